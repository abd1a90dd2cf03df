#!/usr/bin/env python3
"""A tip simulated in MuJoCo, as a plant for the plant link.

    retroflex evaluate --plant 'exec:python3 tests/mujoco_plant/tip.py --seed 3 --effect leak'
    tip.py --list                      prints the names that --effect accepts, with sizes and units
    tip.py --calib --seed 3            prints the gains of that unit as a calibration file
    tip.py --effect leak=0.004 --effect clocking
                                       two effects, one of a given size; without a size it is drawn from the seed
    tip.py --param stiffness=1.2       a physical parameter; `--params` prints them

Needs the package `mujoco` and nothing else. The tip is a chain of 20 universal joints with springs and damping, five of them
with an axial slide and a torsion hinge, held by three tendons that run through the discs at 120 degrees. A tendon is a bellow's centre line: air
pushes it with pressure times area, and its length decides how much room the air has. A syringe, its play and the compliance of the line stand
before it. With springs of the walls k_b and of the line k_t, q = w / (1 + k_b / k_t) holds for the output w of the play, as in Eq. 16 of the paper,
which is the nominal model; an effect is a change of the mechanism or of the sensors, not of that equation.

Inside MuJoCo the units are mm, g, s, hence forces are in uN; elsewhere mm, N, s, rad, m/s^2, uT. Quaternions are [w, x, y, z].
"""
import argparse
import json
import math
import random
import sys
from collections import deque

import mujoco
import numpy

PERIOD_S, SUBSTEPS = 0.005, 2
STEP_MM = math.pi * 30.0 / 3200
LENGTH_MM, RADIUS_MM = 20.0, 7.0 / math.sqrt(3.0)
DISCS = 20
AREA_MM2 = 40.0
ATMOSPHERE_N = 0.101325 * AREA_MM2
WALL_N_MM = 0.31  # a bellow pushed by 41 kPa grows by 5.3 mm
K_EPSILON, K_LAMBDA_MM = (2.22, 2.53, 2.21), (0.87, 0.92, 0.81)
HEAD_MM = 4.0  # centre of the head and sensor beyond the last disc
SENSOR_MM = 3.0
UN = 1e6  # N and N mm in units of the simulator

# name: smallest and largest size, unit, mechanism
EFFECTS = {
    "missed_steps": (4, 16, "full steps", "a weak motor slips by whole pole pairs where load and speed are high"),
    "gear_periodic": (0.1, 0.35, "mm", "tooth error of the rack, two harmonics"),
    "leak": (5e-4, 0.01, "1/s", "a puncture lets air out of one line, or in"),
    "gas_compression": (0.35, 0.95, "share", "this share of the line's compliance is ideal gas"),
    "line_lag": (0.08, 0.5, "s", "flow resistance between syringe and bellow, less of it in dense air"),
    "thermal_drift": (6, 25, "K", "the air in the lines warms, in each by another share"),
    "crosstalk": (0.05, 0.25, "share", "a pressurised lumen squeezes its neighbours"),
    "stiffening": (0.12, 0.6, "share at 5 mm", "the walls of a bellow stiffen with stretch"),
    "asymmetry": (0.1, 0.4, "share", "walls stiffer in extension than in contraction, or the other way round"),
    "hysteresis": (0.06, 0.25, "share", "dry friction in every joint, each with another threshold"),
    "hysteresis.folds": (0.06, 0.25, "share", "dry friction between the folds of each bellow"),
    "creep": (0.08, 0.4, "share", "two Maxwell branches beside the walls"),
    "softening": (0.2, 0.6, "share", "walls that soften up to their largest stretch"),
    "gravity": (3, 9, "g", "a heavy head on a tilted base"),
    "curvature": (0.08, 0.3, "share at 60 deg", "a core that stiffens, or softens, as it bends"),
    "clocking": (0.06, 0.3, "rad", "one bellow off its place, or all"),
    "cable_stiffness": (0.1, 0.5, "share", "an elastic cable along one side"),
    "torsion": (0.4, 1.1, "rad", "bellows wound around the axis"),
    "contact": (0.5, 1.0, "rad", "a wall beside the tip, touched at this bend"),
    "gyro_bias": (0.04, 0.09, "rad/s", "the bias drifts as the sensor warms"),
    "accel_bias": (0.15, 0.8, "m/s^2", "constant error of the accelerometer"),
    "hard_iron": (3, 40, "uT", "magnetised head"),
    "motor_field": (0.5, 12, "uT", "coils of the motors, which stand still"),
    "mount_misalignment": (0.03, 0.2, "rad", "sensor glued on askew"),
    "transport_delay": (0.03, 0.2, "s", "the driver queues its commands"),
    "sensor_latency": (0.03, 0.2, "s", "the sensor queues its samples"),
    "base_motion": (0.04, 0.17, "rad", "the base is turned three times"),
    # outside the catalogue
    "loose_bead": (3, 6, "g", "a bead that slides between two stops in the head"),
    "sticking_joint": (3, 7, "N mm", "five neighbouring joints stick and break loose"),
    "gyro_scale": (0.05, 0.2, "share", "the gyroscope reads too much, or too little"),
}
SIGNED = {"asymmetry", "curvature", "clocking", "torsion", "gyro_scale"}

