"""What a posture gains over the plain one, and what its joint travel costs in accuracy: gear error and lost motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.path.process import tool_axes
from compplan.posture.stance import choose_posture
from compplan.posture.start import Start
from compplan.posture.summary import cut_shares, summarise_costs
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames

#: Motion against the last one of less than this is no reversal. [rad or m]
STILL = 1e-6
#: Waypoints that are looked at.
LOOKED_AT = 400


def compare_postures(
    robot: Robot, chain: Chain, start: Start, tool_x: Array, *, gear: float, periods: float, lost: float
) -> tuple[dict[str, float], dict[str, float]] | None:
    """Measure the posture that was chosen and the plain one: one configuration, the tool's x where the job has it.

    Args:
        robot: The robot with its tool.
        chain: Its elastic chain.
        start: What the search chose.
        tool_x: Where x of the TCP points, base axes. Shape (3,).
        gear: As in `measure_travel_error`. [rad]
        periods: The same.
        lost: The same. [rad]

    Returns:
        Costs of both, or None where nothing was chosen or the plain one does not reach the whole path.

    """
    plain = plain_posture(robot, start, tool_x)
    if plain is None or start.stance is None or start.request is None:
        return None
    shares, both = cut_shares(start.nominal), []
    for q in (start.stance.q, plain):
        costs = summarise_costs(chain, robot, start.nominal, q, start.stance.settings, start.request.axes)
        error = measure_travel_error(chain, q, shares, robot.prismatic, gear=gear, periods=periods, lost=lost)
        both.append(costs | {"travel_error_rms_mm": 1e3 * error})
    return both[0], both[1]


def plain_posture(robot: Robot, start: Start, tool_x: Array) -> Array | None:
    """Return joint positions in one configuration, the tool's x where the job has it, or None. Shape (n, nq)."""
    try:
        posture = choose_posture(robot, start.nominal.position, tool_axes(start.nominal, tool_x))
    except InputError:
        return None
    return None if posture.missed.any() else posture.q


def measure_travel_error(
    chain: Chain, q: Array, shares: Array, slides: NDArray[np.bool_], *, gear: float, periods: float, lost: float
) -> float:
    """Measure what gears do to the tip while joints travel: root mean square over the cut. [m].

    A gear error of amplitude a and n periods a turn varies by a / sqrt(2) where the joint travels a period and more,
    by less in proportion below; lost motion b is off by b / 2 in a joint that turns back on the path. What a joint
    that stands still is off by is a constant that touching off takes away.

    Args:
        chain: The chain.
        q: Joint positions along the path. Shape (n, nq). [rad or m]
        shares: Share of the cut that each waypoint stands for, see `cut_shares`. Shape (n,).
        slides: Which joints slide; they are left out. Shape (nq,).
        gear: Amplitude of the gear error of turning joints. [rad]
        periods: Its periods a turn.
        lost: Lost motion of turning joints, full width. [rad]

    """
    steps = np.diff(q, axis=0)
    period = 2 * np.pi / periods
    span = np.abs(steps).sum(axis=0)
    back = (steps > STILL).any(axis=0) & (steps < -STILL).any(axis=0)
    error = np.hypot(gear / np.sqrt(2.0) * np.minimum(span / period, 1.0), 0.5 * lost * back)
    error[slides] = 0.0
    rows = np.flatnonzero(shares > 0)
    if not len(rows):
        return 0.0
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, LOOKED_AT).astype(int))]
    columns = joint_jacobian(chain, locate_frames(chain, q[rows]))[:, :3]
    square = np.einsum("nij,j->n", columns**2, error**2)
    weight = shares[rows] / shares[rows].sum()
    return float(np.sqrt((weight * square).sum()))
