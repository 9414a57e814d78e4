"""A CAM file read a second time: which language it is, and its moves."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from compplan.second.gcode import GCode
from compplan.second.moves import CannotTellError, Reading

_PRINTER = re.compile(r"^\s*M(?:104|109|140|190)\b", re.M)


def read_moves(file: Path, options: dict[str, Any] | None = None) -> Reading:
    """Read the moves of a CAM file.

    Args:
        file: The file.
        options: The table [cam] of a job as it stands in the file.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    options = options or {}
    text = file.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff")
    return read_gcode(text, options)


def read_gcode(text: str, options: dict[str, Any]) -> Reading:
    """Read G-code."""
    reader = GCode(
        inch=options.get("unit") == "inch", centres=options.get("arc_centres") or "incremental",
        expand=options.get("cycles", "expand") == "expand", rotary=options.get("rotary"),
        printer=bool(_PRINTER.search(text)),
    )  # fmt: skip
    try:
        return reader.run(text)
    except (ValueError, OverflowError) as error:
        raise CannotTellError(f"{error}") from None
