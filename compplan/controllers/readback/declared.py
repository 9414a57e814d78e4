"""What the comments of a program say that frames and tools of the cell have to be; people enter these numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from compplan.controllers.readback.poses import Pose, fanuc_pose

#: A line that names what stands on the next lines, and a number with its decimals there.
NAMED = re.compile(r"\b(UFRAME|UTOOL|USER FRAME|TOOL)\W*\d+\W+has to be")
DECIMAL = re.compile(r"(?<![\w.])-?\d+\.\d+")
#: Rounding of what people enter. [mm, 1]
PLACE, TURN = 5e-3, 1e-4


def compare_declared(path: Path, part: Pose, tool: Pose) -> list[str]:
    """Say which frame that a FANUC or INFORM program asks of the cell is not the planned one.

    The part frame is seen from the robot's world, the tool from the pendant's flange. Shape (4, 4). [mm]
    """
    found = []
    for name, said in read_declared(path).items():
        off = said - (tool if name == "tool" else part)
        if np.linalg.norm(off[:3, 3]) > PLACE or np.abs(off[:3, :3]).max() > TURN:
            found.append(f"the {name} that it expects of the cell is not the planned one")
    return found


def read_declared(path: Path) -> dict[str, Pose]:
    """Read "part frame" and "tool" that a program states for the cell, X Y Z W P R. [mm]."""
    found = {}
    lines = [re.sub(r"^ *\d+: *", "", line) for line in path.read_text().splitlines()]
    for k, line in enumerate(lines):
        if match := NAMED.search(line):
            numbers = [float(number) for later in lines[k + 1 : k + 4] for number in DECIMAL.findall(later)]
            found["part frame" if "FRAME" in match[1] else "tool"] = fanuc_pose(*numbers[:6])
    return found
