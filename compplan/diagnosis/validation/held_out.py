"""Cross-validation: errors on poses left out of the fit, predicted by the robot as read from its folder.

Registered frames belong to the campaign, not to the robot; a later campaign has other ones. They are therefore fitted
to the held-out errors of all rows at once; errors are enlarged by the part that this fit absorbs with few poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from compplan.diagnosis.data.channels import block_index, group_poses, position_residual
from compplan.diagnosis.data.shared import ENOUGH_ROWS, LEVEL, rms_length
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import find_posterior
from compplan.diagnosis.evidence.normal_equations import NormalEquations, select_rows
from compplan.diagnosis.search.fit import register_again
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState, has_equilibrium
from compplan.effects import apply_effects, build_model, fold_effects, robot_effects, solve_model_poses
from compplan.errors import ConvergenceError, InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import CONTACTS
from compplan.robot import Array, as_read

#: Number of folds, and consecutive blocks that stay in one fold (assumed: neighbours in time share drifts).
FOLDS, RUN_OF_BLOCKS = 5, 3
#: Least ratio of the stated error to the true one in 95 % of cases (assumed: a quarter more than stated is tolerable).
UNDERSTATED = 0.8


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals of rows left out of the fit: rows of the campaign (r,), measured minus predicted (r, 3). [m]"""

    rows: NDArray[np.int_]
    residual: Array

    @property
    def rms(self) -> float:
        """Root mean square distance. [m]"""
        return rms_length(self.residual)

    def of(self, seen: NDArray[np.bool_]) -> HeldOut:
        """Return the residuals of selected rows. Shape of `seen`: (r,)."""
        return HeldOut(self.rows[seen], self.residual[seen])

    def correct_for_selection(self, fold: NDArray[np.int_], seen: NDArray[np.bool_]) -> HeldOut:
        """Enlarge residuals that may be small by chance because there are few folds.

        Logarithms of the folds' mean squares m_f are nearly normal, and the true one lies below its upper 95 % limit

            exp(mean-square's log + t_{k-1} s sqrt(1 / k + 1 / (k - 1))),

        s the deviation of log m_f over k folds; the fits of the folds share most of their rows, which adds the second
        term [NadeauBengio2003]. The stated error is at least UNDERSTATED of that limit. `seen`: rows (r,) that are not
        outliers.
        """
        folds = [self.of(seen & (fold == number)).rms for number in np.unique(fold[seen])]
        count, logs = len(folds), 2.0 * np.log(np.maximum(folds, 1e-300))
        if count < 2:
            return self
        above = float(stdtrit(count - 1, LEVEL)) * float(logs.std(ddof=1)) * np.sqrt(1.0 / count + 1.0 / (count - 1))
        return replace(self, residual=max(1.0, UNDERSTATED * float(np.exp(0.5 * above))) * self.residual)


