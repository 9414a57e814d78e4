"""Interpreters of KRL, VAL3, FANUC and RAPID programs, independent of the writers.

Each returns the moves in order of execution, with the data in force at each: tool, base, speed, and whether the robot
stops there. An unknown line is an error. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from compplan.controllers.readback.poses import (
    NUMBER,
    Move,
    Pose,
    abb_pose,
    fanuc_pose,
    kuka_pose,
    list_lines,
    read_action,
    read_numbers,
    staubli_pose,
)

# --------------------------------------------------------------------------------------------------------------- KRL

ARM = ("A1", "A2", "A3", "A4", "A5", "A6")
_KRL_FIELD = re.compile(rf"(\w+) ({NUMBER})")
_KRL_MOVE = re.compile(r"(PTP|LIN|CIRC) (?:(\{.*?\}),)?(\{.*?\})(?: (C_\w+))?")


@dataclass
class _Krl:
    """A KRL interpreter for assignments, calls, PTP, LIN and CIRC."""

    folder: Path
    values: dict[str, Any] = field(default_factory=lambda: {"$NULLFRAME": dict.fromkeys("XYZABC", 0.0)})
    moves: list[Move] = field(default_factory=list)
    carried: bool = False

    def evaluate(self, text: str) -> Any:
        text = text.strip()
        if text.startswith("#"):
            return text
        if text.startswith("{M "):
            return read_numbers(text)[:4]
        if text.startswith("{"):
            return {key: float(value) for key, value in _KRL_FIELD.findall(text)}
        if text[0] in "-.0123456789":
            return float(text)
        name = text.upper()
        return self.values.get(name) if name.startswith(("BASE_DATA", "TOOL_DATA", "LOAD_DATA")) else self.values[name]

    def assign(self, name: str, text: str) -> None:
        self.values[name.strip().upper()] = self.evaluate(text)

    def call(self, name: str) -> None:
        file = self.folder / f"{name}.src"
        assert file.read_bytes().count(b"\r\n") > 2, "CR LF"
        lines = list_lines(file.read_text())
        for line in lines[lines.index(f"DEF {name}()") + 1 : lines.index("END")]:
            self.step(line)

    def step(self, line: str) -> None:
        if moved := _KRL_MOVE.fullmatch(line):
            assert (moved[1] == "CIRC") == (moved[2] is not None)
            self.move(moved[1], self.evaluate(moved[3]), moved[4], self.evaluate(moved[2]) if moved[2] else None)
        elif act := read_action(line, "krl"):
            self.moves.append(act)
        elif match := re.fullmatch(r"BAS\(#VEL_PTP,(\d+)\)", line):
            self.values |= {f"$VEL_AXIS[{axis}]": float(match[1]) for axis in range(1, 7)}
        elif line in ("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()", "INTERRUPT ON 3"):
            pass  # standard declarations of every module: stop messages
        elif line == "BAS(#INITMOV,0)":
            self.values |= {"$APO.CPTP": 0.0, "$APO.CDIS": 0.0, "$ADVANCE": 3.0}
        elif match := re.fullmatch(r"(\w+)\(\)", line):
            self.call(match[1])
        elif match := re.fullmatch(r"\$BASE=EK\(MACHINE_DEF\[(\d+)\].ROOT,MACHINE_DEF\[\1\].MECH_TYPE,(.*)\)", line):
            self.assign("$BASE", match[2])
            self.carried = True
        else:
            assert "=" in line, f"unknown line: {line}"
            self.carried = self.carried and not line.startswith("$BASE=")
            self.assign(*line.split("=", 1))

    def move(self, word: str, point: dict[str, float], blend: str | None, via: dict[str, float] | None) -> None:
        turned = self.values.get("$CIRC_TYPE"), self.values.get("$ORI_TYPE")
        assert via is None or turned == ("#BASE", "#VAR"), "arcs whose turn of the tool is not stated"
        space = {"C_PTP": "$APO.CPTP", "C_DIS": "$APO.CDIS"}.get(blend or "")
        stops = space is None or not self.values.get(space) or not self.values.get("$ADVANCE")
        places = {key: self.values[f"${key.upper()}"] for key in ("tool", "base")}
        frames: dict[str, Any] = {key: place and _place_kuka(place) for key, place in places.items()}
        joints = tuple(point[name] for name in ARM) if "A1" in point else None
        pose = _place_kuka(point) if "X" in point else None
        configuration = tuple(int(point[key]) for key in "ST" if key in point)
        external = tuple(point.get(f"E{number}", 0.0) for number in range(1, 7))
        feed, percent = (float(self.values["$VEL.CP"]) * 1e3, None) if word != "PTP" else (None, self.percent())
        kind = {"PTP": "joint", "LIN": "line", "CIRC": "arc"}[word]
        middle = None if via is None else _place_kuka(via)
        load = tuple(self.values.get("$LOAD") or ())
        self.moves.append(Move(
            kind, stops, joints, external, pose, feed, percent, configuration, **frames, load=load, via=middle,
            carried=self.carried,
        ))  # fmt: skip

    def percent(self) -> float:
        rates = {self.values[f"$VEL_AXIS[{number}]"] for number in range(1, 7)}
        assert len(rates) == 1, "axes differ"
        return float(rates.pop())


def _place_kuka(values: dict[str, float]) -> Pose:
    return kuka_pose(*(values[key] for key in "XYZABC"))


def read_krl(source: Path) -> list[Move]:
    """Interpret a KRL program with the name of its .src file; parts and data are in the same folder."""
    interpreter = _Krl(source.parent)
    interpreter.call(source.stem)
    return interpreter.moves


# -------------------------------------------------------------------------------------------------------------- VAL3


_VAL3_MOVE = re.compile(r"move([jlc])\((?:(\w+)\[(\d+)\],)?(\w+)\[(\d+)\],(\w+),(\w+)\)")


def _val3_tag(element: ElementTree.Element) -> str:
    return element.tag.split("}")[-1]


@dataclass
class _Val3:
    """A VAL3 interpreter for calls, movej, movel and movec over the arrays of the .dtx file."""

    folder: Path
    data: dict[str, list[dict[str, str]]]
    waited: bool = True
    moves: list[Move] = field(default_factory=list)

    def call(self, name: str) -> None:
        root = ElementTree.fromstring((self.folder / f"{name}.pgx").read_text())
        code = next(element.text or "" for element in root.iter() if _val3_tag(element) == "Code")
        lines = list_lines(code, "//")
        assert (lines[0], lines[-1]) == ("begin", "end")
        for line in lines[1:-1]:
            self.step(line)

    def place(self, name: str, index: int = 0) -> Any:
        """Return the pose of an array element."""
        return staubli_pose(*(float(self.data[name][index][key]) for key in ("x", "y", "z", "rx", "ry", "rz")))

    def step(self, line: str) -> None:
        if match := _VAL3_MOVE.fullmatch(line):
            self.move(*(text or "" for text in match.groups()))
        elif feed := re.fullmatch(rf"(\w+)\.tvel=({NUMBER})", line):
            self.data[feed[1]][0]["tmax"] = feed[2]
        elif zone := re.fullmatch(rf"(\w+)\.(leave|reach)=({NUMBER})", line):
            self.data[zone[1]][0][zone[2]] = zone[3]
        elif act := read_action(line, "val3"):
            assert self.waited, "what happens beside motion does not wait for the arm"
            self.moves.append(act)
        elif called := re.fullmatch(r"call (\w+)\(\)", line):
            self.call(called[1])
        elif line == "waitEndMove()":
            self.moves[-1:] = [move._replace(stops=True) for move in self.moves[-1:]]
            self.waited = True
        else:
            assert line == "resetMotion()", f"unknown line: {line}"

    def move(self, kind: str, vias: str, middle: str, points: str, index: str, mounted: str, way: str) -> None:
        row = int(index)
        assert (kind == "c") == bool(vias)
        point, tool, how = self.data[points][row], self.data[mounted][0], self.data[way][0]
        assert tool["fatherId"] == "flange[0]"
        self.waited = False
        joints, pose, base = None, None, np.eye(4)
        if kind == "j":
            joints = tuple(float(point[f"j{number}"]) for number in range(1, 7))
        else:
            father = point["fatherId"].removesuffix("[0]")
            (frame,) = self.data[father]
            assert frame["fatherId"] == "world[0]"
            pose, base = self.place(points, row), self.place(father)
        words = tuple(point[key] for key in ("shoulder", "elbow", "wrist") if key in point)
        stops = how["blend"] == "off" or not float(how["leave"])
        slow = float(how["tmax"]) < 99999
        feed, percent = (float(how["tmax"]), None) if slow else (None, float(how["vel"]))
        name, via = {"j": "joint", "l": "line", "c": "arc"}[kind], self.place(vias, int(middle)) if vias else None
        self.moves.append(Move(name, stops, joints, (), pose, feed, percent, words, self.place(mounted), base, via=via))


def read_val3(project: Path) -> list[Move]:
    """Interpret the program start of a VAL3 project folder."""
    data: dict[str, list[dict[str, str]]] = {}
    root = ElementTree.fromstring(next(project.glob("*.dtx")).read_text())
    for element in root.iter():
        if _val3_tag(element) == "Data":
            values = [dict(child.attrib) for child in element]
            assert [value["key"] for value in values] == [str(key) for key in range(int(element.attrib["size"]))]
            data[element.attrib["name"]] = values
    listed = re.search(r'millimeterUnit="(\w+)"', next(project.glob("*.pjx")).read_text())
    assert listed and listed[1] == "true"
    interpreter = _Val3(project, data)
    interpreter.call("start")
    return interpreter.moves


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
