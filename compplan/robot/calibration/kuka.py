"""$MACHINE.DAT of KUKA controllers: the frames and lengths by which the controller computes where the flange is.

The model is that of the maker's handbook (KR C2, Machine Data, 2.1.7 and 2.1.156 to 2.1.161): at the mathematical
zero the arm is stretched along x. Axis 1 turns about z of $TIRORO; axis 2 about y, $LENGTH_A along x; axis 3 about y,
$LENGTH_B along x (frame P3); axis 4 about z of $TX3P3 in P3; then Denavit-Hartenberg numbers $DH_4 and $DH_5; $TFLWP
is the flange. Frames are X Y Z [mm] and A B C [deg] about z, the new y, the newest x.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.robot.calibration.fit import fit_numbers
from compplan.robot.calibration.geometry import (
    ZeroPose,
    face_axes,
    find_zero_pose,
    frame_dh,
    move_axes,
    shift_zeros,
    tool_zero,
)  # fmt: skip
from compplan.robot.calibration.numbers import OwnFile, keep_once, read_numbers, require_names
from compplan.robot.pose import build_pose

name = "kuka"
words = "$MACHINE.DAT of KUKA ($TIRORO, $LENGTH_A, $LENGTH_B, $TX3P3, $DH_4, $DH_5, $TFLWP)"
lacks = "axis 2 not square to axis 1, axis 3 not parallel to axis 2"
advice = "compare it with the controller's own file line by line, load it, master the axes whose $MAMES changed"
_FRAME = ("X", "Y", "Z", "A", "B", "C")
_DH = ("DHART_A", "DHART_D", "DHART_ALPHA")
#: The keys of the model and their parts, in the order of the numbers.
KEYS: dict[str, tuple[str, ...]] = {
    "TIRORO": _FRAME, "LENGTH_A": ("",), "LENGTH_B": ("",), "TX3P3": _FRAME, "DH_4": _DH, "DH_5": _DH, "TFLWP": _FRAME,
}  # fmt: skip
#: Axes whose zero no frame of the model holds: $MAMES says it.
MASTERED = (1, 2, 4)
_LINE = re.compile(r"\s*(?:FRAME\s+|REAL\s+)?\$(\w+?)(\[\d\])?\s*=\s*(.*?)\s*(?:;.*)?$")
#: Numbers that are angles; the others are lengths.
_ANGLE = np.array([part in ("A", "B", "C", "DHART_ALPHA") for parts in KEYS.values() for part in parts])
#: From the file's units to [rad] and [m].
_UNIT = np.where(_ANGLE, np.pi / 180, 1e-3)


def recognise(text: str) -> bool:
    """Tell whether a text is a $MACHINE.DAT."""
    return re.search(r"^\s*(FRAME\s+)?\$(TIRORO|TX3P3|LENGTH_A)\b", text, re.MULTILINE) is not None


def read(text: str, file: Path, nominal: Robot) -> Robot:
    """Return the robot of a $MACHINE.DAT.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The robot of this type as it ships, joints at the controller's zero.

    Raises:
        InputError: If a key is missing or no number, the main axes or the robot are of another kind.
    """
    numbers, _ = _read_numbers(text, file)
    return move_axes(nominal, tool_zero(face_axes(walk(numbers), nominal), nominal), file)


def write(robot: Robot, nominal: Robot, own: OwnFile | None = None) -> tuple[str, Robot]:
    """Return the controller's own $MACHINE.DAT with the numbers of a measured robot, and the robot it then believes.

    Args:
        robot: The robot as measured.
        nominal: The robot of this type as it ships; joints of both at the controller's zero.
        own: The controller's file as it is now.

    Raises:
        InputError: If the controller's file is not given, is faulty, or is of another robot.
    """
    if own is None:
        raise InputError("--controller kuka needs --own FILE, the $MACHINE.DAT that the controller has now")
    read(own.text, own.file, nominal)
    start, mastering = _read_numbers(own.text, own.file)
    require_names(mastering, [f"MAMES[{axis + 1}]" for axis in MASTERED], own.file)
    count = len(start)

    def place(numbers: Array) -> ZeroPose:
        zeros = np.zeros(6)
        zeros[list(MASTERED)] = numbers[count:]
        return shift_zeros(tool_zero(face_axes(walk(numbers[:count]), nominal), nominal), zeros)

    # $DH_4.DHART_D is always 0 on the controller
    free = np.arange(count + len(MASTERED)) != _index("DH_4", "DHART_D")
    full = np.concatenate([start, np.zeros(len(MASTERED))])

    def spread(part: Array) -> Array:
        values = full.copy()
        values[free] = part
        return values

    found = spread(fit_numbers(lambda part: place(spread(part)), full[free], find_zero_pose(robot)))
    told = dict(zip(_places(), found[:count] / _UNIT, strict=True))
    for axis, turn in zip(MASTERED, found[count:], strict=True):
        key = f"MAMES[{axis + 1}]"
        told[key, ""] = mastering[key][0] + float(np.degrees(own.sense[axis] * turn))
    return _replace_lines(own.text, told), move_axes(robot, place(found), robot.name)


def walk(numbers: Array) -> ZeroPose:
    """Return axes and flange of the model's numbers, in the order of KEYS. Shape (26,). [m, rad]"""
    parts = np.split(numbers, np.cumsum([len(part) for part in KEYS.values()])[:-1])
    root, a, b, wrist, dh4, dh5, flange = parts
    first = _frame(root)
    second = first @ _frame(np.array([a[0], 0, 0, 0, 0, 0]))
    third = second @ _frame(np.array([b[0], 0, 0, 0, 0, 0]))
    fourth = third @ _frame(wrist)
    fifth = fourth @ frame_dh(0.0, dh4[0], dh4[1], dh4[2])
    sixth = fifth @ frame_dh(0.0, dh5[0], dh5[1], dh5[2])
    frames, columns = np.array([first, second, third, fourth, fifth, sixth]), [2, 1, 1, 2, 2, 2]
    direction = np.array([frame[:3, column] for frame, column in zip(frames, columns, strict=True)])
    return ZeroPose(direction, frames[:, :3, 3], sixth @ _frame(flange))


