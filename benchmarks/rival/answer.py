"""The plain rival's answer to a campaign in the shape of diagnosis.json, and its prediction of a later campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rival.chain import Array, Chain, read_chain
from benchmarks.rival.greedy import ALIKE, MOST, WIDE, Problem, Selection, Spec, Trial, fit_frames, select, try_all
from benchmarks.rival.log import Log, read_log
from benchmarks.rival.scene import stage
from benchmarks.rival.signatures import Columns

#: Where more than so many noise floors are left, something is not explained (assumed: robots are wrong by as much).
LEFT = 2.0
#: Claims are made from here on; a rival is listed as a tie at most so many.
CLAIM, TIES, FOLDS = 0.5, 4, 5
#: An effect that explains so many times what is left is a cause with even odds, and how steeply the odds grow with it:
#: smaller ones are the errors that a robot has everywhere. Fitted on 77 drawn campaigns (214 chosen effects).
EVEN, STEEP = 1.65, 3.2


@dataclass(frozen=True, eq=False)
class Answer:
    """What the rival says."""

    table: dict[str, Any]  #: As diagnosis.json.
    chain: Chain  #: The nominal robot.
    #: What was chosen to predict with: more than was chosen to be named where MOST was not enough.
    selection: Selection
    value: Array  #: Parameters of frames and effects, in the order of the columns.

    def predict(self, log: Log, nominal: bool = False) -> Array:
        """Predict the target of every row of a later campaign, frames registered anew. Shape (n, 3). [m]"""
        picked, given = self.selection, self.selection.problem.scene
        sagging = bool(given.gravity.any()) and not nominal
        q = log.q if nominal else _correct(log.q, picked.coupling, self.chain)
        scene = stage(self.chain, log, q, sagging, cold=_cold(given.log), later=True)
        tip, attitude = scene.posed.tip.copy(), scene.posed.attitude
        columns, at = Columns(scene), 0
        for spec in [] if nominal else [*picked.problem.always, *picked.chosen]:
            motion = columns.of(spec).position
            width = motion.shape[2]
            if at >= _width(picked.problem):
                tip += motion @ self.value[at : at + width]
            at += width
        frames = fit_frames(log, tip, attitude, picked.problem.register)
        target = tip + np.einsum("nij,nj->ni", attitude, frames.of_targets(log))
        return np.asarray(target @ frames.turn.T + frames.shift)


def _width(problem: Problem) -> int:
    return sum(problem.motion(s).position.shape[2] for s in problem.always)


def _cold(log: Log) -> float | None:
    return None if log.heat is None else float(np.nanmean(log.heat[:3]))


def _correct(q: Array, coupling: Spec | None, chain: Chain) -> Array:
    if coupling is None:
        return q
    out, joint = q.copy(), chain.joints.index(str(coupling.joint))
    word, zero = str(coupling.shape[0]), float(coupling.shape[1])
    if word == "reversed":
        out[:, joint] = zero - q[:, joint]
    elif word == "zero":
        out[:, joint] += zero
    else:
        out[:, joint] += zero * q[:, chain.joints.index(word)]
    return out


def diagnose(robot: Path, measurements: Path, register: Sequence[str] = ()) -> Answer:
    """Diagnose a campaign the plain way."""
    chain = read_chain(robot)
    log = read_log(measurements, chain)
    selection = select(chain, log, tuple(register))
    problem = selection.problem
    value, left = problem.fit(selection.chosen)
    nominal = problem
    if selection.coupling is not None or (problem.scene.gravity.any() and not chain.has_gravity):
        nominal = Problem(stage(chain, log, log.q, sagging=False), tuple(register))
    before = nominal.fit([])[1][0]
    floor = noise_floor(log, chain, left[0], problem.kept)
    after = rms(left[0][problem.kept])
    effects = claim(selection, value, after)
    claimed = [e for e in effects if e["probability"] >= CLAIM]
    places = {(e["effect"], e["joint"], e["axis"]) for e in claimed}
    named = problem.fit([s for s in selection.chosen if s.place in places])[1][0]
    open_end = rms(named[problem.kept]) > LEFT * floor
    status = ("partly_explained" if open_end else "explained") if claimed else ("unknown" if open_end else "none")
    if len(selection.chosen) >= MOST:
        selection = select(chain, log, tuple(register), WIDE)
        problem = selection.problem
        value, left = problem.fit(selection.chosen)
        after = rms(left[0][problem.kept])
    held = held_out(problem, selection.chosen)
    gap = {
        "before_rms_mm": 1e3 * rms(before[problem.kept]),
        "after_rms_mm": 1e3 * after,
        "held_out_before_rms_mm": 1e3 * rms(held_out(nominal, [])[problem.kept]),
        "held_out_after_rms_mm": 1e3 * rms(held[problem.kept]),
        "noise_floor_mm": 1e3 * floor,
    }
    table = {"schema": 1, "verdict": {"status": status, "effects": claimed}, "gap": gap, "candidates": effects}
    return Answer(table, chain, selection, value)


def rms(gap: Array) -> float:
    """Return the rms of distances. [m]"""
    return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))


def noise_floor(log: Log, chain: Chain, left: Array, kept: np.ndarray) -> float:
    """Return the scatter of the distance that no model can take away [m]: visits, poses met again, what is stated."""
    visit = np.cumsum(np.r_[True, (log.stay[1:] != log.stay[:-1])])
    within, between, seen, again = 0.0, 0.0, 0, 0
    for stay in np.unique(log.stay[kept]):
        rows = np.flatnonzero((log.stay == stay) & kept)
        means = []
        for v in np.unique(visit[rows]):
            part = left[rows[visit[rows] == v]]
            means.append(part.mean(axis=0))
            within += float(np.sum((part - means[-1]) ** 2))
            seen += len(part) - 1
        if len(means) > 1:
            between += float(np.sum((np.array(means) - np.mean(means, axis=0)) ** 2))
            again += len(means) - 1
    instrument = within / seen if seen >= 3 else 3.0 * log.sigma**2
    robot = between / again if again >= 3 else instrument + 3.0 * chain.repeatability**2
    floor = float(np.sqrt(max(instrument, robot)))
    return floor if floor > 0.0 else rms(left[kept])


def claim(selection: Selection, value: Array, after: float) -> list[dict[str, Any]]:
    """State every chosen effect with its probability: BIC weights against its rivals, times the odds of its size."""
    problem, out, at = selection.problem, [], _width(selection.problem)
    if selection.coupling is not None:
        out.append(_entry(selection.coupling, 0.99, [], np.array(selection.coupling.shape[1:], float)))
    for spec in selection.chosen:
        width = problem.motion(spec).position.shape[2]
        own = value[at : at + width]
        at += width
        beside = [c for c in selection.chosen if c is not spec]
        baked = spec.effect == "gravity_sag" and problem.scene.gravity.any() and not problem.scene.chain.has_gravity
        if baked:
            out.append(_entry(spec, 0.99, [], own + 1.0))
            continue
        pool = [s for s in selection.specs if s.place not in {b.place for b in beside}]
        trials = try_all(problem, beside, [*(p for p in pool if p.place != spec.place), spec], len(selection.specs))
        mine = next((t for t in trials if t.spec == spec), None)
        if mine is not None:
            out.append(_weigh(problem, mine, trials, own, after))
    out.sort(key=lambda e: -e["gain"])
    places = [(e["effect"], e["joint"], e["axis"]) for e in out]
    return [e for k, e in enumerate(out) if places[k] not in places[:k]]


def _weigh(problem: Problem, mine: Trial, trials: list[Trial], own: Array, after: float) -> dict[str, Any]:
    """Share the posterior among the effect, what cannot be told from it, its rivals and nothing."""
    rows = sum(int(m.sum()) * g.shape[1] for m, g in zip(problem.masks(), problem.gaps, strict=True))
    scale = np.sqrt(rows / (3.0 * problem.poses))
    alike = [t for t in trials if float(np.linalg.norm(t.fit - mine.fit)) / scale < ALIKE]
    top = max(0.0, max(t.gain for t in trials))
    weights = {id(t): float(np.exp(0.5 * (t.gain - top))) for t in trials}
    total = sum(weights.values()) + float(np.exp(-0.5 * top))
    share = sum(weights[id(t)] for t in alike) / total
    ties: list[tuple[str, str | None, str | None]] = []
    for t in alike:
        if t.spec.place != mine.spec.place and t.spec.place not in ties and len(ties) < TIES:
            ties.append(t.spec.place)
    seen = int(problem.masks()[0].sum())
    explained = problem.sigma[0] * float(np.linalg.norm(mine.fit[: 3 * seen])) / np.sqrt(max(seen, 1))
    odds = (explained / (EVEN * max(after, 1e-12))) ** STEEP
    return _entry(mine.spec, share * odds / (1.0 + odds), ties, own, gain=float(mine.fit @ mine.fit))


def _entry(
    spec: Spec, probability: float, ties: Sequence[tuple[str, str | None, str | None]], value: Array, gain: float = 1e9
) -> dict[str, Any]:
    return {
        "effect": spec.effect,
        "joint": spec.joint,
        "axis": spec.axis,
        "probability": round(min(probability, 0.999), 4),
        "parameters": {"shape": list(spec.shape), "value": [float(v) for v in value]},
        "ambiguous_with": [{"effect": e, "joint": j, "axis": a} for e, j, a in ties],
        "gain": gain,
    }


def held_out(problem: Problem, chosen: list[Spec]) -> Array:
    """Return the gap of every row under a fit of frames and effects that left its pose out. Shape (n, 3)."""
    every, y = [*problem.always, *chosen], problem.gaps[0]
    a = np.concatenate([problem.motion(s).position for s in every], axis=2) if every else np.zeros((*y.shape, 0))
    out, scale = y.copy(), np.linalg.norm(a, axis=(0, 1)) + 1e-30
    fold = problem.scene.log.stay % FOLDS
    for k in range(FOLDS):
        use = (fold != k) & problem.kept
        if a.shape[2] and use.any():
            value = np.linalg.lstsq((a[use] / scale).reshape(-1, a.shape[2]), y[use].ravel(), rcond=1e-9)[0] / scale
            out[fold == k] = y[fold == k] - a[fold == k] @ value
    return out
