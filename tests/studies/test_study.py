from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from montecarlo_cases import cone_job, cone_study, small_study
from scipy.stats import binomtest

from compplan.cli import group
from compplan.errors import InputError, UnknownNameError
from compplan.job.names import ONLINE, STRATEGIES
from compplan.job.noise import NoiseTable, describe_noise
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.statics.stiffness import attain_pose
from compplan.studies.job_study import DRAWS, SEED
from compplan.studies.runner import Settings, discard_chunks, run_study
from compplan.studies.sampling import Factors, draw_points, list_factors
from compplan.studies.sensitivity import design_points, estimate_totals, measure_sensitivity
from compplan.studies.study import prepare_study
from compplan.studies.summary import estimate_mean, estimate_quantile, estimate_share, summarise_run
from compplan.studies.workers import Workers
from compplan.uncertainty.sensitivities import state_force

HERE = Workers(workers=1)


def test_two_processes_give_the_numbers_of_one_to_the_last_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    from compplan.studies import runner

    monkeypatch.setattr(runner, "CHUNK", 20)
    settings = Settings(samples=50, seed=3)
    one = run_study(small_study(), settings, workforce=HERE)
    two = run_study(small_study(), settings, workforce=Workers(workers=2))
    for a, b in zip(one.evaluated, two.evaluated, strict=True):
        np.testing.assert_array_equal(a, b)


def test_an_interrupted_study_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from compplan.studies import runner

    monkeypatch.setattr(runner, "CHUNK", 16)
    study, settings = small_study(), Settings(samples=64, seed=3)

    def interrupt(done: int, wanted: int) -> None:
        if done >= 32:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, settings, folder=tmp_path, workforce=HERE, progress=interrupt)
    assert len(list(tmp_path.glob("chunk-*.npz"))) == 2
    (tmp_path / "chunk-000001.npz").write_bytes(b"cut off")
    resumed = run_study(study, settings, folder=tmp_path, workforce=HERE)
    assert resumed.reused == 1
    whole = run_study(study, settings, workforce=HERE)
    np.testing.assert_array_equal(resumed.evaluated.rms, whole.evaluated.rms)
    np.testing.assert_array_equal(resumed.evaluated.along, whole.evaluated.along)
    prolonged = run_study(study, Settings(samples=80, seed=3), folder=tmp_path, workforce=HERE)
    assert prolonged.reused == 4
    with pytest.raises(InputError, match=r"holds 5 finished chunks of another study .* --discard"):
        run_study(study, Settings(samples=64, seed=4), folder=tmp_path, workforce=HERE)
    assert len(list(tmp_path.glob("chunk-*.npz"))) == 5
    discard_chunks(tmp_path)
    other = run_study(study, Settings(samples=64, seed=4), folder=tmp_path, workforce=HERE)
    assert other.reused == 0 and not np.array_equal(other.evaluated.rms, whole.evaluated.rms)


def test_a_chunk_of_another_study_that_slips_in_is_not_taken(tmp_path: Path) -> None:
    study = small_study()
    run_study(study, Settings(samples=64, seed=3), folder=tmp_path / "a", workforce=HERE)
    run_study(study, Settings(samples=64, seed=4), folder=tmp_path / "b", workforce=HERE)
    (tmp_path / "b" / "chunk-000000.npz").replace(tmp_path / "a" / "chunk-000000.npz")
    with pytest.raises(InputError, match="another study"):
        run_study(study, Settings(samples=64, seed=3), folder=tmp_path / "a", workforce=HERE)


