"""Motion blocks of Sinumerik programs: G0 to G3, CIP, CT, poles, corners, tool directions, modes."""

from __future__ import annotations

import math
import re
from pathlib import Path

from compplan.toolpath.readers.arcs import Point, arc_about, combine, dot
from compplan.toolpath.readers.cnc.words import HARMLESS, VALUES
from compplan.toolpath.readers.contour import Corner, Element, find_centre, find_tangent_arc
from compplan.toolpath.readers.options import CamTable, ask_compensation
from compplan.toolpath.readers.plain import read_place
from compplan.toolpath.readers.robot_moves import find_arc
from compplan.toolpath.readers.sinumerik_frames import AXES, ELSEWHERE, INCH, NORMALS, PLANES, SinumerikFrameReader
from compplan.toolpath.readers.sinumerik_words import Words
from compplan.toolpath.readers.turning import LETTERS

CENTRES, MIDDLES, DIRECTIONS = ("I", "J", "K"), ("I1", "J1", "K1"), ("A3", "B3", "C3")
#: Addresses of a motion block, and those that say nothing of the path.
MOVING = {*AXES, *CENTRES, *MIDDLES, *DIRECTIONS, *LETTERS, "CR", "AR", "AP", "RP", "TURN"}
#: Lengths among them.
LENGTHS = (*AXES, *CENTRES, *MIDDLES, "CR", "RP")
CORNERS = {"RND": "ROUND", "CHR": "LEG", "CHF": "CHAMFER"}
SILENT_WORDS = {"F", "S", "T", "D", "H", "M", "P", "FB", "FRC", "FRCM", *VALUES, "ADISPOS", "SPOS", "FA", "DISCL",
                "FGREF", "OTOL", "CTOL", "TOFFL", "TOFFR", "OMA", "STOLF", "TCARR"}  # fmt: skip
SILENT_CODES = {9.0, 25.0, 26.0, 40.0, 43.0, 49.0, 60.0, 61.0, 62.0, 63.0, 64.0, 80.0, 94.0, 96.0, 97.0, 140.0, 141.0,
                142.0, 143.0, 290.0, 340.0, 341.0, 450.0, 451.0, 460.0, 461.0, 462.0, 601.0, 602.0, 603.0, 621.0, 961.0,
                971.0, *(640.0 + i for i in range(6))}  # fmt: skip
REFUSED_CODES = {
    5.0: "another motion", 7.0: "oblique plunging", 12.0: "another motion", 33.0: "threading", 34.0: "threading",
    35.0: "threading", 58.0: "a shift of the frame", 59.0: "a shift of the frame", 68.0: "coordinate rotation",
    92.0: "a shift of the frame", 147.0: "soft approach", 148.0: "soft departure", 247.0: "soft approach",
    248.0: "soft departure", 291.0: "ISO mode", 331.0: "tapping", 332.0: "tapping", 347.0: "soft approach",
    348.0: "soft departure",
}  # fmt: skip
#: Words whose block moves in ways that are not read.
REFUSED_NAMES = re.compile(
    r"[ABC]SPLINE|POLY|POLYPATH|INVCC?W|A?ROTS?|CROTS?|TRANSMIT\w*|TRACYL\w*|TRAANG|TRACON|TOFRAME\w?|TOROT\w?|PAROT|"
    r"MEAS|MEAW|DIAMON|DIAM90|ROTATION|OFFN|CORROF|PTP|EAUTO|ENAT|BAUTO|BNAT|MEAC|TANG\w*|ORIPATH\w*|ORICON\w*|COUPON"
)
OFFSET_CODES = {54.0, 55.0, 56.0, 57.0, 500.0}


