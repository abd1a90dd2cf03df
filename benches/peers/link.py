"""The controller's side of the plant link: a plant in another process, in lockstep."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass

import orjson

Vector = list[float]


@dataclass(slots=True)
class Reading:
    """What a plant answers: a sample of the IMU and the true orientation, which is for scoring only."""

    acc: Vector
    gyr: Vector
    mag: Vector | None
    truth: Vector


class Plant:
    """A running plant. Between `send` and `receive` it works at the same time as its controller."""

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        hello = orjson.loads(self._process.stdout.readline())
        self.period_s: float = hello["imu_period_s"]
        self.step_mm: float = hello["step_mm"]
        self._n = 0

    def send(self, counts: tuple[int, int, int]) -> None:
        """Holds the counts for one period."""
        self._n += 1
        link = self._process.stdin
        link.write(b'{"t":%.6f,"steps":[%d,%d,%d]}\n' % (self._n * self.period_s, *counts))
        link.flush()

    def receive(self) -> Reading:
        """The reading at the end of the period."""
        answer = orjson.loads(self._process.stdout.readline())
        imu = answer["imu"]
        return Reading(imu["acc"], imu["gyr"], imu["mag"], answer["ref"]["quat"])

    def close(self) -> None:
        """Ends the plant."""
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()
