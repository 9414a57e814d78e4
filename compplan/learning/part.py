"""From the measured points of a cut part to the next program: previous plan, model update, next plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from compplan.learning.model_update import ModelUpdate, expect_deviations, learn_part, prior_of, take_blocks
from compplan.learning.path_state import PathState, apply_state, factor_state, read_state
from compplan.learning.representable import Learned, Residual, list_learned, read_residual, residual_file
from compplan.learning.transfer import Transfer, TransferResult, build_part_terms, transfer_to_paths
from compplan.measurement.distance import band_radius
from compplan.measurement.part_points import Surface, read_measured_points
from compplan.planning.checks import state_notes
from compplan.planning.plan import PlanOptions, build_task, plan_task, prepare_job
from compplan.planning.posture.start import read_lock
from compplan.planning.result import Plan
from compplan.planning.task import PlanTask
from compplan.process.learned_force import LearnedForce, read_learned_force
from compplan.robot import Array, Robot, load_robot
from compplan.robot.pose import fit_displacement, see_position
from compplan.robot.uncertainty import Uncertainty
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, solve_posture_near
from compplan.toolpath.contact import turn_about_axis
from compplan.toolpath.toolpath import Toolpath, interpolate
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import (
    LEARNED,
    OTHER_CAUSES,
    PARTS,
    PATHS,
    SEED,
    UNDETERMINED,
    Slopes,
    draw_columns,
    linearise_path,
    widen_to_path,
)
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    apply_wrench_to_model,
    build_path_model,
    pick_rows,
    read_force_spread,
    tip_of,
    vary_model,
)
from compplan.uncertainty.touch_off import TouchedPart, build_touch_model, is_lasting, states_placement

#: Greatest number of places along the path of a residual.
MOST_PLACES = 5000
#: Advice for a rigid displacement of the part: the points alone do not separate clamping from robot errors.
WHOLE_PART = (
    "--align best_fit removes it, --align datum learns it as an error of the robot, [noise] part_frame_mm in the job"
    " states how far the clamping may be off"
)
#: Greatest median ratio of deviation to 95 % band (assumed: the uncertainties of a robot folder are rough).
POSSIBLE = 4.0
#: Moves longer than this are corrected at their ends only. [m]
LONG_MOVE = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class LearnedPart(Shown):
    """A model update with the plans before and after it."""

    job: Job  #: The job.
    robot: Robot  #: The robot of the folder before.
    updated: Robot  #: The updated robot.
    model_update: ModelUpdate  #: Force, robot and residual learned from the part.
    measured: MeasuredPath  #: The measured points.
    path: Toolpath  #: The nominal path, base frame.
    slopes: Slopes  #: The path as it was cut, linearised.
    length: Array  #: Arc length of the path at the rows of `slopes`. Shape (k,). [m]
    before: Plan  #: The plan that was cut.
    after: Plan  #: The next plan.
    residual: Residual | None  #: Deviation beyond the robot model that the next program subtracts; None: none.
    state: PathState | None  #: Joint posterior of robot, force and deviation of this path; None: nothing was learned.
    learned: tuple[Learned, ...]  #: Parameters with the greatest changes relative to their standard deviations.
    notes: tuple[str, ...]  #: Notes for the user, one sentence each.
    transfer: Transfer  #: Learned parameters that transfer to other paths.
    force: LearnedForce | None  #: Learned force of the process, or None.

    @property
    def nominal(self) -> Array:
        """Return the nominal tip at the waypoints of the next program, uncorrected by learning. Shape (n, 3). [m]"""
        task = self.after.task
        length = np.interp(task.origin, np.arange(len(self.path)), self.path.arc_length)
        return np.asarray(task.position + (0.0 if self.residual is None else self.residual.at(length)))

    @property
    def widest_band(self) -> float:
        """Return the 95 % band of the next part at the worst point of the path, as its plan states it. [m]"""
        band = self.after.learned
        return float(self.model_update.band_after.max()) if band is None else band.greatest

    def summary(self) -> list[tuple[str, str]]:
        """Return pairs of name and text: results of the model update, and the deviation predicted for the next part."""
        model_update, name = self.model_update, self.job.name or self.job.file.stem
        rows = [
            ("measured", f"rms {format_length(model_update.rms)} at {len(self.measured)} points"),
            ("reason", model_update.reason),
        ]
        if model_update.taken:
            rows += [
                ("expected next", f"rms {format_length(model_update.expected)} in all directions, with a force that"
                                  " varies from part to part"),
                ("95 % band", f"{format_length(self.widest_band)} at its widest, before "
                              f"{format_length(float(model_update.band_before.max()))}"),
            ]  # fmt: skip
        taken = "corrected program" if model_update.taken else "no correction"
        return [("measured part", f"{name}: {taken}, {self.robot.name}"), *rows]

    def curves(self) -> Curves:
        """Return the measured deviation along the path, and the part of it that the model expects to repeat. [mm]"""
        order = np.argsort(self.measured.length)
        measured, update = np.linalg.norm(self.measured.seen, axis=1)[order] * 1e3, self.model_update
        explained = 1e3 * np.linalg.norm(update.physics + update.pushed + update.residual, axis=1)
        repeats = Curve("what repeats", self.length * 1e3, explained, "after")
        lines = (Curve("measured", self.measured.length[order] * 1e3, measured, "before"), repeats)
        return Curves(self.job.name or self.job.file.stem, "along the path [mm]", "deviation of the part [mm]", lines)


@dataclass(frozen=True, eq=False)
class CutPath:
    """A path as it was cut."""

    scene: ForwardModel  #: Forward model of the robot along the path.
    known: Uncertainty  #: Parameter uncertainty of the robot.
    force: ForceSpread  #: Uncertainty of the force common to all parts.
    slopes: Slopes  #: The path, linearised, k rows.
    #: Arc length of the nominal path at every waypoint; that of the corrected path differs slightly. Shape (n,). [m]
    length: Array
    #: Part frame located by touch-off, or None if the frame is absolute.
    touched: TouchedPart | None = None

    def exact(self, values: Array, force: Array) -> Array:
        """Return the nonlinear motion of the tip due to parameters and force. Shape (k, 3). [m]"""
        return self.tip(values, force, self.slopes.rows) - self.slopes.tip

    def tip(self, values: Array, force: Array, rows: NDArray[np.int_]) -> Array:
        """Return the tip for given parameters and force, relative to the touched part frame. Shape (k, 3). [m]"""
        varied = vary_model(self.scene, self.known.unknowns, values)
        position = tip_of(apply_wrench_to_model(varied, force, self.force), rows)
        if self.touched is None:
            return position
        touch = build_touch_model(self.touched)
        every = np.arange(len(self.touched.q))
        moved = tip_of(vary_model(touch, self.known.unknowns, values * is_lasting(self.known.unknowns)), every)
        return see_position(position, fit_displacement(tip_of(touch, every), moved))


def linearise_cut(before: Plan, nominal: Toolpath, force: ForceSpread, state: PathState | None) -> CutPath:
    """Linearise a path as it was cut, from its plan.

    nominal: the nominal path, base frame; state: posterior of an earlier part of this path, or None.
    """
    known, task = robot_uncertainty(before.robot), before.task
    scene = build_path_model(before.robot, before.q, task.wrench, task.step_time)
    length = np.interp(task.origin, np.arange(len(nominal)), nominal.arc_length)
    slopes = linearise_path(scene, known, force, task.cut, touched=task.touched)
    slopes, known = apply_state(state, slopes, known, force, length[slopes.rows])
    return CutPath(scene, known, force, slopes, length, task.touched)


def learn_from_part(
    job: Job, robot_name: str | Path | Robot, measured: Any, *, in_base: bool = False, align: str | None = None,
    sigma: float | None = None, sure: bool = False, surface: Surface | None = None,
    announce: Callable[[str], None] = lambda words: None,
) -> LearnedPart:  # fmt: skip
    """Learn from a cut part and plan the next one.

    Args:
        job: The job.
        robot_name: The robot folder with which the program was planned; it contains earlier updates of this path.
        measured: The measured points: a file, or its columns.
        in_base: Whether the points are in the base frame; otherwise in the part frame.
        align: "datum": use the points as given in their frame; "best_fit": fit a rigid motion and remove it; None: as
            "datum", but raise an error if an unexpected motion of this kind dominates the deviations.
        sigma: Standard deviation of points whose file states none; assumed if left out. [m]
        sure: Accept implausible points without an error.
        surface: The nominal surface of the part in the frame of the points, or None.
        announce: Called with the name of each step.

    Raises:
        InputError: If a file is invalid or its points are implausible.
    """
    points = read_measured_points(measured)
    robot = robot_name if isinstance(robot_name, Robot) else load_robot(robot_name)
    old = read_residual(residual_file(robot, job), robot)
    job = job.with_context(force=(read_learned_force(robot.folder, job.process),))
    announce("plan of the part that was cut")
    nominal, before = plan_learned(job, robot, old)
    matched = match_points(
        points, nominal, job.T_base_part, in_base=in_base, align=align or "datum", sigma=sigma, accept_implausible=sure,
        surface=surface,
    )  # fmt: skip
    announce("fit force and robot")
    whole = read_force_spread(job)
    cut = linearise_cut(before, nominal, whole.of_all(), read_state(robot, job))
    slopes, known, length = cut.slopes, cut.known, cut.length[cut.slopes.rows]
    gathered, fitted = gather_points(matched, length), matched.motion is not None
    own = build_part_terms(job.noise, job.T_base_part[:3, 3], slopes, whole, fitted=fitted)
    expected = expect_deviations(slopes, known, gathered, own)
    if not sure:
        band = band_radius(take_blocks(expected, len(gathered.row)))
        check_plausible(points, gathered, band)
    allowed = old is not None or align == "best_fit" or states_placement(job.noise)
    rigid, beyond = ("", False) if allowed else describe_whole(gathered, slopes.tip, job.T_base_part[:3, :3], expected)
    if beyond and align is None and not sure:
        raise points.error(f"{rigid}; was the part clamped elsewhere? {WHOLE_PART}")
    model_update = learn_part(slopes, known, gathered, cut.exact, own)
    taken = model_update.taken
    others = transfer_to_paths(job, robot, model_update, known, whole)
    residual, state = old, None
    if taken:
        residual, left, model_update = add_residual(old, model_update, cut, before.task, others)
        state = keep_state(model_update, cut, length, others, left)
    announce("plan of the next part")
    job = job.with_context(force=(others.force,))
    after = plan_learned(job, others.robot, residual)[1] if taken else before
    after = with_band(after, model_update, slopes, known) if residual is not None else after
    return LearnedPart(
        job, robot, others.robot, model_update, matched, nominal, slopes, length, before, after,
        residual, state, tuple(list_learned(known, model_update.values, others.held)),
        _list_notes(model_update, others.transfer, matched, nominal, rigid), others.transfer, others.force,
    )  # fmt: skip


def _list_notes(
    model_update: ModelUpdate, transfer: Transfer, matched: MeasuredPath, nominal: Toolpath, rigid: str
) -> tuple[str, ...]:
    """Return the notes of an update: reason, transfer, points left out, and long moves."""
    if not model_update.taken:
        return (model_update.reason, *matched.notes)
    whole = [f"{rigid}; it is learned as an error of the robot; if the set-up shifted, correct that"] if rigid else []
    longest = float(nominal.steps[~nominal.rapid[1:]].max(initial=0.0))
    coarse = f"moves longer than {LONG_MOVE * 1e3:g} mm are corrected at their ends only; sample them finer"
    return (
        model_update.reason, transfer.reason, *whole, *matched.notes, *([coarse] if longest > LONG_MOVE else []),
    )  # fmt: skip


def check_plausible(points: Table, gathered: Gathered, band: Array) -> None:
    """Check that the points lie within a multiple of the band due to robot, force, clamping and instrument.

    Raises:
        InputError: If the median point does not.
    """
    size = np.linalg.norm(gathered.deviation, axis=1)
    if float(np.median(size / np.maximum(band, 1e-12))) > POSSIBLE:
        raise points.error(
            f"the points are {float(np.median(size)) * 1e3:.3g} mm off the path (median), {np.median(size / band):.2g}"
            f" times the 95 % band of {float(np.median(band)) * 1e3:.3g} mm; check part, unit, frame and [part] of the"
            " job. --align best_fit removes a shift of the whole part, --assume-ok learns the points as they are"
        )


def plan_learned(job: Job, robot: Robot, residual: Residual | None) -> tuple[Toolpath, Plan]:
    """Plan a job with a given robot and residual; also return the nominal path before the residual is subtracted."""
    nominal, task, options = build_learned(job, robot, residual)
    # not evaluated as a job, which would reload robot and path: both are updated here, and the task has its force
    name = job.name or job.file.stem
    plan = replace(plan_task(task, options.strategy, name=name, output=job.output), job=job)
    if residual is not None:
        most = float(np.linalg.norm(residual.deviation, axis=1).max(initial=0.0)) * 1e3
        note = f"the path is shifted by up to {most:.3g} mm as learned from cut parts; deviations count from there"
        plan = plan.add_checks(state_notes([note]), first=True)
    return nominal, plan


def build_learned(job: Job, robot: Robot, residual: Residual | None) -> tuple[Toolpath, PlanTask, PlanOptions]:
    """Prepare the task of a job with a given robot; also return the nominal path and the plan options.

    With a residual, the postures are those of the residual; otherwise they are those that the job locks.
    """
    _, nominal, options = prepare_job(job)
    mounted = robot if job.tool is None else job.tool.mount(robot)
    options = replace(options, lock=options.lock or read_lock(job, mounted))
    target = nominal
    if residual is not None:
        target = replace(nominal, position=nominal.position - residual.at(nominal.arc_length))
    task = build_task(mounted, target, options, file=job.file)
    if residual is not None:
        task = keep_posture(task, residual, np.interp(task.origin, np.arange(len(nominal)), nominal.arc_length))
    return nominal, task, options


def keep_posture(task: PlanTask, residual: Residual, length: Array) -> PlanTask:
    """Return a task whose initial postures are nearest to those of a residual.

    length: arc length of the nominal path at every waypoint of the task. Shape (n,). [m]
    """
    near = interpolate(length, residual.length, residual.q)
    rotation = task.rotation
    if task.robot.nq >= 6:
        rotation = turn_about_axis(locate_frames(task.chain, near).tcp_rotation[:, :, 0], task.nominal.axis)
    arm = build_arm(task.robot)
    q, rotation, reached = solve_posture_near(arm, near, task.position, rotation, spin_free=task.spin_free)
    return replace(task, q_start=q, rotation=rotation, missed=~reached)


def add_residual(
    old: Residual | None, model_update: ModelUpdate, cut: CutPath, task: PlanTask, others: TransferResult
) -> tuple[Residual, Array, ModelUpdate]:
    """Add to the residual of a path: the deviation by the update minus that by the transferred robot and force.

    The residual changes only at measured places in measured directions: elsewhere it would extrapolate. The transferred
    robot and force are supported by cross-validation and act everywhere. Also returns the deviation that is expected
    but not subtracted, at the rows of the slopes, (k, 3) [m]; the band of the returned update includes it.

    old: residual before, or None; others: transferred robot and force.
    """
    rows, slopes = pick_rows(task.cut, MOST_PLACES), cut.slopes
    length, at = cut.length[rows], cut.length[slopes.rows]
    before = np.zeros((len(rows), 3)) if old is None else old.at(length)
    moved = cut.tip(model_update.values, model_update.force, rows) - cut.tip(others.held, others.shares, rows)
    own = moved + interpolate(length, at, model_update.residual)
    known = measured_directions(model_update.gathered, slopes.tip, task.position[rows])
    taken = np.einsum("nij,nj->ni", known, own)
    left = interpolate(at, length, own - taken)
    rms = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    model_update = replace(
        model_update, band_after=band_radius(model_update.next_part, mean=left),
        expected=float(np.hypot(model_update.expected, rms)),
    )  # fmt: skip
    return Residual(length, before + taken, task.q_start[rows]), left, model_update


def keep_state(
    model_update: ModelUpdate, cut: CutPath, length: Array, others: TransferResult, left: Array
) -> PathState:
    """Return what the next part of a path starts from: the posterior, and what neither folder nor program take over.

    The means of parameters and force that the folder does not hold are in the program. That share of the deviation may
    be of another cause: the means count as one more standard deviation, with the deviation left in the program.

    length: arc length at the rows of the slopes, (k,) [m]; left: deviation that is not subtracted, (k, 3) [m].
    """
    size = np.array([cut.force.level, *[cut.force.direction] * 3])
    size[0] /= 1.0 + size[0] * others.shares[0]  # relative to the level of the next program
    missed = np.r_[model_update.values - others.held, model_update.force - others.shares, left.ravel()]
    unit = np.r_[np.ones(len(others.held)), size, np.ones(left.size)]
    covariance = np.outer(unit, unit) * (model_update.joint + np.outer(missed, missed))
    return factor_state(cut.known.names, length, covariance)


def with_band(plan: Plan, model_update: ModelUpdate, slopes: Slopes, known: Uncertainty) -> Plan:
    """Add the band of the update to a plan: the band of this path is narrower than that of the robot elsewhere.

    What repeats from part to part, such as inertia, is in the measured part, hence in the posterior.
    """
    error_band = plan.error_band
    if error_band is None:
        return plan
    n, own = len(plan.task), model_update.model.own.following
    rows = slopes.rows * (n - 1) / max(len(error_band.cut) - 1, 1)
    tip = model_update.tip if model_update.taken else prior_of(model_update.model)
    pushed, placed = (part @ np.swapaxes(part, 1, 2) for part in (own[:, :, :1], own[:, :, 1:]))
    spread = {"model": take_blocks(tip, len(own)), "force": pushed, "placement": placed}
    radii = {name: np.interp(np.arange(n), rows, band_radius(part)) for name, part in spread.items()}
    parts = {name: radii.get(name, np.zeros(n)) for name in PARTS}
    parts["repeatability"] = error_band.parts["repeatability"]
    radius = np.interp(np.arange(n), rows, model_update.band_after) + plan.after.distance
    known = replace(known, grade="measured", source=f"{known.source}; {LEARNED}")
    better = replace(error_band, radius=radius, parts=parts, known=known, before=None, ladder=(), cheapest=())
    names = {**OTHER_CAUSES, "model": UNDETERMINED}
    better = replace(better, causes={names[name]: float(part[better.widest]) for name, part in parts.items()})
    run = np.broadcast_to((known.repeatability or 0.0) * np.eye(3), (len(own), 3, 3))
    value, vector = np.linalg.eigh(tip)
    repeats = (vector * np.sqrt(np.maximum(value, 0.0))).reshape(len(own), 3, -1)
    normal = np.random.default_rng(SEED).standard_normal((3 * len(own), PATHS))
    drawn = draw_columns(np.concatenate([repeats, own, run], axis=2), normal)
    whole = (better.greatest - better.between) * widen_to_path(drawn) + better.between
    return replace(plan, learned=replace(better, whole=whole))
