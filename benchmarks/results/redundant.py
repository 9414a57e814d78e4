"""Twelve redundant jobs: one program beside iterated mirror and the fastest run, at the CAM posture and the graph's."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.redundant_jobs import JOBS, write_job
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table
from compplan.job.job import Job, check_job
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.inertia import measure_motion
from compplan.planning.measured_runs import BAND_ROWS, ease_run, measure_runs, spread_tip
from compplan.planning.plan import PlanOptions, _state_task, build_task, prepare_job
from compplan.planning.posture.settings import PostureProblem
from compplan.planning.redundancy import PathRequest
from compplan.planning.task import PlanTask
from compplan.robot import Robot
from compplan.simulation.vibration import build_dynamics
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.band import band_radius
from compplan.uncertainty.motion import spread_draws
from compplan.uncertainty.sensitivities import pick_rows, read_force_spread

TITLE = "Redundant jobs: time, posture and correction in one program"
QUESTION = (
    "On jobs that leave the arm a choice (rail, free spin, leans of 10 degrees, rounded corners), "
    "what does one program of posture and speed bring beside iterated mirror compensation and the fastest run?"
)
METHOD = (
    "`benchmarks/redundant_jobs.py` holds the jobs. Cells: cycle in s, widest 95 % band in mm with vibration. "
    "*CAM posture*: the job's configuration and tool x. *Graph*: posture of the ladder graph, as mirror gets it; "
    "*eased*: slower where the arm vibrates most, as the program is. *Program*: the default of `compplan plan`. "
    "All timed by TOPP-RA with the smoothing of plans, before correction."
)
CHART = Chart("95 % band, mm", {
    way: (way, 1) for way in ("CAM posture", "graph", "program", "error_band", "fast")
}, log=True)  # fmt: skip
LIMITS = (
    "Robots are models; force, lost motion and most uncertainties are assumed, and so is the band.",
    "The author of the program also chose the jobs and fitted the weights of its second solution to them. The joints"
    " cannot reach all feeds. No MoveIt, no PyRoki.",
    "The tool of `spin_frame` and `spin_small` lies along joint 6, so spin turns that joint alone. `spin_small` gains "
    "nothing, `spin_frame` only by the programmed direction of its tool.",
)
WAYS = ("CAM posture", "graph", "graph, eased", "program", "error_band", "fast")
PRESETS = ("error_band", "fast")


class Row(NamedTuple):
    """What one way of planning makes of a job."""

    status: str
    cycle: float
    band: float
    spent: float


def measure(settings: Settings) -> Findings:
    """Plan the jobs in every way and compare."""
    found: dict[str, dict[str, Row | str]] = {}
    for name in JOBS:
        found[name] = {}
        for way in WAYS:
            found[name][way] = _plan(name, way, settings)
            print(name, way, found[name][way], flush=True)
    rows, shorter, narrower, worse, wins, asked, slow = [], [], [], [], [], [], []
    for name, ways in found.items():
        base = min((row for way in ("CAM posture", "graph") if isinstance(row := ways[way], Row) and
                    row.status == "reached"), key=lambda row: row.cycle, default=None)  # fmt: skip
        ours, fast = ways["program"], ways["fast"]
        rows.append((f"`{name}`", *(show(ways[way]) for way in ways)))
        if base is None or not isinstance(ours, Row) or ours.status != "reached":
            worse.append(f"`{name}`: {ours if isinstance(ours, str) else ours.status}; nothing to compare")
            continue
        graph = next((row for way in ("graph, eased", "graph") if isinstance(row := ways[way], Row)), base)
        gain, narrow = 1.0 - ours.cycle / graph.cycle, 1.0 - ours.band / graph.band
        shorter.append(gain)
        narrower.append(narrow)
        wins += [name] if _wins(ours, graph) else []
        asked += [name] if _wins(ours, graph) or _wins(ways["error_band"], graph) else []
        if gain < -0.002 or narrow < -0.002:
            worse.append(f"`{name}`: cycle {100 * gain:+.1f} %, band {100 * narrow:+.1f} % gained beside the graph")
        plain = ways["CAM posture"]
        if isinstance(plain, Row) and plain.cycle < 0.998 * ours.cycle and plain.band < 0.998 * ours.band:
            worse.append(f"`{name}`: the CAM posture is shorter and narrower than the program's")
        others = [row for row in ways.values() if isinstance(row, Row) and row.status == "reached"]
        if not isinstance(fast, Row) or fast.cycle > 1.001 * min(row.cycle for row in others):
            slow.append(f"`{name}`: `fast` is not the fastest")
    head = ("job", *WAYS)
    spent = [np.median([row.spent for ways in found.values() if isinstance(row := ways[way], Row)]) for way in WAYS]
    return Findings(
        (
            f"{len(wins)} of {len(JOBS)} jobs: at least 15 % shorter at no wider band, or 25 % narrower at no "
            f"longer cycle, beside iterated mirror at the graph's posture with the same easing (aim: 9): "
            f"{', '.join(wins) or 'none'}. "
            f"With preset `error_band` where that does it: {len(asked)}"
            f"{''.join(f', {name}' for name in asked if name not in wins)}.",
            f"Cycle beside it: {100 * np.median(shorter):.1f} % shorter in the median, {100 * max(shorter):.1f} % at "
            f"most; the band {100 * np.median(narrower):.1f} % narrower in the median, "
            f"{100 * max(narrower):.1f} % at most.",
            f"Worse on {len(worse)} jobs; `fast` is the fastest on {len(JOBS) - len(slow)} of {len(JOBS)}.",
            "CPU of the choice, median: "
            + ", ".join(f"{way} {cpu:.1f} s" for way, cpu in zip(WAYS, spent, strict=True))
            + ".",
        ),
        (draw_table(head, rows),),
        (*worse, *slow, *((f"The aim of 9 jobs is missed by {9 - len(wins)}.",) if len(wins) < 9 else ())),
    )


def _wins(ours: Row | str, graph: Row) -> bool:
    """Tell whether a plan is 15 % shorter at no wider band, or a band 25 % narrower at no longer cycle."""
    if isinstance(ours, str) or ours.status != "reached":
        return False
    gain, narrow = 1.0 - ours.cycle / graph.cycle, 1.0 - ours.band / graph.band
    return (gain >= 0.15 and narrow >= -0.002) or (narrow >= 0.25 and gain >= -0.002)


def _plan(name: str, way: str, settings: Settings) -> Row | str:
    job = check_job(write_job(name, settings.work, way if way in PRESETS else ""), settings.work / "job.toml")
    robot, nominal, options = prepare_job(job)
    start = time.process_time()
    try:
        if way == "CAM posture":
            options = replace(options, strategy="iterated_mirror", posture=replace(options.posture, search=False))
        elif way.startswith("graph"):
            options = replace(options, strategy="iterated_mirror")
        task = build_task(robot, nominal, options)
        if way == "graph, eased":
            task = _ease(task, robot, nominal, options)
        return measure_task(task, robot, job, options, time.process_time() - start)
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:80]


def _ease(task: PlanTask, robot: Robot, nominal: Toolpath, options: PlanOptions) -> PlanTask:
    """Return a task with the same posture, its speed eased where the arm vibrates most."""
    force = options.force or read_force_spread(None)
    asked = PathRequest(PostureProblem(robot, nominal, np.asarray(options.tool_x, float), options.posture), force,
                  partial(_state_task, robot, task.chain, options))  # fmt: skip
    assert task.start is not None
    first = measure_runs(task.start, asked)[0]
    return asked.state(ease_run("", first, first, asked).start)


def measure_task(task: PlanTask, robot: Robot, job: Job, options: PlanOptions, spent: float) -> Row:
    """Time and judge a task before correction; `spent` is the CPU time [s] that its posture took."""
    task = resolve_starts(task)
    timing = time_run(task, task.q_start)[1]
    motion, rows = measure_motion(task, timing.time, build_dynamics(task.robot)), pick_rows(task.cut, BAND_ROWS)
    ringing = 0.0 if motion is None else spread_draws(motion.error[:, rows])
    spread = spread_tip(task, read_force_spread(job)) + ringing
    return Row("out of reach" if task.missed.any() else "reached", float(timing.time[-1]),
               1e3 * float(band_radius(spread).max()), spent)  # fmt: skip


def show(row: Row | str) -> str:
    """Show a row in a cell of the table."""
    if isinstance(row, str):
        return row
    status = "" if row.status == "reached" else f" ({row.status.replace('_', ' ')})"
    return f"{row.cycle:.2f}, {row.band:.2f}{status}"
