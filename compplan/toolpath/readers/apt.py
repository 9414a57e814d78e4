"""Reader of APT cutter location files (ISO 4343): GOTO, dialects of arcs, cycles, feeds, units, machine records."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.apt_words import NUMBER, AptCycle, find_numbers, read_cycle, read_numbers, split_records
from compplan.toolpath.readers.arcs import MOST_TURNS, Point, arc_about, combine, cross, dot, orient
from compplan.toolpath.readers.cnc.state import INCH, STARTING, STOPPING, Machine, State
from compplan.toolpath.readers.frames import UP
from compplan.toolpath.readers.lines import count_lines
from compplan.toolpath.readers.moves import CamFile, MoveLog
from compplan.toolpath.readers.options import CHORD_MM, CamTable, find_start, refuse_unit

name = "apt"
suffixes = (".apt", ".cls", ".cl", ".ncl", ".clsf", ".aptsource", ".cldata")

REFUSED = {
    "COPY", "INDEX", "TRACUT", "REFSYS", "MIRROR", "SCALE", "MACRO", "CALL", "LOOPST", "SPLINE", "BSPLINE", "BSPLN",
    "POCKET", "HELIX", "PITCH", "PLUNGE", "GOLFT", "GORGT", "GOUP", "GODOWN", "GOBACK", "GO",
}  # fmt: skip
#: Records that switch machine functions, that hold text, and that do not affect the path.
SWITCHES = {"SPINDL", "COOLNT", "LOADTL", "LOAD", "TLCHG", "DELAY", "DWELL", "STOP", "OPSTOP", "AUXFUN"}
TEXT = ("PARTNO", "PPRINT", "REMARK", "TPRINT", "TITLES", "TOOL PATH", "LETTER", "$$")
SILENT = {
    "MACHIN", "TLDATA", "SELECT", "CUTTER", "INTOL", "TOLER", "OUTTOL", "PAINT", "DISPLAY", "END-OF-PATH", "FINI",
    "SEQNO", "REWIND", "END", "LEADER", "CLEARP", "CLDIST", "PROBE", "CLRSRF", "OPSKIP", "TLCOMP", "CUTCOM",
    "ARCSLP", "LINTOL", "MAXDPM", "MAXANG", "DISPLY", "PROGRAM", *SWITCHES,
}  # fmt: skip
#: Units of feed in mm/min, and of feed per revolution in mm (None: the unit of length of the file).
FEED_UNITS = {"MMPM": 1.0, "MMPMIN": 1.0, "MPM": 1000.0, "MMPS": 60.0, "IPM": INCH, "FPM": 12 * INCH}
REVOLUTION_UNITS = {"MMPR": 1.0, "IPR": INCH, "PERREV": None, "UPR": None}
#: Cycles that retract from the hole at the feed.
FEED_OUT = ("BORE", "TAP", "REAM", "THREAD")
CLOCKWISE, ANTICLOCKWISE = {"CLW", "CLOCKWISE", "CW"}, {"CCLW", "CCW", "ANTICLOCKWISE", "COUNTERCLOCKWISE"}
#: Least number of arcs tangent in reverse before the assumed sense of rotation is reversed.
MIN_TANGENT_ARCS = 3


def recognise(text: str) -> bool:
    """Return whether a text is an APT cutter location file."""
    return re.search(r"^[ \t]*GOTO[ \t]*/", text, re.MULTILINE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read an APT cutter location file.

    The sense of an arc about the axis of its CIRCLE record is given by the words CLW and CCLW. Without them it is
    clockwise in the long records of NX and right-handed otherwise. If more than 80 % of the arcs tangent to the move
    before them then start in reverse, the sense of all arcs is reversed, with a note.
    """
    reader = _AptReader(options, flipped=False)
    for flipped in (False, True):
        reader = _AptReader(options, flipped=flipped)
        try:
            reader.run(text)
        except (InputError, ValueError) as fault:
            message = fault.message if isinstance(fault, InputError) else str(fault)
            raise InputError(message, file=file, where=reader.line) from None
        forwards, backwards = reader.tangent_counts
        if flipped or backwards < MIN_TANGENT_ARCS or backwards <= 4 * forwards:
            break
    if reader.flipped:
        note = "arcs are read against the usual sense of their axis, so that they are tangent to the moves before them"
        reader.log.note(note, 1)
    return reader.log.finish(file, name, ", ".join(reader.state.units) or "not stated", count_lines(text))


