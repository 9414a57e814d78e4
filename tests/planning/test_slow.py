"""Where a run is slower than programmed: starting up and coming to rest do not count, slow stretches beside them do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compplan.planning.slow import find_slow_spans

N = 200


class Cut(SimpleNamespace):
    """What a task says of its waypoints."""

    def __len__(self) -> int:
        return N


def run(speed: np.ndarray, feed: float = 0.02, step: float = 2e-4) -> tuple[Any, Any]:
    """A cut from rest to rest with waypoints every 0.2 mm; speed at the waypoints as a share of the feed."""
    mean = np.maximum(0.5 * (speed[1:] + speed[:-1]), 1e-3)
    time = np.r_[0.0, np.cumsum(step / (feed * mean))]
    share = np.r_[mean[0], mean]
    still = np.zeros(N, bool)
    return Cut(nominal=SimpleNamespace(rapid=still), lead=still), SimpleNamespace(
        time=time, share=share, lowered=share < 0.995
    )


def ramp(rows: int) -> np.ndarray:
    """Speed over the path from rest at constant acceleration: the root of the way."""
    return np.sqrt(np.minimum(np.arange(N) / rows, 1.0))


@pytest.mark.parametrize("rows", [1, 3, 10, 60])
def test_starting_up_and_coming_to_rest_are_no_slow_stretches(rows: int) -> None:
    assert find_slow_spans(*run(np.minimum(ramp(rows), ramp(rows)[::-1]))) == []


@pytest.mark.parametrize("rows", [1, 3, 10])
@pytest.mark.parametrize("level", [0.3, 0.9])
def test_a_slow_stretch_that_runs_to_the_end_is_found(rows: int, level: float) -> None:
    slow = np.where(np.arange(N) < 120, 1.0, level)
    ends = np.minimum(ramp(rows), ramp(rows)[::-1])
    for speed, (low, high) in ((slow, (118, 198)), (slow[::-1], (1, 81))):
        (span,) = find_slow_spans(*run(np.minimum(speed, ends)))
        assert low <= span[0] <= low + 2 + rows and high - 2 - rows <= span[1] <= high + 1


def test_a_cut_that_is_slow_all_along_is_one_slow_stretch() -> None:
    (span,) = find_slow_spans(*run(np.minimum(np.minimum(ramp(5), ramp(5)[::-1]), 0.5)))
    assert span[0] < 8 and span[1] > N - 9


def test_a_slow_stretch_in_the_middle_is_found_beside_the_ends() -> None:
    dip = 1.0 - 0.5 * np.exp(-(((np.arange(N) - 100) / 6.0) ** 2))
    (span,) = find_slow_spans(*run(np.minimum(dip, np.minimum(ramp(5), ramp(5)[::-1]))))
    assert 80 < span[0] < 95 and 105 < span[1] < 120
