"""The G codes of the RS-274 family (Fanuc, Haas, LinuxCNC, printers): what each of them does, one line a code.

A new code is one line of `G_CODES`: `ignore()` where it says nothing of the path, `note(text)` where it is read past
with a note, `refuse(what)` where it changes the path in a way that is not read, `set_mode(name=value)` where it sets
modal state, or `Code(operation)` with a function operation(interpreter, block, code).
"""

from __future__ import annotations

from compplan.toolpath.readers.cnc.interpreter import (
    CYCLES,
    MOTIONS,
    MOVING,
    PLACES,
    UNITS,
    Code,
    Interpreter,
    WordBlock,
)
from compplan.toolpath.readers.cnc.state import AXES, PLANE_AXES
from compplan.toolpath.readers.options import ask_compensation

LENGTH_NOTE = "tool length compensation (G43) is not applied: the path is that of the tool tip"
#: Codes that act before all others of their block, and in this order; motion acts last.
FIRST = (20.0, 21.0, 70.0, 71.0, 90.0, 91.0, 17.0, 18.0, 19.0, 93.0, 94.0, 95.0, 80.0, 98.0, 99.0)
#: Work offsets of Haas: G110 is G154 P1.
HAAS_OFFSETS = (110.0, 111.0, *(float(number) for number in range(114, 130)))


def ignore(takes: str = "") -> Code:
    """Return a code that says nothing of the programmed path."""
    return Code(lambda interpreter, block, code: None, 2 if takes else 0, takes)


def note(text: str, takes: str = "") -> Code:
    """Return a code that is read past with a note."""
    return Code(lambda it, block, code: it.log.note(text, it.flow.line), 2 if takes else 0, takes)


def refuse(what: str) -> Code:
    """Return a code that is refused."""

    def run(interpreter: Interpreter, block: WordBlock, code: float) -> None:
        raise interpreter.error(f"G{code:g} ({what}) is not read; post-process without it")

    return Code(run)


def set_mode(**changes: object) -> Code:
    """Return a code that sets modal state."""

    def run(interpreter: Interpreter, block: WordBlock, code: float) -> None:
        for name, value in changes.items():
            setattr(interpreter.state, name, value)

    return Code(run)


def set_motion(it: Interpreter, block: WordBlock, code: float) -> None:
    """G0 to G3: the motion of this block and those after it."""
    it.state.motion, it.state.cycle_code = code, 0.0


def begin_cycle(it: Interpreter, block: WordBlock, code: float) -> None:
    """Begin a cycle; the level it began at stays until it is cancelled."""
    state = it.state
    if not state.cycle_code:
        axis = 3 - sum(PLANE_AXES[state.plane])
        unknown = axis in state.lost or (axis not in state.known and not state.moved)
        state.cycle_start = None if unknown else state.position[axis]
        state.cycle = {}
    state.cycle_code = code


def set_unit(it: Interpreter, block: WordBlock, code: float) -> None:
    """G20, G21 (G70, G71): inches or millimetres."""
    if code in (70.0, 71.0) and block.names(frozenset("PQUWIJL")):
        raise it.error(f"G{code:g} as a lathe cycle or bolt circle is not read; post-process without it")
    unscaled = not it.state.unit_stated and it.options.unit is None and it.state.offsets.origins
    if code in (20.0, 70.0) and unscaled:
        raise it.error("inches are stated after G10 has set work offsets; state the unit before them")
    it.state.set_unit(25.4 if code in (20.0, 70.0) else 1.0)


def refuse_spline(it: Interpreter, block: WordBlock, code: float) -> None:
    """G5, G5.1: look-ahead of the control, or with coordinates a spline."""
    if block.names(frozenset("XYZIJ")):
        raise it.error(f"G{code:g} (splines) is not read; post-process without it")


def use_offset(it: Interpreter, block: WordBlock, code: float) -> None:
    """G54 to G59.9, G54.1, G154, G500: a work offset."""
    it.origins.use_offset(code, block.values)


