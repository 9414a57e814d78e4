"""What to measure next: the moves that separate effects which a campaign leaves ambiguous, and what they would tell.

Two hypotheses A and B, each fitted to the campaign with everything else free, predict a further move with means
m_A, m_B and covariances K_A, K_B of what is not known exactly. With noise N the expected log likelihood ratio is

    D = 1/2 (m_A - m_B)^T (N + (K_A + K_B) / 2)^-1 (m_A - m_B)

[Box1967; Atkinson1975: T-optimality, here with the uncertainty of both models]. Moves are picked one after the other,
each for what it adds to those before, until more of them would not tell more, then exchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import expit, logit, ndtri

from compplan.diagnosis.data.shared import NEGLIGIBLE, SAMPLE, SURE, rank_number
from compplan.diagnosis.evidence.candidates import key_of, offered_signatures, propose_again
from compplan.diagnosis.results.measurement_moves import KINDS, MOVES, MeasuringMove, list_moves
from compplan.diagnosis.results.result import Diagnosis, place_table
from compplan.diagnosis.results.verdict import NAMING, Verdict
from compplan.diagnosis.search.search import SEARCH, SHIFTS, Claim, Model
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.probability import MAP, find_alternatives, is_comparable
from compplan.diagnosis.validation.unmodelled import UNMODELLED
from compplan.effects import apply_effects, build_model, solve_model_poses, transmission_error
from compplan.effects.linearization import Linearization, Place, linearize_model
from compplan.measurement.pose_selection import grow_choice, odds_gains, settle_choice, weight_rows
from compplan.robot import Array

NOTHING = "none"


@dataclass(frozen=True, eq=False)
class Pair:
    """Two explanations: places of claim and rival (None: no claim), their models, log odds of the first, tempered."""

    first: Place
    second: Place | None
    model: Model
    other: Model
    log_odds: float


class DifferenceShown(NamedTuple):
    """What k moves show of the difference of two models."""

    mean: Array  #: Parameters of the first, less those of the second, each in its own place. Shape (P,).
    covariance: Array  #: Mean covariance of the two. Shape (P, P).
    rows: Array  #: Derivatives of what each move shows, in units of its noise. Shape (k, c, P).


@dataclass(frozen=True)
class Proposal:
    """A measurement that separates two explanations; the second is None where the question is whether there is any.

    `moves` of one kind, the most telling first; `probability` of the better explanation now, `gain` by how much that of
    the true one is expected to rise, `information` the expected log likelihood ratio.
    """

    separates: tuple[Place, Place | None]
    kind: str
    moves: tuple[MeasuringMove, ...]
    probability: float
    gain: float
    information: float


def propose_measurements(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Propose what to measure next, as `next_measurement` of diagnosis.json holds it, the most telling first.

    Nothing is proposed where no positions were measured: poses at a socket or a gauge are not free to choose.
    """
    fit = diagnosis.fit
    pairs = list(find_pairs(fit, diagnosis.verdict))
    if not pairs or not fit.problem.campaign.measured.any():
        return []
    pool, moves = list_moves(fit.problem.robot, fit.problem.campaign)
    if not moves:
        return []
    scene = build_model(fit.problem.robot, pool, registration=fit.state.registration, later=True)
    scene = apply_effects(scene, fit.state.effects)
    at = linearize_model(
        scene, solve_model_poses(scene), {effect.place: effect.parameters for effect in fit.state.effects}
    )
    # what a stay gets wrong in common is noise to the next one
    variance = np.exp(fit.model.posterior.hyper.log_noise) * (1.0 + np.exp(2.0 * fit.model.posterior.hyper.log_shared))
    parts = zip(predict_columns(fit, at), variance, strict=True)
    design = np.concatenate([part / np.sqrt(v) for part, v in parts], axis=1)
    tried = [(pair, best_proposal(pair, design, moves)) for pair in pairs]
    proposals = sorted((found for _, found in tried if found is not None), key=lambda p: -rank_number(p.gain))
    tables = [summarise_proposal(fit, at, proposal) for proposal in proposals]
    tables += [_inseparable(pair) for pair, found in tried if found is None]
    return tables[: MOVES.most_moves]


def find_pairs(fit: Fit, verdict: Verdict) -> Iterable[Pair]:
    """Pair every claim with effects it cannot be told from, every unsure one with its best replacement or nothing."""
    search, model = fit.search, fit.model
    judged = {finding.signature: finding for finding in (*verdict.findings, *verdict.doubtful)}
    small = {finding.signature for finding in verdict.minor}
    for claim in (c for c in model.claims if c.signature not in small):
        finding = judged.get(claim.signature)
        # claims that errors without a name explain as well are improbable
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
            odds = np.clip((here.score - other.score) / MAP.temper, 0.0, logit(SURE))
            yield Pair(place, rival, here, other, float(odds))
        if probability < SURE:
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
    offered = offered_signatures(at, fit.problem.register, SHIFTS)
    offered += propose_again(at, looked_for, {key_of(s) for s in looked_for})
    by_key = {(s.place, s.form): s for s in offered}
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
                own = equations.scale[columns[fresh]] / channel.noise.sigma
                design[:, :, columns[fresh]] = motion[:, :, fresh] * own
        done.update(columns[fresh].tolist())
    return designs


