"""The band after further measurements, and the band of the uncorrected program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.band import ErrorBand, estimate_band
from compplan.uncertainty.ladder import climb_ladder, condition
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model

Z = 1.959964


def predict(tmp_path: Path, tolerance: float) -> ErrorBand:
    """A one-joint arm: dz = dC F L^2 with C = 1e-6, F = 100 N, L = 1.5 m; its width is 30 %, that of the force 10 %."""
    width = Unknown("joint_stiffness", "joint_1", None, ("compliance_change_rad_per_Nm",), np.array([3e-7]))
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.zeros(1))
    known = Uncertainty("measured", "made up", (width, tool), np.eye(2), repeatability=0.0)
    robot = replace(one_joint_arm(tmp_path, length=1.5, compliance=1e-6), uncertainty=known)
    scene = build_path_model(robot, np.zeros((3, 1)), np.tile([0.0, 0, 100.0, 0, 0, 0], (3, 1)))
    off = np.tile([0.0, 0.0, 2.25e-4], (3, 1))
    level = ForceSpread(0.1, 0.0, 0.0, "made up")
    return estimate_band(robot, scene, np.ones(3, bool), level, uncorrected=off, tolerance=tolerance)


def test_rungs_and_the_uncorrected_band_have_closed_forms(tmp_path: Path) -> None:
    band = predict(tmp_path, 5e-5)
    unit = Z * 1e-6 * 100.0 * 1.5**2
    rungs = {rung.step: rung for rung in band.ladder}
    assert list(rungs) == ["now", "force_log", "poses", "first_part"]
    assert rungs["now"].band == band.whole
    assert rungs["force_log"].alone == pytest.approx(band.whole * np.hypot(0.3, 0.02) / np.hypot(0.3, 0.1), rel=0.01)
    left = 3e-5 / np.sqrt(3 + (3e-5 / 6.75e-5) ** 2)  # three rows of 30 um tell a deviation of 67.5 um
    expected = band.whole * np.hypot(Z * left, 0.1 * unit) / (unit * np.hypot(0.3, 0.1))
    assert rungs["poses"].alone == pytest.approx(expected, rel=0.02)
    assert rungs["first_part"].band < rungs["poses"].band < rungs["force_log"].band < rungs["now"].band
    assert band.before is not None
    # one side of a normal of deviation 71.2 um about 225 um
    assert band.before[0] == pytest.approx(2.25e-4 + 1.6449 * unit / Z * np.hypot(0.3, 0.1), rel=0.02)


def test_the_cheapest_set_that_keeps_is_named_and_none_where_nothing_is_needed(tmp_path: Path) -> None:
    assert predict(tmp_path, 1.0).cheapest == ()
    band = predict(tmp_path, 1e-4)
    assert band.cheapest == ("poses",)
    assert predict(tmp_path, 1e-7).cheapest == ()


def test_a_cheap_pair_goes_before_a_dear_single() -> None:
    left = {(): 9.0, ("force_log",): 5.0, ("poses",): 5.0, ("first_part",): 0.5}
    rungs, cheapest = climb_ladder(9.0, lambda chosen: left.get(tuple(chosen), 0.9), [
        "first_part", "poses", "force_log"], 1.0)  # fmt: skip
    assert cheapest == ("force_log", "poses")
    assert [rung.keeps for rung in rungs] == [False, False, True, True]


def test_conditioning_is_the_posterior_of_a_normal() -> None:
    random = np.random.default_rng(1)
    columns, rows = random.standard_normal((2, 3, 4)), random.standard_normal((5, 4))
    posterior = np.linalg.inv(np.eye(4) + rows.T @ rows / 0.3**2)
    assert condition(columns, [rows], [0.3]) == pytest.approx(columns @ posterior @ np.swapaxes(columns, 1, 2))
