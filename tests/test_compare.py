"""Strategies side by side, in cells that agree with the planner's model and in cells that do not."""

from pathlib import Path

import numpy as np
import pytest

import compplan as cp
from compplan.job.job import check_job
from compplan.outputs.plan import summarise_comparison

PATHS = Path(__file__).parents[1] / "paths"


@pytest.fixture(scope="module")
def comparison():
    job = cp.load_job(PATHS / "circle_500mm.toml")
    data = job.model_dump(by_alias=True, exclude_unset=True)
    data["toolpath"]["waypoints"] = 150
    return cp.compare_job(check_job(data, job.file))


def test_mirror_and_nlp_stand_far_below_none(comparison):
    runs = comparison.as_modelled
    assert runs["none"].max_deviation > 1e-3
    assert runs["mirror"].max_deviation < 0.01 * runs["none"].max_deviation
    assert runs["nlp"].max_deviation < 1e-6
    assert runs["iterated_mirror"].max_deviation < 1e-6


def test_a_mismatch_of_a_fifth_leaves_a_fifth_of_the_deflection(comparison):
    none = comparison.as_modelled["none"].rms_deviation
    for cell in ("compliance x 1.2", "compliance x 0.8"):
        for strategy in ("mirror", "iterated_mirror", "nlp"):
            left = comparison.evaluations[cell][strategy].rms_deviation
            assert left == pytest.approx(0.2 * none, rel=0.05)


def test_compare_json_is_as_the_contract_says(comparison):
    summary = summarise_comparison(comparison)
    assert summary["schema"] == 1
    assert list(summary["strategies"]) == ["none", "mirror", "iterated_mirror", "nlp"]
    for figures in summary["strategies"].values():
        assert figures["rms_mm"] <= figures["max_mm"] and figures["mean_mm"] <= figures["rms_mm"]
        assert [entry["cell"] for entry in figures["under_mismatch"]] == ["compliance x 1.2", "compliance x 0.8"]
        assert {"cell", "rms_mm", "max_mm"} <= figures["under_mismatch"][0].keys()


def test_every_cell_ran_the_same_commands(comparison):
    assert np.isfinite([run.max_deviation for runs in comparison.evaluations.values() for run in runs.values()]).all()
    assert set(comparison.commands) == set(comparison.evaluations["compliance x 1.2"])
