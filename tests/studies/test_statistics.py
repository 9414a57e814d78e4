from __future__ import annotations

import numpy as np
from montecarlo_cases import cone_job
from scipy.stats import binomtest

from compplan.job.noise import NoiseTable, describe_noise
from compplan.robot import load_robot
from compplan.studies.sampling import Factors, draw_points, list_factors
from compplan.studies.sensitivity import design_points, estimate_totals
from compplan.studies.summary import estimate_mean, estimate_quantile, estimate_share, trace_convergence


def test_stated_intervals_hold_as_often_as_they_say() -> None:
    """400 repeated studies of a function with a known mean; binomial test at 1 %."""
    factors = Factors({"five": slice(0, 5)}, {})
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
    factors = list_factors(load_robot("staubli_tx200"), NoiseTable())
    points = draw_points(factors, 5, 8, range(1024))
    random = np.random.default_rng(5).random(points.shape)
    widths = [estimate_mean(values[:, :6].sum(axis=1), 8).half_width for values in (points, random)]
    assert widths[0] < 0.3 * widths[1]


def test_a_sobol_study_is_continued_not_begun_anew() -> None:
    factors = list_factors(load_robot("staubli_tx200"), NoiseTable())
    whole = draw_points(factors, 9, 4, range(40))
    parts = [draw_points(factors, 9, 4, range(a, b)) for a, b in ((0, 13), (13, 30), (30, 40))]
    np.testing.assert_array_equal(whole, np.vstack(parts))
    assert ((whole > 0) & (whole < 1)).all()


def test_groups_without_uncertainty_are_left_out() -> None:
    robot = load_robot("kuka_kr270_full")
    factors = list_factors(robot, NoiseTable())
    assert len(factors.group_names()) == factors.size and all(factors.group_names())
    quiet = NoiseTable(temperature_K=0.0, wrench_path=0.0)
    assert {"temperature", "wrench_path"}.isdisjoint(list_factors(robot, quiet).groups)


def test_every_default_says_where_it_comes_from() -> None:
    sentences = describe_noise(cone_job(wrench_level=0.3).noise)
    assert len(sentences) == len(NoiseTable.model_fields)
    assert any(s == "noise.wrench_level = 0.3: set in the job" for s in sentences)
    assert sum("assumed" in s for s in sentences) >= len(sentences) - 1


def test_the_interval_of_a_mean_narrows_with_the_samples() -> None:
    values = np.random.default_rng(2).normal(size=4096)
    trace = trace_convergence(values, 8)
    assert trace[0][0] < trace[-1][0] == 4096
    assert trace[-1][1].half_width < 0.4 * trace[0][1].half_width


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
