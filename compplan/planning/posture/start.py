"""Where a plan starts: the posture that the ladder graph chooses, or one fixed configuration where it finds none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InfeasibleError, InputError
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.clearance import ClearanceProfile, measure_clearance, measure_margin
from compplan.planning.posture.collision_scene import CollisionScene, compute_model_loads
from compplan.planning.posture.configuration import Preference, choose_posture, solve_default_posture
from compplan.planning.posture.contacts import describe_contact
from compplan.planning.posture.costs import ErrorModel
from compplan.planning.posture.follow import follow_from, follow_path
from compplan.planning.posture.partial import find_partial
from compplan.planning.posture.settings import PostureProblem, PostureSettings, read_settings
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CONFIGURATIONS, build_arm, name_configuration
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath

if TYPE_CHECKING:
    from compplan.job.job import Job


#: What a robot of four joints cannot do.
FOUR_JOINTS = (
    "The robot has four joints: it cannot choose where its tool points. The tip is corrected; what the load leans the"
    " tool stays (tilt_after_deg in plan.json), and points of the tool above the tip are aside by it."
)


#: Costs in words: what is best, what postures were, and what it means that they tie.
WORDS = {
    "driven_s": ("the fastest", "timed", "the programmed feed sets the time, not the posture"),
    "band_mm": ("that with the smallest 95 % band", "measured", "the posture does not set the 95 % band"),
    "joint_travel_deg": ("that with the least motion", "measured", "the path sets the motion, not the posture"),
}
#: Postures whose measures differ by less than this share tie.
TIED = 1e-3


@dataclass(frozen=True)
class PostureRequest:
    """What a job asks of the posture.

    Attributes:
        settings: What the search may vary and what it weighs.
        axes: Axes in whose components the wrench errs, as columns in base axes. Shape (3, 3).
        scene: What may touch what, or None.
        wanted: Clearance that is asked for. [m]

    """

    settings: PostureSettings
    axes: Array
    scene: CollisionScene | None = None
    wanted: float = 0.0

    def state(self, robot: Robot, nominal: Toolpath, tool_x: Array) -> PostureProblem:
        """State the choice of the posture along a path, x of the TCP pointing along tool_x (3,) at spin 0."""
        scene, wanted = self.scene, self.wanted
        margin = None if scene is None else lambda q, waypoints: measure_margin(scene, q, wanted)
        return PostureProblem(robot, nominal, np.asarray(tool_x, float), self.settings, self.axes, margin)


class Easing(NamedTuple):
    """How a run goes beside the fastest one, so that the arm rings less where its band is widest.

    Attributes:
        window: Windows of smoothing as a share of those that plans have.
        places: Places along the toolpath, waypoints counted from 0. Shape (k,).
        slower: Factor by which the run is slower there; accelerations fall with its square. Shape (k,).

    """

    window: float
    places: Array
    slower: Array


@dataclass(frozen=True)
class Bettered:
    """What the program of time, posture and promise made of the posture that the graph chose.

    Attributes:
        time: Time of the run before and after, nothing corrected. [s]
        band: Widest 95 % band before and after, nothing corrected. [mm]
        least_time: Time of the programmed feed, of rapid moves, and of smoothing at both ends of every run. [s]
        origin: Where it started: "search" (the posture search) or "programmed" (x of the tool as programmed).
        steps: Iterations of the program.
        names: What was free: "spin", "lead", "lean", or extra axes.

    """

    time: tuple[float, float]
    band: tuple[float, float]
    least_time: float
    origin: str
    steps: int
    names: tuple[str, ...]

    def describe(self) -> dict[str, object]:
        """Describe it for plan.json."""
        return {
            "free": list(self.names), "start": self.origin, "steps": self.steps,
            "time_s": {"graph": self.time[0], "program": self.time[1]},
            "band_p95_max_mm": {"graph": self.band[0], "program": self.band[1]},
            "least_time_s": self.least_time,
        }  # fmt: skip

    def sentence(self, pace: Easing | None = None) -> str:
        """Say it in a sentence; `pace` is how the run goes beside the fastest one."""
        (before, after), (wide, narrow) = self.time, self.band
        most = 1.0 if pace is None else float(pace.slower.max(initial=1.0))
        eased = "" if most == 1.0 else f"; the run is up to {most:.3g} times slower where the arm would ring most"
        eased += "" if pace is None or pace.window == 1.0 else f"; smoothed over {pace.window:.0%} of the usual time"
        head = f"Posture and speed are of one program ({', '.join(self.names)} free)"
        if not self.steps:
            posture = {"search": "the posture of the search",
                       "programmed": "one configuration with x of the tool as programmed"}[self.origin]  # fmt: skip
            head = f"Posture and speed are chosen together ({posture})"
        return (f"{head}: run {before:.4g} -> {after:.4g} s "
                f"(the programmed feed takes {self.least_time:.4g} s), widest 95 % band {wide:.3g} -> "
                f"{narrow:.3g} mm, before correction{eased}.")  # fmt: skip


@dataclass(frozen=True)
class Start:
    """Where a plan starts.

    Attributes:
        nominal: The path, its tool axis leaning as chosen.
        q: Joint positions that put the unloaded tool on the path. Shape (n, nq). [rad or m]
        rotation: Wanted orientation of the TCP frame. Shape (n, 3, 3).
        configuration: Shoulder, elbow and wrist along most of the path.
        missed: Waypoints that are not reached. Shape (n,).
        posture_choice: What the graph chose, or None where it found nothing (or was not asked).
        request: What was asked for, or None.
        notes: What a user should know, one sentence each.
        of_program: Whether q is a motion that is kept as it is: an earlier program's, or one that was followed.
        mend: What stops the first waypoint that is out of reach and what mends it, "" where all is reached.
        bettered: What the program made of the graph's posture, None where that is kept.
        pace: How the run goes beside the fastest one, None where it is that.
        aside: Where the path lies beside the programmed one, in its tube, None for nowhere. Shape (n, 3). [m]
        upright: Tool axis as programmed where `nominal` leans, None where it does not. Shape (n, 3).

    """

    nominal: Toolpath
    q: Array
    rotation: Array
    configuration: Mapping[str, str]
    missed: NDArray[np.bool_]
    posture_choice: PostureSummary | None = None
    request: PostureRequest | None = None
    notes: tuple[str, ...] = ()
    of_program: bool = False
    mend: str = ""
    bettered: Bettered | None = None
    pace: Easing | None = None
    aside: Array | None = None
    upright: Array | None = None


def read_request(job: Job, robot: Robot, errors: ErrorModel | None = None) -> PostureRequest:
    """Read what a job asks of the posture; `errors` is what the preset "error_band" counts.

    Raises:
        InputError: If a mesh that the job names is missing or cannot be read.

    """
    wanted = 0.0 if job.collision is None else job.collision.clearance_mm * 1e-3
    return PostureRequest(
        read_settings(job, robot, errors), job.T_base_part[:3, :3], compute_model_loads(job, robot), wanted
    )


def find_start(
    robot: Robot, nominal: Toolpath, tool_x: Array, wish: Preference, request: PostureRequest | None
) -> Start:
    """Find where a plan starts, x of the TCP pointing along tool_x (3,) at no rotation about the tool axis.

    `wish` is what is said about configuration and start; without a request one configuration and the orientation are
    kept as they are.

    Raises:
        InputError: If the wanted start lies outside the joint limits, or no waypoint is reached.

    """
    if robot.nq < 6:
        return _follow_few_joints(robot, nominal, tool_x, request)
    note: tuple[str, ...] = ()
    if request is not None:
        problem = request.state(robot, nominal, tool_x)
        stated = wish.start is not None and not robot.prismatic[: robot.nq - 6].all()  # where seven axes stand
        if stated and (followed := _follow_start(problem, wish, request)):
            return followed
        try:
            return stand(choose_posture_path(problem), nominal, request)
        except InfeasibleError as error:
            sentence = str(error)
        reason = f"{sentence[0].upper()}{sentence[1:]}."
        if request.scene is not None:
            blind = find_start(robot, nominal, tool_x, wish, replace(request, scene=None))
            if blind.posture_choice is not None:
                said = f"{reason} The posture is that without anything in the way."
                return replace(blind, request=request, notes=(said, *blind.notes))
        instead = _follow_start(problem, wish, request) or _keep_stretches(problem, request)
        if instead is not None:
            return instead
        note = (f"{reason} One configuration is kept instead, and x of the TCP frame points along plan.tool_x all the"
                " way.",)  # fmt: skip
    rotation = tool_axes(nominal, tool_x)
    posture = choose_posture(robot, nominal.position, rotation, wish)
    return Start(nominal, posture.q, rotation, posture.configuration, posture.missed, None, request, note)


def _follow_few_joints(robot: Robot, nominal: Toolpath, tool_x: Array, request: PostureRequest | None) -> Start:
    """Follow the path with an arm of four or five joints, along one branch."""
    arm = build_arm(robot)
    free = robot.nq == 5 or (request is not None and request.settings.free_spin)
    q, missed = follow_path(arm, nominal.position, tool_axes(nominal, tool_x), spin_free=free)
    if missed.all():
        least = ", which keep the tool where it points" if robot.nq < 5 else ""
        raise InputError(
            f"robot {robot.name!r} of {robot.nq} joints{least}: reaches no waypoint of the path in one branch"
        )
    note = (FOUR_JOINTS,) if robot.nq < 5 else ()
    return Start(nominal, q, locate_frames(arm.chain, q).tcp_rotation, {}, missed, None, request, note)


def _keep_stretches(problem: PostureProblem, request: PostureRequest) -> Start | None:
    """Go on along what is in reach where the graph finds no way along the whole path."""
    partial = find_partial(replace(problem, margin=None))
    if partial is None:
        return None
    said = f"{partial.sentence[0].upper()}{partial.sentence[1:]}."
    return Start(problem.nominal, partial.q, partial.rotation, partial.configuration, partial.missed, None, request,
                 (said,), of_program=True, mend=partial.mend)  # fmt: skip


def _follow_start(problem: PostureProblem, wish: Preference, request: PostureRequest) -> Start | None:
    """Go on from the job's start by the least motion of all joints; None where that does not lead along the path."""
    if wish.start is None or request.scene is not None:
        return None
    robot, nominal, settings = problem.robot, problem.nominal, problem.settings
    q, missed = follow_from(
        robot, problem.chain, nominal.position, tool_axes(nominal, problem.tool_x), wish.start,
        free_spin=settings.free_spin, most_step=settings.most_step,
    )  # fmt: skip
    if missed.any():
        return None
    told = "The motion goes on from the job's start, every waypoint by the least motion of the joints."
    return Start(nominal, q, locate_frames(problem.chain, q).tcp_rotation, name_along(robot, q), missed, None, request,
                 (told,), of_program=True)  # fmt: skip


