"""What readers of native robot programs have in common: moves, actions beside motion, poses from angles.

They share nothing with the writers. Lengths in mm, angles in deg.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np

Pose = np.ndarray
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


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


def turn(axis: str, angle: float) -> Pose:
    """Rotation about x, y or z. Shape (4, 4)."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[first, first] = matrix[second, second] = c
    matrix[second, first], matrix[first, second] = s, -s
    return matrix


def shift(x: float, y: float, z: float) -> Pose:
    """Translation. Shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def kuka_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Pose:
    """KUKA: A about z, then B about the new y, then C about the newest x."""
    return fanuc_pose(x, y, z, c, b, a)


def staubli_poses(numbers: Pose) -> Pose:
    """Staubli: rx about x, then ry about the new y, then rz about the newest z. Shape (n, 6) -> (n, 4, 4)."""
    x, y, z = numbers[:, :3].T
    (sx, sy, sz), (cx, cy, cz) = (wave(np.radians(numbers[:, 3:])).T for wave in (np.sin, np.cos))
    poses = np.zeros((len(numbers), 4, 4))
    poses[:, 0] = np.column_stack([cy * cz, -cy * sz, sy, x])
    poses[:, 1] = np.column_stack([cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy, y])
    poses[:, 2] = np.column_stack([sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy, z])
    poses[:, 3, 3] = 1.0
    return poses


def fanuc_pose(x: float, y: float, z: float, w: float, p: float, r: float) -> Pose:
    """FANUC: W about x, then P about the fixed y, then R about the fixed z."""
    (sx, cx), (sy, cy), (sz, cz) = ((math.sin(math.radians(a)), math.cos(math.radians(a))) for a in (w, p, r))
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx, x],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx, y],
            [-sy, cy * sx, cy * cx, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def kawasaki_pose(x: float, y: float, z: float, o: float, a: float, t: float) -> Pose:
    """Kawasaki: O about z, then A about the new y, then T about the newest z."""
    return shift(x, y, z) @ turn("z", o) @ turn("y", a) @ turn("z", t)


def vector_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Pose:
    """Universal Robots: m and a rotation vector in rad (Rodrigues); in mm here."""
    angle, matrix = math.sqrt(a * a + b * b + c * c), shift(x * 1e3, y * 1e3, z * 1e3)
    if angle > 0:
        cross = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]) / angle
        matrix[:3, :3] = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


def abb_pose(place: list[float], quaternion: list[float]) -> Pose:
    """ABB: the quaternion's real part stands first."""
    w, x, y, z = quaternion
    assert math.isclose(w * w + x * x + y * y + z * z, 1.0, abs_tol=1e-6), "no unit quaternion"
    matrix = shift(*place)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return matrix


def read_numbers(text: str) -> list[float]:
    """Return the numbers of a text."""
    return [float(number) for number in re.findall(NUMBER, text)]


