"""Base class of a simulator for the plant link: `--plant 'exec:PROGRAM …'` of `evaluate`, `run` and `gap compare`."""

from __future__ import annotations

import json
import math
import os
import sys
from functools import cached_property, reduce
from io import RawIOBase
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, TextIO, Tuple

_Quaternion = Tuple[float, float, float, float]
_Vector = Tuple[float, float, float]


class Imu(NamedTuple):
    """A reading of an IMU in its own frame; vectors of three."""

    acc: Sequence[float]
    """Specific force, m/s²: +9.81 on the axis that points up at rest."""
    gyr: Sequence[float]
    """Mean angular rate since the sample before, rad/s, so that its sum is the rotation."""
    mag: Optional[Sequence[float]] = None
    """Magnetic field, µT."""


class Sample(NamedTuple):
    """What the sensors say at the end of a step. Vectors and quaternions may be lists, tuples or arrays."""

    acc: Sequence[float]
    """Specific force of the tip, m/s², sensor frame, shape (3,): +9.81 on the axis that points up at rest."""
    gyr: Sequence[float]
    """Mean angular rate of the tip since the sample before, rad/s, sensor frame, shape (3,): its sum is the rotation."""
    mag: Optional[Sequence[float]] = None
    """Magnetic field, µT, sensor frame, shape (3,)."""
    ref: Optional[Sequence[float]] = None
    """True orientation, tip to base, relative to rest, unit quaternion [w, x, y, z]. It serves only for scoring."""
    base: Optional[Imu] = None
    """IMU on the base, its axes parallel to those of the tip's at rest within 3°. Needs `base_imu = True`."""
    base_quat: Optional[Sequence[float]] = None
    """True orientation, base to world, relative to rest, unit quaternion [w, x, y, z]. It serves only for scoring."""


class Plant:
    """A simulated machine. A subclass implements `step`; its program calls `run`.

    ```python
    class Tip(Plant):
        name = "my simulator"

        def step(self, t, pistons_mm):
            ...
            return Sample(acc, gyr, mag, ref)

    Tip().run()
    ```
    """

    name: str = "python"
    """Name of the plant in results."""
    imu_period_s: float = 0.005
    """Time between two steps, s, 0.0002 to 0.05."""
    step_mm: float = math.pi * 30.0 / (200 * 16)
    """Displacement of a piston by one microstep, mm; by default that of the paper's machine."""
    rest_length_mm: float = 20.0
    """Length of the centre line at rest, mm."""
    base_imu: bool = False
    """Whether the plant has an IMU on its base."""

    @cached_property
    def params(self) -> Dict[str, float]:
        """The arguments `--param NAME=VALUE` of the command line, which `gap compare --fit NAME=LOW:HIGH` appends.

        A plant reads them as `self.params.get("stiffness", 1.0)`. Other arguments are left to the program.
        """
        given, params = sys.argv[1:], {}
        for k, word in enumerate(given):
            if word != "--param" and not word.startswith("--param="):
                continue
            text = word[len("--param="):] or "".join(given[k + 1 : k + 2])
            name, _, value = text.partition("=")
            try:
                params[name] = float(value)
            except ValueError:
                sys.exit(f"--param {text}: it must be NAME=VALUE with a number as VALUE")
        return params

    def step(self, t: float, pistons_mm: List[float]) -> Sample:
        """Holds the pistons from the step before until time t, s, and returns what the sensors say at t.

        `pistons_mm` are the displacements of the three pistons as counted, mm: 0 at rest, positive elongates the bellow. The
        first step ends at `imu_period_s`; for the first 2 s at least the pistons stand at zero.
        """
        raise NotImplementedError

    def run(self) -> None:
        """Serves the plant link over standard input and output until its end of file.

        What the program prints from now on goes to standard error, because standard output is the link.
        """
        self.params  # an argument that is wrong is said before the link begins
        sys.stdout.flush()
        with open(os.dup(1), "wb", buffering=0) as link:
            os.dup2(2, 1)
            try:
                self._serve(sys.stdin, link)
            except BrokenPipeError:
                # who asked has gone, which is the end as well
                pass

    def _serve(self, requests: TextIO, link: RawIOBase) -> None:
        def send(message: Dict[str, Any]) -> None:
            link.write(json.dumps(message).encode() + b"\n")

        hello = {
            "plant": self.name, "protocol": 1, "imu_period_s": self.imu_period_s, "step_mm": self.step_mm,
            "rest_length_mm": self.rest_length_mm,
        }
        send({**hello, "base_imu": True} if self.base_imu else hello)
        check, before = _RateCheck(), 0.0
        for line in requests:
            request = json.loads(line)
            t: float = request["t"]
            sample = self.step(t, [n * self.step_mm for n in request["steps"]])
            answer = {"t": t, **self._answer(sample)}
            send(answer)
            if sample.ref is not None:
                check.add(t - before, answer["imu"]["gyr"], answer["ref"])
            before = t

    def _answer(self, sample: Sample) -> Dict[str, Any]:
        answer: Dict[str, Any] = {"imu": _reading(Imu(*sample[:3]), "")}
        if self.base_imu:
            if sample.base is None:
                raise ValueError("base is missing, though base_imu is True")
            answer["base"] = _reading(sample.base, "base.")
        elif sample.base is not None:
            raise ValueError("base is given, though base_imu is False")
        if sample.ref is not None:
            answer["ref"] = {"quat": _vector("ref", sample.ref, 4)}
            if sample.base_quat is not None:
                answer["ref"]["base_quat"] = _vector("base_quat", sample.base_quat, 4)
        return answer


