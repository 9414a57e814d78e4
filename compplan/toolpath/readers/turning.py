"""The rotary axes A B C of programs whose tool is followed on a course: what the user says of the machine decides."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.rotary import RotaryError, build_machine
from compplan.toolpath.readers.frames import Frame
from compplan.toolpath.readers.options import CamTable

LETTERS = "ABC"


class Rotary:
    """Hold how the rotary axes stand, and what they turn."""

    def __init__(self, options: CamTable) -> None:
        self.options = options
        self.angles: dict[str, float] = {}
        self.turned: set[str] = set()

    @property
    def unknown(self) -> bool:
        """Whether axes stand turned, and nobody says what they turn."""
        return self.options.rotary is None and any(self.angles.values())

    @property
    def ignored(self) -> bool:
        """Whether the user leaves rotary words out."""
        return self.options.rotary == "ignore"

    def take(self, letter: str, angle: float) -> None:
        """Turn an axis to an angle [deg]."""
        self.angles[letter] = angle
        if angle:
            self.turned.add(letter)

    def refuse_unknown(self) -> None:
        """Refuse a cut while axes stand turned of which nobody says what they turn.

        Raises:
            ValueError: If they do.

        """
        if self.unknown:
            words = " ".join(f"{letter}{angle:g}" for letter, angle in self.angles.items() if angle)
            raise ValueError(f"rotary words {words} turn the tool or the part; state which with rotary = "
                             '"head", "table" or "head_table" (--rotary), or machine = "NAME"')  # fmt: skip

    def point_tool(self, angles: Mapping[str, float] | None = None) -> Point:
        """Return the tool axis in the part, for these angles or for those in force.

        Raises:
            ValueError: If the machine is not known.

        """
        angles = self.angles if angles is None else angles
        if not any(angles.values()) or self.ignored:
            return 0.0, 0.0, 1.0
        return build_machine(self.options, self.turned).point_tool(angles)

    def turn_on_way(self, before: Mapping[str, float]) -> Callable[[float], Point]:
        """Return the tool axis after a share of a move on which the axes turn evenly."""
        after = dict(self.angles)

        def axis(share: float) -> Point:
            letters = before.keys() | after.keys()
            now = {key: (1.0 - share) * before.get(key, 0.0) + share * after.get(key, 0.0) for key in letters}
            return self.point_tool(now)

        return axis

    def place(self, *, tip_control: bool) -> Frame:
        """Return where X Y Z of the machine stand in the part: as they are where they are the tip in the part frame.

        Raises:
            ValueError: If the machine is not known.

        """
        if tip_control or self.options.tip_control or self.unknown or self.ignored or not any(self.angles.values()):
            return Frame()
        machine = build_machine(self.options, self.turned)
        try:
            return machine.place(self.angles)
        except RotaryError as fault:
            words = " ".join(f"{letter}{angle:g}" for letter, angle in self.angles.items())
            raise ValueError(
                f"{words} without control of the tip (M128, TCPM, TRAORI): X Y Z are positions of the machine; "
                f"state {fault}, or tip_control = true if they are the tip in the part frame"
            ) from None
