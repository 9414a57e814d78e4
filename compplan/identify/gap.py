"""How far the model lies from the measurements, before and after, on rows it was fitted to and on rows it never saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.identify.estimate import Estimate, pose_groups
from compplan.identify.heldout import distance_rms, leave_out, linearise_at
from compplan.identify.parameters import FreeRobot
from compplan.identify.problem import IdentifyProblem
from compplan.robot import Array


@dataclass(frozen=True)
class IdentifiedGap:
    """Rms of the 3D distance over the rows that are no outliers. [m]

    Attributes:
        before: Nominal robot, frames fitted.
        after: Identified robot.
        held_out_before: As before; frames from the other blocks.
        held_out_after: As after, from models that never saw the rows.
        under_load_before: Deflection of a pose under its loads, nominal; None where no pose has several loads.
        under_load_after: The same, identified, held out.
    """

    before: float
    after: float
    held_out_before: float
    held_out_after: float
    under_load_before: float | None
    under_load_after: float | None


def measure_gap(problem: IdentifyProblem, structure: FreeRobot, kept: Estimate, *, difference: bool) -> IdentifiedGap:
    """Measure the gap of the nominal and the identified robot.

    Args:
        problem: Rows, and frames to be fitted, in absolute poses.
        structure: Structure that holds the nominal robot.
        kept: Fit that the updated robot holds.
        difference: Whether it is of differences.
    """
    rows, group = np.ones(len(problem.observations), bool), pose_groups(problem.observations)
    bare = problem.fit(structure.select([]))
    shown = kept
    if difference:
        shown = problem.fit(_move_nominal(kept.structure, kept.model_values).select([]))
    several = len(np.unique(group)) < 0.7 * len(group) and np.abs(problem.observations.wrench).max(initial=0.0) > 0
    weights = kept.weights

    def held_out(estimate: Estimate, *, difference: bool = False) -> float:
        return distance_rms(_leave_out(problem, replace(estimate, weights=weights), difference=difference), rows)

    return IdentifiedGap(
        before=distance_rms(bare.residuals, rows),
        after=distance_rms(shown.residuals, rows),
        held_out_before=held_out(bare),
        held_out_after=held_out(shown),
        under_load_before=held_out(bare, difference=True) if several else None,
        under_load_after=held_out(kept, difference=True) if several else None,
    )


def _leave_out(problem: IdentifyProblem, estimate: Estimate, *, difference: bool = False) -> Array:
    system = linearise_at(estimate, problem.observations)
    free = estimate.free.copy()
    if difference:
        # Frames and geometry do not show in differences of one pose.
        free &= np.array([parameter.kind in ("joint", "spring", "link") for parameter in estimate.parameters], bool)
    return leave_out(system, problem.observations, estimate, free, difference=difference).residual


def _move_nominal(structure: FreeRobot, values: Array) -> FreeRobot:
    """Make the given compliances of a structure its nominal ones."""
    chain = replace(structure.chain, compliance=structure.compliance(values))
    moved = tuple(replace(p, nominal=float(v)) for p, v in zip(structure.parameters, values, strict=True))
    return replace(structure, chain=chain, parameters=moved)
