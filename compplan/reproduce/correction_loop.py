"""Time response of an online correction loop: PI or PID law at a fixed rate, robot with lag and delay.

From [Johra2022]: a demanded correction u (from the deflection that the model predicts under the measured force) passes
through a discrete PID law; the robot follows the sent corrections with a lag and a delay. The error of the law is taken
either from the last sent correction ("sent") or from the attained correction of the robot ("attained"). The loop is
linear, a filter from demanded to attained correction, without limiter and anti-windup.

The law as printed in the paper (PID, error from the correction sent one period before) has a pole of 2.29 and is
unstable. Without its derivative part it is stable (0.91). The PID is stable if its error is that of the attained
correction, on the plant that fits its gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyadd
from scipy.signal import lfilter

from compplan.robot import Array

#: Error above which a diverging response is held constant, and greatest shown error. [mm]
RUN_AWAY, SHOWN = 1e6, 10.0


@dataclass(frozen=True)
class Plant:
    """Response of a robot to corrections: lag [s] and delay [s]."""

    lag: float = 0.0135
    delay: float = 0.037


@dataclass(frozen=True)
class Loop:
    """A correction loop."""

    gain: float = 0.8  #: Proportional gain.
    integral: float = 0.048  #: Integral time. [s]
    derivative: float = 0.012  #: Derivative time, 0 for a PI law. [s]
    plant: Plant = Plant()  #: Response of the robot.
    #: Correction in the error of the law: "sent" one period before, or "attained".
    error: Literal["sent", "attained"] = "attained"
    period: float = 0.01  #: Period of the law. [s]

    @property
    def law(self) -> tuple[Array, Array]:
        """The law as a fraction of polynomials in 1/z: error -> correction sent one period later."""
        i, d = self.period / self.integral, self.derivative / self.period
        proportional = np.array([1.0 + i + d, -1.0 - 2.0 * d, d]) * self.gain
        return np.r_[0.0, proportional], np.array([1.0, -1.0])

    @property
    def robot(self) -> tuple[Array, Array]:
        """The robot as a fraction of polynomials in 1/z: correction sent -> correction attained."""
        if self.plant.lag <= 0.0 and self.plant.delay <= 0.0:
            return np.ones(1), np.ones(1)
        decay = float(np.exp(-self.period / self.plant.lag)) if self.plant.lag > 0.0 else 0.0
        whole = int(self.plant.delay / self.period)
        share = self.plant.delay / self.period - whole
        return (1.0 - decay) * np.r_[np.zeros(whole), 1.0 - share, share], np.array([1.0, -decay])


def loop_fraction(loop: Loop) -> tuple[Array, Array]:
    """Return the filter from demanded to attained correction as numerator and denominator in 1/z."""
    top, bottom = loop.law
    robot_top, robot_bottom = loop.robot
    if loop.error == "sent":
        return np.convolve(top, robot_top), np.convolve(polyadd(bottom, top), robot_bottom)
    open_top, open_bottom = np.convolve(top, robot_top), np.convolve(bottom, robot_bottom)
    return open_top, np.asarray(polyadd(open_bottom, open_top), float)


def largest_pole(loop: Loop) -> float:
    """Return the magnitude of the largest pole of a loop; the loop is stable below 1."""
    bottom = np.trim_zeros(loop_fraction(loop)[1], "b")
    return float(np.abs(np.roots(bottom)).max(initial=0.0))


#: The law as printed, on a robot without lag and delay: unstable.
LITERAL = Loop(plant=Plant(0.0, 0.0), error="sent")
#: Eqs. (6) to (8) and (17) without the derivative part.
WITHOUT_DERIVATIVE = replace(LITERAL, derivative=0.0)


def ziegler_nichols_plant(loop: Loop = LITERAL) -> Plant:
    """Compute the plant for which the Ziegler-Nichols rule gives the gains (Kc = 0.6 Ku, Ti = Tu / 2, Td = Tu / 8).

    A lag a and a delay L have the gain 1/Ku = 1 / sqrt(1 + (w a)^2) and the phase -pi at w = 2 pi / Tu.
    """
    ultimate, frequency = loop.gain / 0.6, np.pi / loop.integral
    lag = float(np.sqrt(ultimate**2 - 1) / frequency)
    delay = float((np.pi - np.arctan(frequency * lag)) / frequency)
    return Plant(lag, delay)


def fitted_loop() -> Loop:
    """Return the PID loop with the error of the attained correction, on the plant that fits its gains."""
    return replace(Loop(), plant=ziegler_nichols_plant(Loop()))


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
    return time, {name: _hold(1.0 - lfilter(*loop_fraction(loop), wanted)) for name, loop in loops.items()}


def _hold(error: Array) -> Array:
    """Hold an error constant once it diverges, and clip it to SHOWN."""
    away = np.flatnonzero(np.abs(error) > RUN_AWAY)
    if len(away):
        error[away[0] :] = error[away[0] - 1]
    return np.clip(error, -SHOWN, SHOWN)
