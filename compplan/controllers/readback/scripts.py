"""Interpreters of URScript, SINUMERIK, INFORM and AS programs; see languages."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.readback.poses import (
    NUMBER,
    Move,
    Pose,
    fanuc_pose,
    kawasaki_pose,
    list_lines,
    read_action,
    read_numbers,
    shift,
    turn,
    vector_pose,
)

# ---------------------------------------------------------------------------------------------------------- URScript

_SCRIPT_POSE = r"pose_trans\(part, p\[(.*?)\]\)"
_SCRIPT_END = rf"v=({NUMBER})(?:, r=({NUMBER}))?"


def read_urscript(path: Path) -> list[Move]:
    """Interpret a URScript program, or its numbered parts in order."""
    parts = sorted(path.parent.glob(f"{path.stem}_[0-9]*.script"), key=lambda part: int(part.stem.split("_")[-1]))
    return [move for part in ([path] if path.exists() else parts) for move in _run_script(part)]


def _run_script(path: Path) -> list[Move]:
    lines = list_lines(path.read_text(), "#")
    assert (lines[0], *lines[-2:]) == (f"def {path.stem}():", "end", f"{path.stem}()")
    frames: dict[str, Pose | None] = {}
    load: tuple[float, ...] = ()
    moves = []
    for line in lines[1:-2]:
        if act := read_action(line, "urscript"):
            moves.append(act)
        elif match := re.fullmatch(r"set_tcp\(p\[(.*)\]\)", line):
            frames["tool"] = vector_pose(*read_numbers(match[1]))
        elif match := re.fullmatch(r"part = p\[(.*)\]", line):
            frames["part"] = vector_pose(*read_numbers(match[1]))
        elif match := re.fullmatch(rf"set_(?:target_)?payload\(({NUMBER}), \[(.*)\]\)", line):
            load = (float(match[1]), *(value * 1e3 for value in read_numbers(match[2])))
        elif re.fullmatch(r"part = \w+", line):
            frames["part"] = None
        elif match := re.fullmatch(rf"movej\(\[(.*)\], a=1.4, {_SCRIPT_END}\)", line):
            joints = tuple(math.degrees(value) for value in read_numbers(match[1]))
            rate, stops = math.degrees(float(match[2])), not float(match[3] or 0)
            moves.append(Move("joint", stops, joints, rate=rate, tool=frames.get("tool"), base=np.eye(4), load=load))
        else:
            pattern = rf"(?:movel\(|movec\({_SCRIPT_POSE}, ){_SCRIPT_POSE}, a=1.2, {_SCRIPT_END}(, mode=0)?\)"
            match = re.fullmatch(pattern, line)
            assert match and (match[1] is None) == (match[5] is None), f"unknown line: {line}"
            via = None if match[1] is None else vector_pose(*read_numbers(match[1]))
            moves.append(Move(
                "line" if via is None else "arc", not float(match[4] or 0), pose=vector_pose(*read_numbers(match[2])),
                feed=float(match[3]) * 1e3, tool=frames.get("tool"), base=frames["part"], load=load, via=via,
            ))  # fmt: skip
    return moves


# --------------------------------------------------------------------------------------------------------- SINUMERIK


_WORD = re.compile(rf"([XYZ]) ?({NUMBER})")
#: Words with the settings that the reader assumes.
KNOWN = {"G17", "G90", "G94", "G710", "G500", "D1", "TRAORI", "ORIWKS", "ORIRPY", "G642", "TRAFOOF", "M30"}


@dataclass
class _Sinumerik:
    """A SINUMERIK interpreter for TRANS, AROT, tool lengths, G0, G1, CIP, PTP, CP and calls."""

    folder: Path
    frame: Pose | None = field(default_factory=lambda: np.eye(4))
    lengths: dict[str, float] = field(default_factory=dict)
    modal: set[str] = field(default_factory=set)
    travel: str = "CP"
    feed: float = 0.0
    moves: list[Move] = field(default_factory=list)
    cell_frame: Pose | None = None

    def read_cell_comments(self, text: str) -> None:
        """Read from comments the tool lengths and the frame that users have to enter in the cell."""
        if match := re.search(r"^; lengths of D1 of tool \d+ have to be: (Z.*)$", text, re.M):
            self.lengths = {str(5 - "XYZ".index(name)): float(value) for name, value in _WORD.findall(match[1])}
        if match := re.search(r"^; \S+ has to be the part frame: (X.*)\n; turned by (.*)$", text, re.M):
            self.cell_frame = shift(*(float(value) for _, value in _WORD.findall(match[1])))
            for name, value in _WORD.findall(match[2]):
                self.cell_frame = self.cell_frame @ turn(name.lower(), float(value))

    def run(self, text: str) -> None:
        self.read_cell_comments(text)
        for line in list_lines(text):
            line = re.sub(r"^N\d+ ", "", line)
            if act := read_action(line, "sinumerik"):
                self.moves.append(act)
            elif match := re.fullmatch(rf"\$TC_DP([1345])\[\d+,1\]=({NUMBER})", line):
                self.lengths[match[1]] = float(match[2])
            elif match := re.fullmatch(rf"TRANS X({NUMBER}) Y({NUMBER}) Z({NUMBER})", line):
                self.frame = shift(*map(float, match.groups()))
            elif match := re.fullmatch(rf"AROT ([XYZ])({NUMBER})", line):
                self.frame = self.frame @ turn(match[1].lower(), float(match[2]))
            elif line == "TRANS":
                self.frame = np.eye(4)
            elif line in ("PTP", "CP"):
                self.travel = line
            elif line.startswith(("G0 ", "G1 ", "CIP ")):
                between = re.findall(rf"([IJK]1)=AC\(({NUMBER})\)", line)
                via = shift(*(float(dict(between)[key]) for key in ("I1", "J1", "K1"))) if between else None
                code, _, rest = re.sub(rf" [IJK]1=AC\({NUMBER}\)", "", line).partition(" ")
                words = re.findall(rf"(?:(STAT|TU|[ABC]2|E1)=|([XYZF]))({NUMBER})", rest)
                self.move({word or letter: number for word, letter, number in words}, code, line.endswith(" G9"), via)
            elif (self.folder / f"{line}.SPF").exists():
                part = (self.folder / f"{line}.SPF").read_text()
                assert part.splitlines()[-1] == "M17"
                self.run(part.removesuffix("M17\n"))
            else:
                codes = {re.sub(r"^T\d+$", "T", w) for w in re.sub(rf"^G641 ADIS={NUMBER}$", "G642", line).split()}
                if own := {word for word in codes if re.fullmatch(r"G5(?:[4-7]|\d\d)", word)} - {"G500"}:
                    self.frame = self.cell_frame
                assert codes <= KNOWN | own | {"T"}, f"unknown line: {line}"
                self.modal |= codes

    def move(self, words: dict[str, str], code: str, stops: bool, via: Pose | None) -> None:
        assert (code == "CIP") == (via is not None)
        assert {"TRAORI", "ORIRPY", "G94", "G17", "T"} <= self.modal
        value = {key: float(number) for key, number in words.items()}
        self.feed = value.get("F", self.feed)
        mounted = shift(self.lengths["5"], self.lengths["4"], self.lengths["3"]) if self.lengths else None
        pose = fanuc_pose(*(value[key] for key in ("X", "Y", "Z", "A2", "B2", "C2")))
        kind = {("G0", "PTP"): "joint", ("G1", "CP"): "line", ("CIP", "CP"): "arc"}[code, self.travel]
        external = tuple(value[key] for key in value if key.startswith("E"))
        configuration = tuple(int(value[key]) for key in ("STAT", "TU") if key in value)
        feed = None if kind == "joint" else self.feed / 60
        self.moves.append(
            Move(kind, stops, None, external, pose, feed, None, configuration, mounted, self.frame, flange_turn=True,
                 via=via)
        )  # fmt: skip


def read_sinumerik(path: Path) -> list[Move]:
    """Interpret a SINUMERIK part program; subprograms are in the same folder."""
    interpreter = _Sinumerik(path.parent)
    interpreter.run(path.read_text())
    return interpreter.moves


# ------------------------------------------------------------------------------------------------------------ INFORM


def read_inform(path: Path, frames: dict[str, Pose] | None = None) -> list[Move]:
    """Interpret an INFORM job and the jobs that it calls."""
    frames = frames if frames is not None else {}
    head, body = path.read_text().split("NOP\n")
    points, stations, variables, kind = {}, {}, {}, ""
    configuration: tuple[int, ...] = ()
    for line in head.splitlines():
        if line.startswith("///POSTYPE "):
            kind = line.split()[1]
        elif line.startswith("///RCONF "):
            configuration = tuple(int(number) for number in line.split()[1].split(","))
            assert len(configuration) == 24
        elif match := re.fullmatch(r"C(\d{5})=(.*)", line):
            points[match[1]] = (kind, read_numbers(match[2]), configuration[:6])
        elif match := re.fullmatch(r"EC(\d{5})=(.*)", line):
            assert kind == "ANGLE"
            stations[match[1]] = tuple(read_numbers(match[2]))
        elif match := re.fullmatch(r"P(\d{5})=(.*)", line):
            assert kind == "BASE"
            variables[match[1]] = fanuc_pose(*read_numbers(match[2]))
    assert re.search(rf"^///NPOS {len(points)},0,{len(stations)},{len(variables)},0,0$", head, re.M)
    assert not stations or re.search(r"^///GROUP2 ST\d+$", head, re.M)
    moves: list[Move] = []
    for line in body.removesuffix("END\n").splitlines():
        if act := read_action(line, "inform"):
            moves.append(act)
        elif match := re.fullmatch(r"(MFRAME UF#\(\d+\)|SETTOOL TL#\(\d+\)) P(\d{5})( BF)?", line):
            frames[match[1][0]] = variables[match[2]]
        elif match := re.fullmatch(r"CALL JOB:(\w+)", line):
            called = path.with_name(f"{match[1]}.JBI")  # a job of the cell changes tools
            moves += read_inform(called, frames) if called.exists() else [Move("act", True, action=line)]
        elif not line.startswith("'"):
            other = rf"(?: \+MOVJ EC(\d{{5}})(?: VJ={NUMBER})?)?"
            match = re.fullmatch(rf"S?MOV([JL]) C(\d{{5}}) (VJ|V)=({NUMBER}) PL=(\d){other}", line)
            assert match, f"unknown line: {line}"
            assert line.startswith("S") == (match[6] is not None and match[1] == "L")
            external = () if match[6] is None else stations[match[6]]
            assert (match[1], match[3]) in (("J", "VJ"), ("L", "V"))
            kind, values, words = points[match[2]]
            speed: dict[str, Any] = {"percent" if match[1] == "J" else "feed": float(match[4])}
            stops, name = match[5] == "0", {"J": "joint", "L": "line"}[match[1]]
            target: dict[str, Any] = {"joints": tuple(values)} if kind == "ANGLE" else {"pose": fanuc_pose(*values)}
            assert kind in ("ANGLE", "USER")
            words = words if kind == "USER" else ()
            base = frames.get("M") if kind == "USER" else np.eye(4)
            target |= {"external": external, "carried": line.startswith("S")}
            moves.append(Move(name, stops, **target, **speed, configuration=words, tool=frames.get("S"), base=base))
    return moves


# ------------------------------------------------------------------------------------------------------- Kawasaki AS


def read_kawasaki(path: Path) -> list[Move]:
    """Interpret the program of an AS file; further programs are in the same folder."""
    programs: dict[str, list[str]] = {}
    values: dict[str, list[float]] = {}
    for file in path.parent.glob("*.as"):
        text = file.read_text()
        for head, body in re.findall(r"^\.(PROGRAM \w+\(\)|JOINTS|TRANS)\n(.*?)^\.END", text, re.M | re.S):
            if head.startswith("PROGRAM"):
                programs[head[8:-2]] = list_lines(body)
            else:
                values |= {line.split()[0]: [float(n) for n in line.split()[1:]] for line in body.splitlines()}
    runner = _Kawasaki(programs, values)
    runner.run(path.stem)
    return runner.moves


@dataclass
class _Kawasaki:
    programs: dict[str, list[str]]
    values: dict[str, list[float]]
    frames: dict[str, Pose | None] = field(default_factory=dict)
    load: tuple[float, ...] = ()
    speed: tuple[float, str] = (0.0, "")
    blends: bool = False
    between: Pose | None = None
    moves: list[Move] = field(default_factory=list)

    def run(self, name: str) -> None:
        for line in self.programs[name]:
            if act := read_action(line, "kawasaki_as"):
                self.moves.append(act)
            elif match := re.fullmatch(r"POINT part = TRANS\((.*)\)|TOOL TRANS\((.*)\)", line):
                numbers = read_numbers(match[1] or match[2])
                self.frames["part" if match[1] else "tool"] = kawasaki_pose(*numbers)
            elif match := re.fullmatch(r"POINT (part) = \w+|(TOOL) \w+", line):
                self.frames[(match[1] or match[2]).lower()] = None
            elif line.startswith("WEIGHT "):
                self.load = tuple(read_numbers(line))
            elif line.startswith("ACCURACY "):
                self.blends = read_numbers(line)[0] > 0 and "CP" in self.frames
            elif line == "CP ON":
                self.frames["CP"] = np.eye(4)
            elif match := re.fullmatch(rf"SPEED ({NUMBER})( MM/S)?", line):
                self.speed = (float(match[1]), match[2] or "")
            elif match := re.fullmatch(r"CALL (\w+)", line):
                self.run(match[1])
            elif line == "BREAK":
                self.moves[-1] = self.moves[-1]._replace(stops=True)
            else:
                self.move(line)

    def move(self, line: str) -> None:
        if match := re.fullmatch(r"C1MOVE part\+(\w+)", line):
            self.between = kawasaki_pose(*self.values[match[1]][:6])
            return
        arc = line.startswith("C2MOVE ")
        assert arc == (self.between is not None)
        match = re.fullmatch(r"JMOVE (#\w+)|(?:L|C2)MOVE part\+(\w+)", line)
        assert match, f"unknown line: {line}"
        numbers = self.values[match[1] or match[2]]
        external, tool = tuple(numbers[6:]), self.frames["tool"]
        target: dict[str, Any]
        if match[1]:
            assert self.speed[1] == ""
            kind, target = "joint", {"joints": tuple(numbers[:6]), "percent": self.speed[0], "base": np.eye(4)}
        else:
            assert self.speed[1] == " MM/S"
            pose = kawasaki_pose(*numbers[:6])
            kind, target = "arc" if arc else "line", {"pose": pose, "feed": self.speed[0], "base": self.frames["part"]}
            target["via"], self.between = self.between, None
        self.moves.append(Move(kind, not self.blends, external=external, tool=tool, load=self.load, **target))
