"""A cut part, from measured points to the next program: the plan that was cut, the update, the plan that follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.effects.forward_model import ForwardModel
from compplan.io.display import Curve, Curves, Shown
from compplan.io.quantities import format_length
from compplan.io.tables import Table
from compplan.job.job import Job
from compplan.learning.gathered_points import Gathered, describe_whole, gather_points, measured_directions
from compplan.learning.measured_path import MeasuredPath, match_points
from compplan.learning.model_update import ModelUpdate, expect_deviations, learn_part, take_blocks
from compplan.learning.representable import Learned, Residual, list_learned, read_residual, residual_file
from compplan.learning.transfer import Others, Transfer, state_own, transfer_nothing, transfer_to_paths
from compplan.measurement.distance import band_radius
from compplan.measurement.part_points import Surface, read_measured_points
from compplan.planning.checks import state_notes
from compplan.planning.plan import PlanOptions, build_task, plan_task, prepare_job
from compplan.planning.posture.follow import solve_posture_near, turn_about_axis
from compplan.planning.posture.start import read_lock
from compplan.planning.result import Plan
from compplan.planning.task import PlanTask
from compplan.process.learned_force import LearnedForce, read_learned_force
from compplan.robot import Array, Robot, load_robot
from compplan.robot.pose import fit_displacement, see_position
from compplan.robot.uncertainty import Uncertainty
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm
from compplan.toolpath.toolpath import Toolpath, interpolate
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import PATHS, SEED, Slopes, draw_columns, linearise_path, widen_to_path
from compplan.uncertainty.motion import read_placement
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    apply_wrench_to_model,
    build_path_model,
    pick_rows,
    read_force_spread,
    tip_of,
    vary_model,
)
from compplan.uncertainty.touch_off import TouchedPart, is_lasting, stage_touch

#: Places along the path that hold an update, at most.
MOST_PLACES = 5000
#: What to do about a part that is off as a whole: nobody can tell its clamping from the robot.
WHOLE_PART = (
    "--align best_fit takes that off, [noise] part_frame_mm of the job allows for how parts are clamped, --align datum"
    " learns it as the robot's"
)
#: Bands that the median point may be off before somebody is asked (assumed: widths of a folder are rough).
POSSIBLE = 4.0
#: Moves longer than this are corrected at their ends only. [m]
LONG_MOVE = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class LearnedPart(Shown):
    """A model update with the plans before and after it."""

    job: Job  #: The job.
    robot: Robot  #: The robot of the folder before.
    taught: Robot  #: The updated robot.
    model_update: ModelUpdate  #: Force, robot and residual learned from the part.
    measured: MeasuredPath  #: The measured points.
    path: Toolpath  #: The wanted path, base frame.
    slopes: Slopes  #: The path to first order, as it was cut.
    length: Array  #: Length of the path at its rows. Shape (k,). [m]
    before: Plan  #: The plan that was cut.
    after: Plan  #: The plan that follows.
    residual: Residual | None  #: What the next program takes off beside the robot's model; None: nothing.
    learned: tuple[Learned, ...]  #: Parameters that moved most for their width.
    notes: tuple[str, ...]  #: What a user has to know, one sentence each.
    travel: Transfer  #: What other paths are told.
    force: LearnedForce | None  #: What is known of the force of the process, or None.

    @property
    def wanted(self) -> Array:
        """Where the path wants the tip at the waypoints of the next program, nothing taken off. Shape (n, 3). [m]."""
        task = self.after.task
        length = np.interp(task.origin, np.arange(len(self.path)), self.path.arc_length)
        return np.asarray(task.position + (0.0 if self.residual is None else self.residual.at(length)))

    def summary(self) -> list[tuple[str, str]]:
        """Return the results of the update and the prediction for the next part."""
        model_update, name = self.model_update, self.job.name or self.job.file.stem
        rows = [
            ("measured", f"rms {format_length(model_update.rms)} at {len(self.measured)} points"),
            ("reason", model_update.reason),
        ]
        if model_update.taken:
            rows += [
                ("expected next", f"rms {format_length(model_update.expected)} in all directions, with a force that"
                                  " varies from part to part"),
                ("95 % band", f"{format_length(float(model_update.band_after.max()))} at its widest, before "
                              f"{format_length(float(model_update.band_before.max()))}"),
            ]  # fmt: skip
        taken = "corrected program" if model_update.taken else "no correction"
        return [("measured part", f"{name}: {taken}, {self.robot.name}"), *rows]

    def curves(self) -> Curves:
        """Return the measured deviation along the path and what stays by the model. [mm]."""
        order = np.argsort(self.measured.length)
        measured, update = np.linalg.norm(self.measured.seen, axis=1)[order] * 1e3, self.model_update
        explained = 1e3 * np.linalg.norm(update.physics + update.pushed + update.residual, axis=1)
        repeats = Curve("what repeats", self.length * 1e3, explained, "after")
        lines = (Curve("measured", self.measured.length[order] * 1e3, measured, "before"), repeats)
        return Curves(self.job.name or self.job.file.stem, "along the path [mm]", "deviation of the part [mm]", lines)


@dataclass(frozen=True, eq=False)
class CutPath:
    """A path as it was cut."""

    scene: ForwardModel  #: The robot on it.
    known: Uncertainty  #: What is known of the robot.
    force: ForceSpread  #: Uncertainty of the force, as far as all parts share it.
    slopes: Slopes  #: The path to first order, k rows.
    #: Length of the wanted path at every waypoint: the corrected path is a little longer or shorter. Shape (n,). [m]
    length: Array
    #: The part as the robot found it by touching, or None where its frame is absolute.
    touched: TouchedPart | None = None

    def exact(self, values: Array, force: Array) -> Array:
        """Return the motion of the tip by values of parameters and force. Shape (k, 3). [m]"""
        return self.tip(values, force, self.slopes.rows) - self.slopes.tip

    def tip(self, values: Array, force: Array, rows: NDArray[np.int_]) -> Array:
        """Return the tip with values of parameters and force, relative to the part frame found. Shape (k, 3). [m]"""
        varied = vary_model(self.scene, self.known.unknowns, values)
        position = tip_of(apply_wrench_to_model(varied, force, self.force), rows)
        if self.touched is None:
            return position
        touch = stage_touch(self.touched)
        every = np.arange(len(self.touched.q))
        moved = tip_of(vary_model(touch, self.known.unknowns, values * is_lasting(self.known.unknowns)), every)
        return see_position(position, fit_displacement(tip_of(touch, every), moved))


def linearise_cut(before: Plan, wanted: Toolpath, force: ForceSpread) -> CutPath:
    """Linearise a path as it was cut, by its plan; the wanted path stands in the base frame."""
    known, task = robot_uncertainty(before.robot), before.task
    scene = build_path_model(before.robot, before.q, task.wrench, task.step_time)
    length = np.interp(task.origin, np.arange(len(wanted)), wanted.arc_length)
    slopes = linearise_path(scene, known, force, task.cut, touched=task.touched)
    return CutPath(scene, known, force, slopes, length, task.touched)


def learn_from_part(
    job: Job, robot_name: str | Path | Robot, measured: Any, *, in_base: bool = False, align: str | None = None,
    sigma: float | None = None, sure: bool = False, surface: Surface | None = None,
    announce: Callable[[str], None] = lambda words: None,
) -> LearnedPart:  # fmt: skip
    """Learn from a cut part and plan the next one.

    Args:
        job: The job.
        robot_name: The robot folder that the program was planned with; what it learned on this path lies in it.
        measured: The measured points: a file, or its columns.
        in_base: Whether they are in the base frame; otherwise in the part frame.
        align: "datum": the points stand where their frame says; "best_fit": a rigid motion is fitted and taken off;
            None: as "datum", but asked about where most of what was measured is such a motion.
        sigma: Standard deviation of points whose file states none; assumed if left out. [m]
        sure: Whether points that cannot be are meant as they are.
        surface: The nominal surface of the part in the frame of the points, or None.
        announce: Told what is being done.

    Raises:
        InputError: If a file is not what it has to be.
    """
    points = read_measured_points(measured)
    robot = robot_name if isinstance(robot_name, Robot) else load_robot(robot_name)
    old = read_residual(residual_file(robot, job), robot)
    job = job.with_context(force=(read_learned_force(robot.folder, job.process),))
    announce("the plan that was cut")
    wanted, before = plan_learned(job, robot, old)
    matched = match_points(
        points, wanted, job.T_base_part, in_base=in_base, align=align or "datum", sigma=sigma, sure=sure,
        surface=surface,
    )  # fmt: skip
    announce("what the part teaches")
    whole = read_force_spread(job)
    cut = linearise_cut(before, wanted, whole.of_all())
    slopes, known, length = cut.slopes, cut.known, cut.length[cut.slopes.rows]
    gathered, fitted = gather_points(matched, length), matched.motion is not None
    own = state_own(job.noise, job.T_base_part[:3, 3], slopes, whole, fitted=fitted)
    left_open = None if old is None else interpolate(length, old.length, old.open)
    expected = expect_deviations(slopes, known, gathered, own, left_open)
    if not sure:
        band = band_radius(take_blocks(expected, len(gathered.row)))
        ask_possible(points, gathered, band)
    allowed = old is not None or align == "best_fit" or read_placement(job.noise) is not None
    stood, beyond = ("", False) if allowed else describe_whole(gathered, slopes.tip, job.T_base_part[:3, :3], expected)
    if beyond and align is None and not sure:
        raise points.error(f"{stood}; was the part there? {WHOLE_PART}")
    learn = partial(learn_part, slopes, known, gathered, cut.exact, own, None if old is None else old.typical)
    model_update = learn(left_open)
    # what the path left open stands for robot and force there: other paths are told what these say alone
    wide = model_update if old is None else learn()
    told = model_update.taken
    others = transfer_to_paths(job, robot, wide, known, whole) if told else transfer_nothing(job, robot, wide)
    residual = old
    if told:
        residual, model_update = add_residual(old, model_update, cut, before.task, others)
    announce("the plan that follows")
    job = job.with_context(force=(others.force,))
    after = plan_learned(job, others.robot, residual)[1] if told else before
    after = with_band(after, model_update, slopes, known) if residual is not None else after
    return LearnedPart(
        job, robot, others.robot, model_update, matched, wanted, slopes, length, before, after,
        residual, tuple(list_learned(known, wide.values, others.held)),
        _list_notes(model_update, others.travel, matched, wanted, stood), others.travel, others.force,
    )  # fmt: skip


def _list_notes(
    model_update: ModelUpdate, travel: Transfer, matched: MeasuredPath, wanted: Toolpath, stood: str
) -> tuple[str, ...]:
    """Return why the update is taken or left, and what to know of the points and of long moves."""
    if not model_update.taken:
        return (model_update.reason, *matched.notes)
    whole = [f"{stood}: learned as an error of the robot"] if stood else []
    longest = float(wanted.steps[~wanted.rapid[1:]].max(initial=0.0))
    coarse = f"moves longer than {LONG_MOVE * 1e3:g} mm are corrected at their ends only; sample them finer"
    return (
        model_update.reason, travel.reason, *whole, *matched.notes, *([coarse] if longest > LONG_MOVE else []),
    )  # fmt: skip


def ask_possible(points: Table, gathered: Gathered, band: Array) -> None:
    """Ask about points that are farther off than folder, force, clamping and instrument let a part be.

    Raises:
        InputError: If the typical point is.
    """
    size = np.linalg.norm(gathered.deviation, axis=1)
    if float(np.median(size / np.maximum(band, 1e-12))) > POSSIBLE:
        raise points.error(
            f"the points are {float(np.median(size)) * 1e3:.3g} mm off (median), {np.median(size / band):.2g} times the"
            f" {float(np.median(band)) * 1e3:.3g} mm that robot folder, force and instrument allow with 95 %; is it"
            " this part, in this unit and frame, at the place of the job? --align best_fit removes a shift of the whole"
            " part, --assume-ok learns it as it is"
        )


def plan_learned(job: Job, robot: Robot, residual: Residual | None) -> tuple[Toolpath, Plan]:
    """Plan a job with a robot of one's own; also return the wanted path before the residual is taken off."""
    nominal, task, options = build_learned(job, robot, residual)
    # the evaluation of a job reads the job's own robot and path: here both have learned, and the task's own force acts
    name = job.name or job.file.stem
    plan = replace(plan_task(task, options.strategy, name=name, feed=options.feed, output=job.output), job=job)
    if residual is not None:
        most = float(np.linalg.norm(residual.deviation, axis=1).max(initial=0.0)) * 1e3
        said = f"the path is shifted by up to {most:.3g} mm as learned from cut parts; deviations count from there"
        plan = plan.add_checks(state_notes([said]), first=True)
    return nominal, plan