def _reading(imu: Imu, prefix: str) -> Dict[str, Any]:
    mag = None if imu.mag is None else _vector(f"{prefix}mag", imu.mag, 3)
    return {"acc": _vector(f"{prefix}acc", imu.acc, 3), "gyr": _vector(f"{prefix}gyr", imu.gyr, 3), "mag": mag}


def _vector(name: str, values: Sequence[float], size: int) -> List[float]:
    vector = [float(x) for x in values]
    if len(vector) != size or not all(map(math.isfinite, vector)):
        raise ValueError(f"{name} is {vector}; it must be {size} finite numbers")
    if size == 4 and abs(math.hypot(*vector) - 1) > 0.01:
        raise ValueError(f"{name} is {vector}; it must be a unit quaternion [w, x, y, z]")
    return vector


class _RateCheck:
    """Compares the integrated rate with the rotation of the reference, and warns once if they disagree by far."""

    # what is compared: windows of this time, s, in which the reference turns by this angle, rad
    WINDOW_S = 1.0
    TURN = math.radians(10)
    # windows in a row that disagree: single ones do by latency, or by a base that turns
    IN_A_ROW = 8

    def __init__(self) -> None:
        self.start: Optional[_Quaternion] = None
        self.turns: List[_Vector] = []
        self.elapsed_s = 0.0
        self.in_a_row = 0

    def add(self, dt: float, gyr: List[float], ref: Dict[str, List[float]]) -> None:
        self.turns.append((gyr[0] * dt, gyr[1] * dt, gyr[2] * dt))
        self.elapsed_s += dt
        if self.start is None or self.elapsed_s > self.WINDOW_S - dt / 2:
            base = ref.get("base_quat", [1.0, 0.0, 0.0, 0.0])
            now = _times(_quaternion(base), _quaternion(ref["quat"]))
            if self.start is not None and self.in_a_row < self.IN_A_ROW:
                self._judge(self.start, now)
            self.start, self.turns, self.elapsed_s = now, [], 0.0

    def _judge(self, start: _Quaternion, now: _Quaternion) -> None:
        in_sensor, in_base = _times(_inverse(start), now), _times(now, _inverse(start))
        turned = _angle(in_sensor)
        if turned < self.TURN:
            return

        def fits(true: _Quaternion, rate: _Quaternion) -> bool:
            return _angle(_times(_inverse(true), rate)) <= turned / 2 + math.radians(2)

        small = [_exp(turn) for turn in self.turns]
        if fits(in_sensor, reduce(_times, small)):
            self.in_a_row = 0
            return
        self.in_a_row += 1
        if self.in_a_row < self.IN_A_ROW:
            return
        path = sum(math.hypot(*turn) for turn in self.turns)
        why = "perhaps it is in another frame, or the instantaneous rate in place of the mean since the sample before"
        if path > 20 * turned:
            why = "it looks like °/s"
        elif fits(in_sensor, reduce(_times, map(_inverse, small))):
            why = "its sign looks wrong"
        elif fits(in_base, reduce(_times, reversed(small))):
            why = "it looks like the rate in the base frame"
        print(
            f"warning: gyr does not agree with ref: within a second it turns by {math.degrees(path):.3g}°, and ref by "
            f"{math.degrees(turned):.3g}°; {why}. gyr is the mean rate over the step in the sensor frame, rad/s.",
            file=sys.stderr, flush=True,
        )


def _quaternion(q: Sequence[float]) -> _Quaternion:
    norm = math.hypot(*q)
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


def _times(a: _Quaternion, b: _Quaternion) -> _Quaternion:
    (w, x, y, z), (p, q, r, s) = a, b
    return (w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p)


def _inverse(q: _Quaternion) -> _Quaternion:
    return (q[0], -q[1], -q[2], -q[3])


def _exp(v: _Vector) -> _Quaternion:
    angle = math.hypot(*v)
    scale = math.sin(angle / 2) / angle if angle > 1e-9 else 0.5
    return (math.cos(angle / 2), v[0] * scale, v[1] * scale, v[2] * scale)


def _angle(q: _Quaternion) -> float:
    return 2 * math.atan2(math.hypot(*q[1:]), abs(q[0]))
