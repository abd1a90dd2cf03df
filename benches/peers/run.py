"""retroflex beside its peers: runs every row, prints the table, and writes `docs/peers.md` and `docs/peers.svg`.

`.ci/peers` calls this with the packages installed.
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path

import accuracy
import diagnosis
import identification
import orientation
import picture
import pulses
import tick
import tracks
from context import HERE, Context, Unavailable
from table import Row, markdown

ROOT = HERE.parents[1]
# the rows in the order of the table; each module has `measure(context) -> list[Row]`
ROWS = {1: tick, 2: pulses, 3: accuracy, 4: identification, 5: diagnosis, 6: orientation, 7: tracks}

INTRODUCTION = """# Peers

What people use instead, beside retroflex, in one run on the same inputs. `.ci/peers [RECORDING…]` makes this page and its picture;
the recordings are files as `retroflex imu score` reads them. Everything about bend errors is simulated.

![{alt}](peers.svg)

Measured on {machine}.

"""

NOTES = """
* **1, tick.** All stacks run the same inputs, one minute of the experiment with a sample of the IMU every 2 ms: orientation, bend,
  PI loop, inverse kinematics, microsteps. retroflex's tick also learns, checks the sensors and plans. Figures are median / p99.9 /
  worst. A tick is late if it ends after the next one is due; a tick that is skipped for that is late too.
* **2, step pulses.** `retroflex bench rt` on the mock pins, from the due time to the end of the write, beside the wake-up latency of
  `cyclictest` at the same priority and rate, in turns.
* **3, bend error.** All drive the same simulated plants through the plant link, with the paper's calibration, which is that of another
  unit. The paper's 120 held states, RMS over the last 0.3 s. The peers share imufusion's filter, the paper's compensation, and the
  speed and acceleration of the drive. Their settings were chosen on units that are not scored, with
  `benches/peers/tune.py` and, for Broyden in the nominal condition, a comparison of eight points. They have one
  set for the nominal condition and one for the others, and no magnetometer where the motors disturb it, each of which serves
  them better; retroflex has one set for all.
  "Python stack" is a PI loop (simple-pid), "Broyden" controls through an estimated Jacobian, "MPC" predicts with the nominal model and
  a disturbance observer. Five units each, with the twin in the nominal condition.
* **4, identification.** `benches/peers/identification.rs`: twelve units make the prior, ten others are calibrated with it; the error is
  that against 120 poses of the same unit.
* **5, diagnosis.** `retroflex gap exam` on questions of another seed than that of the documents.
* **6, orientation.** The metric of BROAD: RMS of the whole angle over the movement, without a fitted alignment.
* **7, paths.** Known in advance, on five units of the twin and five of `tests/independent_plant/plant.c`, all with the paper's
  calibration; RMS length of the desired minus the true bend vector. The peers command the path 0.02 to 0.04 s ahead, and the PI loop
  of the Python stack stays closed; `benches/peers/tracks.py --tune` compares their settings on other units and another path.
"""


def machine() -> str:
    """The processor and system of this run."""
    try:
        cpu = next(line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name"))
    except (OSError, StopIteration):
        cpu = platform.machine()
    return f"{cpu}, {platform.system()} {platform.release()}, Python {platform.python_version()}"


def measure(context: Context, number: int) -> list[Row]:
    """The rows of one comparison; a failure becomes a skipped row."""
    try:
        return ROWS[number].measure(context)
    except Unavailable as why:
        return [Row.skipped(number, ROWS[number].__name__, str(why))]


def page(context: Context, rows: list[Row]) -> str:
    """The page."""
    header = ["row", "comparison", "retroflex", "peer", "ratio", "asked", ""]
    text = markdown(header, [[str(r.row), r.what, r.ours, r.peer, r.ratio, r.asked, r.verdict()] for r in rows])
    details = {"Bend error by condition": "accuracy", "Error on paths": "tracks", "Orientation error by recording, °": "orientation"}
    for title, name in details.items():
        path = context.work / f"{name}.md"
        if path.exists():
            text += f"\n## {title}\n\n{path.read_text()}"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="*", type=Path, help="recordings for the orientation filters, *.csv or *.csv.gz")
    parser.add_argument(
        "--quick", action="store_true", help="fewer plants and shorter runs; writes beside the other results, not into docs/"
    )
    parser.add_argument("--rows", default=",".join(map(str, ROWS)), help="rows to run, such as 1,3")
    parser.add_argument("--release", type=Path, default=ROOT / "target/release", help="folder of the built programs")
    parser.add_argument("--work", type=Path, default=ROOT / "target/peers/work", help="folder for intermediate files")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    for old in args.work.glob("*"):
        old.unlink()
    context = Context(args.release.resolve(), args.work.resolve(), args.quick, args.recordings)
    numbers = [int(n) for n in args.rows.split(",")]
    rows = [row for number in numbers for row in measure(context, number)]
    whole = not args.quick and numbers == list(ROWS)
    out = ROOT / "docs" if whole else args.work
    text = page(context, rows)
    introduction = INTRODUCTION.format(machine=machine(), alt="Bend error of retroflex and its peers in every condition")
    (out / "peers.md").write_text(introduction + text + NOTES)
    table = context.work / "accuracy.json"
    if table.exists():
        (out / "peers.svg").write_text(picture.svg(json.loads(table.read_text())))
    print(text)
    context.say(f"written to {out}")


if __name__ == "__main__":
    main()
