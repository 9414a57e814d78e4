"""Results of a reproduction: rows of published and computed values, with verdicts by one rule.

The verdict on two numbers is "matches" within 5 %, "close" within 20 %, "order of magnitude" within a factor of 3. A
number tuned to the paper is "fitted"; one computed from numbers of the paper is "arithmetic"; a tendency is "trend
only"; a contradiction within the paper is "inconsistent in the paper"; a statement contradicted by the results is "not
seen". If the numbers differ by more, or none can be computed, the verdict names the missing information.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.display import Curve, Curves, draw_png
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number, shorten
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.reporting import page
from compplan.reporting.provenance import describe_robot
from compplan.robot import Array, Robot

MATCHES, CLOSE, FACTOR = 0.05, 0.20, 3.0
#: Explanation of the verdicts on the page.
EXPLANATION = (
    "Matches: within 5 %; close: within 20 %; order of magnitude: within a factor of 3. Fitted: tuned to the paper's "
    "number; arithmetic: computed from the paper's own numbers; neither is evidence. Every other number of ours was "
    "computed in this run."
)
TONES = {"matches": "good", "close": "good", "fitted": "assumed", "inconsistent in the paper": "bad"}


@dataclass(frozen=True)
class Row:
    """One quantity of a paper, published and computed."""

    quantity: str  #: Name of the quantity.
    paper: float | str | None  #: Published value or statement.
    ours: float | str | None  #: Computed value or statement, or None.
    unit: str  #: Unit of both.
    tolerance: float | None  #: Relative tolerance of the verdict, or None if no numbers are compared.
    verdict: str  #: Verdict, as listed above.
    assumption: str = ""  #: Assumptions of the computed value.

    @property
    def ratio(self) -> float | None:
        """Ratio of the computed to the published value, if both are numbers."""
        if isinstance(self.paper, int | float) and isinstance(self.ours, int | float) and self.paper:
            return self.ours / self.paper
        return None


@dataclass(frozen=True)
class Reproduction:
    """Reproduction of a paper."""

    name: str  #: Key of the paper.
    title: str  #: Title of the paper.
    citation: str  #: Authors, year, publication.
    robots: tuple[Robot, ...]  #: Robots used.
    lede: str  #: Summary of the results in a few sentences.
    rows: tuple[Row, ...]  #: Published and computed quantities.
    figures: tuple[page.Picture, ...]  #: Redrawn figures; `description` is the title.
    missing: tuple[str, ...]  #: Information missing in the paper.
    inconsistencies: tuple[str, ...] = ()  #: Contradictions within the paper.

    def row(self, quantity: str) -> Row:
        """Find a row by its quantity."""
        return next(row for row in self.rows if row.quantity == quantity)


def describe_paper(name: str) -> dict[str, Any]:
    """Read the fields of a `Reproduction` that are not computed from `papers.toml`."""
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
    """Build the row of two numbers, with a verdict by the rule of this module.

    missing: missing information, named if the numbers differ by more than a factor of three; fitted: whether `ours`
    was tuned to `paper`.
    """
    ours = shorten(ours)
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
    """Build the row of a number recomputed from other numbers of the paper: arithmetic, no evidence."""
    return Row(quantity, paper, shorten(ours), unit, None, "arithmetic", note)


def cannot(missing: str) -> str:
    """Format the verdict on a quantity that cannot be reproduced, with the missing information."""
    verb = "are" if " and " in missing else "is"
    return f"cannot be reproduced because {missing} {verb} missing"


def unavailable(quantity: str, paper: float | str, missing: str) -> Row:
    """Build the row of a quantity that cannot be computed."""
    return Row(quantity, paper, None, "", None, cannot(missing))


def statement(quantity: str, paper: str, ours: str, holds: bool, assumption: str = "") -> Row:
    """Build the row of a statement: "matches" if it holds, otherwise "order of magnitude"."""
    return Row(quantity, paper, ours, "", None, "matches" if holds else "order of magnitude", assumption)


def count_verdicts(rows: Sequence[Row]) -> dict[str, int]:
    """Count the verdicts; those that name missing information are counted together."""
    counts: dict[str, int] = {}
    for row in rows:
        key = "cannot be reproduced" if row.verdict.startswith("cannot") else row.verdict
        counts[key] = counts.get(key, 0) + 1
    return counts


def summarise_reproduction(result: Reproduction) -> dict[str, Any]:
    """Return the content of reproduction.json."""
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
        pictures = [block for figure in result.figures for block in (figure.description, figure)]
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
        result.title, _open(result), sections, kind="Reproduction", notes=[result.lede], provenance=provenance
    )


def _open(result: Reproduction) -> page.Summary:
    """Return the first screen: number of quantities within 20 % of the paper."""
    counts = count_verdicts(result.rows)
    good = counts.get("matches", 0) + counts.get("close", 0)
    told = sum(counts.values())
    figures = [(str(count), words) for words, count in list(counts.items())[:3]]
    picture = result.figures[0] if result.figures else None
    verdict = f"{good} of {told} figures of the paper come out within 20 %."
    todo = "Read which figures do not, and what the paper leaves out, below."
    return page.Summary(verdict, "good" if good > 0.5 * told else "unsure", figures, picture, todo)


def draw_figure(title: str, curves: Curves, caption: str) -> page.Picture:
    """Draw a redrawn figure from its curves."""
    return page.Picture(draw_png(curves), caption, title)


def draw_shares(title: str, caption: str, x: str, what: str, samples: Mapping[str, Array]) -> page.Picture:
    """Draw the cumulative distributions of samples; x: title of the axis, what: name of a sample, such as "poses"."""
    lines = tuple(
        Curve(f"{name}, mean {values.mean():.2f}", np.sort(values), np.linspace(0.0, 100.0, len(values)), number)
        for number, (name, values) in enumerate(samples.items())
    )
    return draw_figure(title, Curves("", x, f"share of {what} below [%]", lines), caption)


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