class SinumerikMoveReader(SinumerikFrameReader):
    """Carry out motion blocks."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.motion: float | str = 1.0
        self.stated = False
        self.incremental = False
        self.pole: Point = (0.0, 0.0, 0.0)
        self.polar: dict[str, float] = {}
        self.rounding = 0.0
        self.machine_once = False

    def set_codes(self, words: Words) -> str:
        """Set what G codes and names set; return a reason where the coordinates of the block are no move."""
        once = ""
        for code in words.codes:
            if code in REFUSED_CODES:
                raise self.error(f"G{code:g} ({REFUSED_CODES[code]}) is not read; post-process without it")
        motions = {code for code in words.codes if code in (0.0, 1.0, 2.0, 3.0)}
        if len(motions) > 1:
            raise self.error("two motions stand in one block, expected one")
        for code in words.codes:
            if code in (0.0, 1.0, 2.0, 3.0):
                self.motion, self.stated = code, True
            elif code in (17.0, 18.0, 19.0):
                self.plane = int(code)
                if not self.tip_control:
                    self.course.aim(self.swivel.turn(NORMALS[17]))
            elif code in (90.0, 91.0):
                self.incremental = code == 91.0
            elif code in (70.0, 71.0, 700.0, 710.0, 20.0, 21.0):
                self.set_unit(INCH if code in (70.0, 700.0, 20.0) else 1.0, feeds=code not in (70.0, 71.0))
            elif code in (93.0, 94.0, 95.0):
                self.feed_mode = int(code)
            elif code in (53.0, 153.0):
                once = "machine"
            elif code in (74.0, 75.0):
                once = "fixed"
            elif code == 4.0:
                once = "dwell"
            elif code in (25.0, 26.0):
                once = "once"
            elif code in (110.0, 111.0, 112.0):
                self._set_pole(code, words)
                once = "pole"
            elif code in OFFSET_CODES or 505.0 <= code <= 599.0:
                self.use_offset(code)
            elif code in (41.0, 42.0):
                if words.values.get("D") != 0.0:
                    self.log.note(ask_compensation(self.options, f"G{code:g}"), self.line)
            elif code not in SILENT_CODES:
                if words.values.keys() & MOVING and not motions:
                    raise self.error(f"G{code:g} with coordinates is not read and may move the tool")
                self.log.note(f"G{code:g} is not read", self.line)
        for name in words.names:
            once = self.set_name(name) or once
        return once

    def set_name(self, name: str) -> str:
        """Set what a word without a number sets."""
        if name in ("CIP", "CT"):
            self.motion, self.stated = name, True
        elif name == "SUPA":
            return "machine"
        elif name in ("TRAORI", "TRAFOOF"):
            self.tip_control = name == "TRAORI"
            self.set_frame()
        elif name in ("ORIEULER", "ORIRPY", "ORIRPY2", "ORIMKS"):
            pass
        elif REFUSED_NAMES.fullmatch(name) and name not in ("DIAM90",):
            raise self.error(f"{name} is not read and changes the path or its frame; post-process without it")
        elif name not in HARMLESS and name not in VALUES:
            raise self.error(f"word {name[:24]} is not read and may move the tool; post-process without it")
        return ""

    def run_motion(self, words: Words, once: str) -> bool:
        """Carry out the coordinates of a block; return whether it moves the tool."""
        values = words.values
        self._check_addresses(values)
        if "RNDM" in values:
            self.rounding = values["RNDM"] * self.scale
        if once == "dwell":
            wait = values["S"] * 60.0 / self.spindle if "S" in values and self.spindle else values.get("F", 0.0)
            self.log.happen("dwell", self.line, value=max(wait, 0.0))
            return False
        if "F" in values:
            self.feed = values["F"]
        if once in ("pole", "once") or not values.keys() & MOVING:
            return False
        if once in ("machine", "fixed"):
            self._go_in_machine(values)
            return False
        if values.keys() & {"AP", "RP"}:
            self._take_polar(words)
        self._move(words)
        return True

    def _check_addresses(self, values: dict[str, float]) -> None:
        for address in values:
            if address not in MOVING and address not in SILENT_WORDS and address not in CORNERS and address != "RNDM":
                if re.fullmatch(r"[ABC][2-7]", address):
                    raise self.error(f"orientation {address}= is not read, expected A3= B3= C3= or rotary axes A B C")
                raise self.error(f"word {address} is not read and may move the tool; post-process without it")

    def _go_in_machine(self, values: dict[str, float]) -> None:
        """Leave out a move in machine coordinates; where it ended is not known."""
        self.contour.refuse_open()
        self.log.note("moves in machine coordinates (SUPA, G53, G153, G74, G75) are left out", self.line)
        if "Z" in values:
            self.course.retreat(self.line)
        self.course.lose(axis for axis, letter in enumerate(AXES) if letter in values)
        for letter in LETTERS:
            if abs(values.get(letter, 0.0)) > 0.5 * ELSEWHERE:
                raise self.error(f"{letter} of a move in machine coordinates is not known; write its angle")
            if letter in values:
                self.rotary.take(letter, values[letter])

    def _set_pole(self, code: float, words: Words) -> None:
        """Carry out G110 (from the tool), G111 (from the origin), G112 (from the last pole)."""
        base = {110.0: self.contour.position, 111.0: (0.0, 0.0, 0.0), 112.0: self.pole}[code]
        point = list(base)
        for axis, letter in enumerate(AXES):
            if letter in words.values:
                number = words.values[letter] * self.scale
                point[axis] = number if letter in words.absolute else base[axis] + number
        if words.values.keys() & {"AP", "RP"}:
            raise self.error("a pole in polar coordinates is not read")
        self.pole = point[0], point[1], point[2]

    def _take_polar(self, words: Words) -> None:
        """Keep radius and angle of a polar block; they stay in force."""
        start, (first, second) = self.contour.position, PLANES[self.plane]
        dx, dy = start[first] - self.pole[first], start[second] - self.pole[second]
        now = {"RP": math.hypot(dx, dy) / self.scale, "AP": math.degrees(math.atan2(dy, dx))}
        for address in ("RP", "AP"):
            if address not in words.values:
                self.polar.setdefault(address, now[address])
                continue
            relative = address in words.relative or (self.incremental and address not in words.absolute)
            self.polar[address] = words.values[address] + (now[address] if relative else 0.0)

    def target(self, words: Words) -> tuple[Point, tuple[int, ...]]:
        """Return where a block leads, and which axes it names as absolute coordinates."""
        point, named = list(self.contour.position), []
        for axis, letter in enumerate(AXES):
            if letter not in words.values:
                continue
            number = words.values[letter] * self.scale
            if letter in words.relative or (self.incremental and letter not in words.absolute):
                point[axis] += number
            else:
                point[axis] = number
                named.append(axis)
        if words.values.keys() & {"AP", "RP"}:
            first, second = PLANES[self.plane]
            radius, angle = self.polar["RP"] * self.scale, math.radians(self.polar["AP"])
            point[first] = self.pole[first] + radius * math.cos(angle)
            point[second] = self.pole[second] + radius * math.sin(angle)
            named += [first, second]
        return (point[0], point[1], point[2]), tuple(named)

    def _move(self, words: Words) -> None:
        self.ask_for_unit(words.values.get(name) for name in LENGTHS)
        if self.motion != 0.0:
            self.begin_cut()
        target, named = self.target(words)
        if not self.stated and not self.log.waypoints:
            self.log.note("coordinates before any G0 or G1 are read as G1", self.line)
        if self.motion in (2.0, 3.0, "CIP", "CT"):
            if words.values.keys() & {*LETTERS, *DIRECTIONS} and not self.rotary.ignored:
                raise self.error("an arc with words that turn the tool is not read")
            self._check_cut()
            self._go_round(words, target, named)
            return
        if words.values.keys() & {"CR", "AR", "TURN", *MIDDLES}:
            raise self.error("words of an arc (CR, AR, TURN) in a straight block")
        if words.values.keys() & set(CENTRES):
            self.log.note("I J K in straight moves are not read", self.line)
        before = dict(self.rotary.angles)
        axis = self._turn(words, rapid=self.motion == 0.0)
        if not named and axis is None and target == self.contour.position:
            return
        if self.motion == 0.0:
            self.contour.refuse_open()
            self.course.rapid(target, named, axis)
            return
        self._check_cut()
        feed = self._block_feed(words, math.dist(target, self.contour.position))
        by_axes = axis is not None and not words.values.keys() & set(DIRECTIONS)
        on_way = self.rotary.turn_on_way(before) if by_axes else None
        self.contour.add(
            Element(self.contour.position, target, named, feed, self.line, normal=NORMALS[self.plane], axis=axis,
                    on_way=on_way), self._corner(words))  # fmt: skip

    def is_steady(self) -> bool:
        """Tell whether a block of X Y Z F alone cuts straight to where its numbers say, and nothing else."""
        return bool(
            self.motion == 1.0 and self.feed and self.feed_mode == 94 and self.contour.idle and self.course.knows
            and self.stated and not (self.incremental or self.rounding or self.outside or self.rotary.unknown)
        )  # fmt: skip

    def cut_plain(self, found: re.Match[str]) -> bool:
        """Carry out a block of X Y Z F alone where the program is steady; return whether it was read."""
        feed = found.group(4)
        target = read_place(found, self.course.position, self.scale)
        if target is None or (feed is not None and float(feed) <= 0.0):
            return False
        if feed is not None:
            self.feed = float(feed)
        assert self.feed is not None
        self.course.line(target, (), self.feed * self.feed_scale / 60.0, self.line)
        return True

    def _check_cut(self) -> None:
        """Refuse a cut whose frame is not known: another work offset, rotary axes of an unknown machine."""
        self.check_offset()
        if not self.swivelled:
            self.rotary.refuse_unknown()

    def _block_feed(self, words: Words, length: float) -> float:
        if "FB" in words.values:
            return words.values["FB"] * self.feed_scale / 60.0
        return self.speed(length)

    def _corner(self, words: Words) -> Corner | None:
        """Return the corner that a block asks for at its end."""
        feed = words.values["FRC"] * self.feed_scale / 60.0 if words.values.get("FRC") else None
        for address, kind in CORNERS.items():
            if words.values.get(address):
                return Corner(kind, words.values[address] * self.scale, feed, self.line)
        return Corner("ROUND", self.rounding, None, self.line, modal=True) if self.rounding else None

    def _turn(self, words: Words, *, rapid: bool) -> Point | None:
        """Return the tool axis that A3 B3 C3 or A B C ask for, None where they ask for nothing."""
        named = [letter for letter in DIRECTIONS if letter in words.values]
        if named:
            vector = tuple(words.values.get(letter, 0.0) for letter in DIRECTIONS)
            fault = f"tool direction A3 B3 C3 is {vector}, expected three numbers that are not all 0"
            return self.point_along(vector if len(named) == 3 else (), fault)
        letters = [letter for letter in LETTERS if letter in words.values]
        if not letters or self.rotary.ignored:
            return None
        if self.swivelled and not self.tip_control:
            note = "A B C in a swivelled plane position the rotary axes as the plane asks: its axis is taken"
            self.log.note(note, self.line)
            return None
        angles = dict.fromkeys(letters, 0.0)
        for letter in letters:
            relative = letter in words.relative or (self.incremental and letter not in words.absolute)
            angles[letter] = words.values[letter] + (self.rotary.angles.get(letter, 0.0) if relative else 0.0)
        return self.turn_to(angles, self.swivel.turn(NORMALS[17]), "TRAORI", rapid=rapid)

    def _go_round(self, words: Words, target: Point, named: tuple[int, ...]) -> None:
        """Cut along an arc."""
        start, values, normal = self.contour.position, words.values, NORMALS[self.plane]
        turns = values.get("TURN", 0.0)
        if not 0.0 <= turns <= 9999.0 or turns != int(turns):
            raise self.error(f"TURN={turns:g}, expected a whole number from 0 to 9999")
        right_hand = self.motion == 3.0
        if self.motion == "CIP":
            centre, normal, right_hand = self._find_middle(words, start, target)
        elif self.motion == "CT":
            found = find_tangent_arc(start, self.find_direction(" (CT)"), target, normal)
            if found is None:
                feed = self._block_feed(words, math.dist(start, target))
                self.contour.add(Element(start, target, named, feed, self.line, normal=normal), self._corner(words))
                return
            centre, right_hand = found
        elif "CR" in values:
            centre = find_centre(start, target, normal, values["CR"] * self.scale, right_hand=right_hand)
        elif "AR" in values:
            centre, target = self._find_opening(words, start, target, right_hand=right_hand)
        elif values.keys() & {CENTRES[axis] for axis in PLANES[self.plane]}:
            centre = self._centre(words, start)
        elif values.keys() & {"AP", "RP"}:
            centre = self.pole
        else:
            raise self.error("arc has neither a centre (I J K) nor a radius (CR=), an angle (AR=) or a pole")
        flat = math.dist(_flat(start, normal), _flat(target, normal)) < 1e-9
        if flat and turns:
            note = f"a full circle with TURN={turns:g} is read as {turns + 1:g} turns: TURN adds to the circle itself"
            self.log.note(note, self.line)
        count = int(turns) + 1
        way = arc_about(start, target, centre, normal, right_hand=right_hand, turns=count).length
        feed = self._block_feed(words, way)
        self.contour.add(
            Element(start, target, named, feed, self.line, centre, normal, right_hand, count), self._corner(words)
        )

    def _centre(self, words: Words, start: Point) -> Point:
        """Return the centre of an arc: I J K count from the start, with AC() from the origin."""
        centre = list(start)
        for axis in PLANES[self.plane]:
            letter = CENTRES[axis]
            if letter in words.values:
                number = words.values[letter] * self.scale
                centre[axis] = number if letter in words.absolute else start[axis] + number
        return centre[0], centre[1], centre[2]

    def _find_middle(self, words: Words, start: Point, target: Point) -> tuple[Point, Point, bool]:
        """Return centre, axis and sense of an arc through a point (CIP)."""
        middle = list(start)
        for axis, letter in enumerate(MIDDLES):
            if letter in words.values:
                number = words.values[letter] * self.scale
                relative = letter in words.relative or (self.incremental and letter not in words.absolute)
                middle[axis] = number + (start[axis] if relative else 0.0)
        if not words.values.keys() & set(MIDDLES):
            raise self.error("CIP has no point on its way, expected I1= J1= K1=")
        arc = find_arc(start, (middle[0], middle[1], middle[2]), target)
        return arc.centre, arc.normal, arc.sweep > 0.0

    def _find_opening(self, words: Words, start: Point, target: Point, *, right_hand: bool) -> tuple[Point, Point]:
        """Return centre and end of an arc by its opening angle AR, with its end or its centre."""
        angle, normal = math.radians(words.values["AR"]), NORMALS[self.plane]
        if not 0.0 < angle < 2.0 * math.pi:
            raise self.error(f"AR={words.values['AR']:g}, expected more than 0 and less than 360")
        if words.values.keys() & set(CENTRES):
            centre = self._centre(words, start)
            arm = combine(1.0, _flat(start, normal), -1.0, _flat(centre, normal))
            turn = angle if right_hand else -angle
            side = (normal[1] * arm[2] - normal[2] * arm[1], normal[2] * arm[0] - normal[0] * arm[2],
                    normal[0] * arm[1] - normal[1] * arm[0])  # fmt: skip
            end = combine(1.0, combine(1.0, centre, math.cos(turn), arm), math.sin(turn), side)
            rise = dot(target, normal) - dot(end, normal)
            return centre, combine(1.0, end, rise, normal)
        chord = math.dist(_flat(start, normal), _flat(target, normal))
        radius = 0.5 * chord / math.sin(0.5 * angle)
        signed = radius if angle <= math.pi else -radius
        return find_centre(start, target, normal, signed, right_hand=right_hand), target


def _flat(point: Point, normal: Point) -> Point:
    """Return a point moved into the plane through the origin."""
    return combine(1.0, point, -dot(point, normal), normal)
