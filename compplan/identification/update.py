"""Update a robot with identified springs, links and effects, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.effects import fold_effects, is_of_instrument
from compplan.identification.estimate import Estimate, fit_rows, leave_poses_out
from compplan.identification.parameters import FreeRobot
from compplan.measurement.fit.intervals import distance_rms
from compplan.measurement.fit.rows import Rows
from compplan.robot import Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, spread_unknowns
from compplan.uncertainty.assumed import assume_geometry


def update_robot(robot: Robot, estimate: Estimate, *, source: str) -> Robot:
    """Return the robot with the identified values; added springs without positive compliance are omitted."""
    structure, values = estimate.structure, estimate.model_values
    soft = structure.set_compliances(values)
    springs = tuple(
        spring for spring, old in zip(soft.springs, structure.robot.springs, strict=True)
        if spring.compliance > 0.0 or any(old is present for present in robot.springs)
    )  # fmt: skip
    sources = {**robot.sources, "compliance": source}
    if any(parameter.kind == "geometry" for parameter in structure.parameters):
        sources["geometry"] = f"{robot.sources.get('geometry', 'URDF')}; corrected: {source}"
    grown = replace(robot, springs=springs, sources=sources, grade="identified")
    return fold_effects(grown, structure.effects(values))


def identified_uncertainty(
    robot: Robot, kept: Estimate, gap: IdentifiedGap, *, difference: bool, sigma: float, source: str
) -> Uncertainty:
    """Compute the uncertainty of an identified robot; `sigma`: of the position measurement per axis. [m]

    Compliances and effects have the covariance of the fit that includes the frames. The held-out error beyond the
    instrument's noise is unexplained; with reference "difference" it is that of the deflections.
    """
    unknowns, picked = _name_unknowns(kept.structure, kept)
    named, factor = spread_unknowns(unknowns, kept.covariance[np.ix_(picked, picked)])
    # differences of one pose under several loads contain no information on zeros and lengths
    held = assume_geometry(robot) if difference else []
    root = np.eye(len(factor) + sum(len(unknown.keys) for unknown in held))
    root[: len(factor), : len(factor)] = factor
    left = gap.under_load_after if difference and gap.under_load_after is not None else gap.held_out_after
    return Uncertainty(
        grade="measured",
        source=f"{source}; zeros and lengths assumed" if difference else source,
        unknowns=(*named, *held),
        factor=root,
        unexplained=find_unexplained(left, sigma, difference=difference) if np.isfinite(left) else 0.0,
        repeatability=robot.repeatability,
    )


def find_unexplained(left: float, sigma: float, *, difference: bool) -> float:
    """Return the part of a root mean square distance (3D) that exceeds an instrument's sigma per axis. [m].

    A difference of two measurements has twice the noise variance.
    """
    return float(np.sqrt(max(left**2 - 3.0 * sigma**2 * (2.0 if difference else 1.0), 0.0)))


def _name_unknowns(structure: FreeRobot, kept: Estimate) -> tuple[list[Unknown], list[int]]:
    """Convert the free parameters to unknowns without sizes; also return their indices."""
    found: list[Unknown] = []
    picked: list[int] = []
    for number, parameter in enumerate(structure.parameters):
        nothing = np.zeros(1)
        if parameter.spring >= 0 and kept.free[number]:
            spring, unit = structure.robot.springs[parameter.spring], parameter.unit.replace("/", "_per_")
            key = f"compliance_change_{unit}" if parameter.kind == "joint" else f"compliance_{unit}"
            key = key.replace("(N m)", "Nm")
            if parameter.kind == "joint":
                found.append(Unknown("joint_stiffness", spring.joint, None, (key,), nothing))
            elif spring.axis != "own":
                found.append(Unknown("link_compliance", spring.joint, spring.axis, (key,), nothing))
            else:
                continue
            picked.append(number)
        form = parameter.form
        if form is None or parameter.item > 0 or is_of_instrument(form.name):
            continue
        indices = {p.item: k for k, p in enumerate(structure.parameters) if p.form is form}
        if len(indices) == len(form.keys) and any(kept.free[k] for k in indices.values()):
            found.append(Unknown(form.name, form.joint, form.axis, form.keys, np.zeros(len(indices)), form.fixed))
            picked += [indices[item] for item in range(len(indices))]
    return found, picked


@dataclass(frozen=True)
class IdentifiedGap:
    """Rms of the 3D distance over the rows that are not outliers. [m]"""

    before: float  #: Nominal robot, frames fitted.
    after: float  #: Identified robot.
    held_out_before: float  #: Nominal robot; frames fitted to the other blocks.
    held_out_after: float  #: Identified robot; models fitted to the other blocks.
    #: Deflection of a pose under its loads, nominal; None if no pose has several loads.
    under_load_before: float | None
    under_load_after: float | None  #: The same for the identified robot, held out.


def measure_gap(rows: Rows, structure: FreeRobot, kept: Estimate) -> IdentifiedGap:
    """Compute the gap of the nominal and the identified robot, in absolute poses for every reference of the rows."""
    absolute, compared = replace(rows, reference="absolute"), replace(rows, reference="difference")
    everywhere, group = np.ones(len(rows), bool), rows.alike
    bare = fit_rows(structure.select([]), absolute)
    shown, fitted = kept, kept.structure
    if rows.reference == "difference":
        moved = fold_effects(fitted.set_compliances(kept.model_values), fitted.effects(kept.model_values))
        shown = fit_rows(replace(fitted, robot=moved, parameters=()), absolute)
    several = len(np.unique(group)) < 0.7 * len(group) and np.abs(rows.taken.wrench).max(initial=0.0) > 0

    def held_out(estimate: Estimate, used: Rows = absolute) -> float:
        free = estimate.free.copy()
        if used is compared:
            # Frames and geometry cancel in differences of one pose.
            free &= np.array([p.kind in ("joint", "spring") for p in estimate.parameters], bool)
        return distance_rms(leave_poses_out(used, replace(estimate, weights=kept.weights), free).residual, everywhere)

    return IdentifiedGap(
        before=distance_rms(bare.residuals, everywhere),
        after=distance_rms(shown.residuals, everywhere),
        held_out_before=held_out(bare),
        held_out_after=held_out(shown),
        under_load_before=held_out(bare, compared) if several else None,
        under_load_after=held_out(kept, compared) if several else None,
    )
