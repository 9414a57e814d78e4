"""Plain readers of robot programs, written from the syntax that the makers document; nothing of the package is in them.

URScript is run by Python's own parser, RAPID data by that of JSON, VAL3 data by that of XML; orientations by SciPy.
Each reader returns the targets of a program in order. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import ast
import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

N = r"([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)"


class Target(NamedTuple):
    """Where a move ends, as the controller's world sees it: the tip, or joints and the tool on the flange."""

    kind: str
    feed: float | None
    tip: np.ndarray | None = None
    joints: tuple[float, ...] = ()
    outer: float | None = None
    via: np.ndarray | None = None
    tool: np.ndarray | None = None


def pose(place: Any, rotation: Rotation) -> np.ndarray:
    found = np.eye(4)
    found[:3, 3], found[:3, :3] = np.asarray(place, float), rotation.as_matrix()
    return found


def euler(values: Any, axes: str) -> np.ndarray:
    """Place and three angles about `axes`, small letters fixed ones, in the order in which they are turned."""
    return pose(values[:3], Rotation.from_euler(axes, values[3:6], degrees=True))


def numbers(text: str) -> list[float]:
    return [float(value) for value in re.findall(rf"(?<![\w.]){N}", text)]


def parts_of(main: Path) -> list[Path]:
    """The main program, then its parts by number."""
    own = [file for file in main.parent.glob(f"{main.stem}*{main.suffix}") if re.fullmatch(
        rf"{re.escape(main.stem)}_?\d+", file.stem)]  # fmt: skip
    return [main, *sorted(own, key=lambda file: int(re.findall(r"\d+$", file.stem)[0]))]


def read_krl(main: Path) -> list[Target]:
    """KUKA: frames are X Y Z A B C, A about z, B about the new y, C about the newest x; $VEL.CP in m/s."""

    def frame(text: str) -> np.ndarray:
        return euler([float(re.findall(rf"\b{key} {N}", text)[0]) for key in "XYZABC"], "ZYX")

    def axes(text: str) -> dict[str, Any]:
        outer = re.findall(rf"\bE1 {N}", text)
        return {"joints": tuple(float(re.findall(rf"\bA{k} {N}", text)[0]) for k in range(1, 7)),
                "outer": float(outer[0]) if outer else None}  # fmt: skip

    found, base, tool, feed = list[Target](), np.eye(4), np.eye(4), 0.0
    for file in parts_of(main):
        for line in file.read_text().splitlines():
            word, _, rest = line.split(";")[0].strip().partition(" ")
            if line.startswith("$BASE="):
                base = frame(line)
            elif line.startswith("$TOOL="):
                tool = frame(line)
            elif line.startswith("$VEL.CP="):
                feed = 1e3 * float(line[8:])
            elif word == "PTP" and "{" in rest:
                found.append(Target("joint", None, **axes(rest), tool=tool))
            elif word in ("LIN", "CIRC"):
                *middle, end = re.findall(r"\{.*?\}", rest)
                via = (base @ frame(middle[0]))[:3, 3] if middle else None
                found.append(Target("arc" if middle else "line", feed, base @ frame(end), via=via))
    return found


def read_rapid(main: Path) -> list[Target]:
    """ABB: [place, quaternion with its real part first, configuration, external axes]; 9E9 is none."""

    def frame(place: list[float], turn: list[float]) -> np.ndarray:
        return pose(place, Rotation.from_quat([*turn[1:], turn[0]]))

    def data(text: str) -> tuple[list[Any], str]:
        value, end = json.JSONDecoder().raw_decode(text)
        return value, text[end:].lstrip(",")

    text = main.read_text()
    tool = data(re.sub("TRUE|FALSE", "0", re.findall(r"tooldata \w+:=(.*);", text)[0]))[0][1]
    work = data(re.sub("TRUE|FALSE", "0", re.findall(r"wobjdata \w+:=(.*);", text)[0]))[0]
    base, found = frame(*work[3]) @ frame(*work[4]), list[Target]()
    for file in parts_of(main)[1:]:
        for word, rest in re.findall(r"^ *(Move\w+) (.*)$", file.read_text(), re.M):
            target, rest = data(rest)
            via = None
            if word == "MoveC":
                via = (base @ frame(*target[:2]))[:3, 3]
                target, rest = data(rest)
            speed = data(rest)[0][0]
            if word == "MoveAbsJ":
                outer = None if target[1][0] == 9e9 else target[1][0]
                found.append(Target("joint", speed, None, tuple(target[0]), outer, tool=frame(*tool)))
            else:
                found.append(Target("line" if via is None else "arc", speed, base @ frame(*target[:2]), via=via))
    return found