def name_along(robot: Robot, q: Array) -> dict[str, str]:
    """Name the configuration along most of a motion."""
    arm = build_arm(robot)
    return CONFIGURATIONS[int(np.bincount(name_configuration(arm, q)).argmax())] if len(arm.arm) == 6 else {}


def stand(posture_choice: PostureSummary, nominal: Toolpath, request: PostureRequest) -> Start:
    """Start where the graph stands."""
    leaning = request.settings.lead > 0 or request.settings.lean > 0
    path = replace(nominal, axis=posture_choice.axis) if leaning else nominal
    words = tuple(
        f"The arm changes its configuration from {before} to {after} before waypoint {waypoint}."
        for waypoint, before, after in posture_choice.changes
    )
    if told := describe_finished(posture_choice):
        words += (told,)
    return Start(
        path, posture_choice.q, posture_choice.rotation, posture_choice.configuration, posture_choice.missed,
        posture_choice, request, words, upright=nominal.axis if leaning else None,
    )  # fmt: skip


def check_clearance(start: Start | None, q: Array) -> tuple[ClearanceProfile | None, dict[int, str]]:
    """Measure the clearance of a command; also tell the waypoints that come too near, and what is in the way."""
    if start is None or start.request is None or start.request.scene is None:
        return None, {}
    wanted = start.request.wanted
    profile = measure_clearance(start.request.scene, q, wanted)
    near = {
        int(waypoint): f"clearance ({describe_contact(contact)})"
        for waypoint, contact in zip(profile.computed, profile.contacts, strict=True)
        if contact.distance < wanted - 1e-4
    }
    if profile.own.first and profile.own.distance <= 0:
        near.setdefault(profile.own_waypoint, f"clearance ({describe_contact(profile.own)})")
    return profile, near


