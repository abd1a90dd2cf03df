#!/usr/bin/env python3
"""A minimal plant for the plant link, using only Python's standard library.

    retroflex evaluate --plant 'exec:python3 examples/foreign_plant.py --seed 7'

A simulator greets with one line, then answers every line of microstep counts with one line of IMU reading and
true orientation, until end of file. The physics is minimal: play, extension, lag, constant curvature, and an
IMU with bias and noise. `examples/plant.py` is the same plant by the package `retroflex`, which takes over the link.
Units are mm, s, rad, m/s^2, uT; quaternions are [w, x, y, z] and take tip coordinates to the base's.
"""
import argparse
import json
import math
import random
import sys

PERIOD_S = 0.005
STEP_MM = math.pi * 30.0 / (200 * 16)
REST_LENGTH_MM = 20.0


def multiply(a, b):
    """Quaternion product."""
    (w, x, y, z), (p, q, r, s) = a, b
    return (w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p)


def inverse(q):
    """Inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def exponential(v):
    """Unit quaternion of a rotation vector."""
    angle = math.sqrt(sum(x * x for x in v))
    scale = math.sin(angle / 2) / angle if angle > 1e-9 else 0.5
    return (math.cos(angle / 2), *(x * scale for x in v))


def logarithm(q):
    """Rotation vector of a unit quaternion."""
    sine = math.sqrt(sum(x * x for x in q[1:]))
    scale = 2 * math.atan2(sine, q[0]) / sine if sine > 1e-12 else 2.0
    return [x * scale for x in q[1:]]


def rotated(q, v):
    """The vector v rotated by q."""
    return multiply(multiply(q, (0.0, *v)), inverse(q))[1:]


class Tip:
    """Three lines, three bellows, one IMU."""

    def __init__(self, seed):
        draw = random.Random(seed)
        self.noise = random.Random(seed + 1)
        self.gain = [draw.uniform(1.6, 3.2) for _ in range(3)]
        self.half_gap_mm = [draw.uniform(0.4, 1.2) for _ in range(3)]
        self.r_mm = 7.0 / math.sqrt(3.0) * draw.uniform(0.96, 1.04)
        self.lag_s = draw.uniform(0.015, 0.045)
        self.gyro_bias = [math.radians(draw.gauss(0, 0.4)) for _ in range(3)]
        self.acc_bias = [draw.gauss(0, 0.04) for _ in range(3)]
        tilt = [draw.gauss(0, 0.5) for _ in range(3)]
        self.up = rotated(exponential(tilt), (0.0, 0.0, 9.81))
        self.field = rotated(exponential(tilt), (20.0, 0.0, -43.0))
        self.play_output_mm, self.bend, self.attitude = [0.0] * 3, [0.0, 0.0], (1.0, 0.0, 0.0, 0.0)

    def step(self, pistons_mm):
        """Holds the pistons for one period and returns the IMU reading."""
        for i, piston_mm in enumerate(pistons_mm):
            low, high = piston_mm - self.half_gap_mm[i], piston_mm + self.half_gap_mm[i]
            self.play_output_mm[i] = min(max(self.play_output_mm[i], low), high)
        bellow_mm = [w / (1 + k) for w, k in zip(self.play_output_mm, self.gain)]
        angles = [2 * math.pi * i / 3 for i in range(3)]
        moment = [sum(q * math.cos(a) for q, a in zip(bellow_mm, angles)), -sum(q * math.sin(a) for q, a in zip(bellow_mm, angles))]
        keep = math.exp(-PERIOD_S / self.lag_s)
        for axis in range(2):
            target = -2 / (3 * self.r_mm) * moment[axis]
            self.bend[axis] = target + (self.bend[axis] - target) * keep
        before, self.attitude = self.attitude, exponential((self.bend[1], self.bend[0], 0.0))
        turn = logarithm(multiply(inverse(before), self.attitude))
        to_tip = inverse(self.attitude)
        noisy = lambda v, sigma: [x + self.noise.gauss(0, sigma) for x in v]
        return {
            "acc": noisy([a + b for a, b in zip(rotated(to_tip, self.up), self.acc_bias)], 0.02),
            "gyr": noisy([t / PERIOD_S + b for t, b in zip(turn, self.gyro_bias)], 0.002),
            "mag": noisy(rotated(to_tip, self.field), 0.4),
        }


def main():
    parser = argparse.ArgumentParser(description="a minimal plant for the plant link")
    parser.add_argument("--seed", type=int, default=1, help="seed of the unit and of its noise")
    tip = Tip(parser.parse_args().seed)

    def send(message):
        print(json.dumps(message), flush=True)

    send({"plant": "python", "protocol": 1, "imu_period_s": PERIOD_S, "step_mm": STEP_MM, "rest_length_mm": REST_LENGTH_MM})
    for line in sys.stdin:
        request = json.loads(line)
        imu = tip.step([n * STEP_MM for n in request["steps"]])
        send({"t": request["t"], "imu": imu, "ref": {"quat": tip.attitude}})


if __name__ == "__main__":
    main()
