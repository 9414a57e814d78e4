"""Turned, scaled and tilted frames of a G-code program, and its rotary axes: G51 G51.1 G68 G68.2 G53.1, A B C."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from scipy.spatial.transform import Rotation

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.rotary import UP, RotaryError, RotaryMachine, build_machine
from compplan.toolpath.readers.cnc.state import AXES, PLANE_AXES, PLANE_NORMALS
from compplan.toolpath.readers.frames import Frame, scale_about, tilt_plane, turn_about

UNKNOWN_MACHINE = "moves while rotary axes stand turned whose machine is not stated"
#: From this factor on, a scale P without a decimal point counts in thousandths.
LEAST_THOUSANDTHS = 100.0
#: Order in which frames act on a coordinate, from the word outwards.
LAYERS = ("mirror", "scale", "rotation", "plane")


class ProgramFrames:
    """Hold the frames in force and the rotary axes; their product is the placement of the path.

    Args:
        path: Writer of the moves.

    """

    def __init__(self, path: PathWriter) -> None:
        self.path, self.state, self.log, self.options, self.error = path, path.state, path.log, path.options, path.error
        self.layers: dict[str, Frame] = {}
        self.machine: RotaryMachine | None = None
        self.dynamic_offset = self.turned_to_plane = False
        self.mirrors: dict[int, float] = {}
        #: Letters of rotary axes that have turned.
        self.letters: frozenset[str] = frozenset()

    def set_layers(self, **layers: Frame | None) -> None:
        """Put frames in force or out of it."""
        for name, layer in layers.items():
            self.layers.pop(name, None)
            if layer is not None:
                self.layers[name] = layer
        self._update(keep=True)

    def _update(self, *, keep: bool) -> None:
        """Join the frames in force, the machine's own last."""
        whole: Frame | None = None
        for name in LAYERS:
            layer = self.layers.get(name)
            if layer is not None:
                whole = layer if whole is None else layer.then(whole)
        self._ask_for_machine()
        outer = None if "plane" in self.layers else self._place_machine()
        if outer is not None:
            whole = outer if whole is None else outer.then(whole)
        self.path.replace(whole, keep=keep)

    def _centre(self, values: dict[str, float], letters: str = AXES) -> Point:
        """Return the centre of a rotation or scale: coordinates of the block, the tool's place where there is none."""
        state = self.state
        centre = list(state.position)
        for axis, letter in enumerate(AXES):
            if letter in values and letter in letters:
                if state.incremental:
                    raise self.error("the centre of a rotation or scale in G91 has two meanings, state it in G90")
                centre[axis] = values[letter] * state.scale + state.zero(axis)
            elif letter in letters and (axis in state.lost or axis not in state.known):
                raise self.error(f"a rotation or scale about the tool's place, whose {letter} is not known; state it")
        return centre[0], centre[1], centre[2]

    def read_rotation(self, values: dict[str, float]) -> Frame:
        """Read G68: a turn by R degrees in the plane in force, counter-clockwise."""
        state = self.state
        if "plane" in self.layers and not values.keys().isdisjoint("IJK"):
            raise self.error("G68 in space within a tilted plane is not read; post-process without it")
        if "R" not in values or not values.keys().isdisjoint("IJK"):
            raise self.error("G68 has no angle R in the plane, other forms of it are not read; post-process without it")
        if state.incremental:
            raise self.error("G68 in G91 has two meanings, state it in G90")
        letters = "".join(AXES[axis] for axis in PLANE_AXES[state.plane])
        angle = math.radians(values["R"]) * (-1.0 if state.plane == 18 else 1.0)
        turn = Rotation.from_rotvec([angle * n for n in PLANE_NORMALS[state.plane]])
        if state.plane == 18:  # seen from the positive end of Y, from Z towards X
            turn = Rotation.from_rotvec([0.0, math.radians(values["R"]), 0.0])
        return turn_about(self._centre(values, letters), turn)

    def read_scale(self, values: dict[str, float]) -> Frame:
        """Read G51: P scales all axes, I J K each its own; whole numbers from 100 on count in thousandths."""
        scales = [values.get("P", values.get(letter, 1.0)) for letter in "IJK"]
        for number, scale in enumerate(scales):
            if abs(scale) >= LEAST_THOUSANDTHS and scale == int(scale):
                self.log.note(f"G51 scale {scale:g} is read in thousandths", self.path.line)
                scales[number] = scale * 1e-3
        if any(abs(scale) < 1e-4 or abs(scale) > LEAST_THOUSANDTHS for scale in scales):
            raise self.error(f"G51 scales by {scales}, expected factors from 0.0001 to 100")
        return scale_about(self._centre(values), (scales[0], scales[1], scales[2]))

    def set_mirrors(self, code: float, values: dict[str, float]) -> None:
        """Read G51.1 (mirror about X.. Y.. Z..) and G50.1 (take mirrors back)."""
        state = self.state
        named = [axis for axis in range(3) if AXES[axis] in values]
        for axis in named if code == 51.1 or named else list(self.mirrors):
            if code == 51.1:
                self.mirrors[axis] = values[AXES[axis]] * state.scale + state.zero(axis)
            else:
                self.mirrors.pop(axis, None)
        at = [self.mirrors.get(axis, 0.0) for axis in range(3)]
        sense = [-1.0 if axis in self.mirrors else 1.0 for axis in range(3)]
        centre, senses = (at[0], at[1], at[2]), (sense[0], sense[1], sense[2])
        self.set_layers(mirror=scale_about(centre, senses) if self.mirrors else None)

    def read_plane(self, values: dict[str, float]) -> Frame:
        """Read G68.2: origin X Y Z, and I J K as Euler angles z x' z'', or with P1 as turns about the fixed X Y Z."""
        state = self.state
        form = values.get("P", 0.0)
        if form not in (0.0, 1.0) or (form == 1.0 and values.get("Q", 123.0) != 123.0) or state.incremental:
            raise self.error("G68.2 is read in G90, as Euler angles or with P1 and Q123; post-process it so")
        angles = [values.get(letter, 0.0) for letter in "IJK"]
        turn = Rotation.from_euler("xyz" if form == 1.0 else "ZXZ", angles, degrees=True)
        origin = [values.get(letter, 0.0) * state.scale for letter in AXES]
        zero = [state.zero(axis) for axis in range(3)]
        return tilt_plane((origin[0], origin[1], origin[2]), turn, (zero[0], zero[1], zero[2]))

    def turn_to_plane(self, code: float) -> None:
        """Read G53.1 and G53.6: the rotary axes set the tool square to the tilted plane."""
        if "plane" not in self.layers:
            raise self.error(f"G{code:g} without a tilted plane (G68.2) has nothing to turn to")
        self._set_axis_of_plane(stays=code == 53.6)

    def _set_axis_of_plane(self, *, stays: bool) -> None:
        """Let the tool stand along Z of the tilted plane; where its tip then is nobody knows, unless it stays."""
        self.turned_to_plane = True
        if not stays:
            self.path.lose(range(3))
        self.log.axis = self.layers["plane"].turn(UP)

    def check_plane(self) -> None:
        """Refuse a cut in a tilted plane that the tool was not turned to."""
        if "plane" in self.layers and not self.turned_to_plane:
            tilted = self.layers["plane"].turn(UP)
            if math.dist(tilted, self.log.axis) > 1e-9:
                raise self.error("a cut in a tilted plane (G68.2) that the tool is not turned to (G53.1, or A B C)")

    def turn_rotary(self, values: dict[str, float]) -> dict[str, float] | None:
        """Take the rotary words of a block; return the angles before, None where they do not turn tool or part."""
        state = self.state
        if self.options.rotary == "ignore":
            return None
        before = state.turn(values)
        if "plane" in self.layers:
            self._set_axis_of_plane(stays=False)
            return None
        self.place_rotary(keep=False)
        return before if self.machine is not None else None

    def home_rotary(self, letters: Iterable[str]) -> None:
        """Take rotary axes home: to 0."""
        for letter in letters:
            self.state.rotary[letter] = 0.0
        self.place_rotary(keep=False)

    def place_rotary(self, *, keep: bool) -> None:
        """Follow rotary axes that have turned, or what their words mean; keep: the tool stays where it is."""
        self._update(keep=keep)

    def _ask_for_machine(self) -> None:
        """Build the machine of the rotary words, or leave moves out while they stand turned and it is not stated."""
        turned = {letter: angle for letter, angle in self.state.rotary.items() if angle}
        if self.options.rotary is None and turned and "plane" not in self.layers:
            words = " ".join(f"{letter}{angle:g}" for letter, angle in turned.items())
            self.path.mute(UNKNOWN_MACHINE, f"rotary words {words} (line {self.path.line}) turn the tool or the part; "
                           'state which with rotary = "head", "table" or "head_table" (--rotary)',
                           f"rapid {UNKNOWN_MACHINE} are left out")  # fmt: skip
        elif self.options.rotary is None:
            self.path.unmute(UNKNOWN_MACHINE)
        elif not turned.keys() <= self.letters:
            self.letters = self.letters | turned.keys()
            try:
                self.machine = build_machine(self.options, self.letters)
            except RotaryError as fault:
                raise self.error(str(fault)) from None

    def _place_machine(self) -> Frame | None:
        """Return where X Y Z of the machine stand in the part, None where they are the tip in the part frame."""
        state = self.state
        if self.machine is None or state.tip_control or self.options.tip_control or not any(state.rotary.values()):
            return None
        machine = self.machine
        if self.dynamic_offset:
            machine = replace(machine, centre=(0.0, 0.0, 0.0), offset=(0.0, 0.0, 0.0))
        try:
            return machine.place(state.rotary)
        except RotaryError as fault:
            words = " ".join(f"{letter}{angle:g}" for letter, angle in state.rotary.items())
            raise self.error(
                f"{words} without control of the tip (G43.4, TRAORI, M128): X Y Z are positions of the machine; "
                f"state {fault}, or tip_control = true if they are the tip in the part frame"
            ) from None

    def rotary_axis(self) -> Point | None:
        """Return the tool axis that the rotary axes give, None where they say nothing."""
        if "plane" in self.layers:
            return self.layers["plane"].turn(UP)
        if self.machine is None:
            return UP if self.state.rotary and not any(self.state.rotary.values()) else None
        return self.machine.point_tool(self.state.rotary)

    def control_tip(self, on: bool) -> None:
        """Begin or end that X Y Z are the tip in the part frame."""
        if self.state.tip_control != on:
            self.state.tip_control = on
            if self.state.rotary:
                self.place_rotary(keep=True)
