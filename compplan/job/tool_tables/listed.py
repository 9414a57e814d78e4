"""One tool of a tool table, and the words and numbers that its readers share."""

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
#: Shapes of cutters that no force model here has.
OTHER = r"(?i)\b(chamfer|tapered|dovetail|lollipop|thread|form|radius) mill\b|v-?bit|engrav|counter ?(sink|bore)"


@dataclass(frozen=True)
class LibraryTool:
    """One tool of a table; None is not said.

    Attributes:
        number: T number.
        name: Name or description.
        length_mm: From the gauge line of the spindle to the tip.
        kind: "mill", "drill", "other" for shapes that no force model here has, "" where nothing says it.
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

    @property
    def call(self) -> str:
        """What a message calls it."""
        return f"T{self.number}"


def check_number(word: object, path: Path, where: int | None, what: str) -> float:
    """Return a number that is one."""
    try:
        value = float(str(word).replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > GREATEST:
        raise InputError(f"{what} is {str(word)[:40]!r}, expected a number up to {GREATEST:g}", file=path, where=where)
    return value


def check_whole(word: object, path: Path, line: int | None, what: str) -> int:
    """Return a number that is a count."""
    value = check_number(word, path, line, what)
    if value != int(value) or value < 0:
        raise InputError(f"{what} is {value:g}, expected a whole number", file=path, where=line)
    return int(value)


def name_kind(words: str) -> str:
    """Tell what a cutter is by its description."""
    if re.search(OTHER, words):
        return "other"
    lower = words.lower()
    return "drill" if "drill" in lower else "mill" if "mill" in lower else ""


def round_ball(words: str, diameter: float | None, corner: float | None) -> float | None:
    """Return the corner radius of a cutter: half the diameter of a ball that states none. [mm]"""
    return 0.5 * diameter if not corner and diameter and "ball" in words.lower() else corner


def read_scale(unit: str, path: Path, tool: int) -> float:
    """Return millimetres a unit; a unit that nobody states is refused."""
    lower = unit.lower()
    if lower.startswith("milli") or lower == "mm":
        return 1.0
    if lower.startswith("inch") or lower == "in":
        return INCH
    raise InputError(f'T{tool} states no unit of its lengths; write [tools] unit = "mm" or "inch"', file=path)


def as_mapping(value: object) -> Mapping[str, Any]:
    """Return a table, an empty one where it is none."""
    return value if isinstance(value, Mapping) else {}
