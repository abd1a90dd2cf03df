#!/usr/bin/env python3
"""A short check of the tip in MuJoCo and of what the program makes of it; `.ci/mujoco` runs it.

    check.py target/release/retroflex      exit status 1 if a bound is broken

The bounds are generous: they find a plant or a program that is broken, not one that got a little worse.
"""
import csv
import json
import math
import pathlib
import subprocess
import sys
import tempfile
import time

from record import HERE, pistons, record

RETROFLEX = sys.argv[1] if len(sys.argv) > 1 else "target/release/retroflex"
TIP = [sys.executable, str(HERE / "tip.py")]
PLANT = "exec:" + " ".join(TIP)
failed = []


def bound(what, value, limit, unit="", least=False):
    good = value >= limit if least else value <= limit
    print(f"{what}: {value:.3g}{unit} ({'at least' if least else 'at most'} {limit:g}{unit}){'' if good else ' FAILED'}", flush=True)
    if not good:
        failed.append(what)


def program(*arguments):
    """The program's JSON; its exit status 1 is an answer."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "answer.json"
        done = subprocess.run([RETROFLEX, *arguments, "--json", out], capture_output=True, text=True)
        if done.returncode > 1:
            sys.exit(f"{' '.join(map(str, arguments))} ended with {done.returncode}: {done.stderr}")
        return json.loads(out.read_text())


def answers(*arguments, seconds=2.0):
    """Lines of a short run in which every piston moves."""
    began = time.monotonic()
    process = subprocess.Popen([*TIP, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    hello = json.loads(process.stdout.readline())
    started = time.monotonic()
    lines, n = [], round(seconds / hello["imu_period_s"])
    for k in range(1, n + 1):
        at = [round(500 * math.sin(2 * math.pi * (k / n + i / 3)) - 500 * math.sin(2 * math.pi * i / 3)) for i in range(3)]
        process.stdin.write(json.dumps({"t": round(k * hello["imu_period_s"], 6), "steps": at}) + "\n")
        process.stdin.flush()
        lines.append(process.stdout.readline())
    process.stdin.close()
    if process.wait(timeout=10):
        sys.exit(f"tip.py {' '.join(arguments)} ended with {process.returncode}")
    return lines, started - began, seconds / (time.monotonic() - started)


def main():
    first, start_s, speed = answers("--seed", "4", seconds=10.0)
    bound("start", start_s, 10, " s")
    bound("speed over real time", speed, 2, least=True)
    bound("lines that differ in a second run", sum(a != b for a, b in zip(first, answers("--seed", "4", seconds=10.0)[0])), 0)
    listed = subprocess.run([*TIP, "--list"], check=True, capture_output=True, text=True).stdout
    names = [line.split()[0] for line in listed.splitlines()]
    odd = []
    for name in names:
        replies = [json.loads(line) for line in answers("--seed", "4", "--effect", name)[0]]
        numbers = [x for r in replies for x in r["ref"]["quat"] + (r["imu"]["acc"] + r["imu"]["gyr"] if r["imu"] else [])]
        odd += [name] if not all(map(math.isfinite, numbers)) else []
    bound(f"effects of {len(names)} with an answer that is no number", len(odd), 0)

    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch)
        calib = folder / "calib.toml"
        calib.write_text(subprocess.run([*TIP, "--calib", "--seed", "1"], check=True, capture_output=True, text=True).stdout)
        arms = program("evaluate", "--plant", f"{PLANT} --seed 1", "--calib", calib, "--arms", "backlash,closed")["arms"]
        rmse = {arm["name"]: arm["bend_rmse_deg"] for arm in arms}
        bound("bend RMSE of the open loop", rmse["backlash"], 1.0, "°")
        bound("bend RMSE of the closed loop", rmse["closed"], 0.5, "°")

        # walls that are stiffer by a third: other gains, and no effect
        plan, log = folder / "schedule.csv", folder / "stiff.csv"
        subprocess.run([RETROFLEX, "gap", "excite", "--tracker", "--rounds", "20", "--out", plan], check=True, capture_output=True)
        record([*TIP, "--seed", "1", "--param", "stiffness=1.33"], list(csv.DictReader(plan.open())), log, 1, True)
        answer = program("gap", "diagnose", log)
        gap = answer["gap"]
        bound("gap of stiffer walls with the paper's gains", gap["as_configured_deg"], 2.0, "°", least=True)
        bound("gap of stiffer walls, recalibrated", gap["recalibrated_deg"], 0.6, "°")
        print(f"verdict: {answer['verdict']['kind']} {' '.join(answer['verdict']['names'])}")
        bound("effects named where there is none", len(answer["verdict"]["names"]), 0)
        if subprocess.run([RETROFLEX, "gap", "compare", "--help"], capture_output=True).returncode:
            print("SKIPPED: this program has no `gap compare`")
        else:
            found = program("gap", "compare", log, "--plant", f"{PLANT} --seed 1", "--fit", "stiffness=0.5:2")
            value = {p["name"]: p["value"] for p in found["params"]}["stiffness"]
            bound("stiffness found, off by", abs(value / 1.33 - 1), 0.1)
    if failed:
        sys.exit(f"FAILED: {', '.join(failed)}")


if __name__ == "__main__":
    main()
