"""Work offsets of a G-code file: those that it states (G10 L2), and which of them is the part frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.oracles.cam.moves import CannotTellError


@dataclass
class WorkOffsets:
    """The work offsets of a control.

    Attributes:
        part: Name of the offset that is the part frame, None until one is used.
        used: Name of the offset in force.
        known: Places of those that the file states. [mm]

    """

    part: str | None = None
    used: str = "G54"
    known: dict[str, list[float]] = field(default_factory=dict)

    def state(self, number: int, place: dict[int, float], *, moved: bool) -> None:
        """G10 L2: say where an offset lies.

        Args:
            number: 1 for G54 and so on.
            place: Coordinates by axis. [mm]
            moved: Whether the tool has moved.

        """
        name = f"G{53 + number}"
        if not 1 <= number <= 6:
            raise CannotTellError(f"G10 L2 P{number}")
        if moved and name in (self.used, self.part):
            raise CannotTellError("a work offset that changes on the way")
        known = self.known.setdefault(name, [float("nan")] * 3)
        for axis, value in place.items():
            known[axis] = value

    def shift(self, name: str) -> list[float]:
        """Take an offset into force; return where its zero lies, seen from the part frame. [mm]

        Raises:
            CannotTellError: If that is not known.

        """
        self.used = name
        if self.part is None or name == self.part:
            return [0.0, 0.0, 0.0]
        both = [self.known.get(key) for key in (self.part, name)]
        if both[0] is None or both[1] is None or any(a != a for place in both if place for a in place):
            raise CannotTellError("more than one work offset, whose places the file does not state")
        return [b - a for a, b in zip(both[0], both[1], strict=True)]
