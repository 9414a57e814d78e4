"""Rounded corners that are shorter than a run needs to come to rest: two runs, overlapped where they meet."""

from __future__ import annotations

import numpy as np

from compplan.planning.task import PlanTask
from compplan.planning.timing import INERTIA_WINDOWS
from compplan.robot import Array
from compplan.toolpath.corners import find_roundings, find_shares


def find_narrow(task: PlanTask, along: Array, start: int, end: int) -> list[tuple[int, int, int]]:
    """List first, middle and last waypoint of the roundings of a run that are shorter than its way from feed to rest.

    Waypoints count from the run's first.

    Args:
        task: The task.
        along: Programmed time at each waypoint of the run. Shape (k,). [s]
        start: First waypoint of the run.
        end: Its last waypoint.

    """
    window = task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
    found = []
    for first, last in find_roundings(task.nominal):
        first, last = first - start, last - start
        if first > 0 and last < end - start and last - first > 1 and along[last] - along[first] < window:
            middle = int(np.searchsorted(along, 0.5 * (along[first] + along[last])))
            found.append((first, min(max(middle, first + 1), last - 1), last))
    return found


def overlap_legs(time: Array, position: Array, feed: Array, spans: list[tuple[int, int, int]]) -> Array:
    """Let runs that end and begin in the middles of roundings overlap, u of the rounding even in time.

    A run that is smoothed comes to rest as the fourth power of time: one that is r before it rests d later, and goes
    on at 4 r / d, which is 4 a / g with g the rate dt/du of the rounding: g = a d / r. Where the run is slower or slows
    down later than that, g = 4 a / v keeps the speed v of the move that leads to the rounding, or away from it. The
    rounding takes longer by what keeps the programmed feed.

    Args:
        time: Time at each waypoint with rests in the middles. Shape (k,). [s]
        position: Shape (k, 3). [m]
        feed: Programmed feed to each waypoint. Shape (k,). [m/s]
        spans: First, middle and last waypoint of each rounding.

    """
    step = np.diff(time)
    for first, middle, last in spans:
        u, share = find_shares(position[first : last + 1])
        steps = np.linalg.norm(np.diff(position[first : last + 1], axis=0), axis=1)
        reach, before = share * steps.sum(), steps[: middle - first].sum()
        ways = np.linalg.norm(position[[first, last + 1]] - position[[first - 1, last]], axis=1)
        slowness = 4.0 * (time[[first, last + 1]] - time[[first - 1, last]]) / np.maximum(ways, 1e-9)
        rests = (time[middle] - time[first]) / before, (time[last] - time[middle]) / (steps.sum() - before)
        rate, end = (reach * np.maximum(rests, slowness)).tolist()
        change = end - rate
        taken = np.diff(rate * u + 0.5 * change * u**2)
        wanted = feed[first + 1 : last + 1]
        least = np.divide(steps, wanted, out=np.zeros(len(steps)), where=wanted > 0.0)
        step[first:last] = taken * max(float((least / taken).max()), 1.0)
    return np.r_[0.0, np.cumsum(step)]
