"""Probability of a claim: a logistic map of three features; and other effects that explain the same motion.

A true cause explains its complete error. A wrong effect of the same joint, frame or tool leaves part of it, and that
part moves the target in the same directions. With m_i the motion of the target by the claim at row i, u_i its unit
vector, r_i the residual of claims and small errors, and F the 95 % point of Fisher's F(n, (c - 1) n) for n poses and c
values a row (three of a position),

    similarity^2 = max(sum (u_i . r_i)^2 - F / (c - 1) sum |r_i - (u_i . r_i) u_i|^2, 0) / sum |m_i|^2,

the residual along its motion beyond chance: the largest of every channel in which the claim moves more than the noise,
with and without the unmodelled errors in the residual, since these may fit the rest of a wrong effect.

A vocabulary of hundreds of effects explains part of any smooth error. Errors of no effect are drawn: a wave, step, kink
or parabola of one or two quantities that vary in the campaign, along a direction of the base or of the tool, or as a
rotation of a link; the best effect explains the share e of their squares, with frames and other claims fitted. With E =
(squares explained - number of parameters) / (squares that the other claims leave - noise) of a claim, P(e >= E) over
the draws is its spurious-fit probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, fdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import LEVEL, NEGLIGIBLE, ROUNDING, SAMPLE, SEED, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_normal_equations
from compplan.diagnosis.evidence.normal_equations import project_out
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled import UNMODELLED, RevisedProbabilities
from compplan.effects.linearization import AXES, Linearization, Place
from compplan.effects.signature import Signature
from compplan.measurement.observations import along as take_along
from compplan.robot import Array


@dataclass(frozen=True)
class ProbabilitySettings:
    """Settings of the map from evidence to probability."""

    #: Largest probability of a claim (assumed: one campaign in a hundred has a cause outside every model here).
    most_probable: float = 0.99
    #: Divisor of log odds: evidence of real campaigns is less sharp than its model (assumed).
    temper: float = 2.0
    #: Margins beyond this count logarithmically (assumed).
    margin_scale: float = 5.0
    #: Ranges of spurious-fit probability and similarity, clipped outside: a high similarity may come from a larger
    #: cause (assumed).
    spurious_range: tuple[float, float] = (NEGLIGIBLE, 0.15)
    similarity_range: tuple[float, float] = (0.1, 1.0)
    #: Phase of a drawn error over one standard deviation of its quantity (assumed: from nearly straight to a wave that
    #: a few dozen poses just resolve). [rad]
    roughness: tuple[float, ...] = (0.5, 1.0, 2.0)


MAP = ProbabilitySettings()
#: Map from evidence to log odds, fitted by penalised logistic regression to claims of development campaigns and of
#: parts of measured ones (assumed: that study is not kept; python -m benchmarks ablation prints the map of a suite):
#: constant; weights of the margin (arsinh of it over its scale) and of minus the logarithms of spurious-fit probability
#: and residual similarity. No weight may be negative. The margin accounts for the number of parameters.
CONSTANT, WEIGHTS = -3.49, np.array([0.57, 0.69, 0.83])


@dataclass(frozen=True)
class Evidence:
    """Evidence for a claim."""

    margin: float  #: Log posterior odds against the best model without it, unmodelled errors in both.
    spurious: float  #: Spurious-fit probability (`rate_spurious_fits`).
    similarity: float  #: Residual along the claim's motion beyond chance, over that motion (`rate_similarities`).

    def to_table(self) -> dict[str, float]:
        """Return the content of diagnosis.json."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return the features of the map: margin, spurious-fit probability, residual similarity. Shape (3,)."""
    margin = np.arcsinh(evidence.margin / MAP.margin_scale)
    spurious = np.log(np.clip(evidence.spurious, *MAP.spurious_range))
    return np.array([margin, -spurious, -np.log(np.clip(evidence.similarity, *MAP.similarity_range))])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the calibrated probability of a claim."""
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MAP.most_probable))


def rate_similarities(fit: Fit, revised: RevisedProbabilities) -> dict[Claim, float]:
    """Compute the residual similarity of every claim."""
    equations, values = revised.search.equations, revised.model.posterior.values(revised.search.equations.p)
    foreign = np.concatenate([np.zeros(0, int), *revised.members]).astype(int)
    result = dict.fromkeys(revised.model.claims, 0.0)
    group = group_poses(fit.problem.campaign)
    for channel, design, rest in zip(equations.source, equations.designs, equations.left(values), strict=True):
        if rest.shape[1] == 1:
            continue
        left, pose = rest + design[..., foreign] @ values[foreign], group[channel.rows]
        for claim, found in result.items():
            columns = equations.columns(claim.signature)
            motion = design[..., columns] @ values[columns]
            if channel.name == "position" or np.mean(np.sum(motion**2, axis=1)) > rest.shape[1]:
                both = [measure_similarity(part, motion, pose) for part in (left, rest)]
                result[claim] = max(found, *both)
    return result


def measure_similarity(left: Array, motion: Array, pose: NDArray[np.int_]) -> float:
    """Return the residual (r, c) along a motion (r, c) beyond chance, over the motion; 0 without motion."""
    length = np.linalg.norm(motion, axis=1)
    moves = length > ROUNDING * length.max(initial=0.0)
    if not moves.any():
        return 0.0
    along = np.einsum("ni,ni->n", left[moves], motion[moves] / length[moves, None])
    across = np.sum(left[moves] ** 2) - along @ along
    poses = len(np.unique(pose[moves]))
    others = left.shape[1] - 1
    beyond = along @ along - across / others * fdtri(poses, others * poses, LEVEL)
    return float(np.sqrt(max(beyond, 0.0) / np.sum(motion[moves] ** 2)))


def rate_spurious_fits(fit: Fit, revised: RevisedProbabilities) -> dict[Claim, float]:
    """Compute the spurious-fit probability of every claim."""
    if not revised.model.claims:
        return {}
    equations = revised.search.equations
    total, p = equations.channels[0].total, equations.p
    drawn, length = draw_errors(fit), np.maximum(np.sqrt(np.diag(total.gram)), 1e-12)
    # products of the columns, of unit length, with the drawn errors and, last, the observations
    against = np.column_stack([equations.designs[0].reshape(-1, p).T @ drawn, total.against]) / length[:, None]
    squares = np.diag(np.append(np.sum(drawn**2, axis=0), total.square))
    gram = np.block([[total.gram / np.outer(length, length), against], [against.T, squares]])
    blocks = [equations.columns(number) for number in revised.search.candidates]
    values = np.array([len(block) for block in blocks])[:, None]
    frames, result = equations.columns_named(REGISTRATION), dict[Claim, float]()
    for claim in revised.model.claims:
        others = equations.join_columns(n for n in revised.model.signatures if n != claim.signature)
        nuisance = np.union1d(others, frames).astype(int)
        left = project_out(gram, nuisance)
        squares, count = np.maximum(np.diag(left), 0.0), total.count - len(nuisance)
        columns = equations.columns(claim.signature)
        explained = explain_squares(left, [columns], np.array([len(left) - 1]))[0, 0] - len(columns)
        share = explained / max(float(squares[-1]) - min(float(count), float(squares[-1])), 1e-12)
        # errors explained almost completely by frames and other claims show nothing
        kept = p + np.flatnonzero(squares[p:-1] > (1.0 - LEVEL) * np.diag(gram)[p:-1])
        shares = explain_squares(left, blocks, kept) / squares[kept]
        # k parameters explain k of the squares of any error; the residual of a fully explained error is rounding
        best = (1.0 - (1.0 - shares) * count / np.maximum(count - values, 1.0)).max(axis=0, initial=0.0)
        result[claim] = float((np.sum(best >= min(share, 1.0 - np.sqrt(ROUNDING))) + 0.5) / (len(kept) + 1.0))
    return result


def draw_errors(fit: Fit) -> Array:
    """Draw errors of no effect, of one rms each in units of the noise. Shape (values, SAMPLE)."""
    at, channel = fit.at, fit.search.equations.source[0]
    rows, rng = channel.rows, np.random.default_rng(SEED)
    drivers = list_drivers(at, rows)
    directions = [(joint.name, axis) for joint in at.robot.actuated for axis in AXES[3:]]
    rotation = at.attained.frames.tcp_rotation[rows]
    drawn: list[Array] = []
    while len(drawn) < SAMPLE:
        phases = [_pick(rng, drivers) * rng.choice(MAP.roughness) for _ in range(rng.integers(1, 3))]
        kind, direction = rng.integers(3), rng.normal(size=3)
        if kind == 0:
            moved = np.broadcast_to(direction, (len(rows), 3))
        elif kind == 1:
            moved = rotation @ direction
        else:
            moved = at.parent_twist(*directions[int(rng.integers(len(directions)))])[rows, :3]
        if channel.direction is not None:
            moved = take_along(channel.direction, np.asarray(moved))
        error = (_shape(rng, np.sum(phases, axis=0))[:, None] * moved / channel.sigma).reshape(-1)
        size = float(np.sqrt(np.mean(error**2)))
        if size > ROUNDING:
            drawn.append(error / size)
    return np.stack(drawn, axis=1)


def list_drivers(at: Linearization, rows: NDArray[np.int_]) -> list[Array]:
    """List the standardised quantities that a drawn error may depend on, by kind. Shapes (r, k)."""
    campaign = at.campaign
    kinds = [np.nan_to_num(campaign.q), at.point, np.arange(len(campaign), dtype=float)[:, None]]
    kinds.append(np.nan_to_num(at.own_load))
    if campaign.load_varies:
        kinds.append(np.nan_to_num(at.scene.wrench[:, :3]))
    found = []
    for values in (kind[rows] for kind in kinds):
        spread = values.std(axis=0)
        seen = spread > ROUNDING
        if seen.any():
            found.append((values[:, seen] - values[:, seen].mean(axis=0)) / spread[seen])
    return found


def _pick(rng: np.random.Generator, drivers: Sequence[Array]) -> Array:
    kind = drivers[int(rng.integers(len(drivers)))]
    return np.asarray(kind[:, rng.integers(kind.shape[1])])


def _shape(rng: np.random.Generator, phase: Array) -> Array:
    """Draw a wave, a step, a kink or a parabola."""
    wave = np.sin(phase + rng.uniform(0.0, 2.0 * np.pi))
    return [wave, np.sign(wave), np.abs(phase - rng.normal()), phase**2][int(rng.integers(4))]


def explain_squares(gram: Array, blocks: Sequence[NDArray[np.int_]], errors: NDArray[np.int_]) -> Array:
    """Return the squares of given columns that each block of others explains. Shape (blocks, errors)."""
    result = np.zeros((len(blocks), len(errors)))
    for size in {len(block) for block in blocks}:
        numbers = [n for n, block in enumerate(blocks) if len(block) == size]
        columns = np.stack([blocks[n] for n in numbers])
        # columns have unit length: the residual of a column in the span of others is rounding
        inner = gram[columns[:, :, None], columns[:, None, :]] + ROUNDING * np.eye(size)
        against = gram[columns[:, :, None], errors]
        result[numbers] = np.einsum("nsc,nsc->nc", against, np.linalg.solve(inner, against))
    return result


#: Two effects are indistinguishable if one explains this share of the other's motion, frames fitted to both (assumed),
ALIKE = 0.975
#: or if the residual of the other is this small: sum of squares over the campaign, in units of the noise variance
#: (theory: four standard deviations, log odds of 8).
BELOW_NOISE = 16.0


@dataclass(frozen=True)
class AlternativeEffect:
    """Another effect that explains a share of the motion by a claim, frames fitted to both; number of its parameters.

    `difference` is the sum of squares that it leaves of that motion, in units of the noise variance.
    """

    place: Place
    share: float
    difference: float
    parameters: int

    @property
    def alike(self) -> bool:
        """Whether the campaign cannot distinguish it from the claim."""
        return self.share >= ALIKE or self.difference < BELOW_NOISE


def find_alternatives(fit: Fit, signature: int, values: Array | None = None) -> list[AlternativeEffect]:
    """Find the effects that explain a claim's motion, and their shares, best first.

    The share is the squared cosine of the angle between the claim's motion and the space of the other effect, base and
    tool frames projected out of both. `values` are those of all columns (p,), by default those of the fit's model.
    """
    equations = fit.search.equations
    columns = equations.columns(signature)
    values = (fit.model.posterior.values(equations.p) if values is None else values)[columns]
    free, energy = _measure_trace(fit, columns, values)
    if energy <= 0:
        return []
    claim = equations.signatures[signature]
    best: dict[Place, AlternativeEffect] = {}
    for number, other in enumerate(equations.signatures):
        if other.place == claim.place or not is_comparable(other):
            continue
        theirs = _all_columns(fit, number)
        share = _share(free, columns, values, theirs, energy)
        rival = AlternativeEffect(other.place, share, (1.0 - share) * energy, len(theirs))
        if other.place not in best or rival.share > best[other.place].share:
            best[other.place] = rival
    return sorted(best.values(), key=lambda r: -rank_number(r.share))


def _measure_trace(fit: Fit, columns: NDArray[np.int_], values: Array) -> tuple[Array, float]:
    """Return the products of all columns, frames projected out, and the squares of a claim's motion."""
    gram, _ = combine_normal_equations(fit.search.equations, fit.model.posterior.hyper)
    whole = float(values @ gram[np.ix_(columns, columns)] @ values)
    frames = fit.search.equations.columns_named("base_frame", "tool_frame", REGISTRATION)
    free = project_out(gram, frames)
    energy = float(values @ free[np.ix_(columns, columns)] @ values)
    # frames that explain the motion almost completely are not projected out
    return (gram, whole) if energy < NEGLIGIBLE * whole else (free, energy)


