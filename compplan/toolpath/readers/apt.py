"""APT cutter location files (ISO 4343): GOTO and arcs in their dialects, feeds and units."""

from __future__ import annotations

import math
import re
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.apt_arcs import INCH, ArcReader
from compplan.toolpath.readers.apt_cycles import FEED_OUT, AptCycle, read_cycle
from compplan.toolpath.readers.apt_events import RECORDS, TEXT, AptMachine
from compplan.toolpath.readers.apt_words import NUMBER, read_numbers, split_fields, split_records
from compplan.toolpath.readers.arcs import Point, combine
from compplan.toolpath.readers.lines import count_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.start import refuse_unit

REFUSED = {
    "COPY": "repeated paths",
    "TRACUT": "transformed paths",
    "MACRO": "macros",
    "CALL": "macros",
    "LOOPST": "loops",
    "SPLINE": "splines",
    "BSPLINE": "splines",
    "POCKET": "pocket cycles",
    "GOLFT": "part programs",
    "GORGT": "part programs",
    "GOUP": "part programs",
    "GODOWN": "part programs",
    "GOBACK": "part programs",
    "GO": "part programs",
    "HELIX": "helix records",
    "REFSYS": "transformed paths",
    "MIRROR": "mirrored paths",
    "SCALE": "scaled paths",
    "INDEX": "repeated paths",
    "BSPLN": "splines",
    "PITCH": "threads",
    "PLUNGE": "plunge moves",
}
SILENT = {
    "MACHIN",
    "TLDATA",
    "SELECT",
    "CUTTER",
    "INTOL",
    "TOLER",
    "OUTTOL",
    "PAINT",
    "DISPLAY",
    "END-OF-PATH",
    "FINI",
    "SEQNO",
    "REWIND",
    "MULTAX",
    "END",
    "LEADER",
    "CLEARP",
    "CLDIST",
    "PROBE",
    "CLRSRF",
    "OPSKIP",
    "TLCOMP",
    "CUTCOM",
    "ARCSLP",
    "LINTOL",
    "MAXDPM",
    "MAXANG",
    "DISPLY",
    "PROGRAM",
    *RECORDS,
}
#: mm/s for one unit of feed; None: a revolution of the spindle.
FEED_UNITS = {
    "MMPM": 1.0 / 60.0,
    "MMPMIN": 1.0 / 60.0,
    "MPM": 1000.0 / 60.0,
    "MMPS": 1.0,
    "IPM": INCH / 60.0,
    "FPM": 12 * INCH / 60.0,
}
REVOLUTION_UNITS = {"MMPR": 1.0, "IPR": INCH, "PERREV": None, "UPR": None}
#: Tangent arcs that must speak against the sense that is assumed before it is turned round.
FEWEST_VOTES = 3


name = "apt"
suffixes = (".apt", ".cls", ".cl", ".ncl", ".clsf", ".aptsource", ".cldata")


