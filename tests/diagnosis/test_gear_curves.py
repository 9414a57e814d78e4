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
from compplan.diagnosis.search import fit
from compplan.effects import Effect
from compplan.robot import Spring, load_robot

POSES = 45


def saw(angle: np.ndarray, cycles: float) -> np.ndarray:
    """A saw tooth of so many teeth a turn, which is a sine with overtones of a half, a third, a quarter, ..."""
    return np.mod(cycles * angle / (2.0 * np.pi), 1.0) - 0.5


@pytest.mark.parametrize(("cycles", "seed"), [(3.0, 0), (7.0, 1), (12.0, 2), (31.0, 3)])
def test_the_period_of_a_saw_tooth_is_found_among_all_periods(cycles: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-2.0, 2.0, POSES)
    lever = rng.uniform(0.5, 1.5, POSES)  # motion of the target per unit of the joint, noise units
    left = 6.0 * lever * saw(angle, cycles) + rng.normal(size=POSES)
    found = find_series(angle, lever * left, lever**2, np.concatenate(wave_grid(float(np.ptp(angle)), False)), False)
    # periods closer than half a wave's width, a turn over 4 rad, can hardly be told apart
    assert found == pytest.approx(cycles, abs=0.5 * 2.0 * np.pi / 4.0)


@pytest.mark.slow
def test_a_gear_of_several_waves_is_named(tmp_path: Path) -> None:
    robot = write_small_robot(tmp_path / "small")
    gear = {"cycles_per_turn": [6.0, 11.0, 17.0], "sine_rad": [2e-4, 2e-4, 2e-4], "cosine_rad": [1e-4, -2e-4, 1e-4]}
    cause = Effect("transmission_error", "joint_2", None, gear)
    found = diagnose_campaign(robot, measure(robot, plan_rows(robot, 61, poses=80, loads=0), [cause], 61))
    assert cause.place[:2] in [f.effect.place[:2] for f in found.verdict.findings]


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
