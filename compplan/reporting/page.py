"""Pages: one HTML file that opens without a network, readable on paper, in light and in dark.

Every page has the same anatomy: the summary fills the first screen and the first sheet of paper (the verdict in a line,
what stops the machine, a picture, three figures, what to do next); below it, folded, stand remarks, sections made of
blocks (paragraphs, tables, charts, pictures), and what the page was made from. Paper shows what is open on the screen.
Nothing is fetched.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number
from compplan.reporting.charts import Figure, build_template
from compplan.version import VERSION

TEMPLATES = Path(__file__).parent / "templates"
#: The part of plotly.js that pages draw with; how it was made stands beside it.
PLOTLY = Path(__file__).parent / "plotly" / "plotly.min.js.gz"
#: A command in a sentence: its options with their values, words in capitals, and files.
COMMAND = r"compplan [a-z]+(?: --[a-z-]+(?: (?:[\w/.,-]*\w))?| [A-Z]{2,}[\w/.]*\b| [\w./-]+\.(?:csv|toml|nc)\b)*"
#: Significant digits of numbers in a table.
DIGITS = 3


@dataclass(frozen=True)
class Cell:
    """Hold a value with a tone: "good", "bad", "assumed", "muted", "strong" or "" (plain); `link`: a file it names."""

    value: str | float | int | None
    tone: str = ""
    link: str = ""


@dataclass(frozen=True)
class DataTable:
    """Show rows of values or cells, None as a dash; at most `scroll` rows at once, the rest by scrolling (0: all).

    A head may state unit and significant digits of its numbers: "band [mm]", "length [mm, 4]".
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    scroll: int = 0


@dataclass(frozen=True)
class Chart:
    """Show a figure with what to see in it; height: [px].

    `linked_scenes`: turning one 3D scene turns the others; `along`: the custom data of its traces begin with waypoints,
    and what is hovered there is shown in every such chart of the page.
    """

    figure: Figure
    caption: str = ""
    height: int = 380
    linked_scenes: bool = False
    along: bool = False


@dataclass(frozen=True)
class Picture:
    """Show a PNG picture, kept inside the page; `description` is for those who cannot see it (default: the caption)."""

    png: bytes
    caption: str = ""
    description: str = ""


@dataclass(frozen=True)
class Columns:
    """Set groups of blocks side by side where the page is wide enough, each with its share of the width."""

    groups: Sequence[Sequence[Block]]
    widths: Sequence[float] = ()


@dataclass(frozen=True)
class Fold:
    """Hide blocks behind a line that unfolds on a click (and is unfolded on paper)."""

    summary: str
    blocks: Sequence[Block]


Block = str | DataTable | Chart | Picture | Columns | Fold


@dataclass(frozen=True)
class Section:
    """Group blocks under a title, with a sentence that says what they show; it is folded unless it is open."""

    title: str
    blocks: Sequence[Block]
    lede: str = ""
    open: bool = False


@dataclass(frozen=True)
class Summary:
    """What the first screen of a page says."""

    verdict: str  #: The answer in one line.
    tone: str = ""  #: "good", "bad", "unsure", or "" where the page judges nothing.
    #: Three figures: the number with its unit, what it is, and a tone where it has one.
    figures: Sequence[tuple[str, ...]] = ()
    picture: Block | None = None  #: One picture.
    next: str = ""  #: What to do next, one sentence.
    stops: Sequence[str] = ()  #: What has to be settled before the machine moves, one sentence each.
    sheet: Section | None = None  #: What is shown open right below, such as the setup sheet.

    def format(self, folder: Path, files: Sequence[str], notes: Sequence[str] = ()) -> list[str]:
        """Return the lines of the terminal: verdict, figures, notes, the files written to a folder, the next step."""
        width = max((len(figure[0]) for figure in self.figures), default=0)
        figures = [f"  {figure[0]:<{width}}  {figure[1]}" for figure in self.figures]
        step = self.next.replace("OUT/", f"{folder}/")
        wrote = f"wrote {', '.join(files)} to {folder}"
        return [self.verdict, *figures, *notes, wrote, *([f"next: {step[:1].lower()}{step[1:]}"] if step else [])]


@dataclass(frozen=True)
class Provenance:
    """Say what a page was made from: facts in rows of (what, value), and sentences of what was assumed."""

    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = ()