def recognise(text: str) -> bool:
    """Tell whether a text of unknown suffix is APT/CL."""
    return re.search(r"^[ \t]*GOTO[ \t]*/", text, re.MULTILINE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read an APT cutter location file.

    The sense of an arc about the axis of its CIRCLE record follows from the words CLW and CCLW where there are any;
    clockwise in the long records of NX; by the right hand else. Where most arcs then leave the move before them
    backwards and none forwards, the sense is turned round, with a note.

    Args:
        text: The file.
        file: Its name, for messages.
        options: What the file does not say by itself.

    Raises:
        InputError: With file and line, if an arc is off its circle, or the file holds what is not read here: splines,
            macros, repeated or transformed paths, part programs whose geometry is not resolved.

    """
    reader = _AptReader(file, options, flipped=False)
    reader.run(text)
    forwards, backwards = reader.votes
    if options.circle_sense == "auto" and backwards >= FEWEST_VOTES and backwards > 4 * forwards:
        reader = _AptReader(file, options, flipped=True)
        reader.run(text)
        note = "arcs run against the usual sense of their axis: only so they leave the moves before them smoothly"
        reader.log.note(note, 1)
    return reader.log.finish(file, "apt", reader.unit or "not stated", count_lines(text))


class _AptReader(ArcReader):
    """Follow a file record by record."""

    def __init__(self, file: Path, options: CamTable, *, flipped: bool) -> None:
        super().__init__(file, options, flipped=flipped)
        self.cycle: AptCycle | None = None
        self.feed_before: tuple[float | None, float | None] = (None, None)
        self.frames: set[tuple[float, ...]] = set()
        #: Line of the first point.
        self.first = 0
        self.machine = AptMachine(self.log)

    def run(self, text: str) -> None:
        """Read every record.

        Raises:
            InputError: With the line, if a record is not what it has to be.

        """
        try:
            self._run(text)
        except ValueError as fault:
            raise self.error(str(fault)) from None
        except InputError as fault:
            raise fault if fault.file else self.error(fault.message) from None

    def _run(self, text: str) -> None:
        for self.line, record in split_records(text):
            major, _, minor = record.partition("/")
            major = re.sub(r"^N?\d+\s+", "", major.strip().upper())
            if major.startswith(TEXT):
                self.nx = self.nx or major.startswith("TOOL PATH")
                self.machine.tell(record, self.line)
                continue
            if major.startswith("INSERT"):
                self.log.note(f"text for the control is not read: {record[:40]!r}", self.line)
                continue
            if major == "FINI":
                break
            self._carry_out(major, minor.strip(), record)
        self.machine.end(self.line)
        if not self.unit and self.options.unit is None and self.first:
            self.line = self.first
            raise refuse_unit("UNITS, or a unit of FEDRAT")

    def _carry_out(self, major: str, minor: str, record: str) -> None:
        """Carry out one record."""
        if major == "GOTO":
            self._goto(read_numbers(minor))
        elif major == "GODLTA":
            self._shift(read_numbers(minor))
        elif major == "RAPID":
            self.rapid = True
        elif major in ("FEDRAT", "FEED"):
            self._set_feed(minor.upper())
        elif major == "SPINDL":
            self.spindle = float(next(iter(NUMBER.findall(minor)), self.spindle))
            self.machine.switch(major, minor.upper(), self.line)
        elif major in RECORDS:
            self.machine.switch(major, minor.upper(), self.line)
        elif major in ("UNITS", "UNIT"):
            self._set_unit(minor.upper())
        elif major == "FROM":
            point = self._point(read_numbers(minor))
            self.placed = True
            self.log.place(point[0], point[1])
        elif major == "TLAXIS":
            self.log.axis = self._axis(read_numbers(minor)[:3])
        elif major in ("CIRCLE", "MOVARC", "ARC"):
            self._note_arc(minor.upper())
        elif major == "INDIRV":
            self.direction = self._axis(read_numbers(minor)[:3])
        elif "GOFWD" in major:
            self._follow_circle(minor.upper())
        elif major.startswith("CYCLE"):
            self._set_cycle(major, minor.upper())
        elif major in ("MSYS", "CSYS", "ORIGIN", "TRANS", "ROTABL", "ROTATE", "ROTHED"):
            self._change_frame(major, minor)
        elif major.startswith("NURB"):
            raise self.error(f"{major} (NURBS) is not read; write the path out as GOTO and CIRCLE in the CAM system")
        elif major in REFUSED:
            raise self.error(f"{major} ({REFUSED[major]}) is not read; write the path out as GOTO and CIRCLE")
        elif major == "MODE" and "INCR" in minor.upper():
            raise self.error("MODE/INCR (incremental coordinates) is not read; write absolute coordinates")
        elif "=" in major or ("=" in record and major not in SILENT):
            raise self.error(f"part program statement {record[:40]!r} is not read, only cutter location files are")
        else:
            self._pass_over(major)

    def _pass_over(self, major: str) -> None:
        self.nx = self.nx or major == "TLDATA"
        if major in ("CUTCOM", "TLCOMP"):
            self.log.note(f"{major} is left out: the points of a cutter location file are the tool's", self.line)
        elif major == "GOHOME":
            self.log.note("GOHOME is left out", self.line)
            self.placed, self.away = False, True
        elif major not in SILENT:
            self.log.note(f"record {major[:20]} is not read", self.line)

    def _point(self, numbers: list[float]) -> tuple[Point, Point]:
        """Return tip and tool axis of a record; the axis stays where it is not given."""
        if len(numbers) not in (2, 3, 6) and len(numbers) < 6:
            raise self.error(f"{len(numbers)} numbers, expected x, y, z or x, y, z, i, j, k")
        if len(numbers) == 2 and not self.placed:
            raise self.error("x, y without z before any place of the tool is known, expected x, y, z")
        x, y, z = [*numbers, self.log.position[2] / self.scale][:3]
        axis = self._axis(numbers[3:6]) if len(numbers) >= 6 else self.log.axis
        return (x * self.scale, y * self.scale, z * self.scale), axis

    def _shift(self, numbers: list[float]) -> None:
        if len(numbers) not in (1, 3):
            raise self.error(f"{len(numbers)} numbers, expected dx, dy, dz or a distance along the tool axis")
        self.begin_cut(self.log.axis)
        axis = self.log.axis
        step = (numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else combine(numbers[0], axis, 0.0, axis)
        self._goto(list(combine(1.0 / self.scale, self.log.position, 1.0, step)))

    def _set_unit(self, words: str) -> None:
        unit = "inch" if words.startswith("IN") else "mm" if words.startswith(("MM", "MILLI")) else ""
        if not unit:
            raise self.error(f"unit {words!r}, choose from MM, INCHES")
        self.scale = INCH if unit == "inch" else 1.0
        self.unit = unit if self.unit in ("", unit) else "mm, inch"

    def _set_feed(self, words: str) -> None:
        numbers = self._numbers(words)
        if not numbers:
            self.log.note(f"feed {words[:20]!r} is not read", self.line)
            return
        self.revolution_feed = None
        for word in re.findall(r"[A-Z]+", words):
            if word in FEED_UNITS:
                self.feed = numbers[0] * FEED_UNITS[word]
                self._infer_unit(word.startswith("I"))
                return
            if word in REVOLUTION_UNITS:
                self.revolution_feed = numbers[0] * (REVOLUTION_UNITS[word] or self.scale)
                return
        self.feed = numbers[0] * self.scale / 60.0  # PERMIN, UPM, or no word at all
        if unknown := [word for word in re.findall(r"[A-Z]+", words) if word not in ("PERMIN", "UPM", "FEED")]:
            self.log.note(f"feed unit {unknown[0][:20]!r} is not known: feeds are taken per minute", self.line)
        if not re.search(r"[A-Z]", words):
            self.log.note("feeds without a unit are taken per minute", self.line)

    def _infer_unit(self, inch: bool) -> None:
        """Take the unit of lengths from that of the feed where none is stated."""
        if self.unit or self.options.unit:
            return
        if inch and (self.placed or self.log.waypoints):
            raise self.error("a feed in inches follows points whose unit is not stated; state it with --unit")
        self.unit = "inch" if inch else "mm"
        self.scale = INCH if inch else 1.0
        self.log.note(f"no unit is stated before the first feed: {self.unit} is taken from it", self.line)

    def _set_cycle(self, major: str, words: str) -> None:
        if major != "CYCLE":
            self.log.note(f"record {major[:20]} is not read", self.line)
            return
        if self.cycle is not None:
            self.feed, self.revolution_feed = self.feed_before
        self.cycle = None
        if not words.startswith(("OFF", "NOMORE", "ON")):
            self.feed_before = self.feed, self.revolution_feed
            self.cycle = read_cycle(split_fields(words))
            if self.options.cycles == "expand" and self.cycle.feed:
                self._set_feed(self.cycle.feed)

    def _drill(self, cycle: AptCycle, point: Point, axis: Point) -> None:
        """Go to a hole, and cut it where holes are cut; pecks, dwells and turned tools are left out."""
        log = self.log
        if self.options.cycles != "expand":
            log.note("drilling cycles are left out: the tool moves rapidly above the holes (option cycles)", self.line)
            log.rapid(point, axis)
            return
        if cycle.depth is None:
            raise self.error(f"CYCLE/{cycle.kind} states no depth (DEPTH, FEDTO), so its holes cannot be cut")
        above, begin = (combine(1.0, point, way * self.scale, axis) for way in (cycle.retract, cycle.clear))
        log.rapid(above, axis)
        log.rapid(begin, axis)
        log.line(combine(1.0, point, -cycle.depth * self.scale, axis), self._speed(), axis)
        if cycle.kind.startswith(tuple(FEED_OUT)):
            log.line(begin, self._speed(), axis)
        log.rapid(above, axis)

    def _change_frame(self, major: str, minor: str) -> None:
        if major in ("TRANS", "ROTABL", "ROTATE", "ROTHED"):
            if any(self._numbers(minor)):
                raise self.error(f"{major}/{minor[:30]} turns or shifts the path and is not read; write the path out")
            return
        self.frames.add(tuple(self._numbers(minor)))
        if len(self.frames) > 1 and major == "MSYS":
            raise self.error("MSYS changes on the way: points of several machine coordinate systems are not joined; "
                             "write one file a system, or all points in one")  # fmt: skip
        if len(self.frames) > 1:
            self.log.note(f"{major} changes on the way: all coordinates are taken in one frame", self.line)

    def _goto(self, numbers: list[float]) -> None:
        """Move to a point: rapidly, above a hole, along a pending arc, or straight."""
        point, axis = self._point(numbers)
        self.first = self.first or self.line
        rapid, self.rapid = self.rapid, False
        arc, self.arc = self.arc, None
        if not rapid and self.cycle is None:
            self.begin_cut(axis)
        start = self.log.position
        if self.cycle is not None:
            with self.log.hole():
                self._drill(self.cycle, point, axis)
        elif rapid:
            self.log.rapid(point, axis)
        elif arc is not None:
            self._cut_arc(arc, start, point, axis)
            self.placed = True
            return
        else:
            self.log.line(point, self._speed(), axis)
        self.placed = True
        length = math.dist(point, start)
        self.before = combine(1.0 / length, point, -1.0 / length, start) if length > 1e-6 and not rapid else None
