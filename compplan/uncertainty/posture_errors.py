"""Error band as a criterion for choosing postures: error of the tip by every unknown, at thousands of postures.

The columns are those of `compplan.uncertainty.band` to first order: the signature of the effect if there is one,
otherwise the secant of `measure_slopes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.effects import EFFECTS, solve_model_poses, transmission_error
from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization, linearize_model
from compplan.effects.signature import Signature, plain
from compplan.errors import ConvergenceError
from compplan.job.job import Job
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.assumed import moves_base, robot_uncertainty
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    build_path_model,
    measure_slopes,
    read_force_spread,
    select_model_rows,
    tie_force,
)


@dataclass(frozen=True, eq=False)
class PostureErrors:
    """Uncertainty of a robot and its force, as errors of the tip at any posture."""

    robot: Robot  #: The robot with its tool.
    known: Uncertainty  #: Parameter uncertainty of the robot.
    force: ForceSpread  #: Uncertainty of the force.

    @property
    def source(self) -> str:
        """Return a description of the source of the errors."""
        said = {"measured": "measured", "literature": "from literature", "assumed": "assumed"}[self.known.grade]
        return f"widths are {said}: {self.known.source}; force: {self.force.source}"

    def columns(self, q: Array, wrench: Array) -> Array:
        """Return the error of the tip by one standard deviation of each cause. Shape (n, 3, errors). [m].

        Infinite if the loaded arm has no equilibrium. q: shape (n, nq); wrench at the TCP, base axes: (n, 6).
        """
        try:
            return self._columns(build_path_model(self.robot, q, wrench))
        except ConvergenceError:
            if len(q) == 1:
                return np.full((1, 3, self.known.factor.shape[1] + 8), np.inf)
        half = len(q) // 2
        return np.concatenate([self.columns(q[:half], wrench[:half]), self.columns(q[half:], wrench[half:])])

    def _columns(self, scene: ForwardModel) -> Array:
        known, n = self.known, len(scene.wrench)
        at = linearize_model(scene, solve_model_poses(scene))
        tied, apart = tie_force(known, self.force)
        alike = np.hypot(known.smooth, known.repeatability or 0.0)
        force = derive_force(at, scene.wrench, self.force)
        model = derive_unknowns(at, known.unknowns) @ known.spread + force[:, :, :4] @ tied
        own = [force[:, :, :4] @ apart, force[:, :, 4:]]
        return np.concatenate([model, *own, np.broadcast_to(alike * np.eye(3), (n, 3, 3))], axis=2)


def posture_errors(job: Job, robot: Robot) -> PostureErrors | None:
    """Return the error band criterion of a job; None unless its posture preset is "error_band".

    Raises:
        InputError: If the folder's uncertainty.toml names an effect, joint or parameter that the robot does not have.
    """
    if job.posture.preset != "error_band":
        return None
    known = robot_uncertainty(robot)
    if job.part.touched_off:  # to first order a touched-off part moves with the base
        unknowns = tuple(replace(u, deviation=0.0 * u.deviation) if moves_base(robot, u) else u for u in known.unknowns)
        known = replace(known, unknowns=unknowns)
    return PostureErrors(robot, known, read_force_spread(job))


def derive_force(at: Linearization, wrench: Array, spread: ForceSpread) -> Array:
    """Return the motion of the tip by one standard deviation of the force, to first order. Shape (n, 3, 5). [m].

    Columns: level, rotation about each base axis, local level; each is J C J^T times the change of the wrench.
    """
    parts = wrench[:, :3], wrench[:, 3:]
    turned = [np.concatenate([np.cross(axis, part) for part in parts], axis=1) for axis in np.eye(3)]
    changes = [spread.level * wrench, *(spread.direction * turn for turn in turned), spread.path * wrench]
    return np.asarray(at.wrench_response(np.stack(changes, axis=-1))[0][:, :3])


def derive_unknowns(at: Linearization, unknowns: Sequence[Unknown]) -> Array:
    """Return the motion of the target per unit of every parameter, to first order. Shape (n, 3, p). [m per SI unit]"""
    names = [joint.name for joint in at.robot.actuated]
    offered: dict[tuple[str, str | None, str | None], list[Signature]] = {}
    for name in dict.fromkeys(unknown.effect for unknown in unknowns):
        if name in EFFECTS and name != transmission_error.name:
            for signature in EFFECTS[name].signatures(at):
                offered.setdefault(signature.place, []).append(signature)
    rows, columns = np.arange(len(at.point)), []
    for unknown in unknowns:
        cycles = unknown.fixed.get("cycles_per_turn")
        if unknown.effect == transmission_error.name and cycles is not None:
            same = [transmission_error.waves_at(at, names.index(str(unknown.joint)), cycles)]
        else:
            same = offered.get((unknown.effect, unknown.joint, unknown.axis), [])
        fitting = [one for one in same if one.keys == unknown.keys and _plain(one) == _plain(unknown)]
        columns.append(fitting[0].twist[:, :3] if fitting else measure_slopes(at.scene, [unknown], rows))
    return np.concatenate(columns, axis=2) if columns else np.zeros((len(rows), 3, 0))


def vary_response(scene: ForwardModel, rows: NDArray[np.int_], known: Uncertainty) -> Array:
    """Return the change of the tip's response to the wrench by one deviation of each z of `known`. Shape (k, 3, r). [m]

    The derivatives by parameters with the wrench, less those without, at rows of a forward model.
    """
    here = select_model_rows(scene, rows)
    pushed, still = (
        derive_unknowns(linearize_model(at, solve_model_poses(at)), known.unknowns)
        for at in (here, replace(here, wrench=0.0 * here.wrench))
    )
    return np.asarray((pushed - still) @ known.spread)


def _plain(entry: Signature | Unknown) -> dict[str, object]:
    """Return the fixed settings of an effect as plain values."""
    return {key: value if isinstance(value, str) else plain(value) for key, value in entry.fixed.items()}
