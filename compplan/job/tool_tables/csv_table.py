"""compplan's own tool table: CSV with a head line; lengths in mm, the length from the gauge line to the tip."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.parsing import guard_parser
from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind

words = "CSV (number, length_mm, ..)"
#: Columns beside number, name and kind.
NUMBERS = ("length_mm", "diameter_mm", "teeth", "corner_radius_mm", "flute_mm", "point_deg", "mass_kg",
           "holder_from_mm", "holder_diameter_mm")  # fmt: skip


def recognise(text: str) -> bool:
    """Return whether a text is a table with a column `number`."""
    head = text.lstrip("\ufeff").partition("\n")[0].lower()
    return "number" in [word.strip() for word in re.split("[,;\t]", head)]


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
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
            yield make_tool(entry, path, rows.line_num)


def _guard_rows(rows: csv.DictReader[str], path: Path) -> Iterator[dict[str, str]]:
    with guard_parser(path, "is not a table", lambda: rows.line_num + 1):
        yield from rows


def make_tool(entry: Mapping[str, str], path: Path, line: int) -> LibraryTool:
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