def test_total_indices_find_what_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("compplan.studies.sampling.ENCODERS", (0.0, 0.0))
    quiet = dict.fromkeys(NoiseTable.model_fields, 0.0)
    noise = NoiseTable(**{**quiet, "wrench_level": 0.2, "part_frame_mm": 0.02})
    task = small_study().task
    unknown = Unknown("joint_offset", "joint_1", None, ("offset_rad",), np.array([1e-6]))
    known = Uncertainty("measured", "test", (unknown,), np.eye(1), repeatability=0.0)
    task = replace(task, robot=replace(task.robot, uncertainty=known))
    study = prepare_study(task, noise, ["none"], most_waypoints=6)
    found = measure_sensitivity(study, 1, base=256, workforce=HERE)
    assert found is not None and set(found.groups) == {"wrench_level", "part", "encoders", "force_sensor", "robot"}
    total = dict(zip(found.groups, found.total["none"], strict=True))
    assert total["wrench_level"] > 0.9 and 0 <= total["part"] < 0.2


def test_the_summary_has_the_agreed_form() -> None:
    study = cone_study()
    run = run_study(study, Settings(samples=32, seed=1, replicates=4), workforce=HERE)
    summary = summarise_run(run, None, name="cone")
    assert (summary["schema"], summary["samples"], summary["seed"]) == (1, 32, 1)
    assert set(summary["strategies"]) == set(study.strategies) and len(study.strategies) == 7
    for figures in summary["strategies"].values():
        rms = figures["rms_mm"]
        assert rms["ci95"][0] <= rms["mean"] <= rms["ci95"][1] and rms["p50"] <= rms["p95"]
        assert figures["rms_mm"]["mean"] <= figures["max_mm"]["mean"]
        assert 0 <= figures["within_tolerance"] <= 1
    # left alone, robots spread about the model bend on average as the model does
    bent = attain_pose(study.task.chain, study.task.q_start, study.task.wrench, slope=False).position
    size = 1e3 * np.linalg.norm(bent - study.task.position, axis=1)[study.cut]
    left = summary["strategies"]["none"]
    assert left["rms_mm"]["mean"] == pytest.approx(np.sqrt(np.mean(size**2)), rel=0.15)
    assert left["mean_mm"]["mean"] == pytest.approx(size.mean(), rel=0.15)
    assert left["max_mm"]["mean"] == pytest.approx(size.max(), rel=0.15)
    assert (summary["tolerance_mm"], left["within_tolerance"]) == (0.1, 0.0)
    assert len(summary["paired_differences"]) == 21
    pair = next(p for p in summary["paired_differences"] if p["strategies"] == ["none", "nlp"])
    means = [summary["strategies"][name]["rms_mm"]["mean"] for name in pair["strategies"]]
    assert pair["rms_mm"]["mean"] == pytest.approx(means[1] - means[0])
    assert pair["rms_mm"]["ci95"][1] < 0 and pair["second_better"] == 1.0
    json.dumps(summary)


def test_requests_that_cannot_be_met_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="no strategy named 'luck'"):
        prepare_study(small_study().task, strategies=["luck"])
    with pytest.raises(InputError, match="at least 16"):
        run_study(small_study(), Settings(samples=10, seed=1), workforce=HERE)


@pytest.fixture()
def job_file(tmp_path: Path) -> Path:
    file = tmp_path / "job.toml"
    file.write_text(
        'schema = 1\nname = "short circle"\nrobot = "staubli_tx200"\n'
        '[toolpath]\ngenerator = "circle"\nradius_mm = 20.0\nfeed_mm_s = 20.0\nwaypoints = 16\n'
        "[part]\nposition_mm = [1500.0, 0.0, 183.0]\n"
        '[process]\nmodel = "constant"\nforce_N = [0.0, 300.0, 800.0]\n'
        '[posture]\npreset = "smooth"\n'
        "[noise]\nwrench_level = 0.1\n"
    )
    return file


