"""What an online strategy is: what it has prepared from its own model, what it reads, and how it answers.

All online strategies have one form. Before the first part is cut a strategy solves its own model for the command that
puts the loaded tool on the path under an expected reading, and for how that command changes with the reading:

    q_command = q + gain (reading - expected)

The answer is exact at the expected reading and first order around it; since the command is a function of the reading
alone, the expansion point carries no knowledge that the strategy does not have. Readings are the strategy's own noisy
sensors; it never sees the cell's parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from compplan.plan.correction_loop import Loop
from compplan.robot import Array
from compplan.uncertainty.touch_off import TouchedPart

Sensor = Literal["force", "encoders", "tracker"]


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
        sensor: What is read: "force" (wrench at the tip, base axes, 6), "encoders" (link-side minus motor-side, nq),
            "tracker" (deviation of the part before, 3), or None.
        gain: Change of the command by the reading. Shape (n, nq, k). [rad or m, per unit of the reading]
        expected: The reading expected. Shape (n, k).
        q_rest: Command without correction, which a correction loop starts from. Shape (n, nq). [rad or m]
        loop: The correction loop that the correction passes through in time, or None.
        parts: Parts that are measured and corrected before the one that is judged.
        touched: The part as it was found by touching, at the posture of the strategy, or None.

    """

    name: str
    knows: str
    measures: str
    commands: str
    q: Array
    feedback: str = "motor"
    beta: Array | None = None
    sensor: Sensor | None = None
    gain: Array | None = None
    expected: Array | None = None
    q_rest: Array | None = None
    loop: Loop | None = None
    parts: int = 0
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
