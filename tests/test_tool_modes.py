"""How the tip of a tool answers: a beam on an arm, modes fitted to measured responses, and what is proposed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from compplan.errors import InputError
from compplan.plan.frequency_response import fit_responses, read_response
from compplan.plan.stable_cut import ACCEPTED, propose_cut
from compplan.plan.tool_modes import ToolModes, model_beam, read_tool_modes
from compplan.process.stability import CutDynamics, Modes, Spread, find_odds
from compplan.process.tool_beam import SOLIDS, ToolBeam, ToolBeamTable

SLENDER = ToolBeam(((0.1, 0.01, "steel"),), 0.02)


def test_a_slender_cutter_bends_and_rings_as_a_cantilever() -> None:
    young, _, density = SOLIDS["steel"]
    inertia, area = np.pi * 0.01**4 / 64, np.pi * 0.01**2 / 4
    soft = 0.1**3 / (3 * young * inertia)
    assert SLENDER.compliance(np.zeros(1), np.zeros(1))[0, 0] == pytest.approx(soft, rel=0.01)
    at, load = np.array([0.03]), np.array([0.0])
    away = (0.07**2 * (3 * 0.1 - 0.07)) / (6 * young * inertia)
    assert SLENDER.compliance(at, load)[0, 0] == pytest.approx(away, rel=0.01)
    assert SLENDER.compliance(load, at)[0, 0] == pytest.approx(SLENDER.compliance(at, load)[0, 0])
    first = 1.8751**2 * np.sqrt(young * inertia / (density * area * 0.1**4))
    assert SLENDER.modes.omega[0] == pytest.approx(first, rel=0.01)
    whole = ((SLENDER.modes.tip / SLENDER.modes.omega) ** 2).sum()
    assert whole == pytest.approx(soft, rel=0.02)
    assert SLENDER.modes.pull[0] ** 2 == pytest.approx(0.613 * density * area * 0.1, rel=0.01)


def test_a_short_thick_cutter_gives_by_shear_too_and_its_holder_adds() -> None:
    short = ToolBeamTable(stickout_mm=20.0).build(0.02, 0.02)
    young, poisson, _ = SOLIDS["carbide"]
    inertia, area = np.pi * 0.016**4 / 64, np.pi * 0.016**2 / 4
    bent = 0.02**3 / (3 * young * inertia)
    shear = 0.02 * 2 * (1 + poisson) / (0.9 * young * area)
    assert short.compliance(np.zeros(1), np.zeros(1))[0, 0] == pytest.approx(bent + shear, rel=0.01)
    held = ToolBeamTable(stickout_mm=20.0, holder_length_mm=60.0, holder_diameter_mm=30.0).build(0.02, 0.02)
    assert held.compliance(np.zeros(1), np.zeros(1))[0, 0] > 1.2 * (bent + shear)
    assert held.modes.omega[0] < short.modes.omega[0]


def test_a_beam_on_one_springy_mass_rings_as_both_built_in_one() -> None:
    """The mass as one more node below the clamp, against arm mode and clamped modes that drag each other."""
    _, stiffness, mass = SLENDER._built
    n, heavy, spring = len(mass), 0.4, 4e5
    whole, weights = np.zeros((n + 1, n + 1)), np.diag(np.append(mass, heavy))
    rigid = np.zeros(n)
    rigid[::2] = 1.0  # relative to the clamp: what moves with it does not strain
    change = np.eye(n + 1)
    change[:n, n] = -rigid
    whole[:n, :n] = stiffness
    whole = change.T @ whole @ change
    whole[n, n] += spring
    square, ways = eigh(whole, weights, subset_by_index=[0, 2])
    together = heavy + mass[::2].sum()
    arm = Modes(np.array([np.sqrt(spring / together)]), np.array([[1.0], [0.0], [0.0]]) / np.sqrt(together), 0.03)
    found = model_beam(SLENDER, 3).join(arm, np.eye(3))
    along = np.abs(found.shape[0]) > 1e-9
    assert found.omega[along][:3] == pytest.approx(np.sqrt(square), rel=2e-3)
    assert np.abs(found.shape[0, along][:3]) == pytest.approx(np.abs(ways[0]), rel=0.02)


TRUTH = Modes(2 * np.pi * np.array([420.0, 640.0, 1900.0]), np.array([[3.0, 2.0, 4.0]]), np.array([0.03, 0.02, 0.015]))


def answer(frequency: np.ndarray) -> np.ndarray:
    w = 2 * np.pi * frequency[:, None]
    peaks = TRUTH.shape[0] ** 2 / (TRUTH.omega**2 - w**2 + 2j * TRUTH.damping * TRUTH.omega * w)
    return peaks.sum(axis=1) + 2e-8


def write_columns(file: Path, response: np.ndarray, frequency: np.ndarray) -> None:
    rows = np.column_stack([frequency, 1e6 * response.real, 1e6 * response.imag])
    np.savetxt(file, rows, delimiter=",", header="frequency_Hz,real_um_N,imag_um_N", comments="")


def write_universal(file: Path, response: np.ndarray, frequency: np.ndarray) -> None:
    """Acceleration by force, evenly spaced, single precision, as analysers write it."""
    rate, step = -((2 * np.pi * frequency) ** 2) * response, frequency[1] - frequency[0]
    numbers = [f"{value:13.5E}" for pair in zip(rate.real, rate.imag, strict=True) for value in pair]
    body = ["".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    head = ["    -1", "    58", "tip", "NONE", "01-Jan-26", "NONE", "NONE",
            "    4         0    0         0 NONE               1   1 NONE               1   1",
            f"         5{len(frequency):10d}         1{frequency[0]:13.5E}{step:13.5E}  0.00000E+00",
            "        18    0    0    0 NONE                 Hz", "        12    0    0    0 NONE                 m/s2",
            "        13    0    0    0 NONE                 N",
            "         0    0    0    0 NONE                 NONE"]  # fmt: skip
    file.write_text("\n".join([*head, *body, "    -1"]) + "\n", encoding="ascii")


@pytest.mark.parametrize(("name", "write"), [("frf.csv", write_columns), ("frf.unv", write_universal)])
def test_modes_come_back_from_a_noisy_response(name: str, write, tmp_path) -> None:
    frequency = np.arange(20.0, 3000.0, 4.0)
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(2, len(frequency))) * 0.01 * np.abs(answer(frequency)).max()
    write(tmp_path / name, answer(frequency) + noise[0] + 1j * noise[1], frequency)
    found, told = fit_responses({"y": tmp_path / name})
    assert found.omega == pytest.approx(TRUTH.omega, rel=0.005)
    assert found.damping == pytest.approx(TRUTH.damping, rel=0.1)
    assert found.shape[1] == pytest.approx(TRUTH.shape[0], rel=0.05)
    assert not found.shape[[0, 2]].any() and "y: 4" in told


@pytest.mark.parametrize(("turn", "message"), [
    (lambda response: response.conj(), "imaginary part is above 0"),
    (lambda response: 1e6 * response, r"greatest compliance is .* check the unit"),
    (lambda response: -response.conj(), "unexplained"),
])  # fmt: skip
def test_responses_that_are_no_drive_point_are_refused(turn, message: str, tmp_path) -> None:
    frequency = np.arange(20.0, 3000.0, 10.0)
    write_columns(tmp_path / "frf.csv", turn(answer(frequency)), frequency)
    with pytest.raises(InputError, match=message):
        fit_responses({"x": tmp_path / "frf.csv"})


def test_a_universal_file_without_one_response_is_refused(tmp_path) -> None:
    frequency = np.arange(20.0, 900.0, 10.0)
    write_universal(tmp_path / "frf.uff", answer(frequency), frequency)
    text = (tmp_path / "frf.uff").read_text(encoding="ascii")
    (tmp_path / "two.uff").write_text(text + text, encoding="ascii")
    (tmp_path / "real.uff").write_text(text.replace("         5", "         2", 1), encoding="ascii")
    (tmp_path / "short.uff").write_text(text.replace("        88", "        90", 1), encoding="ascii")
    expected = {"two.uff": "has 2 data sets 58", "real.uff": "data type 2", "short.uff": "are announced"}
    for name, message in expected.items():
        with pytest.raises(InputError, match=message):
            read_response(tmp_path / name)


def test_modes_measured_in_two_postures_stand_where_they_are_near(tmp_path) -> None:
    rows = "frequency_Hz,damping,mass_kg,x,y,z,s_mm\n600,.03,.2,1,0,0,0\n500,.03,.2,1,0,0,400\n700,.03,.2,0,1,0,400\n"
    (tmp_path / "modes.csv").write_text(rows, encoding="utf-8")
    modes = read_tool_modes(tmp_path / "modes.csv")
    assert modes.at(0.15).omega / (2 * np.pi) == pytest.approx([600.0])
    assert modes.at(0.25).omega / (2 * np.pi) == pytest.approx([500.0, 700.0])


def test_proposed_depth_and_speed_keep_the_accepted_probability() -> None:
    omega, stiffness = 2 * np.pi * 600.0, 5e6
    gain = np.zeros((48, 3, 3))
    gain[:, 1, 1] = -3.0 * 2.0 * stiffness * 0.04 * 1.04
    modes = Modes(np.array([omega]), np.array([[0.0], [omega / np.sqrt(stiffness)], [0.0]]), 0.04)
    cut = CutDynamics(gain, 1, 2 * np.pi / omega / 0.75, modes)
    spread = Spread(0.02, 0.1, 0.05)
    assert find_odds(cut, spread) > ACCEPTED
    speeds = np.linspace(0.8, 1.6, 17)
    limits = np.array([float("inf") if find_odds(cut.scaled(1.0, each), spread) < 0.05 else 1e-3 for each in speeds])
    proposal = propose_cut([cut], spread, 450.0, 2e-3, 450.0 * speeds, limits)
    assert proposal.share is not None and proposal.share < 1.0
    assert find_odds(cut.scaled(proposal.share), spread) <= ACCEPTED
    assert proposal.speed is not None
    assert find_odds(cut.scaled(1.0, proposal.speed / 450.0), spread) <= ACCEPTED
    assert f"{1e3 * 2e-3 * proposal.share:.3g} mm" in proposal.sentence and "1/min does" in proposal.sentence


def test_tool_modes_of_none_are_the_beams_along_both_ways() -> None:
    both = model_beam(SLENDER)
    assert isinstance(both, ToolModes) and both.shape.shape == (3, 2) and not both.shape[2].any()
