"""Probes of the last stages' decisions: each asked with what stands just on either side of it, measuring aside.

Each `ask_...` takes the bench and returns the answers; what a stage measures before it decides is put in its hands.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from threshold_bench import Bench

from compplan.diagnose import (
    accuracy,
    blend,
    calibration,
    delivery,
    doubt,
    fit,
    gap_tables,
    gears,
    held_out,
    next_measurement,
    options,
    posterior,
    probe,
    restart,
    verdict,
)
from compplan.diagnose.search import Claim
from compplan.diagnose.unmodelled import UNMODELLED
from compplan.effects import Effect
from compplan.effects.signature import Signature


def ask_names(bench: Bench) -> Any:
    """Effects small and large beside a floor of 1 and a gap of 20, sure and unsure, with and without free frames."""
    structure = verdict.Structure(0.0, 0.0, 20.0, 0.0, 0.0, False, 1.0)
    zero = {"offset_rad": 1e-4}
    findings = [
        verdict.Finding(Effect("joint_offset", f"{size} {sure}", None, zero), sure, size, 0.0, (), 1.0, 0)
        for size in (0.5, 1.0, 5.0)
        for sure in (0.3, 0.7)
    ]  # fmt: skip
    claimed = SimpleNamespace(model=SimpleNamespace(claims=range(len(findings))))
    answers: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "measure_structure", lambda fit, found: structure)
        patch.setattr(verdict, "count_repetitions", lambda fit, found: dict.fromkeys(range(len(findings)), 1.0))
        patch.setattr(verdict, "rate_imitations", lambda fit, found: dict.fromkeys(range(len(findings)), 0.0))
        patch.setattr(verdict, "rate_likenesses", lambda fit, found: dict.fromkeys(range(len(findings)), 1.0))
        patch.setattr(verdict, "find_gears", lambda fit, found: frozenset())
        patch.setattr(verdict, "weigh_claim", lambda fit, found, claim, checks, seen, gear: findings[claim])
        patch.setattr(verdict, "only_in_readings", lambda fit, found, finding: False)
        patch.setattr(verdict, "given_up", lambda fit, found, small: ())
        for register in ((), ("base",)):
            fit = SimpleNamespace(problem=SimpleNamespace(register=register))
            told = verdict.reach_verdict(fit, claimed)  # type: ignore[arg-type]
            answers += [[f.effect.joint for f in part] for part in (told.findings, told.doubtful, told.minor)]
    return answers


def ask_lawful(bench: Bench) -> Any:
    """Curves over a joint's angle of which a wave explains .5, .8 and .99."""
    nothing_bends: Any = SimpleNamespace(search=SimpleNamespace(ledger=SimpleNamespace(signatures=())))
    return [verdict.is_lawful(nothing_bends, *curves(lawful)) for lawful in (50.0, 80.0, 99.0)]


def curves(lawful: float) -> tuple[Any, Claim]:
    """A claim of no law with evidence 100, and a wave at the same place."""
    place = ("transmission_error", "joint_2", None)
    signatures = [
        SimpleNamespace(place=place, form=form, lawful=form == "waves 1", fixed={}) for form in ("spline", "waves 1")
    ]
    gains = [SimpleNamespace(signature=k, log_evidence=value) for k, value in enumerate((100.0, lawful))]
    claims = (Claim(0, 1.0),)
    search = SimpleNamespace(
        ledger=SimpleNamespace(signatures=signatures), log_prior=np.zeros(2), gains=lambda model: gains,
        model=lambda *claims, **options: None,
    )  # fmt: skip
    model = SimpleNamespace(claims=claims, posterior=SimpleNamespace(hyper=None))
    return SimpleNamespace(search=search, model=model), claims[0]


def ask_shapeless(bench: Bench) -> Any:
    """A claim of no law among findings, stated with .1."""
    zero = {"offset_rad": 1e-4}
    structure = verdict.Structure(0.0, 0.0, 20.0, 0.0, 0.0, False, 1.0)
    finding = verdict.Finding(Effect("transmission_error", "joint_2", None, zero), 0.1, 9.0, 0.0, (), 1.0, 0)
    return [verdict.leave_shapeless(structure, [finding]).left]


