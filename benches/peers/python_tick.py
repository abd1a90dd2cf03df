"""The tick of a Python stack, on the inputs that `peer_tick record` writes; one JSON object on standard output.

    python_tick.py INPUTS.csv time --stack imufusion --ticks 100000
    python_tick.py INPUTS.csv late --stack imufusion --rate 1000 --seconds 10 --priority 80

A tick is what `peer_tick` times too: orientation filter, bend, PI loop, inverse kinematics, microsteps. The garbage collector is
off and the memory is locked, as one does where the time matters.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import time
from collections.abc import Callable, Iterator

import ahrs
import numpy as np
from controllers import Estimator, SlowPi, bend_of, between

PERIOD_S, STEP_MM = 0.002, 0.029452
REST_TICKS = 1450


class Imufusion:
    """The filter of imufusion, as in the accuracy row."""

    def __init__(self) -> None:
        self._estimator = Estimator(PERIOD_S, 0.5, 10.0, 10.0)
        self._ticks = 0

    def bend(self, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> tuple[float, float]:
        """A sample in, the bend out; straight until the rest is known."""
        orientation = self._estimator.update(acc, gyr, mag)
        self._ticks += 1
        if self._ticks <= REST_TICKS:
            self._estimator.learn_rest(orientation)
            return (0.0, 0.0)
        return self._estimator.bend(orientation)


class AhrsMadgwick:
    """Madgwick's filter of the package ahrs."""

    def __init__(self) -> None:
        self._filter = ahrs.filters.Madgwick(Dt=PERIOD_S, gain=0.1)
        self._orientation = np.array([1.0, 0.0, 0.0, 0.0])
        self._ticks = 0

    def bend(self, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> tuple[float, float]:
        """A sample in, the bend out; straight until the rest is over."""
        self._orientation = self._filter.updateMARG(self._orientation, gyr, acc, mag)
        self._ticks += 1
        if self._ticks <= REST_TICKS:
            self._rest = self._orientation.tolist()
            return (0.0, 0.0)
        return bend_of(between(self._rest, self._orientation.tolist()))


STACKS = {"imufusion": Imufusion, "ahrs": AhrsMadgwick}


def runner(stack: str, inputs: np.ndarray) -> Callable[[], None]:
    """One tick a call, over the inputs again and again."""
    # every tick of a real loop gets arrays of its own from its driver
    samples = [(row[:3].copy(), row[3:6].copy(), row[6:9].copy(), (row[9], row[10])) for row in inputs]

    def ticks() -> Iterator[None]:
        pistons = (0.0, 0.0, 0.0)
        while True:
            filter_, loop, target = STACKS[stack](), SlowPi(0.1, 0.8, 0.1, 0.1), None
            for gyr, acc, mag, bend in samples:
                if bend != target:
                    loop.aim(bend)
                    target = bend
                pistons = loop.update(filter_.bend(gyr, acc, mag), pistons)
                _counts = [round(p / STEP_MM) for p in pistons]
                yield

    return ticks().__next__


def timed(run: Callable[[], None], ticks: int) -> dict[str, float]:
    """Times every tick."""
    for _ in range(2000):
        run()
    clock = time.perf_counter_ns
    each = np.empty(ticks, dtype=np.int64)
    for k in range(ticks):
        start = clock()
        run()
        each[k] = clock() - start
    each.sort()
    return {"ticks": ticks, "median_ns": int(each[ticks // 2]), "p999_ns": int(each[int(0.999 * ticks)]), "worst_ns": int(each[-1])}


def late(run: Callable[[], None], rate: float, seconds: float, priority: int) -> dict[str, object]:
    """Runs ticks at absolute times; late is a tick that ends after the next one is due, and one that is skipped for it."""
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        ctypes.CDLL(None).mlockall(3)
    clock, period, ticks = time.monotonic_ns, int(1e9 / rate), int(seconds * rate)
    for _ in range(2000):
        run()
    start = clock() + 100_000_000
    missed, worst, k = 0, 0, 0
    while k < ticks:
        due = start + k * period
        ahead = due - clock()
        if ahead > 0:
            time.sleep(ahead * 1e-9)
        run()
        took = clock() - due
        worst = max(worst, took)
        late_by = took // period
        missed += min(late_by, ticks - k)
        k += max(late_by, 1)
    return {"ticks": ticks, "late": missed, "worst_ns": worst}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("inputs")
    parser.add_argument("task", choices=["time", "late"])
    parser.add_argument("--stack", choices=list(STACKS), required=True)
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--priority", type=int, default=0)
    args = parser.parse_args()
    run = runner(args.stack, np.loadtxt(args.inputs, delimiter=",", skiprows=1))
    gc.collect()
    gc.freeze()
    gc.disable()
    result = timed(run, args.ticks) if args.task == "time" else late(run, args.rate, args.seconds, args.priority)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
