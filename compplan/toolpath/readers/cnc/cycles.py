"""Canned drilling cycles of G-code (G73, G74, G76, G81 to G89), in the plane in force."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.state import AXES, State

#: Greatest number of holes of one block, and of pecks of one hole.
MOST_HOLES = 10_000
MOST_PECKS = 10_000
#: How far a deep-hole cycle stays above the depth before when it comes back (G83) or goes back (G73). [mm]
PECK_CLEARANCE_MM = 0.254
#: Least depth of a last peck of its own (at most a tenth of Q): less remains where a file rounds Q to 0.001 mm or
#: 0.0001 inch; assumed. [mm]
LEAST_PECK_MM = 0.005
PECK_NOTE = (
    f"G83 comes back to {PECK_CLEARANCE_MM:g} mm above the depth before, G73 goes back by as much: "
    "assumed, the control's own setting is not in the file"
)
#: Cycles that go back with the feed, that wait at the bottom, and that reverse the spindle there.
FEED_BACK = frozenset({74.0, 84.0, 85.0, 89.0})
DWELLING = frozenset({82.0, 89.0, 76.0, 88.0, 74.0, 84.0})
TAPPING = {74.0: ("spindle_cw", "spindle_ccw"), 84.0: ("spindle_ccw", "spindle_cw")}
NOT_CUT = {87.0: "back boring", 88.0: "boring with a retract by hand"}


def run_cycle(code: float, values: Mapping[str, float], path: PathWriter, expand: bool) -> None:
    """Carry out the holes of one block.

    The tool moves rapidly to each hole at the level where it is (or R if that is higher), and to the level R; it cuts
    to the bottom, in pecks of Q where the cycle has them, and goes back to R (G99) or to the level at which the cycle
    began (G98). Skipped: it moves rapidly to each hole at the level that it retracts to.

    Args:
        code: The cycle.
        values: Words of the block; R, Z, Q, P, I, J, K are modal, L (or K without I) repeats.
        path: Writer of the moves; its state ends where the cycle ends.
        expand: Whether holes are cut.

    Raises:
        InputError: If the block asks for more holes than any part has, or for what no other cycle can do.

    """
    state = path.state
    order = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}[state.plane]
    deep = AXES[order[2]]
    _take_words(values, path, order[2])
    if values.keys().isdisjoint(("X", "Y", "Z", "R")):
        return
    repeats = values.get("L", values.get("K", 1.0) if "I" not in state.cycle else 1.0)
    if repeats == 0.0:
        return
    if not 1.0 <= repeats <= MOST_HOLES:
        raise path.error(f"cycle with {repeats:.0f} repeats, at most {MOST_HOLES} are read")
    if expand and code in NOT_CUT:
        raise path.error(f"cycle G{code:g} ({NOT_CUT[code]}) is not read; post-process it as single moves")
    if deep not in state.cycle:
        raise path.error(f"cycle G{code:g} has no depth {deep}")
    beside = {letter: values[letter] for letter in AXES if letter in values and letter != deep}
    path.check_place(axis for axis in order[:2] if state.incremental or AXES[axis] not in beside)
    for _ in range(int(repeats)):
        target = state.target(beside, order[:2])
        with path.log.hole():
            _run_hole(code, target, order[2], path, expand)
    if not expand:
        path.log.note(f"drilling cycle G{code:g} is left out: the tool moves rapidly above the holes", path.line)


def _take_words(values: Mapping[str, float], path: PathWriter, axis: int) -> None:
    """Keep what a block says of its hole; in G91 R counts from where the cycle began, and the depth from R."""
    state, deep = path.state, AXES[axis]
    stated = values["R"] * state.scale + state.zero(axis) if "R" in values and not state.incremental else None
    start = _starting_level(path, axis, stated)
    for letter, name in (("R", "R"), (deep, deep)):
        if letter in values:
            value = values[letter] * state.scale
            from_level = start if name == "R" else state.cycle.get("R", start)
            state.cycle[name] = value + (from_level if state.incremental else state.zero(axis))
    for letter in "QIJ":
        if letter in values:
            state.cycle[letter] = abs(values[letter]) * state.scale
    if "I" in values and "K" in values:
        state.cycle["K"] = abs(values["K"]) * state.scale
    if "P" in values:
        state.cycle["P"] = values["P"]


def _starting_level(path: PathWriter, axis: int, stated: float | None = None) -> float:
    """Return the level at which the cycle began; where it is not known, the highest rapid so far or the level R.

    Raises:
        InputError: If the program states none of them.

    """
    state = path.state
    if state.cycle_start is None:
        known = path.height if path.height is not None else state.cycle.get("R", stated)
        if known is None and not path.muted:
            raise path.error("a drilling cycle begins where the height of the tool is not known and states no level R; "
                            "let a rapid move (G0) to a height come first")  # fmt: skip
        known = state.position[axis] if known is None else known
        path.log.note(f"a cycle begins where nobody knows the height: {known:g} is assumed", path.line)
        state.cycle_start = known
    return state.cycle_start


def _run_hole(code: float, target: Point, axis: int, path: PathWriter, expand: bool) -> None:
    """Carry out one hole."""
    state = path.state
    start = _starting_level(path, axis)
    clear = state.cycle.get("R", start)
    bottom = state.cycle[AXES[axis]]
    top = max(start, clear) if state.retract_to_start else clear

    def at(level: float) -> Point:
        return _replace(target, axis, level)

    level = max(start if axis in state.lost else state.position[axis], clear)
    state.known.add(axis)
    state.lost.discard(axis)
    if level > state.position[axis] and state.knows_position():
        path.rapid(_replace(state.position, axis, level) if not state.lost else at(level))
    path.rapid(at(level))
    if expand:
        path.rapid(at(clear))
        path.begin_cut()
        if path.start_cut(at(bottom)):
            _cut_hole(code, at, clear, bottom, path)
            if code in FEED_BACK:
                path.cut_line(at(clear), _feed(state, abs(clear - bottom)))
            if code in TAPPING and state.turning:
                path.log.happen(TAPPING[code][1], path.line, value=state.spindle)
    path.rapid(at(top))


def _cut_hole(code: float, at: Callable[[float], Point], clear: float, bottom: float, path: PathWriter) -> None:
    """Cut a hole from the level R to its bottom, in pecks where the cycle has them."""
    state, depth = path.state, clear
    for deeper in _list_pecks(code, clear, bottom, state, path):
        path.cut_line(at(deeper), _feed(state, abs(depth - deeper)))
        depth = deeper
        if deeper != bottom:
            path.rapid(at(clear if code == 83.0 else min(deeper + PECK_CLEARANCE_MM, clear)))
            if code == 83.0:
                path.rapid(at(min(deeper + PECK_CLEARANCE_MM, clear)))
    if code in DWELLING and state.cycle.get("P", 0.0) > 0.0:
        wait = state.cycle["P"]  # from 100 on it counts in milliseconds
        path.log.happen("dwell", path.line, value=wait if wait < 100.0 else wait * 1e-3)
    if code in TAPPING and state.turning:
        path.log.happen(TAPPING[code][0], path.line, value=state.spindle)


def _list_pecks(code: float, clear: float, bottom: float, state: State, path: PathWriter) -> list[float]:
    """Return the depths of a hole: pecks of Q, or from I by J less each time down to K (Haas), and the bottom."""
    words = state.cycle
    first = words.get("I", words.get("Q", 0.0))
    if code not in (73.0, 83.0) or first <= 0.0 or bottom >= clear:
        return [bottom]
    path.log.note(PECK_NOTE, path.line)
    least = words.get("K", first) if "I" in words else first
    if (clear - bottom) / max(least, 1e-9) > MOST_PECKS:
        raise path.error(f"a hole of more than {MOST_PECKS} pecks, of {least:g} mm")
    depths, peck = [clear], first
    while depths[-1] - peck > bottom + min(LEAST_PECK_MM, 0.1 * peck):
        depths.append(depths[-1] - peck)
        peck = max(peck - words.get("J", 0.0), least) if "I" in words else peck
    return [*depths[1:], bottom]


def _replace(point: Point, axis: int, value: float) -> Point:
    moved = list(point)
    moved[axis] = value
    return moved[0], moved[1], moved[2]


def _feed(state: State, length: float) -> float:
    return state.feed_mm_s(length) or 0.0