PARAMS = {
    "stiffness": (1.0, "factor on the stiffness of the bellows' walls"),
    "damping": (1.0, "factor on their damping"),
    "mass": (0.35, "mass of the head, g"),
    "friction": (0.0, "dry friction of a joint, N mm"),
    "lag": (0.0, "lag of the lines by flow resistance, s"),
    "gas": (0.0, "share of the lines' compliance that is ideal gas"),
    "leak": (0.0, "puncture of the first line, 1/s"),
    "line_stiffness": (1.0, "factor on the stiffness of the lines"),
    "play": (1.0, "factor on the backlash"),
}


# ---- quaternions ----
def multiply(a, b):
    (w, x, y, z), (p, q, r, s) = a, b
    return (w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p)


def inverse(q):
    return (q[0], -q[1], -q[2], -q[3])


def exponential(v):
    angle = math.sqrt(sum(x * x for x in v))
    scale = math.sin(angle / 2) / angle if angle > 1e-9 else 0.5
    return (math.cos(angle / 2), *(x * scale for x in v))


def logarithm(q):
    if q[0] < 0:
        q = tuple(-x for x in q)
    sine = math.sqrt(sum(x * x for x in q[1:]))
    scale = 2 * math.atan2(sine, q[0]) / sine if sine > 1e-12 else 2.0
    return [x * scale for x in q[1:]]


def rotated(q, v):
    return multiply(multiply(q, (0.0, *v)), inverse(q))[1:]


def direction(draw):
    v = [draw.gauss(0, 1) for _ in range(3)]
    n = math.sqrt(sum(x * x for x in v))
    return [x / n for x in v]


class Unit:
    """What one tip is: its tolerances, its effects and their sizes. Each is drawn apart, so that an effect changes nothing else."""

    def __init__(self, seed, effects, scale, params):
        self.seed, self.params = seed, params
        draw = self.draw("unit")
        self.k_epsilon = [k * draw.gauss(1, 0.04) for k in K_EPSILON]
        self.k_lambda_mm = [k * draw.gauss(1, 0.08) * params["play"] for k in K_LAMBDA_MM]
        self.lag_s = draw.uniform(0.028, 0.045)
        self.radius_mm = RADIUS_MM * draw.uniform(0.99, 1.01)
        self.place = [2 * math.pi * i / 3 + draw.gauss(0, 0.003) for i in range(3)]
        self.joint_spread = [draw.gauss(1, 0.02) for _ in range(DISCS)]
        self.wall_n_mm = WALL_N_MM * params["stiffness"]
        self.line_n_mm = [WALL_N_MM / k * params["line_stiffness"] for k in self.k_epsilon]
        tilt, around = draw.uniform(0.1, 0.7), draw.uniform(-math.pi, math.pi)
        yaw = draw.uniform(-math.pi, math.pi)
        self.size = {}
        for name, size in effects.items():
            d = self.draw(name)
            low, high = EFFECTS[name][:2]
            # a larger wall is a nearer one
            drawn, sign = d.uniform(low, high) * (1 / scale if name == "contact" else scale), d.choice((-1, 1)) if name in SIGNED else 1
            if name == "curvature" and sign < 0:
                sign = -0.7  # a core that softens more would buckle
            self.size[name] = drawn * sign if size is None else size
        if "gravity" in self.size:
            tilt = self.draw("gravity base").uniform(0.7, 1.5)
        lean = exponential((tilt * math.cos(around), tilt * math.sin(around), 0.0))
        self.base = multiply(exponential((0.0, 0.0, yaw)), lean)

    def draw(self, what):
        return random.Random(f"{self.seed}/{what}")

    def of(self, name):
        return self.size.get(name, 0.0)


