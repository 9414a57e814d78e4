"""Log of executed joints, with imperfect clocks: late rows, missing rows, rows torn between two cycles.

Columns may have the names of controllers' loggers (docs/executed_path.md). Names of nested fields may be joined by
`.`, `_` or `/`; element numbers are in brackets or follow one of those. Such joints are in the controller's joint
convention.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.motion.instructions import read_joints
from compplan.controllers.writers.joint_convention import from_controller, load_controller
from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.robot import Robot

#: Fewest rows for an evaluation.
FEWEST_ROWS = 50
#: A reading is torn if it is behind its neighbours by a cycle's motion, within these shares of it,
TORN_LOW, TORN_HIGH = 0.5, 1.6
#: and by this number of standard deviations of all readings.
TORN_SIGMAS = 5.0
#: Time span of finite differences for rates. [s]
RATE_SPAN = 0.024

#: Fields of a time, and fields with a number for each joint: name here, and first number in the logger's count.
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

COLUMNS = (
    FileColumn("time", "time", required=True),
    FileColumn("q#", ("angle", "length"), required=True, missing=True),
    FileColumn("q#_cmd", ("angle", "length"), missing=True),
    FileColumn("tau#", ("moment", "force"), missing=True),
)


@dataclass(frozen=True)
class Log:
    """Contents of a log, rows in the order of time."""

    file: Path  #: File of the log.
    time: Array  #: Clock of the log. Shape (n,). [s]
    raw: Array  #: Joints as logged. Shape (n, nq). [rad or m]
    q: Array  #: Joints with torn readings corrected. Shape (n, nq). [rad or m]
    rate: Array  #: Rates of `q`. Shape (n, nq). [rad/s or m/s]
    torn: NDArray[np.bool_]  #: Which readings are torn. Shape (n, nq).
    cycle: float  #: Usual time between rows. [s]
    late: float  #: Share of rows whose clock is off by more than a fifth of a cycle.
    missing: float  #: Share of missing rows.
    notes: tuple[str, ...]  #: Notes on ignored or corrected contents.

    def __len__(self) -> int:
        return len(self.time)


def read_log(file: Path, robot: Robot) -> Log:
    """Read LOG.csv and correct torn readings.

    Raises:
        InputError: With file and line, if it is not a log of this robot.
    """
    table = read_table(file, COLUMNS, unknown="note", rename=rename_export)
    raw, time, notes = read_joints(table, robot, "q#"), table.values["time"], list(table.notes)
    if rename_export(table.headers["q1"]) != table.headers["q1"]:
        raw = from_controller(load_controller(robot), np.where(robot.prismatic, 1e3 * raw, np.degrees(raw)))
    whole = np.isfinite(raw).all(axis=1) & np.isfinite(time)
    if not whole.all():
        notes.append(f"{int((~whole).sum())} rows without a joint are left out")
    raw, time = raw[whole], time[whole]
    if (np.diff(time) < 0.0).any():
        order = np.argsort(time, kind="stable")
        notes.append(f"{int((np.diff(time) < 0).sum())} rows are out of order; they are sorted by time")
        raw, time = raw[order], time[order]
    fresh = np.r_[True, np.diff(time) > 0.0][: len(time)]
    if not fresh.all():
        notes.append(f"{int((~fresh).sum())} rows repeat a time and are left out")
    raw, time = raw[fresh], time[fresh]
    if len(time) < FEWEST_ROWS:
        raise InputError(f"has {len(time)} complete rows at different times, {FEWEST_ROWS} are needed", file=file)
    return clean_log(file, time, raw, notes)


def clean_log(file: Path, time: Array, raw: Array, notes: list[str]) -> Log:
    """Find and correct torn readings.

    A reading is compared with the cubic through its four neighbours. A time shift shared by all joints is a late clock;
    a single joint that is behind by a cycle's motion is a torn reading.

    Raises:
        InputError: If no joint moves.
    """
    cycle = float(np.median(np.diff(time)))
    if np.ptp(raw, axis=0).max() < 1e-4:
        raise InputError("no joint moves in this log, expected the log of a program that runs", file=file)
    rate = find_rates(time, raw, max(1, round(0.5 * RATE_SPAN / cycle)))
    gap = raw - _bridge_rows(time, raw)
    moving = np.abs(rate) > 1e-3 * np.abs(rate).max()
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(moving, gap / rate, np.nan)
    shared = _median_rows(shift)
    rest = gap - rate * np.nan_to_num(shared)[:, None]
    sigma = 1.4826 * np.median(np.abs(rest), axis=0) + 1e-9
    behind = -rest / np.where(moving, rate * cycle, np.inf)
    torn = (behind > TORN_LOW) & (behind < TORN_HIGH) & (np.abs(rest) > TORN_SIGMAS * sigma)
    torn[:2] = torn[-2:] = False
    q = np.where(torn, raw - rest, raw)
    span = np.diff(time) / cycle
    late = float(np.mean(np.abs(span - np.round(span)) > 0.2))
    missing = float(np.maximum(np.round(span) - 1.0, 0.0).sum() / max(1.0, np.round(span).sum()))
    rate = find_rates(time, q, max(1, round(0.5 * RATE_SPAN / cycle)))
    return Log(file, time, raw, q, rate, torn, cycle, late, missing, tuple(notes))


def find_rates(time: Array, q: Array, half: int) -> Array:
    """Return rates over `half` rows to either side. Shape (n, nq)."""
    n = len(time)
    low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half, n - 1)
    return np.asarray((q[high] - q[low]) / (time[high] - time[low])[:, None])


def _bridge_rows(time: Array, q: Array) -> Array:
    """Return every row from the cubic through two rows before and two after; the first and last two rows unchanged."""
    out = q.copy()
    if len(time) < 5:
        return out
    at = time[2:-2]
    near = [time[:-4] - at, time[1:-3] - at, time[3:-1] - at, time[4:] - at]
    rows = [q[:-4], q[1:-3], q[3:-1], q[4:]]
    out[2:-2] = 0.0
    for k in range(4):
        weight = np.prod([near[other] / (near[other] - near[k]) for other in range(4) if other != k], axis=0)
        out[2:-2] += weight[:, None] * rows[k]
    return out


def _median_rows(values: Array) -> Array:
    """Return the median of every row without NaN; NaN for fewer than three numbers."""
    enough = np.isfinite(values).sum(axis=1) >= 3
    return np.where(enough, np.nanmedian(np.where(enough[:, None], values, 0.0), axis=1), np.nan)


def rename_export(title: str) -> str:
    """Return the name here of a known logger's column, any other name unchanged."""
    plain = re.sub(r"[\[\]./ _]+", "_", title).strip("_").lower()
    if plain in TIMES:
        return TIMES[plain]
    for pattern, first, names in JOINTS:
        found = pattern.fullmatch(plain)
        if found:
            return names[found[1]].replace("#", str(int(found[2]) + 1 - first))
    return title
