"""Start of a redundant path: best posture of the search, or one optimised together with the speed.

A preset named in the job chooses the best posture of several presets by its criterion. The nonlinear program starts
from it and from the programmed posture. Its result is compared with the posture of the search, both slowed where the
arm vibrates most (`compplan.planning.measured_runs`), and must not take longer.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from compplan.errors import ConvergenceError, InfeasibleError
from compplan.planning.feed import time_run
from compplan.planning.measured_runs import (
    LEAST_GAIN,
    SAME,
    TimedStart,
    band_at_time,
    choose_run,
    compute_gain,
    ease_run,
    least_time,
    measure_runs,
    reference_run,
)
from compplan.planning.motion_limits import difference_motion
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.start import build_start, find_plain
from compplan.planning.posture.summary import PostureSummary, Start
from compplan.planning.redundancy import CostWeights, PathRequest, shape_start
from compplan.planning.task import PlanTask
from compplan.planning.timing import parameter_steps

#: Presets whose postures are compared with that of a preset, and the cost of the comparison.
COMPARED_WITH = {"fast": ("smooth", "accurate"), "accurate": ("smooth", "fast"), "error_band": ("accurate", "smooth"),
          "smooth": ("accurate", "fast")}  # fmt: skip
LEAST = {"fast": "driven_s", "accurate": "band_mm", "error_band": "band_mm", "smooth": "joint_travel_deg"}
#: Joint position difference below which postures are equal. [rad or m]
SAME_POSTURE = 1e-4
#: Ratio of a run's time to the least time at the programmed feed up to which no gain is possible.
AT_FEED = 1.02
#: Waypoints per run above which start and stop are a small part of it.
MANY = 1000
#: Share of the acceleration limits below which vibration does not depend on the posture (assumed).
CALM = 0.5
#: Greatest number of waypoints of a path whose starts are compared; longer paths take more CPU time than they gain.
LONGEST = 8000
#: Weights of the program by preset; other presets keep the posture of the search.
COST_WEIGHTS = {"fast": CostWeights(band=0.0), **dict.fromkeys(("accurate", "error_band", ""), CostWeights())}


def better_start(start: Start, request: PathRequest, *, shape: bool = True) -> Start:
    """Improve a start; return it unchanged if the feed determines the time, or nothing is better.

    `fast` reduces the time, `accurate` and `error_band` the band without more time. Without a named preset the run
    becomes shorter and its band not wider. `error_band` also starts from the result of the unnamed default `accurate`,
    and may take the time of the slower of both, so that its band is not wider. Without `shape` no program is solved.
    """
    posture_choice = start.posture_choice
    if posture_choice is None:
        return start
    default = None
    if posture_choice.settings.compares:
        start, default = _compare_presets(start, request)
        posture_choice = start.posture_choice or posture_choice
    settings = posture_choice.settings
    preset = settings.preset if settings.compares else ""
    most = max(settings.lead, settings.lean, request.tube)
    free = settings.free_spin or most > 0.0 or posture_choice.q.shape[1] > 6
    if preset not in COST_WEIGHTS or not free or posture_choice.missed.any() or not shape or settings.start is not None:
        return start
    task = request.state(start)
    if (not preset or (preset == "fast" and len(task) > LONGEST)) and _keeps_feed(task):
        return start
    runs = measure_runs(start, request)
    if not runs:
        return start
    first = runs[0]
    groups = [(runs, ease_run(preset, first, first, request))]  # candidates, and the reference run
    if preset == "error_band" and default is not None and (usual := measure_runs(default, request)):
        own = (usual, ease_run("", usual[0], usual[0], request))  # default result: the band must not be wider than that
        groups = [own] if np.allclose(default.q, start.q, atol=SAME_POSTURE) else [*groups, own]
    plain = find_plain(request.problem, start) if len(task) <= LONGEST else None
    if plain is not None and not plain.missed.any() and not np.allclose(plain.q, start.q, atol=SAME_POSTURE):
        groups[-1][0].extend(measure_runs(replace(plain, program={"start": "programmed"}), request))
    candidates = [base for _, base in groups]
    for runs, base in groups:
        for origin in tuple(runs):
            of_origin = request.state(origin.start)
            shaped = shape_start(of_origin, origin.start, request, COST_WEIGHTS[preset],
                                 reference_run(base, origin, of_origin))  # fmt: skip
            runs += [] if shaped is None else measure_runs(shaped, request)
        bands = [band_at_time(run, base) for run in runs]  # of equal ones, the nearest to the posture of the search
        alike = (run for run, band in zip(runs, bands, strict=True) if band <= (1.0 + LEAST_GAIN) * min(bands))
        best = runs if preset == "fast" else [next(alike)]
        candidates += [ease_run(preset, run, base, request) for run in best if run is not first]
    latest = max(base.time for _, base in groups)
    base = min((base for _, base in groups), key=lambda run: run.band)
    taken = choose_run(preset, candidates, base._replace(time=latest))
    if compute_gain(preset, taken, first._replace(time=max(first.time, latest))) >= 1.0 - SAME:
        return start
    taken = taken._replace(time=request.time(request.state(taken.start)))
    return _take(start, first, taken, least_time(task))


def _compare_presets(start: Start, request: PathRequest) -> tuple[Start, Start | None]:
    """Return the best of the postures of several presets, by the criterion of the job's preset.

    Also returns the start of the preset `accurate`, None if that is the job's preset or has no posture.
    """
    posture_choice, settings = start.posture_choice, start.settings
    assert posture_choice is not None
    found: dict[str, PostureSummary] = {settings.preset: posture_choice}
    for other in COMPARED_WITH[settings.preset]:
        try:
            own = replace(settings, preset=other, errors=None)
            found[other] = choose_posture_path(replace(request.problem, settings=own))
        except InfeasibleError:
            continue
    cost = LEAST[settings.preset]

    def measure(one: PostureSummary) -> float:
        if cost in one.costs:
            return one.costs[cost]
        built = build_start(one, request.problem.nominal, settings)
        if cost == "driven_s":
            return request.time(request.state(built))
        return next((1e3 * run.band for run in measure_runs(built, request)), np.inf)

    compared = {name: measure(one) for name, one in found.items()}
    name = min(compared, key=lambda each: compared[each])

    def build(name: str) -> Start:
        one = found[name]
        summary = replace(one, settings=settings, costs={**one.costs, cost: compared[name]}, compared=compared,
                       compared_by=cost)  # fmt: skip
        return build_start(summary, request.problem.nominal, settings)

    return build(name), build("accurate") if "accurate" in found and settings.preset != "accurate" else None


def _keeps_feed(task: PlanTask) -> bool:
    """Return whether a run keeps the programmed feed with low accelerations: no gain is possible."""
    rate, acceleration = 0.0, 0.0
    if len(task) > MANY * len(task.runs):  # few starts and stops: the rates at the programmed feed suffice
        for first, last in task.runs:
            time = np.r_[0.0, np.cumsum(parameter_steps(task, task.q_start, first, last))]
            mean, change = difference_motion(task.q_start[first : last + 1], time)
            rate = max(rate, float((np.abs(mean) / task.velocity_limits).max()))
            acceleration = max(acceleration, float((np.abs(change[1:-1]) / task.acceleration_limits).max(initial=0.0)))
        if rate < 1.0 and acceleration < CALM:
            return True
    try:
        timing = time_run(task, task.q_start)[1]
    except ConvergenceError:
        return False
    return bool(timing.time[-1] <= AT_FEED * least_time(task) and timing.acceleration_ratio < CALM)


def _take(start: Start, first: TimedStart, run: TimedStart, least: float) -> Start:
    """Return the start of the chosen run, with its figures and a note on its gain over the first."""
    posture_choice, chosen, slowdown = start.posture_choice, run.start.posture_choice, run.start.slowdown
    assert posture_choice is not None and chosen is not None
    program: dict[str, Any] = {
        "free": [], "start": "search", "steps": 0, **(run.start.program or {}),
        "time_s": {"graph": first.time, "program": run.time},
        "band_p95_max_mm": {"graph": 1e3 * first.band, "program": 1e3 * run.band},
        "least_time_s": least,
    }  # fmt: skip
    costs = {**chosen.costs, "driven_s": run.time, "band_mm": 1e3 * run.band}
    cost, compared = posture_choice.compared_by, dict(posture_choice.compared)
    if compared:
        compared["program"] = costs[cost]
    chosen = replace(chosen, settings=posture_choice.settings, costs=costs, compared=compared, compared_by=cost)
    most = 1.0 if slowdown is None else float(slowdown.slower.max(initial=1.0))
    eased = "" if most == 1.0 else f"; the run is up to {most:.3g} times slower where the arm would ring most"
    how = f"of one program ({', '.join(program['free'])} free)" if program["steps"] else "chosen together"
    note = (f"Posture and speed are {how}: run {first.time:.4g} -> {run.time:.4g} s (the programmed feed takes "
            f"{least:.4g} s), widest 95 % band {1e3 * first.band:.3g} -> {1e3 * run.band:.3g} mm, before correction"
            f"{eased}.")  # fmt: skip
    return replace(run.start, posture_choice=chosen, program=program, notes=(*run.start.notes, note))
