"""Canned drilling cycles of G-code (G73, G74, G76, G81 to G89): what their words say of each hole."""

from __future__ import annotations

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.cycles import MOST_HOLES, PECK_CLEARANCE_MM, Hole, drill, list_pecks, set_level
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import AXES, DEEP_AXIS, CncBlock

PECK_NOTE = (
    f"G83 comes back to {PECK_CLEARANCE_MM:g} mm above the depth before, G73 goes back by as much: "
    "assumed, the control's own setting is not in the file"
)
#: Cycles that go back with the feed, that wait at the bottom, and that reverse the spindle there.
FEED_BACK = frozenset({74.0, 84.0, 85.0, 89.0})
DWELLING = frozenset({82.0, 89.0, 76.0, 88.0, 74.0, 84.0})
TAPPING = {74.0: ("spindle_cw", "spindle_ccw"), 84.0: ("spindle_ccw", "spindle_cw")}
NOT_CUT = {87.0: "back boring", 88.0: "boring with a retract by hand"}


def begin_cycle(it: Interpreter, code: float) -> None:
    """Begin a cycle; the level it began at stays until it is cancelled."""
    state, axis = it.state, DEEP_AXIS[it.state.plane]
    if not state.cycle_code:
        unknown = axis in it.course.lost or axis in it.course.untold
        state.cycle_start = None if unknown else it.course.position[axis]
        state.cycle = {}
    state.cycle_code = code


def run_cycle(it: Interpreter, block: CncBlock) -> None:
    """Carry out the holes of one block.

    The tool moves rapidly to each hole at the level where it is (or R if that is higher), and to the level R; it cuts
    to the bottom, in pecks of Q where the cycle has them, and goes back to R (G99) or to the level at which the cycle
    began (G98). R, Z, Q, P, I, J, K are modal, L (or K without I) repeats.
    """
    state, values, code, axis = it.state, block.values, it.state.cycle_code, DEEP_AXIS[it.state.plane]
    deep, expand = AXES[axis], it.options.cycles == "expand"
    _take_words(it, block, axis)
    if values.keys().isdisjoint(("X", "Y", "Z", "R", "RP", "AP")):
        return
    repeats = values.get("L", values.get("K", 1.0) if "I" not in state.cycle else 1.0)
    if repeats == 0.0:
        return
    if not 1.0 <= repeats <= MOST_HOLES:
        raise InputError(f"cycle with {repeats:.0f} repeats, at most {MOST_HOLES} are read")
    if expand and code in NOT_CUT:
        raise InputError(f"cycle G{code:g} ({NOT_CUT[code]}) is not read; post-process it as single moves")
    if deep not in state.cycle:
        raise InputError(f"cycle G{code:g} has no depth {deep}")
    beside = CncBlock(
        {key: value for key, value in values.items() if key in ("X", "Y", "Z", "RP", "AP") and key != deep}
    )
    named = () if state.incremental else it.motion.target(beside)[1]
    it.contour.refuse_open()
    it.course.check_place({0, 1, 2} - {axis} - set(named))
    for _ in range(int(repeats)):
        target, named = it.motion.target(beside)
        with it.log.hole():
            _run_hole(it, code, target, named, axis, expand=expand)


def _take_words(it: Interpreter, block: CncBlock, axis: int) -> None:
    """Keep what a block says of its hole; in G91 R counts from where the cycle began, and the depth from R."""
    state, values, deep = it.state, block.values, AXES[axis]
    stated = values["R"] * state.scale if "R" in values and not state.incremental else None
    start = _find_start(it, axis, stated)
    for letter, name in (("R", "R"), (deep, deep)):
        if letter in values:
            from_level = start if name == "R" else state.cycle.get("R", start)
            state.cycle[name] = values[letter] * state.scale + (from_level if state.incremental else 0.0)
    for letter in "QIJ":
        if letter in values:
            state.cycle[letter] = abs(values[letter]) * state.scale
    if "I" in values and "K" in values:
        state.cycle["K"] = abs(values["K"]) * state.scale
    if "P" in values:
        state.cycle["P"] = values["P"]


def _find_start(it: Interpreter, axis: int, stated: float | None = None) -> float:
    """Return the level at which the cycle began; where it is not known, the highest rapid so far or the level R."""
    state = it.state
    if state.cycle_start is None:
        known = it.course.level_of_height() if axis == 2 else None
        known = state.cycle.get("R", stated) if known is None else known
        if known is None and not it.course.muted:
            raise InputError("a drilling cycle begins where the height of the tool is not known and states no level R; "
                             "let a rapid move (G0) to a height come first")  # fmt: skip
        state.cycle_start = it.course.position[axis] if known is None else known
        it.note(f"a cycle begins at an unknown height: {state.cycle_start:g} is assumed")
    return state.cycle_start


def _run_hole(it: Interpreter, code: float, target: tuple[float, float, float], named: tuple[int, ...], axis: int,
              *, expand: bool) -> None:  # fmt: skip
    state, course, words = it.state, it.course, it.state.cycle
    start = _find_start(it, axis)
    clear, bottom = words.get("R", start), words[AXES[axis]]
    level = max(start if axis in course.lost else course.position[axis], clear)
    course.settle((axis,))
    if level > course.position[axis] and course.knows:
        course.rapid(set_level(course.position, axis, level))
    course.rapid(set_level(target, axis, level), named)
    feed, wait = it.motion.feed(abs(clear - bottom)), words.get("P", 0.0) if code in DWELLING else 0.0
    hole = Hole(
        axis, clear, bottom, max(start, clear) if state.retract_to_start else clear, feed,
        feed if code in FEED_BACK else None, lifts=code == 83.0,
        wait=wait if wait < 100.0 else wait * 1e-3,  # from 100 on it counts in milliseconds
        turn=TAPPING.get(code, ("", "")) if state.turning else ("", ""), speed=state.spindle,
    )  # fmt: skip
    first = words.get("I", words.get("Q", 0.0))  # Haas: from I by J less each time down to K
    if expand and code in (73.0, 83.0) and first > 0.0 and bottom < clear and not course.muted:
        it.note(PECK_NOTE)
        by_steps = "I" in words
        least = words.get("K", first) if by_steps else first
        hole.pecks = list_pecks(clear, bottom, first, words.get("J", 0.0) if by_steps else 0.0, least)
    drill(course, hole, expand=expand, name=f"G{code:g}")
