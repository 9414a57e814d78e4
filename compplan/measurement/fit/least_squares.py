"""Robust Gauss-Newton fit: residuals, derivatives, robust weights, and degrees of freedom.

Rows of instruments other than a tracker have one component, or the distance between contacts.
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
#: Blocks, and those whose noise is estimated from residuals: known distances are too few.
BLOCKS, NOISE_BLOCKS = 4, 3
#: Least estimated noise relative to the stated one: simulated data may have none.
LEAST_NOISE = 1e-6
State = TypeVar("State")
MAX_STEPS = 40
#: Greatest number of halvings of a step.
HALVINGS = 12
LOSSES = ("least_squares", "huber", "tukey")
EFFICIENCY = 0.95


class System(NamedTuple):
    """Residuals and derivatives at one state; m components per row: 6 of the pose, then the encoders.

    An observation of one component is stored as the first one. Known distances between contacts follow as components
    of the first row of a contact.
    """

    residual: Array  #: Measured minus predicted, zero if not measured. Shape (n, m).
    columns: Array  #: Derivatives of the prediction. Shape (n, m, p).
    sigma: Array  #: Stated standard deviation, infinite if not measured. Shape (n, m).
    block: NDArray[np.int_]  #: Position, orientation, encoders or known distances. Shape (m,).

    @property
    def known(self) -> NDArray[np.bool_]:
        """Return which components were measured. Shape (n, m)."""
        return np.isfinite(self.sigma)

    def whitener(self, noise: Array) -> Array:
        """Return the inverse of the standard deviation, zero if not measured. Shape (n, m)."""
        return 1.0 / (self.sigma * noise[self.block])

    @property
    def count_measured(self) -> Array:
        """Return the number of measured components of each row, without known distances. Shape (n,)."""
        return np.asarray(self.known[:, self.block != DISTANCES].sum(axis=1))

    def distance(self, noise: Array) -> Array:
        """Return the norm of the residuals of each row in standard deviations, without known distances. Shape (n,)."""
        away = self.residual * self.whitener(noise)
        return np.asarray(np.linalg.norm(away[:, self.block != DISTANCES], axis=1))

    def temper(self, weights: Array) -> Array:
        """Return the square roots of robust weights, 1 for known distances. Shape (n, m)."""
        return np.where(self.block == DISTANCES, 1.0, np.sqrt(weights)[:, None])


def weigh(system: System, whitener: Array, group: NDArray[np.int_] | None) -> tuple[Array, Array]:
    """Weight residuals and derivatives, minus the weighted mean of each group if given. Shapes (n, m), (n, m, p)."""
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
    """Stack the components of all rows. Shape (n, m, p) -> (n m, p)."""
    n, m, p = columns.shape
    return np.reshape(columns, (n * m, p))


def information(system: System, whitener: Array, group: NDArray[np.int_] | None) -> Array:
    """Build the information matrix A^T W A. Shape (p, p)."""
    flat = stack(weigh(system, whitener, group)[1])
    return np.asarray(flat.T @ flat)


def invert(matrix: Array) -> Array:
    """Invert an information matrix with scaling, as parameters differ by orders of magnitude."""
    norms = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(norms, norms)) / np.outer(norms, norms))


def count_dof(system: System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_]) -> Array:
    """Return the residual degrees of freedom of each block: measured numbers minus trace of the hat matrix. (3,)."""
    columns = weigh(system, whitener, group)[1][:, :, free]
    flat = stack(columns)
    inverse = invert(flat.T @ flat)
    spare = np.zeros(NOISE_BLOCKS)
    for block in range(NOISE_BLOCKS):
        part, known = stack(columns[:, system.block == block]), system.known[:, system.block == block]
        spare[block] = known.sum() - np.sum((part.T @ part) * inverse)
        if group is not None:
            spare[block] -= sum(len(np.unique(group[known[:, c]])) for c in range(known.shape[1]))
    return spare


def scale_noise(
    system: System, noise: Array, free: NDArray[np.bool_], group: NDArray[np.int_] | None, loss: str
) -> Array:
    """Estimate the ratio of actual to stated noise, separately for position, orientation and encoders.

    Variance components: residual sum of squares of a block over its degrees of freedom. Robust losses use the median
    size of the residuals instead. noise: previous estimate, (4,); others: see `iterate_gauss_newton`.
    """
    result, whitener = noise.copy(), system.whitener(noise)
    left = count_dof(system, whitener, group, free)
    residual = weigh(system, whitener, group)[0]
    for block in range(NOISE_BLOCKS):
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
    """Iterate to convergence; return state, system, ratio of actual to stated noise by block, and step count.

    Args:
        state: Initial state.
        linearise: Returns the system at a state.
        advance: Returns a state moved by a step, shape (p,); a ConvergenceError halves the step.
        sizes: Typical sizes of the parameters. Shape (p,).
        free: Mask of the estimated parameters. Shape (p,).
        group: Number of the pose of each row, for differences; None for absolute poses. Shape (n,).
        loss: "least_squares", "huber" or "tukey".
        sigma: "residuals" or "stated".

    Raises:
        ConvergenceError: If the iteration does not converge.
    """
    system, noise, previous = linearise(state), np.ones(BLOCKS), np.inf
    for count in range(1, MAX_STEPS + 1):
        if sigma == "residuals":
            noise = scale_noise(system, noise, free, group, loss)
        weights = loss_weights(loss, system.distance(noise), system.count_measured)[0]
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
    raise ConvergenceError("the fit did not converge; check units and frames, or fit fewer parameters", residual=size)


def _go_along(state: State, step: Array, advance: Callable[[State, Array], State]) -> State:
    for _ in range(HALVINGS):
        try:
            return advance(state, step)
        except ConvergenceError:
            step = 0.5 * step
    raise ConvergenceError("the fitted robot buckles under its loads; check the units of the wrench", residual=np.inf)


def check_loss(loss: str) -> str:
    """Check and return the name of a loss.

    Raises:
        UnknownNameError: If there is no loss of that name.
    """
    if loss not in LOSSES:
        raise UnknownNameError("loss", loss, list(LOSSES))
    return loss


def loss_weights(loss: str, distance: Array, count: Array) -> tuple[Array, Array]:
    """Return robust weights in [0, 1] of rows, and their slopes dw/d(distance). Shape (n,) each.

    distance: norm of the residuals of a row in standard deviations, (n,); count: number of measured components, (n,).
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
    """Return the constant of a loss with 95 % efficiency under normal noise in `components` dimensions."""
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