def use_haas_offset(it: Interpreter, block: WordBlock, code: float) -> None:
    """G110 to G129: a work offset of Haas; other controls have moves there."""
    if block.names(MOVING) and MOTIONS.isdisjoint(block.codes):
        it.pass_over(block, code)
    it.origins.use_offset(code, block.values)


def set_dynamic_offset(it: Interpreter, block: WordBlock, code: float) -> None:
    """G54.2 P, G254, G255: the work offset turns with the table."""
    it.frames.dynamic_offset = block.values.get("P", 0.0) != 0.0 if code == 54.2 else code == 254.0
    it.frames.place_rotary(keep=True)


def compensate_length(it: Interpreter, block: WordBlock, code: float) -> None:
    """G43, G44, G49 (tool length), G43.4, G43.5, G234 (control of the tip)."""
    it.frames.control_tip(code in (43.4, 43.5, 234.0))
    if code in (43.0, 44.0):
        it.log.note(LENGTH_NOTE, it.flow.line)


def compensate_radius(it: Interpreter, block: WordBlock, code: float) -> None:
    """G41, G42 and G41.1, G42.1: the radius of the cutter."""
    if code in (41.1, 42.1) and block.values.get("D", 0.0) != 0.0:
        raise it.error(f"G{code:g} with a cutter diameter D is not read; post-process the tool centre's path")
    if block.values.get("D") != 0.0:
        it.log.note(ask_compensation(it.options, f"G{code:g}"), it.flow.line)


def probe_from_home(it: Interpreter, block: WordBlock, code: float) -> None:
    """G29: bed levelling of printers."""
    it.log.note("G29 (probing) is left out; where it ended is not known", it.flow.line)
    if not block.names(PLACES):
        it.path.lose(range(3))


def probe(it: Interpreter, block: WordBlock, code: float) -> None:
    """G31, G38: probing."""
    it.log.note(f"G{code:g} (probing) is left out; where it ended is not known", it.flow.line)
    it.path.lose([axis for axis in range(3) if AXES[axis] in block.values])


def rotate(it: Interpreter, block: WordBlock, code: float) -> None:
    """G68: turn the frame in the plane in force."""
    it.frames.set_layers(rotation=it.frames.read_rotation(block.values))


def tilt(it: Interpreter, block: WordBlock, code: float) -> None:
    """G68.2: tilt the working plane."""
    it.frames.set_layers(plane=it.frames.read_plane(block.values), rotation=None)
    it.frames.turned_to_plane = False


CANCEL = Code(lambda it, block, code: setattr(it.state, "cycle_code", 0.0))
PROBE, SHIFT = Code(probe, 2, "once"), Code(lambda it, block, code: it.origins.shift(code, block.values), 2, "once")
DROP = Code(lambda it, block, code: it.origins.drop_shift(code), 2, "once")
HOME = Code(lambda it, block, code: it.origins.go_home(code, block.values), 2, "once")
MIRROR = Code(lambda it, block, code: it.frames.set_mirrors(code, block.values), 2, "once")
TO_PLANE = Code(lambda it, block, code: it.frames.turn_to_plane(code), 2, "once")
UNROTATE = Code(lambda it, block, code: it.frames.set_layers(rotation=None, plane=None), 2, "once")
UNSCALE = Code(lambda it, block, code: it.frames.set_layers(scale=None), 2, "once")
SCALE = Code(lambda it, block, code: it.frames.set_layers(scale=it.frames.read_scale(block.values)), 2, "once")
SET_OFFSET = Code(lambda it, block, code: it.origins.set_offset(block.values), 2, "once")
DYNAMIC, OFFSET, LENGTH = Code(set_dynamic_offset, 2, "once"), Code(use_offset), Code(compensate_length)
MACHINE = ignore("machine")

