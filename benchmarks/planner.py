"""Time the planner: solver time a waypoint at growing length, beside a plain solution waypoint by waypoint.

    python -m benchmarks planner [--sizes 500 5000 50000] [--plain 300] [--json FILE]

The path is the ISF cone of paths/isf_cone_50k.toml, thinned or at its full length; limits as in the job. The plain
solution solves the same pose equations of the same loaded chain for each waypoint by scipy.optimize.least_squares,
with their exact derivatives, started at the waypoint's uncorrected joint positions; it is timed on a sample of
waypoints spread over the path. Ratios compare figures of one run on one machine.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from compplan.job.job import load_job
from compplan.planning.evaluate import evaluate_run
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.strategies import command_path
from compplan.planning.task import PlanTask
from compplan.simulation.simulated_robot import build_simulated_robot
from compplan.statics.sensitivity import attain_pose
from compplan.toolpath.toolpath import select_waypoints

JOB = Path(__file__).parents[1] / "paths" / "isf_cone_50k.toml"


def make_task(count: int) -> PlanTask:
    """Prepare the cone with about `count` waypoints."""
    robot, nominal, options = prepare_job(load_job(JOB))
    cut = np.flatnonzero(~nominal.rapid)
    chosen = np.unique(np.linspace(0, len(cut) - 1, min(count, len(cut))).astype(int))
    thinned = select_waypoints(nominal, cut[chosen])
    return build_task(robot, thinned, options)


def time_program(task: PlanTask) -> dict[str, float]:
    """Time the program on a whole path and judge its command."""
    clock = time.perf_counter()
    command = command_path(task, "nlp")
    whole = time.perf_counter() - clock
    run = evaluate_run(task, command.q, build_simulated_robot(task.robot))
    n = len(task)
    return {
        "waypoints": n,
        "solver_ms": 1e3 * command.solve_time / n,
        "strategy_ms": 1e3 * whole / n,
        "max_deviation_um": 1e6 * run.max_deviation,
        "passes": command.facts["passes"],
    }


def time_plain(task: PlanTask, count: int) -> dict[str, float]:
    """Time least_squares on the same equations, waypoint by waypoint."""
    rows = np.linspace(0, len(task) - 1, count).astype(int)
    worst, clock = 0.0, time.perf_counter()
    for k in rows:
        x, y, _ = task.rotation[k].T

        def missed(q: np.ndarray, k: int = k, x: np.ndarray = x, y: np.ndarray = y) -> np.ndarray:
            there = attain_pose(task.chain, q[None], task.wrench[k : k + 1], slope=False)
            z = there.rotation[0, :, 2]
            return np.r_[there.position[0] - task.position[k], x @ z, y @ z]

        def slope(q: np.ndarray, k: int = k, x: np.ndarray = x, y: np.ndarray = y) -> np.ndarray:
            there = attain_pose(task.chain, q[None], task.wrench[k : k + 1])
            z, turn = there.rotation[0, :, 2], there.jacobian[0, 3:]
            return np.vstack([there.jacobian[0, :3], np.cross(z, x) @ turn, np.cross(z, y) @ turn])

        answer = least_squares(missed, task.q_start[k], slope, method="trf", xtol=1e-10, ftol=1e-10, gtol=1e-10)
        worst = max(worst, float(np.abs(answer.fun).max()))
    spent = time.perf_counter() - clock
    return {"waypoints": count, "plain_ms": 1e3 * spent / count, "max_missed_um": 1e6 * worst}


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[500, 5000, 50000])
    parser.add_argument("--plain", type=int, default=300, help="waypoints that the plain solution is timed on")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    plain = time_plain(make_task(options.sizes[0]), min(options.plain, options.sizes[0]))
    table = Table(title=f"ISF cone, TX200; plain least_squares: {plain['plain_ms']:.3g} ms a waypoint")
    titles = ("waypoints", "solver ms/waypoint", "strategy ms/waypoint", "passes", "deviation um", "plain / solver")
    for title in titles:
        table.add_column(title, justify="right")
    results = []
    for size in options.sizes:
        result = time_program(make_task(size))
        result["plain_over_solver"] = plain["plain_ms"] / result["solver_ms"]
        results.append(result)
        table.add_row(
            f"{result['waypoints']}",
            f"{result['solver_ms']:.3f}",
            f"{result['strategy_ms']:.3f}",
            f"{result['passes']}",
            f"{result['max_deviation_um']:.2g}",
            f"{result['plain_over_solver']:.0f}",
        )
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    growth = results[-1]["solver_ms"] / results[0]["solver_ms"]
    console = Console()
    console.print(table)
    console.print(f"solver time a waypoint, longest against shortest path: {growth:.2f}; peak memory {memory:.2f} GB")
    if options.json:
        summary = {"plain": plain, "program": results, "growth": growth, "peak_memory_GB": memory}
        options.json.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
