"""Checks of a plan: name, value, limit, sentence and severity of each.

Status, notes, terminal, page and plan.json come from this list (`compplan.planning.result.Plan`). The independent check
parses the robot folder separately (`compplan.simulation.exact_model`) and solves the loaded equilibrium at and between
waypoints. Tool axis, correction, limits, effort, feed, times and inertia are computed from the commanded joints,
without the planner's code. A sentence without a figure, such as a note of a reader, is a failed check.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.quantities import state_mm
from compplan.job.job import Job
from compplan.planning.evaluate import find_part
from compplan.planning.executed import ExecutedPath
from compplan.planning.inertia import FOLLOWED
from compplan.planning.sampling import Between, cutting_moves, distance_to_moves, divide_times, insert_between
from compplan.planning.task import AT_CORRECTION, Command, PlanTask, attain_rows, pick_worst
from compplan.planning.timing import Timing
from compplan.robot import Array
from compplan.simulation.exact import ExactRobot, hold_load
from compplan.simulation.exact_model import read_exact_robot
from compplan.simulation.inertia import (
    find_inside,
    fit_parabolas,
    load_springs,
    shift_tip,
    solve_rigid,
)
from compplan.simulation.simulated_robot import (
    AS_MODELLED,
    Evaluation,
    SimulatedRobot,
    build_simulated_robot,
    run_simulated_robot,
    with_touched_part,
)
from compplan.simulation.vibration import build_dynamics
from compplan.statics.inertia import smooth_loads
from compplan.toolpath.toolpath import select_even
from compplan.uncertainty.motion import Motion, greatest_shift

#: Factors on limits for rounding: of the planner's differences, and of other difference formulas.
ROUNDING, ROUNDED = 1.001, 1.002
#: Most moves and loads that are checked: the worst by the planner's model, and evenly spaced ones.
MOST_CHECKED = 3000
#: Allowed difference of the loaded tip between planner and check [m], and waypoints compared.
AGREED, COMPARED = 1e-6, 400
#: Note of readers on drilling cycles left out.
LEFT_OUT = "left out: the tool moves rapidly above the holes"
#: Joint motion in one move of a cut above which the configuration changes. [rad, m]
JUMP_TURN, JUMP_SLIDE = float(np.radians(20.0)), 0.2
#: Allowed tilt of the tool in addition to that due to the load. [rad]
LEAN = float(np.radians(0.05))
#: Most rows at which the displacement by inertia is checked; its allowed difference: share plus constant. [1, 1, m]
INERTIA_ROWS, INERTIA_SHARE, INERTIA_LEAST = 2000, 0.1, 2e-6
#: Severities: a failed check prevents confirmation of the plan, or is noted.
STOP, NOTE = "stop", "note"


class Check(NamedTuple):
    """One check of a plan."""

    name: str  #: Quantity and unit.
    value: float  #: Value in the unit of the limit; NaN for a sentence without a figure.
    limit: float  #: Greatest allowed value.
    sentence: str  #: Message of a failed check; a `Stop` if it must be resolved before the machine moves.
    severity: str = STOP  #: `STOP` or `NOTE`.

    @property
    def fails(self) -> bool:
        """Return whether the value is beyond the limit."""
        return not self.value <= self.limit

    def describe(self) -> dict[str, object]:
        """Describe the check for plan.json."""
        return {"name": self.name, "value": self.value, "limit": self.limit, "fails": self.fails}


def state_notes(notes: Iterable[str]) -> tuple[Check, ...]:
    """Return notes as failed checks without a figure."""
    return tuple(Check("note", np.nan, 0.0, text, NOTE) for text in notes)


@dataclass(frozen=True)
class CheckRobot:
    """Robot of the independent check."""

    simulated: SimulatedRobot  #: Robot as modelled.
    bias: Array | None = None  #: Load of inertia on each spring, or None. Shape (n, s). [N m or N]
    #: Robot from the folder, with all masses and without weight; None for robots and paths in memory, with fewer
    #: checks.
    moving: ExactRobot | None = None


def build_check_robot(task: PlanTask, timing: Timing, job: Job | None) -> CheckRobot:
    """Parse the robot folder independently; use a robot or a path in memory as it is."""
    if job is None or task.robot.folder is None or job.context.mounted is not None:
        bias = _load_springs(task, build_dynamics(task.robot).inertial, timing.time) if task.inertia else None
        return CheckRobot(find_part(task, build_simulated_robot(task.robot)), bias)
    tool, folder = job.model_dump(by_alias=True, exclude_unset=True).get("tool"), Path(task.robot.folder)
    simulated = SimulatedRobot(AS_MODELLED, task.robot, read_exact_robot(folder, tool))
    moving = read_exact_robot(folder, tool, moving=True)
    if task.touched is not None:
        believed = read_exact_robot(folder, tool, geometry="controller.urdf")
        simulated = with_touched_part(simulated, task.touched.q, solve_rigid(believed, task.touched.q)[0])
    bias = _load_springs(task, moving, timing.time) if task.inertia else None
    return CheckRobot(simulated, bias, moving)


def _load_springs(task: PlanTask, moving: ExactRobot, time: Array) -> Array:
    """Compute the load of inertia on the springs, smoothed as in the plan. Shape (n, s). [N m or N]"""
    loads = load_springs(moving, task.q_links, time, np.r_[False, ~task.nominal.rapid[1:]], task.rests)
    return smooth_loads(loads, time, task.runs, FOLLOWED * task.smoothing)


def run_checks(
    task: PlanTask, command: Command, timing: Timing, between: Between, after: Evaluation, check_robot: CheckRobot, *,
    job: Job | None = None, motion: Motion | None = None, executed: ExecutedPath | None = None,
) -> tuple[Check, ...]:  # fmt: skip
    """Check a command and its run; checks against files are left out without a job, or with a robot in memory."""
    q, time = command.q, timing.time
    position, rotation = solve_rigid(check_robot.simulated.exact_robot, q)
    checks = [
        _check_tip(task, after), _check_models(task, q, after), *_check_between(task, q, between, check_robot),
        _check_correction(task, position), *([] if executed is None else [_check_executed(task, executed)]),
        _check_holes(task), *_check_joints(task, q, time),
    ]  # fmt: skip
    if check_robot.moving is not None and job is not None:
        checks += [_check_axis(task, after, rotation), _check_spin(task, q, after, rotation, job),
                   _check_feed(task, time), _check_inertia(task, time, motion, check_robot.moving)]  # fmt: skip
    return tuple(checks)


def _check_tip(task: PlanTask, after: Evaluation) -> Check:
    """Check that the loaded tip of the independent check is within the tolerance at waypoints."""
    use = np.where(after.cut, after.distance, 0.0) / task.tolerance
    worst = int(use.argmax())
    sentence = (
        f"the independent check finds the loaded tip {state_mm(after.distance[worst])} off the path at waypoint {worst}"
    )
    return Check("tip at waypoints, share of the tolerance", float(use[worst]), 1.0, sentence)


def _check_models(task: PlanTask, q: Array, after: Evaluation) -> Check:
    """Compare the loaded tip of planner and independent check at some waypoints of the cut."""
    rows, apart, worst = np.flatnonzero(after.cut), 0.0, 0
    if len(rows):
        rows = select_even(rows, COMPARED)
        away = np.linalg.norm(attain_rows(task, q, rows, slope=False).position - after.position[rows], axis=1)
        apart, worst = float(away.max()), int(rows[away.argmax()])
    sentence = (f"the planner and the independent check place the loaded tip {state_mm(apart)} apart "
                f"at waypoint {worst}: one of them misreads the robot, the tool or the load")  # fmt: skip
    return Check("planner and independent check apart, m", apart, AGREED, sentence)


def _check_between(task: PlanTask, q: Array, between: Between, check_robot: CheckRobot) -> tuple[Check, ...]:
    """Check that the loaded tip is within the tolerance between waypoints."""
    found, move = evaluate_between(task, q, between, check_robot)
    sentence = f"the independent check finds the loaded tip {state_mm(found)} off the path after waypoint {move}"
    own = between.most / task.tolerance
    worst = int(own.argmax())
    stray = f"between waypoints the tip strays by {state_mm(between.most[worst])}, after waypoint {worst}"
    first = Check("tip between waypoints, share of the tolerance", found / task.tolerance, 1.0, sentence)
    value = 0.0 if first.fails else float(own[worst])
    return first, Check("tip between waypoints by the planner, share of the tolerance", value, 1.0, stray)


def _check_correction(task: PlanTask, position: Array) -> Check:
    """Check that the distance of the unloaded tip from the path is within the allowed correction."""
    size = np.where(task.compensated, np.linalg.norm(position - task.position, axis=1), 0.0)
    worst = int(size.argmax())
    sentence = (f"the independent check finds a correction of {state_mm(size[worst])} at waypoint {worst}, allowed are "
                f"{state_mm(task.max_correction)}")  # fmt: skip
    limit = task.max_correction + 2 * AT_CORRECTION
    return Check("correction by the independent check, m", float(size[worst]), limit, sentence)


def _check_executed(task: PlanTask, executed: ExecutedPath) -> Check:
    """Check that the executed path is within the tolerance."""
    use = executed.near / task.tolerance
    worst, basis = int(use.argmax()), "drives as identified" if executed.known else "its blends as assumed"
    sentence = (f"the controller, {basis}, takes the loaded tip {1e3 * executed.near[worst]:.3g} mm off the path at "
                f"waypoint {worst}; lower the feed there")  # fmt: skip
    return Check("executed path, share of the tolerance", float(use[worst]), 1.0, sentence)


def _check_holes(task: PlanTask) -> Check:
    """Check that the path has all cuts of the file."""
    count = sum(LEFT_OUT in note for note in task.nominal.notes)
    sentence = 'holes of the file are not cut, [cam] cycles = "skip" leaves them out; write cycles = "expand"'
    return Check("cycles left out", float(count), 0.0, sentence)


def _check_axis(task: PlanTask, after: Evaluation, stiff: Array) -> Check:
    """Check that the axis of the loaded tool is that of the path, except for the tilt due to the load."""
    bent = _angle(after.rotation[:, :, 2], stiff[:, :, 2])
    beyond = np.where(after.cut, after.tilt - 1.5 * bent, -1.0)
    worst = int(beyond.argmax())
    sentence = (f"the independent check finds the tool axis {np.degrees(after.tilt[worst]):.3g} deg aside at waypoint "
                f"{worst}")  # fmt: skip
    return Check("tool axis, rad", float(beyond[worst]), LEAN, sentence)


def _check_spin(task: PlanTask, q: Array, after: Evaluation, stiff: Array, job: Job) -> Check:
    """Check that the loaded tool has the job's spin where it is not free, except for the rotation due to the load."""
    name = "rotation about the tool axis, rad"
    if task.spin_free or q.shape[1] < 6:
        return Check(name, 0.0, LEAN, "")
    bent = _angle(after.rotation[:, :, 2], stiff[:, :, 2])
    towards = job.T_base_part[:3, :3] @ np.asarray(job.plan.tool_x, float)
    programmed, axis = task.programmed_axis, task.nominal.axis
    flat = towards - (programmed @ towards)[:, None] * programmed
    size = np.maximum(np.linalg.norm(flat, axis=1), 1e-12)
    middle = programmed + axis  # a tilt moves x: half a turn about the programmed axis, half a turn about the middle
    for about in (programmed, middle / np.linalg.norm(middle, axis=1, keepdims=True)):
        flat = 2.0 * np.einsum("ni,ni->n", flat, about)[:, None] * about - flat
    defined = after.cut & (size > 0.05 * np.linalg.norm(towards))
    turned = np.where(defined, _angle(after.rotation[:, :, 0], flat / size[:, None]) - 1.5 * bent, -1.0)
    worst = int(turned.argmax())
    room = LEAN + 1.5 * _angle(after.rotation[worst : worst + 1, :, 0], stiff[worst : worst + 1, :, 0])[0]
    sentence = (f"the independent check finds the tool turned {np.degrees(turned[worst]):.3g} deg about its axis, "
                f"waypoint {worst}")  # fmt: skip
    return Check(name, float(turned[worst]), float(room), sentence)


