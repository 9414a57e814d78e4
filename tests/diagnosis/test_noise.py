"""Noise: what repeats, poses met again, a sigma column and a stated repeatability tell; closed forms with a seed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from compplan.diagnosis.data.noise import LEVEL, Noise, estimate_noise
from compplan.diagnosis.evidence.evidence import _hyperprior
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.results.repeats import check_repeats
from compplan.effects import command_campaign
from compplan.measurement.campaign import Campaign

INSTRUMENT, ROBOT = 2e-5, 2.5e-5
POSES, VISITS = 60, 4


def visit_poses(rows_a_stay: int, seed: int = 3) -> tuple[Campaign, np.ndarray]:
    """Visit poses again and again in a drawn order. Returns the campaign and the scatter of its rows."""
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(POSES) for _ in range(VISITS)])
    q = np.repeat(rng.uniform(-1.0, 1.0, (POSES, 6))[order], rows_a_stay, axis=0)
    stay = np.repeat(rng.normal(0.0, ROBOT, (len(order), 3)), rows_a_stay, axis=0)
    return command_campaign(q, on_path=False), stay + rng.normal(0.0, INSTRUMENT, stay.shape)


def test_rows_of_a_stay_tell_the_instrument_and_poses_met_again_the_robot() -> None:
    noise = estimate_noise(*visit_poses(3), None, "position")
    assert noise.sigma == pytest.approx(INSTRUMENT, rel=0.05)
    assert noise.stay == pytest.approx(ROBOT, rel=0.1)


def test_single_rows_hold_both_as_far_as_poses_are_met_again() -> None:
    noise = estimate_noise(*visit_poses(1), None, "position")
    assert noise.sigma == pytest.approx(np.hypot(INSTRUMENT, ROBOT), rel=0.06)
    assert noise.source == "scatter of poses measured again"
    assert noise.stay == 0.0


def test_the_sum_of_two_stated_variances_has_the_freedom_of_welch_and_satterthwaite() -> None:
    campaign, gap = visit_poses(1)
    once = campaign.take(np.arange(POSES))
    stated = np.full(POSES, INSTRUMENT)
    noise = estimate_noise(once, gap[:POSES], stated, "position", INSTRUMENT)
    assert noise.sigma == pytest.approx(np.sqrt(2.0) * INSTRUMENT)
    assert noise.degrees_of_freedom == pytest.approx(4.0 / (1.0 / 60.0 + 1.0 / 20.0))


def test_a_sigma_column_weighs_each_row() -> None:
    campaign, gap = visit_poses(3)
    stated = np.where(np.arange(len(gap)) % 2 == 0, 1e-5, 3e-5)
    noise = estimate_noise(campaign, gap, stated, "position")
    near, far = noise.spread_of(np.array([0, 1]))
    assert far / near == pytest.approx(3.0)
    assert np.sqrt(np.mean(noise.spread**2)) == pytest.approx(1.0)


def test_poses_that_come_back_far_off_are_a_cause_and_no_noise() -> None:
    campaign, gap = visit_poses(3)
    # play of a tenth of a millimetre: every second visit stands on the other side
    side = np.where(np.arange(len(gap)) // 3 // POSES % 2 == 0, 1.0, -1.0)[:, None]
    noise = estimate_noise(campaign, gap + 5e-5 * side, None, "position", ROBOT)
    assert noise.stay < 1.6 * ROBOT


def test_poses_that_scatter_beyond_a_stated_sigma_are_reported_and_no_noise() -> None:
    campaign, gap = visit_poses(1)
    side = np.where(np.arange(len(gap)) // POSES % 2 == 0, 1.0, -1.0)[:, None]
    noise = estimate_noise(campaign, gap + 1e-4 * side, np.full(len(gap), INSTRUMENT), "position")
    assert noise.sigma == pytest.approx(np.sqrt(2.0) * INSTRUMENT)  # sigma and the repeatability of any robot
    assert noise.source == (
        "sigma column; poses measured again scatter by 5.2 times what sigma and repeatability explain"
    )


def test_repeats_beyond_the_stated_sigma_are_said_with_the_joint_that_creeps() -> None:
    """Three readings a stay, 20 s apart; the third joint creeps in the direction of its last move."""
    campaign, gap = visit_poses(3)
    seconds, rng = 300.0 * (np.arange(len(gap)) // 3) + 20.0 * (np.arange(len(gap)) % 3), np.random.default_rng(8)
    sigma = np.full(len(gap), np.hypot(INSTRUMENT, ROBOT))
    campaign = replace(campaign, position=gap, time=seconds, sigma=sigma)
    motion = rng.normal(size=(len(gap), 6, 6))
    at = SimpleNamespace(
        campaign=campaign, motion=motion, own_load=rng.normal(size=(len(gap), 6)),
        robot=SimpleNamespace(joint_names=[f"joint_{k + 1}" for k in range(6)]),
    )  # fmt: skip
    assert check_repeats(at, gap) is None  # type: ignore[arg-type]
    crept = 3e-5 * np.log1p(seconds % 300.0) * campaign.approach[:, 2]
    found = check_repeats(at, gap + crept[:, None] * motion[:, :3, 2])  # type: ignore[arg-type]
    assert found is not None
    assert (found.joint, found.driver) == ("joint_3", "direction of approach")
    assert found.times_sigma > 1.5 > 1.1 > found.chance and found.values == 3 * (len(gap) - POSES)


def test_the_noise_has_the_chi_square_likelihood_and_leeway_of_its_witnesses() -> None:
    few, off = Noise(1e-5, 12.0, "repeats"), 0.3
    assert few.chance_factor == pytest.approx(12.0 / chi2.ppf(0.5 * (1.0 - LEVEL), 12.0))
    channels = [SimpleNamespace(degrees_of_freedom=12.0)]
    nothing = np.zeros(0)

    def value(log_noise: float) -> float:
        return _hyperprior(channels, Hyper(np.array([log_noise]), np.array([-9.0]), nothing), nothing.astype(bool))[0]

    expected = chi2.logpdf(12.0 * np.exp(-off), 12.0) - off - chi2.logpdf(12.0, 12.0)
    assert value(off) - value(0.0) == pytest.approx(expected)
