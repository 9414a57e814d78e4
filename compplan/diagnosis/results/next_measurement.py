"""Next measurements: poses and loads that separate ambiguous effects, and their expected information.

Two hypotheses A and B, each fitted to the campaign with all other parameters free, predict further rows with means m_A,
m_B and covariances K_A, K_B by parameter uncertainty. With noise N the expected log likelihood ratio is

    D = 1/2 (m_A - m_B)^T (N + (K_A + K_B) / 2)^-1 (m_A - m_B)

[Box1967; Atkinson1975: T-optimality, here with the uncertainty of both models]. Rows are selected one by one, each for
its gain over those before. Candidates continue the campaign: poses within joint limits, no lower and no nearer to the
base axis than in the campaign, without load and under its largest loads. Collisions with cables and surroundings are
not checked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import expit, logit, ndtri

from compplan.diagnosis.data.shared import CERTAIN, ENOUGH_ROWS, FEW_ROWS, LISTED, NEGLIGIBLE, SAMPLE, SEED, rank_number
from compplan.diagnosis.evidence.candidates import key_of, offered_signatures, propose_again
from compplan.diagnosis.results.result import Diagnosis, place_table
from compplan.diagnosis.results.verdict import NAMING, Verdict
from compplan.diagnosis.search.search import SEARCH, SHIFTS, Claim, Model
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.probability import MAP, find_alternatives, is_comparable
from compplan.diagnosis.validation.unmodelled import UNMODELLED
from compplan.effects import apply_effects, build_model, solve_model_poses, transmission_error
from compplan.effects.linearization import Linearization, Place, linearize_model
from compplan.measurement.campaign import Campaign
from compplan.measurement.pose_selection import explain_rows, grow_choice, odds_gains
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

NOTHING = "none"


#: Default weight if the campaign had no load: assumed possible for any robot here. [N]
ASSUMED_WEIGHT = 50.0


@dataclass(frozen=True, eq=False)
class Pair:
    """Two explanations: places of claim and rival (None: no claim), their models, log odds of the first, tempered."""

    first: Place
    second: Place | None
    model: Model
    other: Model
    log_odds: float


@dataclass(frozen=True)
class Proposal:
    """Rows of the candidates that separate a pair, the most informative first.

    `gain` is the expected rise in probability of the true explanation, `information` the expected log likelihood ratio.
    """

    pair: Pair
    rows: tuple[int, ...]
    gain: float
    information: float


def propose_measurements(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Propose the next measurements, as `next_measurement` of diagnosis.json, the most informative first.

    Nothing is proposed without measured positions: poses at a socket or a gauge cannot be chosen.
    """
    fit = diagnosis.fit
    pairs = list(find_pairs(fit, diagnosis.verdict))
    if not pairs or not fit.problem.campaign.measured.any():
        return []
    pool = list_rows(fit.problem.robot, fit.problem.campaign)
    if len(pool) <= FEW_ROWS:
        return []
    scene = build_model(fit.problem.robot, pool, registration=fit.state.registration, later=True)
    scene = apply_effects(scene, fit.state.effects)
    at = linearize_model(
        scene, solve_model_poses(scene), {effect.place: effect.parameters for effect in fit.state.effects}
    )
    # the common error of a stay is noise between stays
    variance = np.exp(fit.model.posterior.hyper.log_noise) * (1.0 + np.exp(2.0 * fit.model.posterior.hyper.log_shared))
    parts = zip(predict_columns(fit, at), variance, strict=True)
    design = np.concatenate([part / np.sqrt(v) for part, v in parts], axis=1)
    loaded = np.asarray(pool.wrench[FEW_ROWS:].any(axis=1))
    found = [best_proposal(pair, design[FEW_ROWS:], loaded) for pair in pairs]
    found.sort(key=lambda proposal: -rank_number(proposal.gain))
    return [summarise_proposal(fit, at, proposal) for proposal in found][:LISTED]


