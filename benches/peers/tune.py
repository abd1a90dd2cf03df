"""Chooses the settings of the peers: `target/peers/bin/python benches/peers/tune.py SERVER nominal|robust`.

SERVER is the built example `plant_server`. One setting after the other takes the value with the least error, twice round, from
two starts. The error is the RMS on units of the twin that `accuracy.py` does not score; for `robust` its geometric mean over
conditions of the sweep. Three directions of the schedule keep this short.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from accuracy import Case
from context import pool
from controllers import Broyden, Controller, Mpc, SlowPi
from trial import Run, together

DIRECTIONS = 3
# the plants whose errors count, each a condition and units of the twin that are not scored
TUNED = {
    "nominal": {"nominal": (101, 102)},
    "robust": {"line lag 0.6 s": (101,), "dead time 0.12 s": (102,), "field of the motors 8 µT": (101,), "respiration 3°": (102,)},
}

Settings = dict[str, float]

GRIDS: dict[str, tuple[Callable[..., Controller], dict[str, tuple[float, ...]]]] = {
    "Python stack": (
        SlowPi,
        {"ki": (1.0, 2.0, 4.0, 6.0), "kp": (0.0, 0.1, 0.3), "band_mm": (0.2, 0.5, 2.0, 5.0), "wait_s": (0.1, 0.2, 0.3)},
    ),
    "Broyden": (
        Broyden,
        {
            "gain_per_s": (1.0, 2.0, 3.0, 4.0),
            "forgetting": (0.1, 0.3, 0.6, 1.0),
            "band_mm": (0.2, 0.5, 2.0, 5.0),
            "wait_s": (0.1, 0.2, 0.3),
        },
    ),
    "MPC": (
        Mpc,
        {"observer": (0.02, 0.05, 0.1, 0.2), "effort": (1e-7, 1e-6, 1e-5), "band_mm": (0.2, 0.5, 2.0, 5.0)},
    ),
}


def error(server: str, tuned: str, make: Callable[..., Controller], settings: Settings) -> float:
    """The logarithm of the error with these settings."""
    total = 0.0
    for condition, units in TUNED[tuned].items():
        cases = [Case(condition, unit) for unit in units]
        runs = [Run(case.command(server), make(**settings), case.estimator(), DIRECTIONS) for case in cases]
        total += math.log(math.sqrt(sum(e * e for e in together(runs)) / len(runs)))
    return total / len(TUNED[tuned])


def descend(name: str, grid: dict[str, tuple[float, ...]], start: Settings, score: Callable[[Settings], Future]) -> tuple[float, Settings]:
    """Settings that no change of a single one makes better, as far as two rounds find them, after their error."""
    best, known = dict(start), {}
    for _ in range(2):
        for key, values in grid.items():
            trials = {value: best | {key: value} for value in values}
            jobs = {v: score(t) for v, t in trials.items() if tuple(t.values()) not in known}
            known |= {tuple(trials[v].values()): job.result() for v, job in jobs.items()}
            errors = {v: known[tuple(t.values())] for v, t in trials.items()}
            best[key] = min(errors, key=errors.get)
            print(name, key, ", ".join(f"{v}: {math.exp(e):.3f}°" for v, e in errors.items()), flush=True)
    return known[tuple(best.values())], best


def main() -> None:
    server, tuned = sys.argv[1:3]
    with pool() as workers:
        for name, (make, grid) in GRIDS.items():
            starts = [{key: values[n] for key, values in grid.items()} for n in (1, 2)]
            score = partial(workers.submit, error, server, tuned, make)
            found = [descend(name, grid, start, score) for start in starts]
            print(f"{name}:", min(found, key=lambda one: one[0])[1], flush=True)


if __name__ == "__main__":
    main()
