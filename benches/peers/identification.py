"""Row 4: held poses until the gains of a new unit are known, the paper's scheme beside a prior from a fleet."""

from __future__ import annotations

import json
import statistics
import subprocess

from context import Context, Unavailable
from table import Row

ASKED = 0.03


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    context.say("identification: gains of a fleet and of ten new units")
    done = subprocess.run([context.program("peers_identification")], capture_output=True, text=True, check=False)
    if done.returncode:
        raise Unavailable(done.stderr.strip()[-200:])
    return [_row(json.loads(line)) for line in done.stdout.splitlines()]


def _row(result: dict) -> Row:
    poses = result["poses"].index(12)
    worst, paper = result["worst"][poses], statistics.median(result["paper_poses"])
    kind = {"plain": "units that follow the transmission law", "twin": "units of the twin, whose gain depends on pose and time"}
    what = f"worst error of a k_ε after 12 held poses with a fleet's prior; poses of the paper's scheme; {kind[result['units']]}"
    return Row(4, what, f"12 poses: {worst:.1%}", f"{paper:.0f} poses to 2 %", f"{12 / paper:.3f}", f"≤ {ASKED:.0%}", worst <= ASKED)
