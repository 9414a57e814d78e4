"""compplan's own tool table as TOML: `[[tool]]` with the columns of the CSV as keys."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from compplan.errors import InputError
from compplan.io.tomlfile import read_toml
from compplan.job.tool_tables.csv_table import NUMBERS, make_tool
from compplan.job.tool_tables.listed import LibraryTool

words = "TOML ([[tool]])"


def recognise(text: str) -> bool:
    """Return whether a text is TOML with [[tool]]."""
    return bool(re.search(r"(?m)^\[\[tool\]\]", text))


def read(text: str, path: Path, unit: str | None) -> Iterator[LibraryTool]:
    """Read the tables."""
    for k, row in enumerate(read_toml(path)["tool"]):
        unknown = [key for key in row if key not in ("number", "name", "kind", *NUMBERS)]
        if unknown:
            allowed = ["number", "name", "kind", *NUMBERS]
            raise InputError(f"unknown key, choose from {allowed}", file=path, where=f"tool[{k}].{unknown[0]}")
        yield make_tool({key: str(value) for key, value in row.items()}, path, 0)
