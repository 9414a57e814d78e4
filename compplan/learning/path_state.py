"""Joint posterior of robot parameters, force and deviation along the path of a measured part.

The files of a robot folder hold what is known on any path: parameters that transfer, level of the force, and a turn
only of a force with a direction fixed in base or part. For the path of the part the posterior is narrower and joint.
It is kept as a factor B of its covariance B B^T, with a row for each parameter, for relative level and turns of the
force, and for each component of the deviation along the path. The next part of the same path starts from it.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from compplan.errors import InputError
from compplan.job.job import Job
from compplan.process.learned_force import FILE as PROCESS
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import FILE as UNCERTAINTY
from compplan.robot.uncertainty import Uncertainty, split_unknowns
from compplan.toolpath.toolpath import interpolate
from compplan.uncertainty.band import Slopes
from compplan.uncertainty.sensitivities import ForceSpread

#: Singular values of the factor below this share of the largest are not kept.
LEAST_SHARE = 1e-3


class PathState(NamedTuple):
    """Joint posterior of p parameters, the force and the deviation at k places along a path; r columns."""

    names: tuple[str, ...]  #: Names of the parameters. Length p.
    length: Array  #: Arc length along the path. Shape (k,). [m]
    parameters: Array  #: Rows of the parameters. Shape (p, r). [SI]
    force: Array  #: Rows of relative level and turns about the base axes of the force. Shape (4, r). [-, rad]
    deviation: Array  #: Deviation of the path that the program does not subtract, base axes. Shape (k, 3, r). [m]


def factor_state(names: tuple[str, ...], length: Array, covariance: Array) -> PathState:
    """Return the state of a joint covariance of parameters, force and deviation, shape (p + 4 + 3 k,) squared.

    Each row counts relative to its own standard deviation when columns of the factor are left out.
    """
    p, size = len(names), np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    value, vector = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = value > LEAST_SHARE**2 * value.max(initial=0.0)
    factor = unit[:, None] * vector[:, kept] * np.sqrt(value[kept])
    return PathState(names, length, factor[:p], factor[p : p + 4], factor[p + 4 :].reshape(len(length), 3, -1))


def apply_state(
    state: PathState | None, slopes: Slopes, known: Uncertainty, force: ForceSpread, length: Array
) -> tuple[Slopes, Uncertainty]:
    """Return a linearised path and its parameter uncertainty with the posterior of an earlier part of the path.

    force: uncertainty of the force of `slopes`; length: arc length at its k rows, (k,) [m]. Without a state, and with
    one of other parameters, both are returned unchanged.
    """
    if state is None or sorted(state.names) != sorted(known.names):
        return slopes, known
    rows = state.parameters[[state.names.index(name) for name in known.names]]
    width = np.linalg.norm(rows, axis=1)
    unknowns = tuple(
        replace(unknown, deviation=own / known.calibration) for unknown, own in split_unknowns(known.unknowns, width)
    )
    known = replace(known, unknowns=unknowns, factor=rows / np.where(width > 0.0, width, 1.0)[:, None])
    size = np.array([force.level, *[force.direction] * 3])[:, None]
    shares = np.where(size > 0.0, state.force / np.where(size > 0.0, size, 1.0), 0.0)
    whole = interpolate(length, state.length, state.deviation.reshape(len(state.length), -1))
    beyond = whole.reshape(*slopes.tip.shape, -1) - slopes.model @ known.spread - slopes.shared[:, :, :4] @ shares
    return replace(slopes, tie=(shares, np.zeros((4, 4))), beyond=beyond, local=0.0 * slopes.local), known


def state_file(job: Job) -> str:
    """Return the name of the file of a robot folder with the state of the path of a job."""
    return f"learned_{job.file.stem}.npz"


def write_state(state: PathState, file: Path) -> None:
    """Write the state of a path into a robot folder that has all of its other files."""
    arrays = {"parameters": state.parameters, "force": state.force, "deviation": state.deviation}
    few: dict[str, Any] = {name: array.astype(np.float32) for name, array in arrays.items()}
    few |= {"names": np.array(state.names), "length": state.length, "folder": _hash(file.parent)}
    np.savez_compressed(file, allow_pickle=False, **few)


def read_state(robot: Robot, job: Job) -> PathState | None:
    """Read the state of the path of a job; None if there is none, or the folder was changed since.

    Raises:
        InputError: If the file is not what `write_state` writes.
    """
    if robot.folder is None or not (file := robot.folder / state_file(job)).is_file():
        return None
    try:
        with np.load(file, allow_pickle=False) as held:
            if str(held["folder"]) != _hash(robot.folder):
                return None
            arrays = [np.asarray(held[name], float) for name in ("length", "parameters", "force", "deviation")]
            state = PathState(tuple(map(str, held["names"])), *arrays)
        p, k, r = len(state.names), len(state.length), state.force.shape[-1]
        if [part.shape for part in state[2:]] != [(p, r), (4, r), (k, 3, r)] or not k:  # type: ignore[union-attr]
            raise ValueError("its arrays do not match")
    except (ValueError, KeyError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise InputError(f"is not what compplan learn writes ({error}); delete it", file=file) from None
    return state


def _hash(folder: Path) -> str:
    """Return the SHA-256 of the files of a robot folder that the state refers to."""
    files = [folder / name for name in (UNCERTAINTY, PROCESS, "elasticity.toml", "robot.urdf")]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files if file.is_file())).hexdigest()
