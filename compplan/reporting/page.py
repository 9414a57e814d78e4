"""The frame of every page: one HTML file that opens without a network, readable on paper, in light and in dark.

Every page has the same anatomy: the opening fills the first screen and the first sheet of paper (the verdict in a line,
what stops the machine, a picture, three figures, what to do next); below it, folded, stand the same in more words,
remarks, sections made of blocks (paragraphs, tables, charts, pictures), and what the page was made from. Paper shows
what is open on the screen. No script but the page's own runs in it, and nothing is fetched.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_text
from compplan.reporting.scripts import load_plotly, pack_text, write_policy
from compplan.reporting.style import build_template, format_number
from compplan.version import VERSION

TEMPLATES = Path(__file__).parent / "templates"
#: A command in a sentence: its options with their values, words in capitals, and files.
COMMAND = r"compplan [a-z]+(?: --[a-z-]+(?: (?:[\w/.-]*\w))?| [A-Z]{2,}[\w/.]*\b| [\w./-]+\.(?:csv|toml|nc)\b)*"


@dataclass(frozen=True)
class Column:
    """Head a column: its title, the unit of its numbers, and how many significant digits they show."""

    title: str
    unit: str = ""
    digits: int = 3


@dataclass(frozen=True)
class TableCell:
    """Hold a value with a tone: "good", "bad", "assumed", "muted", "strong" or "" (plain); `link`: a file it names."""

    value: str | float | int | None
    tone: str = ""
    link: str = ""


Row = list[TableCell | str | float | int | None]


@dataclass(frozen=True)
class PageTable:
    """Show rows of values under columns with units.

    Args:
        columns: One head a column.
        rows: Values, or cells, row by row; None shows as a dash.
        caption: What the table says, in a sentence.
        scroll: Show at most so many rows at once, the rest by scrolling; 0 shows all.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[TableCell | str | float | int | None]]
    caption: str = ""
    scroll: int = 0


@dataclass(frozen=True)
class Chart:
    """Show a figure (`compplan.reporting.figure`).

    Args:
        figure: The figure; its template is replaced by the page's.
        caption: What to see in it, in a sentence.
        height: Height on the page. [px]
        linked_scenes: Whether turning one 3D scene turns the others.
        along: Whether the custom data of its traces begin with waypoints: what is hovered there is shown in every such
            chart of the page.
    """

    figure: Any
    caption: str = ""
    height: int = 380
    linked_scenes: bool = False
    along: bool = False


@dataclass(frozen=True)
class Picture:
    """Show a PNG picture, kept inside the page.

    Args:
        png: The bytes of the picture.
        caption: What to see in it.
        description: What is said to those who cannot see it; default: the caption.
    """

    png: bytes
    caption: str = ""
    description: str = ""


@dataclass(frozen=True)
class Columns:
    """Set blocks side by side where the page is wide enough, one group a column.

    Args:
        groups: The blocks of each column.
        widths: Share of the width that each column takes; equal if left out.
    """

    groups: Sequence[Sequence[Block]]
    widths: Sequence[float] = ()


@dataclass(frozen=True)
class Fold:
    """Hide blocks behind a line that unfolds on a click (and is unfolded on paper)."""

    summary: str
    blocks: Sequence[Block]


Block = str | PageTable | Chart | Picture | Columns | Fold


@dataclass(frozen=True)
class Section:
    """Group blocks under a title, with a sentence that says what they show; it is folded unless it is open."""

    title: str
    blocks: Sequence[Block]
    lede: str = ""
    open: bool = False


@dataclass(frozen=True)
class KeyFigure:
    """One of the figures of an opening: the number with its unit, and what it is."""

    value: str
    words: str
    tone: str = ""


@dataclass(frozen=True)
class Summary:
    """What the first screen of a page says.

    Args:
        verdict: The answer in one line.
        tone: "good", "bad", "unsure", or "" where the page judges nothing.
        figures: Three figures.
        picture: One picture.
        next: What to do next, one sentence.
        stops: What has to be settled before the machine moves, one sentence each.
        sheet: What is shown open right below, such as the setup sheet.
    """

    verdict: str
    tone: str = ""
    figures: Sequence[KeyFigure] = ()
    picture: Block | None = None
    next: str = ""
    stops: Sequence[str] = ()
    sheet: Section | None = None


@dataclass(frozen=True)
class Provenance:
    """Say what a page was made from: facts in rows of (what, value), and everything that was assumed.

    Args:
        facts: Rows of name and value, such as ("robot", "kuka_kr270").
        assumptions: Sentences, each an assumed number or choice.
    """

    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = field(default=())


def write_page(
    file: str | Path,
    title: str,
    lede: str | Sequence[str],
    sections: Sequence[Section],
    *,
    kind: str = "",
    opening: Summary | None = None,
    warning: str = "",
    notes: Sequence[str] = (),
    provenance: Provenance | None = None,
) -> None:
    """Write a page as one self-contained HTML file.

    Args:
        file: The file; replaced if it exists, never left half-written.
        title: Title of the page.
        lede: What the page says, in one sentence or several; several stand as a numbered list.
        sections: The sections.
        kind: Small line above the title, such as "Plan".
        opening: The first screen; left out: the first sentence of the lede and the first picture.
        warning: Sentence that comes first of what stops the machine, such as why a plan is infeasible.
        notes: Remarks; they are folded.
        provenance: What the page was made from.
    """
    html = render_page(
        title, lede, sections, kind=kind, opening=opening, warning=warning, notes=notes, provenance=provenance
    )
    write_text(file, html)


