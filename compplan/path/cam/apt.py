"""APT cutter location files (ISO 4343): GOTO and arcs in their dialects, feeds and units."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from compplan.errors import InputError
from compplan.path.cam.apt_cycles import FEED_OUT, Cycle, read_cycle
from compplan.path.cam.apt_words import NUMBER, read_numbers, split_fields, split_records
from compplan.path.cam.arcs import Arc, Point, arc_about, combine, cross, dot, fits_circle
from compplan.path.cam.lines import count_lines
from compplan.path.cam.moves import CamFile, MoveLog
from compplan.path.cam.options import CamTable

INCH = 25.4
REFUSED = {
    "COPY": "repeated paths", "TRACUT": "transformed paths", "MACRO": "macros", "CALL": "macros", "LOOPST": "loops",
    "SPLINE": "splines", "BSPLINE": "splines", "POCKET": "pocket cycles", "GOLFT": "part programs",
    "GORGT": "part programs", "GOUP": "part programs", "GODOWN": "part programs", "GOBACK": "part programs",
    "GO": "part programs", "HELIX": "helix records", "REFSYS": "transformed paths", "MIRROR": "mirrored paths",
    "SCALE": "scaled paths",
}
SILENT = {
    "PARTNO", "PPRINT", "MACHIN", "TOOL PATH", "TLDATA", "LOADTL", "LOAD", "SELECT", "COOLNT", "CUTTER", "INTOL",
    "TOLER", "OUTTOL", "PAINT", "DISPLAY", "END-OF-PATH", "FINI", "TPRINT", "INSERT", "DELAY", "DWELL", "OPSTOP",
    "STOP", "PREFUN", "AUXFUN", "SEQNO", "REWIND", "MULTAX", "END", "LEADER", "CLEARP", "REMARK", "TITLES", "CLDIST",
    "PROBE", "CLRSRF", "OPSKIP", "TLCOMP", "CUTCOM", "ARCSLP", "LINTOL", "MAXDPM", "MAXANG", "DISPLY", "PROGRAM",
    "SPINDL",
}
PLAIN_TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "TITLES", "TOOL PATH", "LETTER")
#: mm/s for one unit of feed; None: a revolution of the spindle.
FEED_UNITS = {
    "MMPM": 1.0 / 60.0, "MMPMIN": 1.0 / 60.0, "MPM": 1000.0 / 60.0, "MMPS": 1.0, "IPM": INCH / 60.0,
    "FPM": 12 * INCH / 60.0,
}
REVOLUTION_UNITS = {"MMPR": 1.0, "IPR": INCH, "PERREV": None, "UPR": None}
CLOCKWISE = {"CLW", "CLOCKWISE", "CW"}
ANTICLOCKWISE = {"CCLW", "CCW", "ANTICLOCKWISE", "COUNTERCLOCKWISE"}
#: Greatest number of turns of one arc.
MOST_TURNS = 10_000
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
    reader = _Reader(file, options, flipped=False)
    reader.run(text)
    forwards, backwards = reader.votes
    if options.circle_sense == "auto" and backwards >= FEWEST_VOTES and backwards > 4 * forwards:
        reader = _Reader(file, options, flipped=True)
        reader.run(text)
        note = "arcs run against the usual sense of their axis: only so they leave the moves before them smoothly"
        reader.log.note(note, 1)
    return reader.log.finish(file, "apt", reader.unit or "not stated", count_lines(text))


@dataclass(frozen=True)
class Pending:
    """Hold an arc record until the point that ends it: a point of its axis [mm], the axis, sense, turns, radius."""

    centre: Point
    normal: Point
    right_hand: bool
    turns: int = 1
    radius: float | None = None


class _Reader:
    """Follow a file record by record."""

    def __init__(self, file: Path, options: CamTable, *, flipped: bool) -> None:
        self.file, self.options, self.flipped = file, options, flipped
        self.log = MoveLog(options.chord_tolerance_mm)
        self.scale = INCH if options.unit == "inch" else 1.0
        self.unit = ""
        self.line = 0
        self.feed: float | None = None
        self.revolution_feed: float | None = None
        self.spindle = 0.0
        self.rapid = self.placed = self.nx = False
        self.cycle: Cycle | None = None
        self.arc: Pending | None = None
        self.direction: Point | None = None
        self.before: Point | None = None
        self.frames: set[str] = set()
        self.votes = [0, 0]

    def error(self, message: str) -> InputError:
        return InputError(message, file=self.file, where=self.line)

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
            if major.startswith(PLAIN_TEXT):
                self.nx = self.nx or major.startswith("TOOL PATH")
                continue
            if major == "FINI":
                break
            self._carry_out(major, minor.strip(), record)
        if not self.unit:
            self.log.note(f"no unit is stated (UNITS): {self.options.unit or 'mm'} is assumed", 1)

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
            self.log.note("cutter compensation is not applied: the path is taken as programmed", self.line)
        elif major == "GOHOME":
            self.log.note("GOHOME is left out", self.line)
        elif major not in SILENT:
            self.log.note(f"record {major[:20]} is not read", self.line)

    def _numbers(self, minor: str) -> list[float]:
        """Return the numbers of a record that may hold words as well."""
        return [field for field in split_fields(minor) if not isinstance(field, str)] if minor else []

    def _axis(self, vector: list[float]) -> Point:
        length = math.hypot(*vector)
        if len(vector) != 3 or not 1e-3 < length < 1e3:
            raise self.error(f"tool axis {vector} is no direction")
        return vector[0] / length, vector[1] / length, vector[2] / length

    def _point(self, numbers: list[float]) -> tuple[Point, Point]:
        """Return tip and tool axis of a record; the axis stays where it is not given."""
        if len(numbers) not in (2, 3, 6) and len(numbers) < 6:
            raise self.error(f"{len(numbers)} numbers, expected x, y, z or x, y, z, i, j, k")
        x, y, z = [*numbers, self.log.position[2] / self.scale][:3]
        axis = self._axis(numbers[3:6]) if len(numbers) >= 6 else self.log.axis
        return (x * self.scale, y * self.scale, z * self.scale), axis

    def _shift(self, numbers: list[float]) -> None:
        if len(numbers) not in (1, 3):
            raise self.error(f"{len(numbers)} numbers, expected dx, dy, dz or a distance along the tool axis")
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
        self.unit = "inch" if inch else "mm"
        self.scale = INCH if inch else 1.0
        self.log.note(f"no unit is stated before the first feed: {self.unit} is taken from it", self.line)

    def _speed(self) -> float:
        """Return the feed in mm/s, 0 where none is known."""
        feed = self.feed
        if self.revolution_feed is not None:
            feed = self.revolution_feed * self.spindle / 60.0 if self.spindle > 0.0 else None
        if feed is None:
            self.log.note("cutting moves before any feed have none", self.line)
        return feed or 0.0

    def _set_cycle(self, major: str, words: str) -> None:
        if major != "CYCLE":
            self.log.note(f"record {major[:20]} is not read", self.line)
            return
        self.cycle = None
        if not words.startswith(("OFF", "NOMORE", "ON")):
            self.cycle = read_cycle(split_fields(words))
            if self.options.cycles == "expand" and self.cycle.feed:
                self._set_feed(self.cycle.feed)

    def _drill(self, cycle: Cycle, point: Point, axis: Point) -> None:
        """Go to a hole, and cut it where holes are cut; pecks, dwells and turned tools are left out."""
        log = self.log
        log.counts["cycles"] += 1
        if self.options.cycles != "expand":
            log.note("drilling cycles are left out: the tool moves rapidly above the holes (option cycles)", self.line)
            log.rapid(point, axis)
            return
        if cycle.depth is None:
            raise self.error(f"CYCLE/{cycle.kind} states no depth (DEPTH, FEDTO), so its holes cannot be cut")
        above = combine(1.0, point, cycle.clear * self.scale, axis)
        log.rapid(above, axis)
        log.line(combine(1.0, point, -cycle.depth * self.scale, axis), self._speed(), axis)
        if cycle.kind.startswith(tuple(FEED_OUT)):
            log.line(above, self._speed(), axis)
        else:
            log.rapid(above, axis)

    def _change_frame(self, major: str, minor: str) -> None:
        if major in ("TRANS", "ROTABL", "ROTATE", "ROTHED"):
            if any(self._numbers(minor)):
                raise self.error(f"{major}/{minor[:30]} turns or shifts the path and is not read; write the path out")
            return
        self.frames.add(re.sub(r"\s", "", minor))
        if len(self.frames) > 1:
            self.log.note(f"{major} changes on the way: all coordinates are taken in one frame", self.line)

    def _goto(self, numbers: list[float]) -> None:
        """Move to a point: rapidly, above a hole, along a pending arc, or straight."""
        point, axis = self._point(numbers)
        start = self.log.position
        rapid, self.rapid = self.rapid, False
        arc, self.arc = self.arc, None
        if self.cycle is not None:
            self._drill(self.cycle, point, axis)
        elif rapid:
            self.log.rapid(point, axis)
        elif not self.placed:
            self.log.note("the first GOTO is where the path begins", self.line)
            self.log.place(point, axis)
        elif arc is not None:
            self._cut_arc(arc, start, point, axis)
            self.placed = True
            return
        else:
            self.log.line(point, self._speed(), axis)
        self.placed = True
        length = math.dist(point, start)
        self.before = combine(1.0 / length, point, -1.0 / length, start) if length > 1e-6 and not rapid else None

    def _note_arc(self, words: str) -> None:
        """Keep an arc record until the GOTO that ends it."""
        if re.match(r"\s*[XYZIJKR]\s*,", words):
            self._cut_lettered(words)
            return
        if "(" in words:
            raise self.error(f"arc record {words[:40]!r} is not read, expected x, y, z, i, j, k, r")
        angle = re.search(r"ANGLE\s*,\s*([-+.\d]+)", words)
        times = re.search(r"TIMES\s*,\s*([\d.]+)", words)
        plain = re.sub(r",?\s*(ANGLE|TIMES)\s*,\s*[-+.\d]+", "", words).strip(", ")
        numbers = self._numbers(plain)
        if len(numbers) < 6:
            raise self.error(f"arc record with {len(numbers)} numbers, expected x, y, z, i, j, k, r")
        found = set(re.findall(r"[A-Z]+", plain))
        clockwise = bool(found & CLOCKWISE) or (not found & ANTICLOCKWISE and (self.nx or len(numbers) >= 11))
        if self.options.circle_sense != "auto":
            clockwise = self.options.circle_sense == "left_hand"
        count = float(times.group(1)) if times else 1.0
        if angle:
            count = abs(float(angle.group(1))) / 360.0 - 1e-6
        if count > MOST_TURNS:
            raise self.error(f"arc of {count:g} turns, at most {MOST_TURNS} are read")
        turns = math.ceil(count) if angle else int(count)
        radius = numbers[6] * self.scale if len(numbers) > 6 else None
        centre, normal = self._scaled(numbers), self._axis(numbers[3:6])
        self.arc = Pending(centre, normal, clockwise == self.flipped, max(1, turns), radius)

    def _cut_lettered(self, words: str) -> None:
        """Cut along CIRCLE/X,x,Y,y,Z,z,I,i,J,j,K,k[,CCLW]: end and centre from the start; clockwise."""
        pairs = re.findall(r"([XYZIJK])\s*,\s*([-+]?(?:\d+\.?\d*|\.\d+))", words)
        values = {letter: float(number) * self.scale for letter, number in pairs}
        if not values.keys() & set("IJK"):
            raise self.error(f"arc record {words[:40]!r} has no centre, expected I, i, J, j, K, k")
        start = self.log.position
        x, y, z = (values.get(letter, old) for letter, old in zip("XYZ", start, strict=True))
        offset = (values.get("I", 0.0), values.get("J", 0.0), values.get("K", 0.0))
        anticlockwise = bool(set(re.findall(r"[A-Z]+", words)) & ANTICLOCKWISE)
        pending = Pending(combine(1.0, start, 1.0, offset), self.log.axis, anticlockwise)
        self._cut_arc(pending, start, (x, y, z), self.log.axis)

    def _follow_circle(self, words: str) -> None:
        """Read TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/x,y,z,x,y,z): the line ends where the arc ends (CATIA)."""
        circle = re.search(r"\(\s*CIRCLE\s*/([^()]*)\)", words)
        end = re.search(r"\(\s*(?:LINE|POINT)\s*/([^()]*)\)", words)
        centre = self._numbers(circle.group(1)) if circle else []
        last = self._numbers(end.group(1)) if end else []
        if len(centre) < 4 or len(last) < 3 or self.direction is None:
            message = f"motion {words[:40]!r} is not read, expected INDIRV and GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/..)"
            raise self.error(message)
        start, middle, normal = self.log.position, self._scaled(centre), self.log.axis
        right_hand = dot(cross(normal, combine(1.0, start, -1.0, middle)), self.direction) > 0.0
        self._cut_arc(Pending(middle, normal, right_hand), start, self._scaled(last[-3:]), normal)

    def _scaled(self, numbers: list[float]) -> Point:
        """Return the first three numbers as a point in millimetres."""
        return numbers[0] * self.scale, numbers[1] * self.scale, numbers[2] * self.scale

    def _cut_arc(self, pending: Pending, start: Point, end: Point, axis: Point) -> None:
        """Cut along an arc, and keep how it leaves for the arc after it."""
        arc = arc_about(
            start, end, pending.centre, pending.normal, right_hand=pending.right_hand, turns=pending.turns
        )
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its axis and ends {arc.end_radius:.4f} mm from it"
            raise self.error(f"{message}, expected the same radius")
        if pending.radius is not None and abs(pending.radius - arc.radius) > max(0.1, 0.02 * arc.radius):
            message = f"an arc record states the radius {pending.radius:g} mm, its points lie on {arc.radius:.4g} mm"
            self.log.note(f"{message}: the points are taken", self.line)
        self._vote(arc)
        self.log.arc(arc, end, self._speed())
        if max(abs(one - other) for one, other in zip(axis, self.log.axis, strict=True)) > 1e-6:
            self.log.note("the tool axis turns at the end of an arc, not along it", self.line)
            self.log.line(end, self._speed(), axis)
        self.before = arc.tangent(arc.sweep)

    def _vote(self, arc: Arc) -> None:
        """Count whether an arc goes on from the move before it, or turns back on it."""
        if self.before is None:
            return
        along = dot(arc.tangent(0.0), self.before)
        if abs(along) > 0.99:
            self.votes[0 if along > 0.0 else 1] += 1
