"""What a reproduction says: rows of a paper's figure beside ours, and a verdict by one rule for all.

A verdict compares numbers: within 5 % it matches, within 20 % it is close, within a factor of 3 it is the order of
magnitude. A number tuned to the paper is fitted; one computed from the paper's own numbers is arithmetic; a tendency is
trend only; a contradiction of the paper is inconsistent in the paper; a statement that ours contradicts is not seen.
Where our number differs by more, or there is none, the missing information is named.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from compplan.robot import Array, Robot

MATCHES, CLOSE, FACTOR = 0.05, 0.20, 3.0


@dataclass(frozen=True)
class Row:
    """One figure of a paper beside ours."""

    quantity: str  #: What it is.
    paper: float | str | None  #: What the paper states.
    ours: float | str | None  #: What this run computed, or None.
    unit: str  #: Unit of both.
    tolerance: float | None  #: Relative band that the verdict refers to, or None where no numbers are compared.
    verdict: str  #: One of the words above.
    assumption: str = ""  #: What had to be assumed for ours.

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's, where both are numbers."""
        if isinstance(self.paper, int | float) and isinstance(self.ours, int | float) and self.paper:
            return self.ours / self.paper
        return None


@dataclass(frozen=True)
class PaperFigure:
    """A redrawn figure: title, PNG and what to see in it."""

    title: str
    png: bytes
    caption: str


@dataclass(frozen=True)
class Reproduction:
    """A paper reproduced."""

    name: str  #: Key of the paper.
    title: str  #: Title of the paper.
    citation: str  #: Authors, year, where.
    robots: tuple[Robot, ...]  #: The robots that were used.
    lede: str  #: What came out, in a few sentences.
    rows: tuple[Row, ...]  #: Figures of the paper beside ours.
    figures: tuple[PaperFigure, ...]  #: Redrawn figures.
    missing: tuple[str, ...]  #: What the paper leaves out.
    inconsistencies: tuple[str, ...] = ()  #: Where the paper contradicts itself.
    samples: dict[str, Array] = field(default_factory=dict)  #: Numbers behind the rows, for tests and notebooks.

    def row(self, quantity: str) -> Row:
        """Find a row by its quantity."""
        return next(row for row in self.rows if row.quantity == quantity)


def describe_paper(name: str) -> dict[str, Any]:
    """Return what `papers.toml` says of a paper: the fields of a `Reproduction` that no run computes."""
    told = tomllib.loads(Path(__file__).with_name("papers.toml").read_text(encoding="utf-8"))[name]
    return {"name": name} | {key: tuple(value) if isinstance(value, list) else value for key, value in told.items()}


def compare(
    quantity: str,
    paper: float,
    ours: float,
    unit: str,
    assumption: str = "",
    *,
    missing: str = "something that decides it",
    fitted: bool = False,
) -> Row:
    """Compare two numbers by the rule of this module.

    Args:
        quantity: What is compared.
        paper: The paper's number.
        ours: Ours.
        unit: Unit of both.
        assumption: What had to be assumed.
        missing: What the paper leaves out, named where ours is further away than a factor of three.
        fitted: Whether ours was tuned to the paper's.
    """
    ours = float(f"{ours:.6g}")
    if fitted:
        return Row(quantity, paper, ours, unit, None, "fitted", assumption)
    ratio = ours / paper if paper else math.inf
    if abs(ratio - 1) <= MATCHES:
        return Row(quantity, paper, ours, unit, MATCHES, "matches", assumption)
    if abs(ratio - 1) <= CLOSE:
        return Row(quantity, paper, ours, unit, CLOSE, "close", assumption)
    if ratio > 0 and 1 / FACTOR <= ratio <= FACTOR:
        return Row(quantity, paper, ours, unit, FACTOR - 1, "order of magnitude", assumption)
    return Row(quantity, paper, ours, unit, None, cannot(missing), assumption)


def recompute(quantity: str, paper: float, ours: float, unit: str, note: str) -> Row:
    """Compare a number of the paper with the same computed from its own numbers: arithmetic, no evidence."""
    return Row(quantity, paper, float(f"{ours:.6g}"), unit, None, "arithmetic", note)


def cannot(missing: str) -> str:
    """Word the verdict of a figure that cannot be had, and why."""
    verb = "are" if " and " in missing else "is"
    return f"cannot be reproduced because {missing} {verb} missing"


def unavailable(quantity: str, paper: float | str, missing: str) -> Row:
    """Make the row of a figure that cannot be computed at all."""
    return Row(quantity, paper, None, "", None, cannot(missing))


def statement(quantity: str, paper: str, ours: str, holds: bool, assumption: str = "") -> Row:
    """Make the row of a statement that holds or does not.

    Args:
        quantity: What it is about.
        paper: What the paper says.
        ours: What this run found.
        holds: Whether both hold the same quantity.
        assumption: What had to be assumed.
    """
    return Row(quantity, paper, ours, "", None, "matches" if holds else "order of magnitude", assumption)


def count_verdicts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the verdicts, those that name what is missing together."""
    counts: dict[str, int] = {}
    for row in rows:
        key = "cannot be reproduced" if row.verdict.startswith("cannot") else row.verdict
        counts[key] = counts.get(key, 0) + 1
    return counts