def _frame(numbers: Array) -> Array:
    return build_pose(numbers[:3], Rotation.from_euler("ZYX", numbers[3:]).as_matrix())


def _places() -> list[tuple[str, str]]:
    return [(key, part) for key, parts in KEYS.items() for part in parts]


def _index(key: str, part: str) -> int:
    return _places().index((key, part))


def _read_numbers(text: str, file: Path) -> tuple[Array, dict[str, list[float]]]:
    """Read the numbers of the model, [m, rad], and $MAMES by its key, [deg]."""
    found: dict[str, list[float]] = {}
    for line, content in enumerate(text.splitlines(), 1):
        said = _LINE.match(content)
        if said is None:
            continue
        key, value = said[1] + (said[2] or ""), said[3]
        if key == "MAIN_AXIS" and value.upper() != "#NR":
            message = f"$MAIN_AXIS is {value}, expected #NR: an articulated arm, its link arm not carried by a rod"
            raise InputError(message, file=file, where=line)
        if key in KEYS:
            keep_once(found, f"${key}", _read_parts(value, key, file, line), file, line)
        elif said[1] == "MAMES":
            found[key] = read_numbers(value, 1, f"${key}", file, line)
    require_names(found, [f"${key}" for key in KEYS], file)
    numbers = np.concatenate([found[f"${key}"] for key in KEYS]) * _UNIT
    return numbers, {key: value for key, value in found.items() if not key.startswith("$")}


def _read_parts(value: str, key: str, file: Path, line: int) -> list[float]:
    if KEYS[key] == ("",):
        return read_numbers(value, 1, f"${key}", file, line)
    pairs = dict(pair.split() for pair in value.strip("{} ").split(",") if len(pair.split()) == 2)
    if set(pairs) != set(KEYS[key]):
        expected = "{" + ", ".join(f"{part} 0.0" for part in KEYS[key]) + "}"
        raise InputError(f"${key} is {value!r}, expected {expected}", file=file, where=line)
    return [read_numbers(pairs[part], 1, f"${key}.{part}", file, line)[0] for part in KEYS[key]]


def _replace_lines(text: str, told: dict[tuple[str, str], float]) -> str:
    """Return the text with new numbers in the lines of the model and of $MAMES, all else as it is."""
    lines = text.splitlines(keepends=True)
    for index, content in enumerate(lines):
        said = _LINE.match(content.rstrip("\r\n"))
        key = said[1] + (said[2] or "") if said else ""
        if said is None or (key not in KEYS and (key, "") not in told):
            continue
        parts = KEYS.get(key, ("",))
        values = [f"{part} {told[key, part]:.9g}".strip() for part in parts]
        new = values[0] if parts == ("",) else "{" + ",".join(values) + "}"
        lines[index] = content[: said.start(3)] + new + content[said.end(3) :]
    return "".join(lines)