def _angle(a: Array, b: Array) -> Array:
    """Compute the angle between unit vectors. Shape (n,). [rad]"""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b)))


def _check_joints(task: PlanTask, q: Array, time: Array) -> list[Check]:
    """Check the joints against their position, velocity and acceleration limits, and that time increases."""
    robot, step = task.robot, np.diff(time)
    over = np.maximum(robot.lower - q, q - robot.upper).max(axis=0)
    checks = [
        Check("joint range, rad or m", float(over[j]), 1e-9, f"{name} passes its position limits by "
              + (f"{1e3 * over[j]:.3g} mm" if robot.prismatic[j] else f"{np.degrees(over[j]):.3g} deg"))
        for j, name in enumerate(robot.joint_names)
    ]  # fmt: skip
    back = int(step.argmin()) + 1
    checks.append(Check("time runs on, s", -float(step.min()), 0.0, f"time runs backwards at waypoint {back}"))
    if checks[-1].fails:
        return checks
    rate = np.abs(np.diff(q, axis=0)) / np.maximum(step, 1e-12)[:, None] / task.velocity_limits
    rows = _find_moving(task, time)
    acceleration = np.abs(fit_parabolas(q, time, rows)[1]) / task.acceleration_limits
    for name, share, limit in (("velocity", rate, ROUNDED), ("acceleration", acceleration, 1.01 * ROUNDED)):
        for joint, value in zip(robot.joint_names, share.max(axis=0, initial=0.0).tolist(), strict=True):
            sentence = f"the {name} of {joint} is {value:.3g} times its limit"
            checks.append(Check(f"joint {name}, share of its limit", value, limit, sentence))
    return checks


