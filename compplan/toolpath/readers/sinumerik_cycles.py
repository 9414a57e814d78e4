"""Drilling cycles of Sinumerik programs: CYCLE81 to 89 and 840, MCALL, HOLES1, HOLES2, CYCLE801; refused ones."""

from __future__ import annotations

import math
import re
from pathlib import Path

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.sinumerik_frames import NORMALS, PLANES
from compplan.toolpath.readers.sinumerik_moves import SinumerikMoveReader

#: Drilling cycles, and whether the tool leaves the hole with a feed.
DRILLING = {"CYCLE81": False, "CYCLE82": False, "CYCLE83": False, "CYCLE84": True, "CYCLE840": True, "CYCLE85": True,
            "CYCLE86": False, "CYCLE87": False, "CYCLE88": False, "CYCLE89": True}  # fmt: skip
PATTERNS = {"HOLES1", "HOLES2", "CYCLE801"}
#: Calls that say nothing of the path.
SILENT_CALLS = {
    "ACCLIM", "BRISKA", "CLEARM", "COARSEA", "CYCLE60", "CYCLE832", "CYCLE996", "CYCLE9960", "CYCLE_HSC", "DELT",
    "DISPLOF", "DRIVEA", "EXTERN", "FGROUP", "FINEA", "FXS", "GETT", "GROUP_ADDEND", "GROUP_BEGIN", "GROUP_END", "INIT",
    "JERKLIM", "LIMS", "MSG", "RESET", "SETAL", "SETM", "SETMS", "SOFTA", "SPCOF", "SPCON", "START", "STOPRE",
    "VELOLIM", "WAITE", "WAITM", "WAITMC", "WAITS", "WORKPIECE", "WRITE",
}  # fmt: skip
MOST_HOLES = 10_000
#: Pitches of coarse metric threads by their size. [mm]
PITCHES = {3: 0.5, 4: 0.7, 5: 0.8, 6: 1.0, 8: 1.25, 10: 1.5, 12: 1.75, 14: 2.0, 16: 2.0, 18: 2.5, 20: 2.5, 22: 2.5,
           24: 3.0, 27: 3.0, 30: 3.5, 33: 3.5, 36: 4.0, 39: 4.0, 42: 4.5, 45: 4.5, 48: 5.0}  # fmt: skip


