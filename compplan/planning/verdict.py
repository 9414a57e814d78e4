"""The judge's vote: what a plan has to show before it says "solved".

The judge reads robot folder and tool by itself (`compplan.simulation.exact_model`) and brings the loaded tool to rest
at and between waypoints. Limits are held on the timed path by differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from compplan.job.job import Job
from compplan.planning.between import Between, divide_times, insert_between, judged_moves
from compplan.planning.checks import Driven
from compplan.planning.deflection import FOLLOWED, find_runs
from compplan.planning.evaluate import Evaluation, Margins, find_part
from compplan.planning.run_timing import Timing, find_slowdown
from compplan.planning.strategies.limits import AT_CORRECTION
from compplan.planning.task import Command, PlanTask, attain_rows
from compplan.robot import Array
from compplan.simulation.exact import ExactRobot
from compplan.simulation.exact_model import read_exact_robot
from compplan.simulation.inertia import average_loads, load_springs, solve_rigid
from compplan.simulation.simulated_robot import (
    AS_MODELLED,
    SimulatedRobot,
    build_simulated_robot,
    run_simulated_robot,
    touch_cell,
)
from compplan.simulation.vibration import build_dynamics
from compplan.uncertainty.shrinkage import has_faded

#: Rounding that limits on the timed path leave.
ROUNDING = 1.001
#: Moves that the judge looks at between waypoints where there are more: the worst by the planner's model, even ones.
WORST, EVEN = 1500, 1500
#: Planner and judge place the loaded tip within a micrometre and this share of the tolerance; waypoints compared.
AGREED, AGREED_SHARE, COMPARED = 1e-6, 0.02, 400
#: A joint that moves more than this in one move of a cut changes its branch. [rad, m]
JUMP_TURN, JUMP_SLIDE = float(np.radians(20.0)), 0.2


@dataclass(frozen=True)
class Bench:
    """What the judge judges with, of its own reading: a cell, and at every waypoint the wrench and inertia's load.

    `driven` is what else is checked, None for robots and paths in memory.
    """

    cell: SimulatedRobot
    wrench: Array
    bias: Array | None = None
    driven: Driven | None = None


def set_up_bench(task: PlanTask, q: Array, timing: Timing, job: Job | None) -> Bench:
    """Read robot and tool a second time; a robot or a path in memory is taken as it is, and a faded robot."""
    if job is None or task.robot.folder is None or job.mounted is not None:
        bias = _load_springs(task, build_dynamics(task.robot).standing, timing.time) if task.inertia else None
        return Bench(find_part(task, build_simulated_robot(task.robot)), task.wrench, bias)
    tool = job.model_dump(by_alias=True, exclude_unset=True).get("tool")
    if has_faded(task.robot):  # no file holds it
        cell, moving = find_part(task, build_simulated_robot(task.robot)), build_dynamics(task.robot).standing
    else:
        cell = SimulatedRobot(AS_MODELLED, task.robot, read_exact_robot(Path(task.robot.folder), tool))
        moving = read_exact_robot(Path(task.robot.folder), tool, moving=True)
        if task.touched is not None:
            believed = read_exact_robot(Path(task.robot.folder), tool, geometry="controller.urdf")
            cell = touch_cell(cell, task.touched.q, solve_rigid(believed, task.touched.q)[0])
    bias = _load_springs(task, moving, timing.time) if task.inertia else None
    return Bench(cell, task.wrench, bias, Driven(task, q, timing.time, job, cell.judge, moving))


def _load_springs(task: PlanTask, moving: ExactRobot, time: Array) -> Array:
    """Return what the inertia of the motion puts on the springs, as far as the arm follows it: shape (n, s)."""
    rests = np.zeros(len(task), bool) if task.rests is None else task.rests
    loads = load_springs(moving, task.q_links, time, np.r_[False, ~task.nominal.rapid[1:]], rests)
    return average_loads(loads, time, find_runs(task), FOLLOWED * task.smoothing)


def find_breaches(
    task: PlanTask, command: Command, timing: Timing, between: Between, after: Evaluation, margins: Margins,
    bench: Bench,
) -> tuple[str, ...]:  # fmt: skip
    """Say in a sentence each what keeps a plan from being confirmed.

    Args:
        task: The task.
        command: The command.
        timing: Its run.
        between: Where the loaded tip goes between waypoints, by the planner's model.
        after: The command in the judge's cell.
        margins: Distance of the command from its limits.
        bench: What the judge judges with.

    """
    breaches, tolerance = [], task.tolerance
    use = np.where(after.cut, task.use_tolerance(after.deviation), 0.0)
    if use.max() > 1.0:
        worst = int(use.argmax())
        breaches.append(
            f"the independent check finds the loaded tip {_mm(after.distance[worst])} off the path at waypoint {worst}"
        )
    apart, worst = compare_models(task, command.q, after)
    if apart > AGREED + AGREED_SHARE * tolerance:
        breaches.append(
            f"the planner and the independent check place the loaded tip {_mm(apart)} apart "
            f"at waypoint {worst}: one of them misreads the robot, the tool or the load"
        )
    judged, move = evaluate_between(task, command.q, between, bench)
    strays = move >= 0 and judged > task.move_tolerance[move]
    if strays:
        breaches.append(f"the independent check finds the loaded tip {_mm(judged)} off the path after waypoint {move}")
    if (between.driven > task.move_tolerance).any() and not strays:
        move = int((between.driven / task.move_tolerance).argmax())
        breaches.append(f"between waypoints the tip strays by {_mm(between.driven[move])}, after waypoint {move}")
    slower = float((find_slowdown(task, command.q, timing.time)).max())
    ratio = max(slower, timing.velocity_ratio, timing.acceleration_ratio**0.5)
    if ratio > ROUNDING:
        breaches.append(f"a joint's velocity, acceleration or jerk passes its limit by a factor of {ratio:.3g} in time")
    if margins.position < -1e-9:
        name = task.robot.joint_names[margins.joint]
        breaches.append(f"the position limit of {name} is passed by {-margins.position:.3g} rad or m")
    if margins.max_correction > task.max_correction + 2 * AT_CORRECTION:
        breaches.append(f"the correction is {_mm(margins.max_correction)}, allowed are {_mm(task.max_correction)}")
    return tuple(breaches)


def compare_models(task: PlanTask, q: Array, after: Evaluation) -> tuple[float, int]:
    """Compare where planner and judge place the loaded tip, at some waypoints of the cut.

    Returns:
        Greatest distance [m] and its waypoint; 0 and 0 where nothing is compared.

    """
    rows = np.flatnonzero(after.cut)
    if not len(rows):
        return 0.0, 0
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, COMPARED).astype(int))]
    apart = np.linalg.norm(attain_rows(task, q, rows, slope=False).position - after.position[rows], axis=1)
    return float(apart.max()), int(rows[apart.argmax()])


def evaluate_between(task: PlanTask, q: Array, between: Between, bench: Bench) -> tuple[float, int]:
    """Let the judge bring the tool to rest halfway between waypoints, joint positions and wrench gone over linearly.

    Returns:
        Greatest distance from the moves [m], against the tolerance of each, and the waypoint that the move starts at.

    """
    moves = judged_moves(task)
    if len(moves) > WORST + EVEN:
        worst = moves[np.argsort((between.most / task.move_tolerance)[moves])[-WORST:]]
        moves = np.union1d(worst, moves[np.linspace(0, len(moves) - 1, EVEN).astype(int)])
    if not len(moves):
        return 0.0, -1
    half = [0.5 * (values[moves] + values[moves + 1]) for values in (q, bench.wrench)]
    bias = None if bench.bias is None else 0.5 * (bench.bias[moves] + bench.bias[moves + 1])
    if task.robot.effects:  # they see the whole path in order
        path, load = insert_between(q, half[0], moves, 0.5), insert_between(bench.wrench, half[1], moves, 0.5)
        more = None if bench.bias is None or bias is None else insert_between(bench.bias, bias, moves, 0.5)
        tip = run_simulated_robot(bench.cell, path, load, divide_times(task.step_time, 0.5), more).position[
            2 * moves + 1
        ]
    else:
        tip = run_simulated_robot(bench.cell, half[0], half[1], bias=bias).position
    path = task.programmed
    start, along = path[moves], path[moves + 1] - path[moves]
    square = np.maximum(np.einsum("ni,ni->n", along, along), 1e-30)
    share = np.clip(np.einsum("ni,ni->n", tip - start, along) / square, 0.0, 1.0)
    distance = np.linalg.norm(tip - start - share[:, None] * along, axis=1)
    worst_of = int((distance / task.move_tolerance[moves]).argmax())
    return float(distance[worst_of]), int(moves[worst_of])


def find_overloads(task: PlanTask, q: Array, bench: Bench) -> dict[int, str]:
    """Find waypoints whose static load is beyond the effort of a joint, and name the joint and both torques."""
    efforts = np.where(task.robot.carriers, np.inf, task.robot.effort_limits)  # nobody states what lies on a positioner
    if not np.isfinite(efforts).any():
        return {}
    rows = np.flatnonzero(task.compensated)
    if len(rows) > WORST + EVEN:
        heavy = rows[np.argsort(np.linalg.norm(bench.wrench[rows, :3], axis=1))[-WORST:]]
        rows = np.union1d(heavy, rows[np.linspace(0, len(rows) - 1, EVEN).astype(int)])
    share = np.abs(hold_load(bench.cell.judge, q[rows], bench.wrench[rows])) / np.maximum(efforts, 1e-9)
    found = {}
    for k in np.flatnonzero((share > ROUNDING).any(axis=1)).tolist():
        waypoint, j = int(rows[k]), int(share[k].argmax())
        unit = "N" if task.robot.prismatic[j] else "N m"
        name = task.robot.joint_names[j]
        found[waypoint] = f"effort limit of {name} ({efforts[j]:.4g} {unit})"
    return found


def hold_load(judge: ExactRobot, q: Array, wrench: Array) -> Array:
    """Return the torque that each commanded joint needs to hold wrench and weight, springs stiff. Shape (n, nq)."""
    data, model = judge.model.createData(), judge.model
    rigid = q @ judge.commanded.T + judge.shift
    torque = np.empty((len(q), model.nv))
    for i in range(len(q)):
        columns = pin.computeFrameJacobian(model, data, rigid[i], judge.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        torque[i] = -columns.T @ wrench[i]
        if judge.weighs:
            judge.turn_gravity(data, rigid[i])
            torque[i] += judge.weigh(data, rigid[i])
    return torque @ judge.commanded


def find_jumps(task: PlanTask, q: Array) -> dict[int, str]:
    """Find moves of the cut in which a joint jumps: the arm would change its branch in the material."""
    most = np.where(task.robot.prismatic, JUMP_SLIDE, JUMP_TURN)
    step = np.abs(np.diff(q, axis=0)) / most
    jumps = (step.max(axis=1) > 1.0) & ~task.nominal.rapid[1:] & ~task.lead[1:]
    return {
        int(move) + 1: f"jump of {task.robot.joint_names[int(step[move].argmax())]} (change of branch in the cut)"
        for move in np.flatnonzero(jumps)
    }


def _mm(length: float) -> str:
    return f"{1e3 * length:.3g} mm"
