"""The verdict: whether the part may be expected within its tolerance, what speaks against it, and what would change it.

`status` says what the equations and the judge say. The verdict says what the 95 % band of the true tip says: `keeps`
where the whole cut stays within the tolerance with 95 %, `may_not_keep` where it does not, `not_known` where something
that moves the tip is not known, or the path was read by one reader alone, and the rest of the band lies within the
tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.uncertainty.band import CAUSES, ErrorBand
from compplan.uncertainty.ladder import DO

if TYPE_CHECKING:
    from compplan.planning.result import Plan

FORCE = "process force"
#: Words of the verdict.
KEEPS, MAY_NOT_KEEP, NOT_KNOWN = "keeps", "may_not_keep", "not_known"
#: Stretches beyond the tolerance that are listed.
LISTED = 20
MEASURE = "Measure the robot: compplan campaign JOB --poses 12 --out poses."
TOUCH_OFF = "Touch the part off with this robot and tool, and leave out [part] touched_off = false."
LET_COMPENSATE = "Let the plan compensate it: [plan] inertia = true."
#: The next step where a check disagrees with the plan or its files.
SETTLE = (
    "Do not run the programs. Change what is named here in the job or the robot folder; if neither explains it, "
    "report both as a defect."
)
#: What is said of the band of a compromise.
NO_BAND = "no 95 % band is stated, waypoints are out of reach"
#: A band so many times as wide as the uncorrected program is off is explained.
WIDE = 10.0
#: What would change the verdict, by the largest cause.
CHANGES = {
    "process force": "Measure the process force and write its uncertainty into the job: [noise] wrench_level.",
    "inertia and vibration": "Lower the feed.",
    "place of the part": "Measure where the part is: [noise] part_frame_mm, part_frame_deg.",
    "repeatability": "Allow more, or take a robot that repeats better.",
}


@dataclass(frozen=True)
class Stretch:
    """A stretch of the cut whose band reaches beyond the tolerance.

    Attributes:
        first: Its first waypoint.
        last: Its last waypoint.
        start: Length of the path at its first waypoint. [m]
        end: Length of the path at its last waypoint. [m]
        most: Widest band in it. [m]
    """

    first: int
    last: int
    start: float
    end: float
    most: float


@dataclass(frozen=True)
class ToleranceVerdict:
    """Whether the part may be expected within its tolerance.

    Attributes:
        word: "keeps", "may_not_keep" or "not_known".
        sentence: The same for people, with what to do about it.
        tolerance: Greatest deviation that counts as within tolerance, the strictest of all parts. [m]
        band: Distance that the whole cut keeps within with 95 %; None where it is not known. [m]
        beyond_share: Share of the cut, by length, whose band reaches beyond the tolerance; None where not known.
        where: Stretches of the cut beyond the tolerance.
        largest_cause: What makes the band widest where it is widest, or what is not known.
        change: What would change the verdict, one sentence, "" where nothing has to.
        basis: What the band rests on.
        left_out: What moves the tip and is not in the band.
    """

    word: str
    sentence: str
    tolerance: float
    band: float | None
    beyond_share: float | None
    where: tuple[Stretch, ...]
    largest_cause: str
    change: str
    basis: str
    left_out: tuple[str, ...]

    def describe(self) -> dict[str, Any]:
        """Describe it for plan.json."""
        return {
            "word": self.word,
            "sentence": self.sentence,
            "tolerance_mm": 1e3 * self.tolerance,
            "band_mm": None if self.band is None else 1e3 * self.band,
            "beyond_share": self.beyond_share,
            "largest_cause": self.largest_cause,
            "change": self.change,
            "basis": self.basis,
            "where": [
                {"waypoints": [one.first, one.last], "s_mm": [1e3 * one.start, 1e3 * one.end],
                 "band_mm": 1e3 * one.most}
                for one in self.where[:LISTED]
            ],
            "stretches": len(self.where),
            "left_out": list(self.left_out),
        }  # fmt: skip

    @property
    def head(self) -> tuple[str, ...]:
        """Short lines for the head of a program."""
        words = {KEEPS: "keeps", MAY_NOT_KEEP: "MAY NOT KEEP", NOT_KNOWN: "NOT KNOWN if it keeps"}
        lines = [f"verdict: {words[self.word]} {_mm(self.tolerance)}"]
        if self.band is not None:
            lines.append(f"true tip within {_mm(self.band)}, 95 %")
        if self.beyond_share:
            lines.append(f"beyond: {_percent(self.beyond_share)} of the cut")
        return tuple(lines)


def check_tolerance(plan: Plan) -> ToleranceVerdict:
    """Judge whether the part of a plan may be expected within its tolerance."""
    task, promise = plan.task, plan.promise
    if plan.status == "infeasible":
        return _no_solution(plan)
    if promise is None:
        return _not_known(plan, "no robot within the uncertainty has an equilibrium under this load", MEASURE, None)
    use = use_tolerance(task, promise)
    beyond = task.cut & (use > 1.0)
    share = share_length(task.nominal.arc_length, task.cut, beyond)
    if beyond.any():
        return _may_not_keep(plan, promise, beyond, share)
    if plan.status == "not_confirmed":
        return _not_known(plan, f"the plan is {plan.explain_failures()}", SETTLE, share)
    if missing := find_missing(plan):
        return _not_known(plan, *missing, share)
    basis, cause = describe_basis(promise), find_cause(plan, promise)
    most = "" if task.allowed is None else f", and uses {_percent(float(use[task.cut].max()))} of the tolerance at most"
    sentence = (f"Keeps {describe_tolerance(task)}: with 95 % the tip stays within {_mm(promise.whole)} along the"
                f" whole cut{most} ({basis}).{describe_inertia(plan)}")  # fmt: skip
    return ToleranceVerdict(
        KEEPS, sentence, task.tolerance, promise.whole, share, (), cause, "", basis, list_left_out(plan)
    )


def use_tolerance(task: PlanTask, promise: ErrorBand) -> Array:
    """Return the share of its tolerance that the band of the whole path uses at each waypoint. Shape (n,)."""
    if task.allowed is None:
        return promise.along / task.tolerance
    mean = None if promise.motion is None else promise.motion.mean
    return task.allowed.use_of_band(promise.along, promise.covariance, mean)


def describe_tolerance(task: PlanTask) -> str:
    """Say the tolerance, or the range of those across the travel where parts of the cut have their own."""
    if task.allowed is None:
        return _mm(task.tolerance)
    sizes = task.allowed.normal[task.cut]
    span = "" if np.ptp(sizes) == 0.0 else f"{_mm(sizes.min())} to "
    along = task.allowed.tangential[task.cut & task.allowed.apart]
    more = f" across the travel, {_mm(along.min())} along it" if len(along) else ""
    return f"{span}{_mm(sizes.max())}{more}"


def _may_not_keep(plan: Plan, promise: ErrorBand, beyond: NDArray[np.bool_], share: float) -> ToleranceVerdict:
    task, length = plan.task, plan.task.nominal.arc_length
    cause = find_cause(plan, promise)
    change = find_change(plan, promise, cause)
    off = f"the tip may be up to {_mm(promise.whole)} off the path (95 %). Beyond the tolerance: {_percent(share)}"
    use = np.where(plan.task.cut, use_tolerance(plan.task, promise), 0.0)
    widest = promise.widest if plan.task.allowed is None else int(use.argmax())
    off += f" of the cut, most of all {1e3 * length[widest]:.4g} mm along the path"
    if plan.task.allowed is not None:
        off += f" (band {_mm(promise.along[widest])}, {use[widest]:.2g} times its tolerance)"
    sentence = f"May not keep {describe_tolerance(plan.task)}: {off}. Largest cause: {cause}. {change}"
    sentence += "" if change == LET_COMPENSATE else describe_inertia(plan)
    if plan.status != "solved":
        change = SETTLE
        head = f"Do not start: the plan is {plan.explain_failures()}. {SETTLE}"
        sentence = f"{head} May not keep {describe_tolerance(plan.task)}: {off}. Largest cause: {cause}."
    where = find_stretches(beyond, length, promise.along)
    return ToleranceVerdict(
        MAY_NOT_KEEP, sentence.strip(), task.tolerance, promise.whole, share, where, cause, change,
        describe_basis(promise), list_left_out(plan),
    )  # fmt: skip


def _no_solution(plan: Plan) -> ToleranceVerdict:
    """Return the verdict of a best compromise: where waypoints are out of reach there is no band to state."""
    failures = plan.command.failures
    limits = sorted({name for text in failures.values() for name in text.split(", ")})
    cause = f"limits ({', '.join(limits[:2])})" if limits else "limits"
    change = "Move the part (compplan place JOB), or allow more."
    first = f" (the first is waypoint {min(failures)})" if failures else ""
    sentence = (
        f"Do not start: there is no solution. May not keep {describe_tolerance(plan.task)}: "
        f"{len(failures)} waypoints are not reached within the limits{first}. Largest cause: {cause}. {change} "
        f"{NO_BAND[0].upper()}{NO_BAND[1:]}.{describe_inertia(plan)}"
    )
    return ToleranceVerdict(
        MAY_NOT_KEEP, sentence, plan.task.tolerance, None, None, (), cause, change, "", list_left_out(plan)
    )


def _not_known(plan: Plan, missing: str, change: str, share: float | None) -> ToleranceVerdict:
    task, promise = plan.task, plan.promise
    basis, band = ("", None) if promise is None else (describe_basis(promise), promise.whole)
    head = "" if plan.status == "solved" else "Do not start. "
    sentence = (f"{head}Not known whether it keeps {describe_tolerance(task)}: {missing}. {change}"
                f"{describe_inertia(plan)}")  # fmt: skip
    return ToleranceVerdict(
        NOT_KNOWN, sentence.strip(), task.tolerance, band, share, (), missing, change, basis, list_left_out(plan)
    )


def find_missing(plan: Plan) -> tuple[str, str] | None:
    """Say what has to be known for a verdict and is not, and what to do about it; None where all is known."""
    robot = plan.task.robot
    if robot.uncertainty is None and robot.grade == "placeholder":
        return "the stiffness of this robot was never measured (its model is a placeholder)", MEASURE
    if not np.isfinite(plan.bending.inertia):
        return "the robot folder has no masses or no springs, so inertia is not counted", "State them in its folder."
    return None


def find_cause(plan: Plan, promise: ErrorBand) -> str:
    """Name the cause whose measurement narrows the band most, otherwise what makes it widest where it is widest."""
    left = float(plan.after.distance[promise.widest])
    causes = {**promise.causes, "what the plan itself leaves": left}
    largest = max(causes, key=lambda name: causes[name])
    alone = {rung.step: rung.alone for rung in promise.ladder}
    if largest not in (*CAUSES, FORCE) or not {"force_log", "poses"} <= set(alone):
        return largest
    if alone["force_log"] < alone["poses"]:
        return FORCE
    return max((name for name in causes if name in CAUSES), key=lambda name: causes[name])


def find_change(plan: Plan, promise: ErrorBand, cause: str) -> str:
    """Say what would change the verdict: the cheapest measurements that suffice, or that which narrows most."""
    if promise.ladder and cause not in ("inertia and vibration", "place of the part", "repeatability"):
        if promise.cheapest:
            chosen = " and ".join(DO[step] for step in promise.cheapest)
            return f"{chosen[0].upper()}{chosen[1:]}: then it keeps."
        best = min(promise.ladder[1:], key=lambda rung: rung.band)
        return f"No measurement suffices: all together leave {_mm(best.band)}. Allow more, or reduce the force."
    if cause == "inertia and vibration" and not wants_inertia(plan):
        return LET_COMPENSATE
    if cause in CHANGES:
        return CHANGES[cause]
    if cause in CAUSES and promise.known.grade == "measured":
        zero = f"joint_offset {plan.task.robot.actuated[0].name}"
        if promise.leading and promise.leading[0][0] == zero:
            return TOUCH_OFF
        return "Measure more poses: compplan campaign JOB --poses 12 --out poses."
    return MEASURE


def describe_basis(promise: ErrorBand) -> str:
    """Say what the band rests on, in a few words."""
    robot = "measured" if promise.known.grade == "measured" else "assumed"
    force = "assumed" if "assumed" in promise.force.source else "stated"
    said = "the robot is measured" if robot == "measured" else "the robot is assumed, not measured"
    if not np.any(promise.parts["force"]):
        return said
    if robot == force:
        return "robot and force are assumed, not measured"
    return f"{said}; the force is {force}"


def explain_width(promise: ErrorBand | None, nominal: float) -> str:
    """Say why a band is far wider than the uncorrected program is off, nominal [m]; "" where it is not."""
    if promise is None or promise.greatest <= WIDE * nominal:
        return ""
    cause = max(promise.causes, key=lambda name: promise.causes[name], default="the uncertainty of the robot")
    share = f", above all {promise.leading[0][0]} ({_percent(promise.leading[0][1])})" if promise.leading else ""
    return (
        f" The band is wide, {_mm(promise.greatest)} where the uncorrected program is off by {_mm(nominal)} in the"
        f" model: most of it comes from {cause}{share}."
    )


def wants_inertia(plan: Plan) -> bool:
    """Tell whether the job lets the plan compensate the inertia of the motion."""
    return plan.job is None or plan.job.plan.inertia


def describe_inertia(plan: Plan) -> str:
    """Say that inertia is left alone where the job wants it so, "" otherwise."""
    if wants_inertia(plan) or not np.isfinite(plan.bending.inertia):
        return ""
    return " Inertia is not compensated: [plan] inertia = false."


def list_left_out(plan: Plan) -> tuple[str, ...]:
    """List what moves the tip and is not in the band."""
    told = []
    traced = plan.executed is not None and plan.executed.known
    if not traced and not any(effect["effect"] == "tracking_lag" for effect in plan.task.robot.effects):
        told.append("path errors of the controller (no trace of it)")
    if not np.isfinite(plan.bending.inertia):
        told.append("inertia and vibration of the arm (no masses, or no springs)")
    if plan.promise is None or not plan.promise.placed:
        told.append("place of the part ([noise] part_frame_mm states none)")
    told += ["ringing after rapid moves", "bending of the cutter", "chatter", "warming up"]
    return tuple(told)


def share_length(length: Array, cut: NDArray[np.bool_], chosen: NDArray[np.bool_]) -> float:
    """Return the share of a cut, by its length, that chosen waypoints stand for: half of each move beside them.

    Args:
        length: Length of the path at each waypoint. Shape (n,). [m]
        cut: Waypoints of the cut. Shape (n,).
        chosen: Waypoints among them. Shape (n,).
    """
    half = 0.5 * np.diff(length) * (cut[1:] & cut[:-1])
    weight = np.r_[half, 0.0] + np.r_[0.0, half]
    if not weight.any():
        weight = cut.astype(float)
    return float(weight[chosen].sum() / weight.sum()) if weight.sum() > 0.0 else 0.0


def find_stretches(beyond: NDArray[np.bool_], length: Array, band: Array) -> tuple[Stretch, ...]:
    """Return the runs of waypoints beyond the tolerance, in order."""
    edge = np.flatnonzero(np.diff(np.r_[False, beyond, False].astype(int)))
    return tuple(
        Stretch(a, b - 1, float(length[a]), float(length[b - 1]), float(band[a:b].max()))
        for a, b in zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True)
    )


def _mm(length: float) -> str:
    """Write a length in mm with three digits at most, never less than it is."""
    return f"{1e3 * length:.3g} mm"


def _percent(share: float) -> str:
    percent = 100.0 * share
    return "below 0.1 %" if percent < 0.1 else "all" if percent > 99.95 else f"{percent:.3g} %"
