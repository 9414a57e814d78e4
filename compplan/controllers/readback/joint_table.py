"""Is joints.csv what was planned? Its rows held against the commanded arm."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.readback.robot import JointTable
from compplan.io.parsing import guard_parser
from compplan.robot import Array

#: Columns of joints.csv beside time and joints.
WANTED = ("x_mm", "y_mm", "z_mm", "i", "j", "k", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Rounding that joints.csv leaves. [deg or mm]
TABLE = 1e-6


@dataclass(frozen=True)
class Commanded:
    """What was planned, row by row of what is delivered: the way there, the path, the way back."""

    q: Array  #: Commanded joint positions. Shape (n, nq). [rad or m]
    time: Array  #: Shape (n,). [s]
    wanted: Array  #: Wanted tip [mm], tool axis, wrench on the tool [N, N m], base frame. Shape (n, 12).
    program: Array  #: Rows that programs hold; Shape (m,).
    feed: Array  #: Feed that is driven in the move to each row, 0 in rapid moves. Shape (n,). [m/s]
    #: Whether the tool has to stand still at each row that programs hold, beside the ends of rapid moves. Shape (m,).
    stands: NDArray[np.bool_]
    may_stop: NDArray[np.bool_]  #: Where programs may stop exactly instead of leaving the path in a zone. Shape (m,).
    #: Whether the speed of the move to each row that programs hold is of no account. Shape (m,).
    free: NDArray[np.bool_]
    table: NDArray[np.bool_]  #: Rows that joints.csv holds. Shape (n,).
    coarser: Array  #: How much more than the strictest tolerance the move to each row may take. Shape (n,).
    sent: Array  #: Joint positions that programs hold: q, or what leads by the lag of drives. Shape (n, nq). [rad or m]
    asked: Array  #: Feed that the CAM file asks for in the move to each row that programs hold. Shape (m,). [mm/s]
    beside: Array  #: How far zones may lead beside a corner. Shape (m,). [m]
    #: From a row that programs hold to the corner that moves of the tool state in its place, nan at rows of a rounded
    #: corner that they leave out, 0 elsewhere. Shape (m, 3). [m]
    corner: Array
    #: How far rows may lie beside moves of the tool that stand for them, where the tolerance is strictest. [mm]
    fit: float

    def take(self, kept: NDArray[np.int_]) -> Commanded:
        """Return what was planned where programs hold some of their rows alone."""
        some = {
            name: getattr(self, name)[kept]
            for name in ("program", "stands", "may_stop", "free", "asked", "beside", "corner")
        }
        return replace(self, **some)


def check_posture_choice(wanted: Commanded, cycle: float) -> Iterator[str]:
    """Say where joints.csv leaves out a row that is no nearer than a cycle to one that it holds."""
    out, held = np.flatnonzero(~wanted.table), wanted.time[wanted.table]
    if not len(out):
        return
    after = np.clip(np.searchsorted(held, wanted.time[out]), 1, len(held) - 1)
    near = np.minimum(np.abs(wanted.time[out] - held[after - 1]), np.abs(held[after] - wanted.time[out]))
    if near.max() >= cycle:
        row, far = int(out[near.argmax()]), 1e3 * float(near.max())
        yield f"joints.csv leaves out row {row}, {far:.3g} ms from the rows around it, a cycle is {1e3 * cycle:g} ms"


def check_joint_table(file: Path, joints: JointTable, wanted: Commanded) -> Iterator[str]:
    """Say where joints.csv is not what was planned."""
    with file.open(encoding="utf-8", newline="") as stream:
        head = next(csv.reader(stream))
    axes = (f"q{k + 1}_{'mm' if slides else 'deg'}" for k, slides in enumerate(joints.slides))
    names = ["time_s", *axes, *WANTED]
    missing = [name for name in names if name not in head]
    if missing:
        yield f"joints.csv has no column {missing[0]}"
        return
    at = [head.index(name) for name in names]
    with guard_parser(file, "is not a table"):
        table = np.loadtxt(file, delimiter=",", skiprows=1, usecols=at, ndmin=2, encoding="utf-8")
    if len(table) != wanted.table.sum():
        yield f"joints.csv has {len(table)} rows, planned are {wanted.table.sum()}"
        return
    nq = len(joints.slides)
    off = np.abs(table[:, 1 : nq + 1] - to_degrees(wanted.q[wanted.table], joints)).max()
    if off > TABLE:
        yield f"joints.csv: a joint is {off:.4g} deg or mm off"
    if (late := np.abs(table[:, 0] - wanted.time[wanted.table]).max()) > 1e-6:
        yield f"joints.csv: time is {late:.4g} s off"
    away = np.abs(table[:, nq + 1 :] - wanted.wanted[wanted.table])
    for what, unit, columns in (("wanted tip", " mm", away[:, :3]), ("tool axis", "", away[:, 3:6]),
                                ("wrench", " N or N m", away[:, 6:])):  # fmt: skip
        if columns.max() > TABLE:
            yield f"joints.csv: the {what} is {columns.max():.4g}{unit} off"


def to_degrees(q: Array, joints: JointTable) -> Array:
    """Return positions of joints as programs hold them, slides in mm. Shape as q. [deg or mm]"""
    return np.where(np.array(joints.slides), 1e3 * q, np.degrees(q))
