"""The verdict: whether the 95 % band of the true tip lies within the tolerance along the whole cut."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run_command

from compplan.job.job import check_job
from compplan.planning.plan import plan_compensation, plan_job, prepare_job
from compplan.planning.tolerance_verdict import share_length
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import widen_to_path

pytestmark = pytest.mark.usefixtures("graph_alone")

JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 40.0, "feed_mm_s": 20.0, "waypoints": 30},
    "part": {"position_mm": [1700.0, 0.0, 900.0]},
    "process": {"model": "constant", "force_N": [0.0, 0.0, 200.0], "frame": "base"},
    "plan": {"strategy": "nlp"},
    "output": {"programs": ["krl"]},
}


def test_a_wide_tolerance_is_kept_and_a_narrow_one_may_not_be() -> None:
    """The same plan under both: only the word and the share change, the band does not."""
    verdicts = {}
    for tolerance in (30.0, 0.02):
        plan = plan_job(check_job({**JOB, "plan": {"tolerance_mm": tolerance, "inertia": True}}, "job.toml"))
        verdicts[tolerance] = plan.verdict
        assert plan.error_band is not None
        assert plan.error_band.whole >= plan.error_band.greatest
    assert verdicts[30.0].word == "keeps"
    assert verdicts[30.0].beyond_share == 0.0
    assert verdicts[30.0].change == ""
    assert verdicts[0.02].word == "may_not_keep"
    assert verdicts[0.02].beyond_share == pytest.approx(1.0)
    assert verdicts[0.02].change.endswith(".")
    assert verdicts[0.02].sentence.startswith("May not keep 0.02 mm: the tip may be up to")


def test_a_plan_that_leaves_the_limits_never_keeps() -> None:
    plan = plan_job(check_job({**JOB, "plan": {"tolerance_mm": 30.0, "max_correction_mm": 0.05}}, "job.toml"))
    assert plan.status == "infeasible"
    assert plan.verdict.word == "may_not_keep"
    assert "correction" in plan.verdict.largest_cause
    assert plan.verdict.sentence.startswith("Do not start: there is no solution. May not keep 30 mm: ")
    assert "No 95 % band is stated, waypoints are out of reach." in plan.verdict.sentence
    assert plan.error_band is None and plan.verdict.band is None
    assert "error_band_mm" not in plan.to_dict() and plan.to_dict()["verdict"]["band_mm"] is None
    assert dict(plan.summary())["95 % band"] == "No 95 % band is stated, waypoints are out of reach"


def test_a_job_that_leaves_inertia_alone_says_so_and_so_does_the_basis_of_a_robot_that_nobody_measured() -> None:
    job = check_job({**JOB, "plan": {"tolerance_mm": 30.0, "inertia": False}}, "job.toml")
    robot, nominal, options = prepare_job(job)
    known = replace(robot_uncertainty(robot), grade="measured")
    plain = plan_job(job).verdict
    measured = plan_compensation(replace(robot, uncertainty=known), nominal, options).verdict
    assert plain.word == measured.word == "keeps"
    assert plain.sentence.endswith(
        "along the whole cut (robot and force assumed, not measured)."
        " Inertia is not compensated: [plan] inertia = false."
    )
    assert "(robot measured; force assumed)" in measured.sentence


def test_the_verdict_is_the_first_line_and_stands_in_plan_json_and_in_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import tomli_w

    job = tmp_path / "job.toml"
    job.write_text(tomli_w.dumps(JOB), encoding="utf-8")
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    verdict = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))["verdict"]
    assert answer.out.startswith("May not keep 0.1 mm: the tip may be up to ")
    assert answer.out.split(":")[0] == verdict["sentence"].split(":")[0]
    assert set(verdict) >= {"word", "beyond_share", "largest_cause"}
    assert "; verdict: MAY NOT KEEP 0.1 mm" in (tmp_path / "out" / "job_L1.src").read_text(encoding="utf-8")
    assert verdict["sentence"].split(" Largest")[0] in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_share_of_a_cut_goes_by_length() -> None:
    """Waypoints at 0 1 2 10 mm: the first two stand for .5 + 1 of 10 mm."""
    length, cut = np.array([0.0, 1.0, 2.0, 10.0]), np.ones(4, bool)
    assert share_length(length, cut, np.array([True, True, False, False])) == pytest.approx(0.15)
    apart = np.array([True, True, False, True])  # the moves over waypoint 2 are not cut
    assert share_length(length, apart, np.array([True, False, False, False])) == pytest.approx(0.5)
    assert share_length(np.zeros(4), cut, np.array([True, False, False, False])) == pytest.approx(0.25)


def test_the_whole_path_is_never_promised_less_than_its_widest_point() -> None:
    """Independent points stray farther together than any one of them; one point alone does not."""
    random = np.random.default_rng(5)
    drawn = random.standard_normal((20, 3, 2000))
    assert widen_to_path(drawn) > 1.2
    assert widen_to_path(drawn[:1]) == pytest.approx(1.0)
    alike = np.repeat(drawn[:1], 20, axis=0) * np.linspace(0.5, 1.0, 20)[:, None, None]
    assert widen_to_path(alike) == pytest.approx(1.0)
