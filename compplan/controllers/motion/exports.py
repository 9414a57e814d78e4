"""Logs as loggers of controllers name their columns, traces of KUKA's oscilloscope, recordings (MCAP) of joint states.

| log | time | executed joints | commanded joints | torque |
|---|---|---|---|---|
| RTDE client (Universal Robots) | timestamp, s | actual_q_0 .., rad | target_q_0 .., rad | target_moment_0 .., Nm |
| EGM message (ABB) | header.tm, ms | feedBack.joints.joints_0 .., deg | planned.joints.joints_0 .. | |
| motion_program_logger (ABB) | timestamp, s | J1 .., deg | | |
| RSI telegram (KUKA) | IPOC, ms | AIPos.A1 .., deg | ASPos.A1 .., deg | GearTorque.A1 .., Nm |
| trace (KUKA), NAME_KRCIpo.dat and .r64 | Zeit, by its step | AxisPos_Act1 .. | AxisPos_CmdIpo1 .. | |

Names of nested fields may be joined by `.`, `_` or `/`, numbers of elements stand in brackets or behind one of those.
Such joints are counted as the controller counts them; those of ROS as the URDF does.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.robot import Robot

#: Fields that hold a time, and those that hold a number a joint: our name, and what their numbers count from.
TIMES = {"timestamp": "time_s", "header_tm": "time_ms", "ipoc": "time_ms"}
JOINTS = (
    (re.compile(r"(actual_q|target_q|target_moment)_(\d+)"), 0,
     {"actual_q": "q#_rad", "target_q": "q#_cmd_rad", "target_moment": "tau#_Nm"}),
    (re.compile(r"(feedback|planned)_joints_joints_(\d+)"), 0, {"feedback": "q#_deg", "planned": "q#_cmd_deg"}),
    (re.compile(r"(aipos|aspos|geartorque)_a(\d+)"), 1,
     {"aipos": "q#_deg", "aspos": "q#_cmd_deg", "geartorque": "tau#_Nm"}),
    (re.compile(r"(axispos_act|axispos_cmdipo)_?(\d+)"), 1, {"axispos_act": "q#_deg", "axispos_cmdipo": "q#_cmd_deg"}),
    (re.compile(r"(j)(\d+)"), 1, {"j": "q#_deg"}),
)  # fmt: skip
#: Endings of the files of a trace of KUKA: head (DIAdem), numbers, settings.
TRACE_ENDINGS = (".dat", ".r64", ".trc")
#: Keys of a channel in a DIAdem head: name, unit, kind, file, values, place in a row from 1, offset, step or factor.
NAME, UNIT, KIND, FILE, COUNT, PLACE, OFFSET, FACTOR = 200, 202, 210, 211, 220, 221, 240, 241
#: What makes degrees or mm of a unit.
ANGLES = {"rad": 180.0 / np.pi, "mrad": 0.18 / np.pi, "mm": 1.0, "m": 1e3}
#: Names of messages of joint states.
JOINT_STATE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")


def rename_export(title: str) -> str:
    """Return our name of a column of a logger that is known, any other name as it is."""
    plain = re.sub(r"[\[\]./ _]+", "_", title).strip("_").lower()
    if plain in TIMES:
        return TIMES[plain]
    for pattern, first, names in JOINTS:
        found = pattern.fullmatch(plain)
        if found:
            return names[found[1]].replace("#", str(int(found[2]) + 1 - first))
    return title


def read_kuka_trace(file: Path, robot: Robot) -> tuple[Array, Array, list[str]]:
    """Read a trace of KUKA's oscilloscope: a head (DIAdem, .dat) of channels, their numbers beside it (.r64).

    Each number is a double, rows one after another; value = number x factor + offset. Time is a channel of even steps.

    Args:
        file: One of the files of the interpolator's trace (NAME_KRCIpo); the others lie beside it.
        robot: The robot that was recorded.

    Returns:
        Time, shape (n,) [s], joints as the controller counts them, shape (n, nq) [deg or mm], and what is assumed.

    Raises:
        InputError: If it is no such trace, or lacks a joint of this robot.

    """
    head = next((path for end in (".dat", ".DAT") if (path := file.with_suffix(end)).is_file()), file)
    try:
        text = head.read_text(encoding="latin-1")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=head) from None
    blocks = re.findall(r"#BEGINCHANNELHEADER(.*?)#ENDCHANNELHEADER", text, re.S)
    channels = [{int(k): v.strip() for k, v in re.findall(r"^\s*(\d+),(.*)$", block, re.M)} for block in blocks]
    try:
        clock = next(entry for entry in channels if entry.get(KIND, "").upper().startswith("IMPLI"))
        named = {entry[NAME].lower(): entry for entry in channels if FILE in entry}
        wanted = [named[f"axispos_act{k}"] for k in range(1, robot.nq + 1)]
        numbers = np.fromfile(head.with_name(wanted[0][FILE]), "<f8").reshape(int(wanted[0][COUNT]), -1)
        time = float(clock[OFFSET]) + float(clock[FACTOR]) * np.arange(len(numbers))
        joints = np.stack([numbers[:, int(entry[PLACE]) - 1] * float(entry[FACTOR]) + float(entry[OFFSET])
                           for entry in wanted], axis=1)  # fmt: skip
    except (StopIteration, KeyError, IndexError, ValueError, OSError) as error:
        message = f"is no trace of KUKA's interpolator with AxisPos_Act1 .. AxisPos_Act{robot.nq} ({error})"
        raise InputError(f"{message}, expected NAME_KRCIpo.dat with its .r64 beside it", file=head) from None
    units = {entry.get(UNIT, "").strip("[]() ").lower() for entry in wanted}
    known = units & {*ANGLES, "deg", "grad", "\xb0"}
    notes = [] if units == known else ["the unit of AxisPos_Act is not stated: degrees (mm for slides), assumed"]
    joints = joints * [ANGLES.get(entry.get(UNIT, "").strip("[]() ").lower(), 1.0) for entry in wanted]
    seconds = 1e-3 if clock.get(UNIT, "").strip("[]() ").lower() == "ms" else 1.0
    return np.asarray(time * seconds, np.float64), joints, notes


def read_recording(file: Path, robot: Robot) -> tuple[Array, Array]:
    """Read the joint states of an MCAP file: time of their stamps, and positions.

    Messages are sensor_msgs/JointState, as ROS 2 (cdr) or JSON; joints are found by the names of the robot's, or stand
    in their order.

    Args:
        file: The recording.
        robot: The robot that was recorded.

    Returns:
        Shapes (n,) [s] and (n, nq) [rad or m].

    Raises:
        InputError: If the package mcap is missing, or the file holds no joint states of this robot.

    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ImportError:
        raise InputError("MCAP needs the package mcap: pip install compplan[mcap]", file=file) from None
    names, rows, stamps = list(robot.joint_names), [], []
    try:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                if schema is not None and schema.name in JOINT_STATE:
                    stamp, joints, places = _read_state(channel.message_encoding, message.data)
                    if set(names) <= set(joints):
                        places = [places[joints.index(name)] for name in names]
                    stamps.append(stamp)
                    rows.append(places)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file) from None
    except (McapError, ValueError, KeyError, TypeError, struct.error, IndexError) as error:
        raise InputError(f"is no MCAP file of joint states: {error}", file=file) from None
    if not rows:
        raise InputError(f"holds no messages {JOINT_STATE[0]}, expected joint states", file=file)
    if any(len(row) != robot.nq for row in rows):
        raise InputError(f"holds joint states of other joints, expected {names}", file=file)
    return np.array(stamps, np.float64), np.array(rows, np.float64)