def best_proposal(pair: Pair, design: Array, moves: Sequence[MeasuringMove]) -> Proposal | None:
    """Find the kind of move that separates a pair best, with as few moves as do it. design: shape (n, c, p)."""
    found: list[Proposal] = []
    for kind in KINDS:
        own = [move for move in moves if move.kind == kind]
        if not own:
            continue
        picked, information = pick_moves(predict_difference(pair, design, own), pair.log_odds)
        if picked:
            probability = float(expit(abs(pair.log_odds)))
            gain = expected_gain(pair.log_odds, information / MAP.temper, MAP.temper)
            chosen = tuple(own[k] for k in picked)
            found.append(Proposal((pair.first, pair.second), kind, chosen, probability, gain, information))
    best = max((proposal.gain for proposal in found), default=0.0)
    if best < MOVES.worth_it:
        return None
    good = [proposal for proposal in found if proposal.gain >= best - NEGLIGIBLE]
    return min(good, key=lambda p: sum(len(move.rows) for move in p.moves))


def predict_difference(pair: Pair, design: Array, moves: Sequence[MeasuringMove]) -> DifferenceShown:
    """Return what moves show of the difference of two models; `design`: columns at further rows. Shape (n, c, p)."""
    two = [model.posterior for model in (pair.model, pair.other)]
    columns = np.concatenate([design[:, :, posterior.columns] for posterior in two], axis=2)
    longest = max(len(move.rows) for move in moves)
    rows = np.zeros((len(moves), longest, *columns.shape[1:]))
    for number, move in enumerate(moves):
        rows[number, : len(move.rows)] = columns[list(move.rows)]
    return DifferenceShown(
        np.r_[two[0].mean, -two[1].mean],
        0.5 * block_diag(*(posterior.covariance for posterior in two)),
        rows.reshape(len(moves), -1, columns.shape[2]),
    )


def pick_moves(shown: DifferenceShown, log_odds: float) -> tuple[list[int], float]:
    """Pick moves for what each adds to those before, as many as add to the expected gain, then exchange them.

    Returns their numbers, and the expected log likelihood ratio of all of them together.
    """
    worth = weight_rows(odds_gains, shown.covariance, shown.rows, 1.0, shown.mean)

    def gain_of(information: float) -> float:
        return expected_gain(log_odds, information / MAP.temper, MAP.temper)

    picked: list[int] = []
    information = 0.0
    for best, added in grow_choice(worth, min(MOVES.most_moves, len(shown.rows))):
        # a single move may be too little to show although all that are allowed would
        most = information + (MOVES.most_moves - len(picked)) * added
        enough = len(picked) >= MOVES.fewest_moves or not picked
        if enough and gain_of(most) < gain_of(information) + NEGLIGIBLE:
            break
        picked, information = [*picked, best], information + added
    if gain_of(information) < NEGLIGIBLE:
        return [], 0.0
    chosen = settle_choice(worth, picked)
    return [move for move, _ in chosen], sum(added for _, added in chosen)


def expected_gain(log_odds: float, information: float, temper: float = 1.0) -> float:
    """Return by how much the probability of the true one of two explanations is expected to rise.

    The log likelihood ratio of the new rows is normal, of mean +-information and variance 2 information (of the
    untempered ratio) under either explanation. `information` is divided by the temper already.
    """
    # the middles of parts of equal probability
    spread = np.sqrt(2.0 * information / temper) * ndtri((np.arange(SAMPLE) + 0.5) / SAMPLE)
    first = float(expit(log_odds))
    kept = float(np.mean(expit(log_odds + information + spread)))
    lost = float(np.mean(expit(information - log_odds + spread)))
    now = first**2 + (1.0 - first) ** 2
    return float(first * kept + (1.0 - first) * lost - now)


def summarise_proposal(fit: Fit, at: Linearization, proposal: Proposal) -> dict[str, Any]:
    """Return a proposal as diagnosis.json holds it: poses in deg (sliding joints in mm), loads in N and N m."""
    robot, campaign = fit.problem.robot, at.campaign
    rows = [row for move in proposal.moves for row in move.rows]
    unit = np.where(robot.prismatic, 1e3, 180.0 / np.pi)
    table: dict[str, Any] = {
        "separates": _separates(*proposal.separates),
        "kind": proposal.kind,
        "how": _say(proposal),
        "columns": list(robot.joint_headers),
        "poses": [[round(float(v), 4) for v in campaign.q[row] * unit] for row in rows],
        "wrenches": [[round(float(v), 2) for v in campaign.wrench[row]] for row in rows],
        "approach": [name_approach(at, row) for row in rows] if proposal.kind == "reversal" else None,
        "probability_now": round(proposal.probability, 3),
        "expected_probability_gain": round(proposal.gain, 3),
        "expected_log_likelihood_ratio": round(proposal.information, 2),
    }
    if proposal.kind == "loaded_unloaded" and not fit.problem.campaign.load_varies:
        table["assumed"] = "the campaign had no loads; the weight on the tool is assumed"
    return table


def _inseparable(pair: Pair) -> dict[str, Any]:
    """Say that no move was found that would tell two explanations apart."""
    return {
        "separates": _separates(pair.first, pair.second),
        "kind": "none",
        "how": "no move within joint limits and given loads separates these; the simpler one predicts as well",
        "poses": [],
        "wrenches": [],
        "probability_now": round(float(expit(abs(pair.log_odds))), 3),
        "expected_probability_gain": 0.0,
    }


def _separates(first: Place, second: Place | None) -> list[dict[str, str | None]]:
    return [place_table(first), place_table((NOTHING, None, None) if second is None else second)]


def _say(proposal: Proposal) -> str:
    joints = list(dict.fromkeys(move.joint for move in proposal.moves if move.joint))
    of = f" ({', '.join(joints)})" if joints else ""
    return KINDS[proposal.kind] + of


def name_approach(at: Linearization, row: int) -> str:
    """Say which joint moves last before a row, and in which direction."""
    move = at.campaign.q[row] - at.campaign.q[row - 1]
    index = int(np.argmax(np.abs(move)))
    return f"{at.robot.joint_names[index]} {'upwards' if move[index] > 0 else 'downwards'}"
