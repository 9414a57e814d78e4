"""What a path has learned beyond its robot: the file of it in a robot folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.io.columns import FileColumn
from compplan.io.tables import read_table
from compplan.job.job import Job
from compplan.learning.model_update import KEPT
from compplan.robot import Array, Robot
from compplan.toolpath.toolpath import interpolate


@dataclass(frozen=True, eq=False)
class Residual:
    """What a path keeps beyond its robot: the deviation that the next program takes off; b places along it."""

    length: Array  #: Places along the path. Shape (b,). [m]
    deviation: Array  #: Deviation there, base axes. Shape (b, 3). [m]
    spread: Array  #: Standard deviation of it per axis. Shape (b,). [m]
    q: Array  #: How the arm stood there, unloaded on the path. Shape (b, nq). [rad or m]
    open: Array  #: What the last update left open of the tip, as columns u with covariance u u^T. Shape (b, 3, r). [m]

    @property
    def typical(self) -> float:
        """Mean standard deviation of it per axis. [m]"""
        return float(np.mean(self.spread))

    def at(self, length: Array) -> Array:
        """Return the deviation at places along the path. Shape (n, 3). [m]."""
        return interpolate(length, self.length, self.deviation)


def residual_file(robot: Robot, job: Job) -> Path | None:
    """Return the file of a robot folder that holds what it learned on the path of a job."""
    return None if robot.folder is None else robot.folder / f"learned_{job.file.stem}.csv"


def read_residual(file: Path | None, robot: Robot) -> Residual | None:
    """Read what was learned on a path; None where there is no such file.

    Raises:
        InputError: If it is not such a table.
    """
    if file is None or not file.exists():
        return None
    columns = [FileColumn(name, "length", required=True) for name in ("s", "dx", "dy", "dz", "sigma")]
    for number, slides in enumerate(robot.prismatic, 1):
        columns.append(FileColumn(f"q{number}", "length" if slides else "angle", required=True))
    names = [[f"u{n}{axis}" for axis in "xyz"] for n in range(1, KEPT + 1)]
    columns += [FileColumn(name, "length", required=True) for own in names for name in own]
    table = read_table(file, columns)
    length = table.values["s"]
    if not len(length) or (np.diff(length) < 0).any():
        raise table.error("s_mm has to rise from row to row, and there has to be one")
    joints = table.stack([f"q{number}" for number in range(1, robot.nq + 1)])
    left_open = np.stack([table.stack(own) for own in names], axis=2)
    return Residual(length, table.stack(["dx", "dy", "dz"]), table.values["sigma"], joints, left_open)
