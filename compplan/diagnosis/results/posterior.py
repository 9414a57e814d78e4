"""Posterior: parameter uncertainty of the updated robot, and the error that no parameter explains.

The parameters of named effects and small errors are normal about their mean in the calibration, covariance S. For
parameters absent from the robot folder the mean m counts as well: the second moment about the folder is S + m m^T.

The held-out error beyond noise and parameters is unexplained. The parameters that predict a pose are those fitted
without it: their uncertainty is larger than that of the delivered ones. A conformal step widens both until the band
covers the held-out poses. Intervals of named effects hold given that these, and no others, are present.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from compplan.diagnosis.data.shared import ENOUGH_ROWS, HALF_WIDTH, LEVEL, SAMPLE
from compplan.diagnosis.evidence.candidates import in_background
from compplan.diagnosis.evidence.evidence import Posterior
from compplan.diagnosis.results.verdict import Verdict, drop_insignificant
from compplan.diagnosis.search.state import Fit, FitState, linearize_state
from compplan.diagnosis.validation.calibration import Calibration
from compplan.diagnosis.validation.held_out import Folds, HeldOut, fit_frames, spread_held_out
from compplan.effects import is_of_instrument
from compplan.effects.checks import limit_sizes
from compplan.effects.forward_model import own_springs
from compplan.effects.signature import Effect
from compplan.measurement.distance import calibrate_band
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns, spread_unknowns
from compplan.uncertainty.assumed import restore_prior, robot_uncertainty
from compplan.uncertainty.posture_errors import derive_unknowns

Mask = NDArray[np.bool_]

#: Correlation lengths of an unexplained error to choose from (assumed). [m]
SCALES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.3)
#: Default correlation length if there are too few poses: the middle one. [m]
SCALE = SCALES[len(SCALES) // 2]


def state_uncertainty(folds: Folds, found: Calibration, state: FitState, held: HeldOut, good: Mask) -> Uncertainty:
    """Compute the uncertainty of the calibrated robot.

    Args:
        folds: The fit that was calibrated, and the fold of each row.
        found: Its calibration.
        state: State of the delivered robot.
        held: Residuals of the delivered model on held-out poses.
        good: Rows that are not outliers. Shape (n,).
    """
    fit = folds.fit
    unknowns, columns = _list_unknowns(fit, found)
    equations, posterior = fit.search.equations, found.posterior
    at, scale = np.searchsorted(posterior.columns, columns), equations.scale[columns]
    absent = np.array([state.values.get(equations.names[c], 0.0) == 0.0 for c in columns], bool)
    missing = np.where(absent, posterior.mean[at], 0.0)
    rows = equations.source[0].rows
    design, sigma = equations.designs[0], equations.source[0].sigma[:, :, None]
    model = spread_held_out(folds, np.ones(len(rows), bool), design[..., columns] * sigma, np.outer(missing, missing))
    for number, without in found.without_fold.items():  # a prediction errs by the posterior without its pose
        test = folds.fold[rows] == number
        model += spread_held_out(folds, test, design[test][..., without.columns] * sigma[test], without.covariance)
    covariance = (posterior.covariance[np.ix_(at, at)] + np.outer(missing, missing)) * np.outer(scale, scale)
    named, root = spread_unknowns(unknowns, covariance)
    name = fit.problem.campaign.file.name if fit.problem.campaign.file else "a campaign"
    source = f"diagnosed from {name}, {int(good.sum())} rows at {len(np.unique(folds.pose[good[rows]]))} poses"
    stated = Uncertainty("measured", source, named, root)
    return _add_unexplained(folds, stated, model, held, good)


def state_nominal_uncertainty(folds: Folds, nominal: FitState, residual: Array, good: Mask) -> Uncertainty:
    """Compute the uncertainty of the nominal robot: as before the log, and the rest of its gap unexplained.

    A fit that does not predict held-out poses does not determine parameters. residual: of the nominal robot, all
    rows, (n, 3) [m]; other arguments: see `state_uncertainty`.
    """
    fit, rows = folds.fit, folds.fit.search.equations.source[0].rows
    known = robot_uncertainty(fit.problem.robot)
    slopes = derive_unknowns(linearize_state(fit.problem, nominal), known.unknowns)[rows]
    model = spread_held_out(folds, np.ones(len(rows), bool), slopes, known.covariance)
    name = fit.problem.campaign.file.name if fit.problem.campaign.file else "a campaign"
    source = f"{known.source}; unexplained error from {name}, whose fit did not hold on left-out poses"
    held = HeldOut(rows, fit_frames(fit, residual[rows], len(np.unique(folds.pose))))
    return _add_unexplained(folds, replace(known, source=source), model, held, good)


def _add_unexplained(folds: Folds, known: Uncertainty, model: Array, held: HeldOut, good: Mask) -> Uncertainty:
    """Add the unexplained error and the calibration factor; model: covariance of the predictions, (r, 3, 3) [m^2]."""
    fit, channel = folds.fit, folds.fit.search.equations.source[0]
    noise = channel.sigma[:, 0] ** 2 + channel.noise.stay**2
    seen = good[channel.rows]
    left, n_values, axes = held.residual[seen], channel.n_values[seen], channel.axes[seen]
    excess = np.sum(left**2, axis=1) - n_values * noise[seen] - np.trace(model[seen], axis1=1, axis2=2)
    # the value of a gauge or a bar covers one of three axes
    unexplained = float(np.sqrt(max(axes.shape[1] * excess.sum() / n_values.sum(), 0.0))) if len(left) else 0.0
    pose = folds.pose[seen]
    along = unexplained**2 / axes.shape[1] * axes
    factor, groups = calibrate_band(left, model[seen] + along, noise[seen][:, None, None] * axes, pose)
    stated = replace(
        known, unexplained=unexplained,
        scale=find_scale(fit.at.point[channel.rows][seen], left, pose) if unexplained > 0 else SCALE,
        repeatability=fit.problem.robot.repeatability or channel.noise.stay or None, calibration=factor, groups=groups,
    )  # fmt: skip
    frames = fit.state.registration
    unknown_base = frames is not None and ("base" in frames.parts or fit.problem.campaign.free_base)
    return restore_prior(fit.problem.robot, stated, free_base=unknown_base)


def set_calibrated_sizes(fit: Fit, posterior: Posterior, verdict: Verdict, scale: float) -> tuple[Verdict, Uncertainty]:
    """Set named effects to their values in the calibration, and compute their covariance.

    Effects whose 95 % region contains zero are no longer named: v^T C^-1 v of values v and covariance C is then below
    the 95 % point of chi-square. `posterior` is that of the calibration; `scale` is the factor of all deviations
    by which bands cover held-out poses.
    """
    robot, equations = fit.problem.robot, fit.search.equations
    values, findings, determined = posterior.values(equations.p), [], set[int]()
    unknowns, chosen = [], np.zeros(0, int)
    for finding in verdict.findings:
        if finding.signature >= 0:
            signature, columns = equations.signatures[finding.signature], equations.columns(finding.signature)
            size = limit_sizes(robot, signature, values[columns] * signature.scale)
            finding = replace(finding, effect=signature.effect(size))
            if 2.0 * posterior.loss_without(columns) > scale**2 * chdtri(len(columns), 1.0 - LEVEL):
                determined.add(finding.signature)
            if np.isin(columns, posterior.columns).all() and not np.isin(columns, chosen).any():
                unknowns.append(Unknown(*signature.place, signature.keys, np.zeros(len(size)), dict(signature.fixed)))
                chosen = np.r_[chosen, columns]
        findings.append(finding)
    at = np.searchsorted(posterior.columns, chosen)
    covariance = posterior.covariance[np.ix_(at, at)] * np.outer(equations.scale[chosen], equations.scale[chosen])
    spread, factor = spread_unknowns(unknowns, covariance)
    sizes = Uncertainty("measured", "named effects", spread, factor, calibration=scale)
    return drop_insignificant(replace(verdict, findings=tuple(findings)), determined), sizes


def _list_unknowns(fit: Fit, found: Calibration) -> tuple[list[Unknown], NDArray[np.int_]]:
    """List the parameters of named effects, then of small errors, each once; also return their columns.

    Gear waves that the campaign does not show are left out.
    """
    equations, determined = fit.search.equations, found.posterior.columns
    small = determined[fit.search.prior.background[determined] >= 0]
    rest = [n for n in range(len(equations.signatures)) if n not in found.named]
    unknowns, columns = list[Unknown](), list[int]()
    for number in (*found.named, *rest):
        signature = equations.signatures[number]
        named = number in found.named
        if not (named or in_background(signature)) or is_of_instrument(signature.name):
            continue
        entries = [(int(c), key) for c, key in zip(equations.columns(number), signature.keys, strict=True)]
        entries = [(c, key) for c, key in entries if c in (determined if named else small) and c not in columns]
        # a list parameter is included completely or not at all
        if entries and (len(entries) == len(signature.keys) or "#" not in signature.keys[0]):
            columns += [c for c, _ in entries]
            keys = tuple(key for _, key in entries)
            unknowns.append(Unknown(*signature.place, keys, np.zeros(len(entries)), dict(signature.fixed)))
    return unknowns, np.array(columns, int)


def find_scale(place: Array, left: Array, pose: NDArray[np.int_]) -> float:
    """Find the correlation length of residuals (n, 3), from pairs of places (n, 3). [m]

    Least squares of r_i . r_j against a exp(-d_ij^2 / 2 l^2) over pairs of different poses, a >= 0 free.
    """
    _, index, count = np.unique(pose, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    if len(count) < ENOUGH_ROWS:
        return SCALE
    mean = [np.stack([np.bincount(index, part[:, k]) / count for k in range(3)], axis=1) for part in (place, left)]
    few = np.unique(np.linspace(0, len(count) - 1, SAMPLE).astype(int))
    at, error = mean[0][few], mean[1][few]
    i, j = np.triu_indices(len(at), 1)
    square, product = np.sum((at[i] - at[j]) ** 2, axis=1), np.einsum("ni,ni->n", error[i], error[j])
    tries = []
    for scale in SCALES:
        shape = np.exp(-0.5 * square / scale**2)
        size = max(float(shape @ product) / max(float(shape @ shape), 1e-30), 0.0)
        tries.append((float(np.sum((product - size * shape) ** 2)), scale if size > 0 else SCALE))
    return min(tries)[1]


def state_change(robot: Robot, effect: Effect, sizes: Uncertainty) -> dict[str, Any]:
    """Compute the intervals of an effect's parameters, which hold 95 % if the effect is present.

    Returns:
        "interval95": lower and upper end by parameter, where it has one; and for a joint compliance in the model
        "change_percent": value, lower and upper end in percent of the model's.
    """
    deviation = {
        key: float(sigma)
        for unknown, widths in split_unknowns(sizes.unknowns, sizes.width)
        if (unknown.effect, unknown.joint, unknown.axis) == tuple(effect.place)
        for key, sigma in zip(unknown.keys, widths, strict=True)
    }
    ends = {
        key: [float(value) - HALF_WIDTH * deviation[key], float(value) + HALF_WIDTH * deviation[key]]
        for key, value in effect.parameters.items()
        if key in deviation
    }
    if not ends:
        return {}
    found: dict[str, Any] = {"interval95": ends}
    if effect.name == "joint_stiffness":
        spring = own_springs(robot).get(robot.joint_names.index(str(effect.joint)))
        key = next(iter(ends))
        if spring is not None and spring.compliance > 0.0:
            found["change_percent"] = [
                round(100.0 * value / spring.compliance, 2) for value in (float(effect.parameters[key]), *ends[key])
            ]
    return found
