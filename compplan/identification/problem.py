"""Options and structure of an identification, and selection of its springs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.effects import apply_effects, build_model, robot_effects, solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.effects.requested import GEOMETRY, effect_forms, geometry_forms
from compplan.effects.signature import Signature
from compplan.errors import InputError, UnknownNameError
from compplan.identification.estimate import REFERENCES, Estimate, fit_rows, leave_poses_out
from compplan.identification.parameters import FreeRobot, build_structure
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.intervals import gain_score
from compplan.measurement.fit.least_squares import BLOCKS, check_loss
from compplan.measurement.fit.rows import Rows, count_poses, usable_rows
from compplan.measurement.frames import fit_registration
from compplan.measurement.registration import PARTS, Registration, fitted_parts, folder_registration, match_targets
from compplan.robot import Array, Robot
from compplan.robot.springs import label_spring, link_springs, missing_springs, read_spring


@dataclass(frozen=True)
class IdentifySettings:
    """Thresholds of an identification."""

    #: Least ratio of absolute noise to noise of differences of one pose from which differences are preferred.
    least_noise_ratio: float = 1.5
    #: Fewest unloaded poses from which frames are fitted to these alone.
    unloaded_poses: int = 10
    #: Fewest poses from which geometry is fitted.
    geometry_poses: int = 30
    #: Rows with a smaller weight in Tukey's loss are gross outliers, if they are not more than `most_outliers` of all.
    outlier_weight: float = 0.05
    most_outliers: float = 0.05
    #: Standard errors by which geometry has to reduce the held-out score, and by which a spring absent from the robot
    #: has to exceed zero; about one in 700 by chance for each.
    least_ratio: float = 3.0


IDENTIFY = IdentifySettings()


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of `identify_campaign`."""

    register: tuple[str, ...] = ()  #: Frames to fit first: "base", "tool".
    #: Springs to identify, by name. None: those of the robot and, as candidates, a spring about the axis of each joint
    #: without one.
    springs: tuple[str, ...] | None = None
    add: tuple[str, ...] = ()  #: Springs ("joint_3.rx") added to the model.
    #: Whether joint-axis springs beyond the link-side encoders are candidates too (double encoders).
    link_side: bool = False
    #: Effects whose parameters are fitted too, by name or "name@joint" or "name@joint:form".
    effects: tuple[str, ...] = ()
    geometry: str = "auto"  #: "none", "offsets", "all", or "auto": the level that improves held-out poses.
    #: "absolute", "difference", or "auto": differences if geometry errs and poses have several loads.
    reference: str = "auto"
    #: "tukey" finds gross outliers with the richest model, removes them and fits by least squares; "huber" reduces the
    #: weight of rows far from the model; "least_squares" weighs all rows equally.
    loss: str = "tukey"


@dataclass(frozen=True)
class IdentifyProblem:
    """Common input of all fits of a campaign."""

    robot: Robot
    options: IdentifyOptions
    rows: Rows
    geometry: str = "none"

    @property
    def difference(self) -> bool:
        """Whether poses are compared with themselves under other loads."""
        return self.rows.reference == "difference"

    def forms(self) -> list[Signature]:
        """List the signatures of geometry and requested effects at the nominal robot."""
        if self.geometry == "none" and not self.options.effects:
            return []
        scene = build_model(self.robot, self.rows.campaign, registration=self.rows.registration)
        scene = apply_effects(scene, robot_effects(self.robot))
        at = linearize_model(scene, solve_model_poses(scene))
        return [*geometry_forms(at, self.geometry), *effect_forms(at, self.options.effects)]

    def structure(self) -> FreeRobot:
        """Build the structure of all candidates."""
        robot, options = self.robot, self.options
        demanded = tuple(read_spring(robot, name) for name in options.add)
        present = replace(robot, springs=(*robot.springs, *demanded))
        missing = () if options.springs is not None else missing_springs(present)
        present = replace(present, springs=(*present.springs, *missing))
        beyond = link_springs(present) if options.link_side else ()
        springs = None
        if options.springs is not None:
            springs = (*options.springs, *(label_spring(spring) for spring in (*demanded, *beyond)))
        added = (*demanded, *missing, *beyond)
        return build_structure(robot, springs=springs, add=added, forms=self.forms())

    def demanded(self, structure: FreeRobot) -> list[str]:
        """List the parameters kept without a test: those of the nominal model, and requested ones."""
        requested = {label_spring(spring) for spring in self.robot.springs}
        requested |= {*self.options.add, *(self.options.springs or ())}
        return [p.name for p in structure.parameters if p.name in requested or p.kind not in ("joint", "spring")]

    def fit(self, structure: FreeRobot) -> Estimate:
        """Fit a structure."""
        return fit_rows(structure, self.rows)


def place_frames(robot: Robot, campaign: Campaign, parts: tuple[str, ...]) -> Registration:
    """Find the initial frames: fitted to unloaded poses, read from the robot folder, or known."""
    parts = fitted_parts(campaign, parts)
    stated = folder_registration(robot)
    known = None if stated is None else match_targets(stated, campaign)
    if parts:
        rows = usable_rows(campaign)
        quiet = rows & campaign.unloaded
        if count_poses(campaign.q[quiet]) >= IDENTIFY.unloaded_poses:
            rows = quiet
        attained = solve_model_poses(apply_effects(build_model(robot, campaign), robot_effects(robot)))
        start = None if set(parts) & set(PARTS) else known
        return fit_registration(campaign, attained.position, attained.rotation, parts, rows=rows, start=start)
    return Registration.identity(campaign, ()) if known is None else replace(known, parts=())


