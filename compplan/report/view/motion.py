"""Where the links of a cell's arm are, and how the arm bends so that its tip comes to a place."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.report.view.recording import Cell
from compplan.robot import Array

#: Steps towards the drawn tip, the damping of one, and the small motion that gives the slope. [1, m/rad, rad or m]
STEPS, DAMPING, SMALL = 3, 1e-3, 1e-6


def locate_chain(cell: Cell, q: Array) -> dict[str, Array]:
    """Locate every link of the arm; shape (4, 4) each [m].

    Args:
        cell: The cell.
        q: Joints. Shape (nq,). [rad or m]
    """
    value = dict(zip((joint.name for joint in cell.actuated), q, strict=True))
    poses = {cell.base: np.eye(4)}
    for joint in cell.joints:
        position = value.get(joint.name, 0.0)
        if joint.mimic is not None:
            position = joint.mimic.multiplier * value[joint.mimic.joint] + joint.mimic.offset
        motion = np.eye(4)
        if joint.kind == "prismatic":
            motion[:3, 3] = joint.axis * position
        elif joint.kind == "revolute":
            motion[:3, :3] = Rotation.from_rotvec(joint.axis * position).as_matrix()
        poses[joint.child] = poses[joint.parent] @ joint.placement @ motion
    return poses


def bend_arm(cell: Cell, q: Array, tip: Array) -> Array:
    """Move the joints as little as need be until the tip is at a place, for drawing: damped least squares.

    Args:
        cell: The cell.
        q: Commanded joints. Shape (nq,). [rad or m]
        tip: Where the tip is drawn. Shape (3,). [m]

    Returns:
        Joints. Shape (nq,). [rad or m]
    """
    bent = np.array(q, float)
    for _ in range(STEPS):
        here = locate_chain(cell, bent)[cell.tcp][:3, 3]
        slope = np.empty((3, len(bent)))
        for k in range(len(bent)):
            moved = bent.copy()
            moved[k] += SMALL
            slope[:, k] = (locate_chain(cell, moved)[cell.tcp][:3, 3] - here) / SMALL
        bent += slope.T @ np.linalg.solve(slope @ slope.T + DAMPING**2 * np.eye(3), tip - here)
    return bent