def render_page(
    title: str,
    lede: str | Sequence[str],
    sections: Sequence[Section],
    *,
    kind: str = "",
    opening: Summary | None = None,
    warning: str = "",
    notes: Sequence[str] = (),
    provenance: Provenance | None = None,
) -> str:
    """Return the HTML of a page; arguments as for `write_page`."""
    charts: list[dict[str, Any]] = []
    ledes = [lede] if isinstance(lede, str) else list(lede)
    first = opening or Summary(ledes[0].partition(". ")[0].rstrip(".") + "." if ledes else title)
    picture = None if first.picture is None else _describe(first.picture, charts)
    shown = [*([] if first.sheet is None else [replace(first.sheet, open=True)]), *sections]
    parts = [
        {"title": section.title, "lede": section.lede, "open": section.open,
         "sheet": k == 0 and first.sheet is not None, "blocks": [_describe(block, charts) for block in section.blocks]}
        for k, section in enumerate(shown)
    ]  # fmt: skip
    themes = {theme: build_template(theme) for theme in ("light", "dark")}
    payload = json.dumps({"charts": charts, "themes": themes}, separators=(",", ":"), allow_nan=False)
    script = (TEMPLATES / "page.js").read_text(encoding="utf-8")
    return str(
        _environment()
        .get_template("page.html.j2")
        .render(
            title=title,
            ledes=ledes,
            kind=kind,
            opening=first,
            picture=picture,
            stops=[*([warning] if warning else []), *first.stops],
            notes=list(notes),
            sections=parts,
            provenance=None if provenance is None else _with_origin(provenance),
            version=VERSION,
            css=(TEMPLATES / "page.css").read_text(encoding="utf-8"),
            script=script,
            policy=write_policy(script, with_charts=bool(charts)),
            plotly=load_plotly() if charts else "",
            payload=pack_text(payload),
        )
    )


def _with_origin(provenance: Provenance) -> Provenance:
    """Add commit, seeds and the digests of the files that were read."""
    origin = describe_origin()
    facts = [("compplan", f"{origin['compplan']}, commit {origin.get('commit', 'not known')}")]
    facts += [(f"seed of {name}", str(seed)) for name, seed in origin.get("seeds", {}).items()]
    facts += [(f"SHA-256 of {Path(file).name}", digest) for file, digest in origin.get("inputs_sha256", {}).items()]
    return Provenance([*provenance.facts, *facts], provenance.assumptions)


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["mark_commands"] = mark_commands
    return environment


def mark_commands(text: str) -> Any:
    """Return text as HTML in which commands stand out, a click selects one, and no line breaks within an option."""
    from markupsafe import Markup, escape

    marked = re.sub(COMMAND, r'<code class="command">\g<0></code>', str(escape(text)))
    return Markup(re.sub(r"(--[a-z-]+)", r'<span class="option">\1</span>', marked))


def _describe(block: Block, charts: list[dict[str, Any]]) -> dict[str, Any]:
    """Turn a block into what the template shows; charts go into a list of their own."""
    if isinstance(block, str):
        return {"kind": "text", "text": block}
    if isinstance(block, Chart):
        figure = json.loads(block.figure.to_json())
        figure["layout"].pop("template", None)
        kind = {"linked": block.linked_scenes, "along": block.along}
        charts.append({"data": figure["data"], "layout": figure["layout"], **kind})
        return {"kind": "chart", "number": len(charts) - 1, "caption": block.caption, "height": block.height}
    if isinstance(block, PageTable):
        return _describe_table(block)
    if isinstance(block, Picture):
        data = base64.b64encode(block.png).decode("ascii")
        return {"kind": "picture", "data": data, "caption": block.caption, "alt": block.description or block.caption}
    if isinstance(block, Fold):
        return {"kind": "fold", "summary": block.summary, "blocks": [_describe(item, charts) for item in block.blocks]}
    widths = block.widths or [1.0] * len(block.groups)
    groups = [[_describe(item, charts) for item in group] for group in block.groups]
    return {"kind": "columns", "groups": groups, "template": " ".join(f"minmax(0, {width:g}fr)" for width in widths)}


def _describe_table(table: PageTable) -> dict[str, Any]:
    rows = []
    numeric = [True] * len(table.columns)
    for row in table.rows:
        cells = []
        for index, (value, column) in enumerate(zip(row, table.columns, strict=True)):
            cell = value if isinstance(value, TableCell) else TableCell(value)
            if isinstance(cell.value, str):
                numeric[index] = False
            cells.append({"text": _show(cell.value, column.digits), "tone": cell.tone, "link": cell.link})
        rows.append(cells)
    heads = [
        {"title": column.title, "unit": column.unit, "numeric": numeric[index]}
        for index, column in enumerate(table.columns)
    ]
    scroll = table.scroll if 0 < table.scroll < len(rows) else 0
    return {"kind": "table", "heads": heads, "rows": rows, "caption": table.caption, "scroll": scroll}


def _show(value: str | float | int | None, digits: int) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    return format_number(value if isinstance(value, int) else float(value), digits)
