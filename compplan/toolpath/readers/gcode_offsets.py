"""Work offsets of G-code (G54 ..): what G10 L2 says of them, and where that puts the path. Millimetres throughout."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from compplan.toolpath.readers.arcs import Point


@dataclass
class Offsets:
    """Hold the work offsets that a program sets, and the one in force.

    Args:
        active: Code of the offset in force; G54 where none was named.
        origins: Origin of each offset that G10 L2 set, seen from the machine, by axis.

    """

    active: float = 54.0
    origins: dict[float, dict[int, float]] = field(default_factory=dict)

    def set_origin(self, number: int, values: Mapping[int, float]) -> dict[int, float]:
        """Take G10 L2 P number; return by how much the offset in force moves, by axis.

        Raises:
            ValueError: If the offset in force changes and what it was is not known.

        """
        code = self.active if number == 0 else 53.0 + number if number <= 6 else 59.0 + (number - 6) / 10.0
        before = self.origins.setdefault(code, {})
        moved = {axis: value - before[axis] for axis, value in values.items() if axis in before}
        unknown = values.keys() - before.keys()
        before.update(values)
        if code != self.active:
            return {}
        if unknown:
            raise ValueError
        return moved

    def switch(self, code: float) -> Point | None:
        """Put another offset in force; return how far the origin moves [mm], None where nobody knows."""
        old, new = self.origins.get(self.active, {}), self.origins.get(code, {})
        changed, self.active = code != self.active, code
        if not changed:
            return 0.0, 0.0, 0.0
        if len(old) < 3 or len(new) < 3:
            return None
        return new[0] - old[0], new[1] - old[1], new[2] - old[2]

    def from_machine(self, axis: int, value: float) -> float | None:
        """Return a machine coordinate as the offset in force counts it; None where its origin is not known."""
        origin = self.origins.get(self.active, {}).get(axis)
        return None if origin is None else value - origin


def name_offset(code: float) -> str:
    """Return the name of a work offset: G54, G59.1, G54.1 P12."""
    return f"G54.1 P{code - 1000.0:g}" if code >= 1000.0 else f"G{code:g}"


def find_offset(name: str) -> float | None:
    """Return the code of a work offset by its name (G54, G59.1, G54.1 P12, G154 P12, G505), None for other names."""
    found = re.fullmatch(r"G(54\.1|154)\s*P(\d{1,3})", name.strip().upper())
    if found:
        return 1000.0 + float(found.group(2))
    found = re.fullmatch(r"G(5[4-9](?:\.\d)?|5\d\d)", name.strip().upper())
    return float(found.group(1)) if found else None
