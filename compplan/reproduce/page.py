"""Write a reproduction: reproduction.json and report.html with the redrawn figures."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.reporting import page
from compplan.reporting.provenance import describe_robot
from compplan.reproduce.paper import Reproduction, Row, count_verdicts

TONES = {"matches": "good", "close": "good", "fitted": "assumed", "inconsistent in the paper": "bad"}


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
    blocks: list[Any] = [_table(result.rows)]
    if list_assumptions(result.rows):
        blocks.append(_assumption_table(result.rows))
    sections = [page.Section("Figures of the paper beside ours", blocks, _explain_verdicts())]
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
    marks = {text: f"[{number}]" for number, text in enumerate(list_assumptions(rows), start=1)}
    body = []
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        tone = TONES.get(row.verdict, "muted" if row.verdict.startswith("cannot") else "")
        mark = page.Cell(marks.get(row.assumption, ""), "assumed")
        ours, verdict = page.Cell(_show(row.ours), "strong"), page.Cell(row.verdict, tone)
        body.append([row.quantity, row.unit, _show(row.paper), ours, ratio, verdict, mark])
    return page.DataTable(columns, body)


def list_assumptions(rows: tuple[Row, ...]) -> list[str]:
    """List the assumptions of the rows, each once, in order."""
    return list(dict.fromkeys(row.assumption for row in rows if row.assumption))


def _assumption_table(rows: tuple[Row, ...]) -> page.DataTable:
    body = [[f"[{number}]", text] for number, text in enumerate(list_assumptions(rows), start=1)]
    return page.DataTable(["", "assumed for the rows that point here"], body)


def _show(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or "–"
    text = format_number(float(value), 4)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def _explain_verdicts() -> str:
    return (
        "Matches: within 5 %; close: within 20 %; order of magnitude: within a factor of 3. Fitted: tuned to the "
        "paper's number; arithmetic: computed from the paper's own numbers; neither is evidence. Every other number of "
        "ours was computed in this run."
    )
