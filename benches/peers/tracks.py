"""Row 7: paths, known in advance, driven on the same plants from the same calibration.

The plants are units of the twin and seeds of `tests/independent_plant/plant.c`. The error is the RMS length of the desired minus
the true bend vector. A Python stack that follows a path keeps its PI loop closed all the time; `--tune SERVER` shows how its gains
and those of MPC were chosen, on units that are not scored.
"""

from __future__ import annotations

import csv
import json
import math
import random
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from accuracy import calibration
from context import HERE, Context, Unavailable, answer, pool
from controllers import Bend, Drive, Estimator, Mpc, OpenLoop, SlowPi, bend_of
from link import Reading
from peers import ESTIMATOR, Makers
from table import Row, markdown
from trial import Counts, Run, Senses, together

# time at the first point before a path begins
SETTLE_S = 4.0
ROW_S = 0.02
UNITS = range(1, 6)

MAKERS: Makers = {
    "open loop": OpenLoop,
    "Python stack": lambda: SlowPi(ki=8.0, kp=0.3, band_mm=0.5, wait_s=0.0),
    "MPC": lambda: Mpc(observer=0.5, effort=1e-5, band_mm=1.0),
}
# how far ahead of time each commands a path that it knows
LEADS_S = {"open loop": 0.04, "Python stack": 0.02, "MPC": 0.04}


# amplitude in degrees, frequency in Hz, phase in radians
Wave = tuple[float, float, float]


@dataclass(frozen=True)
class Track:
    """A path: each coordinate of the bend vector is a sum of sines."""

    duration_s: float
    waves: tuple[Sequence[Wave], Sequence[Wave]]

    def at(self, t: float) -> Bend:
        """The bend vector at a time, degrees."""
        x, y = (sum(a * math.sin(math.tau * f * t + p) for a, f, p in waves) for waves in self.waves)
        return x, y


def circle(bend_deg: float, hz: float, seconds: float) -> Track:
    """A circle around the straight tip."""
    return Track(seconds, ([(bend_deg, hz, math.pi / 2)], [(bend_deg, hz, 0.0)]))


def smooth(seed: int) -> Track:
    """A random smooth path: four sines in each coordinate, up to 0.3 Hz."""
    draw = random.Random(seed)
    waves = [[(draw.uniform(4, 12), draw.uniform(0.03, 0.3), draw.uniform(0, math.tau)) for _ in range(4)] for _ in range(2)]
    return Track(20.0, (waves[0], waves[1]))


TRACKS = {
    "circle of 30° at 0.1 Hz": circle(30, 0.1, 20.0),
    "circle of 30° at 0.2 Hz": circle(30, 0.2, 10.0),
    "circle of 25° at 0.5 Hz": circle(25, 0.5, 6.0),
    "figure of eight of 40° at 0.1 Hz": Track(20.0, ([(40, 0.1, 0.0)], [(20, 0.2, 0.0)])),
    "random smooth path": smooth(1),
}


def rows(track: Track) -> Iterator[tuple[float, Bend]]:
    """Times and points of a path."""
    for k in range(round(track.duration_s / ROW_S) + 1):
        yield k * ROW_S, track.at(k * ROW_S)


def save(track: Track, path: Path) -> None:
    """The path as a file for `retroflex evaluate --track`."""
    with path.open("w") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["t_s", "bend_deg", "dir_deg"])
        for t, (x, y) in rows(track):
            table.writerow([f"{t:.3f}", f"{math.hypot(x, y):.5f}", f"{math.degrees(math.atan2(y, x)) % 360:.5f}"])


@dataclass(frozen=True)
class Drives(Run):
    """A controller that drives a path on a plant."""

    track: Track = TRACKS["random smooth path"]
    lead_s: float = 0.0

    def trial(self, dt_s: float, step_mm: float) -> Generator[Counts, Reading, float]:
        """Yields counts, takes readings, and returns the error in degrees RMS."""
        drive, controller = Drive(dt_s), self.controller
        senses = Senses(Estimator(dt_s, *self.estimator) if self.estimator else None, dt_s)
        every, settle = round(controller.period_s / dt_s), round(SETTLE_S / dt_s)
        goal, errors = (0.0, 0.0, 0.0), []
        yield from senses.rest()
        for k in range(settle + round(self.track.duration_s / dt_s)):
            now_s = (k + 1 - settle) * dt_s
            if k % every == 0:
                x, y = self.track.at(max(0.0, now_s + self.lead_s))
                controller.aim((math.radians(x), math.radians(y)))
                goal = controller.update(senses.bend(), drive.at)
            drive.move(goal)
            a, b, c = drive.at
            reading = yield (round(a / step_mm), round(b / step_mm), round(c / step_mm))
            senses.take(reading)
            if k >= settle:
                errors.append(math.dist(self.track.at(now_s), [math.degrees(v) for v in bend_of(reading.truth)]))
        return math.sqrt(sum(e * e for e in errors) / len(errors))


