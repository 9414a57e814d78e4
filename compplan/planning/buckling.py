"""An answer where the arm buckles under its load, or its springs are too soft to hold it: waypoint and joint."""

from __future__ import annotations

import numpy as np

from compplan.errors import ConvergenceError, InfeasibleError
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import Chain, jacobian, load_elements, locate_frames
from compplan.statics.elastic import load_hessian, solve_equilibrium

#: Waypoints that are looked at.
TRIED = 400


def find_buckling(task: PlanTask, q: Array) -> dict[int, str]:
    """Find waypoints at which the loaded arm stands in an equilibrium that does not hold, and name the joint."""
    rows = np.flatnonzero(task.compensated)
    if not len(rows) or not task.chain.n_springs:
        return {}
    size = np.linalg.norm(task.wrench[rows, :3], axis=1)
    heavy = rows[np.argsort(size)[-TRIED // 2 :]]
    rows = np.union1d(heavy, rows[np.linspace(0, len(rows) - 1, TRIED // 2).astype(int)])
    share, spring = measure_buckling(task.chain, q[rows], task.wrench[rows])
    return {
        int(rows[k]): f"buckling of {task.chain.spring_names[spring[k]]} (load {share[k]:.3g} of the critical one)"
        for k in np.flatnonzero(share >= 1.0)
    }


def measure_buckling(chain: Chain, q: Array, wrench: Array) -> tuple[Array, Array]:
    """Measure how near loads are to those under which the arm buckles, dead ones: they keep direction and point.

    With H = d(J^T w + tau_g)/dtheta the arm holds as long as C H has no eigenvalue of 1 and more; for one joint of
    stiffness k under a force F along a lever l that is F l / k [Euler].

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Greatest eigenvalue, shape (n,), and the spring that moves the most in its mode, shape (n,).

    """
    loaded = solve_equilibrium(chain, q, wrench, tolerance=1e-10)
    values, modes = np.linalg.eig(chain.compliance @ load_hessian(chain, q, loaded.theta, wrench))
    greatest = values.real.argmax(axis=1)
    every = np.arange(len(values))
    mode = np.abs(np.swapaxes(modes, 1, 2)[every, greatest])
    return np.asarray(values.real[every, greatest]), np.asarray(mode.argmax(axis=1))


def explain_buckling(task: PlanTask) -> InfeasibleError | None:
    """Name waypoints at which the loaded arm finds no rest, and the joint that gives way the most; or return None."""
    rows = np.flatnonzero(task.compensated)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), TRIED)).astype(int))]
    failing = [int(row) for row in rows if not _settles(task, int(row))]
    if not failing:
        return None
    row = slice(failing[0], failing[0] + 1)
    frames = locate_frames(task.chain, task.q_start[row])
    elements = task.chain.spring_elements
    torque = load_elements(task.chain, frames, task.wrench[row])[0, elements]
    give = task.chain.compliance @ torque
    lever = np.linalg.norm(jacobian(task.chain, frames)[0, :3, elements], axis=1)
    worst = int(np.argmax(np.abs(give) * lever))
    name, slides = task.chain.spring_names[worst], task.chain.translates[elements[worst]]
    size = f"{1e3 * abs(give[worst]):.3g} mm" if slides else f"{np.degrees(abs(give[worst])):.3g} deg"
    message = (
        f"the arm buckles at waypoint {failing[0]}: to first order the spring of {name} gives way by {size} under "
        f"{abs(torque[worst]):.4g} {'N' if slides else 'N m'}, and no equilibrium is found "
        f"({len(failing)} of {len(rows)} waypoints tried); check the compliances and the force"
    )
    return InfeasibleError(message, waypoints=failing, limits=[f"equilibrium of {name}"])


def _settles(task: PlanTask, row: int) -> bool:
    try:
        solve_equilibrium(task.chain, task.q_start[row : row + 1], task.wrench[row : row + 1], tolerance=1e-9)
    except ConvergenceError:
        return False
    return True
