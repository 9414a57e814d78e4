"""symotn.va of FANUC controllers: the Denavit-Hartenberg numbers by which the controller computes where the flange is.

The listing holds $DH_A, $DH_D [mm], $DH_ALPHA and $DH_THETA0 [rad] of group 1, in $MRR_GRP or $PARAM_GROUP, one
number a joint: T = prod_k Rz(theta_k) Tz(d_k) Tx(a_k) Rx(alpha_k) from the world frame, where axis 1 meets the height
of axis 2, to the faceplate; theta_k = $DH_THETA0[k] where the display shows zero. No public text of the maker says so.
A public note found it from the backup of an R-2000iC: it gives the recorded pose to 0.07 mm, as the joints are rounded.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from compplan.robot import Robot
from compplan.robot.calibration.geometry import ZeroPose, face_axes, find_zero_pose, move_axes, tool_zero, walk_dh
from compplan.robot.calibration.numbers import keep_once, read_numbers, require_names

name = "fanuc"
words = "symotn.va of FANUC ($DH_A, $DH_D, $DH_ALPHA, $DH_THETA0)"
#: No public text says that a changed listing may be loaded.
lacks = advice = ""
write = None
KEYS = ("DH_THETA0", "DH_A", "DH_D", "DH_ALPHA")
_FIELD = re.compile(r"\s*Field:\s*\$(MRR_GRP|PARAM_GROUP)\[1\]\.\$(DH_\w+).*ARRAY", re.IGNORECASE)
_ELEMENT = re.compile(r"\s*\[([1-6])\]\s*=\s*(\S+)\s*$")


def recognise(text: str) -> bool:
    """Tell whether a text lists the numbers."""
    return re.search(r"\$DH_(A|D|ALPHA|THETA0)\b", text, re.IGNORECASE) is not None


def read(text: str, file: Path, nominal: Robot) -> Robot:
    """Return the robot of a symotn.va.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The robot of this type as it ships, joints at the controller's zero.

    Raises:
        InputError: If a number is missing or none, or the robot is of another type.
    """
    found: dict[str, list[float]] = {}
    group = key = ""
    for number, line in enumerate(text.splitlines(), 1):
        field, element = _FIELD.match(line), _ELEMENT.match(line)
        if field:
            group, key = group or field[1], field[2] if field[1] == (group or field[1]) else ""
        elif element and key in KEYS:
            place = f"{key}[{element[1]}]"
            keep_once(found, place, read_numbers(element[2], 1, f"${place}", file, number), file, number)
        elif "Field:" in line:
            key = ""
    require_names(found, [f"{key}[{joint}]" for key in KEYS for joint in range(1, 7)], file)
    dh = np.array([[found[f"{key}[{joint}]"][0] for key in KEYS] for joint in range(1, 7)])
    zero = walk_dh(dh * [1.0, 1e-3, 1e-3, 1.0])
    faced = face_axes(zero, nominal)
    up = np.eye(4)
    up[2, 3] = find_zero_pose(nominal).point[1, 2]
    raised = ZeroPose(faced.direction, faced.point + up[:3, 3], up @ faced.flange)
    return move_axes(nominal, tool_zero(raised, nominal), file)
