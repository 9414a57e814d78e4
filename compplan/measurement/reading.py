"""Read and check a measurement log; write the header of an empty one.

Column titles of tracker and CMM programs, and of robots, that state axis and unit are converted:

| title, in any case and brackets | read as |
|---|---|
| X [mm], Measured X (mm), Actual_X_mm, X act. [m] | x_mm, x_m |
| J1 [deg], Axis 1 (rad), A1 [deg] | q1_deg, q1_rad |

Columns of nominal values and deviations are not renamed. A title without a unit is ignored: `doctor` reports it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.in_memory import open_table
from compplan.io.meshes import is_scan
from compplan.io.tables import Table
from compplan.measurement.campaign import MODES, WRENCH, Campaign
from compplan.measurement.checks import check_campaign
from compplan.measurement.instrument import COLUMNS, InstrumentFile, ObservedRows, read_observations
from compplan.robot import Array, Robot

_UNIT = r"[ _]*[\[(]?(?P<unit>{units})?[\])]?"
_SEEN = r"(?:(?:measured|meas\.?|actual|act\.?)[ _]*)?"
#: Patterns of titles (assumed), with column name and usual unit.
_TITLES = (
    (re.compile(rf"{_SEEN}(?P<of>[xyz]){_UNIT.format(units='mm|m')}", re.IGNORECASE), "{}", "mm"),
    (re.compile(rf"(?P<of>[xyz])[ _]*(?:measured|meas\.?|actual|act\.?){_UNIT.format(units='mm|m')}", re.IGNORECASE),
     "{}", "mm"),
    (re.compile(rf"(?:j|joint|axis|a|q)[ _]*(?P<of>[1-9]){_UNIT.format(units='deg|rad')}", re.IGNORECASE),
     "q{}", "deg"),
)  # fmt: skip
_HEAD = """\
# Measurement log of {robot}. One row a measured pose, or a sample of a path; rows in time order. # begins a note.
# run              rows of one run were taken without a break: static1 (approached, settled, measured), path1 (moving)
# time_s           since the campaign began
# q                commanded joint positions, as the motor-side encoders read them
# fx_N .. mz_Nm    wrench of the environment on the tool, at the TCP, base axes, weights not in it; all zero: no load
# x_mm y_mm z_mm   measured point, robot base frame (or --register base); another point than the TCP: --target-offset
# temperature_C    of the structure, or the best proxy there is; sigma_mm: standard deviation of the instrument, an axis
# Columns that you do not have may be left out, but run, q and x y z. Further ones: mode, target, rx_deg ry_deg rz_deg,
# q1_link_deg, q1_motor_deg, sigma_deg. Measure some poses twice, with others between: they show the noise.
"""


def log_columns(robot: Robot | None = None) -> list[FileColumn]:
    """List the columns of a log of a robot; without a robot those for any number of joints."""
    joints: list[tuple[str, str | tuple[str, ...]]] = [("q#", ("angle", "length"))]
    if robot is not None:
        joints = [(f"q{k}", "length" if slides else "angle") for k, slides in enumerate(robot.prismatic, 1)]
    columns = [
        FileColumn("run", "text"),
        FileColumn("mode", "text"),
        FileColumn("target", "text"),
        FileColumn("time", "time", missing=True),
    ]
    for joint, kind in joints:
        columns.append(FileColumn(joint, kind, required=True, missing=True))
        columns += [FileColumn(f"{joint}_{side}", kind, missing=True) for side in ("link", "motor")]
    columns += [FileColumn(name, "force", missing=True, group="force") for name in WRENCH[:3]]
    columns += [FileColumn(name, "moment", missing=True, group="moment") for name in WRENCH[3:]]
    columns += [FileColumn(name, "length", missing=True, group="position") for name in "xyz"]
    columns += [FileColumn(name, "angle", missing=True, group="orientation") for name in ("rx", "ry", "rz")]
    columns.append(FileColumn("temperature", "temperature", missing=True))
    columns.append(FileColumn("sigma", "length", missing=True, key="sigma_position"))
    columns.append(FileColumn("sigma", "angle", missing=True, key="sigma_rotation"))
    return [*columns, *COLUMNS]


def read_campaign(source: Any, robot: Robot, instrument: InstrumentFile | None = None) -> Campaign:
    """Read a measurement log.

    Args:
        source: The CSV file; or its columns, as a DataFrame or by name, units in their names:
            `{"q_deg": array of shape (n, nq), "position_mm": array of shape (n, 3)}`.
        robot: The measured robot: number and kind of its joints.
        instrument: Description of an instrument other than a tracker, or None.

    Raises:
        InputError: If the file is not a measurement log of this robot.
    """
    try:
        table = open_table(source, log_columns(robot), what="measurements", rename=rename_title)
    except InputError:
        if isinstance(source, str | Path) and Path(source).is_file() and is_scan(Path(source)):
            said = "is a scan: it measures a part and has no joints, expected a log of poses"
            raise InputError(f"{said}; compplan learn takes scans", file=Path(source)) from None
        raise
    if not len(table):
        raise table.error("the log has no rows, expected one row a measured pose")
    values, n = table.values, len(table)
    joints = [f"q{number}" for number in range(1, robot.nq + 1)]
    wrench = np.column_stack([values.get(name, np.zeros(n)) for name in WRENCH])
    rotation = None
    if "rx" in table:
        vectors = table.stack(["rx", "ry", "rz"])
        rotation = np.full((n, 3, 3), np.nan)
        known = np.isfinite(vectors).all(1)
        rotation[known] = Rotation.from_rotvec(vectors[known]).as_matrix()
    names, target = _targets(table)
    position, sighted = _positions(table, instrument)
    sigma = values.get("sigma_position")
    if sighted is not None:
        sigma = np.where(np.isfinite(sigma), sigma, sighted.sigma) if sigma is not None else sighted.sigma
    campaign = Campaign(
        run=table.text.get("run", np.array(["static"] * n, dtype=np.str_)),
        q=table.stack(joints),
        wrench=wrench,
        position=position,
        rotation=rotation,
        time=values.get("time"),
        temperature=values.get("temperature"),
        link=_encoders(table, robot, "link"),
        motor=_encoders(table, robot, "motor"),
        sigma=sigma,
        sigma_rotation=values.get("sigma_rotation"),
        target=target,
        target_names=names,
        mode=_modes(table),
        file=Path(source) if isinstance(source, str | Path) else None,
        lines=table.lines,
        observations=None if sighted is None else sighted.observations,
    )
    _refuse_empty(campaign, table)
    checked = check_campaign(campaign, robot, table)
    return checked if sighted is None else replace(checked, notes=(*checked.notes, *sighted.notes))


def _positions(table: Table, instrument: InstrumentFile | None) -> tuple[Array, ObservedRows | None]:
    """Return the positions, NaN in rows with another observation, and the observations.

    Raises:
        InputError: If the log has neither.
    """
    position = table.stack(["x", "y", "z"]) if "x" in table else np.full((len(table), 3), np.nan)
    sighted = read_observations(table, position, instrument)
    if "x" not in table and sighted is None:
        raise table.error("columns x_mm, y_mm and z_mm are missing, expected a position, or contact, reading_mm or"
                          " distance_mm of another instrument")  # fmt: skip
    if sighted is None:
        return position, None
    return np.where(sighted.observations.observed[:, None], np.nan, position), sighted


def _refuse_empty(campaign: Campaign, table: Table) -> None:
    if not campaign.usable.any():
        unread = campaign.observations is None and not campaign.measured.any()
        raise table.error("no reading is filled in yet: enter x_mm, y_mm, z_mm" if unread else
                          "no row has joints and a reading, expected at least one")  # fmt: skip
    if not campaign.measured.any():
        return
    reach = float(np.nanmax(np.abs(campaign.position)))
    if reach > 500.0:
        title = table.headers["x"]
        raise table.error(
            f"positions reach {reach:.0f} m with column '{title}'; name the columns x_mm y_mm z_mm if in mm"
        )


def _targets(table: Table) -> tuple[tuple[str, ...], NDArray[np.int_] | None]:
    if "target" not in table:
        return ("",), None
    labels = list(dict.fromkeys(table.text["target"].tolist()))
    return tuple(labels), np.array([labels.index(label) for label in table.text["target"]], int)


def _encoders(table: Table, robot: Robot, side: str) -> Array | None:
    keys = [f"q{number}_{side}" for number in range(1, robot.nq + 1)]
    if not any(key in table for key in keys):
        return None
    nothing = np.full(len(table), np.nan)
    return np.column_stack([table.values.get(key, nothing) for key in keys])


def _modes(table: Table) -> NDArray[np.str_] | None:
    if "mode" not in table:
        return None
    for row, mode in enumerate(table.text["mode"]):
        if mode not in (*MODES, ""):
            message = f"mode is {mode!r}, choose from {list(MODES)}"
            raise InputError(message, file=table.file, where=int(table.lines[row]))
    return table.text["mode"]


def rename_title(title: str) -> str:
    """Convert a column title of an export that states its unit to the name in a log; return any other unchanged."""
    found = _find(title)
    return title if found is None or not found[1] else "_".join(found)


def guess_name(title: str) -> str | None:
    """Return the name in a log, with the usual unit, of a column title without a unit; None for any other."""
    found = _find(title)
    return None if found is None or found[1] else f"{found[0]}_{found[2]}"


def _find(title: str) -> tuple[str, ...] | None:
    for form, name, usual in _TITLES:
        if match := form.fullmatch(title.strip()):
            unit = (match["unit"] or "").lower()
            return (name.format(match["of"].lower()), unit) if unit else (name.format(match["of"].lower()), "", usual)
    return None


def write_log_text(robot: Robot) -> str:
    """Write the header of an empty log of a robot.

    Args:
        robot: The robot: number and kind of its joints.
    """
    wrench = [f"{name}_{'N' if number < 3 else 'Nm'}" for number, name in enumerate(WRENCH)]
    columns = ["run", "time_s", *robot.joint_headers, *wrench, "x_mm", "y_mm", "z_mm", "temperature_C", "sigma_mm"]
    return _HEAD.format(robot=robot.name) + ",".join(columns) + "\n"