def model_of(unit):
    """The chain, its tendons and what touches it."""
    h, u = LENGTH_MM / DISCS, unit
    r, k_b = u.radius_mm, u.wall_n_mm
    bend = 1.5 * k_b * r * r * UN  # of the whole tip, uN mm / rad
    damp = u.lag_s * u.params["damping"] / u.params["stiffness"]
    place = list(u.place)
    if "clocking" in u.size:
        which = u.draw("clocking which").randrange(4)
        place = [a + u.of("clocking") * (which in (i, 3)) for i, a in enumerate(place)]
    twist = u.of("torsion")  # wound symmetrically, so that the mean plane stays
    cable_at = u.draw("cable").uniform(-math.pi, math.pi)

    def sites(j):
        turn = twist * (j / DISCS - 0.5)
        at = [(f"b{i}_{j}", r, a + turn) for i, a in enumerate(place)] + [(f"c_{j}", 1.2 * r, cable_at)]
        z = 0.0 if j == 0 else h / 2
        return "".join(f'<site name="{n}" pos="{d * math.cos(a):.9g} {d * math.sin(a):.9g} {z}"/>' for n, d, a in at)

    def joint(kind, axis, name, k):
        return f'<joint name="{name}" type="{kind}" axis="{axis}" stiffness="{k:.9g}" damping="{k * damp:.9g}"/>'

    text, close = [], ""
    for j in range(1, DISCS + 1):
        k = bend * DISCS * u.joint_spread[j - 1]
        pair = [joint("hinge", "1 0 0", f"x{j}", k), joint("hinge", "0 1 0", f"y{j}", k)]
        flexible = j % 4 == 2
        text.append(f'<body pos="0 0 {h / 2 if j == 1 else h}"><inertial pos="0 0 {h / 2}" mass="0.03" diaginertia="0.15 0.15 0.25"/>')
        text.append(joint("slide", "0 0 1", f"s{j}", 3 * k_b * 5 * UN) if flexible else "")
        text.extend(pair if j % 2 else pair[::-1])  # alternately, or every pair would twist the tip a little
        text.append(joint("hinge", "0 0 1", f"t{j}", 5 * 40.0 * UN) if flexible else "")
        text.append(sites(j))
        close += "</body>"
    mass = u.params["mass"] + u.of("gravity")
    text.append(f'<body name="head" pos="0 0 {h / 2}"><inertial pos="0 0 {HEAD_MM}" mass="{mass:.9g}" diaginertia="{12 * mass:.9g} {12 * mass:.9g} {8 * mass:.9g}"/>'
                f'<site name="imu" pos="0 0 {SENSOR_MM}"/><geom name="nose" type="sphere" size="4" pos="0 0 {SENSOR_MM}" contype="1" conaffinity="1" friction="0.2"/>')
    if "loose_bead" in u.size:
        a = u.draw("bead").uniform(-math.pi, math.pi)
        m = u.of("loose_bead")
        text.append(f'<body name="bead" pos="0 0 {HEAD_MM}"><inertial pos="0 0 0" mass="{m:.9g}" diaginertia="{m:.9g} {m:.9g} {m:.9g}"/>'
                    f'<joint name="bead" type="slide" axis="{math.cos(a):.9g} {math.sin(a):.9g} 0" limited="true" range="-5 5" damping="{m * 80:.9g}" frictionloss="{m * 9810 * 0.08:.9g}"/></body>')
    close += "</body>"
    wall = ""
    if "contact" in u.size:
        b, a = u.of("contact"), u.draw("wall").uniform(-math.pi, math.pi)
        reach = LENGTH_MM * (1 - math.cos(b)) / b + SENSOR_MM * math.sin(b) + 4.0 + 20.0
        wall = (f'<geom type="box" size="20 80 80" pos="{reach * math.cos(a):.9g} {reach * math.sin(a):.9g} 15" euler="0 0 {a:.9g}" '
                'contype="1" conaffinity="1" friction="0.2" solref="0.01 1"/>')
    tendons = [(f"bellow{i}", f"b{i}", "") for i in range(3)]
    if "cable_stiffness" in u.size:
        line = sum(u.line_n_mm) / 3
        k = u.of("cable_stiffness") * 1.5 * (k_b + line) / 1.44 * UN
        tendons.append(("cable", "c", f' stiffness="{k:.9g}" damping="{k * u.lag_s:.9g}" springlength="{LENGTH_MM}"'))
    routes = "".join(f'<spatial name="{n}"{more}>' + "".join(f'<site site="{s}_{j}"/>' for j in range(DISCS + 1)) + "</spatial>" for n, s, more in tendons)
    motors = "".join(f'<motor tendon="bellow{i}" gear="1"/>' for i in range(3))
    turned = " ".join(f"{x:.12g}" for x in u.base)
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
        <compiler angle="radian" autolimits="false" boundmass="0" boundinertia="0"/>
        <option timestep="{PERIOD_S / SUBSTEPS}" gravity="0 0 -9810" integrator="implicitfast" cone="elliptic" iterations="30"/>
        <default><geom contype="0" conaffinity="0" mass="0"/></default>
        <worldbody><body name="base" mocap="true" quat="{turned}">{sites(0)}{wall}{"".join(text)}{close}</body></worldbody>
        <tendon>{routes}</tendon><actuator>{motors}</actuator></mujoco>""")


class Line:
    """A syringe, its play, the line and the air in it. Air counts in mm of piston."""

    def __init__(self, unit, i):
        self.i, self.play_mm, self.k = i, unit.k_lambda_mm[i], unit.line_n_mm[i]
        self.gas = min(max(unit.params["gas"], unit.of("gas_compression")), 0.999)
        d = unit.draw("leaking line")
        self.leak = unit.of("leak") * (d.randrange(3) == i) + unit.params["leak"] * (i == 0)
        lag = unit.params["lag"] + unit.of("line_lag")
        self.at_syringe = 0.4  # share of the compliance on the syringe's side of the resistance
        far = 1 / ((1 - self.at_syringe) / self.k + 1 / unit.wall_n_mm)
        self.resistance = lag * (self.k / self.at_syringe + far)
        warm = unit.draw("warming")
        kelvin = unit.of("thermal_drift")
        # 30 mm of piston fill a line
        self.warm_mm, self.warm_s = 30.0 * kelvin / 300 * warm.uniform(0.7, 1.0) * ((warm.randrange(3) == i) + 0.15), warm.uniform(40, 200)
        self.cross = unit.of("crosstalk")
        self.play_output = self.flown = self.lost = self.force = 0.0

    def pressed(self, room, share):
        """Force, N, of air and walls whose share of the line's compliance gave way by `room` mm."""
        k = self.k / share
        if not self.gas:
            return k * room
        a, b = (1 - self.gas) / k, ATMOSPHERE_N / k - room
        return (math.sqrt(b * b + 4 * a * room * ATMOSPHERE_N) - b) / (2 * a)

    def advance(self, piston, bellow, neighbours, t, dt):
        """Force of the air on the bellow, N."""
        w = self.play_output = min(max(self.play_output, piston - self.play_mm), piston + self.play_mm)
        if self.cross:
            w += 0.5 * self.cross * sum(max(n.force / n.k, 0.0) for n in neighbours)
        if self.warm_mm:
            w += self.warm_mm * (1 - math.exp(-t / self.warm_s))
        if self.leak:
            self.lost += self.leak * self.force / self.k * dt
            w -= self.lost
        if not self.resistance:
            self.force = self.pressed(w - bellow, 1.0)
            return self.force
        near, far = self.pressed(w - self.flown, self.at_syringe), self.pressed(self.flown - bellow, 1 - self.at_syringe)
        density = max(1 + 0.5 * (near + far) / ATMOSPHERE_N, 0.2)
        self.flown += (near - far) / self.resistance * density * dt
        self.force = self.pressed(self.flown - bellow, 1 - self.at_syringe)
        return self.force