def observe_rows(system: System, observations: Observations, frames: Registration, position: Array) -> System:
    """Store observations of one component as the first one; add known distances to the first row of a contact.

    system: positions first, measuring axes, contact positions last if fitted; position: predicted measured points,
    measuring frame, (n, 3). [m]
    """
    residual, columns, sigma = system.residual.copy(), system.columns.copy(), system.sigma.copy()
    R = frames.base[:3, :3]
    direction = observations.directions((position - frames.base[:3, 3]) @ R, frames.places) @ R.T
    one = np.isfinite(direction).all(axis=1)
    residual[one, 0] = np.einsum("ni,ni->n", direction[one], residual[one, :3])
    columns[one, 0] = np.einsum("ni,nip->np", direction[one], columns[one, :3])
    residual[one, 1:3], columns[one, 1:3], sigma[one, 1:3] = 0.0, 0.0, np.inf
    if CONTACTS not in frames.parts or not len(observations.known):
        return System(residual, columns, sigma, system.block)
    known, first = observations.known, (observations.first_rows(), np.arange(len(observations.known)))
    extra, spread = np.zeros((len(residual), len(known))), np.full((len(residual), len(known)), np.inf)
    slopes = np.zeros((*extra.shape, columns.shape[2]))
    own = known.slopes(frames.places).reshape(len(known), -1)
    extra[first], spread[first] = known.gap(frames.places), known.sigma
    slopes[(*first, slice(columns.shape[2] - own.shape[1], None))] = own
    return System(
        np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1),
        np.hstack([sigma, spread]), np.r_[system.block, np.full(len(known), DISTANCES)],
    )  # fmt: skip


def project_out_rotations(system: System, observed: Observations | None, frames: Registration) -> System:
    """Remove spurious information on the rotation of the complete arm about its base from the derivatives.

    Contacts and ball bars do not observe a rotation of the base together with their unknown positions: a rotation w
    changes the residual r of a contact by w x r, which is noise. Without this projection the noise would determine the
    rotation to one radian over the square root of the number of rows.
    """
    if observed is None or CONTACTS not in frames.parts or not np.isin(observed.kind, (CONTACT, DISTANCE)).all():
        return system
    contact, turns = observed.kind == CONTACT, np.zeros((*system.residual.shape, 3))
    turns[contact, :3] = np.swapaxes(np.cross(np.eye(3)[None], system.residual[contact, None, :3]), 1, 2)
    basis, flat = np.linalg.qr(stack(turns))[0], stack(system.columns)
    return system._replace(columns=(flat - basis @ (basis.T @ flat)).reshape(system.columns.shape))
