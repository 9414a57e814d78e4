"""Read a measurement log, and check it before anything is computed from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.in_memory import is_file_name, open_table
from compplan.io.scans import is_scan
from compplan.io.tables import Table
from compplan.measurement.campaign import MODES, WRENCH, Campaign
from compplan.measurement.checks import check_campaign
from compplan.measurement.exports import rename_title
from compplan.measurement.instrument import COLUMNS, InstrumentFile, ObservedRows, read_observations
from compplan.robot import Array, Robot


def log_columns(robot: Robot | None = None) -> list[FileColumn]:
    """List the columns that a log of this robot may have; of any robot, however many joints, where none is given."""
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
        robot: The robot it belongs to: how many joints it has, and which of them slide.
        instrument: What is known of an instrument that sees no positions, where there is one.

    Raises:
        InputError: If the file is not a measurement log of this robot.
    """
    try:
        table = open_table(source, log_columns(robot), what="measurements", rename=rename_title)
    except InputError:
        if is_file_name(source) and Path(source).is_file() and is_scan(Path(source)):
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
        file=Path(source) if is_file_name(source) else None,
        lines=table.lines,
        sights=None if sighted is None else sighted.sights,
    )
    _refuse_empty(campaign, table)
    checked = check_campaign(campaign, robot, table)
    return checked if sighted is None else replace(checked, notes=(*checked.notes, *sighted.notes))


def _positions(table: Table, instrument: InstrumentFile | None) -> tuple[Array, ObservedRows | None]:
    """Return the positions, NaN where a row has another sight, and the sights.

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
    return np.where(sighted.sights.seen[:, None], np.nan, position), sighted


def _refuse_empty(campaign: Campaign, table: Table) -> None:
    if not campaign.usable.any():
        raise table.error("no row has joints and a position, expected at least one")
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
