"""Scores of answers: shares with intervals, and what counts as placed, false and an honest tie."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.answer_scores import Claim, calibration_error, score_answer, share, summarise, wilson


def truth(**changes: Any) -> dict[str, Any]:
    """One joint's stiffness that its nonlinearity imitates, over a small backlash."""
    effect = {
        "effect": "joint_stiffness", "joint": "joint_2", "axis": None, "required": True,
        "acceptable": [{"effect": "stiffness_nonlinearity", "joint": "joint_2", "axis": None, "distance": 0.1}],
    }  # fmt: skip
    small = [{"effect": "backlash", "joint": "joint_3", "axis": None, "seen_sigma": 0.2}]
    return {"kind": "single", "effects": [effect], "background": small, "noise_floor_rms_mm": 0.05, **changes}


def claim(effect: str, joint: str | None, probability: float = 0.9, ties: Any = ()) -> dict[str, Any]:
    return {"effect": effect, "joint": joint, "axis": None, "probability": probability, "ambiguous_with": list(ties)}


def answer(*claims: dict[str, Any], status: str = "explained") -> dict[str, Any]:
    return {
        "verdict": {"status": status, "effects": list(claims)},
        "gap": {"held_out_after_rms_mm": 0.05},
        "fresh_updated": [0.03, 0.04, None],
        "fresh_nominal": [0.3, 0.4, 0.1],
    }


def test_the_interval_of_a_share_is_that_of_wilson() -> None:
    """81 of 263, the worked example of Newcombe 1998 (table I): .2553 to .3662."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert share([])["share"] is None


def test_an_acceptable_rival_counts_as_placed_and_a_tiny_background_error_as_false() -> None:
    score = score_answer("a", truth(), answer(claim("stiffness_nonlinearity", "joint_2"), claim("backlash", "joint_3")))
    assert score.complete and not score.clean
    assert [c.right for c in score.claims] == [True, False]


def test_a_background_error_that_can_be_seen_may_be_named() -> None:
    seen = truth(background=[{"effect": "backlash", "joint": "joint_3", "axis": None, "seen_sigma": 1.5}])
    score = score_answer("a", seen, answer(claim("joint_stiffness", "joint_2"), claim("backlash", "joint_3")))
    assert score.complete and score.clean


def test_a_tie_is_honest_only_where_the_twin_is_listed() -> None:
    twin = {"effect": "stiffness_nonlinearity", "joint": "joint_2", "axis": None}
    listed = score_answer("a", truth(), answer(claim("joint_stiffness", "joint_2", ties=[twin])))
    silent = score_answer("a", truth(), answer(claim("joint_stiffness", "joint_2")))
    assert listed.ties == (True,) and silent.ties == (False,)


def test_a_later_campaign_is_judged_without_missing_rows_and_outliers() -> None:
    score = score_answer(
        "a", truth(split={"fresh": {"outlier_rows": [1]}}), answer(claim("joint_stiffness", "joint_2"))
    )
    assert score.fresh == pytest.approx(0.03) and score.nominal == pytest.approx((0.05) ** 0.5)


def test_an_effect_that_cannot_be_seen_need_not_be_found() -> None:
    hidden = truth(effects=[{**truth()["effects"][0], "required": False}])
    summary = summarise([score_answer("a", hidden, answer(status="none"))])
    assert summary["shares"]["singles placed"]["count"] == 0


def test_claims_that_hold_as_often_as_stated_have_no_calibration_error() -> None:
    claims = [Claim("x", 0.75, k < 3, False) for k in range(4)]
    assert calibration_error(claims) == pytest.approx(0.0)
    assert calibration_error([Claim("x", 0.9, False, False)]) == pytest.approx(0.9)


def test_unknown_causes_are_counted_by_what_is_said() -> None:
    strange = truth(kind="unknown", effects=[{"effect": "unknown", "joint": "joint_1", "axis": None}])
    said = [answer(status="unknown"), answer(claim("backlash", "joint_1"), status="partly_explained")]
    shares = summarise([score_answer(str(k), strange, a) for k, a in enumerate(said)])["shares"]
    assert shares["unknown called so"]["hits"] == 1
    assert shares["unknown called so or partly"]["hits"] == 2
    assert shares["unknown: nothing false"]["hits"] == 1
