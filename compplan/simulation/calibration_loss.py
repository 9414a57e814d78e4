"""What a controller's calibration cannot hold of a robot folder, in mm at the tip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.measurement.campaign import make_log
from compplan.robot import Array, Joint, Robot
from compplan.simulation.predict import predict_campaign

#: Poses over which a loss is taken, drawn within the limits of the joints and half a turn to either side.
POSES = 200


@dataclass(frozen=True)
class Loss:
    """One thing that a calibration does not hold."""

    what: str  #: What it is.
    rms: float  #: Root mean square of the tip's motion that it makes. [m]


def compute_losses(robot: Robot, held: Robot, nominal: Robot, lacks: str, seed: int = 0) -> tuple[list[Loss], float]:
    """Say what is lost, one thing at a time, and the tip error that all of it leaves (rms).

    Args:
        robot: The robot as measured: bending under its own weight and effects included.
        held: The robot that the controller believes, its joints rigid.
        nominal: The robot as it ships; its tool is the controller's until somebody enters another one.
        lacks: What the controller's file has no numbers for.
        seed: Seed of the poses.
    """
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (POSES, robot.nq))

    def locate(arm: Robot) -> Array:
        return predict_campaign(arm, make_log(q, np.zeros(6), np.zeros((POSES, 3)))).position

    plain = replace(robot, effects=())
    held = stiffen(replace(held, effects=()))
    rigid, bent, axes = locate(stiffen(plain)), locate(plain), locate(held)
    believed = locate(replace(held, joints=(*_split(held)[0], *_split(nominal)[1]), tcp=nominal.tcp))
    losses = [
        Loss(lacks, _rms(rigid - axes)),
        Loss("the tool, from flange to TCP: enter it as the TCP", _rms(axes - believed)),
        Loss(f"bending under the arm's own weight, springs {robot.grade}", _rms(bent - rigid)),
    ]
    for effect in robot.effects:
        place = f", {effect['joint']}" if effect.get("joint") else ""
        losses.append(Loss(f"{effect['effect']}{place}", _rms(locate(replace(robot, effects=(effect,))) - bent)))
    return losses, _rms(locate(robot) - believed)


def stiffen(robot: Robot) -> Robot:
    """Return the robot without anything that bends."""
    return replace(robot, springs=(), link_elasticities=())


def _split(robot: Robot) -> tuple[tuple[Joint, ...], tuple[Joint, ...]]:
    """Divide the chain at the flange."""
    end = 1 + max(k for k, joint in enumerate(robot.joints) if joint.child == robot.flange)
    return robot.joints[:end], robot.joints[end:]


def _rms(motion: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(motion**2, axis=1))))