def build_learned(job: Job, robot: Robot, residual: Residual | None) -> tuple[Toolpath, PlanTask, PlanOptions]:
    """Prepare the task of a job with a robot of one's own; also return the wanted path, and what the plan may do.

    A path that has learned keeps the posture in which it learned, another one that of the job's own robot.
    """
    _, nominal, options = prepare_job(job)
    mounted = robot if job.tool is None else job.tool.mount(robot)
    options = replace(options, lock=options.lock or read_lock(job, mounted))
    aimed = nominal
    if residual is not None:
        aimed = replace(nominal, position=nominal.position - residual.at(nominal.arc_length))
    task = build_task(mounted, aimed, options, file=job.file)
    if residual is not None:
        task = keep_posture(task, residual, np.interp(task.origin, np.arange(len(nominal)), nominal.arc_length))
    return nominal, task, options


def keep_posture(task: PlanTask, residual: Residual, length: Array) -> PlanTask:
    """Return a task whose start stands as the arm stood when the path was learned.

    length: of the wanted path at every waypoint of the task. Shape (n,). [m]
    """
    near = interpolate(length, residual.length, residual.q)
    rotation = task.rotation
    if task.robot.nq >= 6:
        rotation = turn_about_axis(locate_frames(task.chain, near).tcp_rotation[:, :, 0], task.nominal.axis)
    arm = build_arm(task.robot)
    q, rotation, reached = solve_posture_near(arm, near, task.position, rotation, spin_free=task.spin_free)
    return replace(task, q_start=q, rotation=rotation, missed=~reached)


