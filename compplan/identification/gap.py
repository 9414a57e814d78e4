"""How far the model lies from the measurements, before and after, on rows it was fitted to and on rows it never saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.effects import fold_effects
from compplan.identification.estimate import Estimate, fit_rows, leave_poses_out
from compplan.identification.parameters import FreeRobot
from compplan.measurement.fit.heldout import distance_rms
from compplan.measurement.fit.rows import Rows


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


def measure_gap(rows: Rows, structure: FreeRobot, kept: Estimate) -> IdentifiedGap:
    """Measure the gap of the nominal and the identified robot, in absolute poses whatever the rows' reference.

    Args:
        rows: The rows, under the reference of the fit, with all frames to be fitted.
        structure: Structure that holds the nominal robot.
        kept: Fit that the updated robot holds.
    """
    absolute, compared = replace(rows, reference="absolute"), replace(rows, reference="difference")
    everywhere, group = np.ones(len(rows), bool), rows.alike
    bare = fit_rows(structure.select([]), absolute)
    shown = kept
    if rows.reference == "difference":
        moved = fold_effects(kept.structure.soften(kept.model_values), kept.structure.effects(kept.model_values))
        shown = fit_rows(replace(kept.structure, robot=moved, parameters=()), absolute)
    several = len(np.unique(group)) < 0.7 * len(group) and np.abs(rows.taken.wrench).max(initial=0.0) > 0

    def held_out(estimate: Estimate, own: Rows = absolute) -> float:
        free = estimate.free.copy()
        if own is compared:
            # Frames and geometry do not show in differences of one pose.
            free &= np.array([p.kind in ("joint", "spring", "link") for p in estimate.parameters], bool)
        return distance_rms(leave_poses_out(own, replace(estimate, weights=kept.weights), free).residual, everywhere)

    return IdentifiedGap(
        before=distance_rms(bare.residuals, everywhere),
        after=distance_rms(shown.residuals, everywhere),
        held_out_before=held_out(bare),
        held_out_after=held_out(shown),
        under_load_before=held_out(bare, compared) if several else None,
        under_load_after=held_out(kept, compared) if several else None,
    )
