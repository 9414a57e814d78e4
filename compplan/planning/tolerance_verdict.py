"""Verdict: whether the 95 % band of the true tip lies within the tolerance, its largest cause, and the remedy.

`keeps` if the band of the complete cut lies within the tolerance, `may_not_keep` if not, `not_known` if a cause of
deviations is unknown and the rest of the band lies within the tolerance.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.io.quantities import join_names, state_mm
from compplan.planning.task import CORRECTION_LIMIT, PlanTask
from compplan.process.learned_force import FILE as PROCESS
from compplan.robot import Array, Robot
from compplan.uncertainty.band import CAUSES, LEARNED, UNDETERMINED, ErrorBand
from compplan.uncertainty.ladder import DO, SHORT

FORCE, INERTIA = "process force", "inertia and vibration"
#: Values of the verdict.
KEEPS, MAY_NOT_KEEP, NOT_KNOWN = "keeps", "may_not_keep", "not_known"
MEASURE = "Measure the robot: compplan campaign JOB --poses 12 --out poses."
NEXT_PART = "Measure the next part, too: compplan learn JOB MEASURED --robot OUT/robot."
LET_COMPENSATE = "Let the plan compensate it: [plan] inertia = true."
#: Cause and remedy of a program without correction.
UNCORRECTED, CORRECT = 'the program is not corrected (plan.strategy = "none")', 'Correct it: plan.strategy = "nlp".'
#: Coordinates of the part below which they may be metres: so near to the base no arm reaches (assumed). [mm]
MOST_METRES = 10.0
#: Causes that less force reduces.
ELASTIC = (FORCE, "stiffness of the robot")
#: Next step if a check disagrees with the plan or its files.
RESOLVE = "Do not run the programs. Change what is named here in job or robot folder, or report it as a defect."
#: Message in place of the band of a compromise.
NO_BAND = "No 95 % band is stated, waypoints are out of reach"
#: Remedy by the largest cause.
CHANGES = {
    FORCE: "Measure the process force and write its uncertainty into the job: [noise] wrench_level.",
    INERTIA: "Lower the feed.",
    "place of the part": "Measure where the part is: [noise] part_frame_mm, part_frame_deg.",
    UNDETERMINED: NEXT_PART,
    "repeatability": "Allow more than {band}, or take a robot that repeats better.",
}


@dataclass(frozen=True)
class ToleranceVerdict:
    """Verdict on the tolerance of a plan."""

    word: str  #: "keeps", "may_not_keep" or "not_known".
    sentence: str  #: The same as a sentence, with the remedy.
    tolerance: float  #: Greatest allowed deviation. [m]
    band: float | None  #: 95 % band of the complete cut; None if unknown. [m]
    #: Share of the cut, by length, with a band beyond the tolerance; None if unknown.
    beyond_share: float | None
    largest_cause: str  #: Largest cause of the band at its widest place, or the unknown cause.
    change: str  #: Remedy in one sentence, "" if none is necessary.
    basis: str  #: Basis of the band: measured or assumed.
    left_out: tuple[str, ...]  #: Causes of deviations that the band does not include.

    def describe(self) -> dict[str, Any]:
        """Describe the verdict for plan.json."""
        lengths = {"tolerance_mm": self.tolerance, "band_mm": self.band}
        plain = {name: value for name, value in vars(self).items() if name not in ("tolerance", "band")}
        return {**plain, **{name: None if value is None else 1e3 * value for name, value in lengths.items()}}


def check_tolerance(
    task: PlanTask, status: str, error_band: ErrorBand | None, *, before: Array, left: Array, known: bool,
    failures: Mapping[int, str], failure: str = "", position_mm: Sequence[float] = (),
    corrected: bool = True, compensates: bool = True, traced: bool = False,
) -> ToleranceVerdict:  # fmt: skip
    """Check the 95 % band of a plan against the tolerance.

    Args:
        task: The task of the plan.
        status: "solved", "not_confirmed" or "infeasible".
        error_band: The 95 % band of the true tip, None if unknown.
        before: Distance of the tip from the path without correction, for a robot as modelled. Shape (n,). [m]
        left: The same with correction. Shape (n,). [m]
        known: Whether masses and springs are known, so that the band includes inertia.
        failures: Failed waypoints and their limits.
        failure: Description of the failure.
        position_mm: Position of the part; () for none.
        corrected: Whether the strategy corrects the program.
        compensates: Whether the job allows the plan to compensate the inertia of the motion.
        traced: Whether the drives were identified.
    """
    wanted, error_band = state_mm(task.tolerance), None if status == "infeasible" else error_band
    band, basis = (None, "") if error_band is None else (error_band.whole, describe_basis(error_band))
    inertia = "" if compensates or not known else " Inertia is not compensated: [plan] inertia = false."
    left_out = list_left_out(task.robot, inertia_known=known, traced=traced)

    def state(word: str, sentence: str, cause: str, change: str, share: float | None) -> ToleranceVerdict:
        return ToleranceVerdict(word, sentence, task.tolerance, band, share, cause, change, basis, left_out)

    def withhold(missing: str, change: str, share: float | None) -> ToleranceVerdict:
        head = "" if status == "solved" else "Do not start. "
        sentence = f"{head}Not known whether it keeps {wanted}: {missing}. {change}{inertia}"
        return state(NOT_KNOWN, sentence, missing, change, share)

    if status == "infeasible":
        cause, change = explain_limits(failures, before, position_mm)
        first = f" (the first is waypoint {min(failures)})" if failures else ""
        sentence = (f"Do not start: there is no solution. May not keep {wanted}: {len(failures)} waypoints are not "
                    f"reached within the limits{first}. Largest cause: {cause}. {change} {NO_BAND}.{inertia}"
                    )  # fmt: skip
        return state(MAY_NOT_KEEP, sentence, cause, change, None)
    if error_band is None:
        return withhold("no robot within the uncertainty has an equilibrium under this load", MEASURE, None)
    use, length = np.where(task.cut, error_band.along, 0.0) / task.tolerance, task.nominal.arc_length
    beyond = use > 1.0
    share, cause = share_length(length, task.cut, beyond), find_cause(error_band, left, corrected=corrected)
    if beyond.any():
        change = find_change(error_band, cause, compensates=compensates)
        worst = f"{1e3 * length[error_band.widest]:.4g} mm along the path"
        off = (f"May not keep {wanted}: the tip may be up to {state_mm(error_band.whole)} off the path (95 %). Band "
               f"above the tolerance on {state_percent(share)} of the cut, worst at {worst}. Largest cause: {cause}."
               )  # fmt: skip
        sentence = f"{off} {change}{'' if change == LET_COMPENSATE else inertia}"
        if status != "solved":
            change = CORRECT if cause == UNCORRECTED else RESOLVE
            sentence = f"Do not start: the plan is {failure}. {change} {off}"
        return state(MAY_NOT_KEEP, sentence, cause, change, share)
    if status == "not_confirmed":
        return withhold(f"the plan is {failure}", RESOLVE, share)
    if task.robot.uncertainty is None and task.robot.grade == "placeholder":
        return withhold("the stiffness of this robot was never measured (its model is a placeholder)", MEASURE, share)
    if not known:
        missing = "the robot folder has no masses or no springs, so inertia is not counted"
        return withhold(missing, "State them in its folder.", share)
    sentence = (f"Keeps {wanted}: with 95 % probability the tip stays within "
                f"{state_mm(error_band.whole)} along the whole cut ({basis}).{inertia}")  # fmt: skip
    return state(KEEPS, sentence, cause, "", share)


def explain_limits(failures: Mapping[int, str], before: Array, position_mm: Sequence[float]) -> tuple[str, str]:
    """Return the limits that stop most waypoints, and the remedy. before: distance without correction, (n,) [m]"""
    first = (re.sub(r"^clearance [(](.*)[)]$", r"\1", text.split(", ")[0]) for text in failures.values())
    listed = [f"{name} at {count} waypoints" for name, count in Counter(first).most_common(2)]
    beyond = [waypoint for waypoint, text in failures.items() if text == CORRECTION_LIMIT]
    others, limit = len(failures) - len(beyond), "plan.max_correction_mm above"
    limit += f" {1e3 * float(before[beyond].max(initial=0.0)):.4g}"
    change = f"Raise {limit} ({len(beyond)} waypoints)."
    if others:
        change = f"Run compplan place JOB ({others} waypoints); the other {len(beyond)} need {limit}."
    if not beyond:
        change = "Move the part: compplan place JOB finds a place in reach."
    if 0.0 < max(map(abs, position_mm), default=0.0) < MOST_METRES:
        change = f"Is part.position_mm = {list(position_mm)} in metres, not in mm? If it is right: compplan place JOB."
    return ", ".join(listed) or "limits", change


def find_cause(error_band: ErrorBand, left: Array, *, corrected: bool) -> str:
    """Find the cause whose measurement narrows the band most, otherwise the largest cause at the widest place."""
    own = "path error of the corrected program" if corrected else UNCORRECTED
    causes = {**error_band.causes, own: float(left[error_band.widest])}
    alone = {rung.step: rung.alone for rung in error_band.ladder}
    largest = max(causes, key=causes.__getitem__)
    if largest in (*CAUSES, FORCE) and {"force_log", "poses"} <= set(alone):
        if alone["force_log"] < alone["poses"]:
            return FORCE
        return max(set(causes) & set(CAUSES), key=causes.__getitem__)
    return largest


def find_change(error_band: ErrorBand, cause: str, *, compensates: bool = True) -> str:
    """Find the remedy: the cheapest sufficient measurements, otherwise another tolerance, force or measurement."""
    if cause == UNCORRECTED:
        return CORRECT
    if error_band.ladder and cause not in (INERTIA, "place of the part", "repeatability"):
        if error_band.cheapest:
            chosen = " and ".join(DO[step] for step in error_band.cheapest)
            return f"{chosen[0].upper()}{chosen[1:]}: then it keeps."
        best = min(rung.band for rung in error_band.ladder[1:])
        steps = join_names([SHORT[rung.step] for rung in error_band.ladder[1:]])
        # clearly more: corners and fit of the program use a share of the tolerance
        allow = f"allow more than {state_mm(best)}, the band after {steps}"
        return f"Reduce the force, or {allow}." if cause in ELASTIC else f"A{allow[1:]}; less force helps little."
    if cause == INERTIA and not compensates:
        return LET_COMPENSATE
    if cause == FORCE and error_band.force.source.startswith(PROCESS):
        return NEXT_PART
    return CHANGES.get(cause, MEASURE).format(band=state_mm(error_band.whole))


def describe_basis(error_band: ErrorBand) -> str:
    """State whether robot and force are measured or assumed."""
    if LEARNED in error_band.known.source:
        return f"robot and force {LEARNED}"
    robot = "measured" if error_band.known.grade == "measured" else "assumed, not measured"
    if error_band.force.source.startswith(PROCESS):
        return f"robot {robot}; force learned from measured parts"
    if not np.any(error_band.parts["force"]):
        return f"robot {robot}; cutting force left out ([process] adds it)"
    if "assumed" not in error_band.force.source:
        return f"robot {robot}; force as the job states it"
    return "robot measured; force assumed" if robot == "measured" else f"robot and force {robot}"


def list_left_out(robot: Robot, *, inertia_known: bool, traced: bool) -> tuple[str, ...]:
    """List the causes of deviations that the band does not include."""
    left_out = []
    if not traced and not any(effect["effect"] == "tracking_lag" for effect in robot.effects):
        left_out.append("path errors of the controller (no trace of it)")
    if not inertia_known:
        left_out.append("inertia and vibration of the arm (no masses, or no springs)")
    return (*left_out, "ringing after rapid moves", "bending of the cutter", "chatter", "warming up")


def share_length(length: Array, cut: NDArray[np.bool_], chosen: NDArray[np.bool_]) -> float:
    """Compute the share of a cut, by length, of chosen waypoints: half of each adjacent move.

    length: arc length of the path at each waypoint [m]; cut, chosen: masks of waypoints. Shapes (n,).
    """
    half = 0.5 * np.diff(length) * (cut[1:] & cut[:-1])
    weight = np.r_[half, 0.0] + np.r_[0.0, half]
    weight = weight if weight.any() else cut.astype(float)
    return float(weight[chosen].sum() / max(weight.sum(), 1e-300))


def state_percent(share: float) -> str:
    """Format a share of the cut in percent, in ASCII, for messages and programs."""
    percent = 100.0 * share
    return "below 0.1 %" if percent < 0.1 else "all" if percent > 99.95 else f"{percent:.3g} %"
