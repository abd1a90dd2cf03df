"""Plants over pipes, as the program starts them."""

import json
import subprocess
import sys

import pytest

PLANT = """
import math, sys
from retroflex import Imu, Plant, Sample
print("before the link" if len(sys.argv) > 99 else "", end="")

class Tip(Plant):
    name = "test"
    imu_period_s = 0.01
    step_mm = 0.5
    before = 0.0

    def step(self, t, pistons_mm):
        {body}

Tip().run()
"""
TURNING = """
        # turns about y by 30 degrees a second
        angle = math.radians(30) * t
        rate = (angle - self.before) / self.imu_period_s
        self.before = angle
        return Sample([-9.81 * math.sin(angle), 0, 9.81 * math.cos(angle)], {gyr}, ref=[math.cos(angle / 2), 0, math.sin(angle / 2), 0])
"""
STILL = "return Sample((0, 0, 9.81), (0, 0, 0), ref=(1, 0, 0, 0))"


def run(body, steps=3, arguments=(), requests=None, head=""):
    """Runs a plant to the end of file; returns the lines of the link, standard error and the exit code."""
    code = PLANT.replace("{body}", body.strip()).replace("class Tip(Plant):", f"class Tip(Plant):\n    {head}")
    if requests is None:
        requests = "".join(json.dumps({"t": round(0.01 * (k + 1), 6), "steps": [k, 0, -k]}) + "\n" for k in range(steps))
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], input=requests, capture_output=True, text=True, timeout=30
    )
    return done.stdout.splitlines(), done.stderr, done.returncode


def test_hello_and_answers():
    lines, errors, code = run("return Sample((0, 0, 9.81), (t, 0, pistons_mm[2]), mag=[20, 0, -43], ref=(1, 0, 0, 0))")
    assert (errors, code) == ("", 0)
    assert json.loads(lines[0]) == {"plant": "test", "protocol": 1, "imu_period_s": 0.01, "step_mm": 0.5, "rest_length_mm": 20.0}
    imu = {"acc": [0, 0, 9.81], "gyr": [0.03, 0, -1], "mag": [20, 0, -43]}
    assert json.loads(lines[3]) == {"t": 0.03, "imu": imu, "ref": {"quat": [1, 0, 0, 0]}}
    assert len(lines) == 4


def test_every_answer_is_sent_at_once():
    code = PLANT.replace("{body}", STILL)
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as plant:
        assert "protocol" in plant.stdout.readline()
        for k in range(1, 4):
            plant.stdin.write(f'{{"t":{k},"steps":[0,0,0]}}\n')
            assert json.loads(plant.stdout.readline())["t"] == k
        plant.stdin.close()
        assert plant.wait(10) == 0


def test_a_plant_whose_program_has_gone_ends_quietly():
    code = PLANT.replace("{body}", STILL)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    ) as plant:
        plant.stdout.readline()
        plant.stdout.close()
        plant.stdin.write('{"t":1,"steps":[0,0,0]}\n')
        assert (plant.wait(10), plant.stderr.read()) == (0, "")


def test_prints_go_to_standard_error():
    lines, errors, _ = run("print('hello'); import os; os.system('echo from a process'); " + STILL, steps=1)
    assert len(lines) == 2 and all(json.loads(line) for line in lines)
    assert "hello" in errors and "from a process" in errors


def test_parameters_of_the_command_line():
    body = "return Sample((self.params['stiffness'], self.params.get('gain', 7), 9.81), (0, 0, 0))"
    lines, errors, _ = run(body, 1, ["--seed", "3", "--param", "stiffness=0.5", "--param", "stiffness=1.25e0"])
    assert json.loads(lines[1])["imu"]["acc"] == [1.25, 7, 9.81] and "ref" not in json.loads(lines[1]), errors
    lines, _, _ = run(body, 1, ["--param=stiffness=-2"])
    assert json.loads(lines[1])["imu"]["acc"][0] == -2
    for wrong in (["--param"], ["--param", "stiffness"], ["--param", "stiffness=soft"]):
        lines, errors, code = run(body, 1, wrong)
        assert lines == [] and code == 1 and "NAME=VALUE" in errors, errors


