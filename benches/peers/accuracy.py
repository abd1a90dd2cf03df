"""Row 3: the bend error of the closed loops on the same plants, with the same schedule and the same calibration.

The plants are the paper twin and units drawn from its spread, nominal and under conditions of `retroflex evaluate --sweep`.
retroflex and the peers drive them through the same plant link.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from context import Context, Unavailable, answer, pool
from controllers import K_EPSILON, K_LAMBDA_MM
from peers import ESTIMATOR, NOMINAL, ROBUST, WITHOUT_FIELD
from table import Row, markdown
from trial import Run, together

# name in the table, condition of the sweep and its value
CONDITIONS = {
    "nominal": "",
    "line lag 0.6 s": "line_lag_s=0.6",
    "dead time 0.12 s": "dead_time_s=0.12",
    "sensor latency 0.12 s": "sensor_latency_s=0.12",
    "field of the motors 8 µT": "motor_field_ut=8",
    "stick-slip 0.5 mm": "stick_slip_mm=0.5",
    "respiration 3°": "respiration_deg=3",
}
# in the quick run
FEW = ("nominal", "line lag 0.6 s", "field of the motors 8 µT")
ASKED = {"Python stack": 0.3, "Broyden": 0.5, "MPC": 0.5}


@dataclass(frozen=True)
class Case:
    """A plant."""

    condition: str
    unit: int

    def command(self, server: str) -> tuple[str, ...]:
        """The program that simulates it."""
        setting = CONDITIONS[self.condition]
        return (server, "--unit", str(self.unit), "--noise", str(self.unit), *(["--condition", setting] if setting else []))

    def estimator(self) -> tuple[float, float, float | None]:
        """The filter of the peers, with the magnetometer unless it is disturbed."""
        return WITHOUT_FIELD if CONDITIONS[self.condition].startswith("motor_field") else ESTIMATOR


def calibration(folder: Path) -> Path:
    """The calibration that every controller has, as a file for retroflex."""
    path = folder / "cold.toml"
    path.write_text(f"[transmission]\nk_epsilon = {list(K_EPSILON)}\nk_lambda_mm = {list(K_LAMBDA_MM)}\n")
    return path


def retroflex(program: str, plant: Sequence[str], calib: Path) -> float:
    """The error of the arm `closed` of `retroflex evaluate`."""
    command = [program, "evaluate", "--plant", f"exec:{' '.join(plant)}", "--calib", str(calib), "--arms", "closed", "--json", "-"]
    return answer(command, may_fail=True)["arms"][0]["bend_rmse_deg"]


def drive(program: str, server: str, case: Case, calib: Path) -> dict[str, float]:
    """The errors of all controllers on a plant."""
    plant = case.command(server)
    makers = NOMINAL if case.condition == "nominal" else ROBUST
    runs = [Run(plant, make(), None if name == "open loop" else case.estimator()) for name, make in makers.items()]
    errors = dict(zip(makers, together(runs)))
    return errors | {"retroflex": retroflex(program, plant, calib)}


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    try:
        server, program = context.program("plant_server"), context.program("retroflex")
    except Unavailable as why:
        return [Row.skipped(3, "bend error", str(why))]
    conditions = FEW if context.quick else tuple(CONDITIONS)
    cases = [Case(c, unit) for c in conditions for unit in _units(c, context.quick)]
    calib = calibration(context.work)
    results: dict[Case, dict[str, float]] = {}
    with pool() as workers:
        jobs = {workers.submit(drive, program, server, case, calib): case for case in cases}
        for job in as_completed(jobs):
            case = jobs[job]
            results[case] = job.result()
            errors = ", ".join(f"{name} {error:.2f}°" for name, error in results[case].items())
            context.say(f"accuracy: {len(results)} of {len(cases)}, {case.condition}, unit {case.unit}: {errors}")
    table = {c: _pooled([results[case] for case in cases if case.condition == c]) for c in conditions}
    (context.work / "accuracy.json").write_text(json.dumps(table))
    (context.work / "accuracy.md").write_text(_details(table))
    return [row for condition, errors in table.items() for row in _rows(condition, errors)]


def _units(condition: str, quick: bool) -> range:
    """The twin itself, unit 0, is driven in the nominal condition."""
    return range(0 if condition == "nominal" else 1, 2 if quick else 6)


def _pooled(results: Sequence[dict[str, float]]) -> dict[str, float]:
    """Root mean square over the units."""
    return {name: math.sqrt(sum(r[name] ** 2 for r in results) / len(results)) for name in results[0]}


def _rows(condition: str, errors: dict[str, float]) -> list[Row]:
    ours = errors["retroflex"]
    rows = []
    for name in NOMINAL:
        ratio = ours / errors[name]
        asked = {"asked": f"≤ {ASKED[name]}", "ok": ratio <= ASKED[name]} if name in ASKED else {}
        rows.append(Row(3, f"bend error, {condition}, beside {name}", f"{ours:.2f}°", f"{errors[name]:.2f}°", f"{ratio:.3f}", **asked))
    return rows


def _details(table: dict[str, dict[str, float]]) -> str:
    names = [*NOMINAL, "retroflex"]
    return markdown(["bend error, ° RMS", *names], [[c, *(f"{errors[n]:.2f}" for n in names)] for c, errors in table.items()])
