"""APT and CL files read a second time: GOTO, GODLTA, circles, feeds and drilling cycles, as ISO 4343 and makers write.

A record is a major word, a slash and its words; `$` at the end of a line carries it on, `$$` begins a remark.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from tests.oracles.cam.moves import ARC, LINE, NAN, RAPID, CannotTellError, Reading, Recorder

INCH = 25.4
#: Unit of a feed: mm of the unit, and whether it counts by the turn.
FEEDS = {"MMPM": (1.0, False), "IPM": (INCH, False), "MMPR": (1.0, True), "IPR": (INCH, True)}
LENGTHS = {"MM": 1.0, "MILLIMETERS": 1.0, "IN": INCH, "INCH": INCH, "INCHES": INCH}
#: Records that move nothing of what is read here.
SILENT = re.compile(
    r"PARTNO|PPRINT|MACHIN|MULTAX|CUTTER|TLDATA|MSYS|TOOL PATH|PAINT|COOLNT|REWIND|END|FINI|STOP|OPSTOP|DELAY|INSERT|"
    r"AUXFUN|PREFUN|SEQNO|LEADER|DISPLY|TLCOMP|CUTCOM|WPLANE|REMARK|TPRINT|NOPOST|CLPRNT|INTOL|OUTTOL|TOLER|END-OF-PATH|"
    r"LOADTL|LOAD|SELECT|SELCTL|OPNAME|CATPROCESS|CATPRODUCT|PROBE"
)
#: Drilling cycles: those that draw chips in between, and those that come out with the feed.
HOLES = {"DRILL", "CSINK", "FACE", "DEEP", "DEEP2", "BRKCHP", "BRKCHP2", "TAP", "BORE", "REAM", "SPOT"}
PECKED, FED_OUT = {"DEEP", "DEEP2", "BRKCHP", "BRKCHP2"}, {"TAP", "BORE", "REAM"}
LABELS = {
    "DEPTH", "FEDTO", "CLEAR", "RAPTO", "RTRCTO", "STEP", "1STPECK", "SUBPECK", "DWELL", "INCR", "RETURN", "CSKDIA",
    "TIMES", "DELAY", "REPEAT", "CAM", "OFFSET",
}  # fmt: skip
#: Greatest difference of the radius along an arc. [mm]
ROUND = 0.02
#: Cosine of the angle between a line and the arc after it where they run on smoothly.
SMOOTH = 0.99
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?")
_CATIA = re.compile(r"(?:TLON,)?GOFWD/\(CIRCLE/([^()]*)\),ON,\(LINE/([^()]*)\)")
Vector = tuple[float, ...]


@dataclass(frozen=True)
class AptArc:
    """An arc that waits for its end.

    Attributes:
        centre: A point of its axis. [mm]
        normal: Its axis.
        clockwise: Whether it runs clockwise about the axis.
        turns: Further whole turns.
        said: Whether the sense is said in words or by the job.
    """

    centre: Vector
    normal: Vector
    clockwise: bool
    turns: int
    said: bool


@dataclass
class AptReader:
    """An interpreter of APT records.

    Args:
        scale: mm of a length.
        sense: "auto", "right_hand" or "left_hand": how the axis of CIRCLE tells the sense.
        expand: Whether drilling cycles are moves.

    """

    scale: float = 1.0
    sense: str = "auto"
    expand: bool = True
    record: Recorder = field(default_factory=Recorder)
    at: list[float] | None = None
    start: list[float] | None = None
    away: bool = False
    axis: Vector = (0.0, 0.0, 1.0)
    fast: bool = False
    feed: float = 0.0
    unit: tuple[float, bool] | None = None
    spindle: float = 0.0
    arc: AptArc | None = None
    ahead: Vector | None = None
    cycle: dict[str, float] | None = None
    kind: str = ""
    straight: Vector = ()
    votes: int = 0

    def run(self, text: str) -> Reading:
        """Read a whole file.

        Raises:
            CannotTellError: If something in it is not known here.

        """
        for line, words in _cut_records(text):
            self.record.line = line
            self.obey(words)
        if self.votes < 0:
            raise CannotTellError("the sense of arcs, most of which would turn back")
        return self.record.finish()

    def obey(self, text: str) -> None:
        """Carry out a record."""
        major, _, rest = text.partition("/")
        major, words = major.strip(), [word.strip() for word in rest.split(",")] if rest.strip() else []
        if major in ("GOTO", "FROM"):
            self.go([self._length(word) for word in words[:3]], words[3:], leads=major == "GOTO")
        elif major == "GODLTA":
            self.step(words)
        elif major == "RAPID":
            self.fast = True
        elif major == "FEDRAT":
            self.set_feed(words)
        elif major == "SPINDL":
            numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
            self.spindle = abs(numbers[0]) if numbers and not {"SFM", "SMM"} & set(words) else self.spindle
        elif major == "TLAXIS":
            self.axis = self._direction(words)
        elif major in ("CIRCLE", "MOVARC"):
            self.read_arc(words)
        elif major == "INDIRV":
            self.ahead = self._direction(words)
        elif match := _CATIA.fullmatch(text.replace(" ", "")):
            self.drive_circle(match[1].split(","), match[2].split(","))
        elif major == "CYCLE":
            self.read_cycle(words)
        elif major == "UNITS":
            if not words or words[0] not in LENGTHS:
                raise CannotTellError(f"UNITS/{rest}", self.record.line)
            self.scale = LENGTHS[words[0]]
        elif major in ("TRANS", "ROTATE", "ROTABL"):
            if any(float(word) for word in words if _NUMBER.fullmatch(word)):
                raise CannotTellError(f"{major}/{rest}", self.record.line)
        elif major == "GOHOME":
            self.record.note("GOHOME is no place of the part")
            self.away = True
        elif not SILENT.fullmatch(major) and not SILENT.match(text.split(" ")[0]):
            raise CannotTellError(f"the record {major[:30]}", self.record.line)
        if major in ("LOADTL", "LOAD") and (numbers := [float(w) for w in words if _NUMBER.fullmatch(w)]):
            self.record.tool = int(numbers[0])

    def _length(self, word: str) -> float:
        return self.scale * self._number(word)

    def _number(self, word: str) -> float:
        if not _NUMBER.fullmatch(word):
            raise CannotTellError(f"the word {word!r}", self.record.line)
        return float(word)

    def _direction(self, words: list[str]) -> Vector:
        vector = tuple(self._number(word) for word in words if word)
        if len(vector) != 3 or not math.hypot(*vector) > 0.0:
            raise CannotTellError("a direction without three numbers", self.record.line)
        return tuple(value / math.hypot(*vector) for value in vector)

    def set_feed(self, words: list[str]) -> None:
        """FEDRAT: a number and its unit, which stays for numbers alone."""
        named = [word for word in words if not _NUMBER.fullmatch(word)]
        numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
        for word in named:
            if word in FEEDS:
                self.unit = FEEDS[word]
            elif word in ("PERMIN", "PERREV"):
                self.unit = self.scale, word == "PERREV"
            else:
                raise CannotTellError(f"a feed in {word}", self.record.line)
        if numbers:
            self.feed = numbers[0]

    def speed(self) -> float:
        """Return the feed in force. [mm/s]"""
        factor, turn = self.unit or (self.scale, False)
        return self.feed * factor * (self.spindle if turn else 1.0) / 60.0

    def go(self, place: list[float], axis: list[str], *, leads: bool = True) -> None:
        """Move to a place, on the arc that waits or straight; or say where the tool starts."""
        if len(place) != 3:
            raise CannotTellError("a place without three numbers", self.record.line)
        if any(axis):
            self.axis = self._direction(axis[:3])
        if not leads:
            self.at = place
            return
        if self.away and self.start and not self.fast and self.cycle is None:
            self.record.move(RAPID, self.start, 0.0, self.axis)
            self.at = self.start
        self.away = False
        if self.cycle is not None:
            self.drill(place)
        elif self.arc is not None and self.at is not None:
            self._follow(self.arc, place)
        else:
            self._line(place)
        self.arc, self.fast = None, False

    def step(self, words: list[str]) -> None:
        """GODLTA: on by a vector, or by a length along the tool axis."""
        by = [self._length(word) for word in words]
        if self.at is None or len(by) not in (1, 3):
            raise CannotTellError("GODLTA from nowhere, or without one or three numbers", self.record.line)
        way = by if len(by) == 3 else [by[0] * value for value in self.axis]
        self.go([a + b for a, b in zip(self.at, way, strict=True)], [])

    def _line(self, place: list[float], *, rapid: bool | None = None, drill: bool = False, feed: float = NAN) -> None:
        fast = self.fast if rapid is None else rapid
        kind = RAPID if fast or self.at is None else LINE
        before = self.at or place
        if kind == LINE and not self.record.rows:
            self.record.move(RAPID, before, 0.0, self.axis)  # the cut begins where FROM says
        self.straight = tuple(b - a for a, b in zip(before, place, strict=True)) if kind == LINE else ()
        self.record.move(kind, place, self.speed() if math.isnan(feed) else feed, self.axis, drill=drill)
        self.at = place

    def read_arc(self, words: list[str]) -> None:
        """CIRCLE and MOVARC: centre, axis, radius; with further numbers (NX) it runs clockwise about its axis."""
        plain = [word for word in words if word not in ("CENTER", "AXIS", "RADIUS", "ON")]
        said = {"CLW": True, "CLOCKWISE": True, "CCLW": False, "COUNTERCLOCKWISE": False}
        sense = next((said[word] for word in plain if word in said), None)
        turns = int(float(plain[plain.index("TIMES") + 1])) - 1 if "TIMES" in plain else 0
        ends = [k for k, word in enumerate(plain) if not _NUMBER.fullmatch(word)]
        numbers = [float(word) for word in plain[: ends[0] if ends else None]]
        if len(numbers) not in (7, 11):
            raise CannotTellError(f"a circle of {len(numbers)} numbers", self.record.line)
        clockwise = len(numbers) == 11 if sense is None else sense
        if self.sense != "auto":
            clockwise = self.sense == "left_hand"
        normal = self._direction([str(value) for value in numbers[3:6]])
        centre = tuple(self.scale * value for value in numbers[:3])
        self.arc = AptArc(centre, normal, clockwise, turns, sense is not None or self.sense != "auto")

    def drive_circle(self, circle: list[str], line: list[str]) -> None:
        """GOFWD along a circle of CATIA up to the end of a line from its centre; INDIRV says which way it begins."""
        centre = [self._length(word) for word in circle[:3]]
        end = [self._length(word) for word in line[3:6]]
        if self.at is None or self.ahead is None or len(circle) != 4 or len(line) != 6:
            raise CannotTellError("GOFWD without a place, a direction or a centre", self.record.line)
        arm = [a - c for a, c in zip(self.at, centre, strict=True)]
        normal = _cross(arm, self.ahead)
        if math.hypot(*normal) < 0.5 * math.hypot(*arm):
            raise CannotTellError("GOFWD along no tangent", self.record.line)
        self._follow(AptArc(tuple(centre), tuple(v / math.hypot(*normal) for v in normal), False, 0, True), end)
        self.ahead = None

    def _follow(self, arc: AptArc, place: list[float]) -> None:
        """Cut an arc to a place."""
        assert self.at is not None
        n = arc.normal
        first, last = ([p - c for p, c in zip(point, arc.centre, strict=True)] for point in (self.at, place))
        rise = _dot(first, n)
        flat, flat1 = ([v - _dot(arm, n) * k for v, k in zip(arm, n, strict=True)] for arm in (first, last))
        radius = math.hypot(*flat)
        if radius <= 0.0 or abs(radius - math.hypot(*flat1)) > ROUND:
            raise CannotTellError("an arc that leaves its circle", self.record.line)
        across = _cross(n, flat)
        sweep = math.atan2(_dot(flat1, across) / radius, _dot(flat1, flat) / radius)
        turn = -2.0 * math.pi if arc.clockwise else 2.0 * math.pi
        if (sweep * turn <= 0.0 and abs(sweep) > 1e-9) or abs(sweep) <= 1e-9:
            sweep += turn
        sign = -1.0 if arc.clockwise else 1.0
        if self.straight and not arc.said:
            along = sign * _dot(self.straight, across) / math.hypot(*self.straight) / math.hypot(*across)
            self.votes += 1 if along > SMOOTH else -1 if along < -SMOOTH else 0
        middle = tuple(c + rise * k for c, k in zip(arc.centre, n, strict=True))
        self.record.move(ARC, place, self.speed(), self.axis, centre=middle, normal=n, sweep=sweep + arc.turns * turn)
        self.at, self.straight = place, ()

    def read_cycle(self, words: list[str]) -> None:
        """CYCLE: depth, feed and clearance by their labels or in their order; OFF ends it, a word alone takes it up."""
        if words[:1] == ["OFF"]:
            self.cycle = None
            return
        if words[:1] == ["ON"]:
            raise CannotTellError("CYCLE/ON", self.record.line)
        if not words or words[0] not in HOLES:
            raise CannotTellError(f"CYCLE/{','.join(words)[:30]}", self.record.line)
        self.kind, k = words[0], 1
        found: dict[str, float] = {}
        plain: list[float] = []
        while k < len(words):
            number = _NUMBER.fullmatch(words[k]) is not None
            after = words[k + 1] if k + 1 < len(words) else ""
            if number and plain and after in FEEDS:
                found["feed"], k = self._cycle_feed(float(words[k]), after), k + 1
            elif number:
                plain.append(float(words[k]))
            elif words[k] in FEEDS and _NUMBER.fullmatch(after):
                found["feed"], k = self._cycle_feed(float(after), words[k]), k + 1
            elif words[k] in LABELS and _NUMBER.fullmatch(after):
                found[words[k]], k = float(after), k + 1
            k += 1
        depth = found.get("DEPTH", found.get("FEDTO", plain.pop(0) if plain else NAN))
        clear = found.get("CLEAR", found.get("RAPTO", plain.pop(0) if plain else 0.0))
        if math.isnan(depth):
            raise CannotTellError("a cycle without depth", self.record.line)
        self.cycle = {"depth": abs(depth) * self.scale, "clear": clear * self.scale, "feed": found.get("feed", NAN)}
        self.cycle["out"] = found.get("RTRCTO", NAN) * self.scale

    def _cycle_feed(self, value: float, unit: str) -> float:
        factor, turn = FEEDS[unit]
        return value * factor * (self.spindle if turn else 1.0) / 60.0

    def drill(self, place: list[float]) -> None:
        """Drill a hole whose mouth is at a place, along the tool axis."""
        assert self.cycle is not None
        known = self.cycle
        if not self.expand:
            self._line(place, rapid=True)
            return

        def over(height: float) -> list[float]:
            return [p + height * a for p, a in zip(place, self.axis, strict=True)]

        feed = self.speed() if math.isnan(known["feed"]) else known["feed"]
        if not math.isnan(known["out"]):
            self._line(over(known["out"]), rapid=True)
        self._line(over(known["clear"]), rapid=True)
        self._line(over(-known["depth"]), rapid=False, drill=self.kind in PECKED, feed=feed)
        if self.kind in FED_OUT:
            self._line(over(known["clear"]), rapid=False, feed=feed)
        if self.kind not in FED_OUT or not math.isnan(known["out"]):
            self._line(over(known["clear"] if math.isnan(known["out"]) else known["out"]), rapid=True)


def _dot(a: Vector | list[float], b: Vector | list[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a: Vector | list[float], b: Vector | list[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _cut_records(text: str) -> Iterator[tuple[int, str]]:
    """Return the records of a file in capitals, each with the number of its first line."""
    kept, first, remark = "", 0, False
    for number, line in enumerate(text.splitlines(), 1):
        if remark or line.lstrip().startswith("$$"):
            remark = re.search(r"(?<!\$)\$\s*$", line) is not None
            continue
        part = line.split("$$")[0].strip().upper()
        first = first if kept else number
        if part.endswith("$"):
            kept += part[:-1].strip()
            continue
        if whole := kept + part:
            yield first, whole
        kept = ""


def read_apt(
    text: str, *, unit: str | None = None, sense: str = "auto", expand: bool = True, start: list[float] | None = None
) -> Reading:
    """Read an APT or CL file; where it states no unit, that of its feeds tells it.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    capital = text.upper()
    inches = unit == "inch" or (
        unit is None and "UNITS" not in capital and re.search(r"FEDRAT\s*/[^$\n]*\bIP[MR]\b", capital) is not None
    )
    reader = AptReader(scale=INCH if inches else 1.0, sense=sense, expand=expand)
    reader.at = reader.start = start
    try:
        return reader.run(text)
    except (ValueError, IndexError, OverflowError) as error:
        raise CannotTellError(f"{error}", reader.record.line) from None
