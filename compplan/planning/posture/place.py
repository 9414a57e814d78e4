"""Where the part should stand: the place in the cell at which least of the deviation would remain after compensation.

A grid of places is rated by a lower bound: at some stations of the path the best posture of all rotations and
configurations, each for itself. The best places are then refined, and the plan's own search (with continuity, limits
and collision) decides among them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from compplan.errors import InfeasibleError, InputError
from compplan.job.frames import PartTable
from compplan.job.job import Job
from compplan.job.loading import load_nominal
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.costs import ErrorModel, measure_nodes
from compplan.planning.posture.lattice import build_options, orient_options, pick_stations
from compplan.planning.posture.search import measure_rungs
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.start import read_request
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.ik import Arm, build_arm, solve_branches
from compplan.toolpath.toolpath import Toolpath

#: Stations, step of rotation [rad] and positions of extra axes that the grid is rated with.
STATIONS, SPIN_STEP, HELD_STEPS = 14, float(np.radians(20.0)), 5
#: Places that may be rated, and postures that are solved at once.
MOST_PLACES, BATCH = 20_000, 40_000
#: Range around the job's own place where [place] says nothing. [m]
AROUND, AROUND_HEIGHT = 0.5, 0.2
#: Places that the full search is tried at, best first.
TRIED = 6


@dataclass(frozen=True)
class Ratings:
    """Lower bounds of the remaining deviation over the grid of one turn of the part.

    Attributes:
        turn: Turn about the vertical through the part's origin. [rad]
        axes: Grid values of x, y and z of the part's origin, base frame at no extra height. Three arrays. [m]
        bound: Root mean square over the cut, NaN where a station is out of reach. Shape (nx, ny, nz). [m]

    """

    turn: float
    axes: tuple[Array, Array, Array]
    bound: Array


@dataclass(frozen=True)
class PlaceResult:
    """Where the part should stand.

    Attributes:
        position: Origin of the part, base frame: as [part] of a job counts it. Shape (3,). [m]
        turn: Turn about the vertical through it, on top of the job's rotation. [rad]
        posture_choice: Posture along the path there.
        before: Posture at the job's own place, or None where none leads along the path.
        ratings: Grids, one a turn.
        here: The job's own place. Shape (3,). [m]

    """

    position: Array
    turn: float
    posture_choice: PostureSummary
    before: PostureSummary | None
    ratings: tuple[Ratings, ...]
    here: Array

    @property
    def ratio(self) -> float:
        """Remaining deviation (95 %) there as a share of that at the job's own place; NaN where that is not known."""
        if self.before is None:
            return float("nan")
        return self.posture_choice.costs["sensitivity_p95_mm"] / max(self.before.costs["sensitivity_p95_mm"], 1e-12)


def place_part(
    job: Job, robot: Robot, announce: Callable[[str], None] = lambda words: None, errors: ErrorModel | None = None,
) -> PlaceResult:  # fmt: skip
    """Search the place of the part where the table [place] of a job lets it stand.

    `announce` is told what is being done; `errors` is what the preset "error_band" counts.

    Raises:
        InputError: If the table [place] asks for too many places.
        InfeasibleError: If the path can be followed at none of them.
    """
    axes = _grid_axes(job)
    here = job.T_base_part[:3, 3]
    settings = read_request(job, robot, errors).settings
    rater = Rater(robot, settings)
    ratings = []
    for turn_deg in job.place.turn_deg:
        announce(f"place: {np.prod([len(v) for v in axes])} places, part turned by {turn_deg:g} deg")
        turned = _move_job(job, here, float(np.radians(turn_deg)))
        cells = np.array(list(product(*axes)))
        bound = rater.rate(load_nominal(turned), turned.tool_x_base, turned.T_base_part[:3, :3], cells - here)
        ratings.append(Ratings(float(np.radians(turn_deg)), axes, bound.reshape([len(v) for v in axes])))
    candidates = _best_places(ratings)
    if not candidates:
        raise InfeasibleError(
            "the path is within reach at none of the places; widen [place], or choose a larger robot or another tool",
            limits=["reach of the arm"],
        )
    announce("place: refine, and search postures at the best places")
    candidates = [*_refine(job, rater, candidates[:3], here, axes), *candidates]
    candidates.sort(key=lambda entry: entry[0])
    search = partial(_search_posture, job, robot, errors)
    posture_choice, position, turn = _decide(search, job.place.step_mm, candidates)
    before = search(here, 0.0)
    if before is not None and _rank(before) <= _rank(posture_choice):
        posture_choice, position, turn = before, here, 0.0
    return PlaceResult(position, turn, posture_choice, before, tuple(ratings), here)


