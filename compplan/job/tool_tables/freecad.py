"""FreeCAD's tool bits (.fctb) and libraries (.fctl): JSON; each size with its unit; they say the cutter alone."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tables import read_text
from compplan.job.tool_tables.listed import (
    LibraryTool,
    as_mapping,
    check_number,
    check_whole,
    name_kind,
    read_scale,
    round_ball,
)

words = "a FreeCAD tool bit or library (.fctb, .fctl)"
#: Where a library finds its bits: beside it, and in the folder Bit beside its own.
FOLDERS = (".", "../Bit")


def recognise(text: str) -> bool:
    """Tell JSON of a tool bit, or of a library of them."""
    return text.lstrip().startswith("{") and ('"parameter"' in text or ".fctb" in text)


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the bit, or each bit of the library."""
    table = _parse(text, path)
    if "tools" not in table:
        yield _read_bit(table, None, path)
        return
    for entry in map(as_mapping, table["tools"] if isinstance(table["tools"], list) else ()):
        name = str(entry.get("path", ""))
        bit = next((file for folder in FOLDERS if (file := path.parent / folder / name).is_file()), None)
        if bit is None:
            raise InputError(f"names the bit {name!r}, which is neither beside it nor in ../Bit", file=path)
        number = check_whole(entry.get("nr"), path, None, "nr")
        yield _read_bit(_parse(read_text(bit), bit), number, bit)


def _parse(text: str, path: Path) -> Mapping[str, Any]:
    try:
        return as_mapping(json.loads(text))
    except (ValueError, RecursionError):
        raise InputError("is no tool bit: expected JSON", file=path) from None


def _read_bit(table: Mapping[str, Any], number: int | None, path: Path) -> LibraryTool:
    parameters, name = as_mapping(table.get("parameter")), str(table.get("name", path.stem))

    def said(key: str) -> float | None:
        if key not in parameters:
            return None
        value, _, stated = str(parameters[key]).strip().partition(" ")
        length = read_scale({'"': "inch"}.get(stated.strip(), stated.strip()), path, f"{key} of {name!r}")
        return length * check_number(value, path, None, key)

    shape = re.sub(r"[-_ ]|\.fcstd", "", str(table.get("shape", "")).lower().rpartition("/")[2])
    kind = "drill" if shape == "drill" else "mill" if shape in ("endmill", "ballend", "bullnose") else \
        name_kind(shape) or "other"  # fmt: skip
    flutes, tip, diameter = parameters.get("Flutes"), str(parameters.get("TipAngle", "")), said("Diameter")
    corner = said("CornerRadius") if "CornerRadius" in parameters else said("FlatRadius")
    return LibraryTool(
        number, name, None, kind, diameter,
        None if not flutes else check_whole(flutes, path, None, "Flutes"),
        round_ball(shape, diameter, corner if shape == "bullnose" else None), said("CuttingEdgeHeight"),
        check_number(re.sub(r"\s*(°|deg)$", "", tip), path, None, "TipAngle") if kind == "drill" and tip else None,
        missing="a tool bit counts no length from the spindle; write [[tool]] with position_mm and cutter_file",
    )  # fmt: skip
