"""The generator from outside: same seed same files, folders and logs that the product reads alike, labels as stated."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import benchmarks.outsider
from benchmarks.outsider.__main__ import main
from benchmarks.outsider.cause import Sized
from benchmarks.outsider.draw import Case, draw_case, kind_of
from benchmarks.outsider.known import KNOWN
from benchmarks.outsider.labels import VISIBLE, Bench, label_causes
from benchmarks.outsider.logbook import write_case
from benchmarks.outsider.observe import observe
from benchmarks.outsider.signatures import linearize
from compplan.effects import EFFECTS
from compplan.measurement.reading import read_campaign
from compplan.robot.folder import read_robot_folder
from compplan.simulation.predict import predict_campaign

# No effect and no scatter: seven axes, dead weights, base and target unknown.
EMPTY, LOADED, REGISTERED = 9, 98, 64
OFFSET = 82  # one joint offset, no everyday errors, no scatter, frames known
FOUR, UNNAMED = 2, 4  # four effects; a cause without a name
DRAWN = (EMPTY, LOADED, REGISTERED, OFFSET, FOUR, UNNAMED)


def _truth(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "truth.json").read_text(encoding="utf-8"))


def _residual(folder: Path, registered: bool, **without: Any) -> np.ndarray:
    """Measured minus predicted by the product from the nominal folder, rows that have both, in the stated noise."""
    robot = replace(read_robot_folder(folder / "robot"), **without)
    campaign = read_campaign(folder / "measurements.csv", robot)
    predicted = predict_campaign(robot, campaign, register=("base", "tool") if registered else ())
    residual = (campaign.position - predicted.position) / (_truth(folder)["sigma_mm"] * 1e-3)
    missing = np.isnan(residual).any(axis=1)
    assert missing.sum() <= 0.02 * len(missing)
    return residual[~missing]


@pytest.fixture(scope="module")
def cases() -> dict[int, Case]:
    drawn = {seed: draw_case(seed) for seed in DRAWN}
    return {seed: case for seed, case in drawn.items() if case is not None}


@pytest.fixture(scope="module")
def folders(cases: dict[int, Case], tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    out = tmp_path_factory.mktemp("outsider")
    return {seed: write_case(case, out) for seed, case in cases.items()}


def test_no_module_of_the_generator_imports_the_product_or_the_other_generator() -> None:
    files = list(Path(benchmarks.outsider.__file__).parent.glob("*.py"))
    assert len(files) > 10
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [f"{'.' * node.level}{node.module or ''}"] if isinstance(node, ast.ImportFrom) else []
            ours = [name for name in names if name.split(".")[0] in ("compplan", "benchmarks", "tests", "")]
            assert all(f"{name}.".startswith("benchmarks.outsider.") for name in ours), file.name


def test_the_same_seed_writes_the_same_files(folders: dict[int, Path], tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["--seeds", f"{EMPTY}:{EMPTY + 1}", "--out", str(tmp_path)])
    assert result.exit_code == 0
    files = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    assert len(files) == 5
    for file in files:
        assert (tmp_path / file).read_bytes() == (folders[EMPTY].parent / file).read_bytes()


def test_seeds_that_are_no_range_end_with_status_2(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["--seeds", "seven", "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "a range A:B of whole numbers is wanted" in result.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", [EMPTY, LOADED, REGISTERED])
def test_the_product_predicts_an_empty_campaign_to_the_stated_noise(folders: dict[int, Path], seed: int) -> None:
    registered = seed == REGISTERED
    residual = _residual(folders[seed], registered)
    freedom = residual.size - 9 * registered
    assert np.sum(residual**2) == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom))
    rigid = _residual(folders[seed], registered, springs=())
    assert np.sum(rigid**2) > 4 * freedom  # the springs, without which this would say little


def test_the_product_sees_an_offset_as_large_as_the_truth_says(folders: dict[int, Path]) -> None:
    truth = _truth(folders[OFFSET])
    gap = truth["effects"][0]["gap_rms_mm"] / truth["sigma_mm"]
    residual = _residual(folders[OFFSET], registered=False)
    rows = len(residual)
    assert gap > 1
    assert np.sum(residual**2) == pytest.approx(rows * (gap**2 + 3), abs=4 * np.sqrt(rows * (4 * gap**2 + 6)))


def test_visible_is_the_length_of_the_motion_in_standard_deviations_where_nothing_else_blurs_it(
    cases: dict[int, Case],
) -> None:
    case = cases[OFFSET]
    gap = observe(case.robot, case.given, case.causes, []).gap[:, :3]
    assert not case.everyday
    assert case.instrument.scatter is None
    by_hand = np.linalg.norm(gap / case.instrument.sigma(case.given)[:, None])
    assert case.labels[0]["visible"] == pytest.approx(by_hand, abs=0.006)


def test_every_effect_told_is_of_the_formats_list_or_unknown(folders: dict[int, Path]) -> None:
    assert set(KNOWN) <= set(EFFECTS)
    told = {seed: [e["effect"] for e in _truth(folder)["effects"]] for seed, folder in folders.items()}
    assert [len(told[seed]) for seed in DRAWN] == [0, 0, 0, 1, 4, 1]
    assert told[UNNAMED] == ["unknown"]
    assert {name for names in told.values() for name in names} <= set(EFFECTS) | {"unknown"}
    rivals = [r for folder in folders.values() for e in _truth(folder)["effects"] for r in e["nearest_rivals"]]
    assert {rival["effect"] for rival in rivals} <= set(EFFECTS)


def test_an_effect_is_required_only_where_it_stands_out_by_four_and_a_half_deviations(cases: dict[int, Case]) -> None:
    assert VISIBLE == 4.5
    case = cases[OFFSET]
    signatures = linearize(case.robot, case.given, case.settings)
    bench = Bench(case.robot, case.given, case.settings, case.instrument, case.everyday, signatures)
    (cause, size), seen = case.causes[0], case.labels[0]["visible"]
    assert label_causes(bench, [Sized(cause, size * 4.4 / seen)]) is None
    labelled = label_causes(bench, [Sized(cause, size * 4.6 / seen)])
    assert labelled is not None
    assert labelled[0][0]["required"] is True
    assert labelled[0][0]["visible"] == pytest.approx(4.6, abs=0.02)


def test_an_unknown_cause_has_no_acceptable_name_and_two_effects_do_not_imitate_it(cases: dict[int, Case]) -> None:
    label = cases[UNNAMED].labels[0]
    assert label["acceptable"] == []
    assert label["nearest_rivals"][0]["distance"] >= 5
    assert label["best_pair"]["distance_both"] >= 3


def test_the_kinds_come_in_their_shares() -> None:
    kinds = [kind_of(seed) for seed in range(1000)]
    assert kinds.count("single") == pytest.approx(380, abs=5)
    assert kinds.count("unknown") == pytest.approx(150, abs=5)
    assert kinds.count("none") == pytest.approx(30, abs=5)
