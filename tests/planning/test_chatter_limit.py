from __future__ import annotations

import numpy as np
import pytest

from compplan.planning.stability import Modes, compute_depth_limit


def test_the_least_limit_over_the_speeds_is_the_critical_stiffness_of_one_mode() -> None:
    """Tlusty: the critical cutting stiffness of one mode is 2 k z (1 + z), whatever the spindle speed."""
    omega, mass, damping, cutting = 2.0 * np.pi * 100.0, 20.0, 0.03, 1e6
    shape = np.array([[1.0], [0.0], [0.0]]) / np.sqrt(mass)
    modes = Modes(np.array([omega]), shape, np.array([damping]))
    mean = -cutting * np.diag([1.0, 0.0, 0.0])
    scales = np.geomspace(0.01, 100.0, 2000)
    periods = np.linspace(0.6, 0.9, 60) * 2.0 * np.pi / omega
    found = min(compute_depth_limit(mean, period, modes, scales) for period in periods)
    assert found == pytest.approx(2.0 * mass * omega**2 * damping * (1.0 + damping) / cutting, rel=0.02)
