"""Drilling cycles: holes and hole patterns of all dialects; G73 to G89 of G-code, CYCLE8x and HOLESx of Sinumerik."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, set_levels
from compplan.toolpath.readers.cnc.course import Course
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import AXES, CncBlock
from compplan.toolpath.readers.frames import DEEP_AXIS, PLANE_AXES, Frame, rotate

#: Greatest number of holes of one block or pattern, and of pecks of one hole.
MOST_HOLES = 10_000
MOST_PECKS = 10_000
#: Clearance above the previous depth on return (G83), and retract after each peck (G73), of deep-hole cycles. [mm]
PECK_CLEARANCE_MM = 0.254
#: Least depth of a separate last peck (at most a tenth of a peck); less is due to a Q rounded to 0.001 mm or
#: 0.0001 inch (assumed). [mm]
LEAST_PECK_MM = 0.005
SKIPPED = "is left out: the tool moves rapidly above the holes (option cycles)"
PECK_NOTE = (
    f"G83 comes back to {PECK_CLEARANCE_MM:g} mm above the depth before, G73 goes back by as much: "
    "assumed, the control's own setting is not in the file"
)
WITHOUT_PECKS = "the retracts between the pecks of a hole are left out: it is drilled in one move"
#: Cycles of G-code that retract at the feed, dwell at the bottom, and reverse the spindle there.
FEED_BACK = frozenset({74.0, 84.0, 85.0, 89.0})
DWELLING = frozenset({82.0, 89.0, 76.0, 88.0, 74.0, 84.0})
TAPPING = {74.0: ("spindle_cw", "spindle_ccw"), 84.0: ("spindle_ccw", "spindle_cw")}
NOT_CUT = {87.0: "back boring", 88.0: "boring with a retract by hand"}
#: Drilling cycles of Sinumerik, and whether the tool retracts from the hole at a feed.
DRILLING = {"CYCLE81": False, "CYCLE82": False, "CYCLE83": False, "CYCLE84": True, "CYCLE840": True, "CYCLE85": True,
            "CYCLE86": False, "CYCLE87": False, "CYCLE88": False, "CYCLE89": True}  # fmt: skip
PATTERNS = {"HOLES1", "HOLES2"}
REFUSED = re.compile(r"CYCLE\d+|POCKET\d|SLOT\d|LONGHOLE|HOLES\d|CONTPRON|CONTDCON")
#: Calls that do not affect the path.
SILENT_CALLS = frozenset((
    "ACCLIM", "BRISKA", "CLEARM", "COARSEA", "CYCLE60", "CYCLE832", "CYCLE996", "CYCLE9960", "CYCLE_HSC", "DELT",
    "DISPLOF", "DRIVEA", "EXTERN", "FGROUP", "FINEA", "FXS", "GETT", "GROUP_ADDEND", "GROUP_BEGIN", "GROUP_END",
    "INIT", "JERKLIM", "LIMS", "MSG", "RESET", "SETAL", "SETM", "SETMS", "SOFTA", "SPCOF", "SPCON", "START", "STOPRE",
    "VELOLIM", "WAITE", "WAITM", "WAITMC", "WAITS", "WORKPIECE", "WRITE",
))  # fmt: skip
#: Pitches of coarse metric threads by nominal diameter. [mm]
PITCHES = {3: 0.5, 4: 0.7, 5: 0.8, 6: 1.0, 8: 1.25, 10: 1.5, 12: 1.75, 14: 2.0, 16: 2.0, 18: 2.5, 20: 2.5, 22: 2.5,
           24: 3.0, 27: 3.0, 30: 3.5, 33: 3.5, 36: 4.0, 39: 4.0, 42: 4.5, 45: 4.5, 48: 5.0}  # fmt: skip
Numbers = list[float | None]


@dataclass
class Hole:
    """Hole along an axis of the program (0 to 2), from the level `clear`, where the feed begins, to `bottom` [mm].

    `top` is the retract level. `feed` and `out` are the feeds down and back to `clear`, None for a rapid retract
    [mm/s]. `pecks` are the levels of intermediate retracts, out of the hole (`lifts`) or by a short distance. A rapid
    retract may stop at `clear` (`by_clear`). `wait` is the dwell at the bottom [s]. `turn` are the senses of the
    spindle at the bottom and after the retract (tapping), "" if unchanged; `speed` its speed [1/min].
    """

    axis: int
    clear: float
    bottom: float
    top: float
    feed: float
    out: float | None = None
    pecks: Sequence[float] = ()
    lifts: bool = False
    by_clear: bool = False
    wait: float = 0.0
    turn: tuple[str, str] = ("", "")
    speed: float = 0.0


def drill(course: Course, hole: Hole, name: str) -> None:
    """Drill a hole at the position of the tool and retract; only retract to `top` if cycles are skipped."""
    if course.options.cycles == "expand":
        go_to_level(course, hole.axis, hole.clear)
        course.begin_cut()
        if not course.leave_out(set_levels(course.position, {hole.axis: hole.bottom})):
            place, log = course.position, course.log
            for deeper in (*hole.pecks, hole.bottom):
                course.line(set_levels(place, {hole.axis: deeper}), hole.feed)
                if deeper != hole.bottom:
                    back = min(deeper + PECK_CLEARANCE_MM, hole.clear)
                    for level in (hole.clear, back) if hole.lifts else (back,):
                        course.rapid(set_levels(place, {hole.axis: level}))
            if hole.wait > 0.0:
                log.add_event("dwell", value=hole.wait)
            if hole.turn[0]:
                log.add_event(hole.turn[0], value=hole.speed)
            if hole.out is not None:
                course.line(set_levels(place, {hole.axis: hole.clear}), hole.out)
            elif hole.by_clear:
                go_to_level(course, hole.axis, hole.clear)
            if hole.turn[1]:
                log.add_event(hole.turn[1], value=hole.speed)
    else:
        course.note(f"drilling cycle {name} {SKIPPED}")
    go_to_level(course, hole.axis, hole.top)


def go_to_level(course: Course, axis: int, level: float) -> None:
    """Move rapidly along an axis."""
    course.rapid(set_levels(course.position, {axis: level}), (axis,))


def list_pecks(clear: float, bottom: float, first: float, less: float, least: float) -> list[float]:
    """Return the levels of the pecks of a hole: depth `first`, each reduced by `less` to a minimum of `least`."""
    if (clear - bottom) / max(least, 1e-9) > MOST_PECKS:
        raise InputError(f"a hole of more than {MOST_PECKS} pecks, of {least:g} mm")
    depths, peck = [clear], first
    while depths[-1] - peck > bottom + min(LEAST_PECK_MM, 0.1 * peck):
        depths.append(depths[-1] - peck)
        peck = max(peck - less, least)
    return depths[1:]


def list_circle(centre: tuple[float, float], radius: float, start: float, step: float, count: int) -> list[Point]:
    """Return the positions of holes on a circle; angles in degrees."""
    angles = [math.radians(start + step * i) for i in range(_check(count))]
    return [(centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), 0.0) for angle in angles]


def list_grid(corner: tuple[float, float], turn: float, steps: tuple[float, float], counts: tuple[int, int],
              first: float = 0.0) -> list[Point]:  # fmt: skip
    """Return the positions of holes in rows, in zigzag order; the grid is rotated about the corner by `turn` [deg]."""
    turned = Frame(rotate(2, turn).rows, (*corner, 0.0))
    columns = range(_check(counts[0] * counts[1]) // counts[1])
    return [
        turned.apply((first + column * steps[0], row * steps[1], 0.0))
        for row in range(counts[1]) for column in (columns if row % 2 == 0 else reversed(columns))
    ]  # fmt: skip


def _check(count: int) -> int:
    if not 0 < count <= MOST_HOLES:
        raise InputError(f"pattern of {count} holes, 1 to {MOST_HOLES} are read")
    return count


def begin_cycle(it: Interpreter, code: float) -> None:
    """Begin a cycle of G-code; its initial level is kept until the cycle is cancelled."""
    state, axis = it.state, DEEP_AXIS[it.state.plane]
    if not state.cycle_code:
        state.cycle_start = None if axis in it.course.unknown else it.course.position[axis]
        state.cycle = {}
    state.cycle_code = code


def run_cycle(it: Interpreter, block: CncBlock) -> None:
    """Execute the holes of one block of G-code.

    The tool moves rapidly to each hole at its current level (or R if that is higher), then to the level R. It cuts
    to the bottom, in pecks of Q if the cycle has them, and retracts to R (G99) or to the initial level of the cycle
    (G98). R, Z, Q, P, I, J, K are modal, L (or K without I) is the number of repetitions.
    """
    state, values, code, axis = it.state, block.values, it.state.cycle_code, DEEP_AXIS[it.state.plane]
    deep, words = AXES[axis], it.state.cycle
    start = _find_start(it, axis, values["R"] * state.scale if "R" in values and not state.incremental else None)
    for letter in ("R", deep):  # in G91 R is relative to the initial level, and the depth to R
        if letter in values:
            base = (start if letter == "R" else words.get("R", start)) if state.incremental else 0.0
            words[letter] = values[letter] * state.scale + base
    for letter in "QIJK" if "I" in values else "QJ":
        if letter in values:
            words[letter] = abs(values[letter]) * state.scale
    if "P" in values:
        words["P"] = values["P"]
    if values.keys().isdisjoint(("X", "Y", "Z", "R", "RP", "AP")):
        return
    repeats = values.get("L", values.get("K", 1.0) if "I" not in words else 1.0)
    if repeats == 0.0:
        return
    if not 1.0 <= repeats <= MOST_HOLES:
        raise InputError(f"cycle with {repeats:.0f} repeats, at most {MOST_HOLES} are read")
    if it.options.cycles == "expand" and code in NOT_CUT:
        raise InputError(f"cycle G{code:g} ({NOT_CUT[code]}) is not read; post-process it as single moves")
    if deep not in words:
        raise InputError(f"cycle G{code:g} has no depth {deep}")
    beside = CncBlock({key: values[key] for key in ("X", "Y", "Z", "RP", "AP") if key in values and key != deep})
    named = () if state.incremental else it.motion.target(beside)[1]
    it.contour.refuse_open()
    it.course.check_place({0, 1, 2} - {axis} - set(named))
    for _ in range(int(repeats)):
        target, named = it.motion.target(beside)
        with it.log.hole():
            _run_hole(it, code, target, named, axis)


def _find_start(it: Interpreter, axis: int, stated: float | None = None) -> float:
    """Return the initial level of the cycle; if unknown, the highest rapid move so far or the level R."""
    state = it.state
    if state.cycle_start is None:
        known = it.course.level_of_height() if axis == 2 else None
        known = state.cycle.get("R", stated) if known is None else known
        if known is None and not it.course.suspended:
            raise InputError("a drilling cycle begins where the height of the tool is not known and states no level R; "
                             "let a rapid move (G0) to a height come first")  # fmt: skip
        state.cycle_start = it.course.position[axis] if known is None else known
        it.note(f"a cycle begins at an unknown height: {state.cycle_start:g} is assumed")
    return state.cycle_start


def _run_hole(it: Interpreter, code: float, target: Point, named: tuple[int, ...], axis: int) -> None:
    state, course, words = it.state, it.course, it.state.cycle
    start = _find_start(it, axis)
    clear, bottom = words.get("R", start), words[AXES[axis]]
    level = max(start if course.unknown.get(axis) else course.position[axis], clear)
    course.mark_known((axis,))
    if level > course.position[axis] and not course.unknown:
        course.rapid(set_levels(course.position, {axis: level}))
    course.rapid(set_levels(target, {axis: level}), named)
    feed, wait = it.motion.feed(abs(clear - bottom)), words.get("P", 0.0) if code in DWELLING else 0.0
    hole = Hole(
        axis, clear, bottom, max(start, clear) if state.retract_to_start else clear, feed,
        feed if code in FEED_BACK else None, lifts=code == 83.0,
        wait=wait if wait < 100.0 else wait * 1e-3,  # milliseconds from 100 on
        turn=TAPPING.get(code, ("", "")) if state.turning else ("", ""), speed=state.spindle,
    )  # fmt: skip
    first = words.get("I", words.get("Q", 0.0))  # Haas: I, reduced by J down to K
    pecks = it.options.cycles == "expand" and code in (73.0, 83.0) and first > 0.0 and bottom < clear
    if pecks and not course.suspended:
        it.note(PECK_NOTE)
        less, least = (words.get("J", 0.0), words.get("K", first)) if "I" in words else (0.0, first)
        hole.pecks = list_pecks(clear, bottom, first, less, least)
    drill(course, hole, f"G{code:g}")


class SinumerikCycles:
    """Drilling cycles of Sinumerik programs: CYCLE81 to 89 and 840, MCALL, HOLES1, HOLES2."""

    def __init__(self, it: Interpreter, evaluate: Callable[[str], float]) -> None:
        self.it, self.evaluate = it, evaluate
        #: Cycle that is called at every following position (MCALL).
        self.modal: tuple[str, Numbers] | None = None

    def run(self, called: str, arguments: list[str], *, modal: bool) -> bool:
        """Execute a cycle, or store a modal one for the following holes; return whether the call is a known one."""
        if called in SILENT_CALLS:
            return True
        if called not in DRILLING and called not in PATTERNS:
            if REFUSED.fullmatch(called):
                raise InputError(f"{called} is not read; write its moves out in the CAM system")
            return False
        numbers: Numbers = [None if not text or text[0] == '"' else self.evaluate(text) for text in arguments]
        numbers += [None] * (20 - len(numbers))
        if called in PATTERNS:
            self._drill_pattern(called, [number or 0.0 for number in numbers])
        elif modal:
            self.modal = called, numbers
        else:
            self.drill(called, numbers)
        return True

    def drill(self, called: str, numbers: Numbers) -> None:
        """Execute CYCLE8x(RTP, RFP, SDIS, DP, DPR, ..): from RFP + SDIS to DP, retract to RTP.

        A non-zero DPR is the depth below RFP and replaces DP.
        """
        it, scale = self.it, self.it.state.scale
        it.contour.refuse_open()
        it.check_unit(numbers[:5])
        rtp, rfp, sdis, dp, dpr = (None if number is None else number * scale for number in numbers[:5])
        if rtp is None or (dp is None and not dpr):
            raise InputError(f"{called} states no retract plane or no depth, expected RTP, RFP, SDIS, DP, DPR")
        surface = rfp or 0.0
        sense = 1.0 if rtp >= surface else -1.0
        bottom = surface - sense * abs(dpr) if dpr else dp or 0.0
        if (bottom - surface) * sense > 0.0:
            raise InputError(f"{called} ends above its reference plane, expected a depth below RFP")
        state, size, pitch, speed = it.state, numbers[7], numbers[8], abs(numbers[10] or it.state.spindle)
        lead = abs(pitch) * scale if pitch else PITCHES.get(int(abs(size or 0.0)), 0.0)
        if called == "CYCLE84" and lead and speed:
            feed, out = lead * speed / 60.0, lead * abs(numbers[11] or speed) / 60.0
        elif called == "CYCLE85" and numbers[6]:
            feed, out = (state.to_mm_s(number) for number in (numbers[6], numbers[7] or numbers[6]))
        else:
            feed = out = it.motion.feed(0.0)
        axis, clear = DEEP_AXIS[it.state.plane], surface + sense * abs(sdis or 0.0)
        if called == "CYCLE83":
            it.note(WITHOUT_PECKS)
        with it.log.hole():
            drill(it.course, Hole(axis, clear, bottom, rtp, feed, out if DRILLING[called] else None), called)

    def _drill_pattern(self, called: str, n: list[float]) -> None:
        """Execute HOLES1 (a row) and HOLES2 (a circle) with the modal cycle."""
        if self.modal is None:
            raise InputError(f"{called}, and no drilling cycle is called before it (MCALL)")
        corner, count = (n[0], n[1]), int(n[5])
        if called == "HOLES1":  # SPCA, SPCO, STA1, FDIS, DBH, NUM
            places = list_grid(corner, n[2], (n[4], 0.0), (count, 1), n[3])
        else:  # CPA, CPO, RAD, STA1, INDA, NUM
            places = list_circle(corner, n[2], n[3], n[4] or 360.0 / max(count, 1), count)
        first, second = PLANE_AXES[self.it.state.plane]
        self.it.contour.refuse_open()
        for u, v, _ in places:
            levels = {first: u * self.it.state.scale, second: v * self.it.state.scale}
            self.it.course.rapid(set_levels(self.it.course.position, levels), (first, second))
            self.drill(*self.modal)
