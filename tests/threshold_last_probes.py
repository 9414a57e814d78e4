"""Small questions to the last stages of the diagnosis, whose answers are numbers that a threshold may change.

Each probe asks one stage: the campaigns are small, the fit is made once, and later stages start from it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows
from threshold_bench import CAUSES, Bench

from compplan.diagnose import (
    accuracy,
    bounds,
    calibration,
    campaign_diagnosis,
    delivery,
    doubt,
    fit,
    held_out,
    measurement_moves,
    next_measurement,
    polish,
    small_errors,
    state,
    traces,
    verdict,
    where,
)
from compplan.effects import Effect
from compplan.errors import CompplanError


def ask_doubt(bench: Bench) -> Any:
    """Claims among errors that no effect makes."""
    found = doubt.raise_doubt(bench.small_fit)
    first = replace(bench.small_fit.model, claims=bench.small_fit.model.claims[:1])
    few = replace(bench.small_fit, search=replace(bench.small_fit.search, cache={}), model=first)
    more = doubt.raise_doubt(few)
    return [(d.model.claims, d.model.score, d.model.posterior.hyper.vector) for d in (found, more)]


def ask_verdict(bench: Bench) -> Any:
    """The verdict of the fit, of one whose effects are small, and of one that leaves much."""
    own, found = bench.small_fit, bench.doubt
    whole = verdict.reach_verdict(own, found)
    answers: list[Any] = [whole.status, whole.structure]
    answers += [[(f.effect.place, f.probability, f.explained, f.margin, f.evidence) for f in part]
                for part in (whole.findings, whole.doubtful, whole.minor)]  # fmt: skip
    zero = next((f for f in whole.findings if f.effect.name == "joint_offset"), whole.findings[0])
    wide = [replace(zero, effect=Effect("joint_offset", "joint_5", None, {"offset_rad": v})) for v in (1e-3, 0.1)]
    answers += [verdict.name_far_zero(f).effect.name for f in wide]
    none = replace(found, model=replace(found.model, claims=()))
    answers += [[(f.effect.place, f.probability) for f in verdict.given_up(own, none, 0.0)]]
    registered = replace(own, problem=replace(own.problem, register=("base",)))
    answers += [[f.effect.place for f in verdict.reach_verdict(registered, found).minor]]
    for factor in (0.05, 3.0, 30.0):
        source = [replace(c, noise=replace(c.noise, sigma=c.noise.sigma * factor)) for c in found.search.ledger.source]
        scaled = replace(found, search=replace(found.search, ledger=replace(found.search.ledger, source=tuple(source))))
        seen = verdict.reach_verdict(own, scaled)
        answers += [seen.status, seen.structure.left, [f.effect.place for f in seen.minor],
                    [f.effect.place for f in seen.structure.dependences]]  # fmt: skip
    deaf = [np.zeros_like(found.search.ledger.designs[0]), *own.search.ledger.designs[1:]]
    silent = replace(own, search=replace(own.search, ledger=replace(own.search.ledger, designs=tuple(deaf))))
    answers += [verdict.only_in_readings(silent, found, f) for f in whole.findings]
    answers += [verdict.only_in_readings(own, found, f) for f in whole.findings]
    return answers


def ask_moves(bench: Bench) -> Any:
    """Candidate moves of a warm, loaded campaign with a path, of a cold one without loads, and of a flat one."""
    warm = replace(bench.campaign, temperature=20.0 + 8e-3 * bench.campaign.time)
    cold = replace(bench.campaign, temperature=np.full(len(warm), 20.0), wrench=np.zeros_like(warm.wrench))
    tepid = replace(bench.campaign, temperature=20.0 + 5e-4 * bench.campaign.time)
    flat = replace(bench.campaign, wrench=np.where(warm.wrench.any(1)[:, None], [0.0, 0.0, -300.0, 0, 0, 0], 0.0))
    answers: list[Any] = []
    for campaign in (warm, cold, flat, tepid):
        pool, moves = measurement_moves.lay_out_moves(bench.robot, campaign)
        answers += [pool.q, pool.wrench, pool.time, pool.temperature, [(m.kind, m.rows) for m in moves]]
    low = replace(bench.campaign, q=bench.campaign.q * 0.3)
    answers += [measurement_moves.keeps_clear(bench.robot, low, np.random.default_rng(1).uniform(-2, 2, (200, 6)))]
    return [*answers, measurement_moves.joint_range(bench.robot, low)]


def ask_picks(bench: Bench) -> Any:
    """Moves that tell much, little and nothing."""
    answers: list[Any] = []
    for size in (0.02, 0.3, 1.0, 3.0):
        difference = size * np.linspace(1.0, 0.2, 24)
        items = [np.arange(2 * k, 2 * k + 2) for k in range(12)]
        answers += [next_measurement.pick_moves(difference, np.eye(24), items, odds) for odds in (0.0, 2.0)]
    return [answers, [next_measurement.expected_gain(0.3, v, 2.0) for v in (0.01, 1.0, 40.0)]]


def ask_next(bench: Bench) -> Any:
    """What to measure next."""
    return next_measurement.propose_measurements(bench.diagnosis)


def ask_polish(bench: Bench) -> Any:
    """The last exact steps of a fit that stands a little off."""
    off = replace(bench.small_fit.state, values={k: 0.7 * v for k, v in bench.small_fit.state.values.items()})
    off = replace(off, effects=tuple(replace(e, parameters={k: 0.7 * v if isinstance(v, float) else v
                  for k, v in e.parameters.items()}) for e in bench.small_fit.state.effects))  # fmt: skip
    found = polish.polish_fit(replace(bench.small_fit, state=off))
    return [found.exact, found.state.values]


def ask_fit(bench: Bench) -> Any:
    """The whole fit, round after round, of four effects, of which one is found in what the others leave."""
    wave = {"cycles_per_turn": [23.4], "sine_rad": [2e-4], "cosine_rad": [8e-5]}
    causes = [*CAUSES, Effect("transmission_error", "joint_1", None, wave)]
    seen = measure(bench.robot, plan_rows(bench.robot, 21, poses=30, loads=1), causes, 21)
    found = fit.fit_effects(state.Problem(bench.robot, seen), None)
    return [found.score, found.model.claims, found.state.values, found.noises]


def ask_diagnosis(bench: Bench) -> Any:
    """What is delivered: the updated robot, candidates, and short campaigns that are refused."""
    found = campaign_diagnosis.diagnose_campaign(bench.robot, bench.few)
    return [found.gap, [c.place for c in found.candidates], found.updated.effects, found.updated.springs]


def ask_short(bench: Bench) -> Any:
    """A campaign that is too short, and one that counts a joint backwards."""
    try:
        campaign_diagnosis.diagnose_campaign(bench.robot, bench.few.take(np.arange(11)))
    except CompplanError as error:
        return [str(error)]
    return ["diagnosed"]


def ask_convention_named(bench: Bench) -> Any:
    """How sure a convention is that was found beforehand."""
    problem = replace(bench.small_fit.problem, fixed=(Effect("joint_coupling", "joint_5", None, {"reversed": True}),))
    found = campaign_diagnosis._with_conventions(verdict.reach_verdict(bench.small_fit, bench.doubt), problem, 0)
    return [found.findings[0].probability, found.findings[0].margin]


def ask_update(bench: Bench) -> Any:
    """Which folders are delivered, of predictions that differ by shares of a gap."""
    found = bench.diagnosis
    folds = held_out.Folds(found.fit, held_out.make_folds(bench.few))
    nominal = state.FitState((), {}, None, bench.few.usable)
    plain = folds.hold_out([], background=False)
    answers: list[Any] = []
    for scale in (1.0, 0.3, 0.1, 0.06):
        lesser = replace(plain, residual=scale * plain.residual)
        given = delivery.deliver_folders(folds, found.verdict, lesser, nominal, bench.few.usable)
        answers.append([(entry.kind, entry.held.rms) for entry in given])
    named, signatures = found.verdict.findings, found.fit.search.ledger.signatures
    other = next(n for n, s in enumerate(signatures) if s.name == "joint_offset" and n != named[0].signature)
    doubted = replace(found.verdict, findings=(), doubtful=(*named, replace(named[0], signature=other)))
    given = delivery.deliver_folders(folds, doubted, plain, nominal, bench.few.usable)
    return [*answers, [(entry.kind, entry.held.rms) for entry in given]]


def ask_told(bench: Bench) -> Any:
    """What the page and diagnosis.json say beside the verdict."""
    found = bench.diagnosis
    told = [accuracy.measure_accuracy(found), accuracy.list_worst(found), accuracy.draw_learning(found)]
    told += [calibration.list_corrections(found), calibration.list_frames(found)]
    return [*told, where.split_diagnosis(found), traces.trace_findings(found)]


def ask_small_errors(bench: Bench) -> Any:
    """What a calibration finds, by joint and kind."""
    return small_errors.divide_small_errors(bench.diagnosis)


def ask_bounds(bench: Bench) -> Any:
    """Effects of sizes that a robot may just have, and of sizes that none has, with and without a data sheet."""
    own, answers = bench.small_fit, []
    mass = float(sum(body.mass for body in own.problem.robot.bodies))
    for rating, length in ((None, 0.1), ((0.5 * mass, 1.0), 0.005)):
        tool = np.eye(4)
        tool[0, 3] = length
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bounds, "read_rating", lambda robot, rating=rating: rating)
            patch.setattr(bounds, "flange_to_tcp", lambda robot, tool=tool: tool)
            answers += [bool(bounds.find_breach(own, *asked)) for asked in sized_effects(own, mass)]
    return answers


def sized_effects(own: Any, mass: float) -> list[tuple[Effect, float, float]]:
    """Effects of the joints of a small robot, with their motion and the gap [m]."""
    law = {"compliance": 1e-6, "reference_load": 100.0, "zone_load": 10.0}
    joint = own.at.robot.joint_names[1]
    load = float(np.maximum(np.abs(own.at.own_load), np.abs(own.at.own_weight_load))[:, 1].max())
    masses = [(0.1, 0.0, 0.0), (0.1, -0.009, 0.0), (0.1, -0.02, 0.0), (0.1, 0.0, -0.02), (0.8, 0.0, 0.0)]
    masses += [(1.6, 0.0, 0.0)]
    asked: list[tuple[str, str | None, dict[str, Any]]] = [
        ("payload", None, {"mass_kg": m * mass, "first_moment_kg_m": [x * mass, 0.0, z * mass]}) for m, x, z in masses
    ]
    asked += [("gravity_compensator", joint, {"constant_Nm": c * load}) for c in (0.5, 9.0)]
    asked += [("stiffness_nonlinearity", joint, {**law, "soft_zone_ratio": r}) for r in (5.0, 33.0)]
    asked += [("stiffness_nonlinearity", joint, {**law, "quadratic_ratio": r}) for r in (1.0, 5.0)]
    asked += [("joint_coupling", joint, {"other": joint, "ratio": r}) for r in (0.02, 3e-4)]
    found = [(Effect(name, at, None, values), 1e-3, 1e-3) for name, at, values in asked]
    far = Effect("joint_offset", joint, None, {"offset_rad": 1e-3})
    return [*found, (far, 2e-3, 1e-3), (far, 0.4, 1e-3)]