def check_options(options: IdentifyOptions) -> None:
    """Raise an error for choices that do not exist.

    Raises:
        UnknownNameError: If a loss, a geometry or a reference does not exist.
    """
    check_loss(options.loss)
    if options.geometry not in (*GEOMETRY, "auto"):
        raise UnknownNameError("choice of geometry", options.geometry, [*GEOMETRY, "auto"])
    if options.reference not in (*REFERENCES, "auto"):
        raise UnknownNameError("reference", options.reference, [*REFERENCES, "auto"])


def screen_outliers(problem: IdentifyProblem) -> tuple[IdentifyProblem, tuple[int, ...], list[str]]:
    """Remove gross outliers of the richest model; a poorer model would mistake unmodelled effects for outliers.

    Returns:
        The problem without them, to be fitted by least squares; the removed rows; and notes. If more than
        `most_outliers` of the rows are outlying, no model here fits them: all are kept, with Huber's loss.
    """
    options, rows = problem.options, problem.rows
    if options.loss != "tukey":
        return problem, (), []
    geometry = "none" if options.geometry == "auto" else options.geometry
    if options.geometry == "auto" and rows.poses >= IDENTIFY.geometry_poses and options.reference != "difference":
        geometry = GEOMETRY[-1]
    richest = replace(problem, geometry=geometry)
    apart = richest.fit(richest.structure()).weights < IDENTIFY.outlier_weight
    if apart.mean() > IDENTIFY.most_outliers:
        sentence = f"{apart.mean():.0%} of the rows lie apart from every model tried, too many for gross outliers"
        wide = replace(problem, rows=replace(rows, loss="huber"))
        return wide, (), [f"{sentence}: all are kept, with Huber's loss"]
    kept = replace(rows, row=rows.row[~apart], loss="least_squares")
    return replace(problem, rows=kept), tuple(rows.row[apart].tolist()), []


def choose_geometry(problem: IdentifyProblem) -> IdentifyProblem:
    """Select the level of geometry that improves held-out poses."""
    requested = problem.options.geometry
    if requested != "auto" or problem.options.reference == "difference":
        return replace(problem, geometry="none" if requested == "auto" else requested)
    if problem.rows.poses < IDENTIFY.geometry_poses:
        return problem
    best, score = problem, held_out_score(problem, problem.fit(problem.structure()))
    for level in GEOMETRY[1:]:
        richer = replace(problem, geometry=level)
        after = held_out_score(richer, richer.fit(richer.structure()))
        if gain_score(score, after) > IDENTIFY.least_ratio:
            best, score = richer, after
    return best


def held_out_score(problem: IdentifyProblem, estimate: Estimate) -> Array:
    """Compute the held-out score of a fit, in stated standard deviations. Shape (poses,)."""
    return leave_poses_out(problem.rows, replace(estimate, noise=np.ones(BLOCKS))).score


def choose_reference(problem: IdentifyProblem) -> tuple[IdentifyProblem, list[str]]:
    """Select differences under other loads if these are much less noisy than absolute poses."""
    requested, rows = problem.options.reference, problem.rows
    apart = replace(rows, reference="difference", registration=replace(rows.registration, parts=()))
    differences = replace(problem, geometry="none", rows=apart)
    if requested != "auto":
        return (differences if requested == "difference" else problem), []
    loads, group = np.round(rows.taken.wrench, 1), rows.alike
    several = [len(np.unique(loads[group == k], axis=0)) > 1 for k in range(int(group.max()) + 1)]
    if np.mean(np.asarray(several)[group]) < 0.5:
        return problem, []
    try:
        absolute, relative = problem.fit(problem.structure()), differences.fit(differences.structure())
    except InputError:
        return problem, []
    ratio = float(absolute.noise[0] / relative.noise[0])
    if ratio < IDENTIFY.least_noise_ratio:
        return problem, []
    return differences, [
        f"poses are compared with themselves under other loads: absolute positions scatter {ratio:.1f} times as much,"
        " so geometry errs; compplan diagnose looks for the reason"
    ]


def select_springs(problem: IdentifyProblem, structure: FreeRobot, full: Estimate) -> Estimate:
    """Drop springs one by one, the least significant first, and refit [Johra2022].

    Compliances below zero are dropped, and candidates less than `least_ratio` standard errors above zero. `full` is the
    fit of all parameters of the structure; its inseparable parameters are held.
    """
    requested = set(problem.demanded(structure))
    names = [name for name, free in zip(full.names, full.free, strict=True) if free and name in structure.names]
    dropped: list[str] = []
    while True:
        estimate = problem.fit(_make_rigid(structure.select(names), dropped))
        fitted = zip(estimate.structure.parameters, estimate.model_values, estimate.standard_errors, strict=False)
        ratio = {p.name: value / max(error, 1e-300) for p, value, error in fitted if p.kind in ("joint", "spring")}
        weak = [(r, name) for name, r in ratio.items() if r < (0.0 if name in requested else IDENTIFY.least_ratio)]
        if not weak:
            return estimate
        dropped.append(min(weak)[1])
        names.remove(dropped[-1])


def _make_rigid(structure: FreeRobot, names: Sequence[str]) -> FreeRobot:
    """Set the compliance of some springs that are not free to zero."""
    springs = tuple(
        replace(spring, compliance=0.0) if label in names else spring
        for spring, label in zip(structure.robot.springs, structure.spring_labels, strict=True)
    )
    return replace(structure, robot=replace(structure.robot, springs=springs))
