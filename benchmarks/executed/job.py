"""Drawn cells: a controller, its traces, what compplan makes of them, and jobs that are planned with that and executed.

compplan is asked by its commands alone, in this process (starting one takes as long as most of them do).
"""

from __future__ import annotations

import json
import shutil
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import tomli_w
from scipy.spatial import cKDTree

from benchmarks.executed.controller import STEP, Block, Controller, draw_controller, execute
from benchmarks.executed.programs import read_cut
from benchmarks.plan_check.cell import Kinematics, SimulatedRobot
from benchmarks.plan_check.drawn import draw_posture, reach_of, turn_of
from benchmarks.plan_check.job import ROBOTS, Job, Rows, read_job, read_joints
from benchmarks.plan_check.paths import write_toolpath
from benchmarks.plan_check.robot import Arm, Array, read_arm

#: Robots of each make that cells are drawn from.
CELLS = {
    "rapid": ("abb_irb4600_60_205", "abb_irb1600_8_145"),
    "krl": ("kuka_kr240", "kuka_kr16_2"),
    "urscript": ("ur10e", "ur5e"),
}
#: Feeds of the two traces, and of logs that are held against the model: one repeats, two are other speeds [m/s].
TRACED, OTHERS = (0.04, 0.09), (0.04, 0.065, 0.12)
#: Half the box about a tip that an arm has to reach [m].
BOX = 0.15
#: Zone of the traced programs [m], corners of a trace and the way between two [m].
ZONE, CORNERS, SIDES = 2e-3, 24, (0.008, 0.02)
#: Noise of a reading [rad], cycle of a log [s], share of its rows that are torn.
NOISE, LOGGED, TORN = 2e-6, 0.004, 0.01
#: Feeds [mm/s] and tolerances [mm] of jobs, powers of ten of both; force [N], corners, and the way between them [mm].
FEED, TOLERANCE, FORCE, BENDS, LEGS = (1.0, 1.9), (-0.9, -0.2), 80.0, (3, 6), (10.0, 35.0)
#: Length at both ends of a cut where the force comes and goes, which is not judged [m]; samples of the tip [s].
ENDS, SAMPLE = 1.5e-3, 5e-3


@dataclass(frozen=True)
class Equipment:
    """A robot under a drawn controller; `folder` is the robot folder that compplan has of it."""

    make: str
    arm: Arm
    control: Controller
    folder: Path
    posture: Array
    pose: Array


def draw_shop(folder: Path, seed: int) -> Equipment:
    """Draw a robot, its controller, and where it works."""
    rng = np.random.default_rng([seed, 320])
    make = tuple(CELLS)[seed % len(CELLS)]
    name = str(rng.choice(CELLS[make]))
    shutil.copytree(ROBOTS / name, folder / name, dirs_exist_ok=True)
    arm = read_arm(folder / name)
    posture, pose = _draw_place(rng, arm)
    return Equipment(make, arm, draw_controller(seed, len(arm.commanded), make), folder / name, posture, pose)


def _draw_place(rng: np.random.Generator, arm: Arm) -> tuple[Array, Array]:
    """Draw a posture from which the arm reaches a box about its tip, and whose wrist is bent."""
    box = np.stack(np.meshgrid(*[[-BOX, BOX]] * 3), axis=-1).reshape(-1, 3)
    while True:
        found = draw_posture(rng, arm)
        bent = found is not None and abs(np.sin(found[0][-2])) > 0.4
        if found is None or not bent or np.linalg.norm(found[1][:3, 3]) > 0.7 * reach_of(arm):
            continue
        poses = np.tile(found[1], (len(box), 1, 1))
        poses[:, :3, 3] += box @ found[1][:3, :3].T
        if Kinematics(arm).reach(np.tile(found[0], (len(box), 1)), poses, rounds=40)[1].max() < 1e-8:
            return found


def identify_shop(shop: Equipment, seed: int, place: Path) -> tuple[Path, dict]:
    """Log two paths, let `compplan trace` identify the controller; return its robot folder and what it says."""
    programs, logs = [], []
    for k, feed in enumerate(TRACED):
        poses = draw_trace(shop.pose, [seed, k])
        programs.append(write_program(place / f"path{k}.csv", shop, poses, shop.posture, feed))
        logs.append(write_log(place / f"log{k}.csv", *run_trace(shop, poses, shop.posture, feed), [seed, k, 7]))
    words = ["trace", *logs]
    for program in programs:
        words += ["--program", program]
    run_command([*words, "--robot", shop.folder, "--out", place / "trace"])
    return place / "trace" / "robot", json.loads((place / "trace" / "trace.json").read_text(encoding="utf-8"))


