"""Put what was identified into a robot: springs, links and geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects.folding import shift_origin, shift_zero
from compplan.identify.estimate import Estimate
from compplan.identify.parameters import AXES, FreeRobot
from compplan.robot import Array, LinkElasticity, Robot, Spring


def update_robot(robot: Robot, estimate: Estimate, *, source: str) -> tuple[Robot, tuple[str, ...]]:
    """Return a robot that holds the identified values.

    A compliance below zero cannot be built: it is written as zero (a link's 6x6 as the nearest one without a negative
    eigenvalue), and said so.

    Args:
        robot: The nominal robot.
        estimate: The fit.
        source: Where the numbers come from, for `sources`.

    Returns:
        The robot, and a sentence for each value that could not be written as identified.
    """
    structure, values = estimate.structure, estimate.model_values
    notes: list[str] = []
    named = dict(zip(structure.names, values, strict=True))
    springs: list[Spring] = []
    for spring, name in zip(structure.robot.springs, structure.spring_labels, strict=True):
        value = float(named.get(name, spring.compliance))
        if value < 0:
            notes.append(f"{name} came out negative ({value:.3g}), which no spring can be; it is written as rigid")
        if name and (value > 0 or any(spring is own for own in robot.springs)):
            springs.append(replace(spring, compliance=max(value, 0.0)))
    links = list(robot.link_elasticities)
    if any(parameter.kind == "link" for parameter in structure.parameters):
        links, more = _update_links(structure, values)
        notes += more
    moved = _update_geometry(robot, named)
    sources = {**robot.sources, "compliance": source}
    if any(parameter.kind == "geometry" for parameter in structure.parameters):
        sources["geometry"] = f"{robot.sources.get('geometry', 'URDF')}; corrected: {source}"
    updated = replace(
        moved,
        springs=tuple(springs),
        link_elasticities=tuple(links),
        sources=sources,
        grade="identified",
    )
    return updated, tuple(notes)


def _update_links(structure: FreeRobot, values: Array) -> tuple[list[LinkElasticity], list[str]]:
    matrix, links, notes = structure.compliance(values), [], []
    for block, first in zip(structure.robot.link_elasticities, structure.link_coordinates, strict=True):
        own = matrix[first : first + 6, first : first + 6]
        value, vector = np.linalg.eigh(_scaled(own))
        if value[0] < -1e-12:
            own = _scaled((vector * np.maximum(value, 0.0)) @ vector.T, back=True)
            notes.append(f"the 6x6 of {block.link} came out with a negative eigenvalue; it is written without")
        links.append(replace(block, compliance=0.5 * (own + own.T)))
    return links, notes


def _scaled(matrix: Array, *, back: bool = False) -> Array:
    """Scale m/N, rad/N and rad/(N m) to comparable sizes (metre against 0.1 rad), or back."""
    scale = np.r_[np.full(3, 10.0), np.ones(3)]
    return matrix / np.outer(scale, scale) if back else matrix * np.outer(scale, scale)


def _update_geometry(robot: Robot, values: Mapping[str, float]) -> Robot:
    """Put joint zeros and changes of origin into the placements of the joints.

    The elements of an origin act as Tx Ty Tz Rx Ry Rz at the old origin, in the axes of the link before.
    """
    for before, joint in zip((None, *robot.joints), robot.joints, strict=False):
        if before is not None:
            step = np.array([values.get(f"{before.name}.end.{axis}", 0.0) for axis in AXES])
            if step.any():
                step[3:] = Rotation.from_euler("XYZ", step[3:]).as_rotvec()
                robot = shift_origin(robot, joint.name, step)
        if values.get(f"{joint.name}.offset"):
            robot = shift_zero(robot, joint.name, values[f"{joint.name}.offset"])
    return robot
