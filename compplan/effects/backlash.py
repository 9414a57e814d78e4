"""backlash: lost motion; the position depends on the direction of the joint's last move.

The link of a joint with play of width w follows its command q at q - s w / 2, s the side on which the command pushes:
1 as it rises, -1 as it falls. The command for a required link position is q_link + s w / 2; at a reversal it
crosses the play at once. Small swings do not change the side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array, Robot

name = "backlash"
words = "{at} has lost motion (backlash)"
follows = "direction of approach"
#: Assumed: full width of a worn gear's lost motion, rad or m.
SCALE = {"revolute": 2e-4, "prismatic": 1e-4}
#: Direction of approach of the first row, where unknown: from below (assumed).
CAME_FROM_BELOW = -0.5
#: Least width of lost motion that is compensated (assumed). [rad or m]
LEAST_PLAY = 1e-6
#: Rounding tolerance of joint positions in the search for reversals. [rad or m]
STANDS = 1e-9
#: Swings of a link that do not change the side: share of the play, and least size (assumed). [1, rad or m]
SWING, LEAST_SWING = 0.02, 1e-6


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a signature for every joint approached from both sides; positive where the link lags.

    None if the approach of most rows is unknown, as where each pose has a run label of its own.
    """
    if 2 * at.campaign.first_visit.sum() > len(at.campaign):
        return
    free = ~at.campaign.link_controlled
    for index, joint in enumerate(at.robot.actuated):
        direction = at.campaign.approach[:, index] * free
        if not ((direction > 0).any() and (direction < 0).any()):
            continue
        key = "width_m" if joint.kind == "prismatic" else "width_rad"
        scale = np.array([SCALE[joint.kind]])
        width = float(at.current.get((name, joint.name, None), {}).get(key, 0.0))
        width = width if abs(width) > 0.1 * scale[0] else 0.5 * float(scale[0])
        shape = lost_motion(np.nan_to_num(at.campaign.q[:, index]), width, CAME_FROM_BELOW) / width * free
        twist, encoder = at.joint_response(index, shape[:, None])
        yield Signature(name, joint.name, None, "", (key,), scale, twist, encoder, positive=True)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the lost motion of the link: half the width behind its reading, on either side."""
    index, values = model.joint_index(effect.joint), effect.parameters
    width = float(values["width_m"] if "width_m" in values else values["width_rad"])
    start = float(values.get("start_ratio", CAME_FROM_BELOW))
    return model.add_to_joint("drive", index, lost_motion(np.nan_to_num(model.campaign.q[:, index]), width, start))


def lost_motion(reading: Array, width: float, start: float = 0.0) -> Array:
    """Return link minus reading of a joint with play. Shape (n,). [rad or m]

    The link rests until the reading has crossed the play; the state is kept between runs. A negative width mirrors a
    positive one.

    reading: in time order, (n,); width: of the whole play; start: link minus reading before the first row, in widths,
    -0.5 if the joint came from below.
    """
    half = 0.5 * abs(width)
    readings = reading.tolist()
    follower, result = (readings[0] + start * abs(width) if readings else 0.0), []
    for value in readings:
        if follower < value - half:
            follower = value - half
        elif follower > value + half:
            follower = value + half
        result.append(follower - value)
    return np.asarray(np.sign(width) * np.array(result))


def find_sides(position: Array, swing: float, first: float) -> Array:
    """Return the side on which a joint is pushed at every row: 1 rising, -1 falling. Shape (n,).

    A joint reverses at the farthest row before it returns by more than a swing [rad or m]; that row keeps the previous
    side. `first` is the side at the first row.
    """
    sides, side, far = np.empty(len(position)), first, 0
    values = position.tolist()
    begin, most = 0, values[0] if values else 0.0
    for row, value in enumerate(values):
        if side * (value - most) >= -STANDS:
            far, most = row, max(value, most) if side > 0.0 else min(value, most)
        elif side * (most - value) > swing:
            sides[begin : far + 1] = side
            begin, side, far, most = far + 1, -side, row, value
    sides[begin:] = side
    return sides


def is_play(entry: Mapping[str, Any]) -> bool:
    """Return whether an effect of a folder is lost motion that joint commands can compensate."""
    return entry.get("effect") == "backlash" and width_of(entry) > LEAST_PLAY


def width_of(entry: Mapping[str, Any]) -> float:
    """Return the width of a backlash. [rad or m]"""
    values = entry.get("parameters", {})
    return float(values.get("width_rad", values.get("width_m", 0.0)))


def list_plays(robot: Robot) -> Array:
    """Return the width of the lost motion of every joint in a robot folder. Shape (nq,). [rad or m]"""
    widths = np.zeros(robot.nq)
    for entry in filter(is_play, robot.effects):
        # unknown joint names are refused when the effects are built
        widths += width_of(entry) * (np.array(robot.joint_names) == entry["joint"])
    return widths


def without_play(robot: Robot) -> Robot:
    """Return a robot whose joints have no lost motion."""
    return replace(robot, effects=tuple(entry for entry in robot.effects if not is_play(entry)))


def state_sides(robot: Robot, q: Array) -> Robot:
    """Return a robot whose joints with lost motion begin on the side of their first motion along q (n, nq)."""
    widths, effects = list_plays(robot), []
    if not widths.any():
        return robot
    for entry in robot.effects:
        if is_play(entry):
            joint = robot.joint_names.index(str(entry["joint"]))
            away = q[:, joint] - q[0, joint]
            far = np.flatnonzero(np.abs(away) > max(SWING * widths[joint], LEAST_SWING))
            side = float(np.sign(away[far[0]])) if len(far) else -2.0 * CAME_FROM_BELOW
            entry = {**entry, "parameters": {**entry["parameters"], "start_ratio": -0.5 * side}}
        effects.append(entry)
    return replace(robot, effects=tuple(effects))


def lead_play(robot: Robot, links: Array, contacts: Sequence[int] = ()) -> Array:
    """Return the lead of the command over the links that compensates lost motion. Shape (n, nq). [rad or m]

    links: required link positions (n, nq) [rad or m]; contacts: rows at rest, whose play is crossed before the motion
    continues.
    """
    lead = np.zeros_like(links)
    for entry in filter(is_play, robot.effects):
        index, width = robot.joint_names.index(str(entry["joint"])), width_of(entry)
        first = -np.sign(float(entry["parameters"].get("start_ratio", CAME_FROM_BELOW))) or 1.0
        sides = find_sides(links[:, index], max(SWING * width, LEAST_SWING), float(first))
        before = np.array([row for row in contacts if row < len(sides) - 1], int)
        sides[before] = sides[before + 1]
        lead[:, index] += 0.5 * width * sides
    return lead


def find_crossings(q: Array, links: Array) -> NDArray[np.bool_]:
    """Return the moves that cross lost motion: the lead of the command over the links changes. Shape (n - 1,)."""
    return np.asarray((np.abs(np.diff(q - links, axis=0)) > 0.5 * LEAST_SWING).any(axis=1))