def make_folds(campaign: Campaign, folds: int = FOLDS) -> NDArray[np.int_]:
    """Assign blocks of neighbouring stays to folds; the same pose is always in the same fold. Shape (n,).

    If all blocks would be in one fold, they are assigned one by one, a single block by its halves.
    """
    block = block_index(campaign)
    # neighbours in time share errors, and in long campaigns neighbouring blocks are neighbours in place, too
    run = max(RUN_OF_BLOCKS, len(np.unique(block)) // ENOUGH_ROWS)
    fold = (block // run) % folds
    if not fold.any():
        fold = block % folds if block.any() else np.arange(len(block)) * 2 // max(len(block), 1)
    static = ~campaign.on_path
    _, first = np.unique(campaign.pose, return_index=True)
    return np.where(static, fold[first[campaign.pose]], fold)


@dataclass(frozen=True, eq=False)
class Folds:
    """A fit and the fold of each row of its campaign, shape (n,)."""

    fit: Fit
    fold: NDArray[np.int_]

    @cached_property
    def pose(self) -> NDArray[np.int_]:
        """Pose, or block of a path, of each predicted row. Shape (r,)."""
        return group_poses(self.fit.problem.campaign)[self.fit.search.equations.source[0].rows]

    @cached_property
    def numbers(self) -> list[int]:
        """Numbers of the folds."""
        return [int(number) for number in np.unique(self.fold[self.fit.search.equations.source[0].rows])]

    def hold_out(self, build: Callable[[int], FitState]) -> HeldOut:
        """Predict every row with the exact model of a fit to the other folds."""
        fit, rows = self.fit, self.fit.search.equations.source[0].rows
        campaign, residual = fit.problem.campaign, np.zeros((len(self.fold), 3))
        for number in self.numbers:
            state = build(number)
            if fit.problem.register and has_equilibrium(fit.problem, state):
                # frames turn far and are fitted exactly, to rows of the fit; contacts use all rows, since few rows may
                # not determine their place (frames are fitted to all below in any case)
                contacts = CONTACTS in fit.problem.register
                state = register_again(fit, state, fit.state.use & (contacts | (self.fold != number)))
            gap = predict_gap(fit, state)
            if gap is None:
                gap = np.where(campaign.measured[:, None], campaign.position, np.inf)
            test = self.fold == number
            residual[test] = gap[test]
        return HeldOut(rows, fit_frames(fit, residual[rows], len(np.unique(self.pose))))

    def hold_out_linear(self, claim: Claim) -> HeldOut:
        """Predict every row to first order by one claim, without small errors; enough to rank candidates."""
        search, hyper = self.fit.search, self.fit.model.posterior.hyper
        whole, prior = search.equations, search.prior_of([claim])
        prior = replace(prior, background=np.full_like(prior.background, -1))
        rows, left = whole.source[0].rows, np.zeros_like(whole.observed[0])
        for number in self.numbers:
            part = replace(whole, channels=select_rows(whole, self.fold != number, prior.active))
            found = find_posterior(part, prior.of(prior.active), hyper, fit=False)
            test = self.fold[rows] == number
            left[test] = whole.observed[0][test] - whole.designs[0][test][..., prior.active] @ found.mean
        return HeldOut(rows, left * whole.source[0].sigma)


def fit_frames(fit: Fit, residual: Array, poses: int) -> Array:
    """Return errors (r, 3) as in a later campaign of many poses with its frames fitted to them. [m]"""
    if not fit.problem.register:
        return residual
    sigma = fit.search.equations.source[0].sigma
    return np.asarray(free_of_frames(fit, poses) * take_out_frames(fit.search.equations, residual / sigma) * sigma)


def take_out_frames(equations: NormalEquations, left: Array) -> Array:
    """Project the registered frames out of positions, shape (r, 3). In units of the noise."""
    frames = equations.columns_named(REGISTRATION)
    if not len(frames):
        return left
    columns = equations.designs[0][..., frames].reshape(left.size, len(frames))
    values = np.linalg.lstsq(columns, left.reshape(-1), rcond=1e-9)[0]
    return np.asarray(left - (columns @ values).reshape(left.shape))


def spread_held_out(folds: Folds, test: NDArray[np.bool_], slopes: Array, covariance: Array) -> Array:
    """Return the covariance of held-out errors due to columns that predict the rows of one fold. (r, 3, 3) [m^2]

    The frames that are fitted to the errors of all rows spread those of the fold. test: rows of the fold, (r,);
    slopes: their motion by each column, frames included, (n, 3, k) [m]; covariance: of the columns, (k, k).
    """
    fit, equations = folds.fit, folds.fit.search.equations
    sigma, found = equations.source[0].sigma[:, :, None], np.zeros((len(test), 3, 3))
    part = slopes / sigma[test]
    if fit.problem.register:
        frames = equations.designs[0][..., equations.columns_named(REGISTRATION)].reshape(3 * len(test), -1)
        basis, size, _ = np.linalg.svd(frames, full_matrices=False)
        frame = basis[:, size > 1e-9 * size.max()].reshape(len(test), 3, -1)
        share = np.einsum("nic,nik->ck", frame[test], part)
        part = part - frame[test] @ share
        found[~test] = frame[~test] @ (share @ covariance @ share.T) @ np.swapaxes(frame[~test], 1, 2)
    found[test] = part @ covariance @ np.swapaxes(part, 1, 2)
    return np.asarray((free_of_frames(fit, len(np.unique(folds.pose))) * sigma) ** 2 * found)


def free_of_frames(fit: Fit, poses: int) -> float:
    """Return the ratio of errors before and after frames were fitted to the poses that show them.

    Frames of f values that are fitted to n poses leave sqrt(1 - f / 3 n) of the errors on average; in a later campaign
    of many poses they absorb almost nothing.
    """
    if not fit.problem.register:
        return 1.0
    equations = fit.search.equations
    values = equations.source[0].n_values.mean() * poses
    frames = equations.designs[0][..., equations.columns_named(REGISTRATION)]
    used = int(np.linalg.matrix_rank(frames.reshape(-1, frames.shape[-1])))
    return float(np.sqrt(values / max(values - used, 0.5 * values)))


def predict_gap(fit: Fit, state: FitState) -> Array | None:
    """Return measured minus predicted positions of the robot as read from its folder. Shape (n, 3). [m]

    None if the folder cannot be read, or its robot has no equilibrium.
    """
    problem = fit.problem
    try:
        read = as_read(fold_effects(problem.robot, state.effects[len(robot_effects(problem.robot)) :]))
        scene = build_model(read, problem.campaign, registration=state.registration)
        scene = apply_effects(scene, robot_effects(read))
        attained = solve_model_poses(scene)
    except (ConvergenceError, InputError):
        return None
    gap = position_residual(problem.campaign, scene, attained)
    return gap if np.isfinite(gap[problem.campaign.usable]).all() else None
