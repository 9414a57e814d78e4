"""tool_frame: the offset of the TCP on the flange differs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.folding import change_joint
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array, Robot
from compplan.robot.pose import apply_twist

name = "tool_frame"
words = "the tool centre point differs"
sits, follows = "tool", "posture"
#: Assumed: a TCP measured by touching a tip.
SCALE = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])
KEYS = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")


def tool_twists(at: Linearization) -> Array:
    """Return the motion of the target per motion of the TCP frame along and about its axes. Shape (n, 6, 6)."""
    R = at.attained.frames.tcp_rotation
    arm = at.point - at.attained.frames.tcp_position
    twist = np.zeros((len(R), 6, 6))
    twist[:, :3, :3] = R
    twist[:, 3:, 3:] = R
    twist[:, :3, 3:] = np.cross(np.swapaxes(R, 1, 2), arm[:, None, :]).swapaxes(1, 2)
    return twist


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return an offset of the TCP, and one with a rotation if orientation or an offset target shows it."""
    twist = tool_twists(at)
    both = Signature(name, None, None, "offset+turn", KEYS, SCALE, twist, columns=KEYS)
    yield both.part("offset", slice(3))
    if shows_turn(at, twist):
        yield both


def shows_turn(at: Linearization, twist: Array) -> bool:
    """Return whether orientation or an offset target shows a rotation of the tool."""
    return at.campaign.rotation is not None or bool(np.abs(twist[:, :3, 3:]).max(initial=0.0) > 1e-6)


def twist_values(effect: Effect) -> Array:
    """Return the step of a frame. Shape (6,). [m, rad]."""
    return np.array([float(effect.parameters.get(key, 0.0)) for key in KEYS])


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the step into the last joint of the chain, which carries the TCP frame."""
    last = robot.joints[-1]
    return change_joint(robot, last.name, placement=last.placement @ apply_twist(twist_values(effect)))