def ask_special_case(bench: Bench) -> Any:
    """A law of deflection and the straight one that it holds, whose evidence is 0.5, 1 and 9 less; an offset beside."""
    names = ("stiffness_nonlinearity", "joint_stiffness", "joint_offset")
    signatures = [SimpleNamespace(place=(name, "joint_2", None), joint="joint_2") for name in names]
    answers = []
    for less in (0.5, 1.0, 9.0):
        gains = [SimpleNamespace(signature=k, log_evidence=50.0 - less * (k == 1), size=1.0) for k in range(3)]

        def model(claims: Any, *rest: Any, **options: Any) -> Any:
            return SimpleNamespace(claims=tuple(claims), score=0.0, posterior=SimpleNamespace(hyper=None))

        search = SimpleNamespace(ledger=SimpleNamespace(signatures=signatures), gains=lambda m, g=gains: g, model=model)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(doubt, "forms_that_hold", lambda ledger, special: {0} if special == 1 else set())
            told = doubt._simplify(search, model([Claim(0, 1.0)]))  # type: ignore[arg-type]
        answers.append([names[claim.signature] for claim in told.claims])
    return answers


def ask_readings(bench: Bench) -> Any:
    """Effects that move the target not at all, a little and much, and readings by 1, 5 and 50 deviations."""
    answers = []
    for target in (0.0, 1e-9, 1e-3, 10.0):
        for reading in (0.01, 1.0, 5.0, 50.0):
            designs = [np.full((4, 3, 1), target), np.full((4, 1, 1), reading)]
            ledger = SimpleNamespace(columns=lambda number: np.array([0]), designs=designs, p=1)
            values = SimpleNamespace(values=lambda p: np.ones(p))
            fit = SimpleNamespace(search=SimpleNamespace(ledger=ledger))
            found = SimpleNamespace(model=SimpleNamespace(posterior=values), search=SimpleNamespace(ledger=ledger))
            answers.append(verdict.only_in_readings(fit, found, SimpleNamespace(signature=0)))  # type: ignore[arg-type]
    return answers


def ask_spoken(bench: Bench) -> Any:
    """Two things that an unknown error follows, one by a fifth of what is left, the other by four fifths."""
    motion = np.zeros((6, 3, 2))
    motion[:, 0] = [0.2, 0.8]
    owners = [SimpleNamespace(name=UNMODELLED, joint=None, axis=None) for _ in range(2)]
    ledger = SimpleNamespace(
        p=2, designs=[motion], signatures=owners, columns=lambda number: np.array([number]),
        source=[SimpleNamespace(sigma=np.ones((6, 3)))],
    )  # fmt: skip
    found = SimpleNamespace(
        search=SimpleNamespace(ledger=ledger), classes=("time", "place"), members=(np.array([0]), np.array([1])),
        model=SimpleNamespace(posterior=SimpleNamespace(values=lambda p: np.ones(p))),
    )  # fmt: skip
    structure = verdict.Structure(9.0, 1.0, 1.0, 0.0, 0.0, True, 0.1)
    return [f.effect.axis for f in verdict.find_dependences(found, structure)]  # type: ignore[arg-type]


def ask_left(bench: Bench) -> Any:
    """Structure just below one and a half floors: by what it gains, and by its size."""
    own, found = bench.small_fit, bench.doubt
    own = replace(own, search=replace(own.search, cache={}))
    here = found.model.posterior.log_evidence
    alone = replace(found, model=replace(found.model, claims=found.model.claims[:1]))
    answers: list[Any] = [verdict.measure_structure(own, one).gain for one in (found, alone)]
    rms = verdict.measure_structure(own, found)
    whole = float(np.hypot(rms.rms, rms.floor))
    for share in (0.8, 0.95):
        for gain in (-2.0, 0.0, 2.0, 5.0, 10.0, 40.0):
            sure = replace(found.model.posterior, log_evidence=here - rms.gain + gain)
            told = replace(found, model=replace(found.model, posterior=sure))
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(verdict, "noise_floor", lambda fit, size=share * whole: size)
                patch.setattr(verdict, "find_dependences", lambda found, structure: ())
                answers.append(verdict.measure_structure(own, told).left)
    return answers