class Rubber:
    """Walls of a bellow beyond their linear spring."""

    def __init__(self, unit):
        self.k = unit.wall_n_mm
        self.stiff, self.asym, self.soft, self.creep = (unit.of(n) for n in ("stiffening", "asymmetry", "softening", "creep"))
        d = unit.draw("creep times")
        self.branches = [[d.uniform(1.5, 5), 0.0], [d.uniform(15, 50), 0.0]]
        self.longest = 0.0
        # springs whose feet slip: stiffness, threshold, foot
        folds = unit.of("hysteresis.folds") / 6
        self.folds = [[4 * folds, 4 * folds * (0.2 + 0.4 * j), 0.0] for j in range(6)] if folds else []
        self.any = any((self.stiff, self.asym, self.soft, self.creep, self.folds))

    def force(self, q, dt):
        """Force against the stretch q, N, beyond k q."""
        k = self.stiff * (q / 5) ** 2
        if self.soft:
            self.longest = max(self.longest, abs(q))
            k -= self.soft * (1 - math.exp(-self.longest / 3))
        f = k * q + self.asym * 0.5 * (math.sqrt(q * q + 0.04) - 0.2)
        if self.creep:
            for branch in self.branches:
                tau, z = branch
                f += 0.5 * self.creep * (q - z)
                branch[1] = z + (q - z) * dt / tau
        for fold in self.folds:
            k, most, foot = fold
            load = min(max(k * (q - foot), -most), most)
            fold[2] = q - load / k
            f += load
        return self.k * f


