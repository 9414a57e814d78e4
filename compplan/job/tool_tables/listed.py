"""A tool of a tool table, and helpers of the readers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.parsing import GREATEST

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
    raise InputError(f'T{tool} states no unit of its lengths; write [tools] unit = "mm" or "inch"', file=path)


def as_mapping(value: object) -> Mapping[str, Any]:
    """Return a value if it is a table, else an empty table."""
    return value if isinstance(value, Mapping) else {}