def ask_margins(bench: Bench) -> Any:
    """Margins of claims against what could stand in their place."""
    fit = bench.small_fit
    model = fit.model
    return [verdict.margin_of(fit.search, model.claims, model.posterior.hyper, c, set()) for c in model.claims]


def ask_weighing(bench: Bench) -> Any:
    """Where the weighing of claims among errors without a name begins, how far it may go, and its single steps."""
    begun: list[Any] = []

    def record(search: Any, model: Any, changes: int) -> Any:
        begun.append((model.posterior.hyper.vector, model.score, changes))
        return model

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(doubt, "_settle", record)
        doubt.raise_doubt(bench.fit)
    found = bench.doubt
    without = doubt._leave_out(replace(found.search, cache={}), bench.doubt.model)
    return [begun, without.score]


def ask_plain_path(bench: Bench) -> Any:
    """Effects of the plain path that a second start begins with."""
    return restart.follow_plain_path(bench.fresh_search(), 24).claims


def ask_rounds(bench: Bench) -> Any:
    """Rounds of a fit that gets worse from round to round: when noise is known, and which of them is kept."""
    own, told = bench.small_fit, list[Any]()

    def round_off(problem: Any, state: Any, noises: Any, proposals: Any, progress: Any) -> Any:
        told.append(noises is None)
        return own, []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "_round", round_off)
        patch.setattr(fit, "advance_state", lambda found: found.state)
        patch.setattr(fit, "descend", lambda found, there: (found.state, -float(len(told))))
        patch.setattr(fit, "_settled", lambda found, here, there: False)
        patch.setattr(fit, "_finish", lambda best, there: best)
        found = fit.fit_effects(own.problem, None)
    return [told, found.score]


def ask_curve(bench: Bench) -> Any:
    """The learning curve of a fit with path and poses, and how it is told."""
    found = SimpleNamespace(deliveries=[SimpleNamespace(fitted=bench.fit)], fit=bench.fit)
    curve = accuracy.draw_learning(found)  # type: ignore[arg-type]
    assert curve is not None
    return [curve.poses, curve.errors, curve.to_json()]


def ask_told_frames(bench: Bench) -> Any:
    """Free frames whose spread a campaign shrinks to a millionth, a thirtieth, a third and not at all."""
    share = np.array([1e-6, 1 / 30, 1 / 3, 1.0])
    prior = SimpleNamespace(free=np.ones(4, bool), variance=lambda log_tau: np.ones(4))
    ledger = SimpleNamespace(scale=np.ones(4), names=list("abcd"))
    model = SimpleNamespace(
        claims=(),
        posterior=SimpleNamespace(
            columns=np.arange(4), covariance=np.diag(share**2), hyper=SimpleNamespace(log_tau=0.0)
        ),
    )
    fitted = SimpleNamespace(model=model, search=SimpleNamespace(ledger=ledger, prior_of=lambda claims: prior))
    return sorted(calibration._spreads(SimpleNamespace(fitted=fitted)))  # type: ignore[arg-type]


def ask_stretches(bench: Bench) -> Any:
    """Stretches of time of logs of 30 and of 500 rows."""
    table = SimpleNamespace(describe=lambda inside: {"rows": int(inside.sum())})
    log = SimpleNamespace(time=None)
    return [gap_tables.split_time(table, log, np.arange(n)) for n in (30, 500)]  # type: ignore[arg-type]


def ask_columns(bench: Bench) -> Any:
    """Columns of an effect at further rows, by differences of the exact model."""
    at = bench.fit.at
    offered = [s for s in bench.fit.search.ledger.signatures if s.name == "joint_offset"]
    return [probe.probe_signature(at, s).twist for s in offered[:2]]


