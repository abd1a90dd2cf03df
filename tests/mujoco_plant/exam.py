#!/usr/bin/env python3
"""Asks `retroflex gap diagnose` about logs of the tip in MuJoCo.

    exam.py --retroflex target/release/retroflex --seeds 1,2              every effect twice, with the tracker
    exam.py --retroflex … --seeds 3 --field --effects leak,none           two logs without
    exam.py --retroflex … --effects none --param stiffness=1.3 --keep DIR a log of a tip with stiffer walls, which stays in DIR

The logs are recorded as a user would: the schedule of `gap excite`, driven with the gains of the paper, 100 rows a second. An answer is right
if it names the effect and nothing else, says `none` without one, and `unknown` for a cause outside the catalogue; it counts as *group*
if the effect stands in a group with what was named.
"""
import argparse
import concurrent.futures
import csv
import json
import math
import pathlib
import random
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
RADIUS_MM, K_EPSILON, K_LAMBDA_MM = 7.0 / math.sqrt(3.0), (2.22, 2.53, 2.21), (0.87, 0.92, 0.81)
ROW_S, CORNER_ROWS, TRACKER_DEG = 0.01, 12, 0.12
OUTSIDE = ("loose_bead", "sticking_joint", "gyro_scale")


def pistons(schedule):
    """Commands and piston positions row by row: Eq. 16, straight lines at the speed of the fastest piston, rounded corners."""
    path, command, at, before, side = [], [], [0.0] * 3, [0.0] * 3, [0] * 3
    for row in schedule:
        bend, turn, length, hold, speed = (float(row[k]) for k in ("bend_deg", "dir_deg", "len_mm", "hold_s", "speed_mm_s"))
        q = [length - 20.0 - math.radians(bend) * RADIUS_MM * math.cos(math.radians(turn) + 2 * math.pi * i / 3) for i in range(3)]
        want = [x * (1 + k) for x, k in zip(q, K_EPSILON)]
        side = [int(math.copysign(1, w - b)) if abs(w - b) > 0.02 else s for w, b, s in zip(want, before, side)]
        to = [w + k * s for w, k, s in zip(want, K_LAMBDA_MM, side)]
        moving = max(1, math.ceil(max(abs(a - b) for a, b in zip(to, at)) / speed / ROW_S))
        still = int(hold / ROW_S)
        path += [[a + (b - a) * k / moving for a, b in zip(at, to)] for k in range(1, moving + 1)] + [to] * still
        command += [(bend, turn, length)] * (moving + still)
        at, before = to, want
    padded = [path[0]] * CORNER_ROWS + path
    window, total, smooth = CORNER_ROWS + 1, [sum(c) for c in zip(*padded[:CORNER_ROWS])], []
    for k in range(len(path)):
        total = [t + x for t, x in zip(total, padded[k + CORNER_ROWS])]
        smooth.append([t / window for t in total])
        total = [t - x for t, x in zip(total, padded[k])]
    return smooth, command


