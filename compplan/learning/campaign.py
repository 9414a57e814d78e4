"""Design the few measurements that narrow the 95 % band on one path most, and predict their effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from compplan.errors import InputError
from compplan.learning.candidates import (
    PLACES,
    Candidates,
    Fixture,
    find_postures,
    find_touching,
    list_candidates,
    list_fixtures,
)
from compplan.learning.design import Choice, Design, choose_measurements, order_poses
from compplan.measurement.campaign import Campaign
from compplan.measurement.equipment import SOCKETS, TRACKER, Equipment
from compplan.measurement.observations import Observations
from compplan.measurement.pose_selection import learn_rows
from compplan.planning.plan import Plan
from compplan.planning.posture.collision_scene import build_scene
from compplan.robot import Array, Robot
from compplan.simulation.predict import predict_campaign
from compplan.uncertainty.assumed import COMPLIANCES, list_assumed, robot_uncertainty
from compplan.uncertainty.band import lead_unknowns, linearise_path, split_covariance
from compplan.uncertainty.sensitivities import (
    build_path_model,
    build_varied_model,
    measure_slopes,
    read_force_spread,
)

#: Probability of the chi-square test whether a log is consistent with the parameter uncertainty.
BY_CHANCE = 0.999


@dataclass(frozen=True, eq=False)
class PoseCampaign:
    """Poses to measure, in the order of measuring; the last repeats the first."""

    plan: Plan  #: Plan of the path for which they are chosen.
    equipment: Equipment  #: Available measuring equipment.
    poses: Candidates  #: The measurements, in the order of measuring.
    rank: NDArray[np.int_]  #: Rank in `choice`, 1 the most useful; ordered as `poses`.
    choice: Choice  #: Reduction of the band, in the order of the rank.
    design: Design  #: Prior uncertainty and linearised path.
    start: Array  #: Covariance before the first measurement.
    #: Parameters that dominate the remaining band: name and share of the variance.
    rest: tuple[tuple[str, float], ...]
    touching: NDArray[np.int_]  #: Indices into `poses` of the poses whose approaching joint move collides.
    log: int  #: Number of rows used from the partial log.
    lacks_load: bool  #: Whether compliances, which poses without load do not determine, dominate the remaining band.
    notes: tuple[str, ...]  #: Notes for the user, one sentence each.

    @property
    def fixtures(self) -> tuple[Fixture, ...]:
        """Return the locations of the instrument; empty for a tracker, which may be placed anywhere."""
        return list_fixtures(self.equipment.instrument, self.poses.observations, self.poses.tip)


def design_campaign(
    plan: Plan, equipment: Equipment, count: int, log: Campaign | None = None,
    announce: Callable[[str], None] = lambda words: None,
) -> PoseCampaign:  # fmt: skip
    """Design `count` measurements for the path of a plan; `log`: earlier measurements, or None.

    Raises:
        InputError: If fewer than `count` postures are reachable.
    """
    task, robot = plan.task, plan.robot
    announce("the path and what is known")
    solids = None if task.start is None else task.start.settings.scene
    solids = build_scene(robot) if solids is None else solids
    lowest = float(task.position[:, 2].min())
    known, scene = robot_uncertainty(robot), build_path_model(robot, plan.q, task.wrench, task.step_time)
    # poses reduce the uncertainty of the robot alone: its correlation with the force is ignored
    path = linearise_path(scene, known, read_force_spread(plan.job), task.cut, touched=task.touched)
    design, notes = Design(known, replace(path, tie=None), equipment.sigma, equipment.frames), list_assumed(robot)
    start, used, advice = learn_log(design, robot, log)
    notes += advice
    announce("postures")
    postures, observations = find_postures(robot, plan.q, lowest, solids, equipment.seed), None
    if equipment.instrument != TRACKER and len(postures):
        places = PLACES[equipment.instrument] if equipment.places is None else equipment.places
        middle = task.position[task.cut].mean(axis=0)
        postures, observations = find_touching(robot, postures, middle, lowest, equipment.instrument, places,
                                          equipment.length, solids)  # fmt: skip
    if len(postures) < count:
        raise InputError(
            f"only {len(postures)} postures are within joint limits and free of collisions, --poses asks for {count}:"
            " ask for fewer, or check limits and shapes of the robot folder"
        )
    candidates = list_candidates(robot, postures, equipment.weights, equipment.pull, known.unknowns)
    if observations is not None:
        candidates = replace(candidates, observations=observations.repeat(len(candidates) // len(observations.kind)))
    announce("choice")
    if candidates.observations is not None:
        design, start = add_places(design, start, candidates.observations, candidates.tip, count)
    choice = choose_measurements(design, candidates, count, start)
    notes += advise_pull(equipment, task.wrench[task.cut, :3])
    chosen = candidates.take(choice.rows)
    order, touching = order_poses(robot, chosen.q, chosen.start, chosen.wrench, plan.q[0], solids)
    again, after = np.r_[order, order[0]], known.with_covariance(choice.covariance)
    return PoseCampaign(
        plan=plan,
        equipment=equipment,
        poses=chosen.take(again),
        rank=again + 1,
        choice=choice,
        design=design,
        start=start,
        rest=lead_unknowns(design.path, after, split_covariance(design.path, after)),
        touching=touching,
        log=used,
        lacks_load=not equipment.loaded and is_dominated_by_compliances(design, choice.covariance),
        notes=tuple(notes),
    )


def add_places(
    design: Design, start: Array, observations: Observations, tip: Array, count: int
) -> tuple[Design, Array]:
    """Add the unknown contact positions to a design; condition its covariance on the known distances between them.

    Raises:
        InputError: If `count` poses are fewer than two for each place.
    """
    if count < 2 * len(observations.names):
        message = f"{count} poses at {len(observations.names)} unknown places, expected at least two per place"
        raise InputError(f"{message}: more --poses or fewer --places")
    design = replace(design, places=len(observations.names))
    wide = design.start.copy()
    wide[: len(start), : len(start)] = start
    places = observations.start_places(tip)
    slopes = observations.known.slopes(places).reshape(len(observations.known), 3 * len(places))
    for row, sigma in zip(slopes, observations.known.sigma, strict=True):
        wide = learn_rows(wide, np.pad(row, (len(wide) - len(row), 0))[None, None], float(sigma) ** 2)
    return design, wide


def advise_pull(equipment: Equipment, force: Array) -> list[str]:
    """Return advice to pull at the tool if the process has a sideways force and only weights are used. [N]"""
    aside, down = (float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (force[:, :2], force[:, 2:]))
    if not equipment.loaded or equipment.pull > 0.0 or equipment.instrument == SOCKETS or aside <= down:
        return []
    return [
        f"weights pull down only, but the process pushes sideways with up to {aside:.0f} N: pull the tool sideways"
        f" at some poses (--pull-N {min(aside, 400.0):.0f}), otherwise the sideways deflection stays uncertain"
    ]


def is_dominated_by_compliances(design: Design, covariance: Array) -> bool:
    """Return whether compliances cause at least half of the variance of the remaining band."""
    rigid = [u.effect not in COMPLIANCES for u in design.known.unknowns for _ in u.keys]
    left, rest = design.model_band(covariance), design.model_band(covariance * np.outer(rigid, rigid))
    return bool(rest**2 <= 0.5 * left**2)


def learn_log(design: Design, robot: Robot, log: Campaign | None) -> tuple[Array, int, list[str]]:
    """Condition the covariance on a partial log; also return the number of rows used and a consistency note."""
    if log is None:
        return design.start, 0, []
    use = np.flatnonzero(log.usable & ~log.on_path)
    observations = None if log.observations is None else log.observations.take(use)
    # the contact positions of this log are further unknowns of the state while its rows are learned
    own = design if observations is None else replace(design, places=len(observations.names))
    scene = build_varied_model(robot, log)
    predicted = predict_campaign(robot, log, register=design.frames)
    slopes = measure_slopes(scene, design.known.unknowns, use)
    rows = own.rows(slopes, predicted.position[use], predicted.rotation[use], observations)
    gap, flat = predicted.gap[use].reshape(-1), rows.reshape(3 * len(use), -1)
    spread = flat @ own.start @ flat.T + design.noise * np.eye(len(flat))
    rank = int(np.sum(np.abs(flat).sum(axis=1) > 0)) if observations is None else int(np.linalg.matrix_rank(rows).sum())
    freedom = max(rank - 3 * len(design.frames) ** 2 - 3 * own.places, 1)
    distance = float(gap @ np.linalg.solve(spread, gap))
    advice = []
    if distance > 2.0 * gammaincinv(0.5 * freedom, BY_CHANCE):
        advice.append(
            f"the log contradicts the robot folder: it differs by {np.sqrt(distance / freedom):.2g} times the stated"
            " uncertainty; run compplan diagnose on it, then campaign with --robot and the updated folder"
        )
    p = len(design.start)
    return learn_rows(own.start, rows, design.noise)[:p, :p], len(use), advice


def parse_weights(text: str) -> tuple[float, ...]:
    """Read the available weights: numbers in kg, separated by commas.

    Raises:
        InputError: If they are not numbers from 0 to 5000 kg.
    """
    try:
        weights: Sequence[float] = [float(part) for part in text.split(",")]
    except ValueError:
        weights = [-1.0]
    if not all(0.0 <= weight <= 5000.0 for weight in weights):
        raise InputError(f"--weights-kg is {text!r}, expected numbers from 0 to 5000 with commas, such as 0,20")
    return tuple(dict.fromkeys(weights))
