"""What every row is given, and small helpers."""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent


class Unavailable(Exception):
    """A row cannot run here; the text says why."""


@dataclass(frozen=True)
class Context:
    """Options of a run."""

    release: Path
    work: Path
    quick: bool
    recordings: list[Path]
    start: float = field(default_factory=time.monotonic)

    def program(self, name: str) -> str:
        """A built program: `retroflex`, or an example."""
        for path in (self.release / name, self.release / "examples" / name):
            if path.exists():
                return str(path)
        raise Unavailable(f"{name} is not built")

    def say(self, text: str) -> None:
        """Progress, on standard error."""
        print(f"{time.monotonic() - self.start:6.0f} s  {text}", file=sys.stderr, flush=True)


def answer(command: list[str], may_fail: bool = False) -> dict:
    """The JSON that a program prints. Exit code 1 of retroflex is a verdict, no failure."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in ((0, 1) if may_fail else (0,)):
        raise Unavailable(f"`{' '.join(command[:3])} …` failed: {done.stderr.strip()[-200:]}")
    return json.loads(done.stdout)


def pool() -> ProcessPoolExecutor:
    """One worker on each processor. A plant and its controller take turns, which is several times quicker on one processor."""
    processors = multiprocessing.SimpleQueue()
    allowed = os.sched_getaffinity(0)
    for processor in allowed:
        processors.put(processor)
    return ProcessPoolExecutor(len(allowed), initializer=_stay, initargs=(processors,))


def _stay(processors: multiprocessing.SimpleQueue) -> None:
    os.sched_setaffinity(0, {processors.get()})
