"""Tool tables: CSV, TOML, and tool libraries of Fusion.

| form | length | cutter |
|---|---|---|
| CSV (a head line with `number`), .toml (`[[tool]]`) | length_mm | diameter_mm, teeth, corner_radius_mm .. |
| Fusion: .json, .tools | assemblyGaugeLength, or gaugeLength + LB | DC NOF RE LCF SIG |

A length counts from the gauge line of the spindle to the tip.
"""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field

from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.io.provenance import note_input
from compplan.io.tables import read_text
from compplan.io.tomlfile import StrictTable, check_table, read_toml

#: Greatest size of an unpacked library, and number of its tools. [bytes, 1]
LARGEST, MOST_TOOLS = 50_000_000, 10_000
#: Shapes of cutters without a force model.
OTHER = r"(?i)\b(chamfer|tapered|dovetail|lollipop|thread|form|radius) mill\b|v-?bit|engrav|counter ?(sink|bore)"
#: Lengths of the units of a Fusion library. [mm]
UNITS = {"millimeters": 1.0, "mm": 1.0, "inches": 25.4, "in": 25.4}
#: Keys of the cutter, and those of a Fusion library.
CUTTER = {"diameter_mm": "DC", "corner_radius_mm": "RE", "flute_mm": "LCF"}


def _name_kind(words: str) -> str:
    """Return the kind of a cutter from its description."""
    if re.search(OTHER, words):
        return "other"
    lower = words.lower()
    return "drill" if "drill" in lower else "mill" if "mill" in lower else ""


Size = Annotated[float, Field(ge=0.0, le=5000.0)]


class LibraryTool(StrictTable):
    """A tool of a table; None is unknown.

    kind: "mill", "drill", "other" for shapes without a force model, or "".
    """

    model_config = ConfigDict(strict=False)
    number: int = Field(ge=0)
    name: str = ""
    length_mm: Size | None = None
    kind: Annotated[str, AfterValidator(_name_kind)] = ""
    diameter_mm: Size | None = None
    teeth: int | None = Field(default=None, ge=0)
    corner_radius_mm: Size | None = None
    flute_mm: Size | None = None
    point_deg: Size | None = None
    mass_kg: Size | None = None


def _read_csv(text: str, path: Path) -> Iterator[LibraryTool]:
    head = text.partition("\n")[0].lower()
    separator = max(",;\t", key=head.count)
    if "number" not in [word.strip() for word in head.split(separator)]:
        raise InputError(f"is not a tool table, expected {FORMS}", file=path)
    rows = csv.DictReader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    with guard_parser(path, "is not a table", lambda: rows.line_num + 1):
        for row in rows:
            stated = {key: value.strip() for key, value in row.items() if key and value}
            entry = {key.strip().lower(): value for key, value in stated.items() if value}
            if not entry or entry.get("number", "").startswith("#"):
                continue
            texts = {key: entry.pop(key) for key in ("name", "kind") if key in entry}
            numbers = {key: value.replace(",", ".") for key, value in entry.items()}
            try:
                yield check_table(LibraryTool, {**numbers, **texts}, file=path)
            except InputError as error:
                raise InputError(f"{error.where} {error.message}", file=path, where=rows.line_num) from None


def _read_toml(text: str, path: Path) -> Iterator[LibraryTool]:
    for k, row in enumerate(read_toml(path).get("tool", [])):
        yield check_table(LibraryTool, row, file=path, key=f"tool[{k}]")


def _read_fusion(text: str, path: Path) -> Iterator[LibraryTool]:
    with guard_parser(path, "is not a tool library"):
        entries = json.loads(text)["data"]
        if len(entries) > MOST_TOOLS:
            raise InputError(f"has {len(entries)} tools, at most {MOST_TOOLS} are read", file=path)
        for entry in entries:
            if entry.get("type") not in ("holder", "probe") and "number" in entry.get("post-process", {}):
                yield check_table(LibraryTool, _convert_fusion(entry, path), file=path, key="data")


def _convert_fusion(entry: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return a tool of a Fusion library in keys of the other tables."""
    number, kind, geometry = entry["post-process"]["number"], entry.get("type", ""), entry.get("geometry", {})
    holder = entry.get("holder", {})
    units = [str(unit).lower() for unit in (entry.get("unit", ""), holder.get("unit", entry.get("unit", "")))]
    if not set(units) <= set(UNITS):
        raise InputError(f"T{number} states no unit of its lengths; state it in the tool table", file=path)
    scale, held = (UNITS[unit] for unit in units)
    sizes = {key: scale * float(geometry[code]) for key, code in CUTTER.items() if geometry.get(code) is not None}
    if "ball" in kind.lower() and not sizes.get("corner_radius_mm") and "diameter_mm" in sizes:
        sizes["corner_radius_mm"] = 0.5 * sizes["diameter_mm"]
    gauge, body, hold = geometry.get("assemblyGaugeLength"), geometry.get("LB"), holder.get("gaugeLength")
    if gauge is not None:
        sizes["length_mm"] = scale * float(gauge)
    elif body is not None and hold is not None:
        sizes["length_mm"] = scale * float(body) + held * float(hold)
    more = {"name": entry.get("description", ""), "kind": kind, "teeth": geometry.get("NOF")}
    return {"number": number, **sizes, **more, "point_deg": geometry.get("SIG") or None}


#: Description of the forms, and reader by file suffix; files of other suffixes are read as CSV.
FORMS = "a Fusion tool library (.json, .tools), TOML ([[tool]]) or CSV (number, length_mm, ..)"
READERS = {".json": _read_fusion, ".tools": _read_fusion, ".toml": _read_toml}


def read_tool_library(path: str | Path) -> tuple[LibraryTool, ...]:
    """Read a tool table in any of the forms above.

    Raises:
        InputError: With file and line, if it has none of these forms, lacks a unit, or holds an invalid tool.
    """
    path = Path(path)
    text = _read(path).lstrip("\ufeff")
    tools = tuple(READERS.get(path.suffix.lower(), _read_csv)(text, path))
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
    with guard_parser(path, "is not a zipped tool library"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        found = [info for info in archive.infolist() if info.filename.lower().endswith(".json")]
        if len(found) != 1:
            raise InputError("does not hold one tools.json, expected a zipped tool library of Fusion", file=path)
        if found[0].file_size > LARGEST:
            raise InputError(f"unpacks to more than {LARGEST // 1_000_000} MB of tools", file=path)
        return archive.read(found[0]).decode("utf-8-sig")


def take_tool(tools: Sequence[LibraryTool], number: int, name: str, path: str | Path) -> LibraryTool | None:
    """Return the tool with a number or name, or None.

    Raises:
        InputError: If the table holds different ones, or states no length.
    """
    found = [tool for tool in tools if (tool.name.lower() == name.lower() if name else tool.number == number)]
    call = repr(name) if name else f"T{number}"
    if any(tool != found[0] for tool in found):
        raise InputError(f"describes {call} {len(found)} times, expected once", file=path)
    if found and found[0].length_mm is None:
        message = "has no length from the gauge line; write length_mm, in Fusion assemblyGaugeLength, or gaugeLength"
        raise InputError(f"{call} {message} of the holder and LB", file=path)
    return found[0] if found else None
