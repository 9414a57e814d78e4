"""The correction loop of [Johra2022]: the plant that its gains fit, and its answers to a load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.reproduce.correction_loop import LITERAL, PID, Loop, Plant, run_loop
from compplan.robot import Array

#: Eqs. (6) to (8) and (17) without the derivative part.
WITHOUT_DERIVATIVE = replace(LITERAL, derivative=0.0)
#: A remaining error beyond this has run away and is held [mm]; errors are shown up to the second.
RUN_AWAY, SHOWN = 1e6, 10.0


def ziegler_nichols_plant(loop: Loop = LITERAL) -> Plant:
    """Find the plant for which Ziegler and Nichols' rule gives a loop's gains (Kc = 0.6 Ku, Ti = Tu / 2, Td = Tu / 8).

    A lag a and a delay L have the gain 1/Ku = 1 / sqrt(1 + (w a)^2) and the phase -pi at w = 2 pi / Tu.
    """
    ultimate, frequency = loop.gain / 0.6, np.pi / loop.integral
    lag = float(np.sqrt(ultimate**2 - 1) / frequency)
    delay = float((np.pi - np.arctan(frequency * lag)) / frequency)
    return Plant(lag, delay)


def fitted_loop() -> Loop:
    """Return the PID loop whose error is taken from where the robot stands, on the plant that its gains fit."""
    return replace(PID, plant=ziegler_nichols_plant(PID))


def simulate_loops(seconds: float = 1.0) -> tuple[Array, dict[str, Array]]:
    """Simulate the error after a load that deflects the tool by 1 mm: time [s], and error by variant [mm]."""
    fitted = fitted_loop()
    loops = {
        "literal": LITERAL,
        "without derivative": WITHOUT_DERIVATIVE,
        f"plant of {fitted.plant.lag * 1e3:.1f} ms lag, {fitted.plant.delay * 1e3:.0f} ms delay": fitted,
    }
    wanted = np.ones(int(seconds / fitted.period))
    time = np.arange(float(len(wanted))) * fitted.period
    return time, {name: _hold(1.0 - run_loop(loop, wanted)) for name, loop in loops.items()}


def _hold(error: Array) -> Array:
    """Hold an error from where it runs away, and show no more than SHOWN of it."""
    away = np.flatnonzero(np.abs(error) > RUN_AWAY)
    if len(away):
        error[away[0] :] = error[away[0] - 1]
    return np.clip(error, -SHOWN, SHOWN)
