"""Start of a redundant path: the best of the search's finished postures, or one that the program shapes with the speed.

A preset that was asked for by name gets, of the postures that several presets find, the best by its own measure. The
program shapes it, and the programmed one, further. Runs are timed by TOPP-RA and measured by their widest 95 % band,
vibration included, nothing corrected. The best ones are also run slower where the arm vibrates most, as long as they
take no longer than the first. With f_i a factor by which waypoint i is slower, what vibration adds to the band falls
about with f_i^2; f follows a target B of the band, halved in between what takes too long and what does not:

    f_i <- max(1, f_i (v_i / sqrt(B^2 - s_i^2))^g),    v and s what vibration and all else have of the band.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError, InfeasibleError
from compplan.planning.deflection import measure_motion
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.limits.band import BAND_ROWS, spread_tip
from compplan.planning.motion_limits import difference_motion
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.settings import PostureProblem
from compplan.planning.posture.start import build_start, find_plain
from compplan.planning.posture.summary import Easing, PostureSummary, Start
from compplan.planning.redundancy import PathRequest, Prices, Shaped, shape_start
from compplan.planning.task import PlanTask
from compplan.planning.timing import INERTIA_WINDOWS, parameter_steps, time_rapids
from compplan.robot import Array
from compplan.simulation.vibration import Dynamics, build_dynamics
from compplan.uncertainty.band import band_radius
from compplan.uncertainty.sensitivities import pick_rows

LOG = logging.getLogger(__name__)

#: Presets whose finished postures are measured beside that of a preset, and which of a posture's costs it makes least.
BESIDE = {"fast": ("smooth", "accurate"), "accurate": ("smooth", "fast"), "error_band": ("accurate", "smooth"),
          "smooth": ("accurate", "fast")}  # fmt: skip
LEAST = {"fast": "driven_s", "accurate": "band_mm", "error_band": "band_mm", "smooth": "joint_travel_deg"}
#: Shortest windows of smoothing, as a share of those that plans have.
SHORT = 0.7
#: Gain that a posture is changed for, and difference of the band that counts as none.
LEAST_GAIN, SAME = 0.01, 1e-3
#: Joint positions that differ by less are one posture. [rad or m]
ALIKE = 1e-4
#: A run whose time is this near to the least that the programmed feed allows has nothing to gain.
AT_FEED = 1.02
#: Waypoints a run from rest to rest from which on its start and stop are a small part of it.
MANY = 1000
#: Share of the acceleration limits below which the arm's vibration is no matter of the posture (assumed).
CALM = 0.5
#: Most waypoints of a path whose starts are compared: the measures of a longer one cost more than they bring.
LONGEST = 8000
#: Eased runs that are tried at most, and waypoints times runs.
ROUNDS, WORK = 14, 40_000
#: Target of the band from one pair of rounds to the next until it takes too long, and its least share for vibration.
LOWER, LEAST_ROOM = 0.86, 0.2
#: Exponent g, and the least and greatest change of a factor in one round.
GAIN, EASIER, SLOWER = 0.6, 0.9, 1.4
#: Postures that a program starts from, in words.
ORIGINS = {"search": "the posture of the search", "programmed": "one configuration with x of the tool as programmed"}
#: What the program weighs by preset, one solve each; a preset that is not here keeps the posture of the search. The
#: first solve tells what time the base leaves; within that the second makes the band alone narrow.
BALANCED = Prices(time=1.0, band=0.3)
PRICES = dict.fromkeys(("accurate", "error_band", ""), (BALANCED, Prices(time=0.1, band=1.0)))
PRICES["fast"] = (Prices(most_band=np.inf), BALANCED)


class TimedStart(NamedTuple):
    """A run of a start, nothing corrected."""

    start: Start  #: The start, with its pace.
    time: float  #: The whole run. [s]
    band: float  #: Widest 95 % band along the cut. [m]
    still: float  #: The same, vibration left out. [m]
    spare: float  #: Time that the shortest windows of smoothing spare. [s]
    quiet: Array  #: Covariance of the tip at its rows of the cut, vibration left out. Shape (k, 3, 3). [m^2]
    task: PlanTask  #: The task, with the usual windows.
    origin: str = "search"  #: Where it comes from: "search" or "programmed".
    shaped: Shaped | None = None  #: What the program did, None for nothing.


def better_start(start: Start, request: PathRequest, *, shape: bool = True) -> Start:
    """Better a start; the start itself where the feed sets the time, or nothing wins.

    A preset that was asked for by name gets better by what it is for: `fast` by the time, `accurate` and
    `error_band` by the band at no more time. Without a name the run gets shorter, and no band wider. Without `shape`
    finished postures are compared alone, and the program shapes none.
    """
    posture_choice = start.posture_choice
    if posture_choice is None:
        return start
    if posture_choice.settings.compares:
        start = _compare_presets(start, request)
        posture_choice = start.posture_choice or posture_choice
    settings = posture_choice.settings
    preset = settings.preset if settings.compares else ""
    most = max(settings.lead, settings.lean, request.tube)
    free = settings.free_spin or most > 0.0 or posture_choice.q.shape[1] > 6
    if preset not in PRICES or not free or posture_choice.missed.any() or not shape or settings.start is not None:
        return start
    task = request.state(start)
    if (not preset or (preset == "fast" and len(task) > LONGEST)) and _keeps_feed(task, request):
        return start
    runs = measure_runs(start, request)
    if not runs:
        return start
    first, origins = runs[0], [(runs[0], task)]
    base = ease_run(
        preset, first, first, request
    )  # what a candidate is compared with: the same posture, eased as it is
    plain = find_plain(request.robot, request.nominal, request.tool_x, start) if len(task) <= LONGEST else None
    if plain is not None and not plain.missed.any() and not np.allclose(plain.q, start.q, atol=ALIKE):
        for run in measure_runs(plain, request):
            runs.append(run._replace(origin="programmed"))
            if run.time / first.time + run.band / first.band < 2.0:
                origins.append((runs[-1], request.state(plain)))

    def rank(run: TimedStart) -> float:
        return run.time if preset == "fast" else _band_beside(run, base)

    prices, others = PRICES[preset]
    found = [(run, each) for each in origins for run in _shape_runs(*each, request, prices)]
    runs += [run for run, _ in found]
    if found:
        run, where = min(found, key=lambda each: rank(each[0]))
        room = np.inf if preset == "fast" else base.time / run.time
        if run.shaped is not None and room > 1.0 + LEAST_GAIN:
            runs += _shape_runs(*where, request, others, room * run.shaped.time)
    best = runs if preset == "fast" else [min(runs, key=rank)]
    eased = [ease_run(preset, run, base, request) for run in best if run is not first]
    taken = _choose_run(preset, [base, *eased], base)
    if compute_gain(preset, taken, first) >= 1.0 - LEAST_GAIN:
        return start
    taken = taken._replace(time=request.time(request.state(taken.start)))
    return _take(start, first, taken, least_time(task))


def _shape_runs(
    origin: TimedStart, task: PlanTask, request: PathRequest, prices: Prices, most_time: float = np.inf
) -> list[TimedStart]:
    """Shape an origin by the program and measure its fastest run; none where nothing follows."""
    shaped = shape_start(task, origin.start, request, prices, most_time)
    runs = [] if shaped is None else measure_runs(shaped[0], request)
    return [run._replace(origin=origin.origin, shaped=None if shaped is None else shaped[1]) for run in runs]


def _compare_presets(start: Start, request: PathRequest) -> Start:
    """Take the best of the finished postures of several presets, by the measure of the preset that was asked for."""
    posture_choice, settings = start.posture_choice, start.settings
    assert posture_choice is not None
    found: dict[str, PostureSummary] = {settings.preset: posture_choice}
    for other in BESIDE[settings.preset]:
        try:
            other_settings = replace(settings, preset=other)
            found[other] = choose_posture_path(
                PostureProblem(request.robot, request.nominal, request.tool_x, other_settings)
            )
        except InfeasibleError:
            continue
    cost = LEAST[settings.preset]

    def measure(one: PostureSummary) -> float:
        if cost in one.costs:
            return one.costs[cost]
        built = build_start(one, request.nominal, settings)
        if cost == "driven_s":
            return request.time(request.state(built))
        return next((1e3 * run.band for run in measure_runs(built, request)), np.inf)

    compared = {name: measure(one) for name, one in found.items()}
    name = min(compared, key=lambda each: compared[each])
    best = found[name]
    return build_start(replace(best, settings=settings, costs={**best.costs, cost: compared[name]}, compared=compared,
                         compared_by=cost), request.nominal, settings)  # fmt: skip


def _keeps_feed(task: PlanTask, request: PathRequest) -> bool:
    """Tell whether a run keeps the programmed feed so calmly that neither time nor vibration can be gained."""
    rate, push = 0.0, 0.0
    if len(task) > MANY * len(task.runs):  # few starts and stops: rates at the programmed feed tell it without a run
        for first, last in task.runs:
            time = np.r_[0.0, np.cumsum(parameter_steps(task, task.q_start, first, last))]
            mean, change = difference_motion(task.q_start[first : last + 1], time)
            rate = max(rate, float((np.abs(mean) / task.velocity_limits).max()))
            push = max(push, float((np.abs(change[1:-1]) / task.acceleration_limits).max(initial=0.0)))
        if rate < 1.0 and push < CALM:
            return True
    try:
        timing = time_run(task, task.q_start, request.feed_request)[1]
    except ConvergenceError:
        return False
    return bool(timing.time[-1] <= AT_FEED * least_time(task) and timing.acceleration_ratio < CALM)


def measure_runs(
    start: Start, request: PathRequest, *, window: float = 1.0, beside: TimedStart | None = None,
    known: TimedStart | None = None,
) -> list[TimedStart]:  # fmt: skip
    """Measure the fastest run of a start; beside another run, slower ones too, each with a narrower band.

    Args:
        start: The start, without a pace.
        request: What is asked of the path.
        window: Windows of smoothing, share of those that plans have.
        beside: A run whose time is not to be passed, or None.
        known: A run of the same posture, where one has been measured.
    """
    found = list[TimedStart]()
    try:
        whole = resolve_starts(request.state(start), request.feed_request) if known is None else known.task
        task, spare = replace(whole, smoothing=window * whole.smoothing), (1.0 - SHORT) * smoothing_time(whole)
        slower, target, rows = np.ones(len(task)), np.inf, pick_rows(task.cut, BAND_ROWS)
        kept, low, high = (slower, slower, slower), 0.0, np.inf if beside is None else beside.band
        dynamics, aside = build_dynamics(task.robot), task.position[rows] - task.programmed[rows]
        still = spread_tip(task, request.force, rows) if known is None else known.quiet
        calm = band_radius(still, mean=aside)
        for count in range(1 if beside is None else max(min(ROUNDS, WORK // len(task)), 1)):
            eased = start if count == 0 and window == 1.0 else replace(
                start, pace=Easing(window, task.origin, slower))  # fmt: skip
            run = replace(task, start=eased)
            time = time_run(run, run.q_start, request.feed_request)[1].time
            rings = _spread_vibration(run, time, rows, dynamics)
            band = band_radius(still + rings, mean=aside)
            widest, least = (float(each.max(initial=0.0)) for each in (band, calm))
            found.append(TimedStart(eased, float(time[-1]), widest, least, spare, still, whole))
            if beside is None or not rings.any():
                break
            if count % 2 == 0:  # two rounds bring the run near to a target, then the time says which way it goes on
                late = time[-1] > beside.time
                if late and count == 0:
                    break
                low, high = (target, high) if late else (low, min(target, widest))
                kept = kept if late else (slower, band, time)
                slower, band, time = kept
                target = 0.5 * (low + high) if low > 0.0 else LOWER * high
            room = np.sqrt(np.maximum(target**2 - calm**2, (LEAST_ROOM * target) ** 2))
            use = np.sqrt(np.maximum(band**2 - calm**2, 0.0)) / room
            wide = _widen(np.interp(np.arange(len(task)), rows, use), time, task.smoothing)
            slower = np.maximum(slower * np.clip(wide**GAIN, EASIER, SLOWER), 1.0)
    except ConvergenceError:
        pass
    return found


def _spread_vibration(task: PlanTask, time: Array, rows: NDArray[np.int_], dynamics: Dynamics) -> Array:
    """Return the covariance of the tip by its vibration at some waypoints of a run. Shape (k, 3, 3). [m^2]"""
    motion = measure_motion(task, time, dynamics)
    if motion is None:
        return np.zeros((len(rows), 3, 3))
    away = motion.error[:, rows] - motion.error[:, rows].mean(axis=0)
    return np.asarray(np.einsum("dni,dnj->nij", away, away) / max(len(away) - 1, 1))


def _widen(use: Array, time: Array, reach: float) -> Array:
    """Return the greatest value within a reach of time [s] on either side, its steps smoothed. Shape (n,)."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    span = time[-1] - time[0]
    if not (span > 0.0 and reach > 0.0):
        return use
    grid = np.linspace(time[0], time[-1], int(np.clip(8.0 * span / reach, 16, 20_000)))
    size = max(int(reach / (grid[1] - grid[0])), 1)
    wide = maximum_filter1d(np.interp(grid, time, use), 2 * size + 1, mode="nearest")
    smooth = uniform_filter1d(wide, size // 2 * 2 + 1, mode="nearest")  # a running sum: rounding may make it negative
    return np.interp(time, grid, np.clip(smooth, use.min(), use.max()))


def _take(start: Start, first: TimedStart, run: TimedStart, least: float) -> Start:
    """Return the start of the candidate that was taken, with what it brings beside the first."""
    posture_choice, chosen, pace = start.posture_choice, run.start.posture_choice, run.start.pace
    assert posture_choice is not None and chosen is not None
    shaped = run.shaped or Shaped(0, (), 0.0)
    program = {
        "free": list(shaped.names), "start": run.origin, "steps": shaped.iterations,
        "time_s": {"graph": first.time, "program": run.time},
        "band_p95_max_mm": {"graph": 1e3 * first.band, "program": 1e3 * run.band},
        "least_time_s": least,
    }  # fmt: skip
    costs = {**chosen.costs, "driven_s": run.time, "band_mm": 1e3 * run.band}
    cost, compared = posture_choice.compared_by, dict(posture_choice.compared)
    if compared:
        compared["program"] = costs[cost]
    chosen = replace(chosen, settings=posture_choice.settings, costs=costs, compared=compared, compared_by=cost)
    upright = run.start.upright
    nominal = run.start.nominal if upright is None else replace(run.start.nominal, axis=upright)
    built = build_start(chosen, nominal, start.settings)
    most = 1.0 if pace is None else float(pace.slower.max(initial=1.0))
    eased = "" if most == 1.0 else f"; the run is up to {most:.3g} times slower where the arm would ring most"
    eased += "" if pace is None or pace.window == 1.0 else f"; smoothed over {pace.window:.0%} of the usual time"
    head = f"Posture and speed are of one program ({', '.join(shaped.names)} free)"
    if not shaped.iterations:
        head = f"Posture and speed are chosen together ({ORIGINS[run.origin]})"
    note = (f"{head}: run {first.time:.4g} -> {run.time:.4g} s (the programmed feed takes {least:.4g} s), widest 95 % "
            f"band {1e3 * first.band:.3g} -> {1e3 * run.band:.3g} mm, before correction{eased}.")  # fmt: skip
    return replace(built, program=program, aside=run.start.aside, pace=pace, notes=(*built.notes, note))


def ease_run(preset: str, run: TimedStart, base: TimedStart, request: PathRequest) -> TimedStart:
    """Return the best of a run and of those of its posture that go slower where the arm vibrates, beside a base."""
    beside, runs, windows = (None if preset == "fast" else base), [run], [SHORT]
    late = max(run.time - base.time, 0.0) / run.spare
    if beside is not None and late < 1.0:
        windows = [1.0 - (1.0 - SHORT) * late, SHORT]
    for window in windows:
        eased = measure_runs(run.start, request, window=window, beside=beside, known=run)
        runs += [each._replace(origin=run.origin, shaped=run.shaped) for each in eased]
    for each in runs:
        LOG.debug("%s%s: time %.4f -> %.4f s, band %.4f -> %.4f mm", run.origin, ", program" if run.shaped else "",
                  base.time, each.time, 1e3 * base.band, 1e3 * each.band)  # fmt: skip
    return _choose_run(preset, runs, base)


def _choose_run(preset: str, runs: list[TimedStart], base: TimedStart) -> TimedStart:
    """Choose the run that a preset is for, of those that differ from it by less than counts the shortest."""
    gains = [compute_gain(preset, run, base) for run in runs]
    alike = [run for run, gain in zip(runs, gains, strict=True) if gain <= min(gains) + LEAST_GAIN]
    return min(alike, key=lambda run: run.time)


def _band_beside(run: TimedStart, base: TimedStart) -> float:
    """Return the band of a run at the time of the base, infinite where it takes longer however short its window. [m]

    What vibration adds falls with the square of the time.
    """
    ring = (run.band**2 - run.still**2) * (run.time / base.time) ** 4
    return float(np.sqrt(run.still**2 + max(ring, 0.0))) if run.time - run.spare <= base.time else np.inf


def compute_gain(preset: str, run: TimedStart, base: TimedStart) -> float:
    """Return what a preset ("" for none) makes less, as a share; infinite where that is bought with what it may not."""
    time, band, still = run.time / base.time, run.band / base.band, run.still / base.still
    if preset == "fast":
        return time
    if time > 1.0 or band > 1.0 + SAME:
        return np.inf
    if preset == "error_band":
        return band
    return 0.5 * (band + still) if preset else 0.5 * (time + band)


def least_time(task: PlanTask) -> float:
    """Return the time of the programmed feed, of rapid moves, and of smoothing. [s]"""
    rapid = task.nominal.rapid[1:]
    moves = np.abs(np.diff(task.q_start, axis=0))[rapid]
    between = time_rapids(moves, task.velocity_limits, task.acceleration_limits).sum()
    return float(task.step_time[~rapid].sum() + between + smoothing_time(task))


def smoothing_time(task: PlanTask) -> float:
    """Return the time by which smoothing makes the runs of a path longer, each by its windows. [s]"""
    return len(task.runs) * task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
