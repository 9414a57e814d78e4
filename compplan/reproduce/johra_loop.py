"""The correction loop of [Johra2022]: poles and responses of its PID law, literal and with a plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.robot import Array

SAMPLE_S = 0.01


@dataclass(frozen=True)
class Gains:
    """PID gains: gain, integral time [s], derivative time [s]."""

    gain: float
    integral: float
    derivative: float


@dataclass(frozen=True)
class Plant:
    """A robot that follows corrections with a lag and a delay. [s]."""

    lag: float
    delay: float


GAINS = Gains(0.8, 0.048, 0.012)


def largest_pole_literal(gains: Gains = GAINS) -> float:
    """Compute the largest pole of eqs. (6) to (8) and (17) with one sample of delay.

    eps_k = -xi_k - delta, xi_(k+1) = Kc (eps_k + T/Ti sum eps + Td/T (eps_k - eps_(k-1))), so that
    z^2 (z - 1) + Kc (z (z - 1) + T/Ti z^2 + Td/T (z - 1)^2) = 0.
    """
    i, d = SAMPLE_S / gains.integral, gains.derivative / SAMPLE_S
    law = np.array([1 + i + d, -1 - 2 * d, d])
    return _largest(np.array([1.0, -1, 0, 0]) + gains.gain * np.r_[0.0, law])


def largest_pole_pi(gains: Gains = GAINS) -> float:
    """Compute the largest pole of the same loop without its derivative part."""
    return largest_pole_literal(Gains(gains.gain, gains.integral, 0.0))


def ziegler_nichols_plant(gains: Gains = GAINS) -> Plant:
    """Find the plant for which Ziegler and Nichols' rule gives these gains (Kc = 0.6 Ku, Ti = Tu / 2, Td = Tu / 8).

    A lag a and a delay L have the gain 1/Ku = 1 / sqrt(1 + (w a)^2) and the phase -pi at w = 2 pi / Tu.
    """
    ultimate, frequency = gains.gain / 0.6, np.pi / gains.integral
    lag = float(np.sqrt(ultimate**2 - 1) / frequency)
    delay = float((np.pi - np.arctan(frequency * lag)) / frequency)
    return Plant(lag, delay)


def largest_pole_plant(plant: Plant, gains: Gains = GAINS) -> float:
    """Compute the largest pole of the loop when the error is taken from where the robot stands."""
    return float(np.abs(np.linalg.eigvals(_loop_matrix(plant, gains))).max())


def simulate_loop(plant: Plant, seconds: float = 1.0) -> tuple[Array, dict[str, Array]]:
    """Simulate the error after a load that deflects the tool by 1 mm: time [s], and error by variant [mm]."""
    count = int(seconds / SAMPLE_S)
    time = np.arange(float(count)) * SAMPLE_S
    responses = {
        "literal": _simulate_literal(GAINS, count),
        "without derivative": _simulate_literal(Gains(GAINS.gain, GAINS.integral, 0.0), count),
        f"plant of {plant.lag * 1e3:.1f} ms lag, {plant.delay * 1e3:.0f} ms delay": _simulate_plant(plant, count),
    }
    return np.asarray(time), {name: np.clip(values, -10, 10) for name, values in responses.items()}


def _largest(polynomial: Array) -> float:
    return float(np.abs(np.roots(polynomial)).max())


def _simulate_literal(gains: Gains, count: int) -> Array:
    correction, total, last = 0.0, 0.0, 0.0
    errors = np.empty(count)
    for k in range(count):
        error = -correction - 1.0
        total += error * SAMPLE_S / gains.integral
        slope = gains.derivative / SAMPLE_S * (error - last)
        correction, last = gains.gain * (error + total + slope), error
        errors[k] = error
        if abs(correction) > 1e6:
            errors[k:] = np.sign(error) * 1e6
            break
    return -errors


def _loop_matrix(plant: Plant, gains: Gains) -> Array:
    """Build the state matrix: position of the robot, delayed corrections, sum of errors, last error."""
    decay, steps, share = _delays(plant)
    size = 1 + steps + 1 + 2
    i, d = SAMPLE_S / gains.integral, gains.derivative / SAMPLE_S
    matrix = np.zeros((size, size))
    total, last, newest = size - 2, size - 1, 1
    matrix[0, 0] = decay
    matrix[0, steps] += (1 - decay) * (1 - share)
    matrix[0, steps + 1] += (1 - decay) * share
    matrix[total, 0], matrix[total, total] = -i, 1.0
    matrix[last, 0] = -1.0
    matrix[newest] = gains.gain * (matrix[total] + (1 + d) * matrix[last])
    matrix[newest, last] -= gains.gain * d
    for k in range(2, steps + 2):
        matrix[k, k - 1] = 1.0
    return matrix


def _delays(plant: Plant) -> tuple[float, int, float]:
    """Split the delay into whole samples and a share of one more."""
    steps = int(plant.delay / SAMPLE_S)
    return float(np.exp(-SAMPLE_S / plant.lag)), max(steps, 1), plant.delay / SAMPLE_S - steps


def _simulate_plant(plant: Plant, count: int) -> Array:
    decay, steps, share = _delays(plant)
    position, total, last = 0.0, 0.0, 0.0
    corrections = np.zeros(steps + 1)
    errors = np.empty(count)
    for k in range(count):
        error = -position - 1.0
        total += error * SAMPLE_S / GAINS.integral
        slope = GAINS.derivative / SAMPLE_S * (error - last)
        position = decay * position + (1 - decay) * ((1 - share) * corrections[-2] + share * corrections[-1])
        corrections = np.r_[GAINS.gain * (error + total + slope), corrections[:-1]]
        last = error
        errors[k] = error
    return -errors
