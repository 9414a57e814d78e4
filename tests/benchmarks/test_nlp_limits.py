"""The job of the figure in docs/concepts/nlp.md: which of its limits the program's solution meets."""

import pytest

from benchmarks.nlp_limits import ACTIVE, measure_shares, solve_job


@pytest.mark.slow
def test_the_job_of_the_figure_gets_shorter_and_meets_the_limits_that_its_page_names() -> None:
    solved = solve_job()
    assert solved.point.time < 0.97 * solved.start.time
    most = {name: float(share.max()) for name, share in measure_shares(solved).items()}
    for name in ("lead", "lean", "tube", "joint range", "velocity", "acceleration", "torque", "programmed feed"):
        assert ACTIVE <= most[name] < 1.001, name
    assert max(most.values()) < 1.001
