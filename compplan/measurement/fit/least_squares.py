"""A fit by Gauss-Newton: residuals, derivatives, weights that gross outliers cannot pull far, and what they leave over.

Rows of other instruments than a tracker tell one number, or the distance of contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gammaincinv, gammaln, xlogy

from compplan.errors import ConvergenceError, UnknownNameError
from compplan.measurement.observations import CONTACT, DISTANCE, Observations
from compplan.measurement.registration import CONTACTS, Registration
from compplan.robot import Array

POSITION, ORIENTATION, ENCODERS, DISTANCES = range(4)
#: Blocks, and those whose noise the residuals tell: known distances are too few for that.
BLOCKS, TOLD_BLOCKS = 4, 3
#: The residuals never say less than this share of the stated noise: simulated data may hold none.
LEAST_NOISE = 1e-6
State = TypeVar("State")
MAX_STEPS = 40
#: Halvings of a step at most.
HALVINGS = 12
LOSSES = ("least_squares", "huber", "tukey")
EFFICIENCY = 0.95


class System(NamedTuple):
    """Residuals and derivatives at one state; m components a row: 6 of the pose, then the encoders.

    A row that tells one number of the position has it first. Known distances between contacts follow as components of
    the first row of a contact.
    """

    residual: Array  #: Measured minus predicted, zero where nothing was measured. Shape (n, m).
    columns: Array  #: Derivatives of the prediction. Shape (n, m, p).
    sigma: Array  #: Stated standard deviation, infinite where nothing was measured. Shape (n, m).
    block: NDArray[np.int_]  #: Position, orientation, encoders or known distances. Shape (m,).

    @property
    def known(self) -> NDArray[np.bool_]:
        """Tell what was measured. Shape (n, m)."""
        return np.isfinite(self.sigma)

    def whitener(self, noise: Array) -> Array:
        """Take one over the standard deviation, zero where nothing was measured. Shape (n, m)."""
        return 1.0 / (self.sigma * noise[self.block])

    @property
    def seen(self) -> Array:
        """Count what each row saw itself: a known distance between contacts is no part of the row. Shape (n,)."""
        return np.asarray(self.known[:, self.block != DISTANCES].sum(axis=1))

    def distance(self, noise: Array) -> Array:
        """Measure how far what the rows saw lies from the model, in standard deviations. Shape (n,)."""
        away = self.residual * self.whitener(noise)
        return np.asarray(np.linalg.norm(away[:, self.block != DISTANCES], axis=1))

    def temper(self, weights: Array) -> Array:
        """Return the roots of robust weights; known distances keep theirs. Shape (n, m)."""
        return np.where(self.block == DISTANCES, 1.0, np.sqrt(weights)[:, None])


def weigh(system: System, whitener: Array, group: NDArray[np.int_] | None) -> tuple[Array, Array]:
    """Weigh the system; with groups, take off each group's weighted mean first. Shapes (n, m), (n, m, p)."""
    residual, columns = system.residual, system.columns
    if group is not None:
        power = whitener**2
        total = np.zeros((int(group.max()) + 1, power.shape[1]))
        np.add.at(total, group, power)
        share = power / np.where(total > 0, total, 1.0)[group]
        mean, mean_columns = np.zeros_like(total), np.zeros((*total.shape, columns.shape[2]))
        np.add.at(mean, group, share * residual)
        np.add.at(mean_columns, group, share[..., None] * columns)
        residual, columns = residual - mean[group], columns - mean_columns[group]
    return residual * whitener, columns * whitener[..., None]


def stack(columns: Array) -> Array:
    """Put the components of all rows under one another. Shape (n, m, p) -> (n m, p)."""
    n, m, p = columns.shape
    return np.reshape(columns, (n * m, p))


def information(system: System, whitener: Array, group: NDArray[np.int_] | None) -> Array:
    """Build the information matrix A^T W A. Shape (p, p)."""
    flat = stack(weigh(system, whitener, group)[1])
    return np.asarray(flat.T @ flat)


def invert(matrix: Array) -> Array:
    """Invert an information matrix whose parameters differ by orders of magnitude."""
    norms = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(norms, norms)) / np.outer(norms, norms))


