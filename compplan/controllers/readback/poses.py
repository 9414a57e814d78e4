"""Shared parts of the readers of native robot programs: moves, non-motion instructions, poses from angles.

They are independent of the writers. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.robot.pose import build_pose

Pose = np.ndarray
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


class Move(NamedTuple):
    """A move: its end, its speed, and whether it stops there.

    `joints` are those of the arm and `external` the further axes, in the controller's convention; `pose` is the tool's
    in the active base. The speed is in mm/s along the path (`feed`) or a share of the axis rates (`percent`).
    `configuration` is as written in the language; `load` is the tool's mass [kg] and its centre, flange frame [mm];
    `rate` is that of the leading joint [deg/s]; with `flange_turn` a pose has the tip's position and the flange's
    orientation. `via` is the via pose of a move of kind "arc" (for SINUMERIK only its position).
    With `carried` the base moves with the external axes that carry the part.
    `action` is a non-motion instruction; its `kind` is "act".
    """

    kind: str
    stops: bool
    joints: tuple[float, ...] | None = None
    external: tuple[float, ...] = ()
    pose: Pose | None = None
    feed: float | None = None
    percent: float | None = None
    configuration: tuple[object, ...] = ()
    tool: Pose | None = None
    base: Pose | None = None
    load: tuple[float, ...] = ()
    rate: float | None = None
    flange_turn: bool = False
    action: str = ""
    via: Pose | None = None
    carried: bool = False


def _euler_pose(order: str, *numbers: float) -> Pose:
    """Return a frame from x y z and three Euler angles; capitals are intrinsic axes, small letters extrinsic ones."""
    return build_pose(numbers[:3], Rotation.from_euler(order, numbers[3:], degrees=True).as_matrix())


#: KUKA: A about z, B about the new y, C about the newest x. FANUC: W about x, P about the fixed y, R about the fixed z.
kuka_pose, fanuc_pose = partial(_euler_pose, "ZYX"), partial(_euler_pose, "xyz")
#: Kawasaki: O about z, A about the new y, T about the newest z.
kawasaki_pose = partial(_euler_pose, "ZYZ")
#: Staubli: rx about x, ry about the new y, rz about the newest z.
staubli_pose = partial(_euler_pose, "XYZ")


def turn(axis: str, angle: float) -> Pose:
    """Return the rotation about x, y or z."""
    return build_pose(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True).as_matrix())


def shift(x: float, y: float, z: float) -> Pose:
    """Return a translation."""
    return build_pose((x, y, z), np.eye(3))


def vector_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Pose:
    """Return a pose of Universal Robots in mm: position in m and a rotation vector in rad."""
    return build_pose((x * 1e3, y * 1e3, z * 1e3), Rotation.from_rotvec((a, b, c)).as_matrix())


def abb_pose(place: Sequence[float], quaternion: Sequence[float]) -> Pose:
    """Return a pose of ABB: quaternion with its real part first."""
    w, x, y, z = quaternion
    assert math.isclose(w * w + x * x + y * y + z * z, 1.0, abs_tol=1e-6), "no unit quaternion"
    return build_pose(place, Rotation.from_quat((x, y, z, w)).as_matrix())


def read_numbers(text: str) -> list[float]:
    """Return the numbers of a text."""
    return [float(number) for number in re.findall(NUMBER, text)]


#: Non-motion instructions of each language, with empty texts.
ACTIONS: dict[str, str] = {
    "krl": rf'MsgNotify\(""\)|HALT|\$OUT\[\d+\]=(TRUE|FALSE)|WAIT SEC {NUMBER}'
           r"|WAIT FOR \$IN\[\d+\]|\w+\(\d+\)",
    "rapid": rf'TPWrite "";|Stop;|SetDO \w+,[01];|WaitTime {NUMBER};|WaitDI \w+,1;|\w+ \d+;',
    "urscript": r'while \(not get_standard_digital_in\(\d+\)\):|popup\("", title="", blocking=True\)|sync\(\)'
                rf"|end|set_standard_digital_out\(\d+, (True|False)\)|sleep\({NUMBER}\)|\w+\(\d+\)",
    "inform": rf"PAUSE|DOUT OT#\(\d+\) (ON|OFF)|TIMER T={NUMBER}|WAIT IN#\(\d+\)=ON",
    "kawasaki_as": rf'TYPE ""|PAUSE|SIGNAL -?\d+|TWAIT {NUMBER}|SWAIT \d+|CALL \w+\(\d+\)',
    "fanuc_ls": r"PAUSE|DO\[\d+\]=(ON|OFF)"
                rf"|WAIT +{NUMBER}\(sec\)|WAIT DI\[\d+\]=ON|CALL \w+\(\d+\)",
    "val3": r'userPage\(\)|putln\(""\)|l_nKey=get\(\)|\w+=(true|false)'
            rf"|delay\({NUMBER}\)|wait\(\w+==true\)|call \w+\(\d+\)",
    "sinumerik": rf"M[0135789]|M[34] S\d+|M4|G4 F{NUMBER}|\$A_OUT\[\d+\]=[01]|\w+\(\d+\)",
}  # fmt: skip


def list_lines(text: str, comment: str = ";") -> list[str]:
    """Return the effective lines of a program, without comments and indentation, with empty texts."""
    lines = (re.sub(r'"[^"]*"', '""', line).split(comment)[0].strip() for line in text.splitlines())
    return [line for line in lines if line]


def read_action(line: str, language: str) -> Move | None:
    """Return a non-motion instruction as a `Move` of kind "act"; None for other lines."""
    return Move("act", True, action=line) if re.fullmatch(ACTIONS[language], line) else None
