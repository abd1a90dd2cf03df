"""Row 2: the lateness of step pulses beside that of `cyclictest` at the same priority, in turns."""

from __future__ import annotations

import re
import shutil
import statistics
import subprocess

from context import Context, Unavailable
from table import Row

PRIORITY, RATE_HZ = 80, 4000
ASKED = 1.5


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    what = "lateness of a step pulse, p99.9, beside a wake-up of cyclictest"
    if not shutil.which("cyclictest"):
        return [Row.skipped(2, what, "cyclictest is not installed (Debian package rt-tests)")]
    turns, seconds = (2, 3) if context.quick else (5, 10)
    pairs = []
    for turn in range(turns):
        context.say(f"pulses: turn {turn + 1} of {turns}")
        try:
            pairs.append((_ours(context, seconds), _theirs(seconds)))
        except Unavailable as why:
            return [Row.skipped(2, what, str(why))]
    ratio = statistics.median(a / b for a, b in pairs)
    ours, theirs = (statistics.median(column) for column in zip(*pairs))
    every = ", ".join(f"{a / b:.2f}" for a, b in pairs)
    figures = (f"{ours:.1f} µs", f"{theirs:.0f} µs", f"{ratio:.2f} ({every})")
    return [Row(2, f"{what}, median of {turns} turns", *figures, f"≤ {ASKED}", ratio <= ASKED)]


def _ours(context: Context, seconds: int) -> float:
    """p99.9 of the lateness of steps, µs."""
    command = [context.program("retroflex"), "bench", "rt", "--rate", str(RATE_HZ), "--seconds", str(seconds)]
    text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    if "SCHED_FIFO: granted" not in text:
        raise Unavailable("no right to SCHED_FIFO")
    columns = _cells(text, "µs")
    return float(_cells(text, "step lateness")[columns.index("99.9 %")])


def _cells(text: str, first: str) -> list[str]:
    """The cells of the line of a table that begins with `first`."""
    for line in text.splitlines():
        cells = [cell.strip() for cell in re.split(r"[│┆|]", line.strip().strip("│|"))]
        if cells[0] == first:
            return cells
    raise Unavailable(f"`retroflex bench rt` prints no line `{first}`")


def _theirs(seconds: int) -> float:
    """p99.9 of cyclictest's latency, µs, from its histogram."""
    command = ["cyclictest", "-q", "-m", "-t1", f"-p{PRIORITY}", f"-i{1_000_000 // RATE_HZ}", f"-D{seconds}s", "-h20000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    counts = {int(us): int(n) for us, n in re.findall(r"^(\d{6}) (\d+)", done.stdout, re.MULTILINE)}
    total = sum(counts.values())
    if done.returncode or not total:
        raise Unavailable(f"cyclictest did not complete: {done.stderr.strip()[-200:]}")
    below = 0
    for us, n in sorted(counts.items()):
        below += n
        if below >= 0.999 * total:
            return max(float(us), 1.0)
    raise Unavailable("the histogram of cyclictest is not complete")