def _all_columns(fit: Fit, number: int) -> NDArray[np.int_]:
    """Return the columns of an effect at its place: a nonlinear stiffness has both its shapes."""
    equations = fit.search.equations
    signature = equations.signatures[number]
    if signature.form not in ("quadratic", "cubic"):
        return equations.columns(number)
    return equations.join_columns(
        n for n, s in enumerate(equations.signatures) if s.place == signature.place and s.form in ("quadratic", "cubic")
    )


def _share(gram: Array, columns: NDArray[np.int_], values: Array, other: NDArray[np.int_], energy: float) -> float:
    """Return the share of a motion that other columns explain; zero if they move nothing."""
    block, against = gram[np.ix_(other, other)], gram[np.ix_(other, columns)] @ values
    trace = float(np.trace(block))
    if trace <= 0:
        return 0.0
    fitted = np.linalg.solve(block + 1e-9 * trace / len(block) * np.eye(len(block)), against)
    return float(np.clip(against @ fitted / energy, 0.0, 1.0))


def is_comparable(other: Signature) -> bool:
    """Check whether an effect is a rival: proposed forms, variants of stiffness laws, waves and balancers are not."""
    if other.name in (REGISTRATION, UNMODELLED) or other.tried > 1:
        return False
    if other.name == "stiffness_nonlinearity":
        return other.form in ("quadratic", "cubic")
    if other.name == "transmission_error":
        return len(other.keys) == 2
    if other.name == "gravity_compensator":
        return other.form == "sine"
    return True