def find_pairs(fit: Fit, verdict: Verdict) -> Iterable[Pair]:
    """Pair every claim with its indistinguishable rivals, every uncertain one with its best replacement or none."""
    search, model = fit.search, fit.model
    by_signature = {finding.signature: finding for finding in (*verdict.findings, *verdict.doubtful)}
    small = {finding.signature for finding in verdict.minor}
    for claim in (c for c in model.claims if c.signature not in small):
        finding = by_signature.get(claim.signature)
        # claims that unmodelled errors explain as well are improbable
        probability = NAMING.refused if finding is None else finding.probability
        rivals = find_alternatives(fit, claim.signature) if finding is None else finding.rivals
        rest = search.without(model.claims, claim)
        reduced = search.model(rest, model.posterior.hyper, fit=False)
        here = search.model(model.claims, model.posterior.hyper, fit=False)
        best: dict[Place, Claim] = {}
        gains = [g for g in search.gains(reduced) if _place(fit, g.signature)[0] != UNMODELLED]
        for gain in gains:
            if is_comparable(search.equations.signatures[gain.signature]):
                best.setdefault(_place(fit, gain.signature), Claim(gain.signature, gain.size))
        place = _place(fit, claim.signature)
        alike = [rival.place for rival in rivals if rival.alike and rival.place in best]
        for rival in alike[: SEARCH.tried]:
            other = search.model((*rest, best[rival]), model.posterior.hyper, fit=False)
            odds = np.clip((here.score - other.score) / MAP.temper, 0.0, logit(CERTAIN))
            yield Pair(place, rival, here, other, float(odds))
        if probability < CERTAIN:
            odds = float(logit(probability))
            strongest = next((g for g in gains if _place(fit, g.signature) not in (place, *alike)), None)
            if strongest is None or strongest.log_evidence <= 0.0:
                yield Pair(place, None, here, reduced, odds)
            else:
                stronger = Claim(strongest.signature, strongest.size)
                other = search.model((*rest, stronger), model.posterior.hyper, fit=False)
                yield Pair(place, _place(fit, stronger.signature), here, other, odds)


def _place(fit: Fit, signature: int) -> Place:
    return fit.search.equations.signatures[signature].place


def predict_columns(fit: Fit, at: Linearization) -> list[Array]:
    """Evaluate the columns of the normal equations at further rows, in units of noise. Shapes (n, c, p).

    Columns that further rows cannot show are zero.
    """
    equations, n = fit.search.equations, len(at.campaign)
    claimed = [equations.signatures[claim.signature] for claim in fit.model.claims]
    looked_for = [s for s in claimed if s.name in (*SHIFTS, transmission_error.name)]
    again = propose_again(at, looked_for, {key_of(s) for s in looked_for})
    by_key = {(s.place, s.form): s for s in (*offered_signatures(at, fit.problem.register, SHIFTS), *again)}
    designs = [np.zeros((n, channel.residual.shape[1], equations.p)) for channel in equations.source]
    done: set[int] = set()
    for number, signature in enumerate(equations.signatures):
        columns = equations.columns(number)
        fresh = [k for k, column in enumerate(columns) if int(column) not in done]
        if not fresh or signature.name == UNMODELLED:
            continue
        found = by_key.get((signature.place, signature.form))
        if found is None or len(found.keys) != len(columns):
            continue
        motions = {"position": found.twist[:, :3], "orientation": found.twist[:, 3:], "encoder": found.encoder}
        for channel, design in zip(equations.source, designs, strict=True):
            motion = motions.get(channel.name)
            if motion is not None:
                scale = equations.scale[columns[fresh]] / channel.noise.sigma
                design[:, :, columns[fresh]] = motion[:, :, fresh] * scale
        done.update(columns[fresh].tolist())
    return designs