G_CODES: dict[float, Code] = {
    **dict.fromkeys(MOTIONS, Code(set_motion, 1)),
    **dict.fromkeys(CYCLES, Code(begin_cycle, 1)),
    80.0: CANCEL,
    # modes
    15.0: set_mode(polar=False), 16.0: set_mode(polar=True),
    17.0: set_mode(plane=17), 18.0: set_mode(plane=18), 19.0: set_mode(plane=19),
    90.0: set_mode(incremental=False), 91.0: set_mode(incremental=True),
    90.1: set_mode(centres="absolute", centres_stated=True), 91.1: set_mode(centres="incremental", centres_stated=True),
    93.0: set_mode(feed_mode=93), 94.0: set_mode(feed_mode=94), 95.0: set_mode(feed_mode=95),
    98.0: set_mode(retract_to_start=True), 99.0: set_mode(retract_to_start=False),
    **dict.fromkeys(UNITS, Code(set_unit)),
    # origins and frames
    **{float(code): OFFSET for code in range(54, 60)}, 154.0: OFFSET, 54.2: Code(set_dynamic_offset),
    **dict.fromkeys(HAAS_OFFSETS, Code(use_haas_offset)),
    10.0: SET_OFFSET, 28.0: HOME, 30.0: HOME, 53.0: MACHINE, 153.0: MACHINE,
    52.0: SHIFT, 92.0: SHIFT, 92.1: DROP, 92.2: DROP, 92.3: DROP,
    50.0: UNSCALE, 51.0: SCALE, 50.1: MIRROR, 51.1: MIRROR, 53.1: TO_PLANE, 53.6: TO_PLANE,
    68.0: Code(rotate, 2, "once"), 68.2: Code(tilt, 2, "once"), 69.0: UNROTATE, 254.0: DYNAMIC, 255.0: DYNAMIC,
    # compensation and probing
    **dict.fromkeys((41.0, 41.1, 42.0, 42.1), Code(compensate_radius)),
    **dict.fromkeys((43.0, 43.4, 43.5, 44.0, 49.0, 234.0), LENGTH),
    43.1: note(LENGTH_NOTE, "once"), 22.0: note("limits of the working space (G22) are not read", "once"),
    29.0: Code(probe_from_home), **dict.fromkeys((31.0, 38.2, 38.3, 38.4, 38.5), PROBE),
    # nothing of the path
    4.0: ignore("once"), 9.0: ignore(), 40.0: ignore(), 61.0: ignore(), 61.1: ignore(), 64.0: ignore(), 67.0: ignore(),
    96.0: ignore(), 97.0: ignore(), 113.0: ignore(), 269.0: ignore(),
    # refused
    5.0: Code(refuse_spline), 5.1: Code(refuse_spline), 5.2: refuse("NURBS"), 6.2: refuse("NURBS"),
    7.0: refuse("lathe diameters"), 12.0: refuse("pocket cycles"), 13.0: refuse("pocket cycles"),
    32.0: refuse("threading"), 33.0: refuse("threading"), 33.1: refuse("rigid tapping"), 34.0: refuse("threading"),
    66.0: refuse("modal macro calls"), 66.1: refuse("modal macro calls"), 68.1: refuse("coordinate rotation"),
    68.3: refuse("tilted work planes by the tool axis"), 68.4: refuse("tilted work planes on top of each other"),
    107.0: refuse("cylindrical interpolation"), 112.0: refuse("polar interpolation"),
    268.0: refuse("tilted work planes of Haas"), 12.1: refuse("polar interpolation"),
    7.1: refuse("cylindrical interpolation"), 54.4: refuse("workpiece setting errors"),
}  # fmt: skip
G_CODES |= {code: Code(G_CODES[code].run, rank - len(FIRST)) for rank, code in enumerate(FIRST)}


def find_code(code: float) -> Code | None:
    """Return what a G code does, None where it is not known; G54.3 or G505 are work offsets."""
    found = G_CODES.get(code)
    return found or (OFFSET if 54.0 <= code < 60.0 or 500.0 <= code < 600.0 else None)
