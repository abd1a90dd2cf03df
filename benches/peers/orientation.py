"""Row 6: orientation filters on recordings with an optical reference, with the metric of BROAD.

VQF is its authors' package with their defaults; Madgwick and Mahony are those of the package `ahrs` with the gains that the authors
of BROAD publish as best on it. All start at the orientation of their first sample, where the program lets them.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path

import ahrs
import numpy as np
from context import Context, Unavailable, answer, pool
from table import Row, markdown
from vqf import VQF

MEAN_ASKED, EACH_ASKED = 0.85, 1.2
# from north-west-up to east-north-up
TO_ENU = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])


def measure(context: Context) -> list[Row]:
    """The rows of this comparison."""
    what = "orientation error on recordings"
    if not context.recordings:
        return [Row.skipped(6, what, "no recordings were named as arguments")]
    context.say(f"orientation: {len(context.recordings)} recordings")
    try:
        scores = answer([context.program("retroflex"), "imu", "score", "--json", "-", *map(str, context.recordings)])
    except Unavailable as why:
        return [Row.skipped(6, what, str(why))]
    ours = [row["total_deg"] for row in scores]
    # the filters that are written in Python take most of a minute for each recording
    names = ["VQF"] if context.quick else list(FILTERS)
    with pool() as workers:
        theirs = list(workers.map(_score, context.recordings, [names] * len(ours)))
    (context.work / "orientation.md").write_text(_details(context.recordings, names, ours, theirs))
    rows = []
    for name in names:
        peer = [scores[name] for scores in theirs]
        ratio = _mean(ours) / _mean(peer)
        asked = {"asked": f"≤ {MEAN_ASKED}", "ok": ratio <= MEAN_ASKED} if name == "VQF" else {}
        label = f"{what}, mean of {len(ours)}, beside {name}"
        rows.append(Row(6, label, f"{_mean(ours):.2f}°", f"{_mean(peer):.2f}°", f"{ratio:.2f}", **asked))
    worst = max(range(len(ours)), key=lambda n: ours[n] / theirs[n]["VQF"])
    ratio = ours[worst] / theirs[worst]["VQF"]
    figures = (f"{ours[worst]:.2f}°", f"{theirs[worst]['VQF']:.2f}°", f"{ratio:.2f}")
    rows.insert(1, Row(6, "the recording with the largest ratio to VQF", *figures, f"≤ {EACH_ASKED}", ratio <= EACH_ASKED))
    return rows


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


def _details(recordings: list[Path], names: list[str], ours: list[float], theirs: list[dict[str, float]]) -> str:
    header = ["recording", "retroflex", *names]
    rows = [
        [path.name.split(".")[0], f"{a:.2f}", *(f"{scores[name]:.2f}" for name in names)]
        for path, a, scores in zip(recordings, ours, theirs)
    ]
    return markdown(header, rows)


def _score(path: Path, names: list[str]) -> dict[str, float]:
    """The error of filters on a recording, degrees RMS."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        columns = file.readline().strip().split(",")
        data = np.genfromtxt(file, delimiter=",")

    def pick(*names: str) -> np.ndarray:
        return data[:, [columns.index(name) for name in names]]

    time_s = pick("time_s")[:, 0]
    period_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    samples = (period_s, pick("gyr_x", "gyr_y", "gyr_z"), pick("acc_x", "acc_y", "acc_z"), pick("mag_x", "mag_y", "mag_z"))
    reference = pick("ref_qw", "ref_qx", "ref_qy", "ref_qz")
    scored = (pick("moving")[:, 0] == 1) & np.isfinite(reference).all(axis=1)
    return {name: _rms_deg(FILTERS[name](*samples)[scored], reference[scored]) for name in names}


def _rms_deg(estimate: np.ndarray, reference: np.ndarray) -> float:
    """The whole angle between estimate and reference; neither is aligned to the other."""
    real = np.clip(np.abs((estimate * reference).sum(axis=1)), 0.0, 1.0)
    return float(np.degrees(np.sqrt(np.mean((2 * np.arccos(real)) ** 2))))


def _first(acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    """The orientation, sensor to east-north-up, that a still sample of force and field gives."""
    up = acc / np.linalg.norm(acc)
    east = np.cross(mag, up)
    east /= np.linalg.norm(east)
    matrix = np.array([east, np.cross(up, east), up])
    return ahrs.Quaternion(dcm=matrix).to_array()


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product of a quaternion with one or many."""
    w, x, y, z = a
    return b @ np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])


def _vqf(period_s: float, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    gyr, acc, mag = (np.ascontiguousarray(v) for v in (gyr, acc, mag))
    return VQF(period_s).updateBatch(gyr, acc, mag)["quat9D"]


def _madgwick(period_s: float, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    # this filter's Earth frame is north-west-up
    start = _product(TO_ENU * [1, -1, -1, -1], _first(acc[0], mag[0]))
    return _product(TO_ENU, _updates(ahrs.filters.Madgwick(Dt=period_s, gain=0.12), start, gyr, acc, mag))


def _mahony(period_s: float, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    # and this one's is east-north-up
    return _updates(ahrs.filters.Mahony(Dt=period_s, k_P=0.74, k_I=0.0012), _first(acc[0], mag[0]), gyr, acc, mag)


def _updates(filter_: object, start: np.ndarray, gyr: np.ndarray, acc: np.ndarray, mag: np.ndarray) -> np.ndarray:
    """The orientation after every sample."""
    all_ = np.empty((len(gyr), 4))
    orientation = start
    for k in range(len(gyr)):
        orientation = np.asarray(filter_.updateMARG(orientation, gyr[k], acc[k], mag[k]))
        all_[k] = orientation
    return all_


FILTERS: dict[str, Callable[..., np.ndarray]] = {
    "VQF": _vqf,
    "Madgwick": _madgwick,
    "Mahony": _mahony,
}
