"""A posture beside the plain one: what gears do while joints travel, in closed form, and the table of the page."""

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.planning.posture.motion import measure_travel_error
from compplan.statics.chain import build_chain


def test_gear_error_counts_where_a_joint_travels_a_period_and_lost_motion_where_it_turns_back(tmp_path):
    length, gear, lost = 1.5, 4e-5, 6e-5
    chain, slides = build_chain(one_joint_arm(tmp_path, length, 1e-5)), np.zeros(1, bool)
    shares = np.full(101, 1 / 101)

    def error(q):
        return measure_travel_error(chain, q[:, None], shares, slides, gear=gear, periods=60.0, lost=lost)

    period = 2 * np.pi / 60
    assert error(np.linspace(0.0, 2 * period, 101)) == pytest.approx(length * gear / np.sqrt(2))
    assert error(np.linspace(0.0, 0.25 * period, 101)) == pytest.approx(0.25 * length * gear / np.sqrt(2))
    assert error(np.full(101, 0.3)) == 0.0
    there_and_back = period * np.r_[np.linspace(0, 1, 51), np.linspace(1, 0, 51)[1:]]
    assert error(there_and_back) == pytest.approx(length * np.hypot(gear / np.sqrt(2), 0.5 * lost))
