"""Tables of joints: the reader of the language csv, and the comparison of joints.csv with the commanded arm."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.readback.poses import Move
from compplan.controllers.writers.joint_convention import load_motion
from compplan.io.parsing import guard_parser
from compplan.robot import Array, Robot

#: Columns of joints.csv after time and joints: wanted tip [mm], tool axis, wrench on the tool [N, N m], base frame.
WANTED = ("x_mm", "y_mm", "z_mm", "i", "j", "k", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Accepted rounding of joints.csv. [deg or mm]
TABLE = 1e-6


def check_joint_table(
    file: Path, robot: Robot, time: Array, q: Array, planned: Array, kept: NDArray[np.bool_]
) -> Iterator[str]:
    """Yield differences of joints.csv from the plan, and omitted rows at least a cycle away from its rows.

    Args:
        file: The table.
        robot: The robot.
        time: Time of each planned row. Shape (n,). [s]
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        planned: The columns of `WANTED`. Shape (n, 12).
        kept: Rows in the table. Shape (n,).
    """
    after = np.clip(np.searchsorted(time[kept], time), 1, int(kept.sum()) - 1)
    near = np.abs(time - time[kept][np.stack([after - 1, after])]).min(axis=0)
    if near.max() >= load_motion(robot)[0].cycle:
        yield f"joints.csv leaves out row {near.argmax()}, {1e3 * near.max():.3g} ms from the rows around it"
    time, q, planned = time[kept], q[kept], planned[kept]
    stated = {"time_s": time, **robot.joint_columns(q), **dict(zip(WANTED, planned.T, strict=True))}
    with guard_parser(file, "is not a table"), file.open(encoding="utf-8") as stream:
        head = stream.readline().strip().split(",")
        at = [head.index(name) for name in stated if name in head]
        table = np.loadtxt(stream, delimiter=",", usecols=at, ndmin=2)
    if table.shape != (len(q), len(stated)):
        yield f"joints.csv has {len(table)} rows and {len(at)} columns, planned are {len(q)} and {len(stated)}"
        return
    away = np.abs(table - np.column_stack([*stated.values()]))
    places = np.cumsum([0, 1, robot.nq, 3, 3, 6])
    whats = (("time", "s"), ("a joint", "deg or mm"), ("the wanted tip", "mm"), ("the tool axis", ""),
             ("the wrench", "N or N m"))  # fmt: skip
    for (what, unit), first, end in zip(whats, places[:-1], places[1:], strict=True):
        if (off := away[:, first:end].max()) > TABLE:
            yield f"joints.csv: {what} is {off:.4g} {unit} off"


def read_csv(path: Path, axes: tuple[str, ...], external: Iterable[bool]) -> list[Move]:
    """Read a joint table with these axis names, compared by letters and digits; `external` marks external axes."""
    header, *lines = path.read_text().splitlines()
    columns = [re.sub("[^A-Za-z0-9]", "", name) for name in header.split(",")]
    rows = [dict(zip(columns, map(float, line.split(",")), strict=True)) for line in lines]
    plain = [re.sub("[^A-Za-z0-9]", "", name) for name in axes]
    found = [(name + unit, out) for name, out in zip(plain, external, strict=True) for unit in ("deg", "mm")]
    arm, outer = ([name for name, out in found if name in columns and out == wanted] for wanted in (False, True))
    return [
        Move("joint", row["rapid"] == 1.0, tuple(row[name] for name in arm), tuple(row[name] for name in outer), None,
             row["feedmms"])
        for row in rows
    ]  # fmt: skip
