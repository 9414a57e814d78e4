"""The block of an ordinary cut, X Y Z F alone: most blocks of most programs are of this kind."""

from __future__ import annotations

import re

from compplan.toolpath.readers.arcs import Point

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+))"
#: G1 X1.5 Y-2. Z.3 F1000, block number and words of motion aside.
PLAIN_CODE = re.compile(
    rf"[ \t]*(?:N\d+[ \t]*)?(?:G0?1[ \t]*)?(?:X{_NUMBER}[ \t]*)?(?:Y{_NUMBER}[ \t]*)?(?:Z{_NUMBER}[ \t]*)?"
    rf"(?:F{_NUMBER}[ \t]*)?"
)
#: L X+1.5 Y-2 Z+.3 F1000 (Heidenhain).
PLAIN_KLARTEXT = re.compile(rf"L(?: ?X{_NUMBER})?(?: ?Y{_NUMBER})?(?: ?Z{_NUMBER})?(?: ?F{_NUMBER})?(?: M90)?")


def read_place(found: re.Match[str], old: Point, scale: float, zero: Point = (0.0, 0.0, 0.0)) -> Point | None:
    """Return where a plain block leads, None where it names no axis; axes that it does not name stay.

    Args:
        found: The block.
        old: Where the tool is.
        scale: Millimetres of a unit.
        zero: Where the coordinates count from. [mm]

    """
    x, y, z, _ = found.groups()
    if x is None and y is None and z is None:
        return None
    return (
        old[0] if x is None else float(x) * scale + zero[0],
        old[1] if y is None else float(y) * scale + zero[1],
        old[2] if z is None else float(z) * scale + zero[2],
    )