def summarise_placement(result: PlaceResult, job: Job) -> dict[str, Any]:
    """Describe a result for place.json."""
    before = result.before
    return {
        "schema": 1,
        "status": "solved",
        "robot": job.robot,
        "part": {
            "position_mm": (1e3 * result.position).round(3).tolist(),
            "rotation_deg": list(_turned_rotation(job, result.turn)),
            "turn_deg": float(np.degrees(result.turn)),
        },
        "sensitivity_mm": {
            "expected_rms": result.posture_choice.costs["sensitivity_rms_mm"],
            "p95": result.posture_choice.costs["sensitivity_p95_mm"],
        },
        "sensitivity_here_mm": None
        if before is None
        else {"expected_rms": before.costs["sensitivity_rms_mm"], "p95": before.costs["sensitivity_p95_mm"]},
        "ratio": None if before is None else result.ratio,
        **result.posture_choice.describe_errors(),
        "grids": [
            {
                "turn_deg": float(np.degrees(rating.turn)),
                **{f"{name}_mm": (1e3 * axis).round(3).tolist() for name, axis in zip("xyz", rating.axes, strict=True)},
                "bound_mm": [
                    [[None if np.isnan(v) else round(1e3 * v, 6) for v in column] for column in sheet]
                    for sheet in rating.bound.tolist()
                ],
            }
            for rating in result.ratings
        ],
    }