def find_plain(robot: Robot, nominal: Toolpath, tool_x: Array, start: Start) -> Start | None:
    """Start with one configuration and the tool's x as the job has it, in place of what the graph chose.

    None where the graph chose it already, or it cannot be kept.
    """
    if start.posture_choice is None or start.request is None or start.posture_choice.instead_of is not None:
        return None
    request = start.request
    posture_choice = solve_default_posture(request.state(robot, nominal, tool_x), start.posture_choice)
    return None if posture_choice is None else stand(replace(posture_choice, instead_of=None), nominal, request)


def describe_finished(posture_choice: PostureSummary) -> str:
    """Say what the postures come to that were compared, "" where none were."""
    if len(posture_choice.compared) < 2:
        return ""
    values, unit = posture_choice.compared.values(), posture_choice.compared_by.rpartition("_")[2]
    best, done, tied = WORDS[posture_choice.compared_by]
    head = f"Preset {posture_choice.settings.preset}: "
    if max(values) <= (1.0 + TIED) * min(values):
        said = f"{'take' if unit == 's' else 'come to'} {min(values):.4g} {unit}, within 0.1 %"
        return f"{head}the {len(values)} postures that were {done} {said}; {tied}."
    listed = ", ".join(f"{name} {value:.4g} {unit}" for name, value in posture_choice.compared.items())
    return f"{head}{best} of the postures that were {done} is driven ({listed})."


def compare_postures(robot: Robot, start: Start, tool_x: Array) -> tuple[dict[str, float], dict[str, float]] | None:
    """Return costs of the graph's way and of the plain posture; None where either is not known."""
    posture_choice, request = start.posture_choice, start.request
    if posture_choice is None or request is None:
        return None
    if posture_choice.plain is not None:
        return posture_choice.instead_of or posture_choice.costs, posture_choice.plain
    plain = solve_default_posture(replace(request, scene=None).state(robot, start.nominal, tool_x), posture_choice)
    return None if plain is None else (posture_choice.costs, plain.costs)