def render_page(
    title: str, opening: Summary, sections: Sequence[Section], *, kind: str = "", answers: Sequence[str] = (),
    warning: str = "", notes: Sequence[str] = (), provenance: Provenance | None = None,
) -> str:  # fmt: skip
    """Return a page as one self-contained HTML file.

    Args:
        title: Title of the page.
        opening: The first screen.
        sections: The sections.
        kind: Small line above the title, such as "Plan".
        answers: The answer in more words, in one sentence or several, folded.
        warning: Sentence that comes first of what stops the machine, such as why a plan is infeasible.
        notes: Remarks; they are folded.
        provenance: What the page was made from.
    """
    charts: list[dict[str, Any]] = []
    picture = None if opening.picture is None else _describe(opening.picture, charts)
    sheet = [] if opening.sheet is None else [replace(opening.sheet, open=True)]
    parts = [
        {"title": section.title, "lede": section.lede, "open": section.open, "sheet": section in sheet,
         "blocks": [_describe(block, charts) for block in section.blocks]}
        for section in (*sheet, *sections)
    ]  # fmt: skip
    themes = {theme: build_template(theme) for theme in ("light", "dark")}
    payload = json.dumps({"charts": charts, "themes": themes}, separators=(",", ":"), allow_nan=False)
    script = (TEMPLATES / "page.js").read_text(encoding="utf-8")
    library = PLOTLY.read_bytes() if charts else b""
    html = _environment().get_template("page.html.j2").render(
        title=title, answers=list(answers), kind=kind, opening=opening, picture=picture, notes=list(notes),
        sections=parts, stops=[*([warning] if warning else []), *opening.stops],
        provenance=None if provenance is None else _add_origin(provenance),
        version=VERSION, css=(TEMPLATES / "page.css").read_text(encoding="utf-8"), script=script,
        plotly=base64.b64encode(library).decode("ascii"),
        payload=base64.b64encode(gzip.compress(payload.encode(), mtime=0)).decode("ascii"),
    )  # fmt: skip
    return str(html)


def join_names(names: Sequence[str]) -> str:
    """Join names as a sentence does."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _add_origin(provenance: Provenance) -> Provenance:
    """Add version, seeds and the digests of the files that were read."""
    origin = describe_origin()
    facts = [("compplan", origin["compplan"])]
    facts += [(f"seed of {name}", str(seed)) for name, seed in origin.get("seeds", {}).items()]
    facts += [
        (f"SHA-256 of {'/'.join(Path(file).parts[-2:])}", digest)
        for file, digest in origin.get("inputs_sha256", {}).items()
    ]
    return Provenance([*provenance.facts, *facts], provenance.assumptions)


@cache
def _environment() -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
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
        charts.append({**block.figure.to_dict(), "linked": block.linked_scenes, "along": block.along})
        return {"kind": "chart", "number": len(charts) - 1, "caption": block.caption, "height": block.height}
    if isinstance(block, DataTable):
        return _describe_table(block)
    if isinstance(block, Picture):
        data = base64.b64encode(block.png).decode("ascii")
        return {"kind": "picture", "data": data, "caption": block.caption, "alt": block.description or block.caption}
    if isinstance(block, Fold):
        return {"kind": "fold", "summary": block.summary, "blocks": [_describe(item, charts) for item in block.blocks]}
    widths = block.widths or [1.0] * len(block.groups)
    groups = [[_describe(item, charts) for item in group] for group in block.groups]
    return {"kind": "columns", "groups": groups, "template": " ".join(f"minmax(0, {width:g}fr)" for width in widths)}


def _describe_table(table: DataTable) -> dict[str, Any]:
    """Read title, unit and digits of each head, and write the numbers of its column with them."""
    heads: list[dict[str, Any]] = []
    for text in table.columns:
        title, _, rest = text.partition(" [")
        unit, _, digits = rest.rstrip("]").partition(", ")
        heads.append({"title": title, "unit": unit, "digits": int(digits or DIGITS)})
    rows = [
        [cell if isinstance(cell, Cell) else Cell(cell) for cell, _ in zip(row, heads, strict=True)]
        for row in table.rows
    ]  # fmt: skip
    for k, head in enumerate(heads):
        head["numeric"] = not any(isinstance(row[k].value, str) for row in rows)
    shown = [
        [{"text": _show(cell.value, head["digits"]), "tone": cell.tone, "link": cell.link}
         for cell, head in zip(row, heads, strict=True)]
        for row in rows
    ]  # fmt: skip
    scroll = table.scroll if 0 < table.scroll < len(rows) else 0
    return {"kind": "table", "heads": heads, "rows": shown, "caption": table.caption, "scroll": scroll}


def _show(value: str | float | int | None, digits: int) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    return format_number(value if isinstance(value, int) else float(value), digits)
