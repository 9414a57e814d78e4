"""Select the learned parameters that transfer to other paths: force of the process, and all robot parameters or none.

Cross-validation over long stretches of the part decides: without the residual of the path, the force alone, and force
and robot together, have to reduce the deviation on the stretch that was left out.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.job.job import Job
from compplan.job.loading import find_learned_force
from compplan.job.noise import EXPANSION, NoiseTable
from compplan.learning.gathered_points import Gathered
from compplan.learning.model_update import ModelUpdate, PartTerms, UpdateModel, learn_without
from compplan.learning.representable import apply_update
from compplan.process.learned_force import LearnedForce, LearnedPartTable, add_part, find_axes
from compplan.robot import Array, Robot
from compplan.robot.pose import rigid_columns
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.band import Slopes
from compplan.uncertainty.sensitivities import ForceSpread
from compplan.uncertainty.touch_off import spread_placement, states_placement

#: Prior standard deviation per axis of the placement of a best-fitted part: practically unknown. [m]
FITTED = 0.01
#: Folds of the cross-validation.
STRETCHES = 4
#: Greatest ratio of the left-out rms with and without a transfer (assumed: smaller benefits do not transfer).
FORCE, ROBOT = 0.97, 0.95


@dataclass(frozen=True, eq=False)
class Transfer:
    """Learned parameters that transfer to other paths."""

    force: bool  #: Whether the force transfers.
    robot: bool  #: Whether the robot parameters transfer.
    reason: str  #: Result of the cross-validation.
    #: Left-out rms with no transfer, with the force, and with force and robot. [m]
    left: tuple[float, float, float]


def choose_transfer(model: UpdateModel, gathered: Gathered, *, learned: bool = False) -> Transfer:
    """Select by cross-validation over stretches of a part what transfers to other paths.

    A force that was learned from earlier parts (`learned`) is updated unless the left-out rms grows by over 3 %.
    """
    part = np.minimum(STRETCHES * np.arange(len(gathered.row)) // max(len(gathered.row), 1), STRETCHES - 1)
    if not part.any():
        return Transfer(False, False, "used for this path only: just one place was measured", (np.inf,) * 3)
    left = np.zeros((3, *gathered.deviation.shape))
    for test, state in learn_without(model, gathered, part):
        rows = gathered.row[test]
        own = model.own.part[rows] @ state.own
        pushed = own + state.pushed[rows]
        for k, moved in enumerate((0.0 * own, pushed, pushed + state.physics[rows])):
            seen = np.einsum("bij,bj->bi", gathered.counts[test], moved)
            left[k, test] = gathered.deviation[test] - seen
    rms = np.sqrt(np.mean(np.sum(left**2, axis=2), axis=1))
    pushes = bool(np.any(model.slopes.shared[:, :, 0]))
    force = pushes and bool(rms[1] < (1.0 / FORCE if learned else FORCE) * rms[0])
    robot = bool(rms[2] < ROBOT * min(rms[0], rms[1]))
    names = ("without", "with the force", "with both")
    errors = ", ".join(f"{1e3 * value:.3g} mm {name}" for value, name in zip(rms, names, strict=True))
    chosen = "force and robot" if robot and pushes else "the robot" if robot else "the force" if force else "nothing"
    reason = f"Learned for other paths too: {chosen} (rms deviation on left-out stretches of this part: {errors})"
    return Transfer(force or (robot and pushes), robot, reason, (float(rms[0]), float(rms[1]), float(rms[2])))


def build_part_terms(
    noise: NoiseTable, origin: Array, slopes: Slopes, spread: ForceSpread, *, fitted: bool
) -> PartTerms:
    """Build the part-specific terms of the measured and the next part: force, clamping, temperature of the arm.

    noise: [noise] of the job; origin: of the part frame, (3,) [m]; fitted: whether a best fit moved the measured part.
    """
    tip = slopes.tip
    ratio = spread.scatter / spread.common if spread.common > 0.0 else 0.0
    force = ratio * slopes.shared[:, :, :1]
    moved = clamped = np.zeros((len(tip), 3, 0))  # the error of an absolute frame is common to all parts
    if slopes.touched is not None or states_placement(noise):
        moved = clamped = spread_placement(noise, slopes.touched, tip, origin)
    if fitted:
        free = FITTED, FITTED / max(float(np.ptp(tip, axis=0).max()), 1e-3)
        moved = rigid_columns(tip, tip.mean(axis=0)) * np.repeat(free, 3)
    warm = noise.temperature_K * EXPANSION if "temperature_K" in noise.model_fields_set else 0.0
    heat = warm * tip[:, :, None] if warm > 0.0 else np.zeros((len(tip), 3, 0))
    part, following = (np.concatenate([force, place, heat], axis=2) for place in (moved, clamped))
    return PartTerms(part, following, ratio)


def learn_force(
    model_update: ModelUpdate,
    spread: ForceSpread,
    old: LearnedForce | None,
    process: object,
    R_base_part: Array,
    job: str,
    kept: NDArray[np.bool_],
) -> tuple[LearnedForce, Array]:
    """Compute the learned force for other paths; also return its level and turns in prior sigmas, (4,).

    Its direction transfers if it is fixed in base or part; a direction that follows the path does not. spread: prior
    uncertainty of the force; R_base_part: part axes in the base frame, (3, 3); kept: parameters that the robot folder
    receives, too, (p,).
    """
    axes, shares = find_axes(process), model_update.force.copy()
    scale = 1.0 if old is None else old.level
    common, width = spread.common, np.sqrt(np.maximum(np.diag(model_update.force_covariance), 0.0))
    level = scale * (1.0 + common * float(shares[0]))
    turn = spread.direction * shares[1:]
    if not axes:
        shares[1:] = 0.0
    sigma = float(spread.direction * np.sqrt(np.mean(width[1:] ** 2))) if axes else None
    before = np.zeros(3) if old is None else old.turn
    axis = R_base_part if axes == "part" else np.eye(3)
    local = axis.T @ turn
    own = scale * (1.0 + common * float(shares[0] + model_update.model.own.ratio * model_update.own[0]))
    part = LearnedPartTable(
        date=datetime.datetime.now(tz=datetime.UTC).date(), job=job, level=max(own, 1e-3),
        sigma=scale * common * model_update.part_spread,
    )  # fmt: skip
    parts = () if old is None or not old.same else old.parts
    cross = model_update.cross[kept]
    robot = np.hstack([scale * common * cross[:, :1], spread.direction * bool(axes) * cross[:, 1:] @ axis])
    known = LearnedForce(
        max(level, 1e-3), scale * common * float(width[0]), before + local if axes else np.zeros(3), sigma,
        spread.scatter, parts, axes, robot=robot,
    )  # fmt: skip
    known = add_part(known, part)
    shares[0] = (known.level / scale - 1.0) / common if common > 0.0 else 0.0
    return known, shares


class TransferResult(NamedTuple):
    """Transfer to other paths: selection, robot, represented part of each parameter, force, and its shares.

    `held` has shape (p,) [SI], `shares` (4,).
    """

    transfer: Transfer
    robot: Robot
    held: Array
    force: LearnedForce | None
    shares: Array


def transfer_nothing(job: Job, robot: Robot, model_update: ModelUpdate) -> TransferResult:
    """Return the transfer without learned parameters."""
    transfer = Transfer(False, False, "nothing is transferred to other paths", (np.inf,) * 3)
    return TransferResult(transfer, robot, np.zeros(len(model_update.values)), find_learned_force(job), np.zeros(4))


def transfer_to_paths(
    job: Job, robot: Robot, model_update: ModelUpdate, known: Uncertainty, spread: ForceSpread
) -> TransferResult:
    """Transfer force and robot parameters to other paths as far as cross-validation supports them."""
    result = transfer_nothing(job, robot, model_update)
    transfer = choose_transfer(model_update.model, model_update.gathered, learned=result.force is not None)
    result = result._replace(transfer=transfer)
    own_tool = job.tool is None
    if transfer.force:
        name, turn = job.name or job.file.stem, job.T_base_part[:3, :3]
        keep = [(own_tool or u.effect != "tool_frame") and transfer.robot for u in known.unknowns for _ in u.keys]
        force, shares = learn_force(model_update, spread, result.force, job.process, turn, name, np.array(keep, bool))
        result = result._replace(force=force, shares=shares)
    if transfer.robot:
        updated, held = apply_update(robot, known, model_update.values, model_update.covariance, own_tool=own_tool)
        result = result._replace(robot=updated, held=held)
    return result