def test_an_imu_on_the_base():
    body = "return Sample((0, 0, 9.81), (0, 0, 0), ref=(1, 0, 0, 0), base=Imu((0, 0, 9.8), (0, 0.1, 0)), base_quat=(1, 0, 0, 0))"
    lines, errors, _ = run(body, 1, head="base_imu = True")
    assert json.loads(lines[0])["base_imu"] is True, errors
    answer = json.loads(lines[1])
    assert answer["base"] == {"acc": [0, 0, 9.8], "gyr": [0, 0.1, 0], "mag": None}
    assert answer["ref"] == {"quat": [1, 0, 0, 0], "base_quat": [1, 0, 0, 0]}
    assert "base_imu is False" in run(body, 1)[1]
    assert "base is missing" in run(STILL, 1, head="base_imu = True")[1]


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("return Sample((0, 0), (0, 0, 0))", "acc is [0.0, 0.0]; it must be 3 finite numbers"),
        ("return Sample((0, 0, 1), (0, 0, math.nan))", "gyr is"),
        ("return Sample((0, 0, 1), (0, 0, 0), mag=(math.inf, 0, 0))", "mag is"),
        ("return Sample((0, 0, 1), (0, 0, 0), ref=(2, 0, 0, 0))", "must be a unit quaternion [w, x, y, z]"),
        ("raise RuntimeError('diverged')", "diverged"),
    ],
)
def test_a_sample_that_is_wrong_is_not_sent(body, why):
    lines, errors, code = run(body, 1)
    assert len(lines) == 1 and why in errors and code == 1


def test_arrays_of_numpy_are_vectors():
    pytest.importorskip("numpy")
    lines, errors, _ = run("import numpy; return Sample(numpy.array([0, 0, 9.81], 'f4'), numpy.zeros(3))", 1)
    assert json.loads(lines[1])["imu"]["gyr"] == [0, 0, 0], errors


@pytest.mark.parametrize(
    ("gyr", "warning"),
    [
        ("(0, rate, 0)", None),
        ("(0.02, 0.8 * rate, -0.02)", None),
        ("(0, math.degrees(rate), 0)", "it looks like °/s"),
        ("(0, -rate, 0)", "its sign looks wrong"),
        ("(rate, 0, 0)", "another frame"),
        ("(0, 0, 0)", "another frame, or the instantaneous rate"),
    ],
)
def test_a_rate_that_does_not_agree_with_the_reference_is_said_once(gyr, warning):
    _, errors, code = run(TURNING.replace("{gyr}", gyr), 1200)
    assert code == 0
    if warning is None:
        assert errors == ""
    else:
        assert errors.count("warning: gyr does not agree with ref") == 1 and warning in errors


CIRCLING = """
        # the axis of a bend of 60 degrees goes around, as in a circle of the tip
        def at(t):
            a, h = math.radians(40) * t, math.radians(30)
            return (math.cos(h), math.sin(h) * math.cos(a), math.sin(h) * math.sin(a), 0.0)
        from retroflex._plant import _inverse, _times
        now, before = at(t), at(t - self.imu_period_s)
        turn = _times({turn})
        return Sample((0, 0, 9.81), [2 * x / self.imu_period_s for x in turn[1:]], ref=now)
"""


def test_a_rate_in_the_base_frame_is_recognised():
    assert run(CIRCLING.replace("{turn}", "_inverse(before), now"), 1200)[1] == ""
    errors = run(CIRCLING.replace("{turn}", "now, _inverse(before)"), 1200)[1]
    assert "it looks like the rate in the base frame" in errors


STEPPING = """
        # a step of 15 degrees every second, at 90 degrees a second, whose rate is seen 0.1 s later
        def at(t):
            ramp = min((t % 1) * 6, 1)
            return math.radians(15) * (ramp if t % 2 < 1 else 1 - ramp)
        a, late = at(t), t - 0.1
        rate = (at(late) - at(late - self.imu_period_s)) / self.imu_period_s if late > 0.1 else 0
        return Sample((0, 0, 9.81), (0, rate, 0), ref=(math.cos(a / 2), 0, math.sin(a / 2), 0))
"""


def test_a_reference_that_stands_and_a_sensor_that_is_late_give_no_warning():
    assert run(STILL, 1000)[1] == ""
    assert run(STEPPING, 3000)[1] == ""
