"""backlash: lost motion; the position depends on the direction of the joint's last move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

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
#: Less lost motion is none (assumed). [rad or m]
LEAST_PLAY = 1e-6


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a signature for every joint approached from both sides; positive where the link lags."""
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
    """Let the link lag behind its reading by half the width, on either side."""
    index = model.joint_index(effect.joint)
    drive = model.drive.copy()
    values = effect.parameters
    width = float(values["width_m"] if "width_m" in values else values["width_rad"])
    start = float(values.get("start_ratio", CAME_FROM_BELOW))
    drive[:, index] += lost_motion(np.nan_to_num(model.campaign.q[:, index]), width, start)
    return replace(model, drive=drive)


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


def is_play(entry: Mapping[str, Any]) -> bool:
    """Tell whether an effect of a folder is lost motion that a command can lead."""
    return entry.get("effect") == "backlash" and width_of(entry) > LEAST_PLAY


def width_of(entry: Mapping[str, Any]) -> float:
    """Return the width of a backlash. [rad or m]"""
    values = entry.get("parameters", {})
    return float(values.get("width_rad", values.get("width_m", 0.0)))


def list_plays(robot: Robot) -> Array:
    """Return the width of the lost motion that a robot folder states of every joint. Shape (nq,). [rad or m]"""
    widths = np.zeros(robot.nq)
    for entry in filter(is_play, robot.effects):
        # names that the robot does not have are refused where the effects are built
        widths += width_of(entry) * (np.array(robot.joint_names) == entry["joint"])
    return widths
