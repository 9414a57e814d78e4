"""One small job of the program of posture and speed, and how much of each of its limits the solution uses.

    python -m benchmarks nlp_limits [--out docs/concepts]

A circle with waves on a stretch, beside a rail: spin, lead, lean, rail and the place in the tube are free. The
program is solved once from the graph's posture, for time alone. Shares are worked out anew at its
stations from joints and speeds.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.plan_check.job import Array
from compplan.io.palette import CATEGORIES, NEUTRAL
from compplan.job.job import check_job
from compplan.plan.feed import FeedRequest, TorqueRules
from compplan.plan.freedom import Freedom, find_freedom
from compplan.plan.ground import state_ground
from compplan.plan.one_program import Point, Prices, build_program
from compplan.plan.plan import build_task, prepare_job
from compplan.plan.program_step import solve_program
from compplan.plan.run_meter import RunMeter
from compplan.uncertainty.sensitivities import read_force_spread

#: A constraint counts as active from this share on.
ACTIVE = 0.98
JOB: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr240_rail", "part": {"position_mm": [1590.0, 300.0, 600.0]},
    "process": {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"},
    "plan": {"tolerance_mm": 0.5, "inertia": False}, "sampling": {"chord_mm": 0.3},
    "tolerance": {"normal_mm": 2.0, "tangential_mm": 10.0},
    "posture": {"lead_deg": 1.0, "lean_deg": 1.0, "spin_step_deg": 60.0},
    "limits": {"velocity_scale": 0.3, "acceleration_scale": 0.5},
}  # fmt: skip
#: Effort limits of the job as shares of the robot folder's, so that torque counts, and share of the tolerance.
EFFORT, TUBE = 0.58, 0.5
#: Lower end of joint_4, narrowed so that joint range counts, as soft limits of a cell are. [rad]
SOFT = {"joint_4": -3.61}
#: Circle, its waves (across, from crest to crest, middle and half length of the stretch), and its feed. [mm, mm/s]
RADIUS, WAVES, FEED = 250.0, (3.0, 62.8, 600.0, 120.0), 600.0


class Solved(NamedTuple):
    """The program's start and solution, and what was free."""

    freedom: Freedom
    start: Point
    point: Point
    lower: Array
    upper: Array


def write_path(file: Path) -> None:
    """Write the toolpath of the job."""
    angle = np.linspace(0.0, 2.0 * np.pi, 241)
    across, length, middle, half = WAVES
    wave = across * np.sin(2.0 * np.pi * RADIUS * angle / length) * np.exp(-(((RADIUS * angle - middle) / half) ** 8))
    x, y = (RADIUS + wave) * np.array([np.cos(angle), np.sin(angle)])
    rows = [f"{a:.6f},{b:.6f},0,0,0,1,{FEED}" for a, b in zip(x, y, strict=True)]
    file.write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_s", *rows]) + "\n", encoding="utf-8")


def solve_job() -> Solved:
    """Solve the program of the job once, from the graph's posture.

    Raises:
        RuntimeError: If the job leaves no program.

    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "waves.csv"
        write_path(file)
        robot, nominal, options = prepare_job(check_job(JOB | {"toolpath": str(file)}, "job.toml"))
    robot = replace(robot, joints=tuple(
        replace(each, effort=EFFORT * each.effort, lower=SOFT.get(each.name, each.lower)) for each in robot.joints
    ))  # fmt: skip
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    if task.start is None or task.start.stance is None or task.start.request is None:
        raise RuntimeError("the graph has found no posture for the job")
    free = find_freedom(task, task.start.stance, nominal, np.asarray(options.tool_x, float), 100, TUBE)
    if free is None:
        raise RuntimeError("the job leaves nothing free")
    meter = RunMeter(FeedRequest(torque=True), read_force_spread(None), lambda _: task, 0.03)
    prices = Prices(most_band=np.inf)
    ground = state_ground(free, task.start.request, meter, prices)
    program = None if ground is None else build_program(free, ground, prices)
    if program is None or program.first is None:
        raise RuntimeError("the job's start cannot be followed")
    return Solved(free, program.first, solve_program(program), *program.bounds())


def measure_shares(solved: Solved) -> dict[str, Array]:
    """Measure which share of each limit is used at the stations of the solution. Shapes (k,)."""
    free, _, point, lower, upper = solved
    task, q, values = free.task, point.q, dict(zip(free.names, point.values.T, strict=True))
    size = dict(zip(free.names, free.most.T, strict=True))
    shares = {name: np.abs(values[name]) / size[name] for name in ("lead", "lean")}
    ways = [np.abs(values[name]) / np.maximum(size[name], 1e-12) for name in ("ahead", "left", "up") if name in values]
    shares["tube"] = np.max(ways, axis=0)
    shares["joint range"] = (np.abs(2.0 * q - lower - upper) / (upper - lower)).max(axis=1)
    along = np.r_[0.0, np.cumsum(np.maximum(task.step_time, 1e-7))][free.rows]
    speed = np.zeros(len(q))
    speed[: len(point.speeds[0])] = point.speeds[0]
    bend = np.gradient(speed**2, along) / 2.0
    curve = CubicSpline(along, q, bc_type="natural")
    rate, change = curve(along, 1), curve(along, 2)
    a, b, c, most = TorqueRules(task.robot, q, free.wrench).rows(0, len(q) - 1, rate, change)
    x = speed[:, None] ** 2
    shares["velocity"] = (np.abs(rate) * speed[:, None] / task.velocity_limits).max(axis=1)
    shares["acceleration"] = (np.abs(change * x + rate * bend[:, None]) / task.acceleration_limits).max(axis=1)
    ahead = np.diff(speed**2, append=0.0) / np.diff(along, append=along[-1] + 1.0) / 2.0
    shares["torque"] = (np.abs(a * ahead[:, None] + b * x + c) / most).max(axis=1)
    shares["programmed feed"] = speed
    return shares


def draw_shares(shares: dict[str, Array], file: Path) -> None:
    """Draw one strip a constraint along the path, active stations marked."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 0.8 * len(shares)), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    for axis, (name, share) in zip(figure.subplots(len(shares), 1, sharex=True), shares.items(), strict=True):
        place = 100.0 * np.linspace(0.0, 1.0, len(share))
        active = share >= ACTIVE
        axis.plot(place, share, color=CATEGORIES[0], linewidth=1.4)
        axis.plot(place[active], share[active], "o", color=CATEGORIES[1], markersize=4)
        axis.axhline(1.0, color=NEUTRAL, linestyle="--", linewidth=0.8)
        axis.set(ylim=(0.0, 1.15), yticks=(0.0, 1.0))
        axis.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=9)
        axis.spines[["top", "right"]].set_visible(False)
    axis.set_xlabel(f"station along the path [%] (share of each limit; dots: {ACTIVE:g} and more)")
    figure.savefig(file)


def main() -> None:
    """Solve the job, print the greatest share of each limit, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/concepts"))
    out = parser.parse_args().out
    solved = solve_job()
    shares = measure_shares(solved)
    print(f"time of the run: graph {solved.start.time:.3f} s, program {solved.point.time:.3f} s")
    print(f"{'constraint':18} {'greatest use':>12} {'station':>8}  active")
    for name, share in shares.items():
        most = float(share.max())
        print(f"{name:18} {most:12.3f} {int(share.argmax()):8d}  {'yes' if most >= ACTIVE else 'no'}")
    draw_shares(shares, out / "nlp_limits.png")


if __name__ == "__main__":
    main()