def count_spare(system: System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_]) -> Array:
    """Count the measured numbers of each block less what the fit uses up (the trace of the hat matrix). Shape (3,)."""
    columns = weigh(system, whitener, group)[1][:, :, free]
    flat = stack(columns)
    inverse = invert(flat.T @ flat)
    spare = np.zeros(TOLD_BLOCKS)
    for block in range(TOLD_BLOCKS):
        part, known = stack(columns[:, system.block == block]), system.known[:, system.block == block]
        spare[block] = known.sum() - np.sum((part.T @ part) * inverse)
        if group is not None:
            spare[block] -= sum(len(np.unique(group[known[:, c]])) for c in range(known.shape[1]))
    return spare


def scale_noise(
    system: System, noise: Array, free: NDArray[np.bool_], group: NDArray[np.int_] | None, loss: str
) -> Array:
    """Estimate how large the noise is against the stated one, for position, orientation and encoders apart.

    Variance components: residual sum of squares of a block over what the fit leaves of it. Robust losses take the
    median size of the residuals instead. noise: the estimate before, (3,); others as of `iterate_gauss_newton`.
    """
    result, whitener = noise.copy(), system.whitener(noise)
    left = count_spare(system, whitener, group, free)
    residual = weigh(system, whitener, group)[0]
    for block in range(TOLD_BLOCKS):
        columns = system.block == block
        known = system.known[:, columns]
        spare = left[block]
        if not known.any():
            continue
        if loss == "least_squares":
            factor = np.sqrt((residual[:, columns] ** 2).sum() / max(spare, 1.0))
        else:
            told = known.sum(axis=1)
            rows = told == told.max()
            size = np.linalg.norm(residual[rows][:, columns], axis=1)
            factor = robust_scale(size, int(told.max())) / np.sqrt(max(spare / known.sum(), 0.02))
        result[block] = max(noise[block] * factor, LEAST_NOISE)
    return result


def iterate_gauss_newton(
    state: State, linearise: Callable[[State], System], advance: Callable[[State, Array], State], sizes: Array,
    free: NDArray[np.bool_], *, group: NDArray[np.int_] | None, loss: str, sigma: str,
) -> tuple[State, System, Array, int]:  # fmt: skip
    """Step until the values stand still; return state, problem, noise over the stated one by block, and step count.

    Args:
        state: What to begin with.
        linearise: Gives the problem at a state.
        advance: Goes from a state along a step, shape (p,); a ConvergenceError halves the step.
        sizes: Typical sizes of the parameters. Shape (p,).
        free: Which of them are estimated. Shape (p,).
        group: Number of the pose of each row, for differences; None for absolute poses. Shape (n,).
        loss: "least_squares", "huber" or "tukey".
        sigma: "residuals" or "stated".

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


def check_loss(loss: str) -> str:
    """Return a loss that exists.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if loss not in LOSSES:
        raise UnknownNameError("loss", loss, list(LOSSES))
    return loss


def loss_weights(loss: str, distance: Array, count: Array) -> tuple[Array, Array]:
    """Return weights in [0, 1] of rows by how far off they are, and their slopes dw/d(distance). Shape (n,) each.

    distance: norm of a row's residuals over their standard deviations; count: its components that were measured, (n,).
    """
    if check_loss(loss) == "least_squares":
        return np.ones_like(distance), np.zeros_like(distance)
    counts, place = np.unique(count, return_inverse=True)
    c = np.array([tuning_constant(loss, int(m)) if m else 1.0 for m in counts])[place.ravel()]
    if loss == "huber":
        far = distance > c
        safe = np.where(far, distance, 1.0)
        return np.where(far, c / safe, 1.0), np.where(far, -c / safe**2, 0.0)
    u = distance / c
    inside = u < 1
    return np.where(inside, (1 - u**2) ** 2, 0.0), np.where(inside, -4 * u * (1 - u**2) / c, 0.0)