TEXT = r'"([^"]*)"'
#: Forms of each language, longest first: a pattern over whole lines (indentation aside), and the action it is.
FORMS: dict[str, list[tuple[str, str]]] = {
    "krl": [
        (rf"IF \$IN\[(\d+)\] THEN\n *MsgNotify\({TEXT}\)\n *HALT\nENDIF", r"@pause_if \1"),
        (rf"MsgNotify\({TEXT}\)\n *HALT", "@pause"),
        (r"\$OUT\[(\d+)\]=TRUE", r"@on \1"), (r"\$OUT\[(\d+)\]=FALSE", r"@off \1"),
        (rf"WAIT SEC ({NUMBER})", r"@wait \1"), (r"WAIT FOR \$IN\[(\d+)\]", r"@expect \1"),
        (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
    "rapid": [
        (rf"IF di(\d+)=1 THEN\n *TPWrite {TEXT};\n *Stop;\n *ENDIF", r"@pause_if \1"),
        (rf"TPWrite {TEXT};\n *Stop;", "@pause"), (r"SetDO do(\d+),1;", r"@on \1"), (r"SetDO do(\d+),0;", r"@off \1"),
        (rf"WaitTime ({NUMBER});", r"@wait \1"), (r"WaitDI di(\d+),1;", r"@expect \1"),
        (r"CHANGER (\d+);", r"@call \1"),
    ],
    "urscript": [
        (rf"if \(get_standard_digital_in\((\d+)\)\):\n *popup\({TEXT}, title=\"compplan\", blocking=True\)\n *end",
         r"@pause_if \1"),
        (rf"popup\({TEXT}, title=\"compplan\", blocking=True\)", "@pause"),
        (r"set_standard_digital_out\((\d+), True\)", r"@on \1"),
        (r"set_standard_digital_out\((\d+), False\)", r"@off \1"), (rf"sleep\(({NUMBER})\)", r"@wait \1"),
        (r"while \(not get_standard_digital_in\((\d+)\)\):\n *sync\(\)\n *end", r"@expect \1"),
        (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
    "inform": [
        (r"PAUSE IF IN#\((\d+)\)=ON", r"@pause_if \1"), (r"PAUSE", "@pause"), (r"DOUT OT#\((\d+)\) ON", r"@on \1"),
        (r"DOUT OT#\((\d+)\) OFF", r"@off \1"), (rf"TIMER T=({NUMBER})", r"@wait \1"),
        (r"WAIT IN#\((\d+)\)=ON", r"@expect \1"), (r"CALL JOB:CHANGER", "@call 7"),
    ],
    "kawasaki_as": [
        (rf"IF SIG\(100(\d)\) THEN\n *TYPE {TEXT}\n *PAUSE\n *END", r"@pause_if \1"),
        (rf"TYPE {TEXT}\n *PAUSE", "@pause"), (r"SIGNAL (\d+)", r"@on \1"), (r"SIGNAL -(\d+)", r"@off \1"),
        (rf"TWAIT ({NUMBER})", r"@wait \1"), (r"SWAIT 100(\d)", r"@expect \1"), (r"CALL changer\((\d+)\)", r"@call \1"),
    ],
    "fanuc_ls": [
        (r"IF DI\[(\d+)\]=OFF,JMP LBL\[(\d+)\] ;\n *\d+: *PAUSE ;\n *\d+: *LBL\[\2\]", r"@pause_if \1"),
        (r"PAUSE", "@pause"), (r"DO\[(\d+)\]=ON", r"@on \1"), (r"DO\[(\d+)\]=OFF", r"@off \1"),
        (rf"WAIT +({NUMBER})\(sec\)", r"@wait \1"), (r"WAIT DI\[(\d+)\]=ON", r"@expect \1"),
        (r"CALL CHANGER\((\d+)\)", r"@call \1"),
    ],
    "val3": [
        (rf"if diIn(\d+)==true\n *userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)\n *endIf", r"@pause_if \1"),
        (rf"userPage\(\)\n *putln\({TEXT}\)\n *l_nKey=get\(\)", "@pause"), (r"doOut(\d+)=true", r"@on \1"),
        (r"doOut(\d+)=false", r"@off \1"), (rf"delay\(({NUMBER})\)", r"@wait \1"),
        (r"wait\(diIn(\d+)==true\)", r"@expect \1"), (r"call CHANGER\((\d+)\)", r"@call \1"),
    ],
    "sinumerik": [
        (r"M0", "@pause"), (r"M1", "@pause_if 0"), (rf"G4 F({NUMBER})", r"@wait \1"), (r"M3(?: S(\d+))?", r"@cw \1"),
        (r"M4(?: S(\d+))?", r"@ccw \1"), (r"M5", "@stop"), (r"M8", "@flood"), (r"M7", "@mist"), (r"M9", "@dry"),
        (r"\$A_OUT\[(\d+)\]=1", r"@on \1"), (r"\$A_OUT\[(\d+)\]=0", r"@off \1"), (r"CHANGER\((\d+)\)", r"@call \1"),
    ],
}  # fmt: skip


def mark_actions(text: str, language: str) -> str:
    """Return a program's text with its actions as lines "@action arguments"."""
    head, tail = (r"^( *\d+: *)", r" *;") if language == "fanuc_ls" else (r"^( *)", "")
    for pattern, action in FORMS[language]:
        shifted = re.sub(r"\\(\d)", lambda match: f"\\{int(match[1]) + 1}", action)
        pattern = re.sub(r"(?<!\\)\\2(?!\d)", r"\\3", pattern)
        text = re.sub(f"{head}{pattern}{tail}$", rf"\1{shifted}{' ;' if tail else ''}", text, flags=re.M)
    return text


def read_action(line: str) -> Move | None:
    """Return a line "@action arguments" as a move that is none; other lines are not."""
    words = line[1:].split()
    return Move("act", True, action=(words[0], *map(float, words[1:]))) if line.startswith("@") else None
