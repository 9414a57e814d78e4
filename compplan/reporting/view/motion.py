"""Where the links of a cell's arm are, and how the arm bends so that its tip comes to a place."""

from __future__ import annotations

import numpy as np

from compplan.reporting.scenes import follow_joints
from compplan.reporting.view.recording import ViewCell
from compplan.robot import Array

#: Steps towards the drawn tip, and the damping of one. [1, m/rad]
STEPS, DAMPING = 3, 1e-3


def locate_chain(cell: ViewCell, q: Array) -> dict[str, Array]:
    """Locate every link of the arm; shape (4, 4) each [m].

    Args:
        cell: The cell.
        q: Joints. Shape (nq,). [rad or m]
    """
    value = dict(zip((joint.name for joint in cell.actuated), q, strict=True))
    return follow_joints(cell.base, cell.joints, value)


def slope_tip(cell: ViewCell, poses: dict[str, Array]) -> Array:
    """Return how the tip moves with each joint: axis x (tip - axis point) of a turning joint, axis of a sliding one.

    Args:
        cell: The cell.
        poses: Where its links are, of `locate_chain`. Shape (4, 4) each. [m]

    Returns:
        Shape (3, nq). [m/rad or 1]
    """
    column = {joint.name: number for number, joint in enumerate(cell.actuated)}
    slope = np.zeros((3, len(column)))
    for joint in cell.joints:
        if joint.kind == "fixed":
            continue
        pose = poses[joint.child]
        axis = pose[:3, :3] @ joint.axis
        motion = axis if joint.kind == "prismatic" else np.cross(axis, poses[cell.tcp][:3, 3] - pose[:3, 3])
        if joint.mimic is None:
            slope[:, column[joint.name]] += motion
        else:
            slope[:, column[joint.mimic.joint]] += joint.mimic.multiplier * motion
    return slope


def bend_arm(cell: ViewCell, q: Array, tip: Array) -> Array:
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
        poses = locate_chain(cell, bent)
        slope = slope_tip(cell, poses)
        away = tip - poses[cell.tcp][:3, 3]
        bent += slope.T @ np.linalg.solve(slope @ slope.T + DAMPING**2 * np.eye(3), away)
    return bent
