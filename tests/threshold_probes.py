"""Small questions to the rooms of the diagnosis, whose answers are numbers that a threshold may change.

Each probe asks one stage: the campaigns are small, the fit is made once, and later stages start from it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from simulated_campaigns import measure, plan_rows
from threshold_bench import Bench

from compplan.diagnose import (
    ambiguity,
    background,
    certainty,
    channels,
    cholesky,
    conventions,
    descent,
    doubt,
    evidence,
    explanations,
    gains,
    held_out,
    imitation,
    ledger,
    likeness,
    noise,
    offers,
    outliers,
    proposals,
    questions,
    repetition,
    search,
    state,
    unmodelled,
)
from compplan.effects import Effect, command_campaign
from compplan.errors import CompplanError


def ask_noise(bench: Bench) -> Any:
    """Repeats, poses met again, paths, sigma columns and stated repeatabilities, that agree or contradict."""
    rng = np.random.default_rng(3)
    answers = []
    for rows, poses, tells in ((3, 40, None), (1, 40, 2e-5), (1, 4, None), (2, 4, 9e-5)):
        order = np.concatenate([rng.permutation(poses) for _ in range(3)])
        q = np.repeat(rng.uniform(-1, 1, (poses, 6))[order], rows, axis=0)
        gap = np.repeat(rng.normal(0, 2.5e-5, (len(order), 3)), rows, axis=0)
        gap = gap + rng.normal(0, 2e-5, gap.shape)
        gap[1] += 1.7e-4
        campaign = command_campaign(q, on_path=False)
        for scale in (1.0, 3.0):
            stated = np.full(len(q), 2e-5 * scale) * (1.0 + 1e-5 * rng.uniform(-1, 1, len(q)))
            answers += [noise.estimate_noise(campaign, gap * s, stated, "position", tells) for s in (1.0, 0.3, 4.0)]
        wrench = np.zeros((len(q), 6))
        wrench[:, 2] = 400.0 + 30.0 * rng.uniform(-1, 1, len(q))
        loaded = replace(campaign, wrench=wrench)
        light = replace(campaign, wrench=wrench * 0.02)
        for name in ("position", "orientation", "encoder"):
            answers += [noise.estimate_noise(entry, gap, None, name, tells) for entry in (loaded, light)]
        two = campaign.take(np.arange(2))
        answers += [noise.estimate_noise(two, gap[:2], None, name) for name in noise.ASSUMED_SIGMA]
        uneven = np.where(np.arange(len(q)) % 2 == 0, 1e-5, 3e-5)
        answers += [noise.estimate_noise(campaign, gap, uneven, "position", tells)]
    for count in (12, 40, 900):
        path = command_campaign(np.cumsum(rng.uniform(0, 0.01, (count, 6)), axis=0), on_path=True)
        wave = rng.normal(0, 2e-5, (count, 3)) + np.sin(np.arange(count) / 9.0)[:, None] * 1e-3
        answers += [noise.estimate_noise(path, wave, None, "position")]
        answers += [noise.estimate_noise(path, wave, np.full(count, s), "position") for s in (1.2e-5, 1.8e-5)]
        short = replace(path, run=np.array([f"path_{k // 12}" for k in range(count)]))
        answers += [noise.estimate_noise(short, wave, None, "position")]
    return [*answers, [found.leeway for found in answers]]


def ask_outliers(bench: Bench) -> Any:
    """Rows that stand out of few and many others, more and fewer than may be."""
    rng = np.random.default_rng(5)
    answers = []
    for count in (15, 60, 400):
        campaign = command_campaign(rng.uniform(-1, 1, (count, 6)), on_path=False)
        campaign = replace(campaign, position=np.zeros((count, 3)))
        gap = rng.normal(0, 1e-5, (count, 3))
        for far in ([3], list(range(1, 7)), list(range(2, count, 4))):
            for size in (6e-5, 1.2e-4, 2.4e-4, 1e-2):
                moved = gap.copy()
                moved[far, 0] += size * np.linspace(1.0, 2.0, len(far))
                everywhere = np.ones(count, bool)
                answers += [outliers.find_gross_outliers(campaign, moved)]
                answers += [outliers.find_outliers(campaign, moved, 1e-5, everywhere)]
    return answers


def ask_certainty(bench: Bench) -> Any:
    """Strong and weak claims."""
    cases = [
        (30.0, 25.0, 1.0, 3.0, 0.5, 0.1, 0.02, 0.1), (4.0, 3.0, 0.5, 0.05, 0.01, 0.1, 0.1, 0.5),
        (-50.0, -40.0, 0.0, 0.2, 0.1, 0.1, 0.9, 4.0), (9e2, 9e2, 1.0, 60.0, 1.0, 0.1, 2e-3, 0.02),
        (3.0, 3.0, 0.5, 40.0, 1.0, 0.1, 2e-3, 0.9),
    ]  # fmt: skip
    return [certainty.rate_certainty(certainty.Evidence(*case)) for case in cases]


def ask_likeness(bench: Bench) -> Any:
    """What is left mostly along a motion that is small in some rows, and nowhere in one."""
    rng = np.random.default_rng(8)
    motion = rng.normal(size=(12, 3))
    left = 2.0 * motion + rng.normal(size=(12, 3))
    motion[:4] *= 1e-3
    motion[4] = 0.0
    return likeness.measure_likeness(left, motion, np.arange(12))


def ask_imitation(bench: Bench) -> Any:
    """Claims beside one that takes nearly all, and how often causes without a name are explained as fully."""
    own = bench.small_fit
    alone = replace(own.model, claims=own.model.claims[:1])
    models = [replace(own.model, claims=own.model.claims[:2]), alone]
    rated = [imitation.rate_imitations(own, doubt.Doubt(own.search, model, (), ())) for model in models]
    return [list(found.values()) for found in rated], imitation.draw_causes(own)[:3, :5]


def ask_blocks(bench: Bench) -> Any:
    """Blocks of a path, folds, halves, sizes of groups, and what an incomplete log still tells."""
    campaign = bench.campaign
    link, rotation = campaign.link.copy(), campaign.rotation.copy()
    link[: int(0.6 * len(link)), 1] = np.nan
    link[: int(0.3 * len(link)), 2] = np.nan
    rotation[4:] = np.nan
    at = bench.fit.at
    half = replace(at.scene, campaign=replace(campaign, link=link))
    few = replace(campaign, rotation=rotation)
    return [
        channels.block_index(campaign),
        channels.block_index(command_campaign(np.zeros((400, 6)), on_path=True)),
        held_out.make_folds(campaign, held_out.FOLDS),
        repetition.draw_halves(campaign),
        ledger.typical_size(np.arange(1, 60)),
        [c.residual for c in channels.build_channels(half, at.attained, bench.fit.state.use, bench.fit.noises)],
        channels.estimate_noises(few, at.attained),
        channels.estimate_noises(replace(campaign, rotation=np.where(np.arange(len(rotation))[:, None, None] < 7,
                                 campaign.rotation, np.nan)), at.attained),
    ]  # fmt: skip


def ask_conventions(bench: Bench) -> Any:
    """What is tried, and how far a ratio and a zero of unknown size are driven."""
    rows = plan_rows(bench.robot, 3, poses=16, loads=0)
    own = conventions.hypotheses(bench.robot, rows)
    answers: list[Any] = [[e.parameters for e in own if e.joint == "joint_5"]]
    for case in ({"other": "joint_4", "ratio": 0.37}, {"zero_rad": 1.1}):
        effect = Effect("joint_coupling", "joint_5", None, case)
        seen = measure(bench.robot, rows, [effect], 3, orientation=False)
        answers.append(conventions.size_convention(bench.robot, seen, (), [], effect))
    return answers


def ask_convincing(bench: Bench) -> Any:
    """A joint that counts backwards, in a log with gaps of millimetres and in a rough one."""
    rows = plan_rows(bench.robot, 3, poses=16, loads=0)
    backwards = [Effect("joint_coupling", "joint_5", None, {"reversed": True})]
    seen = measure(bench.robot, rows, backwards, 3, orientation=False)
    rough = replace(seen, position=seen.position + np.random.default_rng(1).normal(0, 0.012, seen.position.shape))
    zero = [Effect("joint_coupling", "joint_2", None, {"zero_rad": 2e-3})]
    small = measure(bench.robot, rows, zero, 3, orientation=False)
    wild = replace(seen, position=small.position + np.random.default_rng(1).normal(0, 0.05, seen.position.shape))
    return [conventions.find_conventions(bench.robot, log, (), most=1) for log in (seen, rough, small, wild)]


def ask_questions(bench: Bench) -> Any:
    """Logs with a mistake each, plain ones and ones at the border."""
    robot = bench.robot
    plain = measure(robot, plan_rows(robot, 11, poses=24), [], 11, orientation=False)
    stiff = questions.stage_rows(replace(robot, springs=(), link_elasticities=()), plain)
    turned = plain.position * [1, -1, 1]
    rough = np.random.default_rng(2).normal(0, 1.0, plain.position.shape)
    bent = np.roll(plain.position, 1, axis=0)
    still = measure(robot, plan_rows(robot, 4, poses=16, loads=0, region=1e-4), [], 4, orientation=False)
    tables = {
        questions.ask_unit: [plain.position * f for f in (1e-3, 0.12, 0.08, 1.0)] + [plain.position + 0.3 * rough],
        questions.ask_hand: [turned, turned + 0.05 * rough, turned + 0.2 * rough, plain.position + 0.002 * rough],
        questions.ask_step: [bent, bent + 0.05 * rough, bent + 0.2 * rough, plain.position + 0.012 * rough],
    }
    answers: list[Any] = []
    for ask, positions in tables.items():
        answers += [ask(questions.stage_rows(robot, replace(plain, position=p))) for p in positions]
    answers += [questions.ask_unit(questions.stage_rows(robot, replace(still, position=still.position * 1e-3)))]
    answers += [len(questions.stage_rows(robot, plain).position)]
    for share in (0.02, 0.1, 0.35):
        moved = plain.position + 0.4 * np.einsum("nij,j->ni", questions.stage_rows(robot, plain).rotation, [0, 0, 1.0])
        log = questions.stage_rows(robot, replace(plain, position=moved + share * 0.2 * rough))
        answers += [questions.ask_target(log, ())]
        moved = plain.position + [0.4, 0.1, 0.0] + share * 0.05 * rough
        answers += [questions.ask_frames(questions.stage_rows(robot, replace(plain, position=moved)), ())]
    metres = replace(plain, position=plain.position * 1e-3)
    answers += [[q.about for q in questions.question_campaign(robot, metres.take(np.arange(n)))] for n in (3, 12)]
    return [*answers, len(stiff.position)]


def ask_signs(bench: Bench) -> Any:
    """Reversed deviations and wrenches, moments about the flange, clocks that are off; plain and at the border."""
    robot = bench.robot
    plain = measure(robot, plan_rows(robot, 11, poses=24), [], 11, orientation=False)
    rows = questions.stage_rows(robot, plain)
    rigid = questions.stage_rows(replace(robot, springs=(), link_elasticities=()), plain).position
    answers: list[Any] = []
    for share in (2.0, 1.05, 1.001):
        wrong = replace(plain, position=share * rigid + (1.0 - share) * plain.position)
        answers += [questions.ask_sign(robot, questions.stage_rows(robot, wrong), ())]
    noisy = plain.position + np.random.default_rng(6).normal(0, 2e-3, plain.position.shape)
    answers += [questions.ask_sign(robot, rows._replace(campaign=replace(plain, wrench=-plain.wrench)), ())]
    opposed = replace(plain, wrench=-plain.wrench)
    rough = 0.4 * (rigid - plain.position) + np.random.default_rng(6).normal(0, 3e-4, noisy.shape)
    for position in (noisy, rigid + rough):
        answers += [questions.ask_sign(robot, rows._replace(campaign=replace(opposed, position=position)), ())]
    lever = rows.position - questions._flange(robot, rows)
    for share, size in ((1.0, 1.0), (1.03, 1.0), (1.3, 1.0), (1.0, 8e-3)):
        moment = size * share * np.cross(lever, rows.campaign.wrench[:, :3])
        about = replace(rows.campaign, wrench=np.hstack([size * rows.campaign.wrench[:, :3], moment]))
        answers += [questions.ask_moment_point(robot, rows._replace(campaign=about))]
    for late, count in ((0.03, 200), (0.4, 200), (0.4, 8)):
        path = plan_rows(robot, 11, poses=6, path=count)
        log = measure(robot, path, [Effect("time_skew", None, None, {"skew_s": late})], 11, orientation=False)
        answers += [questions.ask_clock(robot, questions.stage_rows(robot, log), ())]
    shapes = questions._shape_elastics(replace(robot, gravity=None), rows, ())
    return [*answers, shapes.residual, shapes.weight]


def ask_priors(bench: Bench) -> Any:
    """The background of every column and the odds of every signature; frames that are fitted freely."""
    own = bench.fit.search.ledger
    frames = offers.registration_signatures(bench.fit.at, ("base",))
    return [background.build_prior(own, []), background.log_priors(own.signatures), [f.scale for f in frames]]


def ask_evidence(bench: Bench) -> Any:
    """The posterior of a small model with noise and background fitted, and what claims would add."""
    own, prior = bench.fit.search.ledger, bench.fit.search.prior_of(bench.fit.model.claims)
    start = evidence.start_hyper(own, len(background.CLASSES))
    found = evidence.find_posterior(own, prior, start)
    silent = replace(own, channels=tuple(replace(c, total=replace(c.total, square=1e9)) for c in own.channels))
    free = replace(prior, free=np.arange(own.p) < 2)
    loud = evidence.find_posterior(silent, prior, start, steps=3)
    quiet = replace(own, channels=tuple(replace(c, witnesses=1e-3) for c in own.channels))
    everywhere = np.full(own.p, -1)
    one = np.where(prior.background >= 0, 0, -1)
    loose = replace(prior, background=one, loose=np.array([True]), spread=prior.spread * 1e-9)
    hyper = evidence.Hyper(start.log_noise, start.log_shared, np.zeros(1))
    broken = -np.diag([1.0, 1.0, 1e-9])
    try:
        factor = cholesky.factorize(np.eye(3) + broken * (1 + 1e-12))
    except CompplanError as error:
        factor = str(error)
    return [
        found.log_evidence, found.mean, found.hyper.vector, start.vector,
        evidence.find_posterior(own, prior, start, steps=2).log_evidence,
        evidence.find_posterior(own, free, start, fit=False).mean, loud.hyper.vector,
        evidence.find_posterior(quiet, prior, start).hyper.vector,
        evidence.find_posterior(own, replace(prior, background=everywhere), start).hyper.vector,
        evidence.find_posterior(own, loose, hyper).hyper.vector, factor,
        [g.log_evidence for g in gains.find_gains(own, found, list(range(0, len(own.signatures), 5)))],
    ]  # fmt: skip


def ask_search(bench: Bench) -> Any:
    """Models of true, doubled and opposed claims, and every kind of step from them."""
    own = bench.fit.search
    places = {(*s.place, s.form): n for n, s in reversed(list(enumerate(own.ledger.signatures)))}

    def claim(name: str, joint: str | None, size: float = 1.0) -> search.Claim:
        number = next(n for place, n in places.items() if place[:2] == (name, joint))
        return search.Claim(number, size)

    true = [claim("joint_stiffness", "joint_2"), claim("backlash", "joint_4"), claim("joint_offset", "joint_5")]
    excess = [*true, claim("joint_offset", "joint_3", 0.3), claim("link_geometry", "joint_6", 3.0)]
    curves = [claim("transmission_error", "joint_2"), claim("gravity_compensator", "joint_2")]
    one, answers = bench.fresh_search(), []
    for claims in (true, excess, curves, true[:1], []):
        model, fresh = one.model(claims, one.start), bench.fresh_search()
        added = search.add_claim(fresh, model)
        answers += [model.score, model.posterior.hyper.vector, added.score, added.claims, len(fresh.cache)]
        answers += [search._remove(bench.fresh_search(), model).claims, search.entangled(one, model, model.claims[-1:])]
        answers += [search.explains_enough(one, model, added)]
        large = replace(model.posterior, mean=30.0 * model.posterior.mean)
        answers += [one._coincidence(claims, large)]
        if claims:
            own_forms = search.forms_of(one, one.gains(one.model(claims[1:], one.start)), claims[0])
            for step, some in ((search._exchange, model.claims[:1]), (search._merge, model.claims)):
                fresh = bench.fresh_search()
                answers += [step(fresh, model, some).claims, len(fresh.cache), len(own_forms)]
    weak = search.Claim(claim("joint_offset", "joint_3").signature, 0.1)
    answers += [one.model([weak], one.start, fit=False, steps=1).score, search.log_prior_size(10.0)]
    answers += [search.search_models(bench.fresh_search(), most=1).claims]
    little, nothing = one.model(true[:2], one.start), one.model([], one.start)
    small = replace(one.model(true, one.start), claims=tuple(true[:2]))
    answers += [search.explains_enough(one, nothing, m) for m in (little, small, nothing)]
    return answers


def ask_whole_search(bench: Bench) -> Any:
    """The whole search, from nothing and from too much."""
    found = search.search_models(bench.fresh_search())
    return [found.score, found.claims, found.posterior.hyper.vector]


def ask_rivals(bench: Bench) -> Any:
    """What else explains each claim, large and small, and a frame."""
    own = bench.fit
    values = own.model.posterior.values(own.search.ledger.p)
    frame = next(n for n, s in enumerate(own.search.ledger.signatures) if s.name == "base_frame")
    moved = np.where(np.isin(np.arange(len(values)), own.search.ledger.columns(frame)), 1.0, values)
    asked = [(c.signature, f * values) for c in own.model.claims for f in (1.0, 0.1, 0.01, 1e-4)]
    return [
        [(r.place, r.share, r.alike) for r in ambiguity.find_rivals(own, number, given)]
        for number, given in [*asked, (frame, moved)]
    ]


def ask_explanations(bench: Bench) -> Any:
    """What a robot may be instead of each claim, small ones that rivals imitate and large ones."""
    own, found = bench.fit, []
    values = own.model.posterior.values(own.search.ledger.p)
    for claim in own.model.claims:
        others = ambiguity.find_rivals(own, claim.signature, values)
        for size in (1.0, 0.3, 0.1, 0.03, 0.01):
            nothing = state.FitState((), {}, None, bench.campaign.usable)
            told = explanations.explain_otherwise(own, nothing, size * values, {claim.signature: others})
            found.append([(other.signature.name, other.weight) for other in told])
    return found


def ask_proposals(bench: Bench) -> Any:
    """Shifts, waves and bumps in what is left: a step, two waves, a bump, on wide and narrow joints."""
    own = bench.fit
    rng, n = np.random.default_rng(4), len(own.channels[0].rows)
    rows = own.channels[0].rows
    angle = own.problem.campaign.q[rows, 1]
    answers: list[Any] = []
    spikes = np.zeros((n, 3))
    spikes[9] = 300.0
    shapes = [
        (np.arange(n) > 14)[:, None] * [6.0, 0, 0] + (np.arange(n) > 30)[:, None] * [0, 3.0, 0],
        np.sin(7.3 * angle)[:, None] * [9.0, 9.0, 9.0] + 2.0 * np.cos(3.0 * angle)[:, None],
        np.exp(-0.5 * ((angle - 0.2) / 0.05) ** 2)[:, None] * [20.0, 20.0, 20.0],
        spikes, rng.normal(0, 1.0, (n, 3)),
    ]  # fmt: skip
    for shape in shapes:
        left = [shape + rng.normal(0, 0.3, shape.shape)] + [np.zeros_like(c.residual) for c in own.channels[1:]]
        answers += [[s.place, s.tried, s.form] for s in proposals.propose_shifts(own.at, own.channels, left)]
        answers += [[s.place, s.tried, s.form] for s in proposals.propose_waves(own.at, own.channels, left, {})]
    grids = [proposals.wave_grid(spread, slides) for spread in (0.4, 3.0) for slides in (False, True)]
    return [answers, [(len(grid), grid[:3], grid[-3:]) for grid in grids]]


def ask_unmodelled(bench: Bench) -> Any:
    """Dependences that the campaign can show."""
    found = unmodelled.unmodelled_signatures(bench.fit.at)
    return [(s.place, s.form, s.scale, s.twist[::9].sum(axis=0)) for s in found]


def ask_state(bench: Bench) -> Any:
    """The step of a fit, whole and shortened, with gross errors and with columns that point backwards."""
    own = bench.fit
    far = replace(own, channels=tuple(replace(c, residual=c.residual * 9.0) for c in own.channels))
    ahead = state.advance_state(own)
    left = [channel.residual / channel.sigma for channel in far.channels]
    gone = replace(own.model.posterior, mean=-20.0 * own.model.posterior.mean)
    wild = replace(own, model=replace(own.model, posterior=gone))
    hyper = replace(own.model.posterior.hyper, log_tau=np.full(len(background.CLASSES), 2.0))
    small = evidence.find_posterior(own.search.ledger, own.search.prior_of(own.model.claims), hyper, fit=False)
    loose = replace(own, model=replace(own.model, posterior=small))
    back = replace(own.model.posterior, mean=-np.abs(own.model.posterior.mean))
    _, fixed = state.bend_forwards(own.search.ledger, own.search.prior, back)
    return [
        ahead.values, state.advance_state(loose).values,
        descent.square_left(far.channels, left, own.model.posterior.hyper),
        descent.descend(wild, state.advance_state(wild)), fixed.mean,
    ]  # fmt: skip