def record(plant, schedule, log, seed, lab):
    """Drives the plant through the link and writes a bend log."""
    path, command = pistons(schedule)
    noise = random.Random(seed)
    process = subprocess.Popen(plant, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    hello = json.loads(process.stdout.readline())
    period, step = hello["imu_period_s"], hello["step_mm"]
    each = round(ROW_S / period)
    names = ["time_s", "cmd_bend_deg", "cmd_dir_deg", "cmd_len_mm", "piston1_mm", "piston2_mm", "piston3_mm"]
    names += [f"{s}_{a}_{u}" for s, u in (("acc", "m_s2"), ("gyr", "rad_s"), ("mag", "ut")) for a in "xyz"]
    names += ["ref_qw", "ref_qx", "ref_qy", "ref_qz"] if lab else []
    with open(log, "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(names)
        before, n = [0.0] * 3, 0
        for at, asked in zip(path, command):
            for part in range(1, each + 1):
                n += 1
                counts = [round((b + (a - b) * part / each) / step) for a, b in zip(at, before)]
                process.stdin.write(json.dumps({"t": round(n * period, 6), "steps": counts}) + "\n")
                process.stdin.flush()
                line = process.stdout.readline()
                if not line:
                    raise RuntimeError(f"the plant ended: {' '.join(plant)}")
                reply = json.loads(line)
            before = at
            imu = reply["imu"] or {}
            cells = [v for s in ("acc", "gyr", "mag") for v in (imu.get(s) or ["", "", ""])]
            if lab:
                w, x, y, z = reply["ref"]["quat"]
                a, b, c = (math.radians(noise.gauss(0, TRACKER_DEG)) / 2 for _ in range(3))
                q = (w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a)
                size = math.sqrt(sum(v * v for v in q))
                cells += [f"{v / size:.8f}" for v in q]
            out.writerow([f"{n * period:.3f}", *asked, *(f"{c * step:.6f}" for c in counts), *cells])
    process.stdin.close()
    process.wait(timeout=10)


def judged(truth, verdict):
    """Whether an answer is right, right as one of a group, or wrong."""
    names, kind = set(verdict["names"]), verdict["kind"]
    known = {t for t in truth if t not in OUTSIDE}
    if truth - known:
        return "right" if kind == "unknown" else "wrong"
    if kind == "unknown":
        return "wrong"
    if names == known:
        return "right"
    groups = [set(g) for g in verdict.get("equivalent", [])]
    swapped = all(t in names or any(t in g and names & g for g in groups) for t in known)
    return "group" if known and swapped and len(names) == len(known) else "wrong"


def said(verdict):
    text = " + ".join(verdict["names"]) or "nothing"
    text = verdict["kind"] + (f" ({text} in part)" if verdict["names"] else "") if verdict["kind"] != "effects" else text
    return text + "".join(f"; or {' / '.join(g)}" for g in verdict.get("equivalent", []) if set(g) & set(verdict["names"]))


def main():
    parser = argparse.ArgumentParser(description="the exam of the diagnosis on the tip in MuJoCo")
    parser.add_argument("--retroflex", required=True, help="the program")
    parser.add_argument("--python", default=sys.executable, help="interpreter that has mujoco")
    parser.add_argument("--effects", help="names, separated by commas; two at once with `+`; default: all and `none`")
    parser.add_argument("--seeds", default="1", help="units, separated by commas")
    parser.add_argument("--field", action="store_true", help="without the tracker")
    parser.add_argument("--param", action="append", default=[], help="passed to the plant")
    parser.add_argument("--keep", type=pathlib.Path, help="folder for logs and answers")
    parser.add_argument("--jobs", type=int, default=1, help="logs at a time")
    parser.add_argument("--json", type=pathlib.Path, help="file for the answers")
    args = parser.parse_args()
    tip = [args.python, str(HERE / "tip.py")]
    if args.effects:
        effects = args.effects.split(",")
    else:
        listed = subprocess.run([*tip, "--list"], check=True, capture_output=True, text=True).stdout
        # a base that turns cannot be told from a tip that does without an IMU of its own
        effects = ["none"] + [n for n in (line.split()[0] for line in listed.splitlines()) if n != "base_motion"]
    more = [x for p in args.param for x in ("--param", p)]

    with tempfile.TemporaryDirectory() as scratch:
        folder = args.keep or pathlib.Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        plan = folder / "schedule.csv"
        tracker = [] if args.field else ["--tracker"]
        subprocess.run([args.retroflex, "gap", "excite", *tracker, "--out", plan], check=True, capture_output=True)
        schedule = list(csv.DictReader(plan.open()))

        def ask(case):
            effect, seed = case
            log = folder / f"{effect}-{seed}-{'field' if args.field else 'lab'}.csv"
            flags = [x for e in effect.split("+") for x in ("--effect", e)]
            record([*tip, "--seed", str(seed), *flags, *more], schedule, log, seed, not args.field)
            answer = log.with_suffix(".json")
            done = subprocess.run([args.retroflex, "gap", "diagnose", log, "--json", answer], capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(f"{log.name}: {done.stderr}")
            return effect, seed, json.loads(answer.read_text())

        cases = [(e, int(s)) for s in args.seeds.split(",") for e in effects]
        count, answers = {}, []
        print(f"{'truth':<28} {'seed':>4}  {'judged':<6} {'as set':>7} {'recal.':>7} {'left':>6} {'prob.':>5}  said")
        with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
            for effect, seed, answer in pool.map(ask, cases):
                truth = {e.partition("=")[0] for e in effect.split("+")} - {"none"}
                truth = {"hysteresis" if e == "fold_friction" else e for e in truth}
                how = judged(truth, answer["verdict"])
                kind = "none" if not truth else "outside" if truth & set(OUTSIDE) else "several" if len(truth) > 1 else "one"
                count.setdefault(kind, []).append(how)
                answers.append({"truth": effect, "seed": seed, "lab": not args.field, "judged": how, "answer": answer})
                g = answer["gap"]
                print(f"{effect:<28} {seed:>4}  {how:<6} {g['as_configured_deg']:>6.2f}° {g['recalibrated_deg']:>6.2f}° {g['explained_deg']:>5.2f}° "
                      f"{answer['verdict'].get('probability', math.nan):>5.2f}  {said(answer['verdict'])}", flush=True)
        for kind, all_of in count.items():
            print(f"{kind}: {all_of.count('right')} right and {all_of.count('group')} in a group of {len(all_of)}")
        if args.json:
            args.json.write_text(json.dumps(answers))


if __name__ == "__main__":
    main()
