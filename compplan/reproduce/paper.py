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
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.reporting import page
from compplan.reporting.provenance import describe_robot
from compplan.robot import Array, Robot

MATCHES, CLOSE, FACTOR = 0.05, 0.20, 3.0
#: How the page explains the verdicts.
EXPLANATION = (
    "Matches: within 5 %; close: within 20 %; order of magnitude: within a factor of 3. Fitted: tuned to the paper's "
    "number; arithmetic: computed from the paper's own numbers; neither is evidence. Every other number of ours was "
    "computed in this run."
)
TONES = {"matches": "good", "close": "good", "fitted": "assumed", "inconsistent in the paper": "bad"}


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

    missing: what the paper leaves out, named where ours is further away than a factor of three; fitted: whether ours
    was tuned to the paper's.
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
    """Make the row of a statement that holds or does not."""
    return Row(quantity, paper, ours, "", None, "matches" if holds else "order of magnitude", assumption)


def count_verdicts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the verdicts, those that name what is missing together."""
    counts: dict[str, int] = {}
    for row in rows:
        key = "cannot be reproduced" if row.verdict.startswith("cannot") else row.verdict
        counts[key] = counts.get(key, 0) + 1
    return counts


def summarise_reproduction(result: Reproduction) -> dict[str, Any]:
    """Make the table that reproduction.json holds."""
    return {
        "schema": 1,
        "paper": result.name,
        "title": result.title,
        "citation": result.citation,
        "robots": [robot.name for robot in result.robots],
        "summary": result.lede,
        "verdicts": count_verdicts(result.rows),
        "rows": [asdict(row) for row in result.rows],
        "missing_in_the_paper": list(result.missing),
        "inconsistent_in_the_paper": list(result.inconsistencies),
        "made_by": describe_origin(),
    }


def write_reproduction(result: Reproduction, folder: Path) -> None:
    """Write reproduction.json, report.html and the figures into a folder."""
    with replace_folder(folder, "reproduce") as part:
        write_json(part / "reproduction.json", summarise_reproduction(result))
        for number, figure in enumerate(result.figures, start=1):
            (part / f"figure_{number}.png").write_bytes(figure.png)
        write_text(part / "report.html", _render(result))


def _render(result: Reproduction) -> str:
    sections = [page.Section("Figures of the paper beside ours", [_table(result.rows)], EXPLANATION)]
    if result.figures:
        pictures = [block for figure in result.figures for block in (figure.title, _picture(figure))]
        sections.append(page.Section("Redrawn", pictures))
    gaps = [["missing", text] for text in result.missing] + [["inconsistent", text] for text in result.inconsistencies]
    if gaps:
        table = page.DataTable(["", "in the paper"], gaps)
        sections.append(page.Section("What the paper leaves out, and where it contradicts itself", [table]))
    parts = [describe_robot(robot) for robot in result.robots]
    provenance = page.Provenance(
        [("paper", result.citation), *dict.fromkeys(fact for part in parts for fact in part.facts)],
        list(dict.fromkeys(text for part in parts for text in part.assumptions)),
    )
    return page.render_page(
        result.title, _open(result), sections, kind="Reproduction", answers=[result.lede], provenance=provenance
    )


def _open(result: Reproduction) -> page.Summary:
    """Say how many figures of the paper come out alike."""
    counts = count_verdicts(result.rows)
    good = counts.get("matches", 0) + counts.get("close", 0)
    told = sum(counts.values())
    figures = [(str(count), words) for words, count in list(counts.items())[:3]]
    picture = _picture(result.figures[0]) if result.figures else None
    verdict = f"{good} of {told} figures of the paper come out within 20 %."
    todo = "Read which figures do not, and what the paper leaves out, below."
    return page.Summary(verdict, "good" if good > 0.5 * told else "unsure", figures, picture, todo)


def _picture(figure: Any) -> page.Picture:
    return page.Picture(figure.png, figure.caption, figure.title)


def _table(rows: tuple[Row, ...]) -> page.DataTable:
    columns = ["quantity", "unit", "paper", "ours", "ours / paper", "verdict", "assumed"]
    body: list[list[Any]] = []
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        tone = TONES.get(row.verdict, "muted" if row.verdict.startswith("cannot") else "")
        ours, verdict = page.Cell(_show(row.ours), "strong"), page.Cell(row.verdict, tone)
        body.append(
            [row.quantity, row.unit, _show(row.paper), ours, ratio, verdict, page.Cell(row.assumption, "assumed")]
        )
    return page.DataTable(columns, body)


def _show(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or "–"
    text = format_number(float(value), 4)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text
