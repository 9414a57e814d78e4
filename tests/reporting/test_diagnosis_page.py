"""The page of a diagnosis: the verdict on top, evidence below, nothing claimed that the verdict does not claim."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compplan.diagnosis.results.posterior import state_change
from compplan.diagnosis.results.shares import CALIBRATION, UNEXPLAINED, Share, Shares, SmallErrors
from compplan.diagnosis.results.where import Split, spread_gap
from compplan.effects import EFFECTS
from compplan.effects.signature import Effect
from compplan.io.quantities import format_mm
from compplan.measurement.campaign import Campaign
from compplan.reporting.diagnosis import open_diagnosis, render_diagnosis
from compplan.reporting.diagnosis_text import (
    describe_change,
    describe_effect,
    describe_parameters,
    name_effect,
)
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.statics.chain import build_chain
from compplan.statics.elastic import solve_equilibrium
from tests.reporting.test_report import own_part

SIGMA = 3e-5
PARAMETERS = {"compliance_change_rad_per_Nm": 2.6e-7}
SPRING = {"effect": "joint_stiffness", "joint": "joint_3", "axis": None, "probability": 0.97}


GAP = {
    "before_rms_mm": 0.6, "after_rms_mm": 0.052, "held_out_before_rms_mm": 0.6, "held_out_after_rms_mm": 0.0525,
    "noise_floor_mm": 1e3 * float(np.sqrt(3) * SIGMA),
}  # fmt: skip
TABLE = {
    "verdict": {"status": "explained", "effects": [{**SPRING, "parameters": PARAMETERS}]}, "gap": GAP,
    "candidates": [{**SPRING, "held_out_rms_mm": 0.0525}], "next_measurement": [],
}  # fmt: skip


@pytest.fixture(scope="module")
def diagnosed() -> tuple[Any, Split]:
    """Soften joint 3 by 60 %: what the page reads of a diagnosis that knows the truth, and where the gap lies."""
    robot = load_robot("kuka_kr270")
    rng = np.random.default_rng(1)
    q = np.array([0.0, 0.4, -1.4, 0.0, 0.9, 0.0]) + rng.uniform(-1, 1, (120, 6)) * [1.2, 0.5, 0.5, 1.5, 0.6, 1.5]
    force = rng.uniform(-1500, 1500, (120, 3))
    force[::4] = 0.0
    campaign = Campaign(
        np.repeat(["static_1", "static_2"], 60), q, np.hstack([force, np.zeros((120, 3))]), np.zeros((120, 3)),
        time=10.0 * np.arange(120),
    )  # fmt: skip
    soft = tuple(replace(s, compliance=1.6 * s.compliance) if s.joint == "joint_3" else s for s in robot.springs)
    nominal = solve_equilibrium(build_chain(robot), q, campaign.wrench).position
    noise = rng.normal(scale=SIGMA, size=(120, 3))
    point = solve_equilibrium(build_chain(replace(robot, springs=soft)), q, campaign.wrench).position + noise
    before = point - nominal
    diagnosis = SimpleNamespace(
        robot=robot, residual_before=before, residual_after=noise, registration=None, outliers=np.zeros(0, int),
        fit=SimpleNamespace(problem=SimpleNamespace(campaign=replace(campaign, position=point), register=())),
        delivery=SimpleNamespace(kind="calibrated"), noise="the log", points=point, repeats=None,
        verdict=SimpleNamespace(structure=SimpleNamespace(left=False), findings=[]),
    )  # fmt: skip
    return diagnosis, Split(make_shares(0.94), spread_gap(robot, campaign, before, noise, np.ones(120, bool)))


def make_shares(soft: float) -> Shares:
    """Give joint 3 a share by its stiffness, 4 % to small errors and the rest to noise."""
    carried, nothing = Share(soft, soft - 0.02, soft + 0.01), Share(0.0, 0.0, 0.01)
    return Shares(
        {"joint_3": Share(soft, 0.0, soft), CALIBRATION: Share(0.04, 0.01, 0.06), UNEXPLAINED: nothing},
        {"load": carried, UNEXPLAINED: nothing}, 0.96 - soft,
    )  # fmt: skip


def test_the_page_names_place_cause_and_gain(diagnosed: tuple[Any, Split]) -> None:
    page = render_diagnosis(diagnosed[0], diagnosed[1], None, TABLE)
    html = own_part(page)
    assert "Found: the compliance of joint_3 differs from the model." in html
    assert "joint stiffness, joint_3" in html and ">0.97</td>" in html
    assert format_mm(5.25e-5) in html and format_mm(np.sqrt(3) * SIGMA) in html
    assert len(page) < 6e6


def test_kinds_of_small_errors_stand_beside_the_names(diagnosed: tuple[Any, Split]) -> None:
    groups = (("joint_3", "load", Share(0.6, 0.0, 1.0)), ("joint_5", "geometry", Share(0.34, 0.3, 0.4)))
    split = replace(diagnosed[1], small_errors=SmallErrors({}, {}, groups))
    html = own_part(render_diagnosis(diagnosed[0], split, None, TABLE))
    largest = open_diagnosis({"status": "partly_explained", "effects": [SPRING]}, GAP, "causes", "", "", 0.78)
    assert "Most of the gap comes from many small errors, as of an uncalibrated robot. A part" in largest.verdict
    unknown = open_diagnosis({"status": "unknown", "effects": []}, GAP, "causes", "", "", 0.98)
    assert (
        "No known effect explains the gap alone: many small errors fit these poses, but hardly those" in unknown.verdict
    )
    assert "30\u00a0% to 40\u00a0%" in html and "The gap divided among all errors of the updated robot" in html


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_of_the_vocabulary_has_words(name: str) -> None:
    place = {"effect": name, "joint": "joint_2", "axis": "rx"}
    assert "{" not in describe_effect(place)
    assert "_" not in name_effect({"effect": name, "joint": None, "axis": None})


def test_parameters_show_their_unit() -> None:
    assert describe_parameters({"compliance_change_rad_per_Nm": 2.6e-7}) == "compliance change 2.60e−07 rad/(N m)"
    assert describe_parameters({"offset_mrad": 0.25, "row": 120}) == "offset 0.250 mrad; row 120"
    assert describe_parameters({"tx_m": -0.00627}, {"tx_m": [-0.01, 0]}) == "tx −6.27 mm, 95 %: −10.0 to 0"
    assert describe_parameters({"shift_mm": [0.1, 0.2, 0.0]}) == "shift [0.100, 0.200, 0] mm"


def test_a_softer_joint_is_told_as_a_share_of_the_model_with_its_interval(diagnosed: tuple[Any, Split]) -> None:
    robot = load_robot("kuka_kr270")  # joint_3 yields 0.43 urad/(N m)
    effect = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 3.913e-7})
    width = Unknown("joint_stiffness", "joint_3", None, ("compliance_change_rad_per_Nm",), np.array([4.3e-9]))
    told = state_change(robot, effect, Uncertainty("measured", "", (width,), calibration=2.0))
    np.testing.assert_allclose(told["change_percent"], [91.0, 91.0 - 3.92, 91.0 + 3.92], atol=0.01)
    assert describe_change(told) == "+91 % ± 4 %"
    assert state_change(robot, replace(effect, joint="joint_2"), Uncertainty("measured", "", (width,))) == {}
    verdict = {"status": "explained", "effects": [{**SPRING, "parameters": dict(effect.parameters), **told}]}
    html = own_part(render_diagnosis(diagnosed[0], diagnosed[1], None, {**TABLE, "verdict": verdict}))
    assert "+91 % ± 4 %" in html and "95 %: 3.74e−07 to 4.08e−07" in html
