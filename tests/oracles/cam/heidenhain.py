"""Heidenhain conversational programs read a second time, as the users' manuals of TNC and iTNC state their blocks."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from tests.oracles.cam.corners import cut_corner
from tests.oracles.cam.expressions import evaluate
from tests.oracles.cam.heidenhain_flow import HeidenhainFlow
from tests.oracles.cam.machine import PLANES, UNIT, DrivenMachine, multiply, turn_about
from tests.oracles.cam.moves import LINE, RAPID, CannotTellError, Reading

_VALUE = r"([-+]?\s*(?:\d+\.?\d*|\.\d+|Q[LR]?\d+))"
_WORD = re.compile(rf"(I?(?:X|Y|Z|A|B|C)|I?PR|I?PA|R|CCA|LEN)\s*{_VALUE}")
_FEED = re.compile(rf"\bF\s*(MAX|AUTO|{_VALUE})")
_ACTION = re.compile(r"\bM(\d+)")
_CYCLE_WORD = re.compile(rf"Q(\d+)\s*=\s*({_VALUE}|FMAX|FAUTO|FU|FZ)")
#: Blocks that move nothing.
SILENT = re.compile(
    r"BEGIN PGM|END PGM|BLK FORM|\*|TOOL DEF|STOP|FUNCTION (?:MODE|RESET|FEED|DWELL|S-PULSE|COUNT)|PLANE RESET|"
    r"CYCL DEF (?:9|13|32|247|239)\b|FN ?1[4-9]|FN ?2\d|FN ?3\d"
)
#: M functions that change how moves are read.
STRANGE = {97, 98, 103, 114, 128, 144}
#: Drilling cycles: those that draw chips, and those that come out with a feed.
PECKED, TAPPED = {200, 203, 205}, {207, 209}
DRILLS = {200, 201, 203, 205, 207, 240}


@dataclass
class Heidenhain:
    """An interpreter of conversational blocks.

    Args:
        expand: Whether drilling cycles are moves.
        rotary: What A, B, C turn: "head", "table", or None.

    """

    expand: bool = True
    rotary: str | None = None
    machine: DrivenMachine = field(default_factory=DrivenMachine)
    scale: float = 1.0
    pole: list[float] | None = None
    heading: list[float] | None = None
    corner: tuple[float, str, float | None] | None = None
    before: list[float] | None = None
    cycle: tuple[int, dict[str, float]] | None = None
    modal: bool = False
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turned: float = 0.0
    tilted: bool = False
    tracking: bool = False
    angles: dict[str, float] = field(default_factory=dict)

    def run(self, text: str) -> Reading:
        """Read a whole program.

        Raises:
            CannotTellError: If something in it is not known here.

        """
        flow = HeidenhainFlow(text)
        self.values = flow.values
        self.scale = 25.4 if re.search(r"BEGIN PGM\b.*\bINCH\b", flow.text) else 1.0
        while (block := flow.next_block()) is not None:
            self.machine.record.line = flow.line
            if self.obey(block):
                break
        if self.corner is not None:
            raise CannotTellError("a corner without a move after it", self.machine.record.line)
        return self.machine.record.finish()

    def obey(self, block: str) -> bool:
        """Carry out a block; tell whether the program ends with it."""
        actions = {int(number) for number in _ACTION.findall(block)}
        if STRANGE & actions and not (128 in actions and self.rotary == "head"):
            raise CannotTellError(f"M{min(STRANGE & actions)}", self.machine.record.line)
        if 128 in actions or block.startswith("FUNCTION TCPM"):
            self.tracking = True
        if 129 in actions or block.startswith("FUNCTION RESET TCPM"):
            self.tracking = False
        if 136 in actions or 137 in actions:
            self.machine.feed_mode = 95 if 136 in actions else 94
        head = block.split(" ")[0]
        if re.search(r"\bM140 MB ?MAX", block):
            self.machine.forget([2])
        elif head in ("L", "LP", "C", "CP", "CR", "CT", "CTP", "CC"):
            self._take_feed(block)
            self._move(head, block, actions)
        elif match := re.match(rf"(RND|CHF)\s*R?\s*{_VALUE}", block):
            feed = _FEED.search(block)
            own = None if feed is None else self._speed(feed[1])
            self.corner = self._value(match[2]) * self.scale, "round" if match[1] == "RND" else "side", own
        elif head == "TOOL" and (match := re.match(r"TOOL CALL\s+(\d+)?", block)):
            self._call_tool(block, match[1])
        elif head == "CYCL":
            self._cycle(block)
        elif block.startswith("PLANE SPATIAL"):
            self._tilt(block)
        elif not SILENT.match(block) and not re.fullmatch(r"(?:M\d+ ?)+|FUNCTION (?:RESET )?TCPM.*|F ?\d+.*", block):
            raise CannotTellError(f"the block {block[:30]!r}", self.machine.record.line)
        if block.startswith("PLANE RESET"):
            self.tilted, self.machine.axis = False, (0.0, 0.0, 1.0)
            self._set_frame()
        if 89 in actions:
            self.modal = True
        if 99 in actions or (self.modal and head in ("L", "LP")):
            self._drill()
            self.modal = self.modal and 99 not in actions
        return bool({2, 30} & actions)

    def _value(self, text: str) -> float:
        text = text.replace(" ", "")
        return evaluate(text, self.values)

    def _speed(self, text: str) -> float:
        """Return a feed; tenths of an inch a minute in programs in inches. [mm/s]"""
        return self._value(text) * (2.54 if self.scale != 1.0 else 1.0) / 60.0

    def _take_feed(self, block: str) -> None:
        if (match := _FEED.search(block)) and match[1] not in ("MAX", "AUTO"):
            self.machine.feed = 60.0 * self._speed(match[1])
            if self.machine.feed_mode == 95:
                self.machine.feed = self._value(match[1]) * self.scale

    def _call_tool(self, block: str, number: str | None) -> None:
        if re.search(r"TOOL CALL\s+\S+\s+[XY]\b", block):
            raise CannotTellError("another tool axis than Z", self.machine.record.line)
        if number is not None:
            self.machine.record.tool = int(number)
        if match := re.search(rf"\bS\s*{_VALUE}", block):
            self.machine.spindle = abs(self._value(match[1]))
        self._take_feed(block)

    def _move(self, head: str, block: str, actions: set[int]) -> None:
        """Carry out a block that leads somewhere."""
        machine, words = self.machine, {}
        bare = re.sub(r"\bDR ?[-+]|\bR[0LR]\b|\bM\d+|\bS ?\d+", " ", block[len(head) :])
        bare = _FEED.sub(" ", bare)
        for letter, text in _WORD.findall(bare):
            words[letter] = self._value(text)
        if _WORD.sub("", bare).strip():
            raise CannotTellError(f"the words {_WORD.sub('', bare).strip()[:20]!r}", machine.record.line)
        rapid = "MAX" in [match[1] for match in _FEED.finditer(block)]
        if {91, 92} & actions:
            machine.forget([k for k, axis in enumerate("XYZ") if axis in words])
            self.heading = None
            return
        if head == "CC":
            self._set_pole(words)
            return
        target = self._find_target(head, words)
        if any(axis in words for axis in "ABC"):
            self._swing(words)
        if head in ("L", "LP"):
            self._line(target, rapid, drawn=any(letter in words for letter in ("X", "Y", "Z", *POLAR, *STEPS, *"ABC")))
            return
        machine.begin_cut(machine.at)
        self._need_no_corner()
        start, plane = list(machine.at), PLANES[17]
        clockwise, turns = re.search(r"\bDR ?-", block) is not None, 0
        if head in ("CT", "CTP"):
            centre, clockwise = self._touch(target)
        elif head == "CR":
            centre = machine.radius_centre(target, words["R"] * self.scale, clockwise)
        else:
            centre = self._need_pole()
            if "IPA" in words:
                turns = max(math.ceil(abs(words["IPA"]) / 360.0 - 1e-9) - 1, 0)
            if "DR" not in block:
                raise CannotTellError("an arc without DR", machine.record.line)
        machine.arc(target, centre, clockwise, turns)
        i, j, _ = plane
        arm = [target[i] - centre[i], target[j] - centre[j]]
        self.heading = [arm[1], -arm[0]] if clockwise else [-arm[1], arm[0]]
        self.before = start

    def _find_target(self, head: str, words: dict[str, float]) -> list[float]:
        target = list(self.machine.at)
        for k, axis in enumerate("XYZ"):
            if axis in words:
                target[k] = words[axis] * self.scale
            elif f"I{axis}" in words:
                target[k] += words[f"I{axis}"] * self.scale
        if head not in ("LP", "CP", "CTP"):
            return target
        pole, at = self._need_pole(), self.machine.at
        radius, angle = math.hypot(at[0] - pole[0], at[1] - pole[1]), math.atan2(at[1] - pole[1], at[0] - pole[0])
        if "PR" in words or "IPR" in words:
            radius = words["PR"] * self.scale if "PR" in words else radius + words["IPR"] * self.scale
        if "PA" in words or "IPA" in words:
            angle = math.radians(words["PA"]) if "PA" in words else angle + math.radians(words["IPA"])
        target[0], target[1] = pole[0] + radius * math.cos(angle), pole[1] + radius * math.sin(angle)
        return target

    def _set_pole(self, words: dict[str, float]) -> None:
        old = self.pole if self.pole is not None and words else self.machine.at[:2]
        new = list(old)
        for k, axis in enumerate("XY"):
            if axis in words:
                new[k] = words[axis] * self.scale
            elif f"I{axis}" in words:
                new[k] = self.machine.at[k] + words[f"I{axis}"] * self.scale
        if any(axis in words for axis in ("Z", "IZ")):
            raise CannotTellError("a pole of another plane", self.machine.record.line)
        self.pole = new

    def _need_pole(self) -> list[float]:
        if self.pole is None:
            raise CannotTellError("polar words without a pole", self.machine.record.line)
        return [*self.pole, self.machine.at[2]]

    def _need_no_corner(self) -> None:
        if self.corner is not None:
            raise CannotTellError("a corner beside an arc", self.machine.record.line)

    def _line(self, target: list[float], rapid: bool, *, drawn: bool) -> None:
        machine, start = self.machine, list(self.machine.at)
        if not drawn:
            return
        if self.corner is not None:
            size, form, own = self.corner
            self.corner = None
            if rapid or self.before is None:
                raise CannotTellError("a corner before a rapid move", machine.record.line)
            last = machine.record.rows[-1][7] if machine.record.rows else 0.0
            cut_corner(machine, self.before, target, size, form=form, feed=last if own is None else own)
        machine.straight(RAPID if rapid else LINE, target)
        self.before = start
        self.heading = [target[0] - start[0], target[1] - start[1]]

    def _touch(self, target: list[float]) -> tuple[list[float], bool]:
        """Return the centre of an arc that goes on smoothly, and whether it runs clockwise."""
        at, heading = self.machine.at, self.heading
        if heading is None or not math.hypot(*heading) > 1e-9:
            raise CannotTellError("a smooth arc from nowhere", self.machine.record.line)
        hx, hy = (value / math.hypot(*heading) for value in heading)
        dx, dy = target[0] - at[0], target[1] - at[1]
        aside = -hy * dx + hx * dy  # how far the end lies to the left
        if abs(aside) < 1e-9:
            raise CannotTellError("a smooth arc that is a line", self.machine.record.line)
        radius = (dx * dx + dy * dy) / (2.0 * aside)
        return [at[0] - hy * radius, at[1] + hx * radius, at[2]], aside < 0.0

    def _swing(self, words: dict[str, float]) -> None:
        """Turn the tool axis by rotary words."""
        self.angles |= {axis: words[axis] for axis in "ABC" if axis in words}
        if not any(self.angles.values()):
            return
        if self.rotary != "head" or not self.tracking:
            raise CannotTellError("rotary words without a head whose tip is followed", self.machine.record.line)
        matrix = UNIT
        for k, axis in ((2, "C"), (1, "B"), (0, "A")):
            matrix = multiply(matrix, turn_about(k, self.angles.get(axis, 0.0)))
        self.machine.axis = (matrix[0][2], matrix[1][2], matrix[2][2])

    def _tilt(self, block: str) -> None:
        """PLANE SPATIAL: the plane is turned about the fixed x, y and z, one after the other."""
        found = {axis: self._value(text) for axis, text in re.findall(rf"SP([ABC])\s*{_VALUE}", block)}
        if len(found) != 3:
            raise CannotTellError("PLANE SPATIAL without three angles", self.machine.record.line)
        matrix = turn_about(0, found["A"])
        for k, axis in ((1, "B"), (2, "C")):
            matrix = multiply(turn_about(k, found[axis]), matrix)
        if self.turned or any(self.shift):
            raise CannotTellError("a tilted plane in a moved frame", self.machine.record.line)
        self.tilted = matrix != UNIT
        self.machine.axis = (matrix[0][2], matrix[1][2], matrix[2][2])
        self.machine.set_frame(matrix, [0.0, 0.0, 0.0])
        self.heading = self.before = None

    def _set_frame(self) -> None:
        self.machine.set_frame(turn_about(2, self.turned) if self.turned else UNIT, self.shift)
        self.heading = self.before = None

    def _cycle(self, block: str) -> None:
        """CYCL DEF and CYCL CALL."""
        if block.startswith("CYCL CALL"):
            if re.match(r"CYCL CALL (?:POS|PAT)", block):
                raise CannotTellError("CYCL CALL at a list of places", self.machine.record.line)
            self._drill()
            return
        match = re.match(r"CYCL DEF ?(\d+)(?:\.(\d+))?", block)
        number, part = (0, "") if match is None else (int(match[1]), match[2] or "")
        rest = block[match.end() :] if match else ""
        if number in (7, 10):
            self._shift(number, part, rest)
        elif number in DRILLS:
            words = {key: self._value(text) for key, text, _ in _CYCLE_WORD.findall(rest) if text[0] != "F"}
            self.cycle, self.modal = (number, words), False
            if "F" in re.sub(r"Q\d+\s*=\s*FMAX", "", ",".join(m[0] for m in _CYCLE_WORD.finditer(rest))):
                raise CannotTellError("a cycle with a feed in words", self.machine.record.line)
        elif not SILENT.match(block):
            raise CannotTellError(f"cycle {number}", self.machine.record.line)
        elif number == 247 and self.machine.record.rows:
            raise CannotTellError("another datum", self.machine.record.line)

    def _shift(self, number: int, part: str, rest: str) -> None:
        """Cycle 7 shifts the datum, cycle 10 turns about it."""
        if part == "0" or not part:
            return
        if self.tilted:
            raise CannotTellError("a datum in a tilted plane", self.machine.record.line)
        if number == 10:
            turn = re.search(rf"(I?)ROT\s*{_VALUE}", rest)
            if turn is None:
                raise CannotTellError("cycle 10 without ROT", self.machine.record.line)
            self.turned = self._value(turn[2]) + (self.turned if turn[1] else 0.0)
        elif self.turned or "#" in rest:
            raise CannotTellError("a datum in a turned frame, or of a table", self.machine.record.line)
        for letter, text in _WORD.findall(rest) if number == 7 else []:
            k = "XYZ".index(letter[-1])
            value = self._value(text) * self.scale
            self.shift[k] = value + (self.shift[k] if letter[0] == "I" else 0.0)
        self._set_frame()

    def _drill(self) -> None:
        """Drill a hole where the tool stands."""
        machine = self.machine
        if not self.expand:
            return
        if self.cycle is None:
            raise CannotTellError("a cycle that is not defined", machine.record.line)
        number, words = self.cycle
        surface, over = words.get("203", 0.0) * self.scale, words["200"] * self.scale
        tenth = 2.54 if self.scale != 1.0 else 1.0
        feed = words["206"] * tenth / 60.0 if "206" in words else words["239"] * self.scale * machine.spindle / 60.0
        if number == 240 and words.get("343", 0.0):
            raise CannotTellError("centring to a diameter", machine.record.line)

        def lead(height: float, kind: int, rate: float = 0.0, *, chips: bool = False) -> None:
            point = [machine.at[0], machine.at[1], height]
            if point != machine.at:
                machine.straight(kind, point, drill=chips, speed=rate)

        lead(surface + over, RAPID)
        lead(surface + words["201"] * self.scale, LINE, feed, chips=number in PECKED)
        out = words.get("208", 0.0) * tenth / 60.0 if number == 201 else feed if number in TAPPED else 0.0
        if out:
            lead(surface + over, LINE, out)
        lead(surface + max(words.get("204", 0.0) * self.scale, over), RAPID)


#: Words that lead somewhere besides X, Y, Z.
POLAR, STEPS = ("PR", "PA", "IPR", "IPA"), ("IX", "IY", "IZ")


def read_heidenhain(
    text: str, *, expand: bool = True, rotary: str | None = None, start: list[float] | None = None
) -> Reading:
    """Read a Heidenhain conversational program.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    reader = Heidenhain(expand, rotary)
    reader.machine.start = start
    try:
        return reader.run(text)
    except (ValueError, KeyError, IndexError, OverflowError) as error:
        raise CannotTellError(f"{error}", reader.machine.record.line) from None