def add_residual(
    old: Residual | None, model_update: ModelUpdate, cut: CutPath, task: PlanTask, others: Others
) -> tuple[Residual, ModelUpdate]:
    """Add what stays with the path: what the update says of its tip, less what robot folder and process now say there.

    It moves at measured places in measured directions alone: elsewhere it would continue what other places say. What
    robot folder and process say is a model that stretches left out support, and moves everywhere. The band of the
    update that is returned counts what is not taken off.

    old: what was learned before, or None; others: what robot folder and process say now.
    """
    rows, slopes = pick_rows(task.cut, MOST_PLACES), cut.slopes
    length, at = cut.length[rows], cut.length[slopes.rows]
    if old is not None:
        before, moved = old.at(length), tip_of(cut.scene, rows) + interpolate(length, at, model_update.residual)
    else:
        before, moved = np.zeros((len(rows), 3)), cut.tip(model_update.values, model_update.force, rows)
        moved = moved + model_update.residual_at(task.position[rows], slopes.tip)
    own = moved - cut.tip(others.held, others.shares, rows)
    known = measured_directions(model_update.gathered, slopes.tip, task.position[rows])
    taken = np.einsum("nij,nj->ni", known, own)
    left = np.interp(at, length, np.linalg.norm(own - taken, axis=1))
    model_update = replace(
        model_update,
        band_after=model_update.band_after + left,
        expected=float(np.hypot(model_update.expected, np.sqrt(np.mean(left**2)))),
    )
    spread = np.interp(length, at, np.minimum(model_update.band_after / 2.8, max(model_update.model.size, 1e-7)))
    residual = Residual(length, before + taken, spread, task.q_start[rows], interpolate(length, at, model_update.open))
    return residual, model_update