class Friction:
    """Dry friction in the joints: a stiff spring whose foot slips where it is loaded beyond a threshold, in both axes at once. The simulator's own
    friction is regularised by the inertia of a joint, which is tiny here, so that it would give way under a load that stays."""

    def __init__(self, thresholds, joint_k):
        self.holds, self.slides = thresholds.copy(), thresholds.copy()
        self.k, self.foot = 6 * joint_k, numpy.zeros((2, len(thresholds)))

    def moment(self, at):
        load = self.k * (at - self.foot)
        size = numpy.hypot(*load)
        slips = size > self.holds
        load = numpy.where(slips, load * (self.slides / numpy.maximum(size, 1e-9)), load)
        self.foot = numpy.where(slips, at - load / self.k, self.foot)
        return load


class Motors:
    """From counts to pistons, mm."""

    def __init__(self, unit):
        length = round(unit.of("transport_delay") / PERIOD_S) + 1
        self.queue = deque([(0, 0, 0)] * length, maxlen=length)
        d = unit.draw("teeth")
        self.tooth, self.phase = unit.of("gear_periodic"), [d.uniform(-math.pi, math.pi) for _ in range(3)]
        d = unit.draw("weak motor")
        self.slip, self.weak, self.rested = round(unit.of("missed_steps") / 4) * 64, d.randrange(3), d.uniform(20, 60)
        self.lost, self.before = [0, 0, 0], (0, 0, 0)

    def pistons(self, counts, lines, t):
        self.queue.append(counts)
        now = self.queue[0]
        i = self.weak
        speed = (now[i] - self.before[i]) * STEP_MM / PERIOD_S
        # the pole slips where the rack pushes against pressure at speed
        if self.slip and t > self.rested and abs(speed) > 8 and speed * lines[i].force > 4:
            self.lost[i] -= math.copysign(self.slip, speed)
            self.rested = t + 70
        self.before = now
        u = [(n + m) * STEP_MM for n, m in zip(now, self.lost)]
        if self.tooth:
            error = lambda x, p: math.sin(2 * x + p) + 0.35 * math.sin(4 * x + 2.3 * p)
            u = [x + self.tooth * (error(x, p) - error(0, p)) for x, p in zip(u, self.phase)]
        return u


