"""An answer where the arm buckles under its load, or its springs are too soft to hold it: waypoint and joint."""

from __future__ import annotations

import numpy as np

from compplan.errors import ConvergenceError, InfeasibleError
from compplan.plan.task import PlanTask
from compplan.statics.chain import jacobian, load_elements, locate_frames
from compplan.statics.elastic import solve_equilibrium

#: Waypoints that are tried one by one.
TRIED = 400


def explain_buckling(task: PlanTask, error: ConvergenceError) -> InfeasibleError | None:
    """Name waypoints at which the loaded arm finds no rest, and the joint that gives way the most; or return None.

    Args:
        task: The task.
        error: What the solver said.

    """
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
