"""Fits that settle: noise and background to their end, claims that need each other, steps that lead all the way."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis.data.noise import OUTLYING
from compplan.diagnosis.evidence.evidence import Hyper, Prior, find_posterior
from compplan.diagnosis.evidence.normal_equations import ChannelProducts, NormalEquations, Products
from compplan.diagnosis.search.fit import fit_effects, is_rigid
from compplan.diagnosis.search.polish import descend
from compplan.diagnosis.search.search import Claim, Search
from compplan.diagnosis.search.state import Fit, Problem, advance_state
from compplan.diagnosis.validation.calibrated_probability import rate_likenesses
from compplan.effects import Effect, gravity_sag
from compplan.measurement.campaign import Campaign


def make_ledger(rows: int, columns: int, size: float) -> NormalEquations:
    rng = np.random.default_rng(11)
    design = rng.normal(size=(rows, columns))
    observed = design @ (size * rng.normal(size=columns)) + rng.normal(size=rows)
    total = Products(rows, design.T @ design, design.T @ observed, float(observed @ observed))
    names = tuple(f"c{k}" for k in range(columns))
    channel = ChannelProducts("position", total, {1: total}, 30.0)
    return NormalEquations((), (), names, np.ones(columns), (channel,), (design[:, None],), (observed[:, None],), ())


@pytest.mark.parametrize("size", [3.0, 12.0])
def test_a_fit_of_noise_and_background_that_gains_thousands_goes_to_its_end(size: float) -> None:
    ledger = make_ledger(300, 12, size)
    prior = Prior(np.zeros(12, int), np.ones(12), np.zeros(12, bool), np.zeros(12))
    start = Hyper(np.zeros(1), np.full(1, -1.5), np.full(1, -1.5))
    begun = find_posterior(ledger, prior, start, fit=False)
    found = find_posterior(ledger, prior, start)
    best = max(
        find_posterior(ledger, prior, replace(start, log_tau=np.array([tau])), steps=400).log_evidence
        for tau in np.linspace(-1.0, 3.0, 9)
    )
    assert found.log_evidence - begun.log_evidence > 300.0
    assert found.log_evidence > best - 0.1


def test_on_a_rigid_robot_nothing_is_claimed_to_bend_what_no_claim_makes_soft() -> None:
    forms = [("gravity_sag", gravity_sag.JOINTS), ("payload", ""), ("joint_offset", "")]
    signatures = tuple(SimpleNamespace(name=name, form=form) for name, form in forms)
    sag, payload, zero = claims = [Claim(k, 1.0) for k in range(3)]
    search = Search(SimpleNamespace(signatures=signatures), None, None, [], None, rigid=True)  # type: ignore[arg-type]
    assert search.without(claims) == claims
    assert search.without(claims, sag) == [zero]
    assert search.without(claims, payload) == [sag, zero]
    assert replace(search, rigid=False).without(claims, sag) == [payload, zero]


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    robot = write_small_robot(tmp_path_factory.mktemp("robots") / "small", joints=3)
    there = [Effect("joint_offset", "joint_2", None, {"offset_rad": 1e-3})]
    return fit_effects(Problem(robot, measure(robot, plan_rows(robot, 5, poses=16, loads=0), there, 5)), None)


def test_what_is_no_longer_claimed_fades_as_a_step_is_shortened(fit: Fit) -> None:
    ledger, claimed = fit.search.ledger, set(fit.model.signatures)
    number = next(n for n, s in enumerate(ledger.signatures) if s.name == "joint_offset" and n not in claimed)
    old, column = ledger.signatures[number], ledger.columns(number)[0]
    name = ledger.names[column]
    # so large that it is no small error beside the claims
    before = replace(fit.state, claims=(((*old.place, old.form), 1.0),), values={**fit.state.values, name: 1e-2})
    went = replace(fit, state=before)
    target = fit.model.posterior.values(ledger.p)[column] * ledger.scale[column]
    assert advance_state(went, 0.25).values[name] == pytest.approx(0.75e-2 + 0.25 * target)
    assert advance_state(went).values.get(name, 0.0) == pytest.approx(target, abs=1e-6)


def test_fits_that_leave_out_other_rows_are_scored_alike(fit: Fit) -> None:
    """A row that is no longer used costs what it would cost at the least distance that is left out."""
    step = descend(fit, advance_state(fit))
    use = fit.state.use.copy()
    use[3] = False
    assert step is not None
    found = descend(replace(fit, state=replace(fit.state, use=use)), advance_state(fit))
    assert found is not None
    assert found[1] == pytest.approx(step[1] - 0.5 * OUTLYING**2, abs=3.0)


def test_a_robot_is_rigid_where_neither_springs_nor_loads_bend_it(fit: Fit) -> None:
    problem = fit.problem
    rigid = replace(problem, robot=replace(problem.robot, springs=(), link_elasticities=()))
    assert not is_rigid(problem)
    assert is_rigid(rigid)
    assert not is_rigid(replace(rigid, fixed=(Effect("joint_stiffness", "joint_1", None, {}),)))
    wrench = np.zeros_like(problem.campaign.wrench)
    wrench[::2, 2] = -300.0
    assert not is_rigid(replace(rigid, campaign=replace(problem.campaign, wrench=wrench)))


def test_what_is_left_along_a_claim_in_its_turns_counts_against_it_as_in_its_place() -> None:
    rng, n = np.random.default_rng(6), 40
    motion = [rng.normal(size=(n, 3, 1)) * 10.0 for _ in range(2)]
    left = [0.1 * rng.normal(size=(n, 3)), 0.5 * motion[1][..., 0]]
    ledger = SimpleNamespace(
        p=1, designs=motion, source=[SimpleNamespace(name=name, rows=np.arange(n)) for name in ("position", "other")],
        columns=lambda _: np.array([0]), left=lambda _: left,
    )  # fmt: skip
    posterior = SimpleNamespace(values=lambda _: np.ones(1))
    claim = Claim(0, 1.0)
    model = SimpleNamespace(posterior=posterior, claims=(claim,))
    doubt = SimpleNamespace(search=SimpleNamespace(ledger=ledger), members=(), model=model)
    run, still = np.array(["static_1"] * n), np.zeros((n, 6))
    campaign = Campaign(run=run, q=np.arange(n)[:, None] * np.ones(6), wrench=still, position=still[:, :3])
    fit = SimpleNamespace(problem=SimpleNamespace(campaign=campaign))
    assert rate_likenesses(fit, doubt)[claim] == pytest.approx(0.5)  # type: ignore[arg-type]
    left[1] *= 0.0
    assert rate_likenesses(fit, doubt)[claim] == 0.0  # type: ignore[arg-type]