def with_band(plan: Plan, model_update: ModelUpdate, slopes: Slopes, known: Uncertainty) -> Plan:
    """Give a plan the band of the update: this path is known better than the robot is elsewhere."""
    error_band = plan.error_band
    if error_band is None:
        return plan
    n = len(plan.task)
    rows = slopes.rows * (n - 1) / max(len(error_band.cut) - 1, 1)
    radius = np.interp(np.arange(n), rows, model_update.band_after)
    own = model_update.model.own.following
    force = band_radius(own[:, :, :1] @ np.swapaxes(own[:, :, :1], 1, 2))
    parts = {**error_band.parts, "model": radius, "unexplained": np.zeros(n)}
    parts["force"] = np.interp(np.arange(n), rows, force)
    better = replace(error_band, radius=radius + plan.after.distance, parts=parts, known=known, before=None,
                     ladder=(), cheapest=())  # fmt: skip
    run = np.broadcast_to((known.repeatability or 0.0) * np.eye(3), (len(own), 3, 3))
    drawn = draw_columns(np.concatenate([model_update.open, own, run], axis=2), np.random.default_rng(SEED), PATHS)
    whole = (better.greatest - better.between) * widen_to_path(drawn) + better.between
    return replace(plan, learned=replace(better, whole=whole))