class Sensor:
    """An inertial sensor with its noise and errors."""

    def __init__(self, unit, name):
        d = unit.draw(name)
        tip = name == "tip sensor"
        self.noise = numpy.random.default_rng([unit.seed, 1 if tip else 2])
        self.gyr_bias = numpy.array([d.gauss(0, 0.007) for _ in range(3)])
        self.acc_bias = numpy.array([d.gauss(0, 0.02) for _ in range(3)])
        self.iron = numpy.array([d.gauss(0, 0.2) for _ in range(3)])
        self.mount = exponential([x * (0.004 if tip else 0.03) for x in direction(d)])
        self.drift, self.drift_s, self.scale = numpy.zeros(3), 1.0, 1.0
        if not tip:
            return
        more = lambda what: numpy.array(direction(unit.draw(what + " direction"))) * unit.of(what)
        self.acc_bias += more("accel_bias")
        self.iron += more("hard_iron")
        self.drift, self.drift_s = more("gyro_bias"), unit.draw("gyro warm-up").uniform(20, 150)
        self.scale += unit.of("gyro_scale")
        if "mount_misalignment" in unit.size:
            self.mount = exponential(more("mount_misalignment"))

    def sample(self, acc, gyr, mag, t, with_mag):
        n = self.noise.standard_normal(9)
        return {
            "acc": (numpy.array(acc) + self.acc_bias + 0.04 * n[:3]).round(6).tolist(),
            "gyr": (numpy.array(gyr) * self.scale + self.gyr_bias + self.drift * (1 - math.exp(-t / self.drift_s)) + 0.004 * n[3:6]).round(7).tolist(),
            "mag": (numpy.array(mag) + self.iron + 0.5 * n[6:]).round(4).tolist() if with_mag else None,
        }


