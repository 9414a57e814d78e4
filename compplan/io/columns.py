"""Units in column names, and the columns of a table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError

#: Units of each dimension, with their factor to SI. Temperatures stay in degrees Celsius.
DIMENSIONS = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180.0},
    "force": {"N": 1.0, "kN": 1e3},
    "moment": {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3},
    "time": {"s": 1.0, "ms": 1e-3},
    "speed": {"m_s": 1.0, "mm_s": 1e-3, "m_min": 1.0 / 60.0, "mm_min": 1e-3 / 60.0},
    "temperature": {"C": 1.0},
}
#: Unit suffix -> (dimension, factor to SI).
UNITS = {unit: (name, factor) for name, units in DIMENSIONS.items() for unit, factor in units.items()}


@dataclass(frozen=True)
class FileColumn:
    """One column that a table may have."""

    name: str  #: Name without unit. A trailing or inner `#` is a number from 1: `q#` is q1, q2, ...
    #: "length", "angle", "force", "moment", "time", "speed", "temperature", "number" (no unit) or "text";
    #: several if the unit decides.
    dimension: str | tuple[str, ...] = "number"
    required: bool = False  #: Whether a table without it is refused.
    missing: bool = False  #: Whether a field may be empty, which reads as NaN.
    group: str | None = None  #: Columns of one group occur all or not at all.
    #: Key in the table that is read; default: the name. Columns of the same name need different keys (sigma_mm and
    #: sigma_deg).
    key: str | None = None

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Every dimension that the column may have."""
        return (self.dimension,) if isinstance(self.dimension, str) else self.dimension

    def header(self) -> str:
        """Return the first two titles of the column, joined by "or"."""
        return " or ".join(self.headers()[:2])

    def headers(self) -> list[str]:
        """Return every title of the column; millimetres and degrees first."""
        if set(self.dimensions) & {"number", "text"}:
            return [self.name]
        first = ("mm", "deg", "mm_s")
        units = [unit for unit, (dimension, _) in UNITS.items() if dimension in self.dimensions]
        return [f"{self.name}_{unit}" for unit in sorted(units, key=lambda unit: unit not in first)]


def split_unit(header: str) -> tuple[str, str]:
    """Split a column name into name and unit: "feed_mm_s" -> ("feed", "mm_s"), "i" -> ("i", "")."""
    parts = header.split("_")
    for start in range(1, len(parts)):
        unit = "_".join(parts[start:])
        if unit in UNITS:
            return "_".join(parts[:start]), unit
    return header, ""


def to_unit(values: NDArray[np.float64], header: str) -> NDArray[np.float64]:
    """Convert SI values to the unit of a column name, such as mm for "x_mm"."""
    _, unit = split_unit(header)
    return np.asarray(values, dtype=np.float64) / (UNITS[unit][1] if unit else 1.0)


def match_columns(
    path: Path, line: int, header: list[str], columns: Sequence[FileColumn], unknown: str
) -> tuple[dict[str, tuple[int, FileColumn, str]], list[str]]:
    """Match the header of a file with known columns.

    Args:
        path: The file, for messages.
        line: Line of the header.
        header: The names in the file.
        columns: The columns that it may have.
        unknown: "refuse" columns that are not in `columns`, or "note" them.

    Returns:
        Key -> (index in the file, column, unit), and notes on ignored columns.

    Raises:
        InputError: If a column is unknown, occurs twice, has no or a wrong unit, or is missing, alone or of a group.

    """
    matched: dict[str, tuple[int, FileColumn, str]] = {}
    notes: list[str] = []
    for index, title in enumerate(header):
        found = _find_column(title, columns)
        if found is None:
            message = _explain_unknown(title, columns)
            if unknown == "refuse":
                raise InputError(message, file=path, where=line)
            notes.append(f"column '{title}' is not read")
            continue
        column, unit, key = found
        if key in matched:
            other = header[matched[key][0]]
            twice = f"column '{title}' occurs twice"
            message = twice if other == title else f"columns '{other}' and '{title}' hold the same quantity"
            raise InputError(f"{message}; keep one of them", file=path, where=line)
        matched[key] = (index, column, unit)
    _check_groups(path, line, header, columns, [column for _, column, _ in matched.values()])
    return matched, notes


def _find_column(title: str, columns: Sequence[FileColumn]) -> tuple[FileColumn, str, str] | None:
    """Return the column of a title, with its unit and key."""
    name, unit = split_unit(title)
    for column in columns:
        plain = bool(set(column.dimensions) & {"number", "text"})
        if plain:
            candidate, fits = title, True
        else:
            candidate, fits = name, unit != "" and UNITS[unit][0] in column.dimensions
        if fits and _name_pattern(column.name).fullmatch(candidate):
            return column, "" if plain else unit, candidate if "#" in column.name else column.key or column.name
    return None


def _name_pattern(name: str) -> re.Pattern[str]:
    return re.compile(re.escape(name).replace(r"\#", "#").replace("#", "[1-9][0-9]?"))


def _explain_unknown(title: str, columns: Sequence[FileColumn]) -> str:
    """Return why a title matches no column."""
    name, unit = split_unit(title)
    for column in columns:
        if _name_pattern(column.name).fullmatch(name) or _name_pattern(column.name).fullmatch(title):
            expected = " or ".join(column.headers()[:3]).replace(column.name, name)
            fault = f"has the unit {unit}" if unit else "has no unit"
            return f"column '{title}' {fault}; name it {expected}"
    return f"no column named '{title}', choose from {[column.headers()[0] for column in columns]}"


def _check_groups(
    path: Path, line: int, header: list[str], columns: Sequence[FileColumn], present: Sequence[FileColumn]
) -> None:
    """Refuse a table without a required column, or with part of a group."""
    groups = {column.group for column in present if column.group is not None}
    for column in columns:
        if column in present:
            continue
        if column.required:
            name = column.header().replace("#", "1")
            raise InputError(f"missing column {name}; the columns are {header}", file=path, where=line)
        if column.group in groups:
            mates = [other.headers()[0] for other in columns if other.group == column.group]
            message = f"missing column {column.header()}; {', '.join(mates)}: give all or none"
            raise InputError(message, file=path, where=line)
