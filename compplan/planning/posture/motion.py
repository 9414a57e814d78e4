"""How the joints of a posture move along a path: lost motion that a folder states, and jumps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array, Robot
from compplan.toolpath.toolpath import Toolpath

#: Less lost motion is none (assumed). [rad or m]
LEAST_PLAY = 1e-6


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


def find_torn(q: Array, nominal: Toolpath, most_step: float) -> NDArray[np.bool_]:
    """Tell which waypoints of a cut a joint would have to jump to."""
    torn = np.zeros(len(q), bool)
    torn[1:] = np.abs(np.diff(q, axis=0)).max(axis=1) > most_step
    return torn & ~nominal.rapid