def test_the_command_writes_numbers_and_page_and_says_them_again(job_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["montecarlo", str(job_file), "--samples", "16", "--out", str(out), "--workers", "1",
                 "--replicates", "4", "--strategies", "none,mirror,secondary_encoder,force_sensor"]  # fmt: skip
    result = CliRunner().invoke(group, arguments, catch_exceptions=False)
    assert result.exit_code == 0 and "with the best strategy" in result.output
    first = (out / "montecarlo.json").read_bytes()
    summary = json.loads(first)
    assert summary["samples"] == 16 and 0 <= summary["sensitivity"]["wrench_level"] <= 1.2
    page = (out / "report.html").read_text()
    for words in ("Which uncertainty matters", "Along the path", "set in the job",
                  "stiffness of the process", "quantised encoders"):  # fmt: skip
        assert words in page, words
    again = CliRunner().invoke(group, arguments, catch_exceptions=False)
    assert again.exit_code == 0 and (out / "montecarlo.json").read_bytes() == first


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--strategies", "luck"], "no strategy named"),
        (["--workers", "1", "--scheduler", "tcp://127.0.0.1:1"], "choose one"),
        (["--replicates", "20"], "at least 40"),
    ],
)
def test_the_command_refuses_in_one_sentence_and_writes_nothing(
    job_file: Path, tmp_path: Path, extra: list[str], message: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises(InputError, match=message):
        arguments = ["montecarlo", str(job_file), "--samples", "16", "--out", str(out), *extra]
        CliRunner().invoke(group, arguments, catch_exceptions=False, standalone_mode=False)
    assert not out.exists()


def test_compare_and_montecarlo_draw_from_one_statement_of_the_robot(tmp_path: Path) -> None:
    """Samples of the same seed leave the same with every strategy."""
    file = tmp_path / "job.toml"
    file.write_text(
        'schema = 1\nname = "circle"\nrobot = "kuka_kr270"\n'
        '[toolpath]\ngenerator = "circle"\nradius_mm = 300.0\nfeed_mm_s = 100.0\nwaypoints = 40\n'
        "[part]\nposition_mm = [1700.0, 0.0, 900.0]\ntouched_off = false\n"
        '[process]\nmodel = "constant"\nforce_N = [440.0, 1370.0, -635.0]\nframe = "base"\n'
        "[plan]\nrotate_about_tool_axis = false\nmax_correction_mm = 10.0\n"
    )
    common = [str(file), "--out", str(tmp_path / "compare")]
    assert CliRunner().invoke(group, ["compare", *common], catch_exceptions=False).exit_code == 0
    common = [str(file), "--samples", str(DRAWS), "--seed", str(SEED), "--workers", "1", "--no-sensitivity",
              "--out", str(tmp_path / "study")]  # fmt: skip
    assert CliRunner().invoke(group, ["montecarlo", *common], catch_exceptions=False).exit_code == 0
    one = json.loads((tmp_path / "compare" / "compare.json").read_text())["strategies"]
    two = json.loads((tmp_path / "study" / "montecarlo.json").read_text())["strategies"]
    assert list(one) == list(two) == [*STRATEGIES, *ONLINE]
    for name, left in one.items():
        drawn, study = left["drawn_rms_mm"], two[name]["rms_mm"]
        assert [drawn["median"], *drawn["median_ci95"], drawn["p95"]] == pytest.approx(
            [study["p50"], *study["p50_ci95"], study["p95"]], rel=1e-9
        )
    # one spring stands for gear and link: link-side encoders leave its link share of .4
    assert one["secondary_encoder"]["rms_mm"] == pytest.approx(0.4 * one["none"]["rms_mm"], rel=0.01)


def test_stated_intervals_hold_as_often_as_they_say() -> None:
    """400 repeated studies of a function with a known mean; binomial test at 1 %."""
    factors = Factors({"five": slice(0, 5)}, ("five",) * 5)
    held = 0
    for seed in range(400):
        points = draw_points(factors, seed, 8, range(64))
        values = np.sqrt((3.0 * points**2).sum(axis=1) * points[:, 0])  # of five coordinates, not additive
        interval = estimate_mean(values, 8)
        held += interval.low <= MEAN <= interval.high
    assert binomtest(held, 400, 0.95).pvalue > 0.01, held


def _reference_mean() -> float:
    from scipy.stats import qmc

    points = qmc.Sobol(5, scramble=True, rng=np.random.default_rng(0)).random_base2(18)
    return float(np.sqrt((3.0 * points**2).sum(axis=1) * points[:, 0]).mean())


MEAN = _reference_mean()


def test_intervals_of_quantiles_and_shares_hold() -> None:
    rng = np.random.default_rng(4)
    held = np.zeros(2)
    for _ in range(400):
        values = rng.exponential(size=120)
        quantile, share = estimate_quantile(values, 0.95), estimate_share(int((values < 1.0).sum()), 120)
        held += [quantile.low <= -np.log(0.05) <= quantile.high, share.low <= 1 - np.exp(-1) <= share.high]
    assert (held >= 400 * 0.95 - 2.6 * np.sqrt(400 * 0.05 * 0.95)).all(), held


def test_spread_out_points_give_narrower_intervals_than_random_ones() -> None:
    factors = list_factors(load_robot("staubli_tx200"), NoiseTable(), state_force(NoiseTable()))
    points = draw_points(factors, 5, 8, range(1024))
    random = np.random.default_rng(5).random(points.shape)
    widths = [estimate_mean(values[:, :6].sum(axis=1), 8).half_width for values in (points, random)]
    assert widths[0] < 0.3 * widths[1]


def test_a_sobol_study_is_continued_not_begun_anew() -> None:
    factors = list_factors(load_robot("staubli_tx200"), NoiseTable(), state_force(NoiseTable()))
    whole = draw_points(factors, 9, 4, range(40))
    parts = [draw_points(factors, 9, 4, range(a, b)) for a, b in ((0, 13), (13, 30), (30, 40))]
    np.testing.assert_array_equal(whole, np.vstack(parts))
    assert ((whole > 0) & (whole < 1)).all()


def test_groups_without_uncertainty_are_left_out() -> None:
    robot = load_robot("kuka_kr270_full")
    factors = list_factors(robot, NoiseTable(), state_force(NoiseTable()))
    assert all(factors.groups)
    quiet = NoiseTable(temperature_K=0.0, wrench_path=0.0)
    assert {"temperature", "wrench_path"}.isdisjoint(list_factors(robot, quiet, state_force(quiet)).groups)


def test_every_default_says_where_it_comes_from() -> None:
    sentences = describe_noise(cone_job(wrench_level=0.3).noise)
    assert len(sentences) == len(NoiseTable.model_fields)
    assert any(s == "noise.wrench_level = 0.3: set in the job" for s in sentences)
    assert sum("assumed" in s for s in sentences) >= len(sentences) - 1


def test_total_indices_of_a_known_function_lie_within_their_intervals() -> None:
    """f = a sum + b product: total shares of the groups in closed form [Homma1996]; the second strategy is constant."""
    names = np.array(["one", "one", "", "two"], dtype=object)
    points = design_points(names, ("one", "two"), 1024, seed=3) - 0.5
    assert points.shape == (4 * 1024, 4) and not points[:, 2].any()
    known = 3.0 * points[:, 0] + points[:, 1] + points[:, 3] + 6.0 * points[:, 0] * points[:, 3]
    values = np.stack([known, np.ones(len(points))]).reshape(2, 4, 1024)
    total, half = estimate_totals(values, seed=3)
    variance = {"one": 10.0 / 12.0, "two": 1.0 / 12.0, "both": 36.0 / 144.0}
    whole = sum(variance.values())
    expected = np.array([variance["one"] + variance["both"], variance["two"] + variance["both"]]) / whole
    assert (np.abs(total[0] - expected) < 1.5 * half[0]).all() and (half[0] < 0.1).all()
    np.testing.assert_array_equal(total[1], 0.0)
