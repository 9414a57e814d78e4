from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.reproduce.correction_loop import LITERAL, PI, PID, Loop, Plant, largest_pole, run_loop


def test_the_literal_pid_is_unstable_and_the_others_are_not() -> None:
    assert largest_pole(LITERAL) == pytest.approx(2.29, abs=0.01)
    assert largest_pole(PI) == pytest.approx(0.91, abs=0.005)
    assert largest_pole(PID) < 1
    assert largest_pole(replace(LITERAL, plant=Plant(0.004, 0.01))) > 1


@pytest.mark.parametrize("loop", [PI, PID, Loop(derivative=0.0, plant=Plant(0.0, 0.0), error="sent")])
def test_a_stable_loop_settles_at_the_wanted_correction(loop: Loop) -> None:
    answer = run_loop(loop, np.ones(400))
    assert answer[0] == 0.0
    assert answer[-1] == pytest.approx(1.0, abs=1e-6)


def test_the_filter_of_a_loop_is_its_law_taken_step_by_step() -> None:
    for loop in (LITERAL, PID):
        plant, period = loop.plant, loop.period
        decay = np.exp(-period / plant.lag) if plant.lag else 0.0
        sent, position, total, last = [0.0] * 10, 0.0, 0.0, 0.0
        for attained in run_loop(loop, np.ones(30)):
            assert attained == pytest.approx(position, rel=1e-9)
            error = 1.0 - position
            total += error * period / loop.integral
            sent.append(loop.gain * (error + total + loop.derivative / period * (error - last)))
            late = np.interp(-plant.delay / period, np.arange(-9, 1), sent[-10:])
            position, last = decay * position + (1.0 - decay) * late, error
