"""SINUMERIK 840D programs read a second time, as Siemens' programming manuals state their words."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from tests.oracles.cam.corners import cut_corner
from tests.oracles.cam.machine import PLANES, UNIT, DrivenMachine, Matrix, carry, multiply, turn_about
from tests.oracles.cam.moves import LINE, RAPID, CannotTellError, Reading
from tests.oracles.cam.sinumerik_flow import SinumerikFlow

#: Words that stand alone and move nothing that is read here.
SILENT = {
    "FFWON", "FFWOF", "SOFT", "BRISK", "DRIVE", "STOPRE", "CFC", "CFTCP", "CFIN", "FNORM", "FLIN", "COMPOF", "COMPCAD",
    "COMPON", "COMPCURV", "ORIWKS", "ORIMKS", "ORIVECT", "ORIAXES", "UPATH", "SPATH", "DIAMOF", "TRAFOOF", "TRAORI",
    "SPCOF", "KONT", "KONTC", "RTLIOF", "RTLION", "SD", "WALIMON", "WALIMOF", "CUT2D", "CUT2DF", "OSOF", "ORISON",
    "ORISOF", "SUPA",
}  # fmt: skip
#: G functions that change nothing that is read here.
QUIET = {40, 60, 9, 64, 641, 642, 643, 644, 645, 601, 602, 603, 450, 451, 500, 25, 26, 290, 291, 97, 96, 4}
#: Calls that move nothing: settings of speed, messages, stock.
CALLS = re.compile(r"(?:CYCLE832|WORKPIECE|CYCLE800|MSG|SETMS|CYCLE60|CUTCONOF|GROUP_BEGIN|GROUP_END)\s*\([^()]*\)")
_START = re.compile(r"(?<![A-Z_.])(?:[A-Z]{1,4}\d?\s*=|[A-QS-Z](?=[-+]?(?:\d|\.\d)))")
_WORD = re.compile(r"([A-Z]{1,4}\d?)\s*=\s*(.+)|([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_COUNTED = re.compile(r"(AC|IC)\s*\((.*)\)")
_CYCLE = re.compile(r"CYCLE(8[1-6])\s*\(([^()]*)\)")
#: Cycles that draw chips, and those that come out with a feed.
PECKED = {83}


@dataclass
class Sinumerik840D:
    """An interpreter of SINUMERIK blocks.

    Args:
        expand: Whether drilling cycles are moves.

    """

    expand: bool = True
    machine: DrivenMachine = field(default_factory=DrivenMachine)
    values: SinumerikFlow | None = None
    scale: float = 1.0
    feed_scale: float = 1.0
    motion: int = 1
    absolute: bool = True
    work: float | None = None
    matrix: Matrix = UNIT
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    modal: tuple[int, list[float]] | None = None
    corner: tuple[float, str] | None = None
    before: list[float] | None = None
    tilted: bool = False

    def run(self, text: str) -> Reading:
        """Read a whole program.

        Raises:
            CannotTellError: If something in it is not known here.

        """
        self.values = flow = SinumerikFlow(text)
        while (block := flow.next_block()) is not None:
            self.machine.record.line = flow.line
            if self.obey(block):
                break
        if self.corner is not None:
            raise CannotTellError("a corner without a move after it", self.machine.record.line)
        return self.machine.record.finish()

    def _value(self, text: str) -> float:
        assert self.values is not None
        return self.values.value(text)

    def obey(self, block: str) -> bool:
        """Carry out a block; tell whether the program ends with it."""
        head = re.split(r"[\s(]", block)[0]
        if head in ("TRANS", "ATRANS", "ROT", "AROT", "MIRROR", "SCALE", "AMIRROR", "ASCALE"):
            self._set_frame(head, block[len(head) :])
            return False
        if head == "MCALL":
            self.modal = self._read_cycle(block[5:].strip()) if block[5:].strip() else None
            return False
        if match := re.search(r"CYCLE800\s*\(\s*[^)\s]", block):
            raise CannotTellError("a swivelled plane", self.machine.record.line)
        block = CALLS.sub(" ", block).strip()
        if match := _CYCLE.search(block):
            rest = block.replace(match[0], " ")
            ends = self._words(rest) if rest.strip() else False
            self._drill(*self._read_cycle(match[0]))
            return ends
        return self._words(block) if block else False

    def _words(self, block: str) -> bool:
        """Carry out a block of words."""
        line, machine = self.machine.record.line, self.machine
        alone = set(re.findall(r"(?<![\w=])[A-Z]\w+(?![\w=(])", block)) & SILENT
        for word in alone:
            block = re.sub(rf"(?<!\w){word}(?!\w)", " ", block)
        starts = [match.start() for match in _START.finditer(block) if _depth(block, match.start()) == 0]
        if not starts and not block.strip():
            return False
        if block[: starts[0] if starts else None].strip():
            raise CannotTellError(f"the word {block.strip()[:20]!r}", line)
        codes: list[int] = []
        actions: list[int] = []
        has: dict[str, str] = {}
        for first, after in zip(starts, [*starts[1:], len(block)], strict=True):
            match = _WORD.fullmatch(block[first:after].strip())
            if match is None:
                raise CannotTellError(f"the word {block[first:after].strip()[:20]!r}", line)
            name, text = (match[1], match[2]) if match[1] else (match[3], match[4])
            if name == "G" and match[3]:
                codes.append(int(float(text)))
            elif name == "M" and match[3]:
                actions.append(int(float(text)))
            elif name in has:
                raise CannotTellError(f"the word {name} twice", line)
            else:
                has[name] = text
        self._prepare(codes, has, actions)
        if "SUPA" in alone or {53, 153} & set(codes):
            machine.forget([k for k, axis in enumerate("XYZ") if axis in has])
            self.motion = next((code for code in codes if code in (0, 1)), self.motion)
        elif 4 not in codes:
            self._move(has)
        return bool({2, 17, 30} & set(actions))

    def _prepare(self, codes: list[int], has: dict[str, str], actions: list[int]) -> None:
        machine, line = self.machine, self.machine.record.line
        for code in codes:
            if code in (70, 71, 700, 710):
                self.scale = 25.4 if code in (70, 700) else 1.0
                self.feed_scale = {700: 25.4, 710: 1.0}.get(code, self.feed_scale)
            elif code in PLANES:
                machine.plane = code
            elif code in (90, 91):
                self.absolute = code == 90
            elif code in (93, 94, 95):
                machine.feed_mode = code
            elif 54 <= code <= 57 or 505 <= code <= 599:
                if self.work not in (None, code):
                    raise CannotTellError("more than one work offset", line)
                self.work = code
            elif code in (0, 1, 2, 3):
                self.motion = code
            elif code not in QUIET and code not in (53, 153):
                raise CannotTellError(f"G{code}", line)
        if 4 in codes:
            return
        if "F" in has:
            by = 1.0 if machine.feed_mode == 93 else self.feed_scale
            machine.feed = self._value(has["F"]) * by
        if "S" in has:
            machine.spindle = abs(self._value(has["S"]))
        if "T" in has:
            self.selected = int(self._value(has["T"]))
            machine.record.tool = self.selected
        unknown = set(has) - {"X", "Y", "Z", "I", "J", "K", "F", "S", "T", "D", "H", "CR", "AR", "TURN", "RND", "CHR",
                              "CHF", "A3", "B3", "C3", "SPOS", "ADIS", "S1", "M1", "E"}  # fmt: skip
        if unknown:
            raise CannotTellError(f"the word {sorted(unknown)[0]}", line)

    def _target(self, has: dict[str, str]) -> list[float]:
        """Return where the axis words of a block lead, frame of the program. [mm]"""
        target = list(self.machine.at)
        for k, axis in enumerate("XYZ"):
            if axis in has:
                counted = _COUNTED.fullmatch(has[axis])
                value = self._value(counted[2] if counted else has[axis]) * self.scale
                absolute = counted[1] == "AC" if counted else self.absolute
                target[k] = value if absolute else target[k] + value
        return target

    def _move(self, has: dict[str, str]) -> None:
        machine, line = self.machine, self.machine.record.line
        leads = any(axis in has for axis in "XYZ")
        if {"A3", "B3", "C3"} & set(has):
            vector = [self._value(has.get(axis, "0")) for axis in ("A3", "B3", "C3")]
            machine.axis = tuple(carry(self.matrix, [value / math.hypot(*vector) for value in vector]))
        if self.motion in (2, 3) and (leads or {"I", "J", "K", "CR", "AR"} & set(has)):
            if self.corner is not None:
                raise CannotTellError("a corner beside an arc", line)
            self._arc(has)
            self.before = None
        elif leads:
            target, start = self._target(has), list(machine.at)
            if self.corner is not None:
                if self.motion == 0 or self.before is None:
                    raise CannotTellError("a corner before a rapid move", line)
                cut_corner(machine, self.before, target, self.corner[0], form=self.corner[1],
                           feed=machine.record.rows[-1][7])  # fmt: skip
                self.corner = None
            machine.straight(RAPID if self.motion == 0 else LINE, target)
            self.before = start if self.motion == 1 else None
        for word, form in (("RND", "round"), ("CHR", "side"), ("CHF", "across")):
            if word in has and (size := self._value(has[word])) != 0.0:
                if self.motion != 1 or not leads:
                    raise CannotTellError(f"{word} without a line", line)
                self.corner = size * self.scale, form
        if leads and self.modal is not None:
            self._drill(*self.modal)

    def _arc(self, has: dict[str, str]) -> None:
        machine = self.machine
        machine.begin_cut(machine.at)
        target, clockwise = self._target(has), self.motion == 2
        i, j, _ = PLANES[machine.plane]
        turns = int(self._value(has["TURN"])) if "TURN" in has else 0
        if "CR" in has:
            radius = self._value(has["CR"]) * self.scale
            machine.arc(target, machine.radius_centre(target, radius, clockwise), clockwise)
            return
        centre = list(machine.at)
        for n in (i, j):
            letter = "IJK"[n]
            if letter in has:
                counted = _COUNTED.fullmatch(has[letter])
                value = self._value(counted[2] if counted else has[letter]) * self.scale
                centre[n] = value if counted and counted[1] == "AC" else machine.at[n] + value
        if "AR" in has:
            raise CannotTellError("an arc by its angle", machine.record.line)
        machine.arc(target, centre, clockwise, turns)

    def _set_frame(self, head: str, rest: str) -> None:
        """TRANS and ROT set a frame in place of all before; ATRANS and AROT add to it."""
        if head in ("MIRROR", "SCALE", "AMIRROR", "ASCALE") and rest.strip():
            raise CannotTellError(head, self.machine.record.line)
        words = {}
        for name, value in re.findall(r"(RPL|[XYZ])\s*=?\s*((?:[^\sXYZ]|(?<=[A-Z])[XYZ])+)", rest):
            words[name] = self._value(value)
        if rest.strip() and not words:
            raise CannotTellError(f"{head} {rest.strip()[:20]}", self.machine.record.line)
        if not head.startswith("A"):
            self.matrix, self.shift = UNIT, [0.0, 0.0, 0.0]
        if head.endswith("TRANS"):
            by = carry(self.matrix, [words.get(axis, 0.0) * self.scale for axis in "XYZ"])
            self.shift = [a + b for a, b in zip(self.shift, by, strict=True)]
        elif head.endswith("ROT"):
            across = PLANES[self.machine.plane][2]
            angles = {across: words["RPL"]} if "RPL" in words else {k: words.get("XYZ"[k], 0.0) for k in (2, 1, 0)}
            for k, angle in angles.items():
                self.matrix = multiply(self.matrix, turn_about(k, angle))
        self.machine.set_frame(self.matrix, self.shift)
        self.before = None

    def _read_cycle(self, text: str) -> tuple[int, list[float]]:
        match = _CYCLE.fullmatch(text.strip())
        if match is None:
            raise CannotTellError(f"the cycle {text[:20]!r}", self.machine.record.line)
        return int(match[1]), [self._value(word) if word.strip() else math.nan for word in match[2].split(",")]

    def _drill(self, number: int, words: list[float]) -> None:
        """CYCLE81 to 86: retraction plane, reference plane, safety distance, depth, or depth below the reference."""
        machine = self.machine
        if not self.expand:
            return
        words = [value * (self.scale if k < 5 else 1.0) for k, value in enumerate([*words, *[math.nan] * 12])]
        back, top, clear, depth, below = words[:5]
        depth = top - abs(below) if math.isnan(depth) else depth
        if any(map(math.isnan, (back, top, depth))) or machine.plane != 17 or number == 84:
            raise CannotTellError(f"CYCLE{number} as it stands here", machine.record.line)
        clear = 0.0 if math.isnan(clear) else abs(clear)
        out = top + clear

        def lead(height: float, kind: int, rate: float | None = None) -> None:
            point = [machine.at[0], machine.at[1], height]
            if point != machine.at:
                machine.straight(kind, point, speed=rate, drill=kind == LINE and number in PECKED)

        lead(out, RAPID)
        lead(depth, LINE, words[6] / 60.0 if number == 85 and not math.isnan(words[6]) else None)
        if number == 85:
            lead(out, LINE, None if math.isnan(words[7]) else words[7] / 60.0)
        lead(back, RAPID)


def _depth(text: str, at: int) -> int:
    return text.count("(", 0, at) - text.count(")", 0, at) + text.count("[", 0, at) - text.count("]", 0, at)


def read_sinumerik_program(text: str, *, expand: bool = True, start: list[float] | None = None) -> Reading:
    """Read a SINUMERIK program.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    reader = Sinumerik840D(expand)
    reader.machine.start = start
    try:
        return reader.run(text)
    except (ValueError, KeyError, IndexError, OverflowError) as error:
        raise CannotTellError(f"{error}", reader.machine.record.line) from None
