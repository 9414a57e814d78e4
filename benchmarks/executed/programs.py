"""Read written programs as text: lines, arcs, feeds and zones of RAPID, KRL and URScript.

A motion word that is not known here ends the reading: nothing is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.executed.controller import Block
from benchmarks.plan_check.robot import UNIT, Array, pose_of, rotation_vector

NUMBER = r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?"
#: Radius of ABB's named zones [mm] (RAPID reference manual, zonedata).
ZONES = {"fine": 0.0, "z0": 0.3, "z1": 1.0, "z5": 5.0, "z10": 10.0}
ENDINGS = {"rapid": "*.mod", "krl": "*.src", "urscript": "*.script"}
#: Words that set the arm's joints: they bring it to the cut and away, and are no part of it.
JOINT_WORDS = ("MoveAbsJ", "PTP", "movej")


def read_cut(folder: Path, make: str) -> tuple[Array, list[Block]]:
    """Return the pose that the longest run of lines and arcs begins at, and its blocks; base frame, SI."""
    runs: list[list[Block]] = [[]]
    reader = {"rapid": read_rapid, "krl": read_krl, "urscript": read_urscript}[make]
    parts = sorted(folder.glob(ENDINGS[make]), key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)] or [0])
    for block in reader("\n".join(file.read_text(encoding="utf-8") for file in parts)):
        if block is None:
            runs.append([])
        else:
            runs[-1].append(block)
    longest = max(runs, key=len)
    return longest[0].end, longest[1:]


def read_rapid(text: str) -> Iterator[Block | None]:
    """Read MoveL and MoveC; None where the joints move."""
    numbers = _read_numbers(re.search(r"wobjdata \w+:=\[FALSE,TRUE,\"\",(.*)\];", text)[1])
    part = _quaternion_pose(numbers[:7]) @ _quaternion_pose(numbers[7:14])
    for word, rest in re.findall(r"^ *(Move\w+) (.*);", text, re.M):
        if word in JOINT_WORDS:
            yield None
            continue
        groups = [_read_numbers(group) for group in re.findall(r"\[([^\[\]]*)\]", rest)]
        name = re.search(r"\],(\w+|\[[^\]]*\]),\w+\\WObj", rest)[1]
        zone = ZONES[name] if name in ZONES else (0.0 if name.startswith("[TRUE") else _read_numbers(name)[0])
        heads = (0, 4) if word == "MoveC" else (0,)
        places = [part @ _quaternion_pose([*groups[k], *groups[k + 1]]) for k in heads]
        assert word in ("MoveL", "MoveC") and len(groups) >= 5, f"not known here: {word}"
        speed = groups[8][0] if word == "MoveC" else groups[4][0]
        yield Block(places[-1], speed * 1e-3, zone * 1e-3, places[0] if word == "MoveC" else None)


def read_krl(text: str) -> Iterator[Block | None]:
    """Read LIN and CIRC; None where the joints move."""
    part, speed, zone = np.eye(4), 0.0, 0.0
    for line in (line.split(";")[0].strip() for line in text.splitlines()):
        word = line.split(" ")[0]
        if line.startswith("$BASE="):
            part = _angles_pose(_read_numbers(re.sub(r"[XYZABC] ", " ", line)))
        elif line.startswith("$VEL.CP="):
            speed = float(line.partition("=")[2])
        elif line.startswith("$APO.CDIS="):
            zone = float(line.partition("=")[2]) * 1e-3
        elif word in JOINT_WORDS:
            yield None
        elif "{" in line and not line.startswith("$"):
            assert word in ("LIN", "CIRC"), f"not known here: {line}"
            places = [
                part @ _angles_pose([float(value) for value in re.findall(rf"[XYZABC] ({NUMBER})", group)])
                for group in re.findall(r"\{(.*?)\}", line)
            ]
            via = places[0] if word == "CIRC" else None
            yield Block(places[-1], speed, zone if line.endswith("C_DIS") else 0.0, via)


def read_urscript(text: str) -> Iterator[Block | None]:
    """Read movel and movec; None where the joints move."""
    part = _vector_pose(_read_numbers(re.search(r"part *= *p\[(.*?)\]", text)[1]))
    for word, rest in re.findall(r"^ *(move\w)\((.*)\)", text, re.M):
        if word in JOINT_WORDS:
            yield None
            continue
        assert word in ("movel", "movec"), f"not known here: {word}"
        places = [part @ _vector_pose(_read_numbers(group)) for group in re.findall(r"p\[(.*?)\]", rest)]
        said = {key: float(value) for key, value in re.findall(rf"(\w+)=({NUMBER})", rest)}
        yield Block(places[-1], said["v"], said.get("r", 0.0), places[0] if word == "movec" else None)


def _read_numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(NUMBER, text)]


def _quaternion_pose(numbers: list[float]) -> Array:
    w, *v = numbers[3:]
    size = float(np.linalg.norm(v))
    turn = rotation_vector(np.array(v) / max(size, 1e-300) * 2.0 * np.arctan2(size, w))
    return pose_of(turn, np.array(numbers[:3]) * 1e-3)


def _angles_pose(numbers: list[float]) -> Array:
    """X Y Z [mm], A about z, B about the new y, C about the newest x [deg]."""
    a, b, c = (rotation_vector(np.radians(angle) * UNIT[axis]) for angle, axis in zip(numbers[3:], "zyx", strict=True))
    return pose_of(a @ b @ c, np.array(numbers[:3]) * 1e-3)


def _vector_pose(numbers: list[float]) -> Array:
    return pose_of(rotation_vector(np.array(numbers[3:])), np.array(numbers[:3]))