def read_fanuc(main: Path) -> list[Target]:
    """FANUC: positions by number; W P R about the fixed x, y, z; frames through a position register."""
    found, frames, register = list[Target](), {}, np.zeros(6)
    for file in parts_of(main):
        text = file.read_text()
        points = dict(re.findall(r"^P\[(\d+)\]\{(.*?)^\};", text, re.M | re.S))
        values = {number: {key: float(value) for key, value in re.findall(rf"(\w\d?) *= *{N} +(?:mm|deg)", point)}
                  for number, point in points.items()}  # fmt: skip
        at = {number: euler([own[key] for key in "XYZWPR"], "xyz") for number, own in values.items() if "W" in own}
        middle = ""
        for line in text[text.index("/MN") : text.index("/POS")].splitlines():
            if match := re.search(rf"PR\[99,(\d)\]=\(?{N}", line):
                register[int(match[1]) - 1] = float(match[2])
            elif match := re.search(r"(UFRAME|UTOOL)\[1\]=PR", line):
                frames[match[1]] = euler(register, "xyz")
            elif match := re.search(r"C P\[(\d+)\]$", line.strip()):
                middle = match[1]
            elif match := re.search(rf"([JL:]) +P\[(\d+)\] {N}(%|mm/sec|cm/min)", line):
                word, number, speed, unit = match.groups()
                own, feed = values[number], float(speed) / (6.0 if unit == "cm/min" else 1.0)
                if "J1" in own:
                    joints = tuple(own[f"J{k}"] for k in range(1, 7))
                    found.append(Target("joint", None, None, joints, own.get("E1"), tool=frames["UTOOL"]))
                else:
                    via = (frames["UFRAME"] @ at[middle])[:3, 3] if word == ":" else None
                    kind = "line" if via is None else "arc"
                    found.append(Target(kind, feed, frames["UFRAME"] @ at[number], via=via))
    return found


def read_inform(main: Path) -> list[Target]:
    """Yaskawa: C positions in the order of POSTYPE; Rx Ry Rz about the fixed x, y, z; frames are P variables."""
    text, points, kind = main.read_text(), dict[str, tuple[str, list[float]]](), ""
    for line in text.splitlines():
        if line.startswith("///POSTYPE"):
            kind = line.split()[1]
        elif match := re.fullmatch(r"([CP]\d{5})=(.*)", line):
            points[match[1]] = kind, numbers(match[2])
    frames = {
        word: euler(points[name][1], "xyz") for word, name in re.findall(r"^(MFRAME|SETTOOL) .* (P\d+)", text, re.M)
    }
    found = []
    for name, speed in re.findall(rf"^MOV[JL] (C\d+) VJ?={N}", text, re.M):
        kind, values = points[name]
        if kind == "ANGLE":
            found.append(Target("joint", None, None, tuple(values), tool=frames["SETTOOL"]))
        else:
            found.append(Target("line", float(speed), frames["MFRAME"] @ euler(values, "xyz")))
    return found


def read_val3(project: Path) -> list[Target]:
    """Staubli: arrays of a .dtx file, rx ry rz about x, the new y, the newest z; tvel in mm/s."""
    root = ElementTree.parse(next(project.glob("*.dtx"))).getroot()
    data = {each.attrib["name"]: [child.attrib for child in each] for each in root.iter() if each.tag.endswith("}Data")}

    def frame(name: str, index: int = 0) -> np.ndarray:
        own = data[name][index]
        return euler([float(own[key]) for key in ("x", "y", "z", "rx", "ry", "rz")], "XYZ")

    def axes(name: str, index: int) -> tuple[float, ...]:
        return tuple(float(data[name][index][f"j{k}"]) for k in range(1, 7))

    found, feed, base, tool = list[Target](), dict[str, float](), frame("fPart"), frame("tTool")
    for file in sorted(project.glob("part*.pgx"), key=lambda file: int(file.stem[4:])):
        code = file.read_text()
        if "movel" not in code and "for " in code:  # a loop over the array of joint positions
            name = re.findall(r"jPath\d+", code)[0]
            found += [Target("joint", None, None, axes(name, row), tool=tool) for row in range(len(data[name]))]
            continue
        for line in code.splitlines():
            if match := re.search(rf"(\w+)\.tvel={N}", line):
                feed[match[1]] = float(match[2])
            elif match := re.search(r"move([jlc])\((?:(\w+)\[(\d+)\],)?(\w+)\[(\d+)\],\w+,(\w+)\)", line):
                kind, middle, row, name, index, how = match.groups()
                if kind == "j":
                    found.append(Target("joint", None, None, axes(name, int(index)), tool=tool))
                else:
                    via = (base @ frame(middle, int(row)))[:3, 3] if middle else None
                    target = base @ frame(name, int(index))
                    found.append(Target("arc" if middle else "line", feed[how], target, via=via))
    return found


