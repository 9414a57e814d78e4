"""Inverse kinematics of others along the same path: pink (PyPI pin-pink), judged in the same cell.

pink follows the path by differential inverse kinematics with the rotation about the tool axis free, from the CAM
default's first posture. It knows no load: what its motion would leave is the whole deflection.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.posture_cases import Array, Case
from compplan.plan.plan import PlanOptions, PostureRequest, plan_compensation
from compplan.posture.settings import read_settings
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.toolpath.contact import tool_axes

#: Steps of pink on every waypoint, and its time step.
STEPS, STEP = 3, 1.0


def run_peer(case: Case, start: Array) -> dict[str, Any]:
    """Run pink, from a posture, and the plan along a path; return motion, violations, time and deviation of both."""
    clock = time.perf_counter()
    q = follow_with_pink(case, start)
    row = {"pink": _describe(case, q, time.perf_counter() - clock)}
    request = PostureRequest(read_settings(case.job, case.robot), case.job.T_base_part[:3, :3])
    clock = time.perf_counter()
    plan = plan_compensation(case.robot, case.nominal, PlanOptions(tool_x=case.job.tool_x_base, posture=request))
    row["compplan"] = _describe(case, plan.q, time.perf_counter() - clock)
    return row


def follow_with_pink(case: Case, start: Array) -> Array:
    """Follow the path with pink: position and tool axis wanted, rotation about it free. Shape (n, nq). [rad]"""
    import pink

    rigid = build_exact_robot(replace(case.robot, springs=(), link_elasticities=(), gravity=None))
    model = rigid.model
    model.lowerPositionLimit, model.upperPositionLimit = case.robot.lower.copy(), case.robot.upper.copy()
    model.velocityLimit = case.robot.velocity_limits.copy()
    configuration = pink.Configuration(model, model.createData(), start.copy())
    task = pink.tasks.FrameTask("tcp", position_cost=1.0, orientation_cost=[1.0, 1.0, 0.0], lm_damping=1e-9)
    upright = tool_axes(case.nominal, case.job.tool_x_base)
    path = np.empty((len(case.nominal), model.nq))
    for i in range(len(case.nominal)):
        for _ in range(STEPS):
            task.set_target(pin.SE3(upright[i], case.nominal.position[i]))
            reached = configuration.get_transform_frame_to_world("tcp").rotation
            x = reached[:, 0] - (reached[:, 0] @ upright[i][:, 2]) * upright[i][:, 2]
            x /= np.linalg.norm(x)
            z = upright[i][:, 2]
            target = np.stack([x, np.cross(z, x), z], axis=1)
            task.set_target(pin.SE3(target, case.nominal.position[i]))
            velocity = pink.solve_ik(configuration, [task], STEP, solver="daqp", safety_break=False)
            configuration.integrate_inplace(velocity, STEP)
        path[i] = configuration.q
    return path


def _describe(case: Case, q: Array, spent: float) -> dict[str, Any]:
    cut = ~case.nominal.rapid
    wrench = np.zeros((len(q), 6)) if case.nominal.wrench is None else case.nominal.wrench
    position = solve_exact_pose(case.judge, q, wrench)[0]
    unloaded = solve_exact_pose(case.judge, q)[0]
    outside = (q < case.robot.lower - 1e-9) | (q > case.robot.upper + 1e-9)
    away = np.linalg.norm(position - case.nominal.position, axis=1)[cut]
    return {
        "travel_deg": float(np.degrees(np.abs(np.diff(q, axis=0)).sum())),
        "violations": int(outside.any(axis=1).sum()),
        "largest_step_deg": float(np.degrees(np.abs(np.diff(q, axis=0)).max())),
        "missed_mm": float(1e3 * np.linalg.norm(unloaded - case.nominal.position, axis=1)[cut].max()),
        "deviation_rms_mm": float(1e3 * np.sqrt((away**2).mean())),
        "deviation_max_mm": float(1e3 * away.max()),
        "time_s": round(spent, 2),
    }
