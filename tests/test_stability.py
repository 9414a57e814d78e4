"""Chatter: limits in closed form, and a simulation of the delay equation."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.cell.judge import tip_compliance
from compplan.cell.vibration import build_dynamics, find_modes, natural_frequencies
from compplan.path.forces.stability import CutDynamics, Modes, count_turns, find_coupling_limit, find_multiplier
from compplan.robot import load_robot

OMEGA, STIFFNESS, DAMPING = 2 * np.pi * 30.0, 1e6, 0.04


def turning(share: float, per_period: float) -> CutDynamics:
    """One mode along y, cut along y at every angle: 1 is the depth 2 k z (1 + z) / K that no speed makes unstable."""
    gain = np.zeros((48, 3, 3))
    gain[:, 1, 1] = -share * 2.0 * STIFFNESS * DAMPING * (1.0 + DAMPING)
    shape = np.array([[0.0], [OMEGA / np.sqrt(STIFFNESS)], [0.0]])
    return CutDynamics(gain, 1, 2 * np.pi / OMEGA / per_period, Modes(np.array([OMEGA]), shape, DAMPING))


@pytest.mark.parametrize("share", [0.96, 1.04])
def test_the_unconditional_limit_of_one_mode_is_two_k_zeta_one_plus_zeta(share) -> None:
    speeds = np.linspace(0.6, 1.6, 41)
    zero = [count_turns(turning(share, speed), np.ones(1))[0] > 0 for speed in speeds]
    semi = [find_multiplier(turning(share, speed)) > 1.0 for speed in speeds]
    assert any(zero) == any(semi) == (share > 1.0)


def test_two_modes_couple_where_their_frequencies_meet() -> None:
    omega = 2 * np.pi * np.array([20.0, 22.0])
    gain = np.zeros((48, 3, 3))
    gain[:, 0, 1], gain[:, 1, 0] = 5e5, -3e5
    modes = Modes(omega, np.array([[0.1, 0.0], [0.0, 0.1], [0.0, 0.0]]), 1e-7)
    found = find_coupling_limit(CutDynamics(gain, 1, 0.01, modes), np.linspace(0.1, 3.0, 2901))
    limit = 0.5 * (omega[1] ** 2 - omega[0] ** 2) / (0.01 * np.sqrt(5e5 * 3e5))
    assert found == pytest.approx(limit, abs=0.002)


def test_modes_have_the_frequencies_of_the_arm_and_together_its_compliance() -> None:
    robot = load_robot("staubli_tx200")
    dynamics = build_dynamics(robot)
    q = np.radians([[10.0, 40.0, 80.0, 20.0, 50.0, 0.0]])
    modes, = find_modes(dynamics, q, 99)
    omega, shape = modes.omega, modes.tip
    assert omega[:2] / (2 * np.pi) == pytest.approx(natural_frequencies(dynamics, q)[0], rel=1e-9)
    assert (shape / omega**2) @ shape.T == pytest.approx(tip_compliance(dynamics.judge, q)[0], rel=1e-3, abs=1e-9)


def test_an_independent_simulation_in_time_calls_drawn_cuts_alike(monkeypatch) -> None:
    from benchmarks import stability as bench

    monkeypatch.setattr(bench, "PERIODS", 60)
    monkeypatch.setattr(bench, "STEPS", 48)

    cases = bench.draw_cases(24, 5)
    chatters = np.array([find_multiplier(bench.build_cut(cases, i)) > 1.0 for i in range(24)])
    growth = bench.simulate(cases)
    assert 4 <= (growth > 1.0).sum() <= 20
    assert ((growth > 1.0) == chatters).mean() >= 0.9
