"""Traces: the error that a named joint makes at every row, against what it follows.

What the rest of the diagnosis explains is taken out first, so that a soft spring shows as a line over load, lost motion
as two levels, a gear error as a wave over the joint's angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compplan.effects import driver_of
from compplan.effects.linearization import Linearization
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.verdict import Finding

#: Rows whose point lies nearer to the joint's axis than this share of the usual distance tell nothing about it
#: (assumed).
NEAR_AXIS = 0.25


@dataclass(frozen=True, eq=False)
class Trace:
    """The error of one joint over the rows that show it; k rows.

    Attributes:
        place: The joint.
        effect: The effect that stays in.
        driver: What the error is drawn over. Shape (k,). [`driver_unit`]
        error: Error that the joint makes. Shape (k,). [`error_unit`]
        driver_name: What the driver is.
        driver_unit: Its unit.
        error_unit: "mrad" or "mm".
    """

    place: str
    effect: str
    driver: Array
    error: Array
    driver_name: str
    driver_unit: str
    error_unit: str

    @property
    def two_sided(self) -> bool:
        """Tell whether the driver is a direction: minus, unknown, plus."""
        return self.driver_name == "direction of the last move"


def trace_findings(diagnosis: Diagnosis) -> tuple[Trace, ...]:
    """Trace the errors of the joints that a diagnosis names."""
    doubt, at = diagnosis.doubt, diagnosis.fit.at
    equations, values = doubt.search.equations, doubt.model.posterior.values(doubt.search.equations.p)
    source = equations.source[0]
    left = equations.left(values)[0] * source.sigma
    traces = []
    for finding in diagnosis.verdict.findings:
        if finding.signature not in doubt.model.signatures or finding.effect.joint not in at.robot.joint_names:
            continue
        columns = equations.columns(finding.signature)
        part = left + equations.designs[0][..., columns] @ values[columns] * source.sigma
        traces.append(_trace(finding, at, source.rows, part))
    return tuple(traces)


def _trace(finding: Finding, at: Linearization, rows: NDArray[np.int_], part: Array) -> Trace:
    """Turn what a finding has to explain into an error about the joint's own axis."""
    joint = str(finding.effect.joint)
    index = at.robot.joint_names.index(joint)
    slides = bool(at.robot.prismatic[index])
    own = at.motion[rows][:, :3, index]
    square = (own**2).sum(axis=1)
    seen = square > NEAR_AXIS**2 * square.mean()
    error = 1e3 * (own * part).sum(axis=1) / np.maximum(square, 1e-300)
    driver, name, unit = _driver(finding.effect.name, at, index, slides)
    return Trace(joint, finding.effect.name, driver[rows][seen], error[seen], name, unit, "mm" if slides else "mrad")


def _driver(effect: str, at: Linearization, index: int, slides: bool) -> tuple[Array, str, str]:
    """Return what stands on the horizontal axis, its name and its unit."""
    follows, campaign = driver_of(effect), at.campaign
    if follows in ("load", "gravity"):
        return at.own_load[:, index], "load about the joint's axis", "N" if slides else "N m"
    if follows == "direction of approach":
        return campaign.approach[:, index], "direction of the last move", ""
    if follows == "speed":
        return campaign.speed[:, index], "joint speed", "m/s" if slides else "rad/s"
    return campaign.q[:, index] * (1e3 if slides else 180 / np.pi), "joint position", "mm" if slides else "deg"
