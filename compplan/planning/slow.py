"""Where a run is slower than it is programmed, and why: corners, joint limits, corrections that the joints follow."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import PlanTask
from compplan.planning.timing import Timing
from compplan.robot import Array

#: Times of smoothing around a rest in which the tool gains its speed, and around a limit to which that reaches.
FROM_REST, FROM_LIMIT = 3.0, 1.0
#: A run that keeps above this share of a level stays at it.
STAYS = 0.9
#: A mean feed below this share of the programmed one is told where nothing but starts and stops lower it.
SHORT_CUT = 0.9
#: Stretches that a sentence lists.
LISTED = 5


def group_waypoints(waypoints: list[int]) -> list[tuple[int, int]]:
    """Group waypoints into spans (first, last)."""
    breaks = [0, *(k for k in range(1, len(waypoints)) if waypoints[k] != waypoints[k - 1] + 1), len(waypoints)]
    return [(waypoints[a], waypoints[b - 1]) for a, b in itertools.pairwise(breaks) if b > a]


def find_slow_spans(task: PlanTask, timing: Timing) -> list[tuple[int, int]]:
    """Find spans of waypoints where limits lower the feed; starting up and coming to rest do not count."""
    lowered = timing.lowered & ~task.nominal.rapid
    rest = task.nominal.rapid | task.lead | np.isin(np.arange(len(task)), (0, len(task) - 1))
    middle = np.r_[timing.time[0], 0.5 * (timing.time[1:] + timing.time[:-1])]  # of the move that a share is of
    spans = []
    for begin, end in group_waypoints(np.flatnonzero(lowered).tolist()):
        first, last, rows = begin, end, slice(begin, end + 1)
        if rest[max(begin - 1, 0) : begin + 1].any():
            still = timing.time[begin if rest[begin] else begin - 1]
            first += count_starting(timing.share[rows], middle[rows] - still)
        if rest[end : end + 2].any():
            still = timing.time[end if rest[end] else end + 1]
            last -= count_starting(timing.share[rows][::-1], still - middle[rows][::-1])
        if first < last:
            spans.append((first, last))
    return spans


def count_starting(share: Array, away: Array) -> int:
    """Count the waypoints at which a run starts up from rest: as long as it gets faster and does not stay at a level.

    It stays where it keeps within a tenth of a level for longer than it has taken to come there from rest.

    Args:
        share: Feed as a share of the programmed one, from rest on. Shape (k,).
        away: Time between the rest and the middle of each move. Shape (k,). [s]
    """
    top = int(np.argmax(np.r_[np.diff(share) < 0, True]))
    rising = np.where(away > 0, share, 0.0)[: top + 1]
    reached = np.searchsorted(rising, STAYS * rising)
    stays = away[: top + 1] - away[reached] > np.maximum(away[reached], 0.0)
    return int(reached[stays].min()) if stays.any() else top


def mark_slow(task: PlanTask, timing: Timing) -> NDArray[np.bool_]:
    """Mark the waypoints of the slow spans. Shape (n,)."""
    slow = np.zeros(len(task), bool)
    for first, last in find_slow_spans(task, timing):
        slow[first : last + 1] = True
    return slow


def list_causes(task: PlanTask, timing: Timing) -> list[tuple[str, NDArray[np.int_]]]:
    """Sort the slow waypoints by what slows them; each cause in words, with its waypoints.

    Near a rest within the cut the tool starts up or stops, and nearly so near a rounded corner; near a waypoint where a
    joint is at its limit, that limit holds. What is left is slower for the joints' motion to follow the corrections
    where these follow the feed, and for the run's smoothness elsewhere.
    """
    slow = mark_slow(task, timing)
    rests = task.rests & ~task.nominal.rapid
    by_rest = slow & (_distance(timing.time, rests) <= FROM_REST * task.smoothing)
    curved = np.zeros(len(task), bool)
    if task.nominal.rounded is not None:
        curved = task.nominal.rounded > 0.0
    by_corner = slow & ~by_rest & (_distance(timing.time, curved) <= FROM_REST * task.smoothing)
    plain = slow & ~by_rest & ~by_corner
    by_limit = plain & (_distance(timing.time, timing.limiting >= 0) <= FROM_LIMIT * task.smoothing)
    left = plain & ~by_limit
    follows = task.follows_feed or task.inertia
    words = "so that the joints can follow the corrections" if follows else "to keep the run smooth around joint limits"
    causes = [("at corners, where the tool comes to rest", by_rest), ("at rounded corners", by_corner)]
    causes += [(f"by the {name}", by_limit & rows) for name, rows in _name_limits(task, timing, by_limit)]
    if left.any():
        causes.append((f"{words} ({_describe_busiest(task, timing, left)})", left))
    return [(text, np.flatnonzero(rows)) for text, rows in causes if rows.any()]


def describe_causes(task: PlanTask, timing: Timing) -> str:
    """Say at which waypoints the feed is lowered, why, and how far; "" where it is not."""
    spans = find_slow_spans(task, timing)
    if not spans:
        return _describe_short_cut(task, timing)
    count = sum(last - first + 1 for first, last in spans)
    listed = ", ".join(f"{first}-{last}" for first, last in spans[:LISTED]) + (", ..." if len(spans) > LISTED else "")
    reasons = []
    for words, rows in list_causes(task, timing):
        least = int(rows[timing.share[rows].argmin()])
        reasons.append(f"{words}, down to {100 * timing.share[least]:.3g} % at waypoint {least}")
    return f"The feed is lowered at {count} waypoints ({listed}): {'; '.join(reasons)}."


def _describe_short_cut(task: PlanTask, timing: Timing) -> str:
    """Say that a cut is over before the feed counts, where starting up and coming to rest lower the mean feed."""
    rows = np.flatnonzero(~task.nominal.rapid & ~task.lead & (task.nominal.feed > 0))
    rows = rows[rows > 0]
    length, spent = task.nominal.steps[rows - 1], timing.time[rows] - timing.time[rows - 1]
    share = float((length / task.nominal.feed[rows]).sum() / max(spent.sum(), 1e-12))
    if not len(rows) or share >= SHORT_CUT:
        return ""
    return (f"Starting up and coming to rest lower the mean feed of this short path to {100 * share:.2g} % of the"
            " programmed one.")  # fmt: skip


def _distance(time: Array, marked: NDArray[np.bool_]) -> Array:
    """Return the time from each waypoint to the nearest marked one, infinite without any. Shape (n,). [s]"""
    marks = time[marked]
    if not len(marks):
        return np.full(len(time), np.inf)
    after = np.clip(np.searchsorted(marks, time), 0, len(marks) - 1)
    return np.asarray(np.minimum(np.abs(marks[after] - time), np.abs(time - marks[np.maximum(after - 1, 0)])))


def _name_limits(task: PlanTask, timing: Timing, rows: NDArray[np.bool_]) -> list[tuple[str, NDArray[np.bool_]]]:
    """Say which limit is the nearest of each waypoint."""
    at = np.flatnonzero(timing.limiting >= 0)
    if not rows.any() or not len(at):
        return []
    place = np.searchsorted(timing.time[at], timing.time)
    left, right = at[np.clip(place - 1, 0, len(at) - 1)], at[np.clip(place, 0, len(at) - 1)]
    nearer = np.abs(timing.time[left] - timing.time) <= np.abs(timing.time[right] - timing.time)
    own = np.where(nearer, left, right)
    joint, by_velocity = timing.limiting[own], timing.by_velocity[own]
    found = []
    for number, kind in sorted({(int(joint[i]), bool(by_velocity[i])) for i in np.flatnonzero(rows)}):
        word = "velocity" if kind else "acceleration"
        found.append((f"{word} limit of {task.robot.joint_names[number]}", (joint == number) & (by_velocity == kind)))
    return found


def _describe_busiest(task: PlanTask, timing: Timing, rows: NDArray[np.bool_]) -> str:
    """Say which rate is used the most on some waypoints."""
    use = {
        "velocity": np.abs(timing.velocity[rows]) / task.velocity_limits,
        "acceleration": np.abs(timing.acceleration[rows]) / task.acceleration_limits,
    }
    kind = max(use, key=lambda name: float(use[name].max()))
    joint = int(use[kind].max(axis=0).argmax())
    return f"{kind} of {task.robot.joint_names[joint]} up to {100 * use[kind].max():.2g} % of its limit"