@dataclass(frozen=True)
class _Pending:
    """Arc record before its end point is known: a point on its axis [mm], the axis (right-handed) and turns."""

    centre: Point
    normal: Point
    turns: int = 1


class _AptReader:
    """Interpret a file record by record."""

    def __init__(self, options: CamTable, *, flipped: bool) -> None:
        self.options, self.flipped = options, flipped
        self.line = self.first = 0  # current line, line of the first point
        self.log, self.state = MoveLog(CHORD_MM, self), State(INCH if options.unit == "inch" else 1.0)
        self.note = self.log.note
        self.machine = Machine(self.state, self.log, frozenset(), frozenset())
        self.feed_before: tuple[float | None, int] = (None, 94)
        self.rapid = self.placed = self.nx = self.away = False
        self.cycle: AptCycle | None = None
        self.last_cycle = ""
        self.arc: _Pending | None = None
        self.direction: Point | None = None
        #: Direction at the end of the previous cut; number of arcs that start tangent to it, forwards and in reverse.
        self.before: Point | None = None
        self.tangent_counts = [0, 0]
        self.frames: set[tuple[float, ...]] = set()

    def run(self, text: str) -> None:
        """Interpret every record."""
        for self.line, record in split_records(text):
            major, _, minor = record.partition("/")
            major = re.sub(r"^N?\d+\s+", "", major.strip().upper())
            if major.startswith(TEXT):
                self.nx = self.nx or major.startswith("TOOL PATH")
                words = re.sub(r"^(PPRINT|REMARK|TPRINT|\$\$)\s*/?\s*", "", record.strip(), flags=re.IGNORECASE)
                if words:
                    self.log.add_event("comment", text=words)
            elif major.startswith("INSERT"):
                self.note(f"text for the control is not read: {record[:40]!r}")
            elif major == "FINI":
                break
            else:
                self._carry_out(major, minor.strip(), record)
        self.machine.end()
        if not self.state.unit_stated and self.options.unit is None and self.first:
            self.line = self.first
            raise refuse_unit("UNITS, or a unit of FEDRAT")

    def _carry_out(self, major: str, minor: str, record: str) -> None:
        """Execute one record."""
        if major in RECORDS:
            RECORDS[major](self, minor.upper())
        elif major in SWITCHES:
            self._switch(major, minor.upper())
        elif "GOFWD" in major:
            self._follow_circle(minor.upper())
        elif major in ("MSYS", "CSYS", "ORIGIN"):
            self.frames.add(tuple(find_numbers(minor)))
            if len(self.frames) > 1 and major == "MSYS":
                raise InputError("MSYS changes within the file: points of several machine coordinate systems are "
                                 "not joined; write one file per system, or all points in one")  # fmt: skip
            if len(self.frames) > 1:
                self.note(f"{major} changes on the way: all coordinates are taken in one frame")
        elif major in ("TRANS", "ROTABL", "ROTATE", "ROTHED"):
            if any(find_numbers(minor)):
                raise InputError(f"{major}/{minor[:30]} turns or shifts the path and is not read; write the path out")
        elif major.startswith("NURB") or major in REFUSED:
            raise InputError(f"{major} is not read; write the path out as GOTO and CIRCLE in the CAM system")
        elif major == "MODE" and "INCR" in minor.upper():
            raise InputError("MODE/INCR (incremental coordinates) is not read; write absolute coordinates")
        elif "=" in record and major not in SILENT:
            raise InputError(f"part program statement {record[:40]!r} is not read, only cutter location files are")
        elif major in ("CUTCOM", "TLCOMP"):
            self.note(f"{major} is left out: the points are taken as the tool's own, radius compensated already")
        elif major not in SILENT:
            missing = ": holes it drills are missing" if major.startswith("CYCLE") else ""
            self.note(f"record {major[:20]} is not read{missing}")
        self.nx = self.nx or major == "TLDATA"

    def _set_axes(self, words: str) -> None:
        """Refuse MULTAX/OFF while the tool is tilted: whether points without i, j, k keep its axis is not known."""
        if words.startswith("OFF") and self.log.axis != UP:
            raise InputError("MULTAX/OFF with a tilted tool is not read; state i, j, k in each GOTO, or TLAXIS before")

    def _go_home(self, words: str) -> None:
        self.note("GOHOME is left out")
        self.placed, self.away = False, True

    def _go_from(self, words: str) -> None:
        self.log.place(*self._point(read_numbers(words)))
        self.placed = True

    def _switch(self, major: str, words: str) -> None:
        """Execute a record that switches machine functions, as M codes do."""
        number = next((float(text) for text in NUMBER.findall(words)), None)
        code = {"STOP": 0.0, "OPSTOP": 1.0}.get(major, number)
        if major == "SPINDL":
            anticlockwise = re.search(r"\bC?CCLW\b|\bCCW\b|COUNTER", words)
            code = 5.0 if "OFF" in words or number == 0.0 else 4.0 if anticlockwise else 3.0
            self.state.spindle = self.state.spindle if code == 5.0 or number is None else number
        elif major == "COOLNT":
            code = 9.0 if "OFF" in words or "NONE" in words else 7.0 if "MIST" in words else 8.0
        if major in ("LOADTL", "LOAD", "TLCHG"):
            self.state.tool, self.state.tool_name = number or 0.0, "" if number is not None else words[:32]
            self.machine.change_tool()
        elif major in ("DELAY", "DWELL"):
            turns = 60.0 / self.state.spindle if "REV" in words and self.state.spindle > 0.0 else 1.0
            self.log.add_event("dwell", value=max(number or 0.0, 0.0) * turns)
        elif code in STARTING:
            self.machine.switch_on([code])
        elif code in STOPPING:
            self.machine.stop([code])
        else:
            self.note(f"AUXFUN/{words[:20]} is not read")

    def _begin_cut(self, axis: Point) -> None:
        """Begin a cut at the position of the tool; refuse it if the position is unknown."""
        if self.placed:
            return
        reason = "after GOHOME" if self.away else "no FROM or RAPID comes before it"
        start = find_start(self.log.position, range(3), self.options.from_mm, reason)
        if self.log.waypoints:
            self.log.rapid(start, axis)
        else:
            self.log.place(start, axis)
        self.placed = True

    def _point(self, numbers: list[float]) -> tuple[Point, Point]:
        """Return tip and tool axis of a record; without i, j, k the axis is unchanged."""
        if len(numbers) not in (2, 3, 6) and len(numbers) < 6:
            raise InputError(f"{len(numbers)} numbers, expected x, y, z or x, y, z, i, j, k")
        if len(numbers) == 2 and not self.placed:
            raise InputError("x, y without z before any place of the tool is known, expected x, y, z")
        x, y, z = [*numbers, self.log.position[2] / self.state.scale][:3]
        return self._scaled([x, y, z]), _axis(numbers[3:6]) if len(numbers) >= 6 else self.log.axis

    def _scaled(self, numbers: list[float]) -> Point:
        return numbers[0] * self.state.scale, numbers[1] * self.state.scale, numbers[2] * self.state.scale

    def _shift(self, numbers: list[float]) -> None:
        """Execute GODLTA: a displacement, or a distance along the tool axis."""
        if len(numbers) not in (1, 3):
            raise InputError(f"{len(numbers)} numbers, expected dx, dy, dz or a distance along the tool axis")
        axis = self.log.axis
        self._begin_cut(axis)
        step = (numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else combine(numbers[0], axis, 0.0, axis)
        self._goto(list(combine(1.0 / self.state.scale, self.log.position, 1.0, step)))

    def _set_unit(self, words: str) -> None:
        unit = "inch" if words.startswith("IN") else "mm" if words.startswith(("MM", "MILLI")) else ""
        if not unit:
            raise InputError(f"unit {words!r}, choose from MM, INCHES")
        self.state.set_unit(INCH if unit == "inch" else 1.0)

    def _set_feed(self, words: str) -> None:
        numbers, units = find_numbers(words), re.findall(r"[A-Z]+", words)
        if not numbers:
            self.note(f"feed {words[:20]!r} is not read")
            return
        state = self.state
        state.feed, state.feed_mode = numbers[0] * state.scale, 94  # PERMIN, UPM, or no word at all
        if unit := next((word for word in units if word in FEED_UNITS), ""):
            state.feed = numbers[0] * FEED_UNITS[unit]
            if not (state.unit_stated or self.options.unit):  # unit of lengths from the feed
                if unit[0] == "I" and (self.placed or self.log.waypoints):
                    raise InputError("a feed in inches follows points without a stated unit; state it with --unit")
                state.set_unit(INCH if unit[0] == "I" else 1.0)
                self.note(f"no unit is stated before the first feed: {state.units[0]} is taken from it")
        elif unit := next((word for word in units if word in REVOLUTION_UNITS), ""):
            state.feed, state.feed_mode = numbers[0] * (REVOLUTION_UNITS[unit] or state.scale), 95
        elif unknown := [word for word in units if word not in ("PERMIN", "UPM", "FEED")]:
            self.note(f"feed unit {unknown[0][:20]!r} is not known: feeds are taken per minute")
        elif not units:
            self.note("feeds without a unit are taken per minute")

    def _speed(self) -> float:
        """Return the feed in mm/s, 0 if unknown."""
        feed = self.state.feed_mm_s(0.0)
        if feed is None:
            self.note("cutting moves before any feed have none")
        return feed or 0.0

    def _set_cycle(self, words: str) -> None:
        if self.cycle is not None:
            self.state.feed, self.state.feed_mode = self.feed_before
        self.cycle = None
        if words.startswith("ON"):
            words = self.last_cycle or "OFF"
        if not words.startswith(("OFF", "NOMORE")):
            self.last_cycle = words
            self.feed_before = self.state.feed, self.state.feed_mode
            self.cycle = read_cycle(words)
            if self.options.cycles == "expand" and self.cycle.feed:
                self._set_feed(self.cycle.feed)

    def _drill(self, cycle: AptCycle, point: Point, axis: Point) -> None:
        """Move to a hole and cut it if cycles are expanded; pecks, dwells and spindle reversal are left out."""
        log = self.log
        if self.options.cycles != "expand":
            self.note("drilling cycles are left out: the tool moves rapidly above the holes (option cycles)")
            log.rapid(point, axis)
            return
        if cycle.depth is None:
            raise InputError(f"CYCLE/{cycle.kind} states no depth (DEPTH, FEDTO), so its holes cannot be cut")
        levels = (cycle.retract, cycle.clear, -cycle.depth)
        above, begin, bottom = (combine(1.0, point, level * self.state.scale, axis) for level in levels)
        log.rapid(above, axis)
        log.rapid(begin, axis)
        log.line(bottom, self._speed(), axis)
        if cycle.kind.startswith(FEED_OUT):
            log.line(begin, self._speed(), axis)
        log.rapid(above, axis)

    def _goto(self, numbers: list[float]) -> None:
        """Move to a point: rapidly, with a drilling cycle, along a pending arc, or straight."""
        point, axis = self._point(numbers)
        self.first = self.first or self.line
        rapid, self.rapid = self.rapid, False
        arc, self.arc = self.arc, None
        if not rapid and self.cycle is None:
            self._begin_cut(axis)
        start, self.placed = self.log.position, True
        if self.cycle is not None:
            with self.log.hole():
                self._drill(self.cycle, point, axis)
        elif rapid:
            self.log.rapid(point, axis)
        elif arc is not None:
            self._cut_arc(arc, start, point, axis)
            return
        else:
            self.log.line(point, self._speed(), axis)
        length = math.dist(point, start)
        self.before = combine(1.0 / length, point, -1.0 / length, start) if length > 1e-6 and not rapid else None

    def _note_arc(self, words: str) -> None:
        """Store an arc record until the GOTO with its end point."""
        if re.match(r"\s*[XYZIJKR(]", words):
            raise InputError(f"arc record {words[:40]!r} is not read, expected x, y, z, i, j, k, r")
        angle = re.search(r"ANGLE\s*,\s*([-+.\d]+)", words)
        times = re.search(r"TIMES\s*,\s*([\d.]+)", words)
        plain = re.sub(r",?\s*(ANGLE|TIMES)\s*,\s*[-+.\d]+", "", words).strip(", ")
        numbers = find_numbers(plain)
        if len(numbers) < 6:
            raise InputError(f"arc record with {len(numbers)} numbers, expected x, y, z, i, j, k, r")
        found = set(re.findall(r"[A-Z]+", plain))
        clockwise = bool(found & CLOCKWISE) or (not found & ANTICLOCKWISE and (self.nx or len(numbers) >= 11))
        count = abs(float(angle.group(1))) / 360.0 - 1e-6 if angle else float(times.group(1)) if times else 1.0
        if count > MOST_TURNS:
            raise InputError(f"arc of {count:g} turns, at most {MOST_TURNS} are read")
        turns = max(1, math.ceil(count) if angle else int(count))
        normal = orient(_axis(numbers[3:6]), right_hand=clockwise == self.flipped)
        self.arc = _Pending(self._scaled(numbers), normal, turns)

    def _follow_circle(self, words: str) -> None:
        """Read TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/x,y,z,x,y,z): the arc ends at the end of the line (CATIA)."""
        circle = re.search(r"\(\s*CIRCLE\s*/([^()]*)\)", words)
        end = re.search(r"\(\s*(?:LINE|POINT)\s*/([^()]*)\)", words)
        centre, last = (find_numbers(found.group(1)) if found else [] for found in (circle, end))
        if len(centre) < 4 or len(last) < 3 or self.direction is None:
            raise InputError(f"motion {words[:40]!r} is not read, expected INDIRV and GOFWD/(CIRCLE/..),ON,(LINE/..)")
        self._begin_cut(self.log.axis)
        start, middle, normal = self.log.position, self._scaled(centre), self.log.axis
        right_hand = dot(cross(normal, combine(1.0, start, -1.0, middle)), self.direction) > 0.0
        pending = _Pending(middle, orient(normal, right_hand=right_hand))
        self._cut_arc(pending, start, self._scaled(last[-3:]), normal)

    def _cut_arc(self, pending: _Pending, start: Point, end: Point, axis: Point) -> None:
        """Cut along an arc, and store its end direction for the next arc."""
        arc = arc_about(start, end, pending.centre, pending.normal, pending.turns)
        arc.check_circle()
        along = 0.0 if self.before is None else dot(arc.tangent(0.0), self.before)
        if abs(along) > 0.99:  # tangent to the previous move, forwards or in reverse
            self.tangent_counts[0 if along > 0.0 else 1] += 1
        self.log.arc(arc, end, self._speed())
        if max(abs(one - other) for one, other in zip(axis, self.log.axis, strict=True)) > 1e-6:
            self.note("the tool axis turns at the end of an arc, not along it")
            self.log.line(end, self._speed(), axis)
        self.before = arc.tangent(arc.sweep)


#: Operation of each record on the text after its slash, in capitals.
RECORDS: dict[str, Callable[[_AptReader, str], None]] = {
    "GOTO": lambda reader, words: reader._goto(read_numbers(words)),
    "GODLTA": lambda reader, words: reader._shift(read_numbers(words)),
    "RAPID": lambda reader, words: setattr(reader, "rapid", True),
    **dict.fromkeys(("FEDRAT", "FEED"), _AptReader._set_feed), **dict.fromkeys(("UNITS", "UNIT"), _AptReader._set_unit),
    "MULTAX": _AptReader._set_axes, "FROM": _AptReader._go_from, "GOHOME": _AptReader._go_home,
    "CYCLE": _AptReader._set_cycle,
    "TLAXIS": lambda reader, words: setattr(reader.log, "axis", _axis(read_numbers(words)[:3])),
    "INDIRV": lambda reader, words: setattr(reader, "direction", _axis(read_numbers(words)[:3])),
    **dict.fromkeys(("CIRCLE", "MOVARC", "ARC"), _AptReader._note_arc),
}  # fmt: skip


def _axis(vector: list[float]) -> Point:
    """Return a tool axis as a unit vector."""
    length = math.hypot(*vector)
    if len(vector) != 3 or not 1e-3 < length < 1e3:
        raise InputError(f"direction {vector}: expected three numbers i, j, k, not all 0")
    return vector[0] / length, vector[1] / length, vector[2] / length
