"""The peers: controllers as people write them in Python, all from the same calibration and on the same estimate.

Every controller sees the estimated bend vector and the counted pistons, and returns where the pistons shall go. The drive moves
them there with the speed and acceleration of retroflex's board. Angles are radians, lengths mm. A bend vector is
β (cos δ, sin δ).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import imufusion
import numpy as np
from simple_pid import PID

K_EPSILON = (2.22, 2.53, 2.21)
K_LAMBDA_MM = (0.87, 0.92, 0.81)
R_MM = 7.0 / math.sqrt(3.0)
LAG_S = 0.03
DEG, PER_G = 180 / math.pi, 1 / 9.80665
SPEED_MM_S, ACCELERATION_MM_S2, TRAVEL_MM = 30.0, 600.0, 30.0
# what each bellow shortens by for a bend vector is R_MM times this
SPOKES = tuple((math.cos(2 * math.pi * i / 3), -math.sin(2 * math.pi * i / 3)) for i in range(3))

Bend = tuple[float, float]
Pistons = tuple[float, float, float]


def play_free(bend: Bend) -> Pistons:
    """Piston positions for a bend behind the backlash: the arc (Eq. 10 and 11), then the extension (Eq. 14)."""
    return tuple(-(1 + k) * R_MM * (bend[0] * c + bend[1] * s) for k, (c, s) in zip(K_EPSILON, SPOKES))


# bend vector per play-free piston position, rad/mm: the inverse of `play_free` at constant length
JACOBIAN = np.array([[-2 * spoke[axis] / (3 * R_MM * (1 + k)) for k, spoke in zip(K_EPSILON, SPOKES)] for axis in range(2)])


STRETCH = 1 + np.array(K_EPSILON)
# the least motion that says something of the Jacobian
LEAST_MOVE_MM = 1.0


class Backlash:
    """The inverse of the play (Eq. 15), with the side of each channel as state.

    A channel changes sides when its position has gone back by more than `band_mm`, so that small corrections do not chatter.
    """

    def __init__(self, band_mm: float) -> None:
        self._band_mm = band_mm
        self._side = [0.0, 0.0, 0.0]
        self._extreme = [0.0, 0.0, 0.0]

    def pistons(self, wanted: Sequence[float]) -> Pistons:
        """Piston positions that bring the far side of the play to `wanted`."""
        for i, w in enumerate(wanted):
            away = w - self._extreme[i]
            if self._side[i] == 0.0 and abs(away) > self._band_mm or away * self._side[i] < -self._band_mm:
                self._side[i] = math.copysign(1.0, away)
            if away * self._side[i] > 0.0:
                self._extreme[i] = w
        return tuple(w + k * s for w, k, s in zip(wanted, K_LAMBDA_MM, self._side))


class Drive:
    """The pistons on their way: a trapezoid of speed per channel."""

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self._speed = [0.0, 0.0, 0.0]
        self.at = [0.0, 0.0, 0.0]

    def move(self, target: Sequence[float]) -> None:
        """One period towards `target`."""
        dt, most = self._dt_s, ACCELERATION_MM_S2 * self._dt_s
        for i, goal in enumerate(target):
            away = min(max(goal, -TRAVEL_MM), TRAVEL_MM) - self.at[i]
            # the speed from which braking ends at the goal, and which does not pass it within a period
            wanted = min(SPEED_MM_S, math.sqrt(2 * ACCELERATION_MM_S2 * abs(away)), abs(away) / dt)
            change = math.copysign(wanted, away) - self._speed[i]
            self._speed[i] += min(max(change, -most), most)
            self.at[i] += self._speed[i] * dt


class Estimator:
    """The bend vector from imufusion's filter, relative to the mean orientation at rest.

    Without a threshold for the field the filter runs without the magnetometer.
    """

    def __init__(self, dt_s: float, gain: float, acceleration_rejection_deg: float, magnetic_rejection_deg: float | None) -> None:
        self._ahrs = imufusion.Ahrs()
        self._ahrs.set_settings(
            imufusion.AhrsSettings(
                sample_rate=1 / dt_s,
                convention=imufusion.CONVENTION_NWU,
                gain=gain,
                gyroscope_range=2000.0,
                acceleration_rejection=acceleration_rejection_deg,
                magnetic_rejection=magnetic_rejection_deg or 0.0,
                rejection_timeout=5.0,
            )
        )
        self._with_field = magnetic_rejection_deg is not None
        self._rates: list[list[float]] = []
        self._bias = np.zeros(3)
        self._mag = np.zeros(3)
        self._rest: list[np.ndarray] = []
        self._from_rest: np.ndarray | None = None

    def learn_bias(self, gyr: list[float]) -> None:
        """A rate at rest."""
        self._rates.append(gyr)

    def end_bias(self) -> None:
        """The mean rate at rest is the bias."""
        self._bias = np.degrees(np.mean(self._rates, axis=0))

    def update(self, acc: list[float], gyr: list[float], mag: list[float] | None) -> np.ndarray:
        """A sample; the field is held between its samples. Returns the orientation."""
        if mag is not None:
            self._mag = np.array(mag)
        rate, force = np.array(gyr) * DEG - self._bias, np.array(acc) * PER_G
        if self._with_field:
            self._ahrs.update(rate, force, self._mag)
        else:
            self._ahrs.update_no_magnetometer(rate, force)
        return self._ahrs.get_quaternion()

    def learn_rest(self, quaternion: np.ndarray) -> None:
        """An orientation at rest."""
        self._rest.append(quaternion if not self._rest or quaternion @ self._rest[0] > 0 else -quaternion)

    def bend(self, quaternion: np.ndarray) -> Bend:
        """The bend vector of an orientation."""
        if self._from_rest is None:
            mean = np.mean(self._rest, axis=0)
            self._from_rest = (mean / np.linalg.norm(mean)).tolist()
        return bend_of(between(self._from_rest, quaternion.tolist()))


def between(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """The rotation from orientation `a` to `b`, in the axes of `a`."""
    (w, x, y, z), (p, q, r, s) = a, b
    return [w * p + x * q + y * r + z * s, w * q - x * p - y * s + z * r, w * r + x * s - y * p - z * q, w * s - x * r + y * q - z * p]


def bend_of(quaternion: Sequence[float]) -> Bend:
    """The bend vector of a rotation since rest: β is that of the tip axis, the direction leaves the smallest angle."""
    w, x, y, z = quaternion if quaternion[0] >= 0 else [-c for c in quaternion]
    across = math.hypot(x, y)
    scale = 2 * math.atan2(across, math.hypot(w, z)) / across if across > 1e-9 else 2.0
    return (y * scale, x * scale)


class Controller(Protocol):
    """From the estimated bend to the pistons, once every `period_s`."""

    period_s: float

    def aim(self, bend: Bend) -> None:
        """A new set-point."""

    def update(self, bend: Bend, pistons: Sequence[float]) -> Pistons:
        """Where the pistons shall go, from the estimated bend and the present positions."""


class OpenLoop:
    """The paper's compensation of extension and backlash, without feedback."""

    period_s = 0.02

    def __init__(self) -> None:
        self._backlash = Backlash(0.0)
        self._target: Bend = (0.0, 0.0)

    def aim(self, bend: Bend) -> None:
        self._target = bend

    def update(self, bend: Bend, pistons: Sequence[float]) -> Pistons:
        return self._backlash.pistons(play_free(self._target))


