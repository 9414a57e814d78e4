"""Signs: what is left of deviations where springs yield to weights and loads of either sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from compplan.diagnosis.data.noise import ASSUMED_SIGMA
from compplan.measurement.campaign import Campaign
from compplan.measurement.frames import fit_registration
from compplan.robot import Array, Robot, Spring
from compplan.statics.chain import build_chain, jacobian, locate_frames
from compplan.statics.elastic import spring_torque
from compplan.statics.elements import ELASTIC_AXES

#: Errors of geometry that the sign test allows: metres, and radians (assumed).
GEOMETRY = 2e-3


class ElasticShapes(NamedTuple):
    """What the sign test fits, in units of the noise, what geometry can explain taken off; k equations.

    Attributes:
        residual: Measured minus rigid. Shape (k,).
        weight: Deflection per unit compliance of each joint, under weights. Shape (k, nq).
        load: The same under external loads. Shape (k, nq).

    """

    residual: Array
    weight: Array
    load: Array


def shape_elastics(robot: Robot, campaign: Campaign, register: Sequence[str]) -> ElasticShapes:
    """State what springs of every joint would do to the rows of a campaign; unknown frames are fitted first.

    Args:
        robot: The robot, whose own springs and effects are left out.
        campaign: The rows.
        register: Frames that nobody knows: "base", "tool".
    """
    own = tuple(Spring(joint.name, "own", 0.0) for joint in robot.actuated)
    frames_of = tuple(Spring(joint.name, axis, 0.0) for joint in robot.joints for axis in ELASTIC_AXES)
    bare = replace(robot, springs=own + frames_of, link_elasticities=(), gravity=robot.real_gravity, effects=())
    chain = build_chain(bare)
    frames, n = locate_frames(chain, campaign.q), len(campaign.position)
    at = chain.spring_elements
    turn = jacobian(chain, frames)[:, :3, at]
    weight = spring_torque(chain, frames, np.zeros((n, 6)))[:, at]
    load = spring_torque(chain, frames, campaign.wrench)[:, at] - weight
    joints = np.array(["." not in name for name in chain.spring_names])
    position, measured = frames.tcp_position, campaign.position
    if register:
        fitted = fit_registration(campaign, position, frames.tcp_rotation, register)
        position = fitted.locate_targets(campaign, position, frames.tcp_rotation)
        measured, position = ((p - fitted.base[:3, 3]) @ fitted.base[:3, :3] for p in (measured, position))
    sigma = ASSUMED_SIGMA["position"]
    swing = np.swapaxes(np.cross(np.eye(3)[None], position[:, None, :]), 1, 2)
    free = np.concatenate([turn, np.broadcast_to(np.eye(3), (n, 3, 3)), frames.tcp_rotation, swing], axis=2)
    free = np.vstack([free.reshape(3 * n, -1) / sigma, np.eye(free.shape[2]) / GEOMETRY])
    basis = np.linalg.qr(free)[0]

    def project(columns: Array) -> Array:
        padded = np.vstack([columns.reshape(3 * n, -1) / sigma, np.zeros((free.shape[1], columns[0].size // 3))])
        return np.asarray(padded - basis @ (basis.T @ padded))

    yields = (project((turn * part[:, None, :])[:, :, joints]) for part in (weight, load))
    return ElasticShapes(project((measured - position)[:, :, None])[:, 0], *yields)


def fit_positive(shapes: ElasticShapes, weight_sign: float, load_sign: float) -> float:
    """Fit compliances >= 0 under weights and loads of these signs; return the sum of squares that is left."""
    columns = weight_sign * shapes.weight + load_sign * shapes.load
    size = np.linalg.norm(columns, axis=0)
    seen = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    if not seen.any():
        return float(shapes.residual @ shapes.residual)
    return float(nnls(columns[:, seen] / size[seen], shapes.residual)[1] ** 2)
