"""What readers of native robot programs have in common: moves, actions beside motion, poses from angles.

They share nothing with the writers. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

Pose = np.ndarray
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
TEXT = '"[^"]*"'


class Move(NamedTuple):
    """Hold a move: where it ends, how fast it runs, whether it stops there.

    `joints` are those of the arm and `external` the further axes, as the controller counts them; `pose` is the tool's,
    seen from the base in force. A speed is mm/s along the path (`feed`) or a share of the axis rates (`percent`).
    `configuration` is as the language writes it; `load` is the tool's mass [kg] and its centre, flange frame [mm];
    `rate` that of the leading joint [deg/s]; with `flange_turn` a pose has the tool's tip and the flange's turn.
    `via` is a pose that a move of kind "arc" goes through (of SINUMERIK its place alone).
    With `carried` the base moves with the external axes that carry the part.
    `action` is what a program does beside motion; its `kind` is "act".
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
    action: tuple[object, ...] = ()
    via: Pose | None = None
    carried: bool = False


def build_poses(place: Any, rotation: Rotation) -> Pose:
    """Return frames from places and rotations. Shape (4, 4), or (n, 4, 4) for n of each."""
    matrix = rotation.as_matrix()
    pose = np.zeros((*matrix.shape[:-2], 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = matrix, place, 1.0
    return pose


def _euler_pose(order: str, *numbers: float) -> Pose:
    """Return a frame from x y z and three angles; capitals turn about turning axes, small letters about fixed ones."""
    return build_poses(numbers[:3], Rotation.from_euler(order, numbers[3:], degrees=True))


#: KUKA: A about z, B about the new y, C about the newest x. FANUC: W about x, P about the fixed y, R about the fixed z.
kuka_pose, fanuc_pose = partial(_euler_pose, "ZYX"), partial(_euler_pose, "xyz")
#: Kawasaki: O about z, A about the new y, T about the newest z.
kawasaki_pose = partial(_euler_pose, "ZYZ")
#: Staubli: rx about x, ry about the new y, rz about the newest z.
staubli_pose = partial(_euler_pose, "XYZ")


def turn(axis: str, angle: float) -> Pose:
    """Return the rotation about x, y or z."""
    return build_poses(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True))


def shift(x: float, y: float, z: float) -> Pose:
    """Return a translation."""
    return build_poses((x, y, z), Rotation.identity())


def vector_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Pose:
    """Universal Robots: m and a rotation vector in rad; in mm here."""
    return build_poses((x * 1e3, y * 1e3, z * 1e3), Rotation.from_rotvec((a, b, c)))


def abb_pose(place: Sequence[float], quaternion: Sequence[float]) -> Pose:
    """ABB: the quaternion's real part stands first."""
    w, x, y, z = quaternion
    assert math.isclose(w * w + x * x + y * y + z * z, 1.0, abs_tol=1e-6), "no unit quaternion"
    return build_poses(place, Rotation.from_quat((x, y, z, w)))


def read_numbers(text: str) -> list[float]:
    """Return the numbers of a text."""
    return [float(number) for number in re.findall(NUMBER, text)]


#: Actions of each language, longest first: name (and numbers that are not written), and the pattern of whole lines.
ACTIONS: dict[str, dict[str, str]] = {
    "krl": {
        "pause_if": rf"IF \$IN\[(\d+)\] THEN\n *MsgNotify\({TEXT}\)\n *HALT\nENDIF",
        "pause": rf"MsgNotify\({TEXT}\)\n *HALT", "on": r"\$OUT\[(\d+)\]=TRUE", "off": r"\$OUT\[(\d+)\]=FALSE",
        "wait": rf"WAIT SEC ({NUMBER})", "expect": r"WAIT FOR \$IN\[(\d+)\]", "call": r"CHANGER\((\d+)\)",
    },
    "rapid": {
        "pause_if": rf"IF di(\d+)=1 THEN\n *TPWrite {TEXT};\n *Stop;\n *ENDIF", "pause": rf"TPWrite {TEXT};\n *Stop;",
        "on": r"SetDO do(\d+),1;", "off": r"SetDO do(\d+),0;", "wait": rf"WaitTime ({NUMBER});",
        "expect": r"WaitDI di(\d+),1;", "call": r"CHANGER (\d+);",
    },
    "urscript": {
        "pause_if": rf"if \(get_standard_digital_in\((\d+)\)\):\n *popup\({TEXT}, title=\"compplan\", blocking=True\)"
                    r"\n *end",
        "pause": rf"popup\({TEXT}, title=\"compplan\", blocking=True\)",
        "on": r"set_standard_digital_out\((\d+), True\)", "off": r"set_standard_digital_out\((\d+), False\)",
        "wait": rf"sleep\(({NUMBER})\)", "call": r"CHANGER\((\d+)\)",
        "expect": r"while \(not get_standard_digital_in\((\d+)\)\):\n *sync\(\)\n *end",
    },
    "inform": {
        "pause_if": r"PAUSE IF IN#\((\d+)\)=ON", "pause": "PAUSE", "on": r"DOUT OT#\((\d+)\) ON",
        "off": r"DOUT OT#\((\d+)\) OFF", "wait": rf"TIMER T=({NUMBER})", "expect": r"WAIT IN#\((\d+)\)=ON",
        "call 7": "CALL JOB:CHANGER",
    },
    "kawasaki_as": {
        "pause_if": rf"IF SIG\(100(\d)\) THEN\n *TYPE {TEXT}\n *PAUSE\n *END", "pause": rf"TYPE {TEXT}\n *PAUSE",
        "on": r"SIGNAL (\d+)", "off": r"SIGNAL -(\d+)", "wait": rf"TWAIT ({NUMBER})", "expect": r"SWAIT 100(\d)",
        "call": r"CALL changer\((\d+)\)",
    },
    "fanuc_ls": {
        "pause_if": r"IF DI\[(\d+)\]=OFF,JMP LBL\[(?P<label>\d+)\] ;\n *\d+: *PAUSE ;\n *\d+: *LBL\[(?P=label)\]",
        "pause": "PAUSE", "on": r"DO\[(\d+)\]=ON", "off": r"DO\[(\d+)\]=OFF", "wait": rf"WAIT +({NUMBER})\(sec\)",
        "expect": r"WAIT DI\[(\d+)\]=ON", "call": r"CALL CHANGER\((\d+)\)",
    },
    "val3": {
        "pause_if": rf"if diIn(\d+)==true\n *userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)\n *endIf",
        "pause": rf"userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)", "on": r"doOut(\d+)=true",
        "off": r"doOut(\d+)=false", "wait": rf"delay\(({NUMBER})\)", "expect": r"wait\(diIn(\d+)==true\)",
        "call": r"call CHANGER\((\d+)\)",
    },
    "sinumerik": {
        "pause": "M0", "pause_if 0": "M1", "wait": rf"G4 F({NUMBER})", "cw": r"M3(?: S(\d+))?",
        "ccw": r"M4(?: S(\d+))?",
        "stop": "M5", "flood": "M8", "mist": "M7", "dry": "M9", "on": r"\$A_OUT\[(\d+)\]=1",
        "off": r"\$A_OUT\[(\d+)\]=0", "call": r"CHANGER\((\d+)\)",
    },
}  # fmt: skip


def mark_actions(text: str, language: str) -> str:
    """Return a program's text with its actions as lines "@action number"."""
    head, tail = (r"^( *\d+: *)", r"( *;)") if language == "fanuc_ls" else (r"^( *)", "()")
    for action, pattern in ACTIONS[language].items():
        text = re.sub(f"{head}{pattern}{tail}$", partial(_mark_action, action), text, flags=re.M)
    return text


def _mark_action(action: str, match: re.Match[str]) -> str:
    indent, *numbers, end = match.groups(default="")
    return f"{indent}@{' '.join([action, *numbers[:1]])}{end}"


def list_lines(text: str, language: str, comment: str = ";") -> list[str]:
    """Return the lines of a program that do something, comments and indentation aside, actions marked."""
    lines = (line.split(comment)[0].strip() for line in mark_actions(text, language).splitlines())
    return [line for line in lines if line]


def read_action(line: str) -> Move | None:
    """Return a line "@action numbers" as a move that is none; other lines are not."""
    words = line[1:].split()
    return Move("act", True, action=(words[0], *map(float, words[1:]))) if line.startswith("@") else None
