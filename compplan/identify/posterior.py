"""Posterior: how surely an identified robot is known, as its folder's uncertainty.toml says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from compplan.effects.scene import own_springs
from compplan.identify.estimate import Estimate
from compplan.identify.gap import IdentifiedGap
from compplan.identify.parameters import FreeRobot, Parameter
from compplan.known.assumed import assume_geometry
from compplan.robot import Array, Joint, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, spread_unknowns

#: A stiffness that was not identified keeps this relative width of the value that the folder holds (assumed).
HELD = 0.3


def identified_uncertainty(
    robot: Robot, kept: Estimate, gap: IdentifiedGap, *, difference: bool, sigma: float, source: str
) -> Uncertainty:
    """State how surely an identified robot is known.

    Compliances and geometry keep the covariance of the fit, the frames fitted along. What held-out poses leave beyond
    the instrument is unexplained; under differences of one pose it is that of the deflections.

    Args:
        robot: The updated robot.
        kept: Fit that it holds.
        gap: How far the model lies from held-out measurements.
        difference: Whether poses were compared with themselves under other loads.
        sigma: Standard deviation of the position measurement per axis. [m]
        source: What was measured.
    """
    picked: list[int] = []
    unknowns: list[Unknown] = []
    for number, parameter in enumerate(kept.structure.parameters):
        unknown = _name(kept.structure, parameter)
        if unknown is not None and kept.free[number]:
            picked.append(number)
            unknowns.append(unknown)
    named, factor = spread_unknowns(unknowns, kept.covariance[np.ix_(picked, picked)])
    held = _held_springs(robot, named)
    if difference:
        # differences of one pose under several loads tell nothing of zeros and lengths
        held += assume_geometry(robot)
    root = np.eye(len(named) + len(held))
    root[: len(named), : len(named)] = factor
    left = gap.under_load_after if difference and gap.under_load_after is not None else gap.held_out_after
    noise = 3.0 * sigma**2 * (2.0 if difference else 1.0)
    return Uncertainty(
        grade="measured",
        source=f"{source}; zeros and lengths assumed" if difference else source,
        unknowns=(*named, *held),
        factor=root,
        unexplained=float(np.sqrt(max(left**2 - noise, 0.0))) if np.isfinite(left) else 0.0,
        repeatability=robot.repeatability,
    )


def _name(structure: FreeRobot, parameter: Parameter) -> Unknown | None:
    """Return the unknown of the vocabulary that a parameter is, without its size; None where there is none."""
    joints = {joint.name: joint for joint in structure.robot.joints}
    springs = dict(zip(structure.spring_labels, structure.robot.springs, strict=True))
    nothing = np.zeros(1)
    if parameter.kind in ("joint", "spring") and (spring := springs.get(parameter.name)) is not None:
        slides = parameter.unit == "m/N"
        if parameter.kind == "joint":
            key = "compliance_change_m_per_N" if slides else "compliance_change_rad_per_Nm"
            return Unknown("joint_stiffness", spring.joint, None, (key,), nothing)
        if spring.axis == "own":
            return None
        key = "compliance_m_per_N" if slides else "compliance_rad_per_Nm"
        return Unknown("link_compliance", spring.joint, spring.axis, (key,), nothing)
    if parameter.kind == "geometry":
        return _name_geometry(parameter, joints, structure.robot)
    return None


def _name_geometry(parameter: Parameter, joints: Mapping[str, Joint], robot: Robot) -> Unknown | None:
    nothing = np.zeros(1)
    before, _, rest = parameter.name.partition(".")
    if rest == "offset":
        return Unknown("joint_offset", before, None, ("offset_m" if parameter.unit == "m" else "offset_rad",), nothing)
    axis = rest.rpartition(".")[2]
    order = [joint.name for joint in robot.joints]
    if before not in joints or order.index(before) + 1 >= len(order):
        return None
    after = order[order.index(before) + 1]
    return Unknown("link_geometry", after, axis, (f"{axis}_{'m' if axis[0] == 't' else 'rad'}",), nothing)


def _held_springs(robot: Robot, named: Sequence[Unknown]) -> list[Unknown]:
    """List the joints' own springs that the campaign could not tell, with an assumed width."""
    told = {unknown.joint for unknown in named if unknown.effect == "joint_stiffness"}
    found = []
    for index, spring in own_springs(robot).items():
        joint = robot.actuated[index]
        if joint.name not in told and spring.compliance > 0:
            key = "compliance_change_m_per_N" if joint.kind == "prismatic" else "compliance_change_rad_per_Nm"
            width: Array = np.array([HELD * spring.compliance])
            found.append(Unknown("joint_stiffness", joint.name, None, (key,), width))
    return found
