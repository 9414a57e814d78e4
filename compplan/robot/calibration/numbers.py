"""Parsing of numbers of a calibration file, with the line in every message."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.io.tables import is_plain


def read_numbers(words: str, count: int, name: str, file: Path, line: int) -> list[float]:
    """Read finite numbers separated by commas or spaces.

    Raises:
        InputError: If they are not `count` finite numbers.
    """
    try:
        values = [float(word) for word in re.split(r"[,\s]+", words.strip())] if is_plain(words) else []
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        expected = "a finite number" if count == 1 else f"{count} finite numbers, one a joint"
        raise InputError(f"{name} is {words.strip()!r}, expected {expected}", file=file, where=line)
    return values


def keep_once(found: dict[str, list[float]], name: str, values: list[float], file: Path, line: int) -> None:
    """Store the value of a line.

    Raises:
        InputError: If an earlier line has set it.
    """
    if name in found:
        raise InputError(f"{name} is given twice, expected once", file=file, where=line)
    found[name] = values


def require_names(found: dict[str, list[float]], names: list[str], file: Path) -> None:
    """Refuse a file that lacks a name.

    Raises:
        InputError: With the missing names.
    """
    if missing := [name for name in names if name not in found]:
        raise InputError(f"has no {', '.join(missing)}, expected {', '.join(names)}", file=file)