@lru_cache(maxsize=64)
def tuning_constant(loss: str, components: int) -> float:
    """Find the constant at which a loss keeps 95 % efficiency under normal noise in `components` dimensions."""
    scale = np.log(2.0) * (1.0 - 0.5 * components) - gammaln(0.5 * components)

    def density(d: float) -> float:
        return float(np.exp(scale + xlogy(components - 1.0, d) - 0.5 * d**2))

    def efficiency(c: float) -> float:
        def expect(g: object) -> float:
            return float(quad(lambda d: g(d) * density(d), 0, 12 + components, limit=200, points=[c])[0])  # type: ignore[operator]

        def weight(d: float) -> float:
            return (1.0 if d <= c else c / d) if loss == "huber" else max(0.0, 1 - (d / c) ** 2) ** 2

        def slope(d: float) -> float:
            if loss == "huber":
                return 0.0 if d <= c else -c / d**2
            return -4 * d / c**2 * max(0.0, 1 - (d / c) ** 2)

        spread = expect(lambda d: (weight(d) * d) ** 2) / components
        return expect(lambda d: weight(d) + slope(d) * d / components) ** 2 / spread - EFFICIENCY

    return float(brentq(efficiency, 0.3 * np.sqrt(components), 8 + components, xtol=1e-4))


def robust_scale(residual: Array, components: int = 1) -> float:
    """Estimate the standard deviation of residuals about zero from their median size."""
    size = np.abs(residual[np.isfinite(residual)])
    return float(np.median(size) / np.sqrt(2.0 * gammaincinv(0.5 * components, 0.5))) if len(size) else 1.0


def observe_rows(system: System, sights: Observations, frames: Registration, position: Array) -> System:
    """Put the one number of a row that tells no more first, and known distances beside the first row of a contact.

    system: positions first, measuring axes, places of contacts last where they are fitted; position: measured points as
    predicted, measuring frame, (n, 3). [m]
    """
    residual, columns, sigma = system.residual.copy(), system.columns.copy(), system.sigma.copy()
    R = frames.base[:3, :3]
    direction = sights.directions((position - frames.base[:3, 3]) @ R, frames.places) @ R.T
    one = np.isfinite(direction).all(axis=1)
    residual[one, 0] = np.einsum("ni,ni->n", direction[one], residual[one, :3])
    columns[one, 0] = np.einsum("ni,nip->np", direction[one], columns[one, :3])
    residual[one, 1:3], columns[one, 1:3], sigma[one, 1:3] = 0.0, 0.0, np.inf
    if CONTACTS not in frames.parts or not len(sights.known):
        return System(residual, columns, sigma, system.block)
    known, first = sights.known, (sights.first_rows(), np.arange(len(sights.known)))
    extra, spread = np.zeros((len(residual), len(known))), np.full((len(residual), len(known)), np.inf)
    slopes = np.zeros((*extra.shape, columns.shape[2]))
    own = known.slopes(frames.places).reshape(len(known), -1)
    extra[first], spread[first] = known.gap(frames.places), known.sigma
    slopes[(*first, slice(columns.shape[2] - own.shape[1], None))] = own
    return System(
        np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1),
        np.hstack([sigma, spread]), np.r_[system.block, np.full(len(known), DISTANCES)],
    )  # fmt: skip


def forget_turns(system: System, sights: Observations | None, frames: Registration) -> System:
    """Take out of the derivatives what only seems to tell how the whole arm is turned about its base.

    Contacts and ball bars look the same however the base is turned with their unknown places: a turn w moves what is
    left of a contact's row, r, by w x r, which is noise. Left in, it would tell the turn to one radian over the root of
    the number of rows.
    """
    if sights is None or CONTACTS not in frames.parts or not np.isin(sights.kind, (CONTACT, DISTANCE)).all():
        return system
    contact, turns = sights.kind == CONTACT, np.zeros((*system.residual.shape, 3))
    turns[contact, :3] = np.swapaxes(np.cross(np.eye(3)[None], system.residual[contact, None, :3]), 1, 2)
    basis, flat = np.linalg.qr(stack(turns))[0], stack(system.columns)
    return system._replace(columns=(flat - basis @ (basis.T @ flat)).reshape(system.columns.shape))
