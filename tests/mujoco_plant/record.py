"""Records a log of a plant as a user would: a schedule, driven through the plant link with the gains of the paper, 100 rows a second."""
import csv
import json
import math
import pathlib
import random
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
RADIUS_MM, K_EPSILON, K_LAMBDA_MM = 7.0 / math.sqrt(3.0), (2.22, 2.53, 2.21), (0.87, 0.92, 0.81)
ROW_S, CORNER_ROWS, TRACKER_DEG = 0.01, 12, 0.12


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
