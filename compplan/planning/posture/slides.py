"""How a rail, or a table that carries the part, moves along a path.

On one side of its lost motion as long as it can, in strokes worth the name.
"""

from __future__ import annotations

import itertools

import numpy as np

from compplan.robot import Array, Robot

#: Stroke between two reversals of a rail below which it does not move (assumed: racks and screws lose and repeat
#: hundredths to tenths of a millimetre); as many times what a folder says of its lost motion. [m]
LEAST_STROKE, TIMES_LOST = 1e-3, 3.0
#: The same of a turning joint that carries the part (assumed). [rad]
LEAST_TURN = float(np.radians(1.0))


def least_strokes(robot: Robot) -> Array:
    """Return the least stroke of every joint that slides or carries the part, 0 for the others. (nq,). [m or rad]."""
    stroke = np.where(robot.prismatic, LEAST_STROKE, np.where(robot.carriers, LEAST_TURN, 0.0))
    for entry in robot.effects:
        if entry.get("effect") != "backlash" or entry.get("joint") not in robot.joint_names:
            continue
        j = robot.joint_names.index(entry["joint"])
        if stroke[j]:
            width = entry["parameters"].get("width_m" if robot.prismatic[j] else "width_rad", 0.0)
            stroke[j] = max(stroke[j], TIMES_LOST * abs(float(width)))
    return stroke


def steady_slide(positions: Array, stroke: float) -> Array:
    """Take the small reversals out of the positions of a slide along a path.

    Between turning points that lie at least a stroke apart the slide moves one way only; a slide whose whole motion
    is less stands still. No position moves by a stroke or more.

    Args:
        positions: Positions along the path. Shape (n,). [m]
        stroke: Least way between two reversals. [m]

    """
    if not len(positions) or np.ptp(positions) < stroke:
        return np.full(len(positions), 0.5 * (positions.max() + positions.min()) if len(positions) else 0.0)
    turns = _turning_points(positions, stroke)
    steady = np.array(positions, float)
    for first, last in itertools.pairwise(turns):
        part = positions[first : last + 1]
        rising = part[-1] > part[0]
        run = np.maximum.accumulate(part) if rising else np.minimum.accumulate(part)
        steady[first : last + 1] = np.clip(run, min(part[0], part[-1]), max(part[0], part[-1]))
    steady[: turns[0]], steady[turns[-1] :] = steady[turns[0]], steady[turns[-1]]
    return steady


def count_reversals(positions: Array, stroke: float) -> int:
    """Count where a joint turns back, ways shorter than a stroke left out.

    Args:
        positions: Positions along the path. Shape (n,). [m or rad]
        stroke: Least way between two reversals, above 0. [m or rad]

    """
    if not len(positions) or np.ptp(positions) < stroke:
        return 0
    return len(_turning_points(positions, stroke)) - 2


def _turning_points(positions: Array, stroke: float) -> list[int]:
    """List the rows of alternating extremes, each at least a stroke away from the one before."""
    low = high = 0
    rising: bool | None = None
    turns: list[int] = []
    for k, value in enumerate(positions.tolist()):
        if value > positions[high]:
            high = k
        if value < positions[low]:
            low = k
        if rising is not True and value - positions[low] >= stroke:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and positions[high] - value >= stroke:
            turns.append(high)
            rising, low = False, k
    turns.append(high if rising else low)
    return turns