class Arrival:
    """Whether the pistons have arrived, and for how long."""

    def __init__(self, period_s: float, wait_s: float) -> None:
        self._period_s, self._wait_s = period_s, wait_s
        self._since_s = 0.0

    def restart(self) -> None:
        """The pistons are sent elsewhere."""
        self._since_s = 0.0

    def settled(self, goal: Sequence[float], pistons: Sequence[float]) -> bool:
        """True once they have been near their goal for the waiting time, until a restart."""
        if self._since_s < self._wait_s:
            near = all(abs(g - p) < 0.3 for g, p in zip(goal, pistons))
            self._since_s = self._since_s + self._period_s if near else 0.0
        return self._since_s >= self._wait_s


class SlowPi:
    """The paper's compensation and a slow PI loop on the bend vector, with the package simple-pid.

    While the pistons travel to a new set-point the loop is in manual mode, which the package provides against wind-up.
    """

    period_s = 0.01

    def __init__(self, kp: float, ki: float, band_mm: float, wait_s: float) -> None:
        limit = math.radians(60.0)
        self._axes = [PID(kp, ki, 0.0, sample_time=None, output_limits=(-limit, limit)) for _ in range(2)]
        self._backlash = Backlash(band_mm)
        self._arrival = Arrival(self.period_s, wait_s)
        self._target: Bend = (0.0, 0.0)
        self._goal: Pistons = (0.0, 0.0, 0.0)
        self._feedback = [0.0, 0.0]

    def aim(self, bend: Bend) -> None:
        self._target = bend
        self._arrival.restart()
        for axis, setpoint in zip(self._axes, bend):
            axis.setpoint = setpoint
        self._goal = self._pistons()

    def _pistons(self) -> Pistons:
        wanted = (self._target[0] + self._feedback[0], self._target[1] + self._feedback[1])
        return self._backlash.pistons(play_free(wanted))

    def update(self, bend: Bend, pistons: Sequence[float]) -> Pistons:
        closed = self._arrival.settled(self._goal, pistons)
        for n, axis in enumerate(self._axes):
            if closed != axis.auto_mode:
                axis.set_auto_mode(closed, last_output=self._feedback[n])
            if closed:
                self._feedback[n] = axis(bend[n], dt=self.period_s)
        self._goal = self._pistons()
        return self._goal