def best_proposal(pair: Pair, design: Array, loaded: NDArray[np.bool_]) -> Proposal:
    """Find the poses that separate a pair, without load if nearly as informative; no poses if none separate it.

    `design`: columns at the candidates, shape (n, c, p); `loaded`: which of them carry a load. Shape (n,).
    """
    found: list[Proposal] = []
    plain, under = np.flatnonzero(~loaded), np.flatnonzero(loaded)
    two = [model.posterior for model in (pair.model, pair.other)]
    difference = np.r_[two[0].mean, -two[1].mean]
    covariance = 0.5 * block_diag(*(posterior.covariance for posterior in two))
    for poses in (plain[:, None], np.column_stack([plain[: len(under)], under])):
        columns = np.concatenate([design[poses][..., posterior.columns] for posterior in two], axis=-1)
        shown = columns.reshape(len(poses), -1, columns.shape[-1])
        picked, information = pick_poses(difference, covariance, shown)
        gain = expected_gain(pair.log_odds, information / MAP.temper, MAP.temper)
        found.append(Proposal(pair, tuple(poses[picked].ravel().tolist()), gain, information))
    best = found[0] if found[0].gain >= found[1].gain - NEGLIGIBLE else found[1]
    return best if best.gain >= NEGLIGIBLE else Proposal(pair, (), 0.0, 0.0)


def pick_poses(mean: Array, covariance: Array, rows: Array) -> tuple[list[int], float]:
    """Select `FEW_ROWS` poses one by one, each for its gain over those before.

    Args:
        mean: Parameters of one model and minus those of the other, concatenated. Shape (P,).
        covariance: Mean covariance of the two. Shape (P, P).
        rows: Derivatives of the observations of each pose, in units of its noise. Shape (k, c, P).

    Returns:
        Their numbers, and the expected log likelihood ratio of all of them together.
    """
    most = min(FEW_ROWS, len(rows))
    picked = list(grow_choice(lambda taken: odds_gains(*explain_rows(mean, covariance, rows[taken], 1.0), rows), most))
    return [pose for pose, _ in picked], sum(added for _, added in picked)


def expected_gain(log_odds: float, information: float, temper: float = 1.0) -> float:
    """Return the expected rise in probability of the true one of two explanations.

    The log likelihood ratio of the new rows is normal, of mean +-information and variance 2 information (of the
    untempered ratio) under either explanation. `information` is already divided by the temper.
    """
    # medians of parts of equal probability
    spread = np.sqrt(2.0 * information / temper) * ndtri((np.arange(SAMPLE) + 0.5) / SAMPLE)
    first = float(expit(log_odds))
    kept = float(np.mean(expit(log_odds + information + spread)))
    lost = float(np.mean(expit(information - log_odds + spread)))
    now = first**2 + (1.0 - first) ** 2
    return float(first * kept + (1.0 - first) * lost - now)


def summarise_proposal(fit: Fit, at: Linearization, proposal: Proposal) -> dict[str, Any]:
    """Return a proposal in the format of diagnosis.json: poses in deg (sliding joints in mm), loads in N and N m."""
    robot, campaign, rows = fit.problem.robot, at.campaign, [FEW_ROWS + row for row in proposal.rows]
    unit, pair = np.where(robot.prismatic, 1e3, 180.0 / np.pi), proposal.pair
    how = "no pose within joint limits and given loads separates these; the simpler one predicts as well"
    if rows:
        loaded = any(campaign.wrench[row].any() for row in rows)
        how = "measure each pose without load and under the load" if loaded else "measure these poses, without load"
        if loaded and not fit.problem.campaign.load_varies:
            how += f" (the log has none: {ASSUMED_WEIGHT:g} N are assumed)"
    return {
        "separates": [place_table(pair.first), place_table(pair.second or (NOTHING, None, None))],
        "how": how,
        "columns": list(robot.joint_headers),
        "poses": [[round(float(v), 4) for v in campaign.q[row] * unit] for row in rows],
        "wrenches": [[round(float(v), 2) for v in campaign.wrench[row]] for row in rows],
        "probability_now": round(float(expit(abs(pair.log_odds))), 3),
        "expected_probability_gain": round(proposal.gain, 3),
        "expected_log_likelihood_ratio": round(proposal.information, 2),
    }


