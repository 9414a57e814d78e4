"""The generator from outside: same seed same files, logs that the product reads alike, labels as stated."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("mujoco")

import benchmarks.outsider
from benchmarks.outsider.__main__ import main
from benchmarks.outsider.draw import KINDS, VISIBLE, draw_case, kind_of
from benchmarks.outsider.effects import EFFECTS as DRAWN_EFFECTS
from compplan.effects import EFFECTS
from compplan.measurement.reading import read_campaign
from compplan.robot.folder import read_robot_folder
from compplan.simulation.predict import predict_campaign

EMPTY, UNNAMED, TWO = 9, 12, 13  # nothing wrong; a cause without a name; two effects


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("outsider")
    for seed in (EMPTY, UNNAMED, TWO):
        assert CliRunner().invoke(main, ["--seeds", f"{seed}:{seed + 1}", "--out", str(out)]).exit_code == 0
    return out


def read_truth(suite: Path, seed: int) -> dict[str, Any]:
    return json.loads((suite / f"outside_{seed:05d}" / "truth.json").read_text(encoding="utf-8"))


def test_no_module_of_the_generator_imports_the_product_or_the_other_generator() -> None:
    for folder in ("outsider", "simulated_robot"):
        for file in (Path(benchmarks.outsider.__file__).parents[1] / folder).glob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                ours = [name for name in names if name.split(".")[0] in ("compplan", "benchmarks", "tests")]
                assert all(name.split(".")[1] in ("outsider", "simulated_robot") for name in ours), file.name


def test_the_same_seed_writes_the_same_files(suite: Path, tmp_path: Path) -> None:
    assert CliRunner().invoke(main, ["--seeds", f"{EMPTY}:{EMPTY + 1}", "--out", str(tmp_path)]).exit_code == 0
    for file in [p for p in tmp_path.rglob("*") if p.is_file()]:
        assert file.read_bytes() == (suite / file.relative_to(tmp_path)).read_bytes()


def test_seeds_that_are_no_range_end_with_status_2(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["--seeds", "seven", "--out", str(tmp_path / "out")])
    assert result.exit_code == 2 and "a range A:B of whole numbers is wanted" in result.output


def test_the_product_predicts_an_empty_loaded_campaign_to_the_stated_noise(suite: Path) -> None:
    folder, sigma = suite / f"outside_{EMPTY:05d}", read_truth(suite, EMPTY)["sigma_mm"] * 1e-3

    def chi_square(**without: Any) -> float:
        robot = replace(read_robot_folder(folder / "robot"), **without)
        campaign = read_campaign(folder / "measurements.csv", robot)
        gap = (campaign.position - predict_campaign(robot, campaign, register=()).position) / sigma
        return float(np.delete(gap, read_truth(suite, EMPTY)["split"]["given"]["outlier_rows"], axis=0).var())

    scatter = (read_truth(suite, EMPTY)["noise_floor_rms_mm"] / read_truth(suite, EMPTY)["sigma_mm"]) ** 2 / 3
    assert chi_square() == pytest.approx(scatter, rel=0.3)
    assert chi_square(springs=()) > 3 * scatter


def test_effects_are_those_of_the_format_and_each_is_visible(suite: Path) -> None:
    assert set(DRAWN_EFFECTS) == set(EFFECTS) - {"unknown"}
    labels = [label for seed in (EMPTY, UNNAMED, TWO) for label in read_truth(suite, seed)["effects"]]
    assert [len(read_truth(suite, seed)["effects"]) for seed in (EMPTY, UNNAMED, TWO)] == [0, 1, 2]
    assert all(label["visible"] >= VISIBLE for label in labels)
    unnamed = read_truth(suite, UNNAMED)["effects"][0]
    assert unnamed["effect"] == "unknown" and unnamed["acceptable"] == []


def test_the_kinds_come_in_their_shares() -> None:
    kinds = [kind_of(seed) for seed in range(1000)]
    assert all(kinds.count(kind) == pytest.approx(1000 * share, abs=6) for kind, share in KINDS.items())


def test_a_case_that_cannot_be_labelled_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.outsider.draw._attempt", lambda seed, rng: None)
    assert draw_case(0) is None
