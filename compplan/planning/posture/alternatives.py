"""What a posture gains over the plain one, and what its joint travel costs in accuracy."""

from __future__ import annotations

from compplan.errors import InputError
from compplan.planning.posture.configuration import choose_posture
from compplan.planning.posture.initial_branches import Start
from compplan.planning.posture.summary import summarise_costs
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain
from compplan.toolpath.contact import tool_axes


def compare_postures(
    robot: Robot, chain: Chain, start: Start, tool_x: Array
) -> tuple[dict[str, float], dict[str, float]] | None:
    """Measure the posture that the graph found and the plain one: one configuration, the tool's x where the job has it.

    Args:
        robot: The robot with its tool.
        chain: Its elastic chain.
        start: What the search chose.
        tool_x: Where x of the TCP points, base axes. Shape (3,).

    Returns:
        Costs of the graph's way and of the plain one, or None where nothing was chosen or the plain one does not reach
        the whole path.

    """
    if start.stance is not None and start.stance.plain is not None:
        return start.stance.instead_of or start.stance.costs, start.stance.plain
    plain = plain_posture(robot, start, tool_x)
    if plain is None or start.stance is None or start.request is None:
        return None
    settings, axes = start.stance.settings, start.request.axes
    return start.stance.costs, summarise_costs(chain, robot, start.nominal, plain, settings, axes)


def plain_posture(robot: Robot, start: Start, tool_x: Array) -> Array | None:
    """Return joint positions in one configuration, the tool's x where the job has it, or None. Shape (n, nq)."""
    try:
        posture = choose_posture(robot, start.nominal.position, tool_axes(start.nominal, tool_x))
    except InputError:
        return None
    return None if posture.missed.any() else posture.q
