"""Gauss-Newton steps of a fit until its values stand still against their standard errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError
from compplan.measurement.fit.linear_system import BLOCKS, System, invert, scale_noise, stack, weigh
from compplan.measurement.fit.robust import loss_weights
from compplan.robot import Array

State = TypeVar("State")
MAX_STEPS = 40
#: Halvings of a step at most.
HALVINGS = 12


def iterate_gauss_newton(
    state: State, linearise: Callable[[State], System], advance: Callable[[State, Array], State], sizes: Array,
    free: NDArray[np.bool_], *, group: NDArray[np.int_] | None, loss: str, sigma: str,
) -> tuple[State, System, Array, int]:  # fmt: skip
    """Step until the values stand still.

    Args:
        state: What to begin with.
        linearise: Gives the problem at a state.
        advance: Goes from a state along a step, shape (p,); a ConvergenceError halves the step.
        sizes: Typical sizes of the parameters. Shape (p,).
        free: Which of them are estimated. Shape (p,).
        group: Number of the pose of each row, for differences; None for absolute poses. Shape (n,).
        loss: "least_squares", "huber" or "tukey".
        sigma: "residuals" or "stated".

    Returns:
        The state, the problem there, the noise against the stated one of each block, and the steps taken.

    Raises:
        ConvergenceError: If the values do not settle.
    """
    system, noise, previous = linearise(state), np.ones(BLOCKS), np.inf
    for count in range(1, MAX_STEPS + 1):
        if sigma == "residuals":
            noise = scale_noise(system, noise, free, group, loss)
        weights = loss_weights(loss, system.distance(noise), system.seen)[0]
        residual, columns = weigh(system, system.whitener(noise) * system.temper(weights), group)
        flat = stack(columns[:, :, free])
        inverse = invert(flat.T @ flat)
        step = np.zeros(len(free))
        step[free] = inverse @ (flat.T @ residual.ravel())
        state = _go_along(state, step, advance)
        system = linearise(state)
        strides = np.abs(step[free]) / (1e-9 * sizes[free] + 1e-3 * np.sqrt(np.diag(inverse)))
        size = float(strides.max(initial=0.0))
        if size < 1 or (count > 8 and size < 1e3 and size > 0.5 * previous):
            if sigma == "residuals":
                noise = scale_noise(system, noise, free, group, loss)
            return state, system, noise, count
        previous = size
    raise ConvergenceError("the fit did not settle; leave parameters out or check units and frames", residual=size)


def _go_along(state: State, step: Array, advance: Callable[[State, Array], State]) -> State:
    for _ in range(HALVINGS):
        try:
            return advance(state, step)
        except ConvergenceError:
            step = 0.5 * step
    raise ConvergenceError("the fitted robot buckles under its loads; check the units of the wrench", residual=np.inf)
