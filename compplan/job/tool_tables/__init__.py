"""Tool tables: CSV, TOML, and tool libraries of Fusion.

| form | recognised by | length | cutter |
|---|---|---|---|
| CSV, TOML | a head line with `number`; `[[tool]]` | length_mm | diameter_mm, teeth, corner_radius_mm .. |
| Fusion, JSON (.json, .tools) | `data`, `post-process` | assemblyGaugeLength, or gaugeLength + LB | DC NOF RE LCF SIG |

A length counts from the gauge line of the spindle to the tip. Each form is a module with `words`, `recognise(text)` and
`read(text, path, unit)`.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.io.plugins import Registry
from compplan.io.provenance import note_input
from compplan.io.tables import read_text
from compplan.job.tool_tables.listed import LibraryTool

#: Greatest length of a tool. [mm]
LONGEST_MM = 5_000.0
#: Greatest size of an unpacked library. [bytes]
LARGEST = 50_000_000


class ToolForm(Protocol):
    """Interface of a form; `words` is its name in messages."""

    words: str

    def recognise(self, text: str) -> bool:
        """Return whether a text has this form."""

    def read(self, text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
        """Read the tools; `unit` is for files without one."""


#: Forms by name; the first that recognises a text reads it.
FORMS: Registry[ToolForm] = Registry[ToolForm](("fusion", "toml_table", "csv_table"), __name__)


def read_tool_library(path: str | Path, unit: str | None = None) -> tuple[LibraryTool, ...]:
    """Read a tool table in any of the forms above.

    Args:
        path: The file.
        unit: "mm" or "inch" for a file without a unit.

    Raises:
        InputError: With file and line, if it has none of these forms, lacks a unit, or holds an invalid tool.

    """
    path = Path(path)
    text = _read(path)
    form = next((form for form in FORMS.values() if form.recognise(text)), None)
    if form is None:
        known = [form.words for form in FORMS.values()]
        raise InputError(f"is no tool table, expected {', '.join(known[:-1])} or {known[-1]}", file=path)
    tools = tuple(form.read(text, path, unit))
    if not tools:
        raise InputError("holds no tool", file=path)
    return tools


def _read(path: Path) -> str:
    """Return the text of a table, or of the .json in a zipped Fusion library."""
    head = path.read_bytes()[:4] if path.is_file() else b""
    if head != b"PK\x03\x04":
        return read_text(path)
    content = path.read_bytes()
    note_input(path, content)
    with guard_parser(path, "is no zipped tool library"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        found = [info for info in archive.infolist() if info.filename.lower().endswith(".json")]
        if len(found) != 1:
            raise InputError("does not hold one tools.json, expected a zipped tool library of Fusion", file=path)
        if found[0].file_size > LARGEST:
            raise InputError(f"unpacks to more than {LARGEST // 1_000_000} MB of tools", file=path)
        return archive.read(found[0]).decode("utf-8-sig")


def take_tool(tools: Sequence[LibraryTool], number: int, name: str, path: str | Path) -> LibraryTool | None:
    """Return the tool with a number or name, or None.

    Raises:
        InputError: If the table holds it twice, without a length, or with invalid sizes.

    """
    found = [tool for tool in tools if (tool.name.lower() == name.lower() if name else tool.number == number)]
    if not found:
        return None
    tool = _take_one(found, repr(name) if name else f"T{number}", path)
    if tool.length_mm is None:
        message = f"{tool.call} has no length from the gauge line: {tool.missing}"
        raise InputError(message, file=path, where=tool.line or None)
    return tool


def _take_one(found: Sequence[LibraryTool], call: str, path: str | Path) -> LibraryTool:
    """Return the only tool, with valid sizes.

    Raises:
        InputError: If there are several, or its sizes are invalid.

    """
    tool = found[0]
    if any(replace(other, line=0) != replace(tool, line=0) for other in found):
        raise InputError(f"describes {call} {len(found)} times, expected once", file=path, where=found[1].line or None)
    for key in ("length_mm", "diameter_mm", "corner_radius_mm", "flute_mm", "point_deg", "mass_kg"):
        value = getattr(tool, key)
        if value is not None and not 0.0 <= value <= LONGEST_MM:
            message = f"{key} of {call} is {value:g}, expected 0 to {LONGEST_MM:g}"
            raise InputError(message, file=path, where=tool.line or None)
    return tool
