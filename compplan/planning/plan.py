"""Plan a job, or a path of a robot: posture, correction, timing, checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from compplan.controllers.writers import check_languages
from compplan.effects import robot_effects
from compplan.effects.backlash import state_sides
from compplan.errors import ConvergenceError, InputError, UnknownNameError
from compplan.job.job import Job
from compplan.job.loading import load_path, name_file, refuse_unsettled
from compplan.job.output import OutputTable
from compplan.planning.approach import plan_approach, plan_retract
from compplan.planning.candidates import better_start
from compplan.planning.checks import build_check_robot, find_failures, run_checks, state_notes
from compplan.planning.evaluate import evaluate_model, evaluate_run
from compplan.planning.fixed_point import compensate
from compplan.planning.inertia import choose_smoothing, follow_links, measure_motion
from compplan.planning.notes import list_notes
from compplan.planning.posture.settings import PostureProblem, PostureSettings, read_settings
from compplan.planning.posture.start import check_clearance, find_kept_start, read_lock
from compplan.planning.posture.summary import Start
from compplan.planning.redundancy import PathRequest
from compplan.planning.result import Plan
from compplan.planning.sampling import find_contacts, predict_loads, prepare_sampling, programmed_times
from compplan.planning.stability import explain_buckling
from compplan.planning.task import PlanTask, count_equations
from compplan.process.force_law import ForceLaw
from compplan.robot import Array, Robot, load_robot
from compplan.simulation.vibration import build_dynamics
from compplan.statics.chain import Chain, build_chain
from compplan.toolpath.contact import check_tool_x
from compplan.toolpath.toolpath import Toolpath, check_toolpath, select_even
from compplan.uncertainty.posture_errors import posture_errors
from compplan.uncertainty.sensitivities import ForceSpread, read_force_spread
from compplan.uncertainty.touch_off import TouchOff, read_touch, touch_part


@dataclass(frozen=True)
class PlanOptions:
    """Options of a plan, as in the sections [plan] and [limits] of a job."""

    strategy: str = "nlp"  #: none, mirror, iterated_mirror or nlp.
    spin_free: bool = True  #: Whether the tool may rotate about its axis.
    max_correction: float = 0.010  #: Greatest distance of the unloaded tip from the path. [m]
    tolerance: float = 1e-4  #: Greatest allowed deviation of the loaded tip. [m]
    #: Direction of x of the TCP frame, base axes. Shape (3,).
    tool_x: tuple[float, float, float] | Array = (1.0, 0.0, 0.0)
    velocity_scale: float = 1.0  #: Usable share of the robot's velocity limits.
    acceleration_scale: float = 1.0  #: Usable share of the robot's acceleration limits.
    #: Settings of the posture search (default: one configuration, x of the tool along `tool_x`).
    posture: PostureSettings = field(default_factory=lambda: PostureSettings(search=False))
    constant_feed: bool = False  #: Whether the complete cut requires one feed.
    torque_limits: bool = False  #: Whether joint torques must stay within the efforts of the robot.
    law: ForceLaw | None = None  #: Force law; None if the path has its wrench.
    #: Allowed deviation of the loaded tip between waypoints (default: a tenth of the tolerance). [m]
    chord: float | None = None
    inertia: bool = True  #: Whether the inertia of the motion is a load and is compensated.
    lock: Robot | None = None  #: Another model of the same machine, whose posture is kept.
    force: ForceSpread | None = None  #: Uncertainty of the force (default: assumed).
    #: Allowed offset from the path, as a share of the tolerance, for a shorter run or a narrower band.
    tube: float = 0.0
    touch: TouchOff | None = None  #: Measurement of the part by touching it with the robot; None: absolute frame.
    part_origin: Array | None = None  #: Origin of the part frame; None: the middle of the path. Shape (3,). [m]


def plan_job(job: Job, *, progress: Callable[[str], None] = lambda text: None) -> Plan:
    """Plan a job; `progress` receives the name of each step, and an exception raised in it ends the call.

    Raises:
        InputError: If the job or one of its files is not valid, or the part is out of reach.
    """
    progress("robot and toolpath")
    robot, nominal, options = prepare_job(job)
    progress("posture")
    task = build_task(robot, nominal, options, file=job.file)
    name = job.name or job.file.stem
    return plan_task(task, options.strategy, name=name, job=job, progress=progress)


def prepare_job(job: Job) -> tuple[Robot, Toolpath, PlanOptions]:
    """Load robot with tool, nominal path with wrench, and options of a job.

    Raises:
        InputError: If a file of the job is not valid.

    """
    robot = job_robot(job)
    output = job.output
    check_languages(robot, output.programs, file=job.file, form=output.form, any_brand=output.any_brand)
    nominal, law = load_path(job)
    span = float(np.ptp(nominal.position, axis=0).max())
    if span > 2.0 * robot.longest_reach:
        message = f"toolpath spans {span:.4g} m, the robot reaches {robot.longest_reach:.3g} m; is it in another unit?"
        raise InputError(message, file=job.file, where="toolpath")
    lock = read_lock(job, robot)
    return robot, nominal, replace(read_options(job, lock or robot), law=law, lock=lock)


def plan_compensation(
    robot: Robot, nominal: Toolpath, options: PlanOptions | None = None, *, name: str = "path",
    progress: Callable[[str], None] = lambda text: None,
) -> Plan:  # fmt: skip
    """Plan a path with its predicted wrench, base frame: posture, compensation, timing, and check as modelled.

    `progress` receives the name of each step; an exception raised in it ends the call.

    Raises:
        InputError: If the path cannot be followed, or no waypoint is within reach.
    """
    options = options or PlanOptions()
    progress("posture")
    task = build_task(robot, nominal, options)
    return plan_task(task, options.strategy, name=name, progress=progress)


def plan_task(
    task: PlanTask, strategy: str, *, name: str = "path", job: Job | None = None,
    progress: Callable[[str], None] = lambda text: None, output: OutputTable | None = None,
) -> Plan:  # fmt: skip
    """Correct a task by a strategy, time and check the command; `progress` receives the name of each step.

    `output`: requested programs if there is no job.

    Raises:
        InfeasibleError: If the arm buckles under the load; with waypoint and joint.

    """
    output = output if job is None else job.output
    try:
        found = compensate(task, strategy, output, progress)
    except ConvergenceError as error:
        raise explain_buckling(task) or error from None
    command, timing, executed = found.command, found.timing, found.executed
    task = replace(found.task, links=follow_links(found.task, command.q))
    progress("virtual cell")
    clearance, near = check_clearance(task.start, command.q)
    checker = build_check_robot(task, timing, job)
    if failures := find_failures(task, command, checker, near):
        command = replace(command, status="infeasible", failures=failures)
    after = evaluate_run(task, command.q, checker.simulated, bias=checker.bias)
    uncorrected = task.q_uncorrected
    before = after if command.q is uncorrected else evaluate_model(task, uncorrected)
    progress("checks, approach and retract")
    motion = measure_motion(task, timing.time, build_dynamics(task.robot))
    checks = run_checks(task, command, timing, found.between, after, checker, job=job, motion=motion, executed=executed)
    notes = state_notes([*(task.start.notes if task.start else ()), *found.notes])
    notes += list_notes(task, command, timing, motion, job)
    return Plan(
        name=name, task=task, strategy=strategy, command=command, timing=timing, before=before, after=after,
        checks=checks + notes, job=job, approach=plan_approach(task, command.q),
        retract=plan_retract(task, command.q), between=found.between, motion=motion, clearance=clearance,
        executed=executed,
    )  # fmt: skip


def build_task(robot: Robot, nominal: Toolpath, options: PlanOptions, *, file: Path | None = None) -> PlanTask:
    """Build the task of a strategy: posture, orientation, wrench, times and limits; `file` is for messages.

    Raises:
        InputError: If the path cannot be followed, or no waypoint is within reach.
    """
    nominal = check_toolpath(nominal, file=file)
    robot_effects(robot)  # raises an error for tables that are not effects of this robot
    if not options.spin_free:
        check_tool_x(nominal, np.asarray(options.tool_x, float), file)
    chain = build_chain(robot)
    equations = count_equations(chain, spin_free=options.spin_free)
    if chain.nq < equations:
        message = f"robot {robot.name!r} has {chain.nq} joints, the path needs {equations}"
        raise InputError(message, file=file, where="robot" if file else None)
    tool_x, settings = np.asarray(options.tool_x, float), options.posture
    with name_file(file):
        start = find_kept_start(robot, nominal, tool_x, settings, options.lock)
    if options.lock is None and settings.search:
        request = PathRequest(
            PostureProblem(robot, nominal, tool_x, settings), options.force or read_force_spread(None),
            partial(_state_task, robot, chain, options), options.tube,
        )  # fmt: skip
        start = better_start(start, request, shape=options.strategy == "nlp")
    return _state_task(robot, chain, options, start)


def _state_task(robot: Robot, chain: Chain, options: PlanOptions, start: Start) -> PlanTask:
    """Build the task of a path with a given start."""
    nominal = start.nominal
    compensated = ~nominal.rapid
    compensated[find_contacts(nominal.rapid)] = True
    window = 1.0 if start.slowdown is None else start.slowdown.window
    task = PlanTask(
        robot=robot, chain=chain, nominal=nominal, rotation=start.rotation, wrench=np.zeros((len(nominal), 6)),
        compensated=compensated, q_start=start.q, configuration=start.configuration, missed=start.missed,
        step_time=programmed_times(nominal), velocity_limits=robot.velocity_limits * options.velocity_scale,
        acceleration_limits=robot.acceleration_limits * options.acceleration_scale,
        max_correction=options.max_correction, tolerance=options.tolerance, spin_free=options.spin_free, start=start,
        law=options.law, inertia=options.inertia, constant_feed=options.constant_feed,
        torque_limits=options.torque_limits,
        smoothing=window * choose_smoothing(robot, select_even(start.q, 5)),
        chord=0.1 * options.tolerance if options.chord is None else options.chord,
        touched=None if options.touch is None else touch_part(robot, nominal, start.rotation, start.q, options.touch),
        part_origin=options.part_origin,
    )  # fmt: skip
    sided = robot if nominal.rapid[0] else state_sides(robot, start.q)  # a rapid move determines the side
    task = replace(task, wrench=predict_loads(task), robot=sided)
    turns = options.law is not None and options.law.turns_with_travel
    return prepare_sampling(task, rest_at_corners=turns or not options.constant_feed)


def job_robot(job: Job) -> Robot:
    """Load the robot of a job with its tool."""
    try:
        robot = job.context.mounted or load_robot(job.robot, relative_to=job.folder)
    except UnknownNameError as error:
        raise UnknownNameError("robot", error.name, error.choices, file=job.file, where="robot") from None
    refuse_unsettled(job)
    with name_file(job.file):
        robot = job.positioner.hold(robot)
        return robot if job.tool is None else job.tool.mount(robot)


def read_options(job: Job, robot: Robot) -> PlanOptions:
    """Read the options of a job, in SI units."""
    table = job.plan
    return PlanOptions(
        strategy=table.strategy,
        spin_free=table.rotate_about_tool_axis,
        max_correction=table.max_correction_mm * 1e-3,
        tolerance=1e-3 * job.plan.tolerance_mm,
        tool_x=job.tool_x_base,
        velocity_scale=job.limits.velocity_scale,
        acceleration_scale=job.limits.acceleration_scale,
        posture=read_settings(job, robot, posture_errors(job, robot)),
        constant_feed=job.feed.mode == "constant",
        torque_limits=job.feed.torque_limits,
        inertia=table.inertia,
        force=read_force_spread(job),
        tube=job.tolerance.tube,
        chord=None if job.sampling.chord_mm is None else job.sampling.chord_mm * 1e-3,
        touch=read_touch(job) if job.part.touched_off else None,
        part_origin=job.T_base_part[:3, 3],
    )