class Rater:
    """Rate places by what the best posture at each station would leave."""

    def __init__(self, robot: Robot, settings: PostureSettings) -> None:
        self.robot = robot
        self.chain: Chain = build_chain(robot)
        self.arm: Arm = build_arm(robot)
        self.settings = replace(settings, spin_step=SPIN_STEP, held_steps=HELD_STEPS, stations=STATIONS)

    def rate(self, nominal: Toolpath, tool_x: Array, axes: Array, shifts: Array) -> Array:
        """Bound the remaining deviation of the path moved by each shift (c, 3) [m]: rms over the cut. Shape (c,). [m]

        NaN where a station is out of reach; tool_x and axes as of `PostureProblem`.
        """
        problem = PostureProblem(self.robot, nominal, tool_x, self.settings, axes)
        stations = pick_stations(nominal, STATIONS)
        share = measure_rungs(nominal, stations, most_step=1.0, reconfigure=False).cut_share
        stations, share = stations[share > 0], share[share > 0]
        rotation, held = orient_options(nominal, tool_x, stations, build_options(problem, stations))
        k, wrench = len(stations), problem.wrench
        g = len(held) // k
        bound = np.empty(len(shifts))
        at_once = max(1, BATCH // (k * g))
        for start in range(0, len(shifts), at_once):
            part = shifts[start : start + at_once]
            position = nominal.position[stations][None, :, None] + part[:, None, None]
            position = position.repeat(g, axis=2).reshape(-1, 3)
            copies = len(part)
            q = solve_branches(self.arm, position, np.tile(rotation, (copies, 1, 1)), np.tile(held, (copies, 1)))
            least = self._least(q, np.tile(wrench[stations].repeat(g, axis=0), (len(part), 1)), axes)
            least = least.reshape(len(part), k, g).min(axis=2)
            bound[start : start + len(part)] = np.sqrt((share * least**2).sum(axis=1))
        return np.where(np.isfinite(bound), bound, np.nan)

    def _least(self, q: Array, wrench: Array, axes: Array) -> Array:
        """Return the least sensitivity over the configurations, infinite where none is usable. Shape (n,). [m]"""
        room = self.robot.room(self.settings.limit_room)
        inside = ((q >= self.robot.lower + room) & (q <= self.robot.upper - room)).all(axis=2)
        rows = np.nonzero(inside)
        nodes = measure_nodes(
            self.chain, q[rows], wrench[rows[0]], limits=self.robot.arm_limits,
            uncertainty=self.settings.known, axes=axes,
        )  # fmt: skip
        values = np.full(inside.shape, np.inf)
        values[rows] = np.where(nodes.dexterity >= self.settings.singularity_margin, nodes.sensitivity, np.inf)
        return np.asarray(values.min(axis=1))


def _grid_axes(job: Job) -> tuple[Array, Array, Array]:
    """Build the grid."""
    table, step = job.place, job.place.step_mm * 1e-3
    here = job.T_base_part[:3, 3]
    axes = []
    for k, span in enumerate((table.x_mm, table.y_mm, table.z_mm)):
        around = AROUND_HEIGHT if k == 2 else AROUND
        low, high = (here[k] - around, here[k] + around) if span is None else (span[0] * 1e-3, span[1] * 1e-3)
        if low > high:
            raise InputError("has its bounds in the wrong order", file=job.file, where=f"place.{'xyz'[k]}_mm")
        if not (np.isfinite([low, high]).all() and (high - low) / step < MOST_PLACES):
            message = f"from {low * 1e3:g} to {high * 1e3:g} mm in steps of {table.step_mm:g} mm are too many places"
            raise InputError(f"{message}, at most {MOST_PLACES} are allowed", file=job.file, where="place.step_mm")
        axes.append(np.linspace(low, high, max(1, int(np.ceil((high - low) / step - 1e-9)) + 1)))
    count = int(np.prod([len(v) for v in axes]))
    if count > MOST_PLACES:
        message = f"a step of {table.step_mm:g} mm makes {count} places, at most {MOST_PLACES} are allowed"
        raise InputError(message, file=job.file, where="place.step_mm")
    return axes[0], axes[1], axes[2]


def _best_places(ratings: list[Ratings]) -> list[tuple[float, Array, float]]:
    """List bound, place and turn of the rated places, best first."""
    found = []
    for rating in ratings:
        for index in np.argwhere(np.isfinite(rating.bound)):
            place = np.array([axis[i] for axis, i in zip(rating.axes, index, strict=True)])
            found.append((float(rating.bound[tuple(index)]), place, rating.turn))
    return sorted(found, key=lambda entry: entry[0])


def _refine(
    job: Job, rater: Rater, candidates: list[tuple[float, Array, float]], here: Array, axes: tuple[Array, ...]
) -> list[tuple[float, Array, float]]:
    """Halve the step around the best places, three times; places stay within the grid."""
    refined = []
    low, high = np.array([v[0] for v in axes]), np.array([v[-1] for v in axes])
    for bound, start, turn in candidates:
        best, place = bound, start
        step = job.place.step_mm * 0.5e-3
        moved = _move_job(job, here, turn)
        nominal = load_nominal(moved)
        for _ in range(3):
            around = place + step * np.array(list(product((-1, 0, 1), repeat=3)))
            around = np.unique(np.clip(around, low, high), axis=0)
            values = rater.rate(nominal, moved.tool_x_base, moved.T_base_part[:3, :3], around - here)
            if np.isfinite(values).any() and np.nanmin(values) < best:
                best, place = float(np.nanmin(values)), around[int(np.nanargmin(values))]
            step *= 0.5
        refined.append((best, place, turn))
    return refined


def _search_posture(
    job: Job, robot: Robot, errors: ErrorModel | None, place: Array, turn: float
) -> PostureSummary | None:
    """Search the posture with the part at a place; None where nothing leads along the path."""
    moved = _move_job(job, place, turn)
    request = read_request(moved, robot, errors)
    try:
        return choose_posture_path(request.state(robot, load_nominal(moved), moved.tool_x_base))
    except InfeasibleError:
        return None


def _rank(posture_choice: PostureSummary) -> float:
    """Return what places are compared by: the remaining deviation [mm]."""
    return posture_choice.costs["sensitivity_rms_mm"]


def _decide(
    search: Callable[[Array, float], PostureSummary | None],
    step_mm: float,
    candidates: list[tuple[float, Array, float]],
) -> tuple[PostureSummary, Array, float]:  # fmt: skip
    """Search postures at the best places that lie apart, and take the best."""
    best: tuple[PostureSummary, Array, float] | None = None
    tried: list[tuple[Array, float]] = []
    for bound, place, turn in candidates:
        if any(np.linalg.norm(place - p) < 0.4e-3 * step_mm and turn == t for p, t in tried):
            continue
        if best is not None and (len(tried) >= TRIED or 1e3 * bound >= _rank(best[0])):
            break
        if len(tried) >= 5 * TRIED:
            break
        tried.append((place, turn))
        posture_choice = search(place, turn)
        if posture_choice is not None and (best is None or _rank(posture_choice) < _rank(best[0])):
            best = posture_choice, place, turn
    if best is None:
        raise InfeasibleError(
            "the path is within reach at some places, but no continuous posture keeps clear and within limits at the "
            "best of them; widen [place]", limits=["continuity or clearance"],
        )  # fmt: skip
    return best


def _turned_rotation(job: Job, turn: float) -> tuple[float, float, float]:
    """Return the part's rotation vector with a turn about the vertical on top. [deg]"""
    from scipy.spatial.transform import Rotation

    own = Rotation.from_matrix(job.T_base_part[:3, :3])
    x, y, z = (Rotation.from_rotvec([0.0, 0.0, turn]) * own).as_rotvec(degrees=True)
    return round(float(x), 9), round(float(y), 9), round(float(z), 9)


def _move_job(job: Job, place: Array, turn: float) -> Job:
    """Return the job with its part elsewhere."""
    x, y, z = (1e3 * float(v) for v in place)
    part = PartTable(position_mm=(x, y, z), rotation_deg=_turned_rotation(job, turn))
    moved = job.model_copy(update={"part": part})
    moved._file = job.file
    return moved


#: Distances and heights of the path's middle that are tried, as shares of the length of the stretched links.
OUT, UP = np.linspace(0.15, 0.85, 11), np.linspace(-0.2, 0.5, 8)
#: Where it is put before an arm without a closed form of inverse kinematics, which is slow to try; shares of the same.
ASSUMED = np.array([0.45, 0.0, 0.15])
#: Places are given in steps of this. [m]
ROUND = 0.01


@dataclass(frozen=True)
class FirstPlace:
    """A place, and whether the arm was tried there.

    Attributes:
        position: Origin of the part, base frame. Shape (3,). [m]
        tried: Whether the arm was found to reach stations of the path there.

    """

    position: Array
    tried: bool


def find_first_place(job: Job, robot: Robot) -> FirstPlace | None:
    """Find a position of the part in whose surroundings the arm reaches the path of a job; None where none is found.

    Where its part stands in the job does not matter.

    Raises:
        InputError: If the toolpath cannot be read as the job has it.
    """
    nominal = load_nominal(job)
    cut = nominal.position[~nominal.rapid]
    middle = 0.5 * (cut.min(axis=0) + cut.max(axis=0))
    here = job.T_base_part[:3, 3]
    rater = Rater(robot, read_request(job, robot).settings)
    if rater.arm.solver is None:
        return FirstPlace(_round(here + ASSUMED * robot.longest_reach - middle), tried=False)
    out, up = (robot.longest_reach * shares for shares in (OUT, UP))
    places = np.stack(np.meshgrid(out, [0.0], up, indexing="ij"), axis=-1).reshape(-1, 3)
    bound = rater.rate(nominal, job.tool_x_base, job.T_base_part[:3, :3], places - middle).reshape(len(OUT), len(UP))
    reached = np.isfinite(bound)
    if not reached.any():
        return None
    from scipy.ndimage import distance_transform_edt

    depth = distance_transform_edt(np.pad(reached, 1))[1:-1, 1:-1]
    best = min(np.argwhere(depth == depth.max()).tolist(), key=lambda cell: float(bound[tuple(cell)]))
    return FirstPlace(_round(here + np.array([out[best[0]], 0.0, up[best[1]]]) - middle), tried=True)


def _round(place: Array) -> Array:
    return np.asarray(np.round(place / ROUND) * ROUND)