def compare_logs(shop: Equipment, seed: int, folder: Path, place: Path) -> list[dict]:
    """Hold the model against logs that it was not fitted to; one entry a log, distances across the path in mm."""
    found = []
    rng = np.random.default_rng([seed, 321])
    cases = [("speed", shop.pose, shop.posture, [seed, 0], feed) for feed in OTHERS]
    cases.append(("path", shop.pose, shop.posture, [seed, 5], 0.08))
    posture, pose = _draw_place(rng, shop.arm)
    cases.append(("posture", pose, posture, [seed, 6], 0.08))
    for number, (kind, pose, posture, which, feed) in enumerate(cases):
        poses = draw_trace(pose, which)
        program = write_program(place / f"held{number}.csv", shop, poses, posture, feed)
        run_command(["execute", program, "--robot", folder, "--out", place / "executed.csv"])
        table = np.genfromtxt(place / "executed.csv", delimiter=",", names=True)
        model = 1e-3 * np.stack([table[f"{axis}_mm"] for axis in "xyz"], axis=1)
        _, q = run_trace(shop, poses, posture, feed)
        tip = Kinematics(shop.arm).tip(q[:: round(LOGGED / STEP)])[:, :3, 3]
        tip = tip[np.r_[True, np.linalg.norm(np.diff(tip, axis=0), axis=1) > 1e-6]]
        sizes = [measure_beside(path, tip) for path in (poses[:, :3, 3], model)]
        none, left = ((float(np.median(size)), float(np.percentile(size, 95))) for size in sizes)
        found.append({"kind": kind, "feed": feed, "none": none, "left": left})
    return found


def draw_trace(pose: Array, seed: list[int]) -> Array:
    """Draw the corners of a wandering path about a pose, across the tool and a little along it. Shape (n, 4, 4)."""
    rng = np.random.default_rng([*seed, 322])
    heading = np.cumsum(rng.uniform(-1.5, 1.5, CORNERS))
    legs = rng.uniform(*SIDES, CORNERS)[:, None] * np.stack(
        [np.cos(heading), np.sin(heading), 0.2 * rng.uniform(-1.0, 1.0, CORNERS)], axis=1
    )
    points = np.vstack([np.zeros(3), np.cumsum(legs, axis=0)])
    points -= points.mean(axis=0)
    poses = np.tile(pose, (len(points), 1, 1))
    poses[:, :3, 3] += points @ pose[:3, :3].T
    return poses


def run_trace(shop: Equipment, poses: Array, posture: Array, feed: float) -> tuple[Array, Array]:
    """Execute a traced program; return times and joints of the drives."""
    zones = [*[ZONE] * (len(poses) - 2), 0.0]
    blocks = [Block(pose, feed, zone) for pose, zone in zip(poses[1:], zones, strict=True)]
    return execute(shop.arm, posture, poses[0], blocks, shop.control)


def write_program(file: Path, shop: Equipment, poses: Array, posture: Array, feed: float) -> Path:
    """Write PROGRAM.csv: begin in a posture, then lines."""
    first = Kinematics(shop.arm).reach(posture[None], poses[:1], rounds=40)[0][0]
    lines = ["move,x_mm,y_mm,z_mm,i,j,k," + ",".join(f"q{j}_deg" for j in range(1, 7)) + ",feed_mm_s,zone_mm"]
    for k, pose in enumerate(poses):
        place = ",".join(f"{value:.9f}" for value in [*(1e3 * pose[:3, 3]), *(-pose[:3, 2])])
        bent = ",".join(f"{value:.9f}" for value in np.degrees(first)) if k == 0 else ",,,,,"
        zone = 0.0 if k in (0, len(poses) - 1) else 1e3 * ZONE
        lines.append(f"{'line' if k else 'joint'},{place},{bent},{1e3 * feed:g},{zone:g}")
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def write_log(file: Path, time: Array, q: Array, seed: list[int]) -> Path:
    """Write LOG.csv: noise, rows with one joint a cycle older, a clock of its own."""
    rng = np.random.default_rng([*seed, 323])
    at = np.arange(0.0, time[-1], LOGGED)
    now, old = (np.stack([np.interp(t, time, column) for column in q.T], axis=1) for t in (at, at - LOGGED))
    torn = np.flatnonzero(rng.random(len(at)) < TORN)
    joint = rng.integers(0, q.shape[1], len(torn))
    now[torn, joint] = old[torn, joint]
    now += NOISE * rng.standard_normal(now.shape)
    table = np.column_stack([at + rng.uniform(0.0, 100.0), np.degrees(now)])
    header = "time_s," + ",".join(f"q{j}_deg" for j in range(1, q.shape[1] + 1))
    np.savetxt(file, table, delimiter=",", comments="", fmt="%.7f", header=header)
    return file


def measure_beside(path: Array, tip: Array) -> Array:
    """Return how far tips lie from a polyline. Shape (n,). [mm]"""
    edge = np.diff(path, axis=0)
    size = np.maximum((edge**2).sum(axis=1), 1e-24)
    best = np.full(len(tip), np.inf)
    count = min(60, len(path))
    _, near = cKDTree(path).query(tip, k=count)
    for k in range(count if len(path) <= 400 else 8):  # every piece of a short path, those by the nearest points else
        for piece in (near[:, k] - 1, near[:, k]):
            i = np.clip(piece, 0, len(edge) - 1)
            u = np.clip(((tip - path[i]) * edge[i]).sum(axis=1) / size[i], 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(tip - path[i] - u[:, None] * edge[i], axis=1))
    return 1e3 * best


