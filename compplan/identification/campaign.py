"""Identify a robot from a measurement log: frames, geometry if it improves held-out poses, compliances, gap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compplan.identification.estimate import Estimate
from compplan.identification.problem import (
    IdentifyOptions,
    IdentifyProblem,
    check_options,
    choose_geometry,
    choose_reference,
    place_frames,
    screen_outliers,
    select_springs,
)
from compplan.identification.update import IdentifiedGap, identified_uncertainty, measure_gap, update_robot
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.rows import Rows, take_rows
from compplan.measurement.registration import Registration
from compplan.robot import Robot
from compplan.uncertainty.assumed import restore_prior


@dataclass(frozen=True)
class Identification:
    """Robot parameters identified from a measurement log, with their uncertainty."""

    robot: Robot  #: The updated robot.
    nominal: Robot  #: The robot before.
    estimate: Estimate  #: Fit of every parameter considered, candidates included, and the inseparable parameters.
    kept: Estimate  #: Fit in the updated robot: selected candidates, no compliance below zero.
    geometry: str  #: Fitted geometry: "none", "offsets" or "all".
    gap: IdentifiedGap  #: Distance between model and measurements, before and after.
    rows: Rows  #: Rows used, without outliers, and their reference.
    outliers: tuple[int, ...]  #: Rows of the log classified as gross outliers, counted from 0.
    notes: tuple[str, ...]  #: Notes for the report.

    @property
    def registration(self) -> Registration:
        """Frames of the campaign."""
        return self.kept.registration


def identify_campaign(
    robot: Robot, campaign: Campaign, options: IdentifyOptions | None = None, *,
    progress: Callable[[str], None] = lambda text: None,
) -> Identification:  # fmt: skip
    """Identify a robot from a campaign; an exception raised in `progress` ends the call.

    Frames are fitted first (to unloaded poses if there are enough), then together with all other parameters, so that
    the intervals include the uncertainty of the frames. Geometry enters if it improves held-out poses; a spring absent
    from the robot enters if its 95 % interval lies above zero. Effects of the robot folder are held.

    Raises:
        InputError: If the log has too few rows, or an option names something that does not exist.
    """
    progress("frames and outliers")
    chosen = IdentifyOptions() if options is None else options
    check_options(chosen)
    frames = place_frames(robot, campaign, chosen.register)
    rows, notes = take_rows(campaign, frames, chosen.loss)
    if rows.encoder is not None or len(set(rows.taken.link_controlled.tolist())) > 1:
        chosen = replace(chosen, link_side=True)
    screened, outliers, outlier_notes = screen_outliers(IdentifyProblem(robot, chosen, rows))
    progress("geometry")
    problem, more = choose_reference(choose_geometry(screened))
    progress(f"compliances, geometry {problem.geometry}")
    structure = problem.structure()
    estimate = problem.fit(structure)
    kept = select_springs(problem, structure, estimate)
    source = f"identified from {campaign.file.name if campaign.file else 'measurements'}, {len(rows)} rows"
    progress("held-out poses")
    updated = update_robot(robot, kept, source=source)
    gap = measure_gap(replace(problem.rows, registration=frames), structure, kept)
    sigma = float(np.median(rows.deviation[:, 0]))
    uncertainty = identified_uncertainty(updated, kept, gap, difference=problem.difference, sigma=sigma, source=source)
    uncertainty = restore_prior(robot, uncertainty, free_base="base" in chosen.register or campaign.free_base)
    notes += [*outlier_notes, *more]
    if kept.clustered:
        notes.append(
            "residuals of neighbouring poses agree, so something systematic is left that the model lacks: intervals are"
            " widened from groups of poses, but a bias may exceed them; compplan diagnose looks for the reason"
        )
    return Identification(
        robot=replace(updated, uncertainty=uncertainty),
        nominal=robot,
        estimate=estimate,
        kept=kept,
        geometry=problem.geometry,
        gap=gap,
        rows=problem.rows,
        outliers=outliers,
        notes=tuple(notes),
    )
