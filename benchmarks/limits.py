"""Whether a timed plan holds its limits at every millisecond: velocity, acceleration, torque.

    python -m benchmarks limits JOB [JOB ...]

The run is a cubic spline over time, at rest at both ends of every run, sampled every millisecond; rates are differences
of the samples. Torques are MuJoCo's inverse dynamics of the robot folder, read by the check's own reader.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.simulated_robot.cell import SimulatedRobot
from benchmarks.simulated_robot.job import Array
from benchmarks.simulated_robot.robot import Arm, mount_tool, read_arm

CYCLE = 1e-3
GRAVITY = np.array([0.0, 0.0, -9.81])


def sample_use(
    q: Array, time: Array, runs: list[tuple[int, int]], velocity: Array, acceleration: Array, *,
    arm: Arm | Path | None = None, effort: Array | None = None, wrench: Array | None = None,
) -> dict[str, float]:  # fmt: skip
    """Return the greatest share of every limit that the runs use.

    Args:
        q: Joint positions. Shape (n, nq). [rad or m]
        time: Shape (n,). [s]
        runs: First and last row of every run from rest to rest.
        velocity: Limits. Shape (nq,). [rad/s or m/s]
        acceleration: Limits. Shape (nq,). [rad/s^2 or m/s^2]
        arm: The robot with its tool, or its folder; None asks for no torques.
        effort: Limits. Shape (nq,). [N m or N]
        wrench: On the tool, base axes. Shape (n, 6). [N, N m]
    """
    cell = None if arm is None else SimulatedRobot(read_arm(arm) if isinstance(arm, Path) else arm)
    found = {"velocity": 0.0, "acceleration": 0.0, "torque": 0.0}
    for first, last in runs:
        rows = np.arange(first, last + 1)
        rows = rows[np.r_[True, np.diff(time[rows]) > 1e-9]]
        if len(rows) < 2:
            continue
        curve = CubicSpline(time[rows], q[rows], bc_type="clamped")
        at = np.arange(time[rows[0]], time[rows[-1]], CYCLE)
        samples = np.vstack([curve(at), q[rows[-1:]]]) if len(at) < 4 else curve(at)
        for order, (name, limit) in enumerate((("velocity", velocity), ("acceleration", acceleration))):
            if len(samples) > order + 1:
                most = np.abs(np.diff(samples, order + 1, axis=0)).max(axis=0) / CYCLE ** (order + 1)
                found[name] = max(found[name], float((most / limit).max()))
        if cell is not None and effort is not None and wrench is not None:
            load = np.column_stack([np.interp(at, time[rows], column) for column in wrench[rows].T])
            torque = cell.torques(curve(at), load, GRAVITY, curve(at, 1), curve(at, 2))
            found["torque"] = max(found["torque"], float((np.abs(torque) / effort).max()))
    return found


def main() -> None:
    """Plan jobs and print which share of their limits they use."""
    from compplan.job.job import load_job
    from compplan.planning.plan import plan_job

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", type=Path, nargs="+")
    print(f"{'job':24} {'cycle':>8}  velocity  acceleration  torque   (shares of the limits, at 1 ms)")
    for file in parser.parse_args().jobs:
        plan = plan_job(load_job(file))
        task = plan.task
        arm = None
        if plan.job is not None and plan.job.feed.torque_limits and task.robot.folder is not None:
            table = None if plan.job.tool is None else plan.job.tool.model_dump(exclude_unset=True)
            arm = mount_tool(read_arm(task.robot.folder), table)
        runs = task.runs
        use = sample_use(
            plan.q, plan.timing.time, runs, task.velocity_limits, task.acceleration_limits,
            arm=arm, effort=task.robot.effort_limits, wrench=task.wrench,
        )  # fmt: skip
        print(f"{file.stem:24} {plan.timing.time[-1]:8.2f}  {use['velocity']:8.4f}  {use['acceleration']:12.4f}  "
              f"{use['torque'] if arm is not None else np.nan:6.4f}")  # fmt: skip


if __name__ == "__main__":
    main()
