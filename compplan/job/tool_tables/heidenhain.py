"""Heidenhain's TOOL.T."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

from compplan.errors import InputError
from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind, read_scale

words = "Heidenhain's TOOL.T"


def recognise(text: str) -> bool:
    """Tell a text that begins with BEGIN TOOL."""
    return bool(re.match(r"(?i)\s*BEGIN\s+\S*TOOL\S*", text))


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
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
        number = check_whole(math.floor(float(cells["T"])), path, row, "T")
        scale = read_scale(stated.group(1) if stated else unit or "", path, number)
        said = {key: scale * check_number(cells[key], path, row, key) for key in ("L", "R", "R2") if cells.get(key)}
        teeth = int(check_number(cells["CUT"], path, row, "CUT")) if cells.get("CUT", "").strip() else None
        angle = check_number(cells["T-ANGLE"], path, row, "T-ANGLE") if cells.get("T-ANGLE") else None
        kind = name_kind(" ".join(cells.get(key, "") for key in ("NAME", "DOC", "TYP")))
        yield LibraryTool(
            number, cells.get("NAME", ""), said["L"], kind, 2.0 * said["R"] if said.get("R") else None, teeth or None,
            said.get("R2"), None, angle or None, line=row,
        )  # fmt: skip
