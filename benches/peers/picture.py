"""The picture of the page: the bend error of every controller in every condition, as dots on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Mapping

WIDTH, LEFT, RIGHT, TOP, ROW = 882, 190, 30, 70, 34
LOW_DEG, HIGH_DEG = 0.05, 20.0
TICKS_DEG = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20)
INK, GREY, LINE = "#1c2026", "#565d66", "#d9dce1"
COLOURS = {"retroflex": "#0a66a8", "Python stack": "#c8501e", "Broyden": "#00805c", "MPC": "#a8457f", "open loop": "#8a8f98"}


def x_of(error_deg: float) -> float:
    """Place of an error on the axis; what lies outside is drawn at the end."""
    share = math.log(min(max(error_deg, LOW_DEG), HIGH_DEG) / LOW_DEG) / math.log(HIGH_DEG / LOW_DEG)
    return LEFT + share * (WIDTH - LEFT - RIGHT)


def text(x: float, y: float, words: str, ink: str = GREY, anchor: str = "start", more: str = "") -> str:
    """A line of text."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{ink}" text-anchor="{anchor}"{more}>{words}</text>'


def svg(table: Mapping[str, Mapping[str, float]]) -> str:
    """The drawing of `condition → controller → error in degrees`."""
    bottom = TOP + ROW * len(table)
    height = bottom + 40
    title = "Bend error of the held states, ° RMS, simulated"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" role="img"',
        f' aria-label="{title}" font-family="system-ui, \'Segoe UI\', \'DejaVu Sans\', sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        text(12, 20, title, INK, more=' font-size="14" font-weight="600"'),
    ]
    x = LEFT
    for name, colour in COLOURS.items():
        parts += [f'<circle cx="{x}" cy="42" r="5" fill="{colour}"/>', text(x + 10, 46, name)]
        x += 32 + 7 * len(name)
    for tick in TICKS_DEG:
        parts.append(f'<path d="M{x_of(tick):.1f} {TOP - 8}V{bottom}" stroke="{LINE}"/>')
        parts.append(text(x_of(tick), bottom + 18, f"{tick}°", anchor="middle"))
    for n, (condition, errors) in enumerate(table.items()):
        y = TOP + ROW * n + ROW / 2
        parts.append(text(LEFT - 12, y + 4, condition, INK, "end"))
        parts.append(f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="{LINE}" stroke-dasharray="2 4"/>')
        for name, colour in reversed(COLOURS.items()):
            radius = 6 if name == "retroflex" else 5
            parts.append(f'<circle cx="{x_of(errors[name]):.1f}" cy="{y:.1f}" r="{radius}" fill="{colour}" fill-opacity="0.9"/>')
    return "".join(parts) + "</svg>\n"