def _find_moving(task: PlanTask, time: Array) -> NDArray[np.int_]:
    """Return the waypoints in motion, without rests."""
    rows = find_inside(time, np.r_[False, ~task.nominal.rapid[1:]])
    return rows[~task.rests[rows]]


def _check_feed(task: PlanTask, time: Array) -> Check:
    """Check that the required tip does not move faster than the programmed feed."""
    step, cutting = np.diff(time), ~task.nominal.rapid[1:]
    cut = cutting & ~task.lead[1:] & (task.nominal.feed[1:] > 0.0)
    length = np.linalg.norm(np.diff(task.position, axis=0), axis=1)
    faster = np.where(cut, length - ROUNDED * step * task.nominal.feed[1:], -1.0)
    k = int(faster.argmax())
    driven, programmed = 60e3 * length[k] / max(float(step[k]), 1e-12), 60e3 * task.nominal.feed[k + 1]
    sentence = f"the tool runs at {driven:.4g} mm/min to waypoint {k + 1}, programmed are {programmed:.4g}"
    return Check("way beyond the programmed feed, m", float(faster[k]), 1e-7, sentence)


def _check_inertia(task: PlanTask, time: Array, motion: Motion | None, moving: ExactRobot) -> Check:
    """Compare the tip displacement by inertia of the plan with Pinocchio's inverse dynamics."""
    rows, most = _find_moving(task, time), 0.0
    own = 0.0
    if motion is not None and len(rows):
        own = greatest_shift(motion.static)
        q, cutting = task.q_links, np.r_[False, ~task.nominal.rapid[1:]]
        acceleration = np.linalg.norm(fit_parabolas(q, time, rows)[1], axis=1)
        rows = np.sort(rows[np.argsort(acceleration)[-INERTIA_ROWS // 2 :]])
        loads = load_springs(moving, q, time, cutting, task.rests, rows)
        most = float(np.linalg.norm(shift_tip(moving, q[rows], loads[rows]), axis=1).max())
    sentence = (f"inertia moves the tip by {1e3 * own:.3g} mm in the plan, by {1e3 * most:.3g} mm in Pinocchio's "
                "inverse dynamics")  # fmt: skip
    limit = INERTIA_LEAST + INERTIA_SHARE * max(most, own)
    return Check("displacement by inertia apart, m", abs(most - own), limit, sentence)


def evaluate_between(task: PlanTask, q: Array, between: Between, check_robot: CheckRobot) -> tuple[float, int]:
    """Compute the loaded tip halfway between waypoints, at the mean of joint positions and wrench.

    Returns the greatest distance from the moves [m], and the waypoint where that move starts.
    """
    moves = cutting_moves(task)
    moves = pick_worst(moves, between.most[moves], MOST_CHECKED)
    if not len(moves):
        return 0.0, -1
    half = [0.5 * (values[moves] + values[moves + 1]) for values in (q, task.wrench)]
    bias = None if check_robot.bias is None else 0.5 * (check_robot.bias[moves] + check_robot.bias[moves + 1])
    if task.robot.effects:  # effects need the complete path in order
        path, load = insert_between(q, half[0], moves, 0.5), insert_between(task.wrench, half[1], moves, 0.5)
        more = None if check_robot.bias is None or bias is None else insert_between(check_robot.bias, bias, moves, 0.5)
        tip = run_simulated_robot(check_robot.simulated, path, load, divide_times(task.step_time, 0.5), more).position[
            2 * moves + 1
        ]
    else:
        tip = run_simulated_robot(check_robot.simulated, half[0], half[1], bias=bias).position
    path = task.programmed
    distance = distance_to_moves(tip, path[moves], path[moves + 1])
    worst_of = int(distance.argmax())
    return float(distance[worst_of]), int(moves[worst_of])


def find_failures(task: PlanTask, command: Command, check_robot: CheckRobot, near: Mapping[int, str]) -> dict[int, str]:
    """Find the failed waypoints of a command and their limits; `near`: violations of the clearance, in words."""
    lost = task.missed | np.r_[False, task.missed[:-1]]  # jumps to and from waypoints out of reach are ignored
    jumps = {waypoint: limit for waypoint, limit in find_jumps(task, command.q).items() if not lost[waypoint]}
    stopped = {**jumps, **find_overloads(task, command.q, check_robot), **near}
    for waypoint, limit in command.failures.items():
        stopped[waypoint] = f"{stopped[waypoint]}, {limit}" if waypoint in stopped else limit
    return stopped


def find_overloads(task: PlanTask, q: Array, check_robot: CheckRobot) -> dict[int, str]:
    """Find the waypoints with a static load beyond the effort limit of a joint, by joint name."""
    efforts = np.where(task.robot.carriers, np.inf, task.robot.effort_limits)  # the load of a positioner is unknown
    if not np.isfinite(efforts).any():
        return {}
    rows = np.flatnonzero(task.compensated)
    rows = pick_worst(rows, np.linalg.norm(task.wrench[rows, :3], axis=1), MOST_CHECKED)
    share = np.abs(hold_load(check_robot.simulated.exact_robot, q[rows], task.wrench[rows])) / np.maximum(efforts, 1e-9)
    found = {}
    for k in np.flatnonzero((share > ROUNDING).any(axis=1)).tolist():
        waypoint, j = int(rows[k]), int(share[k].argmax())
        unit = "N" if task.robot.prismatic[j] else "N m"
        name = task.robot.joint_names[j]
        found[waypoint] = f"effort limit of {name} ({efforts[j]:.4g} {unit})"
    return found


def find_jumps(task: PlanTask, q: Array) -> dict[int, str]:
    """Find moves of the cut in which a joint jumps: a change of configuration in the material."""
    most = np.where(task.robot.prismatic, JUMP_SLIDE, JUMP_TURN)
    step = np.abs(np.diff(q, axis=0)) / most
    jumps = (step.max(axis=1) > 1.0) & ~task.nominal.rapid[1:] & ~task.lead[1:]
    return {
        int(move) + 1: f"jump of {task.robot.joint_names[int(step[move].argmax())]} (change of branch in the cut)"
        for move in np.flatnonzero(jumps)
    }
