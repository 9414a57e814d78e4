"""A strategy prepared for a task: its command, the feedback that holds the axes, and its response to a sensor.

A strategy with a force sensor solves its own model before the cut for the command that puts the loaded tool on the
path under the expected wrench, and for how that command changes with the measured wrench:

    q_command = q + gain (wrench - expected)

The command is exact at the expected wrench and first order around it. The wrench is that of the strategy's own noisy
sensor; the strategy does not know the parameters of the drawn robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.robot import Array
from compplan.uncertainty.touch_off import TouchedPart


@dataclass(frozen=True)
class Answer:
    """A strategy at work; n waypoints, nq joints.

    Attributes:
        name: Name of the strategy.
        knows: What it knows, in words.
        measures: What it measures, in words.
        commands: What it commands, in words.
        q: Command at the expected reading. Shape (n, nq). [rad or m]
        feedback: Which reading the axes are held by: "motor", "link" or "combined" (`compplan.statics.encoders`).
        beta: Share of combined feedback. Shape (nq,).
        gain: Change of the command per measured wrench at the tip, base axes; None without a force sensor.
            Shape (n, nq, 6). [rad/N, rad/(N m)]
        expected: The wrench expected. Shape (n, 6). [N, N m]
        touched: The part as it was found by touching, at the posture of the strategy, or None.

    """

    name: str
    knows: str
    measures: str
    commands: str
    q: Array
    feedback: str = "motor"
    beta: Array | None = None
    gain: Array | None = None
    expected: Array | None = None
    touched: TouchedPart | None = None

    @property
    def spring_gain(self) -> Array:
        """What the feedback leaves of each gear's deflection: 1, 0 or -beta. Shape (nq,)."""
        nq = self.q.shape[1]
        if self.feedback == "motor":
            return np.ones(nq)
        if self.feedback == "link":
            return np.zeros(nq)
        return -np.broadcast_to(np.asarray(self.beta, float), (nq,))


def answer_reading(gain: Array, reading: Array) -> Array:
    """Answer a reading: gain times reading, components first.

    Args:
        gain: Shape (nq, k, n).
        reading: Reading less the expected one. Shape (k, b, n), b samples.

    Returns:
        Change of the command. Shape (nq, b, n). [rad or m]

    """
    answer = np.zeros((len(gain), *reading.shape[1:]))
    for row, rates in zip(answer, gain, strict=True):
        for rate, part in zip(rates, reading, strict=True):
            row += rate * part
    return answer
