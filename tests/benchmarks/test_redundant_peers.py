"""Brute force and random samples on redundant jobs: the way they find is the cheapest, and it is followed."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from benchmarks import redundant_peers
from benchmarks.redundant_jobs import write_job
from compplan.job.job import check_job
from compplan.plan.plan import prepare_job
from compplan.posture.lattice import orient_tool
from compplan.statics.ik import build_arm, solve_branches
from compplan.toolpath.toolpath import select_waypoints


def test_no_other_way_through_a_small_grid_is_shorter(tmp_path: Path) -> None:
    robot, nominal, options = prepare_job(check_job(write_job("spin_circle", tmp_path), tmp_path / "job.toml"))
    nominal, tool_x = select_waypoints(nominal, np.arange(4, 12, 2)), np.asarray(options.tool_x, float)
    choices = redundant_peers.draw_choices(robot, (0.0, 0.0), 5, seed=1)
    q = redundant_peers.find_way(robot, nominal, tool_x, choices, timed=False)[2]
    layers = []
    for row in range(4):
        turned = orient_tool(nominal, tool_x, np.array([row]), *choices[None, :, :3].transpose(2, 0, 1))[0]
        nodes = solve_branches(build_arm(robot), np.repeat(nominal.position[[row]], 5, axis=0), turned).reshape(-1, 6)
        layers.append(nodes[((nodes >= robot.lower) & (nodes <= robot.upper)).all(axis=1)])
    ways = (np.diff(way, axis=0) for way in product(*layers))
    least = min(np.linalg.norm(way, axis=1).sum() for way in ways if np.abs(way).max() < redundant_peers.MOST)
    assert np.linalg.norm(np.diff(q, axis=0), axis=1).sum() == pytest.approx(least)


@pytest.mark.parametrize("seed", [None, 0])
def test_grid_and_samples_reach_every_waypoint_of_a_job(seed: int | None, tmp_path: Path) -> None:
    job = check_job(write_job("spin_circle", tmp_path), tmp_path / "job.toml")
    row = redundant_peers.plan_way(job, seed=seed, most=300)
    assert row.status == "reached" and 1.5 < row.cycle < 10.0 and row.promise > 0.5
