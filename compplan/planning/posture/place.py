"""Placement of the part: the place in the cell with the least remaining deviation after compensation.

A grid of places is rated by a lower bound: the best posture of all spins and configurations at some stations of the
path, independently. The posture search of a plan (with continuity, limits and collision) decides among the best.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from compplan.errors import InfeasibleError, InputError
from compplan.job.frames import PartTable
from compplan.job.job import Job
from compplan.job.loading import load_nominal
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.lattice import USABLE, build_options, fill_lattice, pick_stations
from compplan.planning.posture.search import measure_rungs
from compplan.planning.posture.settings import PostureProblem, PostureSettings, read_settings
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.ik import build_arm
from compplan.uncertainty.posture_errors import PostureErrors

#: Stations, step of spin [rad] and positions of extra axes for the rating of the grid.
STATIONS, SPIN_STEP, HELD_STEPS = 14, float(np.radians(20.0)), 5
#: Most places of a grid.
MOST_PLACES = 20_000
#: Default range around the job's place, horizontal and vertical. [m]
AROUND, AROUND_HEIGHT = 0.5, 0.2
#: Places of the full search, best first; most places while none is feasible; cost that is compared.
TRIED, MOST_TRIED, RANK = 6, 30, "sensitivity_rms_mm"


@dataclass(frozen=True)
class Ratings:
    """Lower bounds of the remaining deviation over the grid of one turn of the part."""

    turn: float  #: Rotation about the vertical through the part's origin. [rad]
    #: Grid values of x, y and z of the part's origin, base frame. Three arrays. [m]
    axes: tuple[Array, Array, Array]
    bound: Array  #: Root mean square over the cut, NaN where a station is out of reach. Shape (nx, ny, nz). [m]


@dataclass(frozen=True)
class PlaceResult:
    """Best placement of the part."""

    position: Array  #: Origin of the part, base frame, as in section [part] of a job. Shape (3,). [m]
    turn: float  #: Rotation about the vertical through it, in addition to the job's rotation. [rad]
    posture_choice: PostureSummary  #: Posture along the path there.
    before: PostureSummary | None  #: Posture at the job's place, or None if infeasible.
    ratings: tuple[Ratings, ...]  #: Grids, one per turn.
    here: Array  #: Place of the job. Shape (3,). [m]
    correction: float  #: Greatest deflection at the best place, which a plan has to correct. [m]

    @property
    def ratio(self) -> float:
        """Remaining deviation (rms) as a share of that at the job's place; NaN if the latter is infeasible."""
        if self.before is None:
            return float("nan")
        return self.posture_choice.costs[RANK] / max(self.before.costs[RANK], 1e-12)