class SinumerikCycleReader(SinumerikMoveReader):
    """Carry out cycles."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.modal: tuple[str, list[float | None]] | None = None

    def run_cycle(self, called: str, arguments: list[str], *, modal: bool) -> bool:
        """Carry out a cycle, or keep it for the holes that follow; return whether the call is one."""
        if called in SILENT_CALLS:
            return True
        if called == "CYCLE800":
            self.run_cycle_800(arguments)
            return True
        if called not in DRILLING and called not in PATTERNS:
            if re.fullmatch(r"CYCLE\d+|POCKET\d|SLOT\d|LONGHOLE|HOLES\d|CONTPRON|CONTDCON", called):
                raise self.error(f"{called} is not read; write its moves out in the CAM system")
            return False
        numbers = [None if not text or text.startswith('"') else self.evaluate(text) for text in arguments]
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

    def _drill(self, called: str, numbers: list[float | None]) -> None:
        """Carry out CYCLE8x as one hole."""
        with self.log.hole():
            self._cut_hole(called, numbers)

    def _cut_hole(self, called: str, numbers: list[float | None]) -> None:
        """Carry out CYCLE8x(RTP, RFP, SDIS, DP, DPR, ..): from RFP + SDIS to DP, back to RTP.

        DPR, where it is not 0, is the depth below RFP in place of DP.
        """
        self.contour.refuse_open()
        self.ask_for_unit(numbers[:5])
        k = self.scale
        rtp, rfp, sdis, dp, dpr = (None if number is None else number * k for number in numbers[:5])
        if rtp is None or (dp is None and not dpr):
            raise self.error(f"{called} states no retract plane or no depth, expected RTP, RFP, SDIS, DP, DPR")
        surface = rfp or 0.0
        sense = 1.0 if rtp >= surface else -1.0
        bottom = surface - sense * abs(dpr) if dpr else dp or 0.0
        first = surface + sense * abs(sdis or 0.0)
        if (bottom - surface) * sense > 0.0:
            raise self.error(f"{called} ends above its reference plane, expected a depth below RFP")
        feed, out = self._cycle_feeds(called, numbers)
        axis = (NORMALS[self.plane].index(1.0),)
        self.course.rapid(self._level(first), axis)
        if self.options.cycles == "expand":
            self.course.line(self._level(bottom), axis, feed, self.line)
            if DRILLING[called]:
                self.course.line(self._level(first), axis, out, self.line)
        else:
            note = f"drilling cycle {called} is left out: the tool moves rapidly above the holes (option cycles)"
            self.log.note(note, self.line)
        self.course.rapid(self._level(rtp), axis)

    def _cycle_feeds(self, called: str, numbers: list[float | None]) -> tuple[float, float]:
        """Return feed into and out of a hole in mm/s."""
        k = self.scale
        if called == "CYCLE84":
            size, pitch, speed, back = numbers[7], numbers[8], numbers[10], numbers[11]
            lead = abs(pitch) * k if pitch else PITCHES.get(int(abs(size or 0.0)), 0.0)
            speed = abs(speed) if speed else self.spindle
            if lead and speed:
                return lead * speed / 60.0, lead * abs(back or speed) / 60.0
        if called == "CYCLE85" and numbers[6]:
            return numbers[6] * self.feed_scale / 60.0, (numbers[7] or numbers[6]) * self.feed_scale / 60.0
        feed = self.speed(0.0)
        return feed, feed

    def _level(self, height: float) -> Point:
        point = list(self.course.position)
        point[NORMALS[self.plane].index(1.0)] = height
        return point[0], point[1], point[2]

    def _drill_pattern(self, called: str, n: list[float]) -> None:
        """Carry out HOLES1 (a row), HOLES2 (a circle) and CYCLE801 (a grid) with the modal cycle."""
        if self.modal is None:
            raise self.error(f"{called}, and no drilling cycle is called before it (MCALL)")
        count = int(n[5]) * int(n[6]) if called == "CYCLE801" else int(n[5])
        if not 0 < count <= MOST_HOLES:
            raise self.error(f"{called} with {count} holes, 1 to {MOST_HOLES} are read")
        cosine, sine = math.cos(math.radians(n[2])), math.sin(math.radians(n[2]))
        if called == "HOLES1":  # SPCA, SPCO, STA1, FDIS, DBH, NUM
            places = [((n[3] + i * n[4]) * cosine, (n[3] + i * n[4]) * sine) for i in range(count)]
        elif called == "HOLES2":  # CPA, CPO, RAD, STA1, INDA, NUM
            step = n[4] or 360.0 / count
            angles = [math.radians(n[3] + i * step) for i in range(count)]
            places = [(n[2] * math.cos(at), n[2] * math.sin(at)) for at in angles]
        else:  # SPCA, SPCO, STA, DIS1, DIS2, NUM1, NUM2
            columns = int(n[5])
            grid = [divmod(i, columns) for i in range(count)]
            grid = [(row, column if row % 2 == 0 else columns - 1 - column) for row, column in grid]
            places = [(c * n[3] * cosine - r * n[4] * sine, c * n[3] * sine + r * n[4] * cosine) for r, c in grid]
        first, second = PLANES[self.plane]
        for u, v in places:
            point = list(self.course.position)
            point[first], point[second] = (n[0] + u) * self.scale, (n[1] + v) * self.scale
            self.contour.refuse_open()
            self.course.rapid((point[0], point[1], point[2]), (first, second))
            self.drill_here()
