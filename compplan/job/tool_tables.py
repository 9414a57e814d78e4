"""Tool tables: CSV, TOML, and tool libraries of Fusion.

| form | recognised by | length | cutter |
|---|---|---|---|
| CSV, TOML | a head line with `number`; `[[tool]]` | length_mm | diameter_mm, teeth, corner_radius_mm .. |
| Fusion, JSON (.json, .tools) | `data`, `post-process` | assemblyGaugeLength, or gaugeLength + LB | DC NOF RE LCF SIG |

A length counts from the gauge line of the spindle to the tip.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.parsing import GREATEST, guard_parser
from compplan.io.provenance import note_input
from compplan.io.tables import read_text
from compplan.io.tomlfile import read_toml

#: Greatest length of a tool. [mm]
LONGEST_MM = 5_000.0
#: Greatest size of an unpacked library. [bytes]
LARGEST = 50_000_000
INCH = 25.4
#: Shapes of cutters without a force model.
OTHER = r"(?i)\b(chamfer|tapered|dovetail|lollipop|thread|form|radius) mill\b|v-?bit|engrav|counter ?(sink|bore)"


@dataclass(frozen=True)
class LibraryTool:
    """A tool of a table; None is unknown."""

    number: int  #: T number.
    name: str = ""  #: Name or description.
    length_mm: float | None = None  #: From the gauge line of the spindle to the tip.
    kind: str = ""  #: "mill", "drill", "other" for shapes without a force model, "" unknown.
    diameter_mm: float | None = None
    teeth: int | None = None
    corner_radius_mm: float | None = None
    flute_mm: float | None = None
    point_deg: float | None = None
    mass_kg: float | None = None
    missing: str = ""  #: What is missing for its length.
    #: Heights above the tip and diameters of the holder, from its nose up.
    holder_mm: tuple[tuple[float, float], ...] = ()
    line: int = 0  #: Line of the file, or 0.

    @property
    def call(self) -> str:
        """Its name in messages."""
        return f"T{self.number}"


def check_number(word: object, path: Path, where: int | None, what: str) -> float:
    """Return a value as a number, or refuse it."""
    try:
        value = float(str(word).replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > GREATEST:
        raise InputError(f"{what} is {str(word)[:40]!r}, expected a number up to {GREATEST:g}", file=path, where=where)
    return value


def check_whole(word: object, path: Path, line: int | None, what: str) -> int:
    """Return a value as a positive integer, or refuse it."""
    value = check_number(word, path, line, what)
    if value != int(value) or value < 0:
        raise InputError(f"{what} is {value:g}, expected a whole number", file=path, where=line)
    return int(value)


def name_kind(words: str) -> str:
    """Return the kind of a cutter from its description."""
    if re.search(OTHER, words):
        return "other"
    lower = words.lower()
    return "drill" if "drill" in lower else "mill" if "mill" in lower else ""


def round_ball(words: str, diameter: float | None, corner: float | None) -> float | None:
    """Return the corner radius of a cutter: half the diameter for a ball without one. [mm]"""
    return 0.5 * diameter if not corner and diameter and "ball" in words.lower() else corner


def read_scale(unit: str, path: Path, tool: int) -> float:
    """Return the length of the unit, or refuse a missing one. [mm]"""
    lower = unit.lower()
    if lower.startswith("milli") or lower == "mm":
        return 1.0
    if lower.startswith("inch") or lower == "in":
        return INCH
    raise InputError(f"T{tool} states no unit of its lengths; state it in the tool table", file=path)


def as_mapping(value: object) -> Mapping[str, Any]:
    """Return a value if it is a table, else an empty table."""
    return value if isinstance(value, Mapping) else {}


#: Columns beside number, name and kind.
NUMBERS = ("length_mm", "diameter_mm", "teeth", "corner_radius_mm", "flute_mm", "point_deg", "mass_kg",
           "holder_from_mm", "holder_diameter_mm")  # fmt: skip


def _is_csv(text: str) -> bool:
    """Return whether a text is a table with a column `number`."""
    head = text.lstrip("\ufeff").partition("\n")[0].lower()
    return "number" in [word.strip() for word in re.split("[,;\t]", head)]


def _read_csv(text: str, path: Path) -> Iterator[LibraryTool]:
    """Read the rows."""
    text = text.lstrip("\ufeff")
    head = text.partition("\n")[0]
    separator = max(",;\t", key=head.count)
    rows = csv.DictReader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    names = [name.strip().lower() for name in rows.fieldnames or ()]
    unknown = [name for name in names if name not in (*NUMBERS, "number", "name", "kind")]
    if unknown:
        allowed = ["number", "name", "kind", *NUMBERS]
        raise InputError(f"unknown column {unknown[0]!r}, choose from {allowed}", file=path, where=1)
    if "length_mm" not in names:
        raise InputError("missing column length_mm: from the gauge line of the spindle to the tip", file=path, where=1)
    for row in _guard_rows(rows, path):
        entry = {(key or "").strip().lower(): (value or "").strip() for key, value in row.items() if key is not None}
        if any(entry.values()) and not entry.get("number", "").startswith("#"):
            yield _make_tool(entry, path, rows.line_num)


def _guard_rows(rows: csv.DictReader[str], path: Path) -> Iterator[dict[str, str]]:
    with guard_parser(path, "is not a table", lambda: rows.line_num + 1):
        yield from rows


def _make_tool(entry: Mapping[str, str], path: Path, line: int) -> LibraryTool:
    """Return the tool of a row."""
    given = [key for key in NUMBERS if entry.get(key, "")]
    sizes: dict[str, Any] = {key: check_number(entry[key], path, line or None, key) for key in given}
    if "length_mm" not in sizes:
        raise InputError("length_mm is empty, expected a length", file=path, where=line or None)
    if "teeth" in sizes:
        sizes["teeth"] = check_whole(sizes["teeth"], path, line or None, "teeth")
    number = check_whole(entry.get("number"), path, line or None, "number")
    nose, width = sizes.pop("holder_from_mm", None), sizes.pop("holder_diameter_mm", None)
    if (nose is None) != (width is None) or (nose is not None and not 0.0 < nose < sizes["length_mm"]):
        message = "holder_from_mm (its nose above the tip, below length_mm) and holder_diameter_mm go together"
        raise InputError(message, file=path, where=line or None)
    holder = () if nose is None else ((nose, width), (sizes["length_mm"], width))
    kind = name_kind(entry.get("kind", ""))
    return LibraryTool(number, entry.get("name", ""), kind=kind, holder_mm=holder, line=line, **sizes)


def _is_toml(text: str) -> bool:
    """Return whether a text is TOML with [[tool]]."""
    return bool(re.search(r"(?m)^\[\[tool\]\]", text))


def _read_toml(text: str, path: Path) -> Iterator[LibraryTool]:
    """Read the tables."""
    for k, row in enumerate(read_toml(path)["tool"]):
        unknown = [key for key in row if key not in ("number", "name", "kind", *NUMBERS)]
        if unknown:
            allowed = ["number", "name", "kind", *NUMBERS]
            raise InputError(f"unknown key, choose from {allowed}", file=path, where=f"tool[{k}].{unknown[0]}")
        yield _make_tool({key: str(value) for key, value in row.items()}, path, 0)


#: Greatest number of tools.
MOST_TOOLS = 10_000


def _is_fusion(text: str) -> bool:
    """Return whether a text is a JSON object with `data` and `post-process`."""
    return text.lstrip("\ufeff \r\n\t").startswith("{") and '"data"' in text and "post-process" in text


def _read_fusion(text: str, path: Path) -> Iterator[LibraryTool]:
    """Read the tools."""
    with guard_parser(path, "is no tool library"):
        data = json.loads(text.lstrip("\ufeff"))
    entries = as_mapping(data).get("data")
    if not isinstance(entries, list) or len(entries) > MOST_TOOLS:
        raise InputError(f"is no tool library: expected a list data of at most {MOST_TOOLS} tools in JSON", file=path)
    for entry in entries:
        if not isinstance(entry, Mapping) or entry.get("type") in ("holder", "probe"):
            continue
        post, geometry, holder = (as_mapping(entry.get(key)) for key in ("post-process", "geometry", "holder"))
        if "number" not in post:
            continue
        number = check_whole(post["number"], path, None, "number")
        scale = read_scale(str(entry.get("unit", "")), path, number)

        def size(key: str, table: Mapping[str, Any] = geometry, factor: float = scale) -> float | None:
            return None if table.get(key) is None else factor * check_number(table[key], path, None, key)

        gauge, body = size("assemblyGaugeLength"), size("LB")
        if gauge is None:
            held = as_mapping(holder).get("gaugeLength")
            factor = read_scale(str(holder.get("unit", entry.get("unit", ""))), path, number)
            if held is not None and body is not None:
                gauge = body + factor * check_number(held, path, None, "gaugeLength")
        profile = () if body is None else _read_segments(holder, body, str(entry.get("unit", "")), path, number)
        teeth, angle = size("NOF", factor=1.0), size("SIG", factor=1.0)
        kind, diameter = str(entry.get("type", "")), size("DC")
        yield LibraryTool(
            number, str(entry.get("description", "")), gauge, name_kind(kind), diameter,
            None if teeth is None else int(teeth), round_ball(kind, diameter, size("RE")), size("LCF"), angle or None,
            missing="give it a holder in the library (assemblyGaugeLength, or gaugeLength of the holder and LB)",
            holder_mm=profile,
        )  # fmt: skip


def _read_segments(
    holder: Mapping[str, Any], nose: float, unit: str, path: Path, number: int
) -> tuple[tuple[float, float], ...]:
    """Return the profile of a holder from its segments, nose first; empty without any."""
    scale, profile, height = read_scale(str(holder.get("unit", unit)), path, number), [], nose
    for segment in map(as_mapping, holder.get("segments") or ()):
        rise, low, high = (scale * check_number(segment.get(key), path, None, key)
                           for key in ("height", "lower-diameter", "upper-diameter"))  # fmt: skip
        profile += [(height, low), (height + rise, high)]
        height += rise
    return tuple(profile)


#: Forms: words for messages, how a text is recognised, and how its tools are read; the first that recognises reads.
FORMS = (
    ("a Fusion tool library (.json, .tools)", _is_fusion, _read_fusion), ("TOML ([[tool]])", _is_toml, _read_toml),
    ("CSV (number, length_mm, ..)", _is_csv, _read_csv),
)  # fmt: skip


def read_tool_library(path: str | Path) -> tuple[LibraryTool, ...]:
    """Read a tool table in any of the forms above.

    Args:
        path: The file.

    Raises:
        InputError: With file and line, if it has none of these forms, lacks a unit, or holds an invalid tool.

    """
    path = Path(path)
    text = _read(path)
    read = next((read for _, recognise, read in FORMS if recognise(text)), None)
    if read is None:
        known = [words for words, *_ in FORMS]
        raise InputError(f"is no tool table, expected {', '.join(known[:-1])} or {known[-1]}", file=path)
    tools = tuple(read(text, path))
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
