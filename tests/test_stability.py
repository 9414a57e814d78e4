"""Chatter: limits in closed form, and a simulation of the delay equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from compplan.errors import InputError
from compplan.plan.tool_modes import read_tool_modes
from compplan.process.stability import (
    CutDynamics,
    Modes,
    Spread,
    count_turns,
    draw_modes,
    find_coupling_limit,
    find_multiplier,
    find_odds,
)
from compplan.robot import load_robot
from compplan.simulation.judge import tip_compliance
from compplan.simulation.vibration import build_dynamics, find_modes, natural_frequencies

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


def test_odds_of_chatter_go_from_none_to_all_across_the_limit() -> None:
    spread = Spread(0.05, 0.2, 0.1)
    limit = brentq(lambda share: find_multiplier(turning(share, 0.85)) - 1.0, 0.5, 20.0)
    odds = [find_odds(turning(share * limit, 0.85), spread) for share in (0.3, 1.0, 4.0)]
    assert odds[0] < 0.02 and 0.2 < odds[1] < 0.8 and odds[2] > 0.98


def test_a_mode_drawn_heavier_is_slower_and_as_stiff_as_before() -> None:
    modes = turning(1.0, 0.85).modes
    drawn = draw_modes(modes, Spread(0.05, 0.2, 0.1), np.array([-2.0, 0.0, 1.0, 0.0, 0.0]))
    assert drawn.omega == pytest.approx(modes.omega * np.exp(-0.1))
    assert (drawn.shape / drawn.omega) == pytest.approx(modes.shape / modes.omega)
    assert drawn.damping == pytest.approx(DAMPING * np.exp(0.2))


TABLE = "frequency_Hz,damping,mass_kg,x,y,z\n900,0.02,0.1,1,0,0\n600,0.03,0.2,0,2,0\n"


def test_measured_modes_stand_among_those_of_the_arm_with_their_own_damping(tmp_path) -> None:
    (tmp_path / "modes.csv").write_text(TABLE, encoding="utf-8")
    arm = Modes(2 * np.pi * np.array([20.0]), np.ones((3, 1)), 0.04)
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    both = read_tool_modes(tmp_path / "modes.csv").join(arm, turned)
    assert both.omega / (2 * np.pi) == pytest.approx([20.0, 600.0, 900.0])
    assert np.asarray(both.damping) == pytest.approx([0.04, 0.03, 0.02])
    assert both.measured is not None and both.measured.tolist() == [False, True, True]
    assert both.shape[:, 1] == pytest.approx([1.0 / np.sqrt(0.2), 0.0, 0.0])  # y of the tool
    assert both.shape[:, 2] == pytest.approx([0.0, -1.0 / np.sqrt(0.1), 0.0])


def test_a_residue_is_one_by_the_modal_mass(tmp_path) -> None:
    (tmp_path / "modes.csv").write_text(TABLE, encoding="utf-8")
    other = TABLE.replace("mass_kg", "residue_1_kg").replace("0.1,1", "10,1").replace("0.2,0", "5,0")
    (tmp_path / "other.csv").write_text(other, encoding="utf-8")
    shapes = [read_tool_modes(tmp_path / name).shape for name in ("modes.csv", "other.csv")]
    assert shapes[0] == pytest.approx(shapes[1])


@pytest.mark.parametrize(("edit", "message"), [
    (("0.03", "3"), r"modes.csv:3: damping is 3, 0.0001 to 0.5 is allowed"),
    (("900", "0.9"), r"modes.csv:2: frequency_Hz is 0.9, 1 to 20000 is allowed"),
    (("0.1,1", "-0.1,1"), r"modes.csv:2: mass_kg is -0.1, above 0 is expected"),
    (("mass_kg,", "z_mm,"), "z_mm"),
    (("0,2,0", "0,0,0"), r"modes.csv:3: length of the direction x, y, z is 0"),
])  # fmt: skip
def test_modes_that_cannot_be_true_are_refused(tmp_path, edit: tuple[str, str], message: str) -> None:
    (tmp_path / "modes.csv").write_text(TABLE.replace(*edit), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_tool_modes(tmp_path / "modes.csv")


def test_an_independent_simulation_in_time_calls_drawn_cuts_alike(monkeypatch) -> None:
    from benchmarks import stability as bench

    monkeypatch.setattr(bench, "PERIODS", 60)
    monkeypatch.setattr(bench, "STEPS", 48)

    cases = bench.draw_cases(24, 5)
    chatters = np.array([find_multiplier(bench.build_cut(cases, i)) > 1.0 for i in range(24)])
    growth = bench.simulate(cases)
    assert 4 <= (growth > 1.0).sum() <= 20
    assert ((growth > 1.0) == chatters).mean() >= 0.9
