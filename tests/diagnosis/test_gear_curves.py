"""Curves over a joint's angle: a gear error has a period and may have overtones; a curve without one names no cause."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import diagnose_campaign
from compplan.diagnosis.evidence.proposals import find_series, wave_grid
from compplan.diagnosis.results.verdict import SHAPELESS, Finding, Structure, is_lawful, leave_shapeless
from compplan.diagnosis.search import fit
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.validation import unmodelled_causes as doubt
from compplan.diagnosis.validation.gears import is_law, repeats
from compplan.effects import Effect
from compplan.robot import Spring, load_robot

POSES = 45


def saw(angle: np.ndarray, cycles: float) -> np.ndarray:
    """A saw tooth of so many teeth a turn, which is a sine with overtones of a half, a third, a quarter, ..."""
    return np.mod(cycles * angle / (2.0 * np.pi), 1.0) - 0.5


def form(label: str, *, lawful: bool = True) -> Any:
    place = ("transmission_error", "joint_2", None)
    return SimpleNamespace(form=label, lawful=lawful, place=place, fixed={})


def weighed(forms: list[Any], evidence: list[float]) -> tuple[Any, Claim]:
    """The first of some forms claimed, and what each of them would add to the evidence in its place."""
    gains = [SimpleNamespace(signature=k, log_evidence=value - 5.0) for k, value in enumerate(evidence)]
    claim = Claim(0, 1.0)
    search = SimpleNamespace(
        ledger=SimpleNamespace(signatures=forms), log_prior=np.full(len(forms), -5.0), gains=lambda model: gains,
        without=lambda claims, *gone: [claim for claim in claims if claim not in gone],
        model=lambda *claims, **options: None,
    )  # fmt: skip
    return SimpleNamespace(
        search=search, model=SimpleNamespace(claims=(claim,), posterior=SimpleNamespace(hyper=None))
    ), claim


@pytest.mark.parametrize(("cycles", "seed"), [(3.0, 0), (7.0, 1), (12.0, 2), (31.0, 3)])
def test_the_period_of_a_saw_tooth_is_found_among_all_periods(cycles: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-2.0, 2.0, POSES)
    lever = rng.uniform(0.5, 1.5, POSES)  # motion of the target per unit of the joint, noise units
    left = 6.0 * lever * saw(angle, cycles) + rng.normal(size=POSES)
    found = find_series(angle, lever * left, lever**2, np.concatenate(wave_grid(float(np.ptp(angle)), False)), False)
    # periods closer than half a wave's width, a turn over 4 rad, can hardly be told apart
    assert found == pytest.approx(cycles, abs=0.5 * 2.0 * np.pi / 4.0)


def test_a_curve_names_a_gear_error_only_where_one_wave_explains_most_of_what_it_does() -> None:
    free, wave, saw_tooth = form("waves 1 2 3 4", lawful=False), form("waves 2"), form("series 2")
    rigid: Any = SimpleNamespace(search=SimpleNamespace(ledger=SimpleNamespace(signatures=())))
    assert not is_lawful(rigid, *weighed([free, wave, saw_tooth], [100.0, 60.0, 70.0]))
    assert is_lawful(rigid, *weighed([free, wave, saw_tooth], [100.0, 60.0, 90.0]))
    assert is_lawful(rigid, *weighed([saw_tooth, wave], [100.0, 96.0]))


@pytest.mark.parametrize(("bends", "turns", "law"), [(True, 0.4, False), (True, 1.2, True), (False, 0.4, True)])
def test_an_arch_is_no_gear_error_where_the_links_weight_may_have_bent_the_arm(
    bends: bool, turns: float, law: bool
) -> None:
    q = np.linspace(0.0, 2.0 * np.pi * turns, 20)[:, None]
    offered = [SimpleNamespace(name="gravity_sag", form="joints")] if bends else []
    fit: Any = SimpleNamespace(
        search=SimpleNamespace(ledger=SimpleNamespace(signatures=offered)),
        at=SimpleNamespace(robot=SimpleNamespace(joint_names=("joint_1",))),
        problem=SimpleNamespace(campaign=SimpleNamespace(q=q)),
    )
    wave: Any = SimpleNamespace(lawful=True, joint="joint_1", fixed={"cycles_per_turn": [1.0]})
    assert is_law(fit, wave) == law


def test_a_curve_without_a_law_is_said_to_follow_its_joint() -> None:
    structure = Structure(0.0, 0.0, 1e-3, 0.0, 1e-3, False, 1e-4)
    findings = [
        Finding(Effect("transmission_error", f"joint_{k}", None, {}), stated, 1e-3, 50.0, (), 1.0, k)
        for k, stated in enumerate((SHAPELESS, 0.9))
    ]
    left = leave_shapeless(structure, findings)
    assert left.left and [(d.effect.joint, d.effect.axis) for d in left.dependences] == [("joint_0", "its own angle")]
    assert leave_shapeless(structure, findings[1:]) is structure


def test_a_wave_of_a_gear_has_one_size_and_phase_in_both_halves_of_the_poses() -> None:
    """Worse than no wave is what one half predicts of the other where their product is less than half of a square."""
    wave = np.array([0, 1])
    same = np.array([[1.0, 0.0], [0.9, 0.2], [1.0, 0.1], [0.8, -0.1]])
    assert repeats(same, wave)
    turned = same.copy()
    turned[1::2] = turned[1::2, ::-1] * [1.0, -1.0]
    assert not repeats(turned, wave)
    smaller = same.copy()
    smaller[1::2] *= 0.4
    assert not repeats(smaller, wave)
    # a curve of which each half fits something else is no gear, whatever each half gains
    assert not repeats(np.random.default_rng(2).normal(size=(8, 2)), wave)


@pytest.mark.slow
def test_a_gear_of_several_waves_is_named(tmp_path: Path) -> None:
    robot = write_small_robot(tmp_path / "small")
    gear = {"cycles_per_turn": [6.0, 11.0, 17.0], "sine_rad": [2e-4, 2e-4, 2e-4], "cosine_rad": [1e-4, -2e-4, 1e-4]}
    cause = Effect("transmission_error", "joint_2", None, gear)
    found = diagnose_campaign(robot, measure(robot, plan_rows(robot, 61, poses=80, loads=0), [cause], 61))
    assert cause.place[:2] in [f.effect.place[:2] for f in found.verdict.findings]


@pytest.mark.parametrize(("ahead", "claimed"), [(0.5, "joint_stiffness"), (6.0, "stiffness_nonlinearity")])
def test_a_bent_law_of_deflection_has_to_show(
    ahead: float, claimed: str, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    names = ("stiffness_nonlinearity", "joint_stiffness", "transmission_error")
    signatures = [SimpleNamespace(place=(name, "joint_2", None), joint="joint_2") for name in names]
    # the wave explains as much and is no special case of a law of deflection
    gains = [SimpleNamespace(signature=k, log_evidence=60.0 + ahead * (k == 0), size=1.0) for k in range(3)]

    def model(claims: Any, *rest: Any, **options: Any) -> Any:
        return SimpleNamespace(claims=tuple(claims), score=0.0, posterior=SimpleNamespace(hyper=None))

    search: Any = SimpleNamespace(
        ledger=SimpleNamespace(signatures=signatures),
        model=model,
        gains=lambda base: gains,
        without=lambda claims, *gone: [claim for claim in claims if claim not in gone],
    )
    monkeypatch.setattr(doubt, "representable_forms", lambda ledger, special: {0} if special == 1 else set())
    told = doubt._simplify(search, model([Claim(0, 1.0)]))
    assert [names[claim.signature] for claim in told.claims] == [claimed]


def test_the_law_of_a_joint_is_bent_only_where_the_folder_has_one(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = [
        SimpleNamespace(name=name, joint=joint)
        for name in ("stiffness_nonlinearity", "joint_stiffness")
        for joint in ("joint_1", "joint_2")
    ]
    monkeypatch.setattr(fit, "offered_signatures", lambda at, register, excluded: offered)
    monkeypatch.setattr(fit, "propose_again", lambda at, proposals, wanted: [])
    springs = (Spring("joint_2", "own", 1e-6), Spring("joint_1", "ry", 1e-6), Spring("joint_1", "own", 0.0))
    robot = replace(load_robot("kuka_kr240"), springs=springs)
    problem: Any = SimpleNamespace(robot=robot, register=(), excluded=())
    left = fit._offer_all(problem, SimpleNamespace(claims=()), None, [])  # type: ignore[arg-type]
    assert [(s.name, s.joint) for s in left] == [
        ("stiffness_nonlinearity", "joint_2"), ("joint_stiffness", "joint_1"), ("joint_stiffness", "joint_2"),
    ]  # fmt: skip