def retroflex(program: str, plant: Sequence[str], calib: Path, path: Path) -> float:
    """The error of `retroflex evaluate --track`."""
    command = [program, "evaluate", "--plant", f"exec:{' '.join(plant)}", "--calib", str(calib), "--track", str(path), "--json", "-"]
    return answer(command, may_fail=True)["track"]["rmse_deg"]


def drive(program: str, plant: tuple[str, ...], calib: Path, name: str, path: Path) -> dict[str, float]:
    """The errors of all controllers on a path and a plant."""
    filters = {peer: None if peer == "open loop" else ESTIMATOR for peer in MAKERS}
    runs = [Drives(plant, make(), filters[peer], track=TRACKS[name], lead_s=LEADS_S[peer]) for peer, make in MAKERS.items()]
    return dict(zip(MAKERS, together(runs))) | {"retroflex": retroflex(program, plant, calib, path)}


def plants(server: str, folder: Path) -> dict[str, list[tuple[str, ...]]]:
    """The units of both kinds of plant."""
    found = {"twin": [(server, "--unit", str(n), "--noise", str(n)) for n in UNITS]}
    source, program = HERE.parents[1] / "tests/independent_plant/plant.c", folder / "independent_plant"
    done = subprocess.run(["cc", "-O2", "-o", program, source, "-lm"], capture_output=True, check=False)
    if done.returncode == 0:
        found["independent plant"] = [(str(program), "--seed", str(n)) for n in UNITS]
    return found


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    try:
        server, program = context.program("plant_server"), context.program("retroflex")
    except Unavailable as why:
        return [Row.skipped(7, "paths", str(why))]
    calib = calibration(context.work)
    files = {name: context.work / f"track{n}.csv" for n, name in enumerate(TRACKS)}
    for name, path in files.items():
        save(TRACKS[name], path)
    results: dict[tuple[str, str], list[dict[str, float]]] = {}
    with pool() as workers:
        jobs = {
            workers.submit(drive, program, plant, calib, name, files[name]): (name, kind)
            for kind, units in plants(server, context.work).items()
            for plant in units[: 1 if context.quick else None]
            for name in TRACKS
        }
        for n, job in enumerate(as_completed(jobs), 1):
            results.setdefault(jobs[job], []).append(job.result())
            context.say(f"paths: {n} of {len(jobs)}, {', '.join(jobs[job])}: {job.result()}")
    table = {key: {c: math.sqrt(sum(r[c] ** 2 for r in all_) / len(all_)) for c in all_[0]} for key, all_ in results.items()}
    names = [*MAKERS, "retroflex"]
    order = [(name, kind) for kind in ("twin", "independent plant") for name in TRACKS if (name, kind) in table]
    lines = [[f"{name}, {kind}", *(f"{table[name, kind][c]:.2f}" for c in names)] for name, kind in order]
    (context.work / "tracks.md").write_text(markdown(["error on a path, ° RMS", *names], lines))
    (context.work / "tracks.json").write_text(json.dumps({", ".join(key): value for key, value in table.items()}))
    return [row for key in order for row in _rows(", ".join(key), table[key])]


def _rows(what: str, errors: dict[str, float]) -> list[Row]:
    ours = errors["retroflex"]
    return [Row(7, f"{what}, beside {name}", f"{ours:.2f}°", f"{errors[name]:.2f}°", f"{ours / errors[name]:.3f}") for name in MAKERS]


def tune(server: str) -> None:
    """Prints the error of every setting on two units that are not scored."""
    grid: dict[str, tuple[Callable[[], Controller], float]] = {}
    for band_mm in (0.2, 0.5, 1.0):
        for lead_s in (0.02, 0.04, 0.07):
            for ki in (2.0, 4.0, 8.0, 12.0, 16.0):
                for kp in (0.0, 0.3):
                    make = partial(SlowPi, kp=kp, ki=ki, band_mm=band_mm, wait_s=0.0)
                    grid[f"Python stack, ki {ki}, kp {kp}, band {band_mm} mm, lead {lead_s} s"] = make, lead_s
            for observer in (0.1, 0.2, 0.3, 0.5):
                make = partial(Mpc, observer=observer, effort=1e-5, band_mm=band_mm)
                grid[f"MPC, observer {observer}, band {band_mm} mm, lead {lead_s} s"] = make, lead_s
    tracks = [TRACKS["circle of 30° at 0.2 Hz"], smooth(2)]
    with pool() as workers:
        jobs = {}
        for name, (make, lead_s) in grid.items():
            runs = [
                Drives((server, "--unit", str(n), "--noise", str(n)), make(), ESTIMATOR, track=track, lead_s=lead_s)
                for n, track in zip((101, 102), tracks)
            ]
            jobs[workers.submit(together, runs)] = name
        for job in as_completed(jobs):
            print(f"{math.sqrt(sum(e * e for e in job.result()) / 2):.3f}° {jobs[job]}", flush=True)


if __name__ == "__main__":
    tune(sys.argv[sys.argv.index("--tune") + 1])