def place_part(
    job: Job, robot: Robot, announce: Callable[[str], None] = lambda words: None, errors: PostureErrors | None = None,
) -> PlaceResult:  # fmt: skip
    """Search the best place of the part among those that the section [place] of a job allows.

    `announce` receives progress messages; `errors`, the uncertainty of the tip, is needed for the preset "error_band".

    Raises:
        InputError: If the section [place] allows too many places.
        InfeasibleError: If the path cannot be followed at any of them.
    """
    axes, here = _grid_axes(job), job.T_base_part[:3, 3]
    cells, settings = np.array(list(product(*axes))), read_settings(job, robot, errors)
    ratings: list[Ratings] = []
    for turn in np.radians(job.place.turn_deg).tolist():
        announce(f"place: {len(cells)} places, part turned by {np.degrees(turn):g} deg")
        bound = rate_places(_move_job(job, here, turn), robot, settings, cells - here)
        ratings.append(Ratings(turn, axes, bound.reshape([len(v) for v in axes])))

    def search(place: Array, turn: float) -> PostureSummary | None:
        moved = _move_job(job, place, turn)
        own = read_settings(moved, robot, errors)
        with suppress(InfeasibleError):  # no posture path
            return choose_posture_path(PostureProblem(robot, load_nominal(moved), moved.tool_x_base, own))
        return None

    announce("place: search postures at the best places")
    best: tuple[PostureSummary, Array, float] | None = None
    bounds = np.concatenate([rating.bound.ravel() for rating in ratings])
    order = np.argsort(bounds)[: np.isfinite(bounds).sum()].tolist()
    for count, k in enumerate(order[:MOST_TRIED]):
        if best is not None and (count >= TRIED or 1e3 * bounds[k] >= best[0].costs[RANK]):
            break
        place, turn = cells[k % len(cells)], ratings[k // len(cells)].turn
        found = search(place, turn)
        if found is not None and (best is None or found.costs[RANK] < best[0].costs[RANK]):
            best = found, place, turn
    if best is None:
        limit, what = "reach of the arm", "the path is within reach at none of the places"
        if order:
            limit, what = "continuity or clearance", "no posture leads along the path at the best of the places"
        raise InfeasibleError(f"{what}; widen [place], or choose a larger robot or another tool", limits=[limit])
    before = search(here, 0.0)
    if before is not None and before.costs[RANK] <= best[0].costs[RANK]:
        best = before, here, 0.0
    nominal = load_nominal(_move_job(job, best[1], best[2]))
    tip = solve_equilibrium(build_chain(robot), best[0].q, nominal.wrench).position
    correction = float(np.linalg.norm(tip - nominal.position, axis=1).max())
    return PlaceResult(best[1], best[2], best[0], before, tuple(ratings), here, correction)


def summarise_placement(result: PlaceResult, job: Job) -> dict[str, Any]:
    """Describe a result for place.json."""
    before = result.before
    return {
        "schema": 1,
        "status": "solved",
        "robot": job.robot,
        "part": {
            "position_mm": (1e3 * result.position).round(3).tolist(),
            "rotation_deg": _turn_part(job, result.turn),
            "turn_deg": float(np.degrees(result.turn)),
        },
        "sensitivity_mm": {"expected_rms": result.posture_choice.costs[RANK]},
        "sensitivity_here_mm": None if before is None else {"expected_rms": before.costs[RANK]},
        "ratio": None if before is None else result.ratio,
        "correction_mm": {"max": 1e3 * result.correction, "allowed": job.plan.max_correction_mm},
        **result.posture_choice.describe_errors(),
    }


def rate_places(job: Job, robot: Robot, settings: PostureSettings, shifts: Array) -> Array:
    """Bound the remaining deviation for the best posture at each station, with the path moved by shifts (c, 3) [m].

    Returns the root mean square over the cut, NaN where a station is out of reach. Shape (c,). [m]
    """
    nominal = load_nominal(job)
    coarse = replace(settings, spin_step=SPIN_STEP, held_steps=HELD_STEPS, axes=job.T_base_part[:3, :3])
    problem = PostureProblem(robot, nominal, job.tool_x_base, coarse)
    stations = pick_stations(nominal, STATIONS)
    share = measure_rungs(nominal, stations, most_step=1.0).cut_share
    stations, share = stations[share > 0], share[share > 0]
    options = build_options(problem, stations)
    bound = np.empty(len(shifts))
    for k, shift in enumerate(shifts):
        lattice = fill_lattice(problem, stations, options, nominal.position[stations] + shift)
        least = np.where(lattice.reason == USABLE, lattice.sensitivity, np.inf).min(axis=(1, 2))
        bound[k] = np.sqrt((share * least**2).sum())
    return np.where(np.isfinite(bound), bound, np.nan)


def _grid_axes(job: Job) -> tuple[Array, Array, Array]:
    """Build the grid of places from the section [place]."""
    table, step = job.place, job.place.step_mm * 1e-3
    here, spans = job.T_base_part[:3, 3], list[tuple[float, float]]()
    for k, span in enumerate((table.x_mm, table.y_mm, table.z_mm)):
        around = AROUND_HEIGHT if k == 2 else AROUND
        low, high = (here[k] - around, here[k] + around) if span is None else (span[0] * 1e-3, span[1] * 1e-3)
        if low > high:
            raise InputError("has its bounds in the wrong order", file=job.file, where=f"place.{'xyz'[k]}_mm")
        spans.append((low, high))
    counts = [np.ceil((high - low) / step - 1e-9) + 1.0 for low, high in spans]
    if not np.prod(counts) <= MOST_PLACES:
        message = f"a step of {table.step_mm:g} mm makes too many places, at most {MOST_PLACES} are allowed"
        raise InputError(message, file=job.file, where="place.step_mm")
    x, y, z = (np.linspace(*span, int(count)) for span, count in zip(spans, counts, strict=True))
    return x, y, z


def _move_job(job: Job, place: Array, turn: float) -> Job:
    """Return the job with its part at a place (3,) [m], turned about the vertical by an angle. [rad]"""
    part = PartTable(position_mm=(1e3 * place).tolist(), rotation_deg=_turn_part(job, turn))
    return job.model_copy(update={"part": part})


def _turn_part(job: Job, turn: float) -> Any:
    """Return the rotation vector of the part after a further turn about the vertical. Three numbers. [deg]"""
    rotation = Rotation.from_rotvec([0.0, 0.0, turn]) * Rotation.from_matrix(job.T_base_part[:3, :3])
    return rotation.as_rotvec(degrees=True).round(9).tolist()


#: Distances and heights of the middle of the path in the search, as shares of the length of the stretched links.
OUT, UP = np.linspace(0.15, 0.85, 11), np.linspace(-0.2, 0.5, 8)
#: Middle of the path for an arm without closed-form inverse kinematics (assumed, no search); shares of the same.
ASSUMED = np.array([0.45, 0.0, 0.15])
#: Resolution of the place. [m]
ROUND = 0.01


def find_first_place(job: Job, robot: Robot) -> tuple[Array, bool] | None:
    """Find a position of the part (3,) [m] with the path of a job in reach of the arm.

    Returns the position and whether the reach was checked; None without a solution.

    Raises:
        InputError: If the toolpath of the job cannot be read.
    """
    nominal, here = load_nominal(job), job.T_base_part[:3, 3]
    cut = nominal.position[~nominal.rapid]
    away = here - 0.5 * (cut.min(axis=0) + cut.max(axis=0))
    if build_arm(robot).solver is None:
        return np.round((away + ASSUMED * robot.longest_reach) / ROUND) * ROUND, False
    out, up = (robot.longest_reach * shares for shares in (OUT, UP))
    places = np.stack(np.meshgrid(out, [0.0], up, indexing="ij"), axis=-1).reshape(-1, 3)
    bound = rate_places(job, robot, read_settings(job, robot), places + away - here)
    reached = np.isfinite(bound).reshape(len(OUT), len(UP))
    if not reached.any():
        return None
    depth = distance_transform_edt(np.pad(reached, 1))[1:-1, 1:-1].ravel()
    deepest = np.flatnonzero(depth == depth.max())
    best = places[deepest[bound[deepest].argmin()]]
    return np.round((away + best) / ROUND) * ROUND, True
