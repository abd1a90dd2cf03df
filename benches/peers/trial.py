"""The paper's experiment for any controller on any plant of the link: 120 held states, scored against the true bend."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass

from controllers import Bend, Controller, Drive, Estimator, bend_of
from link import Plant, Reading

HOLD_S, SCORED_S = 1.5, 0.3
ANGLES_DEG = (15, 30, 45, 60, 75)
DIRECTIONS = 12
# rest before the first state, the part of it that gives the bias of the gyroscope, and the part that defines zero
REST_S, BIAS_S, ZERO_S = 9.0, 4.0, 1.0

Counts = tuple[int, int, int]


def schedule(directions: int) -> Iterator[tuple[float, float, bool]]:
    """Bend and direction in degrees, and whether the state is scored. The visit of 80° makes the second 75° an arrival."""
    for n in range(directions):
        for angle in ANGLES_DEG:
            yield angle, 360 * n / directions, True
        yield 80, 360 * n / directions, False
        for angle in reversed(ANGLES_DEG):
            yield angle, 360 * n / directions, True


class Senses:
    """The estimated bend, from rest on; straight without an estimator."""

    def __init__(self, estimator: Estimator | None, dt_s: float) -> None:
        self._estimator, self._dt_s = estimator, dt_s
        self._orientation = None

    def rest(self) -> Generator[Counts, Reading, None]:
        """The rest before the first state."""
        bias, zero, end = (round(s / self._dt_s) for s in (BIAS_S, REST_S - ZERO_S, REST_S))
        for k in range(end):
            reading = yield (0, 0, 0)
            if self._estimator is None:
                continue
            if k < bias:
                self._estimator.learn_bias(reading.gyr)
                continue
            if k == bias:
                self._estimator.end_bias()
            self.take(reading)
            if k >= zero:
                self._estimator.learn_rest(self._orientation)

    def take(self, reading: Reading) -> None:
        """A reading."""
        if self._estimator is not None:
            self._orientation = self._estimator.update(reading.acc, reading.gyr, reading.mag)

    def bend(self) -> Bend:
        """The estimate after the last reading."""
        return (0.0, 0.0) if self._estimator is None else self._estimator.bend(self._orientation)


@dataclass(frozen=True)
class Run:
    """A controller on a plant; an open loop has no estimator."""

    plant: tuple[str, ...]
    controller: Controller
    estimator: tuple[float, float, float | None] | None
    directions: int = DIRECTIONS

    def trial(self, dt_s: float, step_mm: float) -> Generator[Counts, Reading, float]:
        """Yields counts, takes readings, and returns the bend error in degrees RMS."""
        controller, drive = self.controller, Drive(dt_s)
        senses = Senses(Estimator(dt_s, *self.estimator) if self.estimator else None, dt_s)
        every, hold, scored_from = round(controller.period_s / dt_s), round(HOLD_S / dt_s), round((HOLD_S - SCORED_S) / dt_s)
        sum_sq, count, tick = 0.0, 0, 0
        goal = (0.0, 0.0, 0.0)
        yield from senses.rest()
        for bend_deg, dir_deg, scored in schedule(self.directions):
            beta, delta = math.radians(bend_deg), math.radians(dir_deg)
            controller.aim((beta * math.cos(delta), beta * math.sin(delta)))
            for k in range(hold):
                if tick % every == 0:
                    goal = controller.update(senses.bend(), drive.at)
                tick += 1
                drive.move(goal)
                a, b, c = drive.at
                reading = yield (round(a / step_mm), round(b / step_mm), round(c / step_mm))
                senses.take(reading)
                if scored and k >= scored_from:
                    sum_sq += (bend_deg - math.degrees(math.hypot(*bend_of(reading.truth)))) ** 2
                    count += 1
        return math.sqrt(sum_sq / count)


def together(runs: Sequence[Run]) -> list[float]:
    """The errors of several runs, whose plants work while the other controllers do."""
    plants = [Plant(list(run.plant)) for run in runs]
    loops = [run.trial(plant.period_s, plant.step_mm) for run, plant in zip(runs, plants)]
    for plant, loop in zip(plants, loops):
        plant.send(next(loop))
    errors = [math.nan] * len(runs)
    active = list(range(len(runs)))
    while active:
        for n in list(active):
            try:
                plants[n].send(loops[n].send(plants[n].receive()))
            except StopIteration as end:
                errors[n] = end.value
                active.remove(n)
    for plant in plants:
        plant.close()
    return errors