def read_urscript(main: Path) -> list[Target]:
    """Universal Robots: m, rad and rotation vectors; the body of the function is run as the Python that it reads as."""

    class Poses:
        def __getitem__(self, values: tuple[float, ...]) -> np.ndarray:
            return pose(1e3 * np.array(values[:3]), Rotation.from_rotvec(values[3:6]))

    found, tool = list[Target](), dict[str, np.ndarray]()

    def movej(joints: list[float], **how: float) -> None:
        found.append(Target("joint", None, None, tuple(np.degrees(joints)), tool=tool["tcp"]))

    def movel(target: np.ndarray, **how: float) -> None:
        found.append(Target("line", 1e3 * how["v"], target))

    def movec(via: np.ndarray, target: np.ndarray, **how: float) -> None:
        found.append(Target("arc", 1e3 * how["v"], target, via=via[:3, 3]))

    words: dict[str, Any] = {
        "p": Poses(), "movej": movej, "movel": movel, "movec": movec, "set_tcp": lambda tcp: tool.update(tcp=tcp),
        "pose_trans": lambda first, second: first @ second, "set_target_payload": lambda *load: None,
        "set_payload": lambda *load: None, "popup": lambda *words, **more: None,
    }  # fmt: skip
    text = re.sub(r"^ *end *$", "", main.read_text(), flags=re.M)
    exec(compile(ast.parse(text), main.name, "exec"), words)
    return found


def read_kawasaki(main: Path) -> list[Target]:
    """Kawasaki: variables that all programs of a controller share; O A T about z, the new y, the newest z."""
    values, found, base, tool, speed, middle = dict[str, list[float]](), list[Target](), np.eye(4), np.eye(4), 0.0, ""
    for file in main.parent.glob("*.as"):
        for block in re.findall(r"^\.(?:JOINTS|TRANS)\n(.*?)^\.END", file.read_text(), re.M | re.S):
            for line in block.splitlines():
                name, *rest = line.split()
                assert name not in values, f"two programs call a point {name}"
                values[name] = [float(text) for text in rest]
    for file in parts_of(main):
        for line in file.read_text().splitlines():
            if match := re.search(r"(part = |TOOL )TRANS\((.*)\)", line):
                own = euler(numbers(match[2]), "ZYZ")
                base, tool = (own, tool) if "part" in match[1] else (base, own)
            elif match := re.search(rf"SPEED {N}", line):
                speed = float(match[1])
            elif match := re.search(r"C1MOVE part\+(\w+)", line):
                middle = match[1]
            elif match := re.search(r"JMOVE (#\w+)", line):
                own_joints = values[match[1]]
                outer = own_joints[6] if len(own_joints) > 6 else None
                found.append(Target("joint", None, None, tuple(own_joints[:6]), outer, tool=tool))
            elif match := re.search(r"(L|C2)MOVE part\+(\w+)", line):
                via = (base @ euler(values[middle], "ZYZ"))[:3, 3] if match[1] == "C2" else None
                found.append(
                    Target("line" if via is None else "arc", speed, base @ euler(values[match[2]], "ZYZ"), via=via)
                )
    return found


def read_sinumerik(main: Path) -> list[Target]:
    """Siemens: TRANS and AROT, X Y Z of the tip, A2 B2 C2 of the flange about the fixed x, y, z; F in mm/min."""
    base, found, feed = np.eye(4), list[Target](), 0.0
    for line in main.read_text().splitlines():
        words = {key: float(value) for key, value in re.findall(rf"(?<!\w)([XYZF]|[ABC]2=|E1=){N}", line.split(";")[0])}
        if line.startswith("TRANS"):
            base = pose([words.get(key, 0.0) for key in "XYZ"], Rotation.identity())
        elif line.startswith("AROT"):
            ((axis, angle),) = words.items()
            base = base @ pose(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True))
        elif match := re.match(r"N\d+ (G0|G1|CIP) ", line):
            feed, middle = words.get("F", feed), re.findall(rf"[IJK]1=AC\({N}\)", line)
            tip = base @ euler([words[key] for key in ("X", "Y", "Z", "A2=", "B2=", "C2=")], "xyz")
            via = (base @ pose(middle, Rotation.identity()))[:3, 3] if middle else None
            kind = {"G0": "joint", "G1": "line", "CIP": "arc"}[match[1]]
            found.append(Target(kind, None if kind == "joint" else feed / 60.0, tip, outer=words.get("E1="), via=via))
    return found


def read_csv(main: Path) -> list[Target]:
    """A joint table."""
    with main.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [Target("joint", float(row["feed_mm_s"]), None, tuple(float(row[f"A{k}_deg"]) for k in range(1, 7)),
                   float(row["E1_mm"]) if "E1_mm" in row else None) for row in rows]  # fmt: skip


#: Files of each language, joint and linear programs, and who reads them.
READERS: dict[str, tuple[str, str, Callable[[Path], list[Target]]]] = {
    "krl": ("{}_J.src", "{}_L.src", read_krl), "rapid": ("{}.mod", "{}_L.mod", read_rapid),
    "fanuc_ls": ("{}.LS", "{}_L.LS", read_fanuc), "inform": ("{}.JBI", "{}_L.JBI", read_inform),
    "val3": ("{}", "{}_L", read_val3), "urscript": ("{}.script", "{}_L.script", read_urscript),
    "kawasaki_as": ("{}.as", "{}_l.as", read_kawasaki), "sinumerik": ("", "{}.MPF", read_sinumerik),
    "csv": ("{}_joints.csv", "", read_csv),
}  # fmt: skip