class Plant:
    """The whole machine in lockstep."""

    def __init__(self, unit, base_imu):
        self.unit, self.model = unit, model_of(unit)
        self.data = mujoco.MjData(self.model)
        self.head = self.model.body("head").id
        dofs = lambda axis: numpy.array([self.model.joint(f"{axis}{j}").dofadr[0] for j in range(1, DISCS + 1)])
        self.x, self.y = dofs("x"), dofs("y")
        self.curve = unit.of("curvature")
        self.joint_k = 1.5 * unit.wall_n_mm * unit.radius_mm**2 * DISCS * UN
        moment = self.joint_k / DISCS  # at one radian
        share = numpy.array(unit.draw("thresholds").sample([0.1 + 1.8 * j / (DISCS - 1) for j in range(DISCS)], DISCS))
        self.friction = Friction(unit.params["friction"] * UN + unit.of("hysteresis") * moment * share, self.joint_k)
        if "sticking_joint" in unit.size:
            first = unit.draw("stuck").randrange(DISCS - 5)
            self.friction.holds[first:first + 5] += unit.of("sticking_joint") * UN
            self.friction.slides[first:first + 5] += 0.2 * unit.of("sticking_joint") * UN
        self.bends_oddly = self.curve or self.friction.holds.any()
        self.lines, self.rubber = [Line(unit, i) for i in range(3)], [Rubber(unit) for _ in range(3)]
        self.motors = Motors(unit)
        self.tip_sensor, self.base_sensor = Sensor(unit, "tip sensor"), Sensor(unit, "base sensor") if base_imu else None
        d = unit.draw("field")
        strength, dip = d.uniform(40, 55), d.uniform(0.9, 1.25)
        self.field = (strength * math.cos(dip), 0.0, -strength * math.sin(dip))
        d = unit.draw("coils")
        self.coils = numpy.array([d.gauss(0, 1) for _ in range(18)]).reshape(3, 2, 3) / 2.5 * unit.of("motor_field")
        self.idle_s = [0.0] * 3
        d = unit.draw("turns")
        self.turns = [(d.uniform(30, 170), [x * unit.of("base_motion") for x in direction(d)]) for _ in range(3)]
        self.delayed = deque(maxlen=round(unit.of("sensor_latency") / PERIOD_S) + 1)
        self.n, self.t, self.counts, self.reply = 0, 0.0, (0, 0, 0), None
        mujoco.mj_forward(self.model, self.data)
        self.straight = self.data.ten_length[:3].tolist()
        for _ in range(round(1.5 / PERIOD_S)):
            self.advance([0.0] * 3)
        self.rest = self.in_base()
        self.world = self.data.xquat[self.head].tolist(), self.base()
        self.imu = self.model.site("imu").id
        self.places = deque([self.data.site_xpos[self.imu].tolist()] * 3, maxlen=3)

    def lengths(self):
        """How much longer each bellow is than in a straight tip, mm."""
        return [a - b for a, b in zip(self.data.ten_length[:3].tolist(), self.straight)]

    def base(self):
        b = self.unit.base
        for start, v in self.turns if "base_motion" in self.unit.size else ():
            s = min(max((self.t - start) / 1.5, 0.0), 1.0)
            b = multiply(b, exponential([x * s * s * (3 - 2 * s) for x in v]))
        return b

    def in_base(self):
        return multiply(inverse(self.base()), self.data.xquat[self.head].tolist())

    def advance(self, pistons):
        """One period of mechanics."""
        m, d = self.model, self.data
        dt = m.opt.timestep
        for _ in range(SUBSTEPS):
            mujoco.mj_step1(m, d)
            q = self.lengths()
            for i, line in enumerate(self.lines):
                f = line.advance(pistons[i], q[i], (self.lines[i - 1], self.lines[i - 2]), self.t, dt)
                if self.rubber[i].any:
                    f -= self.rubber[i].force(q[i], dt)
                d.ctrl[i] = f * UN
            if self.bends_oddly:
                at = numpy.array((d.qpos[self.x], d.qpos[self.y]))
                square = (at * at).sum(0) * (DISCS * 3 / math.pi) ** 2
                moment = -self.joint_k * self.curve * 1.5 * square / (1 + 0.5 * square) * at
                d.qfrc_applied[self.x], d.qfrc_applied[self.y] = moment - self.friction.moment(at)
            before = d.time
            mujoco.mj_step2(m, d)
            if d.time <= before:  # the simulator begins anew when it diverges
                sys.exit(f"tip.py: the simulation is unstable {self.t:.3f} s after the start")
        mujoco.mj_kinematics(m, d)

    def step(self, t, counts):
        """Holds the counts until t."""
        sampled = False
        while (self.n + 1) * PERIOD_S <= t + 1e-9:
            self.n += 1
            self.t = self.n * PERIOD_S
            self.data.mocap_quat[0] = self.base()
            for i in range(3):
                self.idle_s[i] = 0.0 if counts[i] != self.counts[i] else self.idle_s[i] + PERIOD_S
            self.counts = counts
            self.advance(self.motors.pistons(counts, self.lines, self.t))
            self.delayed.append(self.sample())
            sampled = True
        reply = {"t": t, "imu": None}
        full = len(self.delayed) == self.delayed.maxlen
        if sampled and full:
            reply["imu"] = self.delayed[0][0]
        ref = {"quat": multiply(inverse(self.rest), self.in_base())}
        if self.base_sensor:
            if sampled and full:
                reply["base"] = self.delayed[0][1]
            ref["base_quat"] = multiply(inverse(self.unit.base), self.base())
        reply["ref"] = ref
        return reply

    def sample(self):
        mount = self.tip_sensor.mount
        before, now = self.world, (self.data.xquat[self.head].tolist(), self.base())
        self.world = now
        sensor = multiply(now[0], mount)
        to_sensor = inverse(sensor)
        # the simulator's own accelerometer reads the acceleration before the damping is taken implicitly, which is not what moves the tip
        self.places.append(self.data.site_xpos[self.imu].tolist())
        a, b, c = self.places
        acc = [(x - 2 * y + z) / PERIOD_S**2 * 1e-3 for x, y, z in zip(a, b, c)]
        acc = rotated(to_sensor, (acc[0], acc[1], acc[2] + 9.81))
        turn = logarithm(multiply(inverse(multiply(before[0], mount)), sensor))
        field = self.field
        if "motor_field" in self.unit.size:
            coils = numpy.zeros(3)
            for c, n, idle in zip(self.coils, self.motors.before, self.idle_s):
                phase = 2 * math.pi * (n % 64) / 64
                coils += (0.5 if idle > 0.5 else 1.0) * (c[0] * math.cos(phase) + c[1] * math.sin(phase))
            field = [a + b for a, b in zip(field, rotated(self.unit.base, coils.tolist()))]
        with_mag = self.n % 2 == 0
        tip = self.tip_sensor.sample(acc, [x / PERIOD_S for x in turn], rotated(to_sensor, field), self.t, with_mag)
        if not self.base_sensor:
            return tip, None
        mount = multiply(self.rest, self.base_sensor.mount)
        sensor = multiply(now[1], mount)
        turn = logarithm(multiply(inverse(multiply(before[1], mount)), sensor))
        to_sensor = inverse(sensor)
        return tip, self.base_sensor.sample(rotated(to_sensor, (0, 0, 9.81)), [x / PERIOD_S for x in turn], rotated(to_sensor, self.field), self.t, with_mag)