def ask_pairs(bench: Bench) -> Any:
    """Pairs to be told apart, of a claim that five others imitate."""
    fit = bench.small_fit
    claim = fit.model.claims[0]
    rest = [c for c in fit.model.claims if c != claim]
    reduced = fit.search.model(rest, fit.model.posterior.hyper, fit=False)
    own = fit.search.ledger.signatures[claim.signature]
    gains = [fit.search.ledger.signatures[g.signature] for g in fit.search.gains(reduced)]
    places = dict.fromkeys(s.place for s in gains if s.name != UNMODELLED and next_measurement.is_comparable(own, s))
    rivals = tuple(verdict.Rival(place, 1.0, 0.0, 1) for place in list(places)[:5])
    finding = verdict.Finding(own.effect(own.scale), 0.9999, 1.0, 9.0, rivals, claim.size, claim.signature)
    assert all(rival.alike for rival in rivals) and len(rivals) == 5
    return [(pair.first, pair.second) for pair in next_measurement.find_pairs(fit, [finding])]


def ask_worth(bench: Bench) -> Any:
    """Moves that separate a pair hardly, and well."""
    moves = [next_measurement.MeasuringMove("static", (2 * k, 2 * k + 1)) for k in range(6)]
    pair = SimpleNamespace(first=("a", None, None), second=("b", None, None), log_odds=0.0)
    answers = []
    for size in (0.1, 0.2, 0.5, 1.0, 3.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                next_measurement, "predict_difference",
                lambda fit, pair, stacked, widths, size=size: (size * np.ones(12), np.eye(12)),
            )  # fmt: skip
            patch.setattr(next_measurement, "KINDS", ("static",))
            found = next_measurement.best_proposal(bench.fit, pair, [np.zeros((12, 1, 1))], moves)  # type: ignore[arg-type]
        answers.append(None if found is None else (found.gain, len(found.moves)))
    return answers


def ask_forgetting(bench: Bench) -> Any:
    """The distance over which drawn errors forget themselves: few poses and many, smooth and rough."""
    random = np.random.default_rng(3)
    answers = []
    for poses, length in [(10, 1.0), (60, 1.0), (60, 0.1), *[(450, 0.25)] * 6]:
        place = random.uniform(-1, 1, (poses, 3))
        apart = np.sum((place[:, None] - place[None]) ** 2, axis=2)
        root = np.linalg.cholesky(np.exp(-0.5 * apart / length**2) + 1e-9 * np.eye(poses))
        noise = 3.0 if poses == 450 else 0.1
        left = root @ random.normal(size=(poses, 3)) + noise * random.normal(size=(poses, 3))
        answers.append(posterior.find_scale(place, left, np.arange(poses)))
    return answers


def ask_luck(bench: Bench) -> Any:
    """How often luck does as well as poses that are predicted better, few and many of them."""
    answers = []
    for poses in (5, 18):
        gain, rows = np.random.default_rng(poses).normal(0.5, 1.0, poses), np.arange(poses)
        plain = held_out.HeldOut(rows, np.full((poses, 3), 2.0))
        answers.append(held_out.HeldOut(rows, np.sqrt(plain.residual**2 - gain[:, None])).luck_against(plain, rows))
    return answers


def ask_choice(bench: Bench) -> Any:
    """Folders that predict better than each other by half a percent, five percent and half."""
    answers: list[Any] = []
    fit = SimpleNamespace(problem=SimpleNamespace(campaign=None))
    plain = held_out.HeldOut(np.arange(4), np.full((4, 3), 2.0 / np.sqrt(3.0)))
    # the last number: by which share of itself the square of one pose of four is larger, and that of another smaller
    for causes, calibrated, uneven in (
        (1.0, 0.995, 0.1),
        (1.0, 0.95, 0.1),
        (1.0, 0.5, 0.1),
        (1.0, 1.3, 0.1),
        (1.995, 1.99, 1e-3),
        (1.9, 2.5, 0.5),
        (0.2, 0.3, 0.1),
    ):
        size = {False: causes, True: calibrated}
        shape = np.sqrt(np.array([[1.0], [1.0 + uneven], [1.0 - uneven], [1.0]]) / 3.0) * np.ones(3)
        folds = SimpleNamespace(
            fit=fit,
            pose=np.arange(4),
            hold_out=lambda claims, background=True, decide=None, size=size, shape=shape: held_out.HeldOut(
                np.arange(4), size[background] * shape
            ),
        )
        named = SimpleNamespace(signature=0, size=1.0, rivals=(), probability=1.0)
        found = SimpleNamespace(findings=(named,), minor=(), doubtful=())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(delivery, "possible_claims", lambda verdict: [1])
            patch.setattr(delivery, "decide_once", lambda folds, claims: None)
            patch.setattr(delivery, "blend_options", lambda folds, options, seen: [1])
            patch.setattr(delivery, "hold_out_blend", lambda folds, blend: folds.hold_out(blend))
            patch.setattr(delivery, "_residual", lambda problem, state: np.zeros((4, 3)))
            patch.setattr(delivery, "state_uncertainty", lambda *rest, **named: None)
            patch.setattr(delivery, "hold_out_lawful", lambda folds, blend, seen: None)
            patch.setattr(delivery, "_build", lambda fit, kind, claims, held, sure, lawful: (kind, held.rms))
            given = delivery.deliver_folders(folds, found, plain, None, np.ones(4, bool))  # type: ignore[arg-type]
        answers.append([entry if isinstance(entry, tuple) else entry.kind for entry in given])
    return answers


