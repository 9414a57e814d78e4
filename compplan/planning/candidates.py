"""Start of a redundant path: the posture search's, or one that the program shapes with the speed, whichever serves.

Candidates are timed by the fastest run and measured by their widest 95 % band, vibration included, nothing corrected.
The best ones are also run slower where the arm would vibrate most, as long as they take no longer than the first.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from compplan.errors import ConvergenceError
from compplan.planning.feed import time_run
from compplan.planning.narrow import INERTIA_WINDOWS
from compplan.planning.posture.initial_branches import Bettered, Start, find_plain, stand
from compplan.planning.redundancy import Asked, Prices, Shaped, shape_start
from compplan.planning.run_meter import RunMeter, TimedStart
from compplan.planning.run_timing import cutting_runs, time_rapids
from compplan.planning.task import PlanTask

LOG = logging.getLogger(__name__)

#: Windows of smoothing, as shares of those that plans have, and candidates whose speed is eased, the best ones.
WINDOWS, EASED = (1.0, 0.7), 2
#: Gain that a posture is changed for, and difference of time or band that counts as none.
LEAST_GAIN, SAME = 0.01, 1e-3
#: Joint positions that differ by less are one posture. [rad or m]
ALIKE = 1e-4
#: A run whose time is this near to the least that the programmed feed allows has nothing to gain.
AT_FEED = 1.02
#: Share of the acceleration limits below which the arm's vibration is no matter of the posture (assumed).
CALM = 0.5
#: Most waypoints of a path whose starts are compared: the measures of a longer one cost more than they bring.
LONGEST = 8000
#: What the program weighs by preset; a preset that is not here keeps the posture of the search.
PRICES = {
    "fast": Prices(most_band=np.inf),
    "accurate": Prices(time=0.1, band=1.0),
    "error_band": Prices(time=0.1, band=1.0),
    "": Prices(time=1.0, band=0.3),
}


Candidate = tuple[TimedStart, str, Shaped | None]


def better_start(start: Start, asked: Asked) -> Start:
    """Better a start by the program; the start itself where the feed sets the time, or nothing wins.

    A preset that was asked for by name gets better by what it is for: `fast` by the time, `accurate` and
    `error_band` by the band at no more time. Without a name the run gets shorter, and no band wider.

    Args:
        start: The start of the posture search.
        asked: What is asked of the path.

    """
    stance = start.stance
    if stance is None or start.request is None or stance.settings.weights or stance.settings.start is not None:
        return start
    preset, settings = stance.settings.preset if stance.settings.compares else "", stance.settings
    prices, energy = PRICES.get(preset), settings.energy
    free = settings.free_spin or settings.lead > 0 or settings.lean > 0 or stance.q.shape[1] > 6 or asked.tube > 0.0
    if prices is None or not free or stance.missed.any():
        return start
    asked = replace(asked, meter=replace(asked.meter, energy=energy))
    task = asked.meter.state(start)
    gated = not preset or (preset == "fast" and len(task) > LONGEST)
    if gated and not energy and _keeps_feed(task, asked.meter):
        return start
    measured = asked.meter.measure(start)
    if not measured:
        return start
    first = measured[0]
    runs: list[Candidate] = [(first, "search", None)]
    origins = {"search": (task, start)}
    plain = find_plain(asked.robot, asked.nominal, asked.tool_x, start) if len(task) <= LONGEST else None
    if plain is not None and not plain.missed.any() and not np.allclose(plain.q, start.q, atol=ALIKE):
        for run in asked.meter.measure(plain):
            runs.append((run, "programmed", None))
            if run.time / first.time + run.band / first.band < 2.0:
                origins["programmed"] = asked.meter.state(plain), plain
    for name, (state, origin) in origins.items():
        for weights in (prices, PRICES["accurate"]) if preset == "fast" else (prices,):
            if (found := shape_start(state, origin, asked, weights)) is not None:
                runs += [(run, name, found[1]) for run in asked.meter.measure(found[0])]
    if stance.compared_by == "band_mm":  # no posture that was compared has a narrower band
        runs = [entry for entry in runs if 1e3 * entry[0].still <= min(stance.compared.values()) * (1.0 + 1e-9)]
    taken = _choose_run(preset, first, runs, asked.meter)
    return start if taken is None else _take(start, first, taken, least_time(task))


def _keeps_feed(task: PlanTask, meter: RunMeter) -> bool:
    """Tell whether a run keeps the programmed feed so calmly that neither time nor vibration can be gained."""
    try:
        timing = time_run(task, task.q_start, meter.wish)[1]
    except ConvergenceError:
        return False
    return bool(timing.time[-1] <= AT_FEED * least_time(task) and timing.acceleration_ratio < CALM)


def _take(start: Start, first: TimedStart, taken: Candidate, least: float) -> Start:
    """Return the start of the candidate that was taken, with what it brings beside the first."""
    run, name, how = taken
    stance, stood_on, request = start.stance, run.start.stance, start.request
    assert stance is not None and stood_on is not None and request is not None
    energy = (first.energy, run.energy) if stance.settings.energy else None
    shaped = Shaped(0, ()) if how is None else how
    told = Bettered(start, (first.time, run.time), (1e3 * first.band, 1e3 * run.band), least, name,
                    shaped.iterations, shaped.names, energy)  # fmt: skip
    costs = {**stood_on.costs, "driven_s": run.time, "band_mm": 1e3 * run.still}
    compared = {**stance.compared, "program": costs[stance.compared_by]} if stance.compared else {}
    chosen = replace(stood_on, settings=stance.settings, costs=costs, compared=compared,
                     compared_by=stance.compared_by)  # fmt: skip
    stood = stand(chosen, run.start.nominal if run.start.upright is None else
                  replace(run.start.nominal, axis=run.start.upright), request)  # fmt: skip
    return replace(stood, bettered=told, aside=run.start.aside, pace=run.start.pace,
                   notes=(*stood.notes, told.sentence(run.start.pace)))  # fmt: skip


def _choose_run(preset: str, first: TimedStart, runs: list[Candidate], meter: RunMeter) -> Candidate | None:
    """Choose the run that a preset is for, of all runs and of the best ones eased; None where none gains.

    Args:
        preset: The preset by name, "" for none.
        first: The run of the posture search.
        runs: The runs, where each comes from, and what the program did.
        meter: How runs are measured.

    """

    def share(run: TimedStart) -> tuple[float, float, float]:
        return run.time / first.time, run.band / first.band, run.still / first.still

    def value_of(run: TimedStart) -> float:
        own = judge_gain(preset, *share(run))
        return (own + meter.energy * run.energy / first.energy) / (1.0 + meter.energy) if first.energy > 0.0 else own

    runs = list(runs)
    beside = None if preset == "fast" else first

    def promise(run: TimedStart) -> float:
        """Return the band at the time of the first run, where vibration falls with the square of the time. [m]"""
        ring = (run.band**2 - run.still**2) * (run.time / first.time) ** 4
        return float(np.sqrt(run.still**2 + max(ring, 0.0)))

    order = sorted(runs, key=lambda entry: entry[0].time if preset == "fast" else promise(entry[0]))
    for number, (run, name, how) in enumerate(order[:EASED]):
        for window in WINDOWS if number == 0 else WINDOWS[:1]:
            if window < 1.0 or (beside is not None and run.time <= (1.0 + SAME) * first.time):
                runs += [(eased, name, how) for eased in meter.measure(
                    run.start, window=window, beside=beside, quiet=run.quiet)]  # fmt: skip
    best, least = None, 1.0 - LEAST_GAIN
    for run, name, how in runs:
        value = value_of(run)
        LOG.debug(
            "%s%s: time %.4f -> %.4f s, band %.4f -> %.4f mm",
            name,
            "" if how is None else ", program",
            first.time,
            run.time,
            1e3 * first.band,
            1e3 * run.band,
        )
        if value < least:
            best, least = (run, name, how), value
    return best


def judge_gain(preset: str, time: float, band: float, still: float) -> float:
    """Return what a preset makes less, as a share of the start's; infinite where that is bought with what it may not.

    Args:
        preset: The preset by name, "" for none.
        time: Time as a share of the start's.
        band: Widest band as a share of the start's.
        still: The same, vibration left out.

    """
    if preset == "fast":
        return time
    if max(time, band) > 1.0 + SAME:
        return np.inf
    if preset == "error_band":
        return band
    return 0.5 * (band + still) if preset else 0.5 * (time + band)


def least_time(task: PlanTask) -> float:
    """Return the time of the programmed feed, of rapid moves, and of smoothing at both ends of every run. [s]"""
    rapid, smooth = task.nominal.rapid[1:], task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
    moves = np.abs(np.diff(task.q_start, axis=0))[rapid]
    between = time_rapids(moves, task.velocity_limits, task.acceleration_limits).sum()
    runs = len(cutting_runs(np.r_[False, rapid], task.rests))
    return float(task.step_time[~rapid].sum() + between + runs * smooth)
