"""Likeness: what a wrong name leaves moves the target as the name does, what a right one leaves does not."""

import numpy as np
import pytest
from scipy.stats import f as fisher

from compplan.diagnosis.validation.calibrated_probability import Evidence, calibrate_probability, measure_similarity

POSES = 40
POSE = np.arange(POSES)


def draw_motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a claim's motion with a direction and a size of its own at every pose, and its unit vectors."""
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(POSES, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return unit * rng.normal(size=(POSES, 1)), unit


def test_noise_alone_leaves_more_than_chance_in_one_campaign_of_twenty() -> None:
    rng = np.random.default_rng(2)
    rated = [measure_similarity(rng.normal(size=(POSES, 3)), draw_motion(seed)[0], POSE) for seed in range(400)]
    # of 400, 20 +- 4.4 are above nothing
    assert 7 <= np.sum(np.array(rated) > 0.0) <= 33


def test_an_error_along_the_motion_is_alike_whatever_its_shape_over_the_poses() -> None:
    rng = np.random.default_rng(3)
    motion, unit = draw_motion(0)
    noise = 0.1 * rng.normal(size=(POSES, 3))
    step = np.where(POSE < POSES // 2, 1.0, -1.0)[:, None]
    across = np.cross(unit, [0.0, 0.0, 1.0])
    size = np.sqrt(np.mean(np.sum(motion**2, axis=1)))
    assert np.isclose(measure_similarity(noise + step * unit, motion, POSE), 1.0 / size, rtol=0.1)
    assert measure_similarity(noise + step * across, motion, POSE) == 0.0


def test_the_likeness_is_what_is_left_beyond_fishers_point_over_the_motion() -> None:
    motion = np.tile([2.0, 0.0, 0.0], (POSES, 1))
    left = np.tile([3.0, 1.0, 1.0], (POSES, 1))
    beyond = 9.0 - fisher.ppf(0.95, POSES, 2 * POSES)
    assert np.isclose(measure_similarity(left, motion, POSE), np.sqrt(beyond) / 2.0)


@pytest.mark.parametrize("times", [4, 25])
def test_the_likeness_of_a_large_part_does_not_grow_with_the_number_of_poses(times: int) -> None:
    motion, _ = draw_motion(1)
    left = 0.5 * motion
    more = np.tile(left, (times, 1)), np.tile(motion, (times, 1))
    once = measure_similarity(left, motion, POSE)
    assert np.isclose(once, 0.5)
    assert np.isclose(measure_similarity(*more, np.arange(times * POSES)), once)


def test_rows_of_one_pose_count_as_one_and_rows_at_rest_not_at_all() -> None:
    motion, _ = draw_motion(1)
    left = np.random.default_rng(4).normal(size=(POSES, 3)) + motion
    once = measure_similarity(left, motion, POSE)
    assert once > 0.0
    assert np.isclose(measure_similarity(np.tile(left, (3, 1)), np.tile(motion, (3, 1)), np.tile(POSE, 3)), once)
    still = np.concatenate([motion, np.zeros((5, 3))]), np.concatenate([left, np.ones((5, 3))])
    assert np.isclose(measure_similarity(still[1], still[0], np.arange(POSES + 5)), once)
    assert measure_similarity(left, np.zeros((POSES, 3)), POSE) == 0.0


def test_a_claim_whose_rest_moves_as_it_does_is_stated_less_surely() -> None:
    def rate(likeness: float) -> float:
        return calibrate_probability(Evidence(10.0, 10.0, 4.0, 0.9, 0.1, likeness))

    assert rate(0.9) < rate(0.4) < rate(0.1)
    assert rate(0.01) == rate(0.1)
    assert rate(1e3) == rate(1.0)