def list_rows(robot: Robot, campaign: Campaign, seed: int = SEED) -> Campaign:
    """Build candidate rows that continue a campaign, after `FEW_ROWS` of its rows.

    Poses without load, then some of them under a load each.
    """
    poses = draw_poses(robot, campaign, np.random.default_rng(seed))
    loaded, loads = poses[:ENOUGH_ROWS], np.array(list_loads(campaign))
    before = np.resize(np.flatnonzero(campaign.usable), FEW_ROWS)
    q = np.concatenate([campaign.q[before], poses, loaded])
    under = loads[np.arange(len(loaded)) % len(loads)]
    later = np.arange(len(q)) >= FEW_ROWS
    time = np.zeros(1) if campaign.time is None else np.nan_to_num(campaign.time)
    pace = float(np.ptp(time)) / len(campaign)
    warm = None if campaign.warming is None else np.where(later, np.max(campaign.warming), 0.0)
    return Campaign(
        run=np.where(later, "static_next", "static_before"),
        q=q,
        wrench=np.concatenate([campaign.wrench[before], np.zeros((len(poses), 6)), under]),
        position=np.zeros((len(q), 3)),
        rotation=None if campaign.rotation is None else np.broadcast_to(np.eye(3), (len(q), 3, 3)),
        time=None if campaign.time is None else later * (float(np.max(time)) + pace * np.arange(len(q))),
        temperature=None if warm is None else campaign.reference_temperature + warm,
        link=None if campaign.link is None else q.copy(),
        target=None if campaign.target is None else np.full(len(q), int(campaign.target_index[-1])),
        target_names=campaign.target_names,
    )


def draw_poses(robot: Robot, campaign: Campaign, random: np.random.Generator) -> Array:
    """Draw poses within joint limits, no closer to floor and column than in the campaign. Shape (<= 40, nq)."""
    q = random.uniform(*joint_range(robot, campaign), (4 * SAMPLE, robot.nq))
    return q[is_clear(robot, campaign, q)][: 2 * ENOUGH_ROWS]


def joint_range(robot: Robot, campaign: Campaign) -> tuple[Array, Array]:
    """Return the permitted joint range of candidates. Shapes (nq,). [rad or m]"""
    seen = campaign.q[campaign.usable]
    middle = 0.5 * (seen.min(0) + seen.max(0))
    lower, upper = np.maximum(robot.lower, middle - np.pi), np.minimum(robot.upper, middle + np.pi)
    margin = NEGLIGIBLE * (upper - lower)
    # without limits in the folder, a rail is as long as its range in the campaign
    endless = robot.prismatic & ~(np.isfinite(robot.lower) & np.isfinite(robot.upper))
    return np.where(endless, seen.min(0), lower + margin), np.where(endless, seen.max(0), upper - margin)


def is_clear(robot: Robot, campaign: Campaign, q: Array) -> NDArray[np.bool_]:
    """Return which poses are no lower and no nearer to the base axis than the campaign. Shape (n,)."""
    usable = np.flatnonzero(campaign.usable)
    some = usable[:: max(1, len(usable) // SAMPLE)]
    chain = build_chain(robot)
    seen, tip = (locate_frames(chain, poses).tcp_position for poses in (campaign.q[some], q))
    return np.asarray(
        (tip[:, 2] >= seen[:, 2].min()) & (np.hypot(tip[:, 0], tip[:, 1]) >= np.hypot(seen[:, 0], seen[:, 1]).min())
    )


def list_loads(campaign: Campaign) -> list[Array]:
    """List the largest loads of the campaign, or a known weight if it had none."""
    wrench = campaign.wrench[campaign.usable & ~campaign.unloaded]
    if not campaign.load_varies or not len(wrench):
        return [np.array([0.0, 0.0, -ASSUMED_WEIGHT, 0.0, 0.0, 0.0])]
    several = np.unique(np.round(wrench, 1), axis=0)
    largest = np.argsort(-np.linalg.norm(several[:, :3], axis=1), kind="stable")[:FEW_ROWS]
    return list(several[largest])