def pairs(given, known, what):
    """NAME=VALUE and NAME, several in one argument if separated by commas."""
    out = {}
    for text in ",".join(given).split(","):
        name, _, value = text.strip().partition("=")
        if name in ("", "none"):
            continue
        if name not in known:
            sys.exit(f"tip.py: no {what} `{name}`; there are {', '.join(known)}")
        try:
            out[name] = float(value) if value else None
        except ValueError:
            sys.exit(f"tip.py: `{value}` is no number for {what} `{name}`")
    return out


def main():
    parser = argparse.ArgumentParser(description="a tip in MuJoCo as a plant for the plant link")
    parser.add_argument("--seed", type=int, default=1, help="seed of the unit, its effects and its noise")
    parser.add_argument("--effect", action="append", default=[], metavar="NAME[=SIZE]", help="may be repeated or hold several, separated by commas")
    parser.add_argument("--size", type=float, default=1.0, help="factor on drawn sizes")
    parser.add_argument("--param", action="append", default=[], metavar="NAME=VALUE", help="physical parameter; may be repeated")
    parser.add_argument("--base-imu", action="store_true", help="a second IMU on the base")
    parser.add_argument("--calibrated", action="store_true", help="accepted for the sake of other plants: the sensors always are")
    parser.add_argument("--list", action="store_true", help="print the effects")
    parser.add_argument("--params", action="store_true", help="print the parameters")
    parser.add_argument("--calib", action="store_true", help="print the gains of the unit as a calibration file")
    args = parser.parse_args()
    if args.list:
        for name, (low, high, what, how) in EFFECTS.items():
            print(f"{name:<20} {low:g} to {high:g} {what}: {how}")
        return
    if args.params:
        for name, (default, what) in PARAMS.items():
            print(f"{name:<20} {default:g}: {what}")
        return
    params = {name: default for name, (default, _) in PARAMS.items()}
    params.update({k: v for k, v in pairs(args.param, PARAMS, "parameter").items() if v is not None})
    unit = Unit(args.seed, pairs(args.effect, EFFECTS, "effect"), args.size, params)
    if args.calib:
        row = lambda xs: ", ".join(f"{x:.6f}" for x in xs)
        print(f"[transmission]\nk_epsilon = [{row(unit.wall_n_mm / k for k in unit.line_n_mm)}]\nk_lambda_mm = [{row(unit.k_lambda_mm)}]")
        return
    mujoco.set_mju_user_warning(lambda _: None)  # which would be written into the current folder
    plant = Plant(unit, args.base_imu)
    hello = {"plant": "mujoco", "protocol": 1, "imu_period_s": PERIOD_S, "step_mm": STEP_MM, "rest_length_mm": LENGTH_MM}
    if args.base_imu:
        hello["base_imu"] = True
    print(json.dumps(hello), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps(plant.step(request["t"], tuple(request["steps"]))), flush=True)


if __name__ == "__main__":
    main()
