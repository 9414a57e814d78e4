"""What others do with twelve redundant jobs: brute force over a grid, and random samples with the shortest path.

    python -m benchmarks.redundant_peers [--jobs rail_wave,spin_cone] [--most 3000]

*Grid*: at 40 stations every spin, lean and place of the extra axes of a dense grid with every configuration; dynamic
programming finds the way that takes least time by the programmed feed and joint velocities, motion as a tie-break.
*Samples*: as MoveIt plans a Cartesian path of a redundant arm, random ones in place of the grid and the shortest way in
joint space. Neither prunes, neither is smoothed; between stations the choice goes over linearly and the arm is solved
for every waypoint. Timed and judged as `benchmarks.results.redundant` does with the others. Inverse kinematics are
compplan's, the search is not. PyRoki runs where its package is installed: it is not here.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.redundant_jobs import JOBS, write_job
from benchmarks.results.redundant import Row, measure_task, show
from compplan.job.job import Job, check_job
from compplan.plan.plan import PlanOptions, _state_task, prepare_job
from compplan.posture.initial_branches import Start
from compplan.posture.lattice import orient_tool, pick_stations
from compplan.robot import Robot
from compplan.statics.chain import build_chain
from compplan.statics.ik import build_arm, pose_error, refine_ik, solve_branches
from compplan.toolpath.toolpath import Toolpath, interpolate

Array = NDArray[np.float64]
#: Stations, nodes at most at each, greatest motion of a turning joint from one to the next. [1, 1, rad]
STATIONS, NODES, MOST = 40, 3000, 1.2
#: Between two waypoints a joint that goes farther was torn: another branch or full turn. [rad or m]
TORN = 1.0
#: What a radian (or metre) of motion costs beside a second.
TIE = 1e-3


def draw_choices(robot: Robot, lean: tuple[float, float], count: int, seed: int | None) -> Array:
    """Return spin, lead, lean and extra axes of `count` nodes, on a grid without a seed. Shape (g, 3 + h). [rad, m]."""
    arm = build_arm(robot)
    low = np.r_[-np.pi, -np.array(lean), robot.lower[arm.held]]
    high = np.r_[np.pi, np.array(lean), robot.upper[arm.held]]
    if seed is not None:
        return np.random.default_rng(seed).uniform(low, high, (count, len(low)))
    shares = np.where(high > low, [8.0, 1.0, 1.0, *[8.0] * len(arm.held)], 0.0)  # spins and places are cut most finely
    scale = (count / np.prod(shares[shares > 0.0])) ** (1.0 / (shares > 0.0).sum())
    sizes = np.maximum(np.round(shares * scale), 1).astype(int)
    axes = [np.linspace(a, b, n, endpoint=k > 0) if n > 1 else np.array([0.5 * (a + b)])
            for k, (a, b, n) in enumerate(zip(low, high, sizes, strict=True))]  # fmt: skip
    return np.stack([each.ravel() for each in np.meshgrid(*axes, indexing="ij")], axis=1)


def find_way(
    robot: Robot, nominal: Toolpath, tool_x: Array, choices: Array, *, timed: bool
) -> tuple[NDArray[np.int_], Array, Array]:
    """Find stations (k,), choice (k, c) and joint positions (k, nq) of the cheapest way.

    Raises:
        ValueError: If none leads through.

    """
    arm, stations = build_arm(robot), pick_stations(nominal, STATIONS)
    feed = np.r_[0.0, np.cumsum(np.where(nominal.rapid[1:], 0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9)))]
    layers: list[Array] = []
    owners: list[NDArray[np.int_]] = []
    costs: list[Array] = []
    backs: list[NDArray[np.int_]] = []
    for k, row in enumerate(stations):
        turned = orient_tool(nominal, tool_x, np.array([row]), *choices[None, :, :3].transpose(2, 0, 1))[0]
        place = np.repeat(nominal.position[[row]], len(choices), axis=0)
        q = solve_branches(arm, place, turned, choices[:, 3:])
        keep = np.isfinite(q).all(axis=2) & (q >= robot.lower).all(axis=2) & (q <= robot.upper).all(axis=2)
        owner, slot = np.nonzero(keep)
        if not len(owner):
            raise ValueError(f"no posture at waypoint {row}")
        here, cost, back = q[owner, slot], np.zeros(len(owner)), np.zeros(len(owner), int)
        if k:
            need = feed[row] - feed[stations[k - 1]]
            cost, back = _step(robot, layers[-1], costs[-1], here, need if timed else None)
            if not np.isfinite(cost).any():
                raise ValueError(f"no way to waypoint {row}")
        layers.append(here)
        owners.append(owner)
        costs.append(cost)
        backs.append(back)
    at, way = int(costs[-1].argmin()), []
    for back in reversed(backs):
        way.append(at)
        at = int(back[at])
    way.reverse()
    return (stations, choices[[owner[i] for owner, i in zip(owners, way, strict=True)]],
            np.stack([layer[i] for layer, i in zip(layers, way, strict=True)]))  # fmt: skip


def _step(
    robot: Robot, before: Array, cost: Array, here: Array, need: float | None
) -> tuple[Array, NDArray[np.int_]]:
    """Return the least cost of every node and the node before it; `need` is the time [s] that the feed takes."""
    least, back = np.empty(len(here)), np.empty(len(here), int)
    for at, node in enumerate(here):
        away = np.abs(before - node)
        if need is None:
            price = np.linalg.norm(away, axis=1)
        else:
            price = TIE * away.sum(axis=1) + np.maximum((away / robot.velocity_limits).max(axis=1), need)
        price = np.where((away[:, ~robot.prismatic] < MOST).all(axis=1), price + cost, np.inf)
        back[at] = price.argmin()
        least[at] = price[back[at]]
    return least, back


def plan_way(job: Job, *, seed: int | None, most: int) -> Row:
    """Plan a job by grid or samples, measured as the others are."""
    robot, nominal, options = prepare_job(job)
    clock = time.process_time()
    lean = (np.radians(job.posture.lead_deg), np.radians(job.posture.lean_deg))
    choices = draw_choices(robot, lean, most // 8, seed)
    stations, chosen, q = find_way(robot, nominal, np.asarray(options.tool_x, float), choices, timed=seed is None)
    task_start = follow_way(robot, nominal, options, stations, chosen, q)
    task = _state_task(robot, build_chain(robot), options, task_start)
    return measure_task(task, robot, job, options, time.process_time() - clock)


def follow_way(
    robot: Robot, nominal: Toolpath, options: PlanOptions, stations: NDArray[np.int_], chosen: Array, q: Array
) -> Start:
    """Follow a way at every waypoint: the choice goes over linearly, the spin the shorter way round."""
    arm, every = build_arm(robot), np.arange(len(nominal))
    chosen = np.column_stack([np.unwrap(chosen[:, 0]), chosen[:, 1:]])
    between = interpolate(every, stations, chosen)
    rotation = orient_tool(nominal, np.asarray(options.tool_x, float), every, *between[:, :3].T)
    near = interpolate(every, stations, q)
    near[:, arm.held] = between[:, 3:]
    found = refine_ik(arm, near, nominal.position, rotation)
    missed = np.abs(pose_error(arm.chain, found, nominal.position, rotation)).max(axis=1) > 1e-6
    missed |= ((found < robot.lower) | (found > robot.upper)).any(axis=1)
    missed[1:] |= np.abs(np.diff(found, axis=0)).max(axis=1) > TORN
    leaning = np.abs(between[:, 1:3]).max() > 0.0
    path = replace(nominal, axis=-rotation[:, :, 2]) if leaning else nominal
    return Start(path, found, rotation, {}, missed)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--jobs", default=",".join(JOBS))
    parser.add_argument("--most", type=int, default=NODES, help="nodes of a station at most")
    given = parser.parse_args()
    print(f"PyRoki: {'found, but not driven by this benchmark' if find_spec('pyroki') else 'not installed, not run'}")
    print("job: cycle s / promise mm / turns / CPU s of grid; of samples")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.jobs.split(","):
            job, rows = check_job(write_job(name, Path(folder)), Path(folder) / "job.toml"), []
            for seed in (None, 0):
                try:
                    rows.append(show(plan_way(job, seed=seed, most=given.most)))
                except ValueError as error:
                    rows.append(str(error))
            print(f"{name}: {'; '.join(rows)}", flush=True)


if __name__ == "__main__":
    main()
