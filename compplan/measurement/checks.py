"""Plausibility checks of a measurement log: joints, forces, time order, standard deviations, units.

One row in fifty may be a gross outlier: a few implausible rows are left out, with a note; more of them indicate wrong
units and are rejected. Duplicated rows count once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.parsing import LEAST_SIGMA
from compplan.io.tables import Table
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot

#: Greatest joint reading beyond its limits [rad], [m]: wrong zeros, extended limits.
TURN, WAY = 2.0 * np.pi, 10.0
#: Greatest plausible force [N], moment [N m], duration of a campaign [s] and standard deviation [m, rad].
MOST_FORCE, MOST_MOMENT, LONGEST, MOST_SIGMA = 1e6, 1e6, 1e8, 1.0
#: Range of plausible temperatures. [C]
COLDEST, HOTTEST = -60.0, 300.0
#: Share of the rows that may be gross outliers (measurement log, contract).
OUTLIERS = 0.02
#: Fewest rows of a fit, and greatest rotation vector of a measured orientation. [rad]
LEAST_ROWS, MOST_TURN = 3, 4.0 * np.pi
#: Joints are at rest below STILL [rad or m]; positions have moved above MOVED [m], and are equal up to SAME [m].
STILL, MOVED, SAME = 1e-9, 0.05, 1e-9
#: Joint motion above which positions must differ. [rad or m]
FAR_APART = 1e-2
#: Units by the ratio of measured to true distances if the column states millimetres (theory); relative tolerance of the
#: ratio, and least distance of points for the check (assumed). [m]
UNITS = {
    1e-3: "metres", 1e-2: "decimetres", 1e-1: "centimetres", 1 / 25.4: "inches", 1e3: "micrometres",
    25.4: "millimetres taken for inches",
}  # fmt: skip
ALIKE, DISTANT = 0.3, 20e-3


def check_campaign(campaign: Campaign, robot: Robot, table: Table) -> Campaign:
    """Return the campaign without implausible rows, which its notes list.

    Raises:
        InputError: With file and line, if more than 2 % of the rows (and more than one) are implausible, or the log
            contradicts itself.
    """
    _check_values(campaign, table)
    _check_clock(campaign, table)
    notes = list(table.notes)
    bad = find_pasted(table)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        notes.append(
            f"{bad.sum()} of {len(campaign)} rows repeat earlier rows in every column, the first in line "
            f"{table.lines[row]}: they count once"
        )
    for about, wrong in _absurd_rows(campaign, robot).items():
        if not wrong.any():
            continue
        row = int(np.flatnonzero(wrong)[0])
        said = _describe(about, campaign, robot, row)
        if wrong.sum() > max(1, OUTLIERS * len(campaign)) or wrong.all():
            raise table.error(f"{said}, likewise in {wrong.sum()} of {len(campaign)} rows", row)
        notes.append(f"line {table.lines[row]}: {said}; left out as an outlier")
        bad |= wrong
    if bad.any():
        campaign = replace(
            campaign,
            q=np.where(bad[:, None], _before(campaign.q, bad), campaign.q),
            wrench=np.where(bad[:, None], 0.0, campaign.wrench),
            position=np.where(bad[:, None], np.nan, campaign.position),
            observations=None if campaign.observations is None else campaign.observations.without(bad),
        )
    _check_motion(campaign, table)
    return replace(campaign, notes=tuple(notes))


def describe_unit(measured: Array, predicted: Array) -> str:
    """Describe the probable unit of measured points by distances of predicted ones, (n, 3) [m]; "" if plausible."""
    half = len(predicted) // 2
    seen, expected = (np.linalg.norm(p[half : 2 * half] - p[:half], axis=1) for p in (measured, predicted))
    if expected.max(initial=0.0) < DISTANT:
        return ""
    far = expected >= np.median(expected)
    ratio = float(np.median(seen[far] / expected[far]))
    unit = next((name for factor, name in UNITS.items() if abs(ratio / factor - 1.0) < ALIKE), "")
    said = f"distances between measured points are {ratio:.3g} times those of the predicted tips"
    return f"{said}; are the positions in {unit}, although the columns are named mm?" if unit else ""


def check_unit(campaign: Campaign, predicted: Array) -> None:
    """Reject a log whose positions are in another unit than those of the TCP (predicted, (n, 3) [m])."""
    known = np.isfinite(campaign.position).all(1) & np.isfinite(predicted).all(1)
    if said := describe_unit(campaign.position[known], predicted[known]):
        raise InputError(said, file=campaign.file)


def check_runs(campaign: Campaign) -> None:
    """Reject a log with too few usable rows, or with a separate run label in every row."""
    n, usable = len(campaign), int(campaign.usable.sum())
    if usable < LEAST_ROWS:
        message = f"{usable} rows have joints, load and position, a fit needs {LEAST_ROWS}; add poses"
        raise InputError(message, file=campaign.file)
    if n > 3 and len(np.unique(campaign.run)) == n:
        message = f"column 'run' has {n} labels in {n} rows; rows of one run were taken without a break"
        raise InputError(message, file=campaign.file)


def _check_values(campaign: Campaign, table: Table) -> None:
    """Reject implausible standard deviations, temperatures and orientations."""
    for name, values, low, high, unit, expected in (
        (table.headers.get("sigma_position"), campaign.sigma, LEAST_SIGMA, MOST_SIGMA, "m", ""),
        (table.headers.get("sigma_rotation"), campaign.sigma_rotation, LEAST_SIGMA, MOST_SIGMA, "rad", ""),
        ("temperature", campaign.temperature, COLDEST, HOTTEST, "C", " C"),
    ):
        wrong = np.zeros(0, bool) if values is None else (values < low) | (values > high)
        if values is not None and wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise table.error(f"{name} is {values[row]:g} {unit}, expected {low:g} to {high:g}{expected}", row)
    turns = np.abs(table.stack(["rx", "ry", "rz"])).max(axis=1) if "rx" in table else np.zeros(1)
    if (turns > MOST_TURN).any():
        row = int(np.flatnonzero(turns > MOST_TURN)[0])
        turn, most = np.degrees([turns[row], MOST_TURN])
        message = f"orientation of {turn:g} deg, a rotation vector has at most {most:g} deg"
        raise table.error(f"{message}; is column '{table.headers['rx']}' in another unit?", row)


def _check_clock(campaign: Campaign, table: Table) -> None:
    if campaign.time is None:
        return
    known = np.flatnonzero(np.isfinite(campaign.time))
    time, runs = campaign.time[known], campaign.run_index[known]
    if len(known) < 2:
        return
    back = np.flatnonzero((np.diff(time) < 0.0) & (np.diff(runs) == 0))
    if len(back):
        row = int(known[back[0] + 1])
        raise table.error(f"time runs back to {campaign.time[row]:g} s, expected rows in time order", row)
    if np.ptp(time) == 0.0 and len(known) > 3:
        raise table.error(f"column '{table.headers['time']}' never changes; leave it out where no time was taken")
    if np.ptp(time) > LONGEST:
        raise table.error(f"time spans {np.ptp(time):g} s, at most {LONGEST:g} s; is it in another unit?")


def _absurd_rows(campaign: Campaign, robot: Robot) -> dict[str, NDArray[np.bool_]]:
    """Return the rows with implausible joints, encoder readings or loads, by quantity."""
    room = np.where(robot.prismatic, WAY, TURN)
    rows: dict[str, NDArray[np.bool_]] = {}
    for name, joints in (("joint", campaign.q), ("link", campaign.link), ("motor", campaign.motor)):
        if joints is not None:
            beyond = (joints < robot.lower - room) | (joints > robot.upper + room)
            rows[name] = np.asarray(beyond.any(axis=1), bool)
    with np.errstate(over="ignore"):
        force, moment = (np.abs(part).max(axis=1) for part in (campaign.wrench[:, :3], campaign.wrench[:, 3:]))
    rows["wrench"] = np.logical_or(force > MOST_FORCE, moment > MOST_MOMENT)
    return rows


def _describe(about: str, campaign: Campaign, robot: Robot, row: int) -> str:
    """Describe the implausible value of a row."""
    if about == "wrench":
        size = np.abs(campaign.wrench[row])
        k = int(np.argmax(size))
        unit, most = ("N", MOST_FORCE) if k < 3 else ("Nm", MOST_MOMENT)
        return f"force or moment of {campaign.wrench[row, k]:g} {unit}, at most {most:g} {unit}"
    joints = {"joint": campaign.q, "link": campaign.link, "motor": campaign.motor}[about]
    assert joints is not None
    beyond = np.maximum(robot.lower - joints[row], joints[row] - robot.upper)
    k = int(np.nanargmax(beyond))
    slides = bool(robot.prismatic[k])
    value, low, high = (
        float(x * 1e3 if slides else np.degrees(x)) for x in (joints[row, k], robot.lower[k], robot.upper[k])
    )
    unit, side = "mm" if slides else "deg", "" if about == "joint" else f" ({about} side)"
    hint = "" if slides else "; is the column in radians or degrees?"
    return f"joint {robot.joint_names[k]!r}{side} is at {value:g} {unit}, limits [{low:g}, {high:g}]{hint}"


def _before(values: Array, bad: NDArray[np.bool_]) -> Array:
    """Replace each bad row by the last good one, so that no artificial move appears."""
    good = np.flatnonzero(~bad)
    if not len(good):
        return values
    index = np.maximum.accumulate(np.where(bad, -1, np.arange(len(values))))
    return np.asarray(values[np.where(index < 0, good[0], index)])


def _check_motion(campaign: Campaign, table: Table) -> None:
    """Reject constant positions with moving joints, and constant joints with moving positions."""
    rows = campaign.usable & campaign.measured
    if rows.sum() < 3:
        return
    joints, positions = campaign.q[rows], campaign.position[rows]
    moves, travels = bool((np.ptp(joints, axis=0) > STILL).any()), float(np.ptp(positions, axis=0).max())
    if moves and travels <= SAME and np.ptp(joints, axis=0).max() > FAR_APART:
        where = [float(value) for value in positions[0] * 1e3]
        raise table.error(f"all positions are the same, {where} mm, while the joints move; were they recorded?")
    if not moves and travels > MOVED and len(campaign.target_names) == 1:
        message = f"the joints never move, while positions spread over {travels * 1e3:.4g} mm; were they recorded?"
        raise table.error(message)
    if not moves and travels <= SAME and rows.sum() > 3:
        raise table.error("all rows have the same joints and position; expected different poses")


def list_notes(notes: Sequence[str], shown: int = 5) -> list[str]:
    """Format notes on a log as lines; summarise those beyond `shown` in one line."""
    lines = [f"note: {note}" for note in notes[:shown]]
    return lines if len(notes) <= shown else [*lines, f"note: and {len(notes) - shown} more of them"]


def find_pasted(table: Table) -> NDArray[np.bool_]:
    """Find rows that repeat an earlier row in every column. Shape (n,).

    In a log with time stamps, rows equal in all columns are duplicates. Without them repeated measurements may agree by
    rounding; then only a log that consists of complete repetitions counts as duplicated.
    """
    n = len(table)
    columns = [table.values[key] for key in table.values] + [
        np.unique(table.text[key], return_inverse=True)[1] for key in table.text
    ]
    if n < 2 or not columns:
        return np.zeros(n, bool)
    rows = np.nan_to_num(np.column_stack(columns).astype(float), nan=np.inf)
    pasted = np.ones(n, bool)
    if "time" in table and np.ptp(table.values["time"]) > 0.0:
        pasted[np.unique(rows, axis=0, return_index=True)[1]] = False
        return pasted
    periods = [n // times for times in range(n // 2, 1, -1) if n % times == 0 and n // times > 1]
    whole = next((period for period in periods if (rows == np.tile(rows[:period], (n // period, 1))).all()), n)
    pasted[:whole] = False
    return pasted