def ask_sure(bench: Bench) -> Any:
    """Which names are not weighed anew in parts of the campaign."""
    names = [Effect("joint_offset", "joint_2"), Effect("joint_offset", "joint_3"), Effect("wrench_scale")]
    found = [
        SimpleNamespace(effect=effect, probability=p, signature=n, size=1.0)
        for n, (effect, p) in enumerate(zip(names, (0.6, 0.97, 0.6), strict=True))
    ]
    return delivery.sure_claims(SimpleNamespace(findings=found))  # type: ignore[arg-type]


def ask_blend(bench: Bench) -> Any:
    """Weights of models that may go out, and what each leaves of poses that it never saw."""
    folds = held_out.Folds(bench.small_fit, held_out.make_folds(bench.few))
    claims = bench.small_fit.model.claims
    decide = options.decide_once(folds, claims)
    mixed = blend.blend_options(folds, options.list_options([], claims, decide), np.ones(len(folds.pose), bool))
    return [decide is None, mixed.weights, mixed.by_fold, [one.residual for one in mixed.solved]]


def ask_calibrated(bench: Bench) -> Any:
    """What is called when small errors leave a part of a gap far above the noise."""
    structure = verdict.Structure(0.0, 0.0, 1.0, 0.0, 0.0, True, 0.01)
    unknown = verdict.Verdict("unknown", (), (), (), structure)
    return [verdict.judge_calibration(unknown, 1.0, after).status for after in (0.1, 0.3)]


def ask_gears(bench: Bench) -> Any:
    """Which of several waves are those of a gear: by what they gain, how halves agree, and what they carry."""
    waves = Signature(
        "transmission_error", "joint_2", None, "waves 5 9", ("a", "b", "c", "d"), np.ones(4), np.zeros((0, 6, 4)),
        fixed={"cycles_per_turn": [5.0, 9.0]}, lawful=False,
    )  # fmt: skip
    ledger = SimpleNamespace(signatures=[waves], columns=lambda number: np.arange(4))
    q = np.linspace(0.0, 6.0, 9)[:, None] * np.ones(6)
    fit = SimpleNamespace(
        at=SimpleNamespace(robot=SimpleNamespace(joint_names=["joint_2"])),
        problem=SimpleNamespace(campaign=SimpleNamespace(q=q)),
    )
    answers = []
    for gain in (5.0, 50.0):
        for agree in (1.0, 0.3, -1.0):
            for rest in (1.2, 1.6):
                # the first wave alone, and both together
                lost = {2: gain, 4: rest * gain}
                posterior = SimpleNamespace(
                    loss_without=lambda own, lost=lost: 0.1 if own[0] == 2 and len(own) == 2 else lost[len(own)]
                )
                model = SimpleNamespace(posterior=posterior)
                asked = SimpleNamespace(search=SimpleNamespace(ledger=ledger), model=model)
                halves = np.tile([[1.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0]], (4, 1))
                halves[1::4] *= agree
                answers.append(gears._is_gear(fit, asked, Claim(0, 1.0), halves))  # type: ignore[arg-type]
    return answers