def _read_state(encoding: str, data: bytes) -> tuple[float, list[str], list[float]]:
    """Return stamp [s], names and positions of a joint state."""
    if encoding == "json":
        state: dict[str, Any] = json.loads(data)
        stamp = state["header"]["stamp"]
        nanoseconds = stamp.get("nanosec", stamp.get("nsec", 0))
        return stamp["sec"] + 1e-9 * nanoseconds, list(state["name"]), [float(place) for place in state["position"]]
    if encoding != "cdr":
        raise ValueError(f"messages are encoded as {encoding!r}, expected cdr or json")
    fields = _read_cdr(data)
    stamp_s = next(fields) + 1e-9 * next(fields)
    next(fields)  # frame
    return stamp_s, next(fields), next(fields)


def _read_cdr(data: bytes) -> Iterator[Any]:
    """Yield stamp, frame, names and positions of a joint state in CDR; numbers stand at multiples of their size."""
    order = "<" if data[1] & 1 else ">"
    body, at = data[4:], 0

    def take(kind: str, count: int = 1) -> tuple[Any, ...]:
        nonlocal at
        size = struct.calcsize(f"={kind}")
        at += -at % size
        values = struct.unpack_from(f"{order}{count}{kind}", body, at)
        at += count * size
        return values

    def text() -> str:
        nonlocal at
        length = take("I")[0]
        at += length
        return body[at - length : at - 1].decode()

    yield take("i")[0]
    yield take("I")[0]
    yield text()
    yield [text() for _ in range(take("I")[0])]
    count = take("I")[0]
    yield list(take("d", count)) if count else []
