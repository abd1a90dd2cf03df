"""Row 5: the diagnosis beside simpler methods on the logs of its exam."""

from __future__ import annotations

import json
import subprocess
import time

from context import Context, Unavailable
from table import Row

METHODS = {"bic": "in-sample BIC", "sparse": "sparse regression", "nearest": "nearest signature"}


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    every, path = (16 if context.quick else 4), context.work / "exam.json"
    context.say("diagnosis: the exam, some minutes")
    begun = time.monotonic()
    command = [context.program("retroflex"), "gap", "exam", "--every", str(every), "--seed", "20261", "--json", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Unavailable(done.stderr.strip()[-200:])
    document = json.loads(path.read_text())
    score, logs = document["score"], len(document["logs"])
    # every question has a fresh log too, and is answered by all methods
    seconds = (time.monotonic() - begun) / logs
    ours = _share(score["diagnosis"])
    rows = []
    for name, method in METHODS.items():
        ratio = f"{ours[0] / max(_share(score[name])[0], 1):.1f}"
        what = f"diagnosis beside {method}: single effects and pairs named exactly, false alarms; {logs} questions, {seconds:.0f} s each"
        rows.append(Row(5, what, _text(score["diagnosis"]), _text(score[name]), ratio))
    return rows


def _share(method: dict) -> tuple[int, int]:
    counts = [method[kind][side] for kind in ("single", "pair") for side in ("lab", "field")]
    return sum(c["right"] for c in counts), sum(c["of"] for c in counts)


def _text(method: dict) -> str:
    right, asked = _share(method)
    alarms = [method["alarm"][side] for side in ("lab", "field")]
    return f"{right} of {asked}, {sum(a['right'] for a in alarms)} of {sum(a['of'] for a in alarms)} false"