def run_job(shop: Equipment, folder: Path, seed: int, place: Path) -> dict:
    """Draw a job, plan it with a robot folder, execute what was written, hold the loaded tip against the CAM path."""
    file = write_job(shop, folder, seed, place)
    said = run_command(["plan", file, "--out", place / "out"])
    plan = json.loads((place / "out" / "plan.json").read_text(encoding="utf-8"))
    job = read_job(file)
    rows = read_joints(place / "out" / "joints.csv", job.arm)
    start, blocks = read_cut(place / "out", shop.make)
    begin = int(np.linalg.norm(rows.wanted - start[:3, 3], axis=1).argmin())
    time, q = execute(job.arm, rows.q[begin], start, blocks, shop.control)
    off = measure_loaded(job, rows, q)
    executed = plan.get("executed_mm", {})
    return {
        "status": plan["status"], "tolerance": 1e3 * job.tolerance, "said": executed.get("max"),
        "led": executed.get("lag_led"), "executed": float(off.max()), "p95": float(np.percentile(off, 95)),
        "blocks": len(blocks), "duration": float(time[-1]), "planned": plan["duration_s"], "exit": said,
    }  # fmt: skip


def write_job(shop: Equipment, folder: Path, seed: int, place: Path) -> Path:
    """Write a job: lines between corners, a force, a feed and a tolerance, near where the controller was traced."""
    rng = np.random.default_rng([seed, 324])
    heading = np.cumsum(rng.uniform(-2.2, 2.2, int(rng.integers(*BENDS))))
    legs = rng.uniform(*LEGS, len(heading))[:, None] * np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    corners = np.vstack([np.zeros(3), np.cumsum(legs, axis=0)])
    tip = [corners[:1]]
    for a, b in pairwise(corners):
        count = int(np.ceil(np.linalg.norm(b - a)))
        tip.append(a + (b - a) * np.linspace(0.0, 1.0, count + 1)[1:, None])
    feed, tolerance = (round(float(10.0 ** rng.uniform(*span)), 3) for span in (FEED, TOLERANCE))
    points = np.vstack(tip) - corners.mean(axis=0)
    write_toolpath(place / "job.csv", points, feed, np.tile([0.0, 0.0, 1.0], (len(points), 1)), lift=20.0)
    turn = shop.pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    at = 1e3 * shop.pose[:3, 3] + rng.uniform(-60.0, 60.0, 3)
    force = FORCE * rng.uniform(0.0, 1.0) * rng.standard_normal(3)
    table = {
        "schema": 1, "name": f"executed_{seed}", "robot": str(folder.resolve()), "toolpath": "job.csv",
        "part": {"position_mm": at.round(3).tolist(), "rotation_deg": turn_of(turn).round(6).tolist(),
                 "touched_off": False},
        "process": {"model": "constant", "force_N": force.round(2).tolist(), "frame": "base"},
        "plan": {"tolerance_mm": tolerance}, "output": {"programs": [shop.make]},
    }  # fmt: skip
    (place / "job.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    return place / "job.toml"


def measure_loaded(job: Job, rows: Rows, q: Array) -> Array:
    """Return how far the loaded tip lies from the CAM path while it cuts, its ends left out. Shape (n,). [mm]"""
    every = round(SAMPLE / STEP)
    smooth = np.stack([np.convolve(column, np.full(9, 1.0 / 9.0), mode="same") for column in q.T], axis=1)
    smooth[:5], smooth[-5:] = q[:5], q[-5:]
    rate = np.gradient(smooth, STEP, axis=0)
    change = np.gradient(rate, STEP, axis=0)
    change[:10] = change[-10:] = 0.0
    wanted = cKDTree(rows.wanted)
    near = wanted.query(Kinematics(job.arm).tip(q[::every])[:, :3, 3])[1]
    rest = SimulatedRobot(job.arm).rest(q[::every], rows.wrench[near], rate=rate[::every], change=change[::every])
    cut = np.flatnonzero(~job.path.rapid)
    path = job.path.position[cut[0] - 1 : cut[-1] + 1]
    inner = np.ones(len(near), bool)
    for end in (path[0], path[-1]):
        inner &= np.linalg.norm(rest.position - end, axis=1) > ENDS
    return measure_beside(path, rest.position[inner])


def run_command(words: list[object]) -> int:
    """Run a command of compplan in this process; return its exit status."""
    from compplan.cli import main

    argv, sys.argv = sys.argv, ["compplan", *(str(word) for word in words)]
    said = StringIO()
    try:
        with redirect_stdout(StringIO()), redirect_stderr(said):
            main()
    except SystemExit as leaving:
        status = int(leaving.code or 0)
        if status not in (0, 3):
            raise RuntimeError(said.getvalue().strip()[-500:]) from leaving
        return status
    finally:
        sys.argv = argv
    return 0
