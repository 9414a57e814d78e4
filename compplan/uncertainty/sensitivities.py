"""Robot models with varied parameters, and derivatives of the loaded tip by parameters and force.

Compliances change by a spring in series, C = C_folder + dC, valid for either sign of dC; all other parameters change
through the forward model of their effect. Columns of the Jacobian are secants of the exact equilibrium over one
standard deviation. Effects with memory (lost motion) are evaluated along the complete path; the equilibrium is solved
at selected rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.effects import (
    Effect,
    apply_effects,
    build_model,
    command_campaign,
    fold_effects,
    is_of_instrument,
    robot_effects,
    solve_model_poses,
)
from compplan.effects.attained import attain_positions
from compplan.effects.folding import base_joint
from compplan.effects.forward_model import Attained, ForwardModel
from compplan.effects.signature import pack_parameters
from compplan.job.job import Job
from compplan.job.loading import find_learned_force
from compplan.job.noise import NoiseTable
from compplan.measurement.campaign import Campaign
from compplan.process.learned_force import SCATTER
from compplan.robot import Array, Robot, Spring
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns
from compplan.uncertainty.assumed import LINK_ELASTICITY

#: Number of rows of a path at which the equilibrium is differentiated.
ROWS = 200
#: Greatest part-to-part share of a stated deviation of the level (assumed: half of the variance).
SHARED = 0.7
#: Correlation length of the local level of the force (assumed). [m]
CORRELATION = 0.02
#: Difference steps: of a parameter with zero deviation [SI], and of the force (relative; rotation in rad).
TINY, SHARE = 1e-9, 1e-3
#: Variance added to the correlation matrix of the parameters, against rounding.
REGULARISATION = 1e-6
#: Tolerance of elastic coordinates in equilibria that are subtracted. [rad or m]
REFINED = 1e-12
_BY_ROW = ("zero", "drive", "wrench", "joint_load", "growth", "base_twist", "tool_twist", "encoder")


@dataclass(frozen=True, eq=False)
class ForceSpread:
    """Uncertainty of the wrench on the tool; relative standard deviations."""

    level: float  #: Of its magnitude, constant along the path, including part-to-part scatter.
    direction: float  #: Of its direction, constant along the path. [rad]
    path: float  #: Of its magnitude, varying along the path.
    source: str  #: Source of the values.
    scatter: float = 0.0  #: Of its magnitude from part to part, at most `level`.
    #: Covariance of magnitude and rotations about the base axes [rad] with robot parameters. Shape (p, 4).
    robot: Array = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def common(self) -> float:
        """Return the standard deviation of the magnitude common to all parts."""
        return float(np.sqrt(max(self.level**2 - self.scatter**2, 0.0)))

    def of_all(self) -> ForceSpread:
        """Return the uncertainty common to all parts, without part-to-part scatter."""
        return replace(self, level=self.common)


def read_force_spread(job: Job | None) -> ForceSpread:
    """Return the uncertainty of the force from measured parts and [noise] of a job; without a job, assumed defaults."""
    table = NoiseTable() if job is None else job.noise
    learned = None if job is None else find_learned_force(job)
    if learned is not None:
        direction = float(np.radians(table.wrench_direction_deg))
        direction = direction if learned.turn_sigma is None else learned.turn_sigma
        turn = np.eye(3) if job is None or learned.axes != "part" else job.T_base_part[:3, :3]
        robot = np.hstack([learned.robot[:, :1] / learned.level, learned.robot[:, 1:] @ turn.T])
        return ForceSpread(learned.spread, direction, table.wrench_path, learned.source, learned.scatter, robot)
    return state_force(table)


def state_force(table: NoiseTable) -> ForceSpread:
    """Return the uncertainty of the force that [noise] states, or assumes."""
    stated = {"wrench_level", "wrench_direction_deg", "wrench_path"} & table.model_fields_set
    said = "[noise] of the job" if stated else "assumed: force models of milling and forming err by 10 to 20 %"
    scatter = min(SCATTER, SHARED * table.wrench_level)
    return ForceSpread(
        table.wrench_level, float(np.radians(table.wrench_direction_deg)), table.wrench_path, said, scatter
    )


def tie_force(known: Uncertainty, spread: ForceSpread) -> tuple[Array, Array]:
    """Split level and rotations of the force into parts correlated with and independent of the robot's parameters.

    With parameters p = S z and shares f in standard deviations, f = B z + L e; z and e are independent and normal. The
    first parameters of `known` correspond to the rows of `spread.robot`. Returns B, (4, r), and L, (4, 4).
    """
    factor, count = known.factor, len(spread.robot)
    size = np.array([spread.level, *[spread.direction] * 3])
    if not count or count > len(factor) or not (size > 0.0).all():
        return np.zeros((4, factor.shape[1])), np.eye(4)
    width = np.maximum(known.width, 1e-300)
    joint = np.pad(spread.robot, ((0, len(factor) - count), (0, 0))).T / size[:, None] / width
    tied = joint @ np.linalg.solve(factor @ factor.T + REGULARISATION * np.eye(len(factor)), factor)
    value, vector = np.linalg.eigh(tied @ tied.T)
    # limit the correlation to 1: parameters and force were rounded
    tied = vector @ np.diag(1.0 / np.sqrt(np.maximum(value, 1.0))) @ vector.T @ tied
    return tied, vector @ np.diag(np.sqrt(np.maximum(1.0 - value, 0.0))) @ vector.T


def pick_rows(cut: NDArray[np.bool_], most: int = ROWS) -> NDArray[np.int_]:
    """Select at most `most` evenly spaced rows of the cut, including the first and the last."""
    rows = np.flatnonzero(cut)
    return rows if len(rows) <= most else rows[np.unique(np.linspace(0, len(rows) - 1, most).astype(int))]


def build_path_model(robot: Robot, q: Array, wrench: Array, step_time: Array | None = None) -> ForwardModel:
    """Build the forward model of a robot at the rows of a commanded path, with the effects of its folder."""
    time = None if step_time is None else np.r_[0.0, np.cumsum(step_time)]
    return build_varied_model(robot, command_campaign(q, wrench, time=time))


def select_model_rows(scene: ForwardModel, rows: NDArray[np.int_]) -> ForwardModel:
    """Select rows of a forward model; effects with memory keep the influence of the other rows."""
    parts = {name: getattr(scene, name)[rows] for name in _BY_ROW}
    return replace(scene, campaign=scene.campaign.take(rows), **parts)


def solve_rows(scene: ForwardModel, rows: NDArray[np.int_]) -> Attained:
    """Solve the equilibrium of selected rows of a forward model, accurately enough for finite differences."""
    return solve_model_poses(select_model_rows(scene, rows), tolerance=REFINED)


def measure_slopes(
    scene: ForwardModel, unknowns: Sequence[Unknown], rows: NDArray[np.int_], rest: Attained | None = None
) -> Array:
    """Return the derivative of the target by every parameter at rows of a path. Shape (k, 3, p). [m per SI unit]

    rest: result of `solve_rows` at the rows, if available.
    """
    rest = rest or solve_rows(scene, rows)
    varied, steps = [], []
    for unknown in unknowns:
        for k, deviation in enumerate(unknown.deviation):
            steps.append(float(deviation) if deviation > 0 else TINY)
            values = np.zeros(len(unknown.keys))
            values[k] = steps[-1]
            varied.append(select_model_rows(vary_model(scene, [unknown], values), rows))
    moved = attain_positions(varied, tolerance=REFINED, theta=rest.theta)
    columns = [(position - rest.position) / step for position, step in zip(moved, steps, strict=True)]
    return np.stack(columns, axis=-1) if columns else np.zeros((len(rows), 3, 0))


def measure_force_slopes(
    scene: ForwardModel, rows: NDArray[np.int_], spread: ForceSpread, rest: Attained | None = None
) -> tuple[Array, Array]:
    """Return the motion of the tip by one standard deviation of the force: shared (k, 3, 4) and local (k, 3, 1). [m]

    The shared ones are constant along the path: its level, and a rotation about each base axis.
    """
    here = select_model_rows(scene, rows)
    if not here.wrench.any():
        return np.zeros((len(rows), 3, 4)), np.zeros((len(rows), 3, 1))
    rest = rest or solve_rows(scene, rows)
    turns = [turn_wrench(here.wrench, Rotation.from_rotvec(SHARE * axis)) for axis in np.eye(3)]
    pushed = [replace(here, wrench=wrench) for wrench in (here.wrench * (1.0 + SHARE), *turns)]
    moved = attain_positions(pushed, tolerance=REFINED, theta=rest.theta)
    level, *turned = [(position - rest.position) / SHARE for position in moved]
    shared = np.stack([spread.level * level, *(spread.direction * column for column in turned)], axis=-1)
    return shared, spread.path * level[:, :, None]


def apply_wrench_to_model(scene: ForwardModel, force: Array, spread: ForceSpread) -> ForwardModel:
    """Apply shares of the force uncertainty to a model: level, and rotation about each base axis. force: shape (4,)."""
    turn = Rotation.from_rotvec(spread.direction * np.asarray(force[1:]))
    return replace(scene, wrench=turn_wrench(scene.wrench * (1.0 + spread.level * float(force[0])), turn))


def turn_wrench(wrench: Array, turn: Rotation) -> Array:
    """Rotate forces and moments. Shape (k, 6). [N, N m]."""
    return np.concatenate([turn.apply(wrench[:, :3]), turn.apply(wrench[:, 3:])], axis=1)


def tip_of(scene: ForwardModel, rows: NDArray[np.int_]) -> Array:
    """Return the loaded tip of a forward model at selected rows. Shape (k, 3). [m]."""
    return solve_model_poses(select_model_rows(scene, rows)).position


def vary_robot(robot: Robot, unknown: Unknown, values: Array) -> tuple[Robot, Effect | None]:
    """Change the parameters of one unknown; return the robot, and an effect if URDF and springs cannot represent it."""
    change = float(values[0])
    if unknown.effect == "joint_stiffness":
        return _in_series(robot, Spring(str(unknown.joint), "own", change, actuator=True)), None
    if unknown.effect == "link_compliance":
        return _in_series(robot, Spring(str(unknown.joint), str(unknown.axis), change)), None
    if unknown.effect == "base_compliance" and (joint := base_joint(robot)) is not None:
        return _in_series(robot, Spring(joint, str(unknown.axis), change)), None
    if unknown.effect == LINK_ELASTICITY:
        children = {joint.name: joint.child for joint in robot.joints}
        link = children[str(unknown.joint)]
        blocks = tuple(
            replace(b, compliance=b.compliance * (1.0 + change)) if b.link == link else b
            for b in robot.link_elasticities
        )
        return replace(robot, link_elasticities=blocks), None
    effect = Effect(unknown.effect, unknown.joint, unknown.axis, pack_parameters(unknown.keys, values, unknown.fixed))
    if unknown.effect == "base_compliance":
        return robot, effect
    folded = fold_effects(replace(robot, effects=()), [effect])
    if folded.effects:
        return robot, effect
    return replace(folded, effects=robot.effects), None


def build_varied_model(robot: Robot, campaign: Campaign) -> ForwardModel:
    """Build the forward model of a robot with the effects of its folder at commanded rows, no instrument errors."""
    effects = [effect for effect in robot_effects(robot) if not is_of_instrument(effect.name)]
    return apply_effects(build_model(robot, campaign, later=True), effects)


def vary_model(scene: ForwardModel, unknowns: Sequence[Unknown], values: Array) -> ForwardModel:
    """Apply values of the unknowns to a forward model, exactly."""
    robot, beside = scene.robot, []
    for unknown, own in split_unknowns(unknowns, values):
        robot, effect = vary_robot(robot, unknown, own)
        if effect is not None:
            beside.append(effect)
    return apply_effects(scene if robot is scene.robot else replace(scene, robot=robot), beside)


def _in_series(robot: Robot, spring: Spring) -> Robot:
    """Add a spring in series with those of its joint."""
    return replace(robot, springs=(*robot.springs, spring))
