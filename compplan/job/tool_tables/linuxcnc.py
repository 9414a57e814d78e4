"""LinuxCNC's tool.tbl: lines `T1 P1 Z.. D.. ;remark`, without a unit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from compplan.job.tool_tables.listed import LibraryTool, check_number, check_whole, name_kind, read_scale

words = "LinuxCNC's tool.tbl"


def recognise(text: str) -> bool:
    """Tell a text all of whose lines begin with T and P."""
    lines = [line.split(";")[0].strip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    return bool(lines) and all(re.match(r"(?i)T\d+\s+P\d+\b", line) for line in lines)


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the tools."""
    for row, line in enumerate(text.splitlines(), 1):
        words, _, remark = line.partition(";")
        if not words.strip():
            continue
        said: dict[str, float] = {}
        for letter, value in re.findall(r"([A-Za-z])\s*([^\sA-Za-z]+)", words):
            said[letter.upper()] = check_number(value, path, row, letter.upper())
        number = check_whole(said["T"], path, row, "T")
        scale = read_scale(unit or "", path, number)
        diameter = scale * said["D"] if said.get("D") else None
        yield LibraryTool(number, remark.strip(), scale * said["Z"] if "Z" in said else None, name_kind(remark),
                          diameter, missing="write Z", line=row)  # fmt: skip
