"""Load of a timed motion on the springs, independent of the planner: Pinocchio's recursive Newton-Euler algorithm.

It shares neither code nor masses with the planner (`compplan.statics.inertia`), only the motion between rows: joint
positions are parabolas through three rows. The joint forces accelerate the rigid arm [Featherstone2008].
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.simulation.exact import ExactRobot, load_by_motion


def find_inside(time: Array, moving: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the rows inside a cut with moves of nonzero time on both sides. Shape (k,).

    time: ascending, (n,) [s]; moving: whether the move that ends at each row cuts, (n,).
    """
    step = np.diff(time)
    return 1 + np.flatnonzero(moving[1:-1] & moving[2:] & (np.minimum(step[:-1], step[1:]) > 1e-6))


def fit_parabolas(q: Array, time: Array, rows: NDArray[np.int_]) -> tuple[Array, Array]:
    """Compute velocities and accelerations at rows by the parabola through each row and its neighbours. Shapes (k, nq).

    q: (n, nq) [rad or m]; time: ascending, (n,) [s]; rows: with a neighbour on either side, (k,).
    """
    a, b = (time[rows] - time[rows - 1])[:, None], (time[rows + 1] - time[rows])[:, None]
    a, b = np.maximum(a, 1e-12), np.maximum(b, 1e-12)
    back, ahead = q[rows - 1] - q[rows], q[rows + 1] - q[rows]
    # q(t) = q + v t + w t^2 / 2 through t = -a and t = b
    change = 2.0 * (back * b + ahead * a) / (a * b * (a + b))
    velocity = ahead / b - 0.5 * change * b
    return velocity, change


def load_springs(
    exact_robot: ExactRobot, q: Array, time: Array, moving: NDArray[np.bool_], rests: NDArray[np.bool_],
    among: NDArray[np.int_] | None = None,
) -> Array:  # fmt: skip
    """Compute the load of inertia of a timed motion on each elastic coordinate; zero at rest. Shape (n, s).

    Args:
        exact_robot: The robot with all its masses and no weight.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Shape (n,). [s]
        moving: Whether the move that ends at each row cuts. Shape (n,).
        rests: Whether the tool is at rest at each row. Shape (n,).
        among: Rows to evaluate (default: all).
    """
    found = np.zeros((len(q), len(exact_robot.elastic)))
    if not sum(inertia.mass for inertia in exact_robot.model.inertias) > 0 or not len(exact_robot.elastic):
        return found
    rows = find_inside(time, moving)
    rows = rows[~rests[rows]]
    if among is not None:
        rows = np.intersect1d(rows, among)
    velocity, change = fit_parabolas(q, time, rows)
    found[rows] = load_by_motion(exact_robot, q[rows], velocity, change)
    return found


def shift_tip(exact_robot: ExactRobot, q: Array, loads: Array) -> Array:
    """Compute the tip displacement due to loads on the elastic coordinates, to first order. Shape (k, 3). [m]"""
    data, found = exact_robot.model.createData(), np.empty((len(q), 3))
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for k, (pose, load) in enumerate(zip(q, loads, strict=True)):
        columns = pin.computeFrameJacobian(
            exact_robot.model, data, exact_robot.commanded @ pose + exact_robot.shift, exact_robot.tcp, world
        )
        found[k] = columns[:3, exact_robot.elastic] @ (exact_robot.compliance @ load)
    return found


def solve_rigid(exact_robot: ExactRobot, q: Array) -> tuple[Array, Array]:
    """Compute the pose of the tool on the unloaded, rigid arm: position (n, 3) [m] and rotation (n, 3, 3)."""
    model, data = exact_robot.model, exact_robot.model.createData()
    position, rotation = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for k, coordinates in enumerate(q @ exact_robot.commanded.T + exact_robot.shift):
        pin.forwardKinematics(model, data, coordinates)
        place = pin.updateFramePlacement(model, data, exact_robot.tcp)
        position[k], rotation[k] = place.translation, place.rotation
    return position, rotation