class Broyden:
    """Model-free Jacobian control: the Jacobian starts at that of the calibration and follows Broyden's update.

    A new set-point is approached by one whole Newton step. Once the pistons have arrived, what is left is taken out by a share
    every period. The Jacobian learns from the motion between the ends of two states, where lag and dead time have passed, and
    stays within half of the calibrated one, so that it cannot become singular.
    """

    period_s = 0.04

    def __init__(self, gain_per_s: float, forgetting: float, band_mm: float, wait_s: float) -> None:
        self._share, self._forgetting = gain_per_s * self.period_s, forgetting
        self._backlash = Backlash(band_mm)
        self._arrival = Arrival(self.period_s, wait_s)
        self._jacobian = JACOBIAN
        self._target, self._seen = np.zeros(2), np.zeros(2)
        self._wanted = np.zeros(3)
        self._goal: Pistons = (0.0, 0.0, 0.0)
        self._known = (self._seen, self._wanted)

    def aim(self, bend: Bend) -> None:
        self._learn()
        self._go(np.array(bend) - self._target)
        self._target = np.array(bend)
        self._arrival.restart()

    def _learn(self) -> None:
        """Broyden's update from the last two states."""
        moved = self._wanted - self._known[1]
        length_sq = moved @ moved
        if length_sq > LEAST_MOVE_MM**2:
            surprise = self._seen - self._known[0] - self._jacobian @ moved
            change = self._jacobian + self._forgetting * np.outer(surprise, moved) / length_sq - JACOBIAN
            most = 0.5 * np.linalg.norm(JACOBIAN, 2)
            self._jacobian = JACOBIAN + change * min(1.0, most / max(np.linalg.norm(change, 2), 1e-12))
        self._known = (self._seen, self._wanted)

    def _go(self, change: np.ndarray) -> None:
        """Moves the bend by `change` at constant mean length of the bellows."""
        square = np.vstack([self._jacobian, 1 / STRETCH])
        self._wanted = self._wanted + np.linalg.solve(square, [*change, -(self._wanted / STRETCH).sum()])
        self._goal = self._backlash.pistons(self._wanted)

    def update(self, bend: Bend, pistons: Sequence[float]) -> Pistons:
        self._seen = np.array(bend)
        if self._arrival.settled(self._goal, pistons):
            self._go(self._share * (self._target - self._seen))
        return self._goal


@dataclass
class Mpc:
    """Model predictive control on the nominal model: play, extension, a lag, constant curvature.

    A constant disturbance of the bend is observed, so that there is no offset. The quadratic program in the moves of the
    pistons, bounded by their speed, is solved by accelerated projected gradients from the last solution.
    """

    observer: float
    effort: float
    band_mm: float
    period_s: float = 0.02
    horizon: int = 10
    iterations: int = 15
    _target: np.ndarray = field(default_factory=lambda: np.zeros(2))
    _wanted: np.ndarray = field(default_factory=lambda: np.zeros(3))
    _play: np.ndarray = field(default_factory=lambda: np.zeros(3))
    _bend: np.ndarray = field(default_factory=lambda: np.zeros(2))
    _disturbance: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        self._backlash = Backlash(self.band_mm)
        self._keep = math.exp(-self.period_s / LAG_S)
        n = self.horizon
        # response of the bend at the end of period k to a unit step of the bend demand at the start of period j
        step = np.array([[1 - self._keep ** (k - j + 1) if k >= j else 0.0 for j in range(n)] for k in range(n)])
        self._forced = np.kron(step, JACOBIAN)
        self._free = np.array([self._keep ** (k + 1) for k in range(n)])
        length = np.kron(np.tril(np.ones((n, n))), 1 / STRETCH / 3)
        self._length = 0.03 * length
        self._hessian = self._forced.T @ self._forced + self._length.T @ self._length + self.effort * np.eye(3 * n)
        self._step = 1 / np.linalg.eigvalsh(self._hessian)[-1]
        self._moves = np.zeros(3 * n)

    def aim(self, bend: Bend) -> None:
        self._target = np.array(bend)

    def update(self, bend: Bend, pistons: Sequence[float]) -> Pistons:
        at = np.array(pistons)
        self._play = np.clip(self._play, at - K_LAMBDA_MM, at + K_LAMBDA_MM)
        self._bend = self._keep * self._bend + (1 - self._keep) * (JACOBIAN @ self._play)
        self._disturbance = self._disturbance + self.observer * (np.array(bend) - self._bend - self._disturbance)
        demand = JACOBIAN @ self._wanted
        free = demand + np.outer(self._free, self._bend - demand)
        error = (self._target - self._disturbance - free).ravel()
        offset = 0.03 * self._wanted @ (1 / STRETCH / 3)
        linear = self._forced.T @ error - self._length.sum(axis=0) * offset
        self._moves = self._solve(linear)
        self._wanted = np.clip(self._wanted + self._moves[:3], -TRAVEL_MM, TRAVEL_MM)
        return self._backlash.pistons(self._wanted)

    def _solve(self, linear: np.ndarray) -> np.ndarray:
        most = SPEED_MM_S * self.period_s
        moves = np.concatenate([self._moves[3:], np.zeros(3)])
        ahead, weight = moves, 1.0
        for _ in range(self.iterations):
            following = np.minimum(np.maximum(ahead - self._step * (self._hessian @ ahead - linear), -most), most)
            heavier = (1 + math.sqrt(1 + 4 * weight * weight)) / 2
            ahead = following + (weight - 1) / heavier * (following - moves)
            moves, weight = following, heavier
        return moves
