"""The plain posture: one configuration, the tool's x where the job has it, extra axes where the arm stands best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.planning.posture.configuration import Preference, choose_posture
from compplan.planning.posture.summary import PostureSummary, summarise_costs
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath

#: Waypoints of a finished line whose margin is looked at.
MARGIN_SAMPLES = 600


def solve_default_posture(
    robot: Robot, nominal: Toolpath, tool_x: Array, stance: PostureSummary, axes: Array,
    margin: Callable[[Array, NDArray[np.int_]], Array] | None,
) -> PostureSummary | None:  # fmt: skip
    """Return the plain posture; None where it is not reached or does not keep clear.

    Args:
        robot: The robot with its tool.
        nominal: Toolpath in the base frame, with its predicted wrench.
        tool_x: Where x of the TCP points, base axes. Shape (3,).
        stance: What the graph chose, with its settings.
        axes: Axes in whose components the wrench errs, as columns. Shape (3, 3).
        margin: By how much joint positions at waypoints keep clear, or None. [m]

    """
    settings, rotation = stance.settings, tool_axes(nominal, tool_x)
    start = None if settings.start is None else np.array(settings.start)
    try:
        plain = choose_posture(robot, nominal.position, rotation, Preference(**settings.configuration, start=start))
    except InputError:
        return None
    if plain.missed.any():
        return None
    rows = np.unique(np.linspace(0, len(nominal) - 1, min(len(nominal), MARGIN_SAMPLES)).astype(int))
    if margin is not None and (margin(plain.q[rows], rows) < 0).any():
        return None
    none = np.zeros(len(nominal))
    return replace(
        stance, q=plain.q, rotation=rotation, spin=none, lead=none, lean=none, configuration=plain.configuration,
        changes=(), map=replace(stance.map, chosen=np.zeros(len(stance.map.chosen))), instead_of=stance.costs,
        costs=summarise_costs(build_chain(robot), robot, nominal, plain.q, settings, axes),
    )  # fmt: skip
