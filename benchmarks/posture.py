"""Postures chosen by compplan against the CAM default and against brute force.

Run `python -m benchmarks posture --out posture.json` (12 jobs; `--jobs 0 5` for some, `--place` for more).

For every job: the 95 % deviation that remains after compensation under 10 % error of the wrench and 10 % of every
compliance, with the CAM default (one configuration, tool x fixed in the part), with the accurate preset, and with the
part placed by compplan; and the optimum of a brute force over all configurations and rotations in steps of 1 degree.
The brute force and all figures of the table come from Jacobians of Pinocchio: they share no cost code with the search.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.ndimage import minimum_filter1d

from benchmarks.posture_cases import Array, Case, list_cases
from compplan.errors import CompplanError
from compplan.job.job import Job
from compplan.job.loading import load_nominal
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.configuration import choose_posture
from compplan.planning.posture.lattice import orient_tool, pick_stations
from compplan.planning.posture.settings import read_settings
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import Robot
from compplan.simulation.exact import ExactRobot
from compplan.statics.ik import build_arm, solve_branches
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath

#: Errors of wrench and compliance, samples, stations and steps of the brute force.
ERROR, SAMPLES, STATIONS, STEP = 0.1, 1000, 80, np.radians(1.0)
#: Limits of the search that the brute force keeps too.
ROOM, SINGULAR, WINDOW = np.radians(2.0), 0.03, 30


def judge_columns(judge: ExactRobot, q: Array, wrench: Array) -> tuple[Array, Array]:
    """Return by Pinocchio what the errors leave at the tip, (n, 3, errors) [m], and joint Jacobians (n, 6, nq)."""
    data, elastic = judge.model.createData(), judge.elastic
    linear = np.empty((len(q), 6, judge.model.nv))
    for i in range(len(q)):
        configuration = judge.commanded @ q[i] + judge.shift
        linear[i] = pin.computeFrameJacobian(
            judge.model, data, configuration, judge.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
    springs = linear[:, :, elastic]
    bend = np.einsum("nij,ni->nj", springs, wrench) @ judge.compliance
    by_spring = springs[:, :3] * bend[:, None]
    yielding = springs[:, :3] @ judge.compliance @ np.swapaxes(springs, 1, 2)
    by_wrench = yielding * wrench[:, None]
    return ERROR * np.concatenate([by_spring, by_wrench], axis=2), linear @ judge.commanded


def mean_square(case: Case, q: Array, rows: Array, share: Array) -> float:
    """Return the expected square of the remaining deviation over the cut. [mm^2]"""
    columns = judge_columns(case.judge, q[rows], _wrench(case)[rows])[0]
    return float(1e6 * (share * (columns**2).sum(axis=(1, 2))).sum())


def quantile(case: Case, q: Array, nominal: Toolpath, rows: Array, share: Array) -> float:
    """Return the 95 % value of the remaining deviation, over errors and cut together. [mm]"""
    wrench = np.zeros((len(q), 6)) if nominal.wrench is None else nominal.wrench
    columns = judge_columns(case.judge, q[rows], wrench[rows])[0]
    errors = np.random.default_rng(5).standard_normal((columns.shape[2], SAMPLES))
    lengths = np.linalg.norm(columns @ errors, axis=1)
    order = np.argsort(lengths, axis=None)
    mass = np.cumsum((share[:, None] / SAMPLES * np.ones(SAMPLES)).ravel()[order])
    return float(1e3 * lengths.ravel()[order[np.searchsorted(mass, 0.95)]])


def cut_stations(nominal: Toolpath) -> tuple[Array, Array]:
    """Return stations of the cut and the share that each stands for."""
    rows = pick_stations(nominal, STATIONS)
    along = np.r_[0.0, np.cumsum(np.where(nominal.rapid[1:], 0.0, nominal.steps))][rows]
    share = np.gradient(along)
    share[nominal.rapid[rows] & (share < 1e-9)] = 0.0
    return rows[share > 0], share[share > 0] / share[share > 0].sum()


def brute_force(case: Case, rows: Array, share: Array) -> float:
    """Return the least mean square over all configurations and rotations in steps of 1 degree. [mm^2]

    Bellman's recursion; a rotation may turn by up to 30 degrees between stations. Joint steps are not limited, so the
    figure is a lower bound of what a continuous motion in one configuration can reach.
    """
    arm, robot, wrench = build_arm(case.robot), case.robot, _wrench(case)
    count = round(2 * np.pi / STEP)
    spins = np.tile(np.arange(count) * STEP, (len(rows), 1))
    rotation = orient_tool(case.nominal, case.job.tool_x_base, rows, spins, 0 * spins, 0 * spins)
    position = np.repeat(case.nominal.position[rows], count, axis=0)
    q = solve_branches(arm, position, rotation.reshape(-1, 3, 3))
    q = _inside(q, robot)
    cost = np.full(q.shape[:2], np.inf)
    node = np.nonzero(np.isfinite(q[..., 0]))
    station = node[0] // count
    columns, joints = judge_columns(case.judge, q[node], wrench[rows[station]])
    scaled = joints.copy()
    scaled[:, :3] /= _balance(case.judge, robot)
    singular = np.linalg.svd(scaled, compute_uv=False)
    dexterity = 6.0 / np.sqrt((singular**2).sum(axis=1) * (1.0 / np.maximum(singular, 1e-12) ** 2).sum(axis=1))
    cost[node] = np.where(dexterity > SINGULAR, 1e6 * (columns**2).sum(axis=(1, 2)), np.inf)
    cost = cost.reshape(len(rows), count, -1) * share[:, None, None]
    value = cost[0]
    for here in cost[1:]:
        value = here + minimum_filter1d(value, 2 * WINDOW + 1, axis=0, mode="wrap")
    return float(value.min())


def cam_default(case: Case) -> tuple[Array, float] | None:
    """Follow the path in one configuration, tool x fixed in the part: the first of x, y, -x, -y that leads along."""
    for turn in (0.0, 90.0, 180.0, 270.0):
        x = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0.0])
        rotation = tool_axes(case.nominal, case.job.T_base_part[:3, :3] @ x)
        try:
            posture = choose_posture(case.robot, case.nominal.position, rotation)
        except CompplanError:
            continue
        if not posture.missed.any() and np.abs(np.diff(posture.q, axis=0)).max() < 0.35:
            return posture.q, turn
    return None


def run_case(case: Case, place: bool) -> dict[str, Any]:
    """Run one job; return its row."""
    rows, share = cut_stations(case.nominal)
    default = cam_default(case)
    clock = time.perf_counter()
    stance = _choose(case, case.job)
    spent = time.perf_counter() - clock
    optimum = brute_force(case, rows, share)
    ours = mean_square(case, stance.q, rows, share)
    row: dict[str, Any] = {
        "job": case.name, "angle_deg": case.angle, "waypoints": len(case.nominal), "graph_s": round(spent, 2),
        "accurate_mm": quantile(case, stance.q, case.nominal, rows, share),
        "rms_mm": float(np.sqrt(ours)), "brute_force_rms_mm": float(np.sqrt(optimum)),
        "to_optimum": float(np.sqrt(ours / optimum)),
    }  # fmt: skip
    if default is not None:
        row["cam_mm"] = quantile(case, default[0], case.nominal, rows, share)
        row["cam_tool_x_deg"] = default[1]
        row["ratio"] = row["accurate_mm"] / row["cam_mm"]
    if place:
        from compplan.planning.posture.place import _move_job, place_part

        result = place_part(case.job, case.robot)
        moved = load_nominal(_move_job(case.job, result.position, result.turn))
        row["placed_mm"] = quantile(case, result.stance.q, moved, rows, share)
        row["placed_at_mm"] = (1e3 * result.position).round(1).tolist()
        if default is not None:
            row["placed_ratio"] = row["placed_mm"] / row["cam_mm"]
    return row


def _choose(case: Case, job: Job) -> PostureSummary:
    settings = read_settings(job, case.robot)  # what is left under load alone, as near to limits as the brute force
    settings = replace(settings, weights={"travel": 0.0}, limit_margin=ROOM)
    return choose_posture_path(case.robot, case.nominal, job.tool_x_base, settings, axes=job.T_base_part[:3, :3])


def _wrench(case: Case) -> Array:
    return np.zeros((len(case.nominal), 6)) if case.nominal.wrench is None else case.nominal.wrench


def _inside(q: Array, robot: Robot) -> Array:
    """Shift joints by full turns into the limits; what does not fit becomes NaN."""
    for shift in (-2 * np.pi, 2 * np.pi):
        moved = q + shift
        fits = (moved >= robot.lower + ROOM) & (moved <= robot.upper - ROOM)
        out = (q < robot.lower + ROOM) | (q > robot.upper - ROOM)
        q = np.where(out & fits, moved, q)
    good = ((q >= robot.lower + ROOM) & (q <= robot.upper - ROOM)).all(axis=2)
    return np.where(good[..., None], q, np.nan)


def _balance(judge: ExactRobot, robot: Robot) -> float:
    """Return the length that balances linear and angular rows over random postures."""
    low, high = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = low + (high - low) * np.random.default_rng(0).random((64, robot.nq))
    joints = judge_columns(judge, q, np.zeros((64, 6)))[1]
    return float(np.sqrt((joints[:, :3] ** 2).sum() / (joints[:, 3:] ** 2).sum()))


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print the table for the README."""
    print("| job | CAM default, mm | accurate, mm | ratio | to brute force | placed, mm | ratio | graph, s |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows:
        cells = [row["job"]]
        for key, form in (("cam_mm", ".3f"), ("accurate_mm", ".3f"), ("ratio", ".2f"), ("to_optimum", ".3f"),
                          ("placed_mm", ".3f"), ("placed_ratio", ".2f"), ("graph_s", ".1f")):  # fmt: skip
            cells.append(format(row[key], form) if key in row else "–")
        print(f"| {' | '.join(cells)} |")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, nargs="*", help="numbers of the jobs, 0 to 11; all if left out")
    parser.add_argument("--place", action="store_true", help="also search the place of the part")
    parser.add_argument("--out", type=Path, help="write the rows as JSON")
    options = parser.parse_args()
    cases = list_cases()
    rows = []
    for number in options.jobs if options.jobs is not None else range(len(cases)):
        row = run_case(cases[number], options.place)
        rows.append(row)
        print(json.dumps(row), flush=True)
        if options.out:
            options.out.write_text(json.dumps({"schema": 1, "rows": rows}, indent=1))
    print_table(rows)


if __name__ == "__main__":
    main()
