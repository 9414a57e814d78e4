"""Pages: one self-contained HTML file that opens without a network, for screen (light, dark) and print.

The summary fills the first screen and the first printed sheet: verdict, points to resolve before the machine moves, a
picture, three figures, the next step. Below it, folded, are remarks, sections of blocks (paragraphs, tables, charts,
pictures) and the provenance. Print shows what is open on the screen.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number
from compplan.reporting.charts import Figure, build_template
from compplan.version import VERSION

TEMPLATES = Path(__file__).parent / "templates"
#: Reduced build of plotly.js; the build script is in the same folder.
PLOTLY = Path(__file__).parent / "plotly" / "plotly.min.js.gz"
#: Pattern of a command in a sentence: options with values, words in capitals, and files.
COMMAND = r"compplan [a-z]+(?: --[a-z-]+(?: (?:[\w/.,-]*\w))?| [A-Z]{2,}[\w/.]*\b| [\w./-]+\.(?:csv|toml|nc)\b)*"
#: Files of a result that are not programs: suffixes, tables named on the terminal, and other tables.
NO_PROGRAM = {".html", ".json", ".png", ".npz", ".glb", ".bin", ".toml", ".urdf"}
TABLES = {"campaign.csv", "forces.csv", "instrument.toml", "joints.csv", "robot"}
NO_PROGRAM_NAMES = {*TABLES, "deviation.csv"}
#: Significant digits of numbers in a table.
DIGITS = 3


@dataclass(frozen=True)
class Cell:
    """Hold a value with a tone: "good", "bad", "assumed", "muted", "strong" or "" (plain); `link`: a file."""

    value: str | float | int | None
    tone: str = ""
    link: str = ""


@dataclass(frozen=True)
class DataTable:
    """Table of values or cells, None as a dash; `scroll`: greatest number of rows visible at once (0: all).

    A column head may have unit and significant digits of its numbers: "band [mm]", "length [mm, 4]".
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    scroll: int = 0


@dataclass(frozen=True)
class Chart:
    """Figure with a caption; height: [px].

    `linked_scenes`: 3D scenes turn together; `along`: the custom data of its traces begin with the waypoint, and the
    hovered waypoint is shown in every such chart of the page.
    """

    figure: Figure
    caption: str = ""
    height: int = 380
    linked_scenes: bool = False
    along: bool = False


@dataclass(frozen=True)
class Picture:
    """PNG picture, embedded in the page; `description`: alternative text (default: the caption)."""

    png: bytes
    caption: str = ""
    description: str = ""


@dataclass(frozen=True)
class Columns:
    """Groups of blocks side by side if the page is wide enough."""

    groups: Sequence[Sequence[Block]]


@dataclass(frozen=True)
class Fold:
    """Blocks folded behind a line that unfolds on a click; printed only if unfolded."""

    summary: str
    blocks: Sequence[Block]


Block = str | DataTable | Chart | Picture | Columns | Fold


@dataclass(frozen=True)
class Section:
    """Blocks under a title, with an introductory sentence; folded unless `open`."""

    title: str
    blocks: Sequence[Block]
    lede: str = ""
    open: bool = False


@dataclass(frozen=True)
class Summary:
    """Content of the first screen of a page."""

    verdict: str  #: The answer in one line.
    tone: str = ""  #: "good", "bad", "unsure", or "" for a page without verdict.
    #: Three figures: number with unit, description, and optional tone.
    figures: Sequence[tuple[str, ...]] = ()
    picture: Block | None = None  #: One picture.
    next: str = ""  #: Next step, one sentence.
    stops: Sequence[str] = ()  #: Points to resolve before the machine moves, one sentence each.
    sheet: Section | None = None  #: Section shown open directly below, such as the setup sheet.

    def format(self, folder: Path, files: Iterable[str | Path], notes: Sequence[str] = ()) -> list[str]:
        """Return the lines of the terminal: verdict, figures, points to resolve, notes, written files, next step."""
        width = max((len(figure[0]) for figure in self.figures), default=0)
        figures = [f"  {figure[0]:<{width}}  {figure[1]}" for figure in self.figures]
        stops = [f"before the machine moves: {stop}" for stop in self.stops]
        step = self.next.replace("OUT/", f"{folder}/")
        next_step = [f"next: {step[:1].lower()}{step[1:].rstrip('.')}"] if step else []
        return [self.verdict, *figures, *stops, *notes, format_files(folder, files), *next_step]


def is_program(file: Path) -> bool:
    """Return whether a file is a robot program, by its name relative to the folder of results."""
    return file.parts[0] != "robot" and file.suffix not in NO_PROGRAM and file.name not in NO_PROGRAM_NAMES


def format_files(folder: Path, files: Iterable[str | Path], notes: str = "", status: str = "solved") -> str:
    """Return the line of the written files: results, robot folder, number of programs; `notes` follows the report."""
    inside = [file.relative_to(folder) if file.is_relative_to(folder) else file for file in map(Path, files)]
    names = dict.fromkeys(f"{file.parts[0]}{'/' * (file.parts[0] == 'robot')}" for file in inside)
    shown = [name for name in names if Path(name).suffix in (".html", ".json") or name.rstrip("/") in TABLES]
    shown.sort(key=lambda name: name != "report.html")
    count = sum(is_program(file) for file in inside)
    shown = [f"{name}{notes}" if name == "report.html" else name for name in shown]
    shown += [f"{count} program file{'s' * (count > 1)}"] if count else []
    unsafe = "" if status == "solved" or not count else f"; the programs are marked {status}: do not load them"
    return f"wrote {', '.join(shown)} to {folder}{unsafe}"


@dataclass(frozen=True)
class Provenance:
    """Origin of a page: facts as rows of (name, value), and assumptions as sentences."""

    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = ()


def render_page(
    title: str, opening: Summary, sections: Sequence[Section], *, kind: str = "", notes: Sequence[str] = (),
    provenance: Provenance | None = None,
) -> str:  # fmt: skip
    """Return a page as one self-contained HTML file.

    Args:
        title: Title of the page.
        opening: The first screen.
        sections: The sections.
        kind: Small line above the title, such as "Plan".
        notes: Remarks; they are folded.
        provenance: Origin of the page.
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
        title=title, kind=kind, opening=opening, picture=picture, notes=list(notes),
        sections=parts, stops=opening.stops, provenance=None if provenance is None else _add_origin(provenance),
        version=VERSION, css=(TEMPLATES / "page.css").read_text(encoding="utf-8"), script=script,
        plotly=base64.b64encode(library).decode("ascii"),
        payload=base64.b64encode(gzip.compress(payload.encode(), mtime=0)).decode("ascii"),
    )  # fmt: skip
    return str(html)


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
    """Return text as HTML with commands marked and selectable by a click, and without line breaks within options."""
    from markupsafe import Markup, escape

    marked = re.sub(COMMAND, r'<code class="command">\g<0></code>', str(escape(text)))
    return Markup(re.sub(r"(--[a-z-]+)", r'<span class="option">\1</span>', marked))


def _describe(block: Block, charts: list[dict[str, Any]]) -> dict[str, Any]:
    """Convert a block to the data of the template; charts are appended to `charts`."""
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
    groups = [[_describe(item, charts) for item in group] for group in block.groups]
    return {"kind": "columns", "groups": groups, "template": " ".join(["minmax(0, 1fr)"] * len(groups))}


def _describe_table(table: DataTable) -> dict[str, Any]:
    """Parse title, unit and digits of each column head, and format the numbers of its column."""
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
