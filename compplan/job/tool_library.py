"""Tool tables: our CSV, and the exports of CAM systems and controls whose form is documented.

| form | told by | length | cutter |
|---|---|---|---|
| CSV | a head line with `number` | length_mm | diameter_mm, teeth, corner_radius_mm, flute_mm, point_deg, holder |
| TOML | `[[tool]]` | length_mm | the keys of the CSV |
| Fusion, JSON (.json, .tools) | `data`, `post-process` | assemblyGaugeLength, or gaugeLength + LB | DC NOF RE LCF SIG |
| HSM, XML (.xml, .hsmlib) | `tool-library` | the holder's gauge-length + body-length | diameter, corner-radius .. |
| LinuxCNC tool.tbl | lines `T1 P1 Z.. D..` | Z | D |
| Heidenhain TOOL.T | a line BEGIN TOOL | L | R, R2, CUT |

A length counts from the gauge line of the spindle to the tip.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from compplan.errors import InputError
from compplan.files.origin import note_input
from compplan.files.tables import read_text
from compplan.files.tomlfile import read_toml
from compplan.files.xmlfile import parse_xml

INCH = 25.4
#: Longest table, in tools, and longest tool that is taken for true. [mm]
MOST_TOOLS, LONGEST_MM = 10_000, 5_000.0
#: Greatest size of a zipped library, or one in UTF-16, that is read. [bytes]
LARGEST = 50_000_000
#: Columns of our CSV beside number and name.
NUMBERS = ("length_mm", "diameter_mm", "teeth", "corner_radius_mm", "flute_mm", "point_deg", "mass_kg",
           "holder_from_mm", "holder_diameter_mm")  # fmt: skip


@dataclass(frozen=True)
class LibraryTool:
    """One tool of a table; None is not said.

    Attributes:
        number: T number.
        name: Name or description.
        length_mm: From the gauge line of the spindle to the tip.
        kind: "mill", "drill", or "" for others.
        missing: What it lacks where it has no length.
        holder_mm: Heights above the tip and diameters of the holder, from its nose up.
        line: Line of the file, 0 where it has none.

    """

    number: int
    name: str = ""
    length_mm: float | None = None
    kind: str = ""
    diameter_mm: float | None = None
    teeth: int | None = None
    corner_radius_mm: float | None = None
    flute_mm: float | None = None
    point_deg: float | None = None
    mass_kg: float | None = None
    missing: str = ""
    holder_mm: tuple[tuple[float, float], ...] = ()
    line: int = 0


def read_tool_library(path: str | Path, unit: str | None = None) -> tuple[LibraryTool, ...]:
    """Read a tool table in any of the forms above; its text says which.

    Args:
        path: The file.
        unit: "mm" or "inch" for a file that does not say it.

    Raises:
        InputError: With file and line, if it is none of them, lacks a unit, or states a tool that cannot be.

    """
    path = Path(path)
    text = _read(path)
    reader = next((read for told, read in FORMS if told(text)), None)
    if reader is None:
        message = "is no tool table, expected CSV (number, length_mm, ..), TOML, a Fusion or HSM library, "
        raise InputError(f"{message}LinuxCNC's tool.tbl or Heidenhain's TOOL.T", file=path)
    tools = tuple(reader(text, path, unit))
    if not tools:
        raise InputError("holds no tool", file=path)
    return tools


def _read(path: Path) -> str:
    """Return the text of a table: the JSON in a zipped library of Fusion, XML in UTF-16 too."""
    head = path.read_bytes()[:4] if path.is_file() else b""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff") and path.stat().st_size < LARGEST:
        content = path.read_bytes()
        note_input(path, content)
        return content.decode("utf-16", errors="replace").partition("?>")[2]
    if head != b"PK\x03\x04":
        return read_text(path)
    note_input(path, path.read_bytes())
    try:
        with zipfile.ZipFile(path) as archive:
            names = [info for info in archive.infolist() if info.filename.lower().endswith(".json")]
            if len(names) != 1 or names[0].file_size > LARGEST:
                raise InputError("is a zipped library without one tools.json of common size", file=path)
            return archive.read(names[0]).decode("utf-8")
    except (OSError, zipfile.BadZipFile, UnicodeDecodeError, RuntimeError) as error:
        raise InputError(f"is no zipped tool library: {error}", file=path) from None


def take_tool(tools: Sequence[LibraryTool], number: int, name: str, path: str | Path) -> LibraryTool | None:
    """Return the tool that a file calls by its number, or by its name; None where the table has none.

    Raises:
        InputError: If the table describes it twice, without a length, or as no tool can be.

    """
    found = [tool for tool in tools if (tool.name.lower() == name.lower() if name else tool.number == number)]
    if not found:
        return None
    tool, call = found[0], repr(name) if name else f"T{number}"
    if any(replace(other, line=0) != replace(tool, line=0) for other in found):
        raise InputError(f"describes {call} {len(found)} times, expected once", file=path, where=found[1].line or None)
    if tool.length_mm is None:
        message = f"{call} has no length from the gauge line: {tool.missing}"
        raise InputError(message, file=path, where=tool.line or None)
    for key in ("length_mm", "diameter_mm", "corner_radius_mm", "flute_mm", "point_deg", "mass_kg"):
        value = getattr(tool, key)
        if value is not None and not 0.0 <= value <= LONGEST_MM:
            message = f"{key} of {call} is {value:g}, expected 0 to {LONGEST_MM:g}"
            raise InputError(message, file=path, where=tool.line or None)
    return tool


def _number(word: object, path: Path, where: int | None, what: str) -> float:
    try:
        value = float(str(word).replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{what} is {str(word)[:40]!r}, expected a number", file=path, where=where)
    return value


def _kind(words: str) -> str:
    """Tell what a cutter is by its description."""
    lower = words.lower()
    return "drill" if "drill" in lower else "mill" if "mill" in lower else ""


# ---------------------------------------------------------------------------------------------------------------- CSV


def _is_csv(text: str) -> bool:
    head = text.lstrip("\ufeff").partition("\n")[0].lower()
    return "number" in [word.strip() for word in re.split("[,;\t]", head)]


def _read_csv(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
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
    for row in rows:
        entry = {(key or "").strip().lower(): (value or "").strip() for key, value in row.items() if key is not None}
        if any(entry.values()) and not entry.get("number", "").startswith("#"):
            yield _make_tool(entry, path, rows.line_num)


def _make_tool(entry: Mapping[str, str], path: Path, line: int) -> LibraryTool:
    """Return the tool of a row of our own tables."""
    said: dict[str, Any] = {key: _number(entry[key], path, line or None, key) for key in NUMBERS if entry.get(key, "")}
    if "length_mm" not in said:
        raise InputError("length_mm is empty, expected a length", file=path, where=line or None)
    if "teeth" in said:
        said["teeth"] = _whole(said["teeth"], path, line, "teeth")
    number = _whole(_number(entry.get("number"), path, line or None, "number"), path, line, "number")
    nose, width = said.pop("holder_from_mm", None), said.pop("holder_diameter_mm", None)
    if (nose is None) != (width is None) or (nose is not None and not 0.0 < nose < said["length_mm"]):
        message = "holder_from_mm (its nose above the tip, below length_mm) and holder_diameter_mm go together"
        raise InputError(message, file=path, where=line or None)
    holder = () if nose is None else ((nose, width), (said["length_mm"], width))
    return LibraryTool(number, entry.get("name", ""), kind=_kind(entry.get("kind", "")), holder_mm=holder, line=line,
                       **said)  # fmt: skip


def _is_toml(text: str) -> bool:
    return bool(re.search(r"(?m)^\[\[tool\]\]", text))


def _read_toml(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    for k, row in enumerate(read_toml(path)["tool"]):
        unknown = [key for key in row if key not in ("number", "name", "kind", *NUMBERS)]
        if unknown:
            allowed = ["number", "name", "kind", *NUMBERS]
            raise InputError(f"unknown key, choose from {allowed}", file=path, where=f"tool[{k}].{unknown[0]}")
        yield _make_tool({key: str(value) for key, value in row.items()}, path, 0)


def _whole(value: float, path: Path, line: int | None, what: str) -> int:
    if value != int(value) or value < 0:
        raise InputError(f"{what} is {value:g}, expected a whole number", file=path, where=line)
    return int(value)


# ------------------------------------------------------------------------------------------------------------- Fusion


def _is_fusion(text: str) -> bool:
    return text.lstrip("\ufeff \r\n\t").startswith("{") and '"data"' in text and "post-process" in text


def _read_fusion(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    try:
        data = json.loads(text.lstrip("\ufeff"))
        entries = data["data"]
        assert isinstance(entries, list) and len(entries) <= MOST_TOOLS
    except (ValueError, KeyError, TypeError, AssertionError, RecursionError):
        raise InputError("is no tool library: expected a list data of tools in JSON", file=path) from None
    for entry in entries:
        if not isinstance(entry, Mapping) or entry.get("type") in ("holder", "probe"):
            continue
        post, geometry, holder = (_mapping(entry.get(key)) for key in ("post-process", "geometry", "holder"))
        if "number" not in post:
            continue
        number = _whole(_number(post["number"], path, None, "number"), path, None, "number")
        scale = _scale(str(entry.get("unit", unit or "")), path, number)

        def said(key: str, table: Mapping[str, Any] = geometry, factor: float = scale) -> float | None:
            return None if table.get(key) is None else factor * _number(table[key], path, None, key)

        gauge, body = said("assemblyGaugeLength"), said("LB")
        if gauge is None:
            held = _mapping(holder).get("gaugeLength")
            factor = _scale(str(holder.get("unit", entry.get("unit", unit or ""))), path, number)
            gauge = None if held is None or body is None else body + factor * _number(held, path, None, "gaugeLength")
        profile = () if body is None else _read_segments(holder, body, str(entry.get("unit", unit or "")), path, number)
        teeth, angle = said("NOF", factor=1.0), said("SIG", factor=1.0)
        yield LibraryTool(
            number, str(entry.get("description", "")), gauge, _kind(str(entry.get("type", ""))), said("DC"),
            None if teeth is None else int(teeth), said("RE"), said("LCF"), angle or None,
            missing="give it a holder in the library (assemblyGaugeLength, or gaugeLength of the holder and LB)",
            holder_mm=profile,
        )  # fmt: skip


def _read_segments(
    holder: Mapping[str, Any], nose: float, unit: str, path: Path, number: int
) -> tuple[tuple[float, float], ...]:
    """Return the profile of a holder whose segments stand on each other from its nose up; empty where it has none."""
    scale, profile, height = _scale(str(holder.get("unit", unit)), path, number), [], nose
    for segment in map(_mapping, holder.get("segments") or ()):
        rise, low, high = (scale * _number(segment.get(key), path, None, key)
                           for key in ("height", "lower-diameter", "upper-diameter"))  # fmt: skip
        profile += [(height, low), (height + rise, high)]
        height += rise
    return tuple(profile)


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _scale(unit: str, path: Path, number: int) -> float:
    """Return millimetres a unit; a unit that nobody states is refused."""
    lower = unit.lower()
    if lower.startswith("milli") or lower == "mm":
        return 1.0
    if lower.startswith("inch") or lower == "in":
        return INCH
    raise InputError(f"T{number} states no unit of its lengths; write [tools] unit = \"mm\" or \"inch\"", file=path)


# ---------------------------------------------------------------------------------------------------------------- HSM


def _is_hsm(text: str) -> bool:
    return "<tool-library" in text[:2000]


def _read_hsm(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    root = parse_xml(text, path)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    for tool in root.findall(".//tool"):
        nc, body, holder = (tool.find(name) for name in ("nc", "body", "holder"))
        if nc is None or nc.get("number") is None:
            continue
        number = _whole(_number(nc.get("number"), path, None, "number"), path, None, "number")
        scale = _scale(tool.get("unit", unit or ""), path, number)
        length = _attribute(body, "body-length", scale, path)
        gauge = _attribute(holder, "gauge-length", scale, path)
        whole = None if length is None or gauge is None else length + gauge
        teeth = _attribute(body, "number-of-flutes", 1.0, path)
        angle = _attribute(body, "taper-angle", 1.0, path)
        kind = _kind(tool.get("type", ""))
        yield LibraryTool(
            number, tool.get("description", tool.findtext("description", "")), whole, kind,
            _attribute(body, "diameter", scale, path), None if teeth is None else int(teeth),
            _attribute(body, "corner-radius", scale, path), _attribute(body, "flute-length", scale, path),
            angle if kind == "drill" else None,
            missing="body-length and gauge-length of its holder; export the library as JSON, or write a CSV",
        )  # fmt: skip


def _attribute(element: ElementTree.Element | None, name: str, scale: float, path: Path) -> float | None:
    value = None if element is None else element.get(name)
    return None if value is None else scale * _number(value, path, None, name)


# ------------------------------------------------------------------------------------------------------------ controls


def _is_linuxcnc(text: str) -> bool:
    lines = [line.split(";")[0].strip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    return bool(lines) and all(re.match(r"(?i)T\d+\s+P\d+\b", line) for line in lines)


def _read_linuxcnc(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    for row, line in enumerate(text.splitlines(), 1):
        words, _, remark = line.partition(";")
        if not words.strip():
            continue
        said: dict[str, float] = {}
        for letter, value in re.findall(r"([A-Za-z])\s*([^\sA-Za-z]+)", words):
            said[letter.upper()] = _number(value, path, row, letter.upper())
        number = _whole(said["T"], path, row, "T")
        scale = _scale(unit or "", path, number)
        diameter = scale * said["D"] if said.get("D") else None
        yield LibraryTool(number, remark.strip(), scale * said["Z"] if "Z" in said else None, _kind(remark),
                          diameter, missing="write Z", line=row)  # fmt: skip


def _is_heidenhain(text: str) -> bool:
    return bool(re.match(r"(?i)\s*BEGIN\s+\S*TOOL\S*", text))


def _read_heidenhain(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read TOOL.T: columns begin where their names stand in the second line."""
    lines = text.splitlines()
    stated = re.search(r"(?i)\b(MM|INCH)\b", lines[0])
    head = next((k for k, line in enumerate(lines) if re.match(r"\s*T\s+NAME\b", line)), None)
    if head is None:
        raise InputError("has no line with the names of its columns (T NAME L R ..)", file=path, where=1)
    starts = [(match.group(), match.start()) for match in re.finditer(r"\S+", lines[head])]
    for row, line in enumerate(lines[head + 1 :], head + 2):
        if re.match(r"\s*\[?END\]?", line) or not line.strip():
            continue
        ends = [start for _, start in starts[1:]] + [None]
        cells = {name: line[start:end].strip() for (name, start), end in zip(starts, ends, strict=True)}
        if not re.fullmatch(r"\d+(\.\d+)?", cells["T"]) or not cells.get("L"):
            continue
        number = _whole(math.floor(float(cells["T"])), path, row, "T")
        scale = _scale(stated.group(1) if stated else unit or "", path, number)
        said = {key: scale * _number(cells[key], path, row, key) for key in ("L", "R", "R2") if cells.get(key)}
        teeth = int(_number(cells["CUT"], path, row, "CUT")) if cells.get("CUT", "").strip() else None
        angle = _number(cells["T-ANGLE"], path, row, "T-ANGLE") if cells.get("T-ANGLE") else None
        kind = _kind(f"{cells.get('NAME', '')} {cells.get('DOC', '')} {'drill' if cells.get('TYP') == 'DRILL' else ''}")
        yield LibraryTool(
            number, cells.get("NAME", ""), said["L"], kind, 2.0 * said["R"] if said.get("R") else None, teeth or None,
            said.get("R2"), None, angle or None, line=row,
        )  # fmt: skip


#: Forms of tool tables: what tells one, and its reader.
FORMS: tuple[tuple[Callable[[str], bool], Callable[[str, Path, str | None], Iterator[LibraryTool]]], ...] = (
    (_is_fusion, _read_fusion), (_is_hsm, _read_hsm), (_is_heidenhain, _read_heidenhain),
    (_is_linuxcnc, _read_linuxcnc), (_is_toml, _read_toml), (_is_csv, _read_csv),
)  # fmt: skip
