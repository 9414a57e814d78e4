"""Stability of a plan: buckling of the arm, and limit of the depth of cut of an end mill by chatter."""

from __future__ import annotations

import numpy as np

from compplan.errors import ConvergenceError, InfeasibleError
from compplan.planning.inertia import DAMPING
from compplan.planning.task import PlanTask
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.robot import Array
from compplan.simulation.chatter import compute_depth_limit, compute_gains
from compplan.simulation.vibration import build_dynamics, find_modes
from compplan.statics.chain import jacobian, load_elements, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.toolpath.contact import path_axes
from compplan.toolpath.toolpath import select_even

#: Most waypoints tested for buckling.
TRIED = 400


def explain_buckling(task: PlanTask) -> InfeasibleError | None:
    """Find a waypoint without loaded equilibrium, and the joint that yields the most; None if all have one."""
    for row in select_even(np.flatnonzero(task.compensated), TRIED).tolist():
        q, wrench = task.q_start[[row]], task.wrench[[row]]
        try:
            solve_equilibrium(task.chain, q, wrench, tolerance=1e-9)
        except ConvergenceError:
            break
    else:
        return None
    frames, elements = locate_frames(task.chain, q), task.chain.spring_elements
    give = task.chain.compliance @ load_elements(task.chain, frames, wrench)[0, elements]
    lever = np.linalg.norm(jacobian(task.chain, frames)[0, :3, elements], axis=1)
    name = task.chain.spring_names[int(np.argmax(np.abs(give) * lever))]
    message = (
        f"the arm buckles at waypoint {row}: no equilibrium is found, the spring of {name} yields the most; "
        "check the compliances and the force"
    )
    return InfeasibleError(message, waypoints=[row], limits=[f"equilibrium of {name}"])


#: Modes of the arm at a posture, and most places of the cut tested for chatter.
MODES, PLACES = 5, 12


def describe_depth_limit(task: PlanTask, q: Array) -> str:
    """Describe the least depth limit along a plan; "" without an end mill or with unknown masses."""
    cutting = None if task.law is None else task.law.cutting
    if cutting is None or not isinstance(cutting.process, EndMillProcess):
        return ""
    dynamics = build_dynamics(task.robot)
    touches = cutting.engagement.touches & ~cutting.rapid
    if not dynamics.known or not touches.any():
        return ""
    rows, process = select_even(np.flatnonzero(touches), PLACES), cutting.process
    there = np.clip(np.searchsorted(task.nominal.arc_length, cutting.arc[rows] - 1e-12), 0, len(task.nominal) - 1)
    tool, axes = process.tool_mode, path_axes(task.nominal)[there]
    feed = process.feed_per_tooth(task.nominal.feed[there])
    gains = process.teeth * compute_gains(cutting.engagement.take(rows), process.resistance, feed)
    period, limits = 1.0 / (process.spindle_rpm / 60.0 * process.teeth), np.empty(len(rows))
    for k, own in enumerate(find_modes(dynamics, q[there], MODES)):
        omega, shape, damping = own.omega, axes[k].T @ own.tip, np.full(len(own.omega), DAMPING)
        if tool is not None:  # its mode is equal along both path axes across the tool
            rate = 2.0 * np.pi * tool.frequency_Hz
            shape = np.hstack([shape, np.eye(3)[:, :2] * rate / np.sqrt(1e3 * tool.stiffness_N_mm)])
            omega, damping = np.r_[omega, rate, rate], np.r_[damping, tool.damping, tool.damping]
        limits[k] = compute_depth_limit(gains[k], period, omega, shape, damping)
    worst = int(limits.argmin())
    depth = float(cutting.engagement.axial[rows[worst]])
    known = (f"arm damped by {100 * DAMPING:.3g} % (assumed), "
             + ("tool and holder rigid (process.tool_mode states their mode)" if tool is None else
                f"tool mode of {tool.frequency_Hz:g} Hz"))  # fmt: skip
    if not np.isfinite(limits[worst]):
        return ""
    word = "Chatter is expected: the" if limits[worst] <= 1.0 else "The"
    return (f"{word} zero-order limit of depth is {1e3 * depth * limits[worst]:.2g} mm at waypoint "
            f"{int(there[worst])}, where {1e3 * depth:.2g} mm are cut ({known}).")  # fmt: skip
