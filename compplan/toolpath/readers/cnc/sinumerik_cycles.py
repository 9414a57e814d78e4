"""Cycles of Sinumerik programs: CYCLE81 to 89 and 840, MCALL, HOLES1, HOLES2, CYCLE801; others are refused."""

from __future__ import annotations

import re
from collections.abc import Callable

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import set_level
from compplan.toolpath.readers.cnc.cycles import Hole, drill, list_circle, list_grid
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import DEEP_AXIS, PLANE_AXES

#: Drilling cycles, and whether the tool leaves the hole with a feed.
DRILLING = {"CYCLE81": False, "CYCLE82": False, "CYCLE83": False, "CYCLE84": True, "CYCLE840": True, "CYCLE85": True,
            "CYCLE86": False, "CYCLE87": False, "CYCLE88": False, "CYCLE89": True}  # fmt: skip
PATTERNS = {"HOLES1", "HOLES2", "CYCLE801"}
REFUSED = re.compile(r"CYCLE\d+|POCKET\d|SLOT\d|LONGHOLE|HOLES\d|CONTPRON|CONTDCON")
#: Calls that say nothing of the path.
SILENT_CALLS = frozenset((
    "ACCLIM", "BRISKA", "CLEARM", "COARSEA", "CYCLE60", "CYCLE832", "CYCLE996", "CYCLE9960", "CYCLE_HSC", "DELT",
    "DISPLOF", "DRIVEA", "EXTERN", "FGROUP", "FINEA", "FXS", "GETT", "GROUP_ADDEND", "GROUP_BEGIN", "GROUP_END",
    "INIT", "JERKLIM", "LIMS", "MSG", "RESET", "SETAL", "SETM", "SETMS", "SOFTA", "SPCOF", "SPCON", "START", "STOPRE",
    "VELOLIM", "WAITE", "WAITM", "WAITMC", "WAITS", "WORKPIECE", "WRITE",
))  # fmt: skip
#: Pitches of coarse metric threads by their size. [mm]
PITCHES = {3: 0.5, 4: 0.7, 5: 0.8, 6: 1.0, 8: 1.25, 10: 1.5, 12: 1.75, 14: 2.0, 16: 2.0, 18: 2.5, 20: 2.5, 22: 2.5,
           24: 3.0, 27: 3.0, 30: 3.5, 33: 3.5, 36: 4.0, 39: 4.0, 42: 4.5, 45: 4.5, 48: 5.0}  # fmt: skip
Numbers = list[float | None]


class SinumerikCycles:
    """Carry out cycles."""

    def __init__(self, it: Interpreter, evaluate: Callable[[str], float], ask_for_unit: Callable[..., None]) -> None:
        self.it, self.evaluate, self.ask_for_unit = it, evaluate, ask_for_unit
        #: Cycle that is called at every place from here on (MCALL).
        self.modal: tuple[str, Numbers] | None = None

    def run(self, called: str, arguments: list[str], *, modal: bool) -> bool:
        """Carry out a cycle, or keep it for the holes that follow; return whether the call is one that is read."""
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
            self._drill(called, numbers)
        return True

    def drill_here(self) -> None:
        """Drill with the modal cycle after a block that moved the tool."""
        if self.modal is not None:
            self._drill(*self.modal)

    def _drill(self, called: str, numbers: Numbers) -> None:
        """Carry out CYCLE8x(RTP, RFP, SDIS, DP, DPR, ..): from RFP + SDIS to DP, back to RTP.

        DPR, where it is not 0, is the depth below RFP in place of DP.
        """
        it, scale = self.it, self.it.state.scale
        it.contour.refuse_open()
        self.ask_for_unit(numbers[:5])
        rtp, rfp, sdis, dp, dpr = (None if number is None else number * scale for number in numbers[:5])
        if rtp is None or (dp is None and not dpr):
            raise InputError(f"{called} states no retract plane or no depth, expected RTP, RFP, SDIS, DP, DPR")
        surface = rfp or 0.0
        sense = 1.0 if rtp >= surface else -1.0
        bottom = surface - sense * abs(dpr) if dpr else dp or 0.0
        if (bottom - surface) * sense > 0.0:
            raise InputError(f"{called} ends above its reference plane, expected a depth below RFP")
        feed, out = self._find_feeds(called, numbers)
        axis, clear = DEEP_AXIS[it.state.plane], surface + sense * abs(sdis or 0.0)
        with it.log.hole():
            it.course.rapid(set_level(it.course.position, axis, clear), (axis,))
            hole = Hole(axis, clear, bottom, rtp, feed, out if DRILLING[called] else None)
            drill(it.course, hole, expand=it.options.cycles == "expand", name=called)

    def _find_feeds(self, called: str, numbers: Numbers) -> tuple[float, float]:
        """Return feed into and out of a hole in mm/s."""
        state = self.it.state
        if called == "CYCLE84":
            size, pitch, speed, back = numbers[7], numbers[8], numbers[10], numbers[11]
            lead = abs(pitch) * state.scale if pitch else PITCHES.get(int(abs(size or 0.0)), 0.0)
            speed = abs(speed) if speed else state.spindle
            if lead and speed:
                return lead * speed / 60.0, lead * abs(back or speed) / 60.0
        if called == "CYCLE85" and numbers[6]:
            return numbers[6] * state.feed_scale / 60.0, (numbers[7] or numbers[6]) * state.feed_scale / 60.0
        feed = self.it.motion.feed(0.0)
        return feed, feed

    def _drill_pattern(self, called: str, n: list[float]) -> None:
        """Carry out HOLES1 (a row), HOLES2 (a circle) and CYCLE801 (a grid) with the modal cycle."""
        if self.modal is None:
            raise InputError(f"{called}, and no drilling cycle is called before it (MCALL)")
        corner, count = (n[0], n[1]), int(n[5])
        if called == "HOLES1":  # SPCA, SPCO, STA1, FDIS, DBH, NUM
            places = list_grid(corner, n[2], (n[4], 0.0), (count, 1), n[3])
        elif called == "HOLES2":  # CPA, CPO, RAD, STA1, INDA, NUM
            places = list_circle(corner, n[2], n[3], n[4] or 360.0 / max(count, 1), count)
        else:  # SPCA, SPCO, STA, DIS1, DIS2, NUM1, NUM2
            places = list_grid(corner, n[2], (n[3], n[4]), (count, int(n[6])))
        first, second = PLANE_AXES[self.it.state.plane]
        self.it.contour.refuse_open()
        for u, v, _ in places:
            place = set_level(self.it.course.position, first, u * self.it.state.scale)
            self.it.course.rapid(set_level(place, second, v * self.it.state.scale), (first, second))
            self.drill_here()
