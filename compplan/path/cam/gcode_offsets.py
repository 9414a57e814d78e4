"""Work offsets of G-code (G54 ..): what G10 L2 says of them, and where that puts the path. Millimetres throughout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from compplan.path.cam.arcs import Point

UNKNOWN = "work offsets (G54 ..) are not known: all coordinates are taken in one frame"
EQUAL = "work offsets are known in part (G10 L2): axes that it does not name are taken as equal"


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

    def switch(self, code: float) -> tuple[Point, str]:
        """Put another offset in force; return how far the origin moves, and what has to be noted."""
        old, new = self.origins.get(self.active, {}), self.origins.get(code, {})
        changed, self.active = code != self.active, code
        if not changed:
            return (0.0, 0.0, 0.0), ""
        if not old or not new or old.keys() != new.keys():
            return (0.0, 0.0, 0.0), UNKNOWN
        step = tuple(new.get(axis, 0.0) - old.get(axis, 0.0) for axis in range(3))
        return (step[0], step[1], step[2]), "" if len(new) == 3 else EQUAL

    def from_machine(self, axis: int, value: float) -> float | None:
        """Return a machine coordinate as the offset in force counts it; None where its origin is not known."""
        origin = self.origins.get(self.active, {}).get(axis)
        return None if origin is None else value - origin
