"""The plan: from a job, or from a robot and a path, to corrected joint positions, timed and judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from compplan.cell.cell import JUDGE
from compplan.errors import ConvergenceError, InputError, UnknownNameError
from compplan.job.job import Job
from compplan.job.loading import load_path
from compplan.path.contact import tool_axes
from compplan.path.force_law import ForceLaw
from compplan.path.toolpath import Toolpath, check_toolpath
from compplan.plan.agreement import agree
from compplan.plan.approach import Passage, plan_approach, plan_retract
from compplan.plan.bending import Bending, choose_smoothing, measure_bending, state_frequency
from compplan.plan.between import Between
from compplan.plan.buckling import explain_buckling, find_buckling
from compplan.plan.chatter import read_chatter
from compplan.plan.coupling import CouplingEffect
from compplan.plan.evaluate import (
    Evaluation,
    Margins,
    Mismatch,
    compare_coupling,
    evaluate_mismatch,
    evaluate_model,
    evaluate_run,
    measure_margins,
)
from compplan.plan.feed import FeedWish
from compplan.plan.notes import list_notes, tell_coupling
from compplan.plan.sampling import find_contacts, predict_loads, prepare_sampling, programmed_times
from compplan.plan.slow import group_waypoints
from compplan.plan.task import SMOOTHING, Command, PlanTask
from compplan.plan.timing import Timing
from compplan.plan.verdict import find_breaches, find_jumps, find_overloads, set_up_bench
from compplan.posture.clearance import ClearanceProfile
from compplan.posture.stance import Wish, check_start
from compplan.posture.start import PostureRequest, check_clearance, find_start, read_request
from compplan.program import check_languages
from compplan.promise.band import Promise, promise_path
from compplan.promise.posture_errors import posture_errors
from compplan.promise.slopes import read_force_spread, stage_path
from compplan.robot import Array, Robot, load_robot
from compplan.statics.chain import build_chain, locate_frames


@dataclass(frozen=True)
class PlanOptions:
    """What a plan may do, as the tables [plan] and [limits] of a job say it.

    Attributes:
        strategy: none, mirror, iterated_mirror or nlp.
        spin_free: Whether the tool may rotate about its axis.
        wish: What is said about the posture.
        max_correction: Greatest distance of the unloaded tip from the path. [m]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        tool_x: Where the TCP frame's x points, base axes. Shape (3,).
        velocity_scale: Share of the robot's velocity limits that may be used.
        acceleration_scale: Share of the robot's acceleration limits that may be used.
        feed: What the process asks of the feed.
        posture: What is asked of the posture; None keeps one configuration and the tool's x where `tool_x` has it.
        law: The law of the wrench; None where the path carries its wrench.
        chord: How far the loaded tip may stray from the path between waypoints; a tenth of the tolerance if left out.
            [m]
        inertia: Whether the inertia of the motion counts as a load and is compensated.

    """

    strategy: str = "nlp"
    spin_free: bool = True
    wish: Wish = field(default_factory=Wish)
    max_correction: float = 0.010
    tolerance: float = 1e-4
    tool_x: tuple[float, float, float] | Array = (1.0, 0.0, 0.0)
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    posture: PostureRequest | None = None
    feed: FeedWish = field(default_factory=FeedWish)
    law: ForceLaw | None = None
    chord: float | None = None
    inertia: bool = False


@dataclass(frozen=True)
class Plan:
    """A plan, with everything that it was made from.

    Attributes:
        name: Name of the job.
        task: Robot, nominal path, predicted wrench, posture, limits.
        strategy: How the command was found.
        command: Joint positions, status, failures, what the solver said.
        timing: Times, joint rates and feeds of the command.
        before: The uncorrected command (`task.q_start`) in the cell as modelled.
        after: The command in the cell as modelled.
        margins: Distance of the command from its limits.
        approach: The way to the first waypoint, where the toolpath has no rapid start.
        retract: The way from the last waypoint, where the toolpath ends in a cut.
        between: Where the loaded tip goes between waypoints, by the planner's model.
        bending: What bends the arm along the path, cause by cause.
        judge: Who computed `before` and `after`.
        breaches: What keeps the judge from confirming the plan, one sentence each.
        clearance: How far arm and tool keep clear of part and fixture, or None.
        coupling: The uncorrected tip without and with coupling of force and place, or None.
        notes: Warnings, one sentence each.
        job: The job, or None.
        learned: The promise of what measured parts have taught on this path, or None.

    """

    name: str
    task: PlanTask
    strategy: str
    command: Command
    timing: Timing
    before: Evaluation
    after: Evaluation
    margins: Margins
    approach: Passage
    retract: Passage
    between: Between
    bending: Bending
    judge: str = JUDGE
    breaches: tuple[str, ...] = ()
    clearance: ClearanceProfile | None = None
    coupling: CouplingEffect | None = None
    notes: tuple[str, ...] = ()
    job: Job | None = None
    learned: Promise | None = None

    @property
    def robot(self) -> Robot:
        """The robot model with its tool."""
        return self.task.robot

    @property
    def q(self) -> Array:
        """Commanded joint positions. Shape (n, nq). [rad or m]."""
        return self.command.q

    @property
    def status(self) -> str:
        """Tell "solved", "infeasible" or "not_confirmed"."""
        return "not_confirmed" if self.command.status == "solved" and self.breaches else self.command.status

    @cached_property
    def command_feed(self) -> Array:
        """Feed of the move that ends at each waypoint; where the wanted tip stays, that of the commanded one. [m/s].

        Shape (n,).
        """
        feed, still = self.timing.feed.copy(), np.r_[True, self.task.nominal.steps <= 0] & ~self.task.nominal.rapid
        tip = np.vstack([locate_frames(self.task.chain, q).tcp_position for q in (self.approach.key_q[-1:], self.q)])
        tip = np.vstack([tip[:1], tip])[-len(feed) - 1 :]
        step = np.r_[self.approach.key_gap[-1:] if len(self.approach.key_gap) else 1.0, np.diff(self.timing.time)]
        moved = np.linalg.norm(np.diff(tip, axis=0), axis=1) / np.maximum(step, 1e-9)
        return np.asarray(np.where(still, np.maximum(moved, 1e-4), feed))

    @cached_property
    def correction(self) -> Array:
        """Unloaded tip of the command minus nominal. Shape (n, 3). [m]."""
        return locate_frames(self.task.chain, self.q).tcp_position - self.task.position

    @cached_property
    def mismatch(self) -> Mismatch:
        """What the command leaves where the robot's compliances differ from the model's."""
        return evaluate_mismatch(self.task, self.q)

    @cached_property
    def promise(self) -> Promise | None:
        """The band that holds the true tip with 95 %; None where a robot within it finds no equilibrium."""
        if self.learned is not None:
            return self.learned
        task = self.task
        driven = max(float(way.max(initial=0.0)) for way in (self.between.joint, self.between.cartesian))
        bow = max(driven - self.after.max_deviation, 0.0)
        scene = stage_path(task.robot, self.q, task.wrench, task.step_time)
        force = read_force_spread(None if self.job is None else self.job.noise)
        try:
            return promise_path(task.robot, scene, task.cut, force, left=self.after.distance, between=bow)
        except ConvergenceError:
            return None

    def explain_failures(self) -> str:
        """Say in a sentence which waypoints fail and which limits stop them, or what is not confirmed; else nothing."""
        if not self.command.failures:
            return f"not confirmed: {'; '.join(self.breaches)}" if self.breaches else ""
        failures = self.command.failures
        limits = sorted({name for text in failures.values() for name in text.split(", ")})
        first = min(failures)
        length = self.task.nominal.arc_length[first] * 1e3
        spans = ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in group_waypoints(sorted(failures)))
        return (
            f"{len(failures)} of {len(self.task)} waypoints cannot be reached within the limits "
            f"({'; '.join(limits)}), the first is waypoint {first} (s = {length:.1f} mm); waypoints {spans}"
        )


def plan_job(job: Job, *, progress: Callable[[str], None] = lambda text: None) -> Plan:
    """Plan a job.

    Args:
        job: The job.
        progress: Told what is being done; an exception raised in it ends the call.

    Raises:
        InputError: If the job, or a file that it names, is not what it has to be, or the part is out of reach.

    """
    progress("robot and toolpath")
    robot, nominal, options = prepare_job(job)
    progress("posture")
    task = build_task(robot, nominal, options, file=job.file)
    name = job.name or job.file.stem
    return plan_task(task, options.strategy, name=name, feed=options.feed, job=job, progress=progress)


def prepare_job(job: Job) -> tuple[Robot, Toolpath, PlanOptions]:
    """Load what a job refers to: the robot with its tool, the nominal path with its wrench, and what the plan may do.

    Raises:
        InputError: If a file that the job names is not what it has to be.

    """
    robot = job_robot(job)
    if not job.output.any_brand:
        check_languages(robot, job.output.programs, file=job.file)
    nominal, law = load_path(job)
    span = float(np.ptp(nominal.position, axis=0).max())
    if span > 2.0 * robot.longest_reach:
        message = f"toolpath spans {span:.4g} m, the robot reaches {robot.longest_reach:.3g} m; is it in another unit?"
        raise InputError(message, file=job.file, where="toolpath")
    options = read_options(job, robot)
    posture = options.posture and replace(options.posture, chatter=read_chatter(job, robot, nominal, law))
    return robot, nominal, replace(options, law=law, posture=posture)


def plan_compensation(
    robot: Robot, nominal: Toolpath, options: PlanOptions | None = None, *, name: str = "path",
    progress: Callable[[str], None] = lambda text: None,
) -> Plan:  # fmt: skip
    """Plan a path: choose the posture, compensate, time, and judge in the cell as modelled.

    Args:
        robot: The robot with its tool.
        nominal: The path with its predicted wrench, base frame.
        options: What the plan may do.
        name: Name of the plan.
        progress: Told what is being done; an exception raised in it ends the call.

    Raises:
        InputError: If the path cannot be followed, or no waypoint is within reach.

    """
    options = options or PlanOptions()
    progress("posture")
    task = build_task(robot, nominal, options)
    return plan_task(task, options.strategy, name=name, feed=options.feed, progress=progress)


def plan_task(
    task: PlanTask, strategy: str, *, name: str = "path", feed: FeedWish | None = None, job: Job | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Plan:  # fmt: skip
    """Let one strategy command a task; time and judge its command; `progress` is told what is being done.

    Raises:
        InfeasibleError: If the arm buckles under the load; with waypoint and joint.

    """
    try:
        found = agree(task, strategy, feed or FeedWish(), progress)
    except ConvergenceError as error:
        raise explain_buckling(task, error) or error from None
    task, command, timing, feed_notes = found.task, found.command, found.timing, found.notes
    progress("virtual cell")
    clearance, near = check_clearance(task.start, command.q)
    bench = set_up_bench(task, command.q, timing, job)
    stopped = {**find_jumps(task, command.q), **find_overloads(task, command.q, bench), **near}
    for waypoint, limit in (*find_buckling(task, command.q).items(), *command.failures.items()):
        stopped[waypoint] = f"{stopped[waypoint]}, {limit}" if waypoint in stopped else limit
    if stopped:
        command = replace(command, status="infeasible", failures=stopped)
    after = evaluate_run(task, command.q, bench.cell, bench.wrench, bench.bias, bench.stiffness)
    before = after if command.q is task.q_start else evaluate_model(task, task.q_start)
    if after.settled is not None:
        bench = replace(bench, wrench=after.settled.wrench)
    progress("margins, approach and retract")
    margins = measure_margins(task, command.q, timing)
    bending = measure_bending(task, command.q, timing)
    breaches = find_breaches(task, command, timing, found.between, after, margins, bench)
    if after.settled is not None and not after.settled.agrees:
        breaches += (after.settled.explain(),)
    if task.inertia and not np.isfinite(bending.inertia):
        breaches += ("plan.inertia is true, and the robot folder knows no masses or no springs",)
    coupling = compare_coupling(task, before)
    told = list_notes(task, timing, bending, job)
    return Plan(
        name=name, task=task, strategy=strategy, command=command, timing=timing, before=before, after=after,
        margins=margins, breaches=breaches, job=job, approach=plan_approach(task, command.q),
        retract=plan_retract(task, command.q), between=found.between, bending=bending, coupling=coupling,
        clearance=clearance,
        notes=(*(task.start.notes if task.start else ()), *feed_notes, *told, *tell_coupling(coupling)),
    )  # fmt: skip


def build_task(robot: Robot, nominal: Toolpath, options: PlanOptions, *, file: Path | None = None) -> PlanTask:
    """Prepare what a strategy is told: posture, orientation, wrench at contact, times and limits.

    Args:
        robot: The robot with its tool.
        nominal: The path with its predicted wrench, base frame.
        options: What the plan may do.
        file: File to name in messages.

    Raises:
        InputError: If the path cannot be followed, or no waypoint is within reach.

    """
    nominal = check_toolpath(nominal, file=file)
    rotation = tool_axes(nominal, np.asarray(options.tool_x, float))
    chain = build_chain(robot)
    equations = 5 if options.spin_free else 6
    if chain.nq < equations:
        message = f"robot {robot.name!r} has {chain.nq} joints, a tool position and direction needs {equations}"
        raise InputError(message, file=file, where="robot" if file else None)
    try:
        check_start(robot, options.wish.start)
        start = find_start(robot, nominal, np.asarray(options.tool_x, float), rotation, options.wish, options.posture)
    except InputError as error:
        raise InputError(error.message, file=file, where=error.where if file else None) from None
    nominal = start.nominal
    compensated = ~nominal.rapid
    compensated[find_contacts(nominal.rapid)] = True
    few = start.q[np.unique(np.linspace(0, len(start.q) - 1, 5).astype(int))]
    task = PlanTask(
        robot=robot,
        chain=chain,
        nominal=nominal,
        rotation=start.rotation,
        wrench=np.zeros((len(nominal), 6)),
        compensated=compensated,
        q_start=start.q,
        configuration=start.configuration,
        missed=start.missed,
        step_time=programmed_times(nominal),
        velocity_limits=robot.velocity_limits * options.velocity_scale,
        acceleration_limits=robot.acceleration_limits * options.acceleration_scale,
        max_correction=options.max_correction,
        tolerance=options.tolerance,
        spin_free=options.spin_free,
        start=start,
        law=options.law,
        inertia=options.inertia,
        smoothing=choose_smoothing(robot, few, SMOOTHING),
        chord=0.1 * options.tolerance if options.chord is None else options.chord,
    )
    turns = options.law is not None and options.law.turns_with_travel
    return prepare_sampling(
        replace(task, wrench=predict_loads(task)), rest_at_corners=turns or not options.feed.constant
    )


def job_robot(job: Job) -> Robot:
    """Load the robot of a job, with the tool that the job mounts."""
    try:
        robot = load_robot(job.robot, relative_to=job.folder)
    except UnknownNameError as error:
        raise UnknownNameError("robot", error.name, error.choices, file=job.file, where="robot") from None
    return robot if job.tool is None else job.tool.mount(robot)


def read_options(job: Job, robot: Robot) -> PlanOptions:
    """Return what a job says about its plan, in SI."""
    table, words = job.plan, job.plan.configuration
    start = None if table.start is None else np.asarray(table.start, float)
    if start is not None and len(start) == robot.nq:
        start = np.where(robot.prismatic, start * 1e-3, np.radians(start))
    return PlanOptions(
        strategy=table.strategy,
        spin_free=table.rotate_about_tool_axis,
        wish=Wish(words.shoulder, words.elbow, words.wrist, start),
        max_correction=table.max_correction_mm * 1e-3,
        tolerance=table.tolerance_mm * 1e-3,
        tool_x=job.tool_x_base,
        velocity_scale=job.limits.velocity_scale,
        acceleration_scale=job.limits.acceleration_scale,
        posture=state_frequency(read_request(job, robot, posture_errors(job, robot)), robot),
        feed=FeedWish(job.feed.mode == "constant", job.feed.torque_limits),
        inertia=table.inertia,
        chord=None if job.sampling.chord_mm is None else job.sampling.chord_mm * 1e-3,
    )
