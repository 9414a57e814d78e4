"""Figures of a run: distances, tilt, share within tolerance, path accuracy."""

import numpy as np
import pytest

from compplan.planning.evaluate import Evaluation


def test_figures_are_of_the_cut_alone():
    deviation = np.array([[3e-3, 0, 0], [0, 1e-3, 0], [0, 0, 2e-3]])
    cut = np.array([False, True, True])
    run = Evaluation("cell", deviation, np.tile(np.eye(3), (3, 1, 1)), deviation, np.array([0.5, 0.1, 0.2]), cut)
    assert run.max_deviation == pytest.approx(2e-3)
    assert run.mean_deviation == pytest.approx(1.5e-3)
    assert run.rms_deviation == pytest.approx(np.sqrt(2.5) * 1e-3)
    assert run.max_tilt == 0.2
    assert run.share_within(1.5e-3) == 0.5
