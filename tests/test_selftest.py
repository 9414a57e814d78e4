"""The self-test of the diagnosis: what it draws, how it scores, and that it goes on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run_command

from compplan.effects import attain_scene, stage_scene
from compplan.selftest.case import MIX, Case, kind_of
from compplan.selftest.draw import draw_case
from compplan.selftest.failures import list_failures
from compplan.selftest.scoring import score_answer
from compplan.selftest.study import Settings, run_study
from compplan.selftest.summary import calibrate, summarise_study

STIFFNESS = {"effect": "joint_stiffness", "joint": "joint_3", "axis": None}
OFFSET = {"effect": "joint_offset", "joint": "joint_2", "axis": None}
GEOMETRY = {"effect": "link_geometry", "joint": "joint_2", "axis": "ry"}
WAVE = {"effect": "transmission_error", "joint": "joint_1", "axis": None}
BEND = {"effect": "link_compliance", "joint": "joint_2", "axis": "rx"}


def make_truth(*effects: dict[str, Any], kind: str = "single", expected: str = "explained") -> dict[str, Any]:
    return {
        "case": "made", "kind": kind, "difficulty": "clean", "robot": "arm", "expected_status": expected,
        "effects": [{"acceptable": [], "gap_over_sigma": 10.0, **effect} for effect in effects],
        "background": [WAVE], "noise_floor_rms_mm": 0.05, "split": {"fresh": {"outlier_rows": [2]}},
    }  # fmt: skip


def make_answer(*claims: dict[str, Any], status: str = "explained", updated: float = 0.05) -> dict[str, Any]:
    effects = [{"probability": 0.95, "ambiguous_with": [], **claim} for claim in claims]
    return {
        "verdict": {"status": status, "effects": effects}, "fresh_nominal": [0.2, 0.2, 9.0],
        "fresh_updated": [updated, updated, 9.0], "seconds": 2.0,
    }  # fmt: skip


def gap_of(case: Case) -> np.ndarray:
    scene = stage_scene(case.robot, case.campaign)
    inside = np.ones(len(case.campaign), bool)
    inside[case.truth["split"]["given"]["outlier_rows"]] = False
    return (case.campaign.position - attain_scene(scene).position)[inside]


def test_a_number_gives_the_same_case_again_and_another_number_another_one() -> None:
    first, again, other = draw_case(4), draw_case(4), draw_case(6)
    assert first.truth == again.truth
    assert np.array_equal(first.campaign.position, again.campaign.position)
    assert first.truth["effects"] != other.truth["effects"]


def test_a_case_without_effect_holds_noise_and_nothing_else() -> None:
    case = draw_case(18)
    assert case.truth["kind"] == "none"
    sigma = 1e-3 * case.truth["sigma_mm"]
    assert np.std(gap_of(case)) == pytest.approx(sigma, rel=0.12)


def test_a_hidden_effect_makes_the_gap_that_the_truth_states() -> None:
    case = draw_case(10007, "single", "clean", ["joint_offset"])
    (effect,) = case.truth["effects"]
    rms = 1e3 * float(np.sqrt(np.mean(np.sum(gap_of(case) ** 2, axis=1))))
    expected = np.hypot(effect["gap_rms_mm"], case.truth["noise_floor_rms_mm"])
    assert rms == pytest.approx(expected, rel=0.1)
    assert 5.0 <= effect["gap_over_sigma"] <= 61.0


def test_the_turn_of_the_next_origin_is_found_to_be_alike_an_offset() -> None:
    case = draw_case(10008, "single", "clean", ["joint_offset"])
    (effect,) = case.truth["effects"]
    assert effect["joint"] == "joint_5"
    assert {"effect": "link_geometry", "joint": "joint_6", "axis": "ry", "r2": 1.0} in effect["acceptable"]


def test_any_range_of_numbers_is_a_mix_of_kinds_and_of_both_difficulties() -> None:
    drawn = [kind_of(number) for number in range(500000, 500000 + 2 * len(MIX))]
    assert {kind for kind, _ in drawn} == set(MIX)
    assert {level for kind, level in drawn if kind == "single"} == {"clean", "realistic"}


def test_a_claim_is_right_if_it_names_the_truth_or_what_cannot_be_told_from_it_or_a_background_error() -> None:
    truth = make_truth({**OFFSET, "acceptable": [GEOMETRY]})
    score = score_answer(truth, make_answer(GEOMETRY, WAVE, BEND))
    assert [claim.right for claim in score.claims] == [True, True, False]
    assert [claim.truth for claim in score.claims] == ["joint_offset", "background", ""]
    assert score.all_named
    assert score.false_names == score.confident_wrong == 1


def test_the_wrong_joint_is_a_wrong_name() -> None:
    score = score_answer(make_truth(STIFFNESS), make_answer({**STIFFNESS, "joint": "joint_2"}))
    assert not score.all_named
    assert score.false_names == 1


def test_a_tie_counts_as_listed_and_an_impossible_rival_as_idle() -> None:
    truth = make_truth({**OFFSET, "acceptable": [GEOMETRY]})
    score = score_answer(truth, make_answer({**OFFSET, "ambiguous_with": [GEOMETRY, BEND]}))
    assert score.ties == (1, 1)
    assert score.rivals == (2, 1)
    assert score_answer(truth, make_answer(OFFSET)).ties == (1, 0)


def test_outliers_of_the_later_campaign_do_not_count_against_the_robot() -> None:
    score = score_answer(make_truth(OFFSET), make_answer(OFFSET))
    assert score.fresh == pytest.approx(1.0)
    assert score.fresh_nominal == pytest.approx(4.0)
    assert not score.worse
    assert score_answer(make_truth(OFFSET), make_answer(OFFSET, updated=0.3)).worse


def test_probabilities_that_hold_have_no_calibration_error_and_boasts_have() -> None:
    honest = [(0.75, k % 4 != 0) for k in range(400)]
    boasts = [(0.99, k % 2 == 0) for k in range(400)]
    assert calibrate(honest)["expected_error"] == pytest.approx(0.0, abs=1e-12)
    assert calibrate(boasts)["expected_error"] == pytest.approx(0.49)
    assert calibrate([])["expected_error"] is None


def test_a_summary_holds_rates_confusion_detection_and_withheld_answers() -> None:
    named = {"truth": make_truth(OFFSET), "answer": make_answer(OFFSET), "withheld": make_answer(BEND)}
    missed = {"truth": make_truth(STIFFNESS), "answer": make_answer(BEND, status="partly_explained")}
    missed["withheld"] = make_answer(status="unknown")
    summary = summarise_study([named, missed])
    (kind,) = summary["kinds"]
    assert kind["all_named"] == kind["nothing_false"] == 0.5
    confusion = summary["confusion"]
    cells = {
        (row, column): count
        for row, counts in zip(confusion["rows"], confusion["counts"], strict=True)
        for column, count in zip(confusion["columns"], counts, strict=True)
    }
    assert cells["joint_offset", "joint_offset"] == 1
    assert cells["joint_stiffness", "(not named)"] == 1
    assert cells["(nothing)", "link_compliance"] == 1
    assert summary["withheld"]["all"]["honest"] == 0.5
    assert summary["withheld"]["all"]["confident_wrong"] == 1
    assert summary["detection"] == [
        {"from": 8.0, "to": 12.0, "alone": True, "effects": 2, "named": 0.5, "low": pytest.approx(0.0945, abs=1e-3),
         "high": pytest.approx(0.9055, abs=1e-3)}
    ]  # fmt: skip
    kinds = {line.split(" | ")[0] for line in list_failures([named, missed])}
    assert kinds == {"missed", "confident wrong name", "withheld: confident wrong name", "withheld: not honest"}


def never(number: int) -> Case:
    raise AssertionError(f"case {number} was drawn although its answer is there")


def test_a_study_goes_on_where_it_stopped(tmp_path: Path) -> None:
    settings = Settings(campaigns=1, seed=6, withhold=0)
    seen: list[tuple[int, int]] = []
    (record,) = run_study(draw_case, settings, tmp_path, lambda done, total: seen.append((done, total)))
    assert seen == [(0, 1), (1, 1)]
    assert run_study(never, settings, tmp_path) == [record]
    (tmp_path / "cases" / "6.json").write_text('{"truth": ')
    with pytest.raises(AssertionError, match="case 6 was drawn"):
        run_study(never, settings, tmp_path)


@pytest.mark.slow
def test_the_command_writes_page_summary_and_failures_and_workers_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["selftest-diagnosis", "--campaigns", "2", "--seed", "2"]
    for name, workers in (("one", "1"), ("two", "2")):
        answer = run_command([*options, "--out", tmp_path / name, "--workers", workers], monkeypatch, capsys)
        assert answer.status == 0, answer.err
    one, two = (json.loads((tmp_path / name / "selftest.json").read_text()) for name in ("one", "two"))
    for summary in (one, two):
        summary.pop("seconds")
    assert one == two
    assert (tmp_path / "one" / "failures.txt").is_file()
    assert "Whether probabilities hold" in (tmp_path / "one" / "report.html").read_text()
