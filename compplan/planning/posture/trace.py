"""From the stations to every waypoint: spin, extra axes and leans go over linearly, the configuration follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from compplan.planning.posture.follow import REACHED, reach_tip_and_axis
from compplan.planning.posture.lattice import Options, orient_tool
from compplan.planning.posture.motion import find_torn, least_strokes, steady_slide
from compplan.planning.posture.search import Line
from compplan.planning.posture.settings import PostureProblem
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import pose_error, refine_ik, solve_branches
from compplan.toolpath.toolpath import Toolpath

#: A waypoint of the same configuration lies this near to the straight line between its stations. [rad]
NEAR = 0.3
#: Width of the filter that takes out the steps of the grid. [stations]
SMOOTH = 1.5


@dataclass(frozen=True)
class PostureTrace:
    """How the robot stands at every waypoint, unloaded.

    Attributes:
        q: Joint positions. Shape (n, nq). [rad or m]
        rotation: Orientation of the TCP frame, z out of the tool. Shape (n, 3, 3).
        spin: Rotation about the tool axis, counted on through full turns. Shape (n,). [rad]
        lead: Shape (n,). [rad]
        lean: Shape (n,). [rad]
        missed: Whether the posture could not be followed from station to station. Shape (n,).

    """

    q: Array
    rotation: Array
    spin: Array
    lead: Array
    lean: Array
    missed: NDArray[np.bool_]


def trace_line(
    problem: PostureProblem, stations: NDArray[np.int_], options: Options, line: Line, *, smooth: bool
) -> PostureTrace:
    """Follow a line of the graph through stations (k,) at every waypoint.

    The rotation about the tool axis gives way, where it is free, if the line passes a singularity; `smooth` takes out
    the steps that the grid leaves in rotation and leans.
    """
    arm, nominal, q, most_step = problem.arm, problem.nominal, line.q, problem.settings.most_step
    rows, place = np.arange(len(nominal)), _measure(nominal)
    spin_at, lead_at, lean_at = (_take(v, line.option) for v in (options.spin, options.lead, options.lean))
    along = np.unwrap(spin_at)
    if smooth and len(stations) > 3:
        along, lead_at, lean_at = (_blur(v) for v in (along, lead_at, lean_at))
    spin, lead, lean = (_interpolate(place, stations, v) for v in (along, lead_at, lean_at))
    between = np.stack([_interpolate(place, stations, q[:, j]) for j in range(q.shape[1])], axis=1)
    for j, stroke in enumerate(least_strokes(arm.robot)):
        if stroke > 0 and j in arm.held:
            between[:, j] = np.clip(steady_slide(between[:, j], stroke), arm.robot.lower[j], arm.robot.upper[j])
    rotation = orient_tool(nominal, problem.tool_x, rows, spin, lead, lean)
    upright = rotation
    branches = solve_branches(arm, nominal.position, rotation, between[:, arm.held])
    away = branches - between[:, None]
    turn = np.where(arm.robot.prismatic, np.inf, 2 * np.pi)
    with np.errstate(invalid="ignore"):
        branches = branches - np.where(np.isfinite(turn), turn * np.round(away / (2 * np.pi)), 0.0)
    distance = np.nan_to_num(np.abs(branches - between[:, None]).max(axis=2), nan=np.inf)
    nearest = distance.argmin(axis=1)
    followed = branches[rows, nearest]
    lost = distance[rows, nearest] > NEAR
    if lost.any():
        followed[lost] = refine_ik(arm, between[lost], nominal.position[lost], rotation[lost])
        error = pose_error(arm.chain, followed[lost], nominal.position[lost], rotation[lost])
        lost[lost] = np.abs(error).max(axis=1) > REACHED
    torn = find_torn(followed, nominal, most_step)
    if problem.settings.free_spin and (lost | torn).any():
        stretch = _whole_stretches(lost | torn, stations)
        wanted = nominal.position[stretch], rotation[stretch]
        followed[stretch], reached = reach_tip_and_axis(arm, between[stretch], *wanted)
        lost[stretch] = ~reached
        torn = find_torn(followed, nominal, most_step)
        rotation = np.array(rotation)
        rotation[stretch] = locate_frames(arm.chain, followed[stretch]).tcp_rotation
        turned = np.swapaxes(upright[stretch], 1, 2) @ rotation[stretch]
        spin[stretch] -= np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    outside = ((followed < arm.robot.lower) | (followed > arm.robot.upper)).any(axis=1)
    return PostureTrace(followed, rotation, spin, lead, lean, lost | outside | torn)


def _whole_stretches(marked: NDArray[np.bool_], stations: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return all waypoints strictly between the stations around marked ones; marked stations take both sides."""
    chosen = np.zeros(len(marked), bool)
    for w in np.flatnonzero(marked):
        before = int(np.searchsorted(stations, w, side="left")) - 1
        after = int(np.searchsorted(stations, w, side="right"))
        low = stations[max(before, 0)] + (before >= 0)
        high = stations[min(after, len(stations) - 1)] - (after < len(stations))
        chosen[low : high + 1] = True
    return np.flatnonzero(chosen)


def _blur(values: Array) -> Array:
    """Blur along the stations by a Gaussian of SMOOTH stations; both ends go on as they are."""
    reach, n = round(4.0 * SMOOTH), len(values)
    weights = np.exp(-0.5 / SMOOTH**2 * np.arange(-reach, reach + 1) ** 2)
    weights = (weights / weights.sum())[reach:]
    wide = np.pad(values, reach, mode="edge")
    blurred = weights[0] * values
    for away in range(reach, 0, -1):
        blurred += weights[away] * (wide[reach - away : reach - away + n] + wide[reach + away : reach + away + n])
    return blurred


def _measure(nominal: Toolpath) -> Array:
    """Return how far along the path each waypoint lies: by length, and a little by number where there is none."""
    steps = np.maximum(nominal.steps, 1e-3 * max(float(nominal.steps.mean()), 1e-9))
    return np.r_[0.0, np.cumsum(steps)]


def _interpolate(place: Array, stations: NDArray[np.int_], values: Array) -> Array:
    """Interpolate between stations without overshoot and without kinks."""
    if len(stations) < 3:
        return np.interp(place, place[stations], values)
    return np.asarray(PchipInterpolator(place[stations], values)(place))


def _take(values: Array, choice: NDArray[np.int_]) -> Array:
    wide = np.broadcast_to(values, (len(choice), values.shape[1]))
    return wide[np.arange(len(choice)), choice]
