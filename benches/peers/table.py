"""Rows of the table of peers, as Markdown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One comparison. `ok` is None where nothing is asked, or where nothing could be measured."""

    row: int
    what: str
    ours: str
    peer: str
    ratio: str = ""
    asked: str = ""
    ok: bool | None = None

    @classmethod
    def skipped(cls, row: int, what: str, why: str) -> Row:
        """A row that could not run."""
        return cls(row, what, "–", "–", "–", f"SKIPPED: {why}")

    def verdict(self) -> str:
        """What the last column says."""
        return {None: "", True: "met", False: "**missed**"}[self.ok]


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table whose first column is text and whose others are figures."""
    header = list(header)
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
