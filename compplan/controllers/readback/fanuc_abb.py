"""Interpreters of FANUC and RAPID programs, and of joint tables; see kuka_staubli."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from compplan.controllers.readback.poses import (
    NUMBER,
    Move,
    Pose,
    abb_pose,
    fanuc_pose,
    list_lines,
    read_action,
    read_numbers,
)

# ------------------------------------------------------------------------------------------------------------- FANUC


@dataclass
class _Fanuc:
    """A FANUC interpreter for J, L, C, CALL, and frames: set through a position register, or those of the cell."""

    registers: dict[str, list[float]] = field(default_factory=dict)
    frames: dict[str, Pose] = field(default_factory=lambda: {"UFRAME[0]": np.eye(4)})
    active: dict[str, str] = field(default_factory=dict)
    moves: list[Move] = field(default_factory=list)

    def run(self, path: Path) -> None:
        text = path.read_text()
        points = {int(number): body for number, body in re.findall(r"P\[(\d+)\]\{(.*?)\};", text, re.S)}
        body = text[text.index("/MN") : text.index("/POS")]
        for line in re.findall(r"^ *\d+: *([^;]*?) *;", body, re.M):
            if act := read_action(line, "fanuc_ls"):
                self.moves.append(act)
            elif match := re.fullmatch(rf"([JL]) P\[(\d+)\] ({NUMBER})(%|mm/sec|cm/min) (FINE|CNT\d+)( COORD)?", line):
                self.move(match[1], points[int(match[2])], *(float(match[3]), match[4], match[5]), carried=match[6])
            elif match := re.fullmatch(rf"C P\[(\d+)\]\n +: +P\[(\d+)\] ({NUMBER})(mm/sec|cm/min) (FINE|CNT\d+)", line):
                self.move("C", points[int(match[2])], float(match[3]), match[4], match[5], points[int(match[1])])
            elif match := re.fullmatch(r"CALL (\w+)", line):
                self.run(path.with_name(f"{match[1]}.LS"))
            elif not line.startswith("!"):
                self.assign(line)

    def assign(self, line: str) -> None:
        if match := re.fullmatch(r"(UFRAME|UTOOL)_NUM=(\d+)", line):
            self.active[match[1]] = f"{match[1]}[{match[2]}]"
        elif match := re.fullmatch(r"PR\[(\d+)\]=LPOS", line):
            self.registers[match[1]] = [0.0] * 6
        elif match := re.fullmatch(rf"PR\[(\d+),([1-6])\]=(?:\((-{NUMBER})\)|(?!-)({NUMBER}))", line):
            self.registers[match[1]][int(match[2]) - 1] = float(match[3] or match[4])
        else:
            match = re.fullmatch(r"((?:UFRAME|UTOOL)\[\d+\])=PR\[(\d+)\]", line)
            assert match, f"unknown line: {line}"
            self.frames[match[1]] = fanuc_pose(*self.registers[match[2]])

    def move(
        self, word: str, point: str, speed: float, unit: str, ending: str, through: str = "", carried: str | None = None
    ) -> None:
        point, *others = re.split(r"GP[2-9]:", point)
        values, between = _read_values(point), _read_values(through)
        via = fanuc_pose(*(between[key] for key in "XYZWPR")) if through else None
        joints = tuple(values[f"J{number}"] for number in range(1, 7)) if "J1" in values else None
        pose = fanuc_pose(*(values[key] for key in "XYZWPR")) if "X" in values else None
        base, configuration = self.frames.get(self.active["UFRAME"]), ()
        if pose is not None:
            (text,) = re.findall(r"CONFIG : '(.*)'", point)
            configuration = tuple(text.replace(",", " ").split())
        ((frame, tool),) = re.findall(r"UF : (\d+), UT : (\d+)", point)
        assert self.active == {"UFRAME": f"UFRAME[{frame}]", "UTOOL": f"UTOOL[{tool}]"}
        feed, percent = (None, speed) if unit == "%" else (speed / 6.0 if unit == "cm/min" else speed, None)
        external = tuple(values[key] for key in sorted(values) if key.startswith("E"))
        for text in others:
            external += tuple(float(number) for number in re.findall(rf"J\d= *({NUMBER}) deg", text))
        kind, stops = {"J": "joint", "L": "line", "C": "arc"}[word], ending in ("FINE", "CNT0")
        mounted = self.frames.get(self.active["UTOOL"])
        self.moves.append(Move(
            kind, stops, joints, external, pose, feed, percent, configuration, mounted, base, via=via,
            carried=carried is not None,
        ))  # fmt: skip


def _read_values(text: str) -> dict[str, float]:
    """Return the numbers of a position by name: X, W, J1, E1 .."""
    found = re.findall(rf"(\w\d?) *= *({NUMBER}) +(mm|deg)", text)
    assert all((unit == "mm") == (name[0] in "EXYZ") for name, _, unit in found)
    assert len({name for name, _, _ in found}) == text.count("=")
    return {name: float(number) for name, number, _ in found}


def read_fanuc(path: Path) -> list[Move]:
    """Interpret a FANUC .LS program and those that it calls."""
    interpreter = _Fanuc()
    interpreter.run(path)
    return interpreter.moves


# ------------------------------------------------------------------------------------------------------------- RAPID


_RAPID_MOVE = re.compile(r"(Move(?:AbsJ|L|C)) \[(.*)\],(\[[^\]]*\]),(\w+|\[FALSE,[^\]]*\]),(\w+)(?:\\WObj:=(\w+))?;")


@dataclass
class _Rapid:
    """A RAPID interpreter for calls, MoveAbsJ, MoveL and MoveC."""

    procedures: dict[str, str]
    tools: dict[str, tuple[Pose, tuple[float, ...]]]
    objects: dict[str, Pose]
    units: dict[str, str]
    moves: list[Move] = field(default_factory=list)
    active: set[str] = field(default_factory=set)

    def run(self, procedure: str) -> None:
        for line in list_lines(self.procedures[procedure], "!"):
            if act := read_action(line, "rapid"):
                self.moves.append(act)
            elif match := _RAPID_MOVE.fullmatch(line):
                self.move(match[1], match[2], read_numbers(match[3])[0], *match.groups()[3:])
            elif match := re.fullmatch(r"ActUnit (\w+);", line):
                self.active.add(match[1])
            elif line not in (r"ConfL\Off;", r"CirPathMode\ObjectFrame;"):
                match = re.fullmatch(r"(\w+);", line)
                assert match, f"unknown line: {line}"
                self.run(match[1])

    def move(self, word: str, target: str, feed: float, zone: str, tool: str, frame: str | None) -> None:
        groups = [read_numbers(text) for text in re.findall(r"\[(.*?)\]", target)]
        joints, pose, via = None, None, None
        configuration: tuple[object, ...] = ()
        if word == "MoveC":
            via, groups = abb_pose(*groups[:2]), groups[4:]
        if word == "MoveAbsJ":
            assert [len(group) for group in groups] == [6, 6]
            joints = tuple(groups[0])
        else:
            assert [len(group) for group in groups] == [3, 4, 4, 6]
            pose, configuration = abb_pose(*groups[:2]), tuple(int(number) for number in groups[2])
        external = tuple(value for value in groups[-1] if value != 9e9)
        mounted, load = self.tools.get(tool, (None, ()))
        base = np.eye(4) if frame is None else self.objects.get(frame)
        kind, stops = {"MoveAbsJ": "joint", "MoveL": "line", "MoveC": "arc"}[word], zone == "fine"
        self.moves.append(Move(
            kind, stops, joints, external, pose, feed, None, configuration, mounted, base, load, via=via,
            carried=self.units.get(frame or "", "") in self.active,
        ))  # fmt: skip


def read_rapid(path: Path) -> list[Move]:
    """Interpret the main procedure of a RAPID module; modules of its procedures are in the same folder."""
    parts = sorted(path.parent.glob("*.mod"))
    modules = "\n".join(file.read_text() for file in parts if file.stem[:-1].rstrip("0123456789").endswith("_"))
    text = path.read_text()
    procedures = dict(re.findall(r"PROC (\w+)\(\)\n(.*?)ENDPROC", modules + text, re.S))
    tools, objects, units = {}, {}, {}
    for name, value in re.findall(r"PERS tooldata (\w+):=(.*?);", text):
        numbers = read_numbers(value)
        assert value.startswith("[TRUE,[[") and len(numbers) == 7 + 11
        tools[name] = (abb_pose(numbers[:3], numbers[3:7]), tuple(numbers[7:11]))
    for name, value in re.findall(r"PERS wobjdata (\w+):=(.*?);", text):
        numbers = read_numbers(value)
        moving = re.match(r'\[FALSE,FALSE,"(\w+)",\[\[', value)
        assert moving or value.startswith('[FALSE,TRUE,"",[[')
        units[name], numbers = (moving[1] if moving else ""), numbers[-14:]
        assert len(numbers) == 14
        objects[name] = abb_pose(numbers[:3], numbers[3:7]) @ abb_pose(numbers[7:10], numbers[10:])
    interpreter = _Rapid(procedures, tools, objects, units)
    interpreter.run(re.findall(r"PROC (\w+)\(\)", text)[-1])
    return interpreter.moves


# --------------------------------------------------------------------------------------------------------------- CSV


def read_csv(path: Path, axes: tuple[str, ...], external: Iterable[bool]) -> list[Move]:
    """Read a joint table with these axis names, compared by letters and digits; `external` marks external axes."""
    header, *lines = path.read_text().splitlines()
    columns = [re.sub("[^A-Za-z0-9]", "", name) for name in header.split(",")]
    rows = [dict(zip(columns, map(float, line.split(",")), strict=True)) for line in lines]
    plain = [re.sub("[^A-Za-z0-9]", "", name) for name in axes]
    found = [(name + unit, out) for name, out in zip(plain, external, strict=True) for unit in ("deg", "mm")]
    arm, outer = ([name for name, out in found if name in columns and out == wanted] for wanted in (False, True))
    return [
        Move("joint", row["rapid"] == 1.0, tuple(row[name] for name in arm), tuple(row[name] for name in outer), None,
             row["feedmms"])
        for row in rows
    ]  # fmt: skip
