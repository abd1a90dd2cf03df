"""Diagnosis of a log by the program `retroflex`."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from typing import Any, Dict, List, Optional, Sequence, TypedDict, Union, cast

from ._errors import ProgramError

_Path = Union[str, "os.PathLike[str]"]


class Gap(TypedDict):
    """How far the log deviates from models of the machine, RMS in degrees."""

    as_configured_deg: float
    recalibrated_deg: float
    """From the nominal model with its gains identified on the log."""
    explained_deg: float
    """From that with the effects of the verdict, on parts of the log that the fit has not seen."""
    noise_floor_deg: float


class Parameter(TypedDict):
    """A fitted parameter; `channel` is the number of the line from 1 on, or 0."""

    name: str
    unit: str
    value: float
    ci95: List[float]
    channel: int


class Effect(TypedDict):
    """An effect of the catalogue; `closed` is the part of the gap that it closes."""

    name: str
    stage: str
    probability: float
    gap_before_deg: float
    gap_after_deg: float
    closed: float
    closed_ci95: List[float]
    params: List[Parameter]


class Verdict(TypedDict):
    """The answer: `kind` is `none`, `effects` or `unknown`."""

    kind: str
    names: List[str]
    equivalent: List[List[str]]
    """Groups of effects that this log cannot tell apart."""


class Diagnosis(TypedDict):
    """Result of `gap diagnose` (docs/gap.md). Keys that are not listed here are there all the same."""

    schema: int
    gap: Gap
    where: Dict[str, Any]
    effects: List[Effect]
    """The whole catalogue, most probable first."""
    verdict: Verdict
    unknown: Dict[str, float]


def diagnose(
    log: Union[_Path, Sequence[_Path]],
    calib: Optional[_Path] = None,
    *,
    board: Optional[_Path] = None,
    save: Optional[_Path] = None,
    html: Optional[_Path] = None,
    seed: Optional[int] = None,
    timeout_s: Optional[float] = None,
) -> Diagnosis:
    """Locates the gap between a machine and its model, and names the effects that cause it.

    `log` is a bend log, or several logs of one unit; `calib` the calibration that it was driven with, `board` the machine if it is
    not that of the paper. `save` is where the explained model goes, `html` a page. The program is RETROFLEX_BINARY or the
    `retroflex` of PATH; it takes some seconds.

    Raises `ProgramError` with the program's own message, also if it takes longer than `timeout_s`.
    """
    named = os.environ.get("RETROFLEX_BINARY") or "retroflex"
    program = shutil.which(named)
    if program is None:
        raise ProgramError(f"there is no program {named}: install it, or name it by RETROFLEX_BINARY", 3)
    logs = [log] if isinstance(log, (str, os.PathLike)) else log
    command = [program, "gap", "diagnose", *(os.fspath(one) for one in logs), "--json", "-"]
    options = {"--calib": calib, "--board": board, "--save": save, "--html": html, "--seed": seed}
    for option, value in options.items():
        if value is not None:
            command += [option, str(value)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", errors="replace", timeout=timeout_s
        )
    except subprocess.TimeoutExpired as late:
        raise ProgramError(f"{program} has not ended within {timeout_s:g} s", 3) from late
    except OSError as problem:
        raise ProgramError(f"{program}: {problem.strerror}", 3) from problem
    if done.returncode != 0:
        raise ProgramError(done.stderr.strip() or f"{program} ended with exit code {done.returncode}", done.returncode)
    try:
        result = json.loads(done.stdout)
    except ValueError as problem:
        raise ProgramError(f"{program} wrote {done.stdout[:200]!r} in place of a diagnosis", 2) from problem
    return cast(Diagnosis, result)
