"""Exports of tracker and CMM programs, and of robots: titles that state axis and unit, as a log calls them.

| title, in any case and brackets | read as |
|---|---|
| X [mm], Measured X (mm), Actual_X_mm, X act. [m] | x_mm, x_m |
| J1 [deg], Axis 1 (rad), A1 [deg] | q1_deg, q1_rad |

Columns of nominal values and deviations stay what they are. A title without a unit is no column: `doctor` names it.
"""

from __future__ import annotations

import re

_UNIT = r"[ _]*[\[(]?(?P<unit>{units})?[\])]?"
_SEEN = r"(?:(?:measured|meas\.?|actual|act\.?)[ _]*)?"
#: Titles (assumed), with name and usual unit in a log.
_TITLES = (
    (re.compile(rf"{_SEEN}(?P<of>[xyz]){_UNIT.format(units='mm|m')}", re.IGNORECASE), "{}", "mm"),
    (re.compile(rf"(?P<of>[xyz])[ _]*(?:measured|meas\.?|actual|act\.?){_UNIT.format(units='mm|m')}", re.IGNORECASE),
     "{}", "mm"),
    (re.compile(rf"(?:j|joint|axis|a|q)[ _]*(?P<of>[1-9]){_UNIT.format(units='deg|rad')}", re.IGNORECASE),
     "q{}", "deg"),
)  # fmt: skip


def rename_title(title: str) -> str:
    """Return a log's name of a column of such an export that states its unit, any other name as it is."""
    found = _find(title)
    return title if found is None or not found[1] else "_".join(found)


def guess_name(title: str) -> str | None:
    """Return a log's name of a column that states no unit, in the usual one; None of any other column."""
    found = _find(title)
    return None if found is None or found[1] else f"{found[0]}_{found[2]}"


def _find(title: str) -> tuple[str, ...] | None:
    for form, name, usual in _TITLES:
        if match := form.fullmatch(title.strip()):
            unit = (match["unit"] or "").lower()
            return (name.format(match["of"].lower()), unit) if unit else (name.format(match["of"].lower()), "", usual)
    return None
