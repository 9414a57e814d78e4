"""Representable part of a model update in the files of a robot folder, and the residual file of a path.

URDF and springs represent some parameters, effects others; the remainder is part of the residual of the path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from compplan.effects import Effect, fold_effect
from compplan.effects.backlash import width_of
from compplan.effects.checks import check_effect
from compplan.effects.signature import pack_parameters
from compplan.errors import CompplanError
from compplan.io.columns import FileColumn
from compplan.io.tables import read_table
from compplan.job.job import Job
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns
from compplan.toolpath.toolpath import interpolate
from compplan.uncertainty.assumed import LINK_ELASTICITY
from compplan.uncertainty.sensitivities import vary_robot

#: Effects that consist of one spring.
SPRINGS = ("joint_stiffness", "link_compliance", "base_compliance")
#: Prefixes of the additive parameters of effects with the same place and form.
ADDS = {"backlash": ("width",), "transmission_error": ("sine", "cosine", "height", "spline")}


class Learned(NamedTuple):
    """A parameter updated by a part."""

    name: str  #: Readable name.
    key: str  #: Key, with the unit as its suffix.
    value: float  #: Change. [SI]
    width: float  #: Prior standard deviation. [SI]
    kept: bool  #: Whether the robot folder represents the change to within 10 %.


def apply_update(
    robot: Robot, known: Uncertainty, values: Array, covariance: Array, *, own_tool: bool = True
) -> tuple[Robot, Array]:
    """Apply a model update to a robot folder; also return the represented part of each value. Shape (p,). [SI]

    Values that URDF and springs cannot represent become effects of the folder. A remainder m (the tool of a job, a
    negative compliance) stays with the path and adds m m^T to the covariance. values: means relative to the folder,
    (p,), ordered as `known`; covariance: (p, p); own_tool: whether the tool belongs to the folder, not to the job.
    """
    held: list[Array] = []
    for unknown, own in split_unknowns(known.unknowns, values):
        holds_tool = own_tool or unknown.effect != "tool_frame"
        robot, part = fit_representable(robot, unknown, own) if holds_tool else (robot, np.zeros(len(own)))
        held.append(part)
    holds = np.concatenate(held) if held else np.zeros(0)
    missing = values - holds
    after = known.with_covariance(covariance + np.outer(missing, missing))
    folder = after.select(own_tool or u.effect != "tool_frame" for u in after.unknowns)
    return replace(robot, uncertainty=replace(folder, grade=known.grade)), holds


def fit_representable(robot: Robot, unknown: Unknown, own: Array) -> tuple[Robot, Array]:
    """Apply values of one unknown to a robot folder; also return the represented part. own: values, (k,). [SI]

    Compliances are not negative: a change below zero is represented down to zero compliance.
    """
    if unknown.effect == LINK_ELASTICITY:
        return vary_robot(robot, unknown, own)[0], own
    joints = {joint.name for joint in robot.joints}
    if unknown.joint is not None and unknown.joint not in joints:
        return robot, np.zeros(len(own))
    effect = Effect(unknown.effect, unknown.joint, unknown.axis, pack_parameters(unknown.keys, own, unknown.fixed))
    folded = fold_effect(robot, effect)
    if folded is None:
        return add_effect(robot, effect, own)
    if unknown.effect in SPRINGS:
        own = np.array([_sum_springs(folded) - _sum_springs(robot)])
    return folded, own


def add_effect(robot: Robot, effect: Effect, own: Array) -> tuple[Robot, Array]:
    """Add an effect to a robot folder; merge it with an effect of the same kind and place if there is one.

    own: its unknown values [SI]. Returns the robot and the represented part of the values: zero if the effect file
    cannot represent them.
    """
    if effect.name == "backlash":  # lost motion is not negative
        same = [one for one in robot.effects if (one["effect"], one.get("joint")) == (effect.name, effect.joint)]
        own = np.maximum(own, -max(sum(map(width_of, same)), 0.0))
        effect = replace(effect, parameters={key: float(own[0]) for key in effect.parameters})
    if not np.any(own):
        return robot, own
    table, tables = effect.to_table(), [dict(one) for one in robot.effects]
    for number, one in enumerate(tables):
        if (merged := _merge(one, table)) is not None:
            tables[number] = merged
            break
    else:
        tables.append(table)
    try:
        check_effect(table, robot, None, "effect")
    except CompplanError:
        return robot, np.zeros(len(own))
    return replace(robot, effects=tuple(tables)), own


def _merge(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any] | None:
    """Add the additive parameters of two effect tables; None if kind, place or form differ."""
    if any(one.get(key) != other.get(key) for key in ("effect", "joint", "axis")):
        return None
    old, new = one["parameters"], other["parameters"]
    sizes = ADDS.get(str(one["effect"]), ())
    if not sizes or set(old) != set(new) or any(old[key] != new[key] for key in old if not key.startswith(sizes)):
        return None
    summed: dict[str, Any] = {}
    for key in old:
        if not key.startswith(sizes):
            summed[key] = old[key]
        elif isinstance(old[key], list):
            summed[key] = [a + b for a, b in zip(old[key], new[key], strict=True)]
        else:
            summed[key] = old[key] + new[key]
    return {**one, "parameters": summed}


def _sum_springs(robot: Robot) -> float:
    return float(sum(spring.compliance for spring in robot.springs))


def list_learned(known: Uncertainty, values: Array, held: Array, most: int = 10) -> list[Learned]:
    """List the parameters with the greatest changes relative to their prior standard deviations."""
    kept = np.abs(values - held) <= 0.1 * np.abs(values)
    width = known.width
    share = np.abs(values) / np.maximum(width, 1e-300)
    names, keys = known.names, [key for unknown in known.unknowns for key in unknown.keys]
    return [
        Learned(names[k], keys[k], float(values[k]), float(width[k]), bool(kept[k])) for k in np.argsort(-share)[:most]
    ]


@dataclass(frozen=True, eq=False)
class Residual:
    """Deviation of a path beyond the robot model, subtracted by the next program; b places along the path."""

    length: Array  #: Arc length along the path. Shape (b,). [m]
    deviation: Array  #: Deviation, base axes. Shape (b, 3). [m]
    q: Array  #: Joint positions, unloaded on the path. Shape (b, nq). [rad or m]

    def at(self, length: Array) -> Array:
        """Interpolate the deviation at arc lengths (n,) [m]. Shape (n, 3). [m]."""
        return interpolate(length, self.length, self.deviation)


def residual_file(robot: Robot, job: Job) -> Path | None:
    """Return the file of a robot folder with the residual of the path of a job; None for a robot without a folder."""
    return None if robot.folder is None else robot.folder / f"learned_{job.file.stem}.csv"


def read_residual(file: Path | None, robot: Robot) -> Residual | None:
    """Read the residual of a path; None if the file does not exist.

    Raises:
        InputError: If the file is not a residual table.
    """
    if file is None or not file.exists():
        return None
    columns = [FileColumn(name, "length", required=True) for name in ("s", "dx", "dy", "dz")]
    for number, slides in enumerate(robot.prismatic, 1):
        columns.append(FileColumn(f"q{number}", "length" if slides else "angle", required=True))
    table = read_table(file, columns)
    length = table.values["s"]
    if not len(length) or (np.diff(length) < 0).any():
        raise table.error("s_mm must rise from row to row, with at least one row")
    joints = table.stack([f"q{number}" for number in range(1, robot.nq + 1)])
    return Residual(length, table.stack(["dx", "dy", "dz"]), joints)
