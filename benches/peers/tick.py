"""Row 1: the time of a control tick, and how many ticks come late, idle and under load."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from context import HERE, Context, Unavailable, answer
from table import Row

RATE_HZ = 1000
# that of retroflex's loop in service
PRIORITY = 70
PYTHON = {"imufusion": "imufusion, numpy, simple-pid", "ahrs": "ahrs (Python, Madgwick), numpy, simple-pid"}


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    tick = context.program("peer_tick")
    inputs = context.work / "inputs.csv"
    with inputs.open("wb") as file:
        subprocess.run([tick, "record"], stdout=file, check=True)
    python = [sys.executable, str(HERE / "python_tick.py"), str(inputs)]

    ticks = 100_000 if context.quick else 1_000_000
    context.say(f"tick: {ticks} ticks of retroflex and of the crate ahrs")
    ours = answer([tick, "time", "--stack", "retroflex", "--ticks", str(ticks)])
    naive = answer([tick, "time", "--stack", "ahrs", "--ticks", str(ticks)])
    fewer = ticks // 10
    times = {}
    for stack, name in PYTHON.items():
        context.say(f"tick: {fewer} ticks of {name}")
        times[stack] = answer([*python, "time", "--stack", stack, "--ticks", str(fewer)])
    fastest = min(times, key=lambda stack: times[stack]["median_ns"])

    rows = []
    for stack, theirs in times.items():
        ratio = theirs["median_ns"] / ours["median_ns"]
        asked = {"asked": "≥ 20 × at the median", "ok": ratio >= 20} if stack == fastest else {}
        what = f"a tick, beside {PYTHON[stack]} ({fewer} ticks)"
        rows.append(Row(1, what, _times(ours), _times(theirs), f"{ratio:.1f} × faster", **asked))
    ratio = naive["median_ns"] / ours["median_ns"]
    rows.append(Row(1, "a tick, beside the Rust crate ahrs with naive glue", _times(ours), _times(naive), f"{ratio:.2f} × faster"))
    return rows + _late_rows(context, tick, [*python, "late", "--stack", fastest], PYTHON[fastest])


def _times(t: dict) -> str:
    return f"{t['median_ns'] / 1e3:.2f} / {t['p999_ns'] / 1e3:.1f} / {t['worst_ns'] / 1e3:.0f} µs"


def _late_rows(context: Context, tick: str, python: list[str], name: str) -> list[Row]:
    """Late ticks at 1 kHz, idle and under load, in the ordinary class and with SCHED_FIFO."""
    rows = []
    ours = [tick, "late", "--stack", "retroflex"]
    for load in (False, True):
        state = "under load of processors and disk" if load else "idle"
        for priority in (PRIORITY, 0):
            what = f"late ticks at {RATE_HZ} Hz, {state}, {'SCHED_FIFO' if priority else 'ordinary scheduling'}, beside {name}"
            context.say(what)
            try:
                rows.append(_late(context, what, ours, python, load, priority))
            except Unavailable as why:
                rows.append(Row.skipped(1, what, str(why)))
    return rows


def _late(context: Context, what: str, ours: list[str], python: list[str], load: bool, priority: int) -> Row:
    if priority and not _may_be_real_time():
        raise Unavailable("no right to SCHED_FIFO")
    seconds = 2 if context.quick else 10
    options = ["--rate", str(RATE_HZ), "--seconds", str(seconds), "--priority", str(priority)]
    with _load(context, load):
        first, second = answer([*ours, *options]), answer([*python, *options])
    (a, b) = (r["late"] / r["ticks"] for r in (first, second))
    shares = [f"{100 * share:.3f} %, worst {r['worst_ns'] / 1e6:.2f} ms" for share, r in ((a, first), (b, second))]
    ratio = f"{a / b:.3f}" if b > 0 else ("none late" if a == 0 else "∞")
    asked = {"asked": "fewer", "ok": a < b or a == b == 0} if load else {}
    return Row(1, what, *shares, ratio, **asked)


def _may_be_real_time() -> bool:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, before, os.sched_param(0))
    return True


@contextmanager
def _load(context: Context, on: bool) -> Iterator[None]:
    """Every processor and the disk busy."""
    if not on:
        yield
        return
    if not shutil.which("stress-ng"):
        raise Unavailable("stress-ng is not installed")
    command = ["stress-ng", "--cpu", "0", "--hdd", "1", "--hdd-bytes", "256m", "--temp-path", str(context.work), "--quiet"]
    stress = subprocess.Popen(command)
    try:
        yield
    finally:
        stress.terminate()
        stress.wait()
