"""Double encoders: readings of both sides of a joint, and the pose under each feedback.

The motor-side (primary) encoder reads the commanded element of a joint; the link-side (secondary) one reads it plus the
elastic coordinates between the two (`Spring.actuator`). A spring of gear and link together has a part beyond the
link-side encoder (`Spring.link_share`), which neither encoder measures [Klimchik2018]. A controller holds one of

    motor feedback:     q1 = q                          link follows the motor plus the gear deflection
    link feedback:      q2 = q                          gear deflection is removed
    combined feedback:  q2 + beta (q2 - q1) = q         a share beta of it compensates for compliance beyond the encoder

so that the link is at q + g C tau with a gain g of 1, 0 and -beta on the compliance C of the gears. A spring of
compliance C and link share s deflects by (s + (1 - s) g) C tau: one chain for each feedback.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from compplan.errors import InputError, ShapeError
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain
from compplan.statics.elastic import LoadedPose, solve_equilibrium

FEEDBACKS = ("motor", "link", "combined")


class EncoderState(NamedTuple):
    """Encoder readings and equilibrium of a loaded, controlled arm at n poses."""

    motor: Array  #: Readings of the motor-side encoders. Shape (n, nq). [rad or m]
    link: Array  #: Readings of the link-side encoders. Shape (n, nq). [rad or m]
    #: Equilibrium of the arm; `theta` of an actuator spring counts from the command, not from the motor.
    loaded: LoadedPose

    @property
    def difference(self) -> Array:
        """Gear deflection: link-side minus motor-side reading. Shape (n, nq). [rad or m]."""
        return self.link - self.motor


def actuator_selection(chain: Chain) -> Array:
    """Return which elastic coordinates add to which link-side encoder.

    Returns:
        Shape (nq, s), entries 1, 0, and -1 if a spring turns against its joint (joint about -y, spring about ry).
    """
    selection = np.zeros((chain.nq, chain.n_springs))
    owner = -1
    for element, spring in enumerate(chain.theta_index):
        if spring < 0:
            owner = element
        elif chain.actuator[spring] and owner >= 0:
            sense = np.sign(chain.axis[..., element, :] @ chain.axis[..., owner, :]) or 1.0
            selection[chain.q_index[owner], spring] = sense
    return selection


def control_equilibrium(
    chain: Chain, q: Array, wrench: Array | None = None, *, feedback: str = "motor", beta: Array | float = 0.0
) -> EncoderState:
    """Solve the equilibrium of an arm under motor-side, link-side or combined feedback.

    Args:
        chain: The chain; actuator springs must not be coupled with others.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes; none if left out. Shape (n, 6). [N, N m]
        feedback: "motor", "link" or "combined".
        beta: Of combined feedback, compliance beyond the encoder over compliance of the gear. Shape (nq,) or a number.

    Raises:
        InputError: If the feedback is unknown, or a gear's compliance is coupled with another spring.
        ShapeError: If beta does not have the shape above.
        ConvergenceError: If the load is near or beyond buckling.
    """
    if feedback not in FEEDBACKS:
        raise InputError(f"no feedback {feedback!r}, choose from {list(FEEDBACKS)}")
    if np.ndim(beta) and np.shape(beta) != (chain.nq,):
        raise ShapeError(f"beta has shape {np.shape(beta)}, expected ({chain.nq},)")
    selection, own = actuator_selection(chain), np.diagonal(chain.compliance, axis1=-2, axis2=-1)
    lies_between = selection.any(axis=0)
    coupled = np.abs(chain.compliance - own[..., None] * np.eye(chain.n_springs))[..., lies_between].any()
    if coupled:
        raise InputError(
            "an actuator spring is coupled with another spring, so encoders cannot separate its deflection; "
            "choose a strategy without encoders"
        )
    gain = feedback_gain(feedback, beta, chain.nq)
    scale = feedback_scale(np.where(lies_between, gain @ np.abs(selection), 1.0), chain.link_share)
    loaded = solve_equilibrium(replace(chain, compliance=chain.compliance * scale), q, wrench)
    yielded = ((1.0 - chain.link_share) * own * loaded.torque) @ selection.T
    link = np.atleast_2d(q) + gain * yielded
    return EncoderState(link - yielded, link, loaded)


def feedback_gain(feedback: str, beta: Array | float, joints: int) -> Array:
    """Return the share of each gear's deflection that remains under a feedback: 1, 0 or -beta. Shape (nq,)."""
    return {"motor": np.ones(joints), "link": np.zeros(joints)}.get(feedback, -np.broadcast_to(beta, (joints,)))


def hold_robot(robot: Robot, gain: Array) -> Robot:
    """Return the robot with the spring compliances that remain under a feedback gain (nq,), see `feedback_gain`."""
    gains = dict(zip(robot.joint_names, gain, strict=True))
    own = np.array([gains.get(spring.joint, 1.0) if spring.actuator else 1.0 for spring in robot.springs])
    scale = feedback_scale(own, np.array([spring.link_share for spring in robot.springs]))
    held = (replace(s, compliance=float(k) * s.compliance) for s, k in zip(robot.springs, scale, strict=True))
    return replace(robot, springs=tuple(held))


def feedback_scale(gain: Array, link_share: Array) -> Array:
    """Return the share of each spring's deflection that a feedback leaves: s + (1 - s) g.

    Args:
        gain: Remaining share g of the gear's deflection, 1 for springs that no encoder measures. Shape (s, ...).
        link_share: Share of each compliance beyond the link-side encoder. Shape (s, ...).
    """
    return link_share + (1.0 - link_share) * gain


def gear_compliance(chain: Chain) -> Array:
    """Return the compliance between the encoders of each joint, 0 if there is none. Shape (nq,). [rad/(N m)]"""
    own = (1.0 - chain.link_share) * np.diagonal(chain.compliance)
    return np.asarray(np.abs(actuator_selection(chain)) @ own)


def combined_gain(gear_compliance: Array, total_compliance: Array) -> Array:
    """Compute beta of combined feedback from two identified compliances per joint.

    beta = (k_total - k_gear) / k_gear [Klimchik2018]: motor-side feedback identifies k_total (gear and links together),
    the difference of the encoders k_gear. It is 0 for a joint without an identified gear spring.

    Args:
        gear_compliance: Compliance between the encoders. Shape (nq,). [rad/(N m)]
        total_compliance: Compliance of joint and links together about the joint's axis. Shape (nq,). [rad/(N m)]
    """
    gear, total = np.asarray(gear_compliance, float), np.asarray(total_compliance, float)
    known = (gear > 0.0) & (total > 0.0)
    return np.where(known, (total - gear) / np.where(known, gear, 1.0), 0.0)
