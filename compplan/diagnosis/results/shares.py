"""Shares: the motion that a diagnosis gives to each of its causes, as parts of the mean square gap.

The causes are the findings of the verdict and the small errors everywhere, with the posterior that the names come from.
With the gap y (frames that are fitted anyway taken out), the motion m_g of each part and what all parts leave,
r = y - sum m_g, the squares that come back where one part alone is taken out are

    d_g = |r + m_g|^2 - |r|^2 = m_g . (m_g + 2 r)

and the parts divide what they explain together, |y|^2 - |r|^2, in proportion to them: parts that cancel each other keep
their weight. Intervals draw the parameters from the posterior, the pose groups anew, and whether a finding is present
from its probability: one that the campaign cannot tell from a rival elsewhere sits there half of the time.

The small errors of a robot that was not calibrated are divided in the same way by joint and kind, with the posterior of
the robot that goes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import position_residual
from compplan.diagnosis.data.shared import ENOUGH_ROWS, LEVEL, SAMPLE, SEED, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_channels, posterior_mean
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.results.verdict import CLAIMED, Finding
from compplan.diagnosis.search.state import FitState, attain_state
from compplan.diagnosis.validation.held_out import make_folds
from compplan.effects import driver_of, locate_effect, robot_effects
from compplan.effects.signature import Signature
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.search.state import Fit

CALIBRATION, UNEXPLAINED = "small errors everywhere", "not explained"


@dataclass(frozen=True)
class Share:
    """A share of the mean square deviation, with its 95 % interval. All three from 0 to 1."""

    share: float
    low: float
    high: float

    def to_json(self) -> dict[str, float]:
        """Return the share as diagnosis.json holds it."""
        return {"share": round(self.share, 4), "low": round(self.low, 4), "high": round(self.high, 4)}


@dataclass(frozen=True, eq=False)
class Part:
    """One part of the motion; r rows.

    Attributes:
        place: Where it sits.
        effect: Name of the effect.
        follows: What its error follows.
        probability: Probability that it is there.
        elsewhere: Place and driver of rivals that the campaign cannot tell from it.
        motion: Its motion of the target, frames taken out. Shape (3 r,). [m]
        columns: Its columns of the posterior's; empty where its size is held.
    """

    place: str
    effect: str
    follows: str
    probability: float
    elsewhere: tuple[tuple[str, str], ...]
    motion: Array
    columns: NDArray[np.int_]


@dataclass(frozen=True)
class Carrier:
    """A named effect at its place: share of the gap, its interval given that the effect is present, and probability."""

    place: str
    effect: str
    share: Share
    probability: float

    def to_json(self) -> dict[str, str | float]:
        """Return the carrier as diagnosis.json holds it."""
        probability = {"probability": round(self.probability, 4)}
        return {"place": self.place, "effect": self.effect, **self.share.to_json(), **probability}


@dataclass(frozen=True, eq=False)
class Shares:
    """A gap divided.

    Attributes:
        by_place: Share of each place: joints, other parts of the cell, small errors everywhere, not explained.
        by_factor: Share of what follows each factor, and what is not explained.
        carriers: Named findings with their shares, largest first.
        together: By place and effect: share.
        noise: Share that noise explains.
        rows: Rows that were looked at. Shape (r,).
        gap: Their gap, frames taken out. Shape (r, 3). [m]
        motions: Motion by claimed cause and by small errors everywhere, largest share first. Shape (r, 3) each. [m]
    """

    by_place: dict[str, Share]
    by_factor: dict[str, Share]
    carriers: tuple[Carrier, ...]
    together: dict[str, dict[str, float]]
    noise: float
    rows: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, int))
    gap: Array = field(default_factory=lambda: np.zeros((0, 3)))
    motions: dict[str, Array] = field(default_factory=dict)


def divide_gap(diagnosis: Diagnosis, seed: int = SEED) -> Shares:
    """Divide the gap of a diagnosis among its causes."""
    motion = PosteriorMotion(diagnosis, np.random.default_rng(seed))
    parts, added = list_parts(diagnosis, motion)
    point, drawn = motion.divide(parts, added)
    every = [*parts, *added]
    carriers = [
        Carrier(part.place, part.effect, find_interval(share, values), part.probability)
        for part, share, values in zip(every, point, drawn, strict=True)
        if part.place != CALIBRATION and part.probability >= CLAIMED
    ]
    together: dict[str, dict[str, float]] = {}
    for part, share in zip(every, point, strict=True):
        if part.probability >= CLAIMED:
            own = together.setdefault(part.place, {})
            own[part.effect] = own.get(part.effect, 0.0) + share
    noise = min(motion.noise, max(1.0 - sum(point), 0.0))
    fate = motion.draw_fate(every)
    places = [[part.place, *(place for place, _ in part.elsewhere)] for part in every]
    factors = [[part.follows, *(driver for _, driver in part.elsewhere)] for part in every]
    drivers = list(dict.fromkeys(name for own in factors for name in own))
    first = [*diagnosis.robot.joint_names, *(name for own in places for name in own if name != CALIBRATION)]
    stated = [share if part.probability >= CLAIMED else 0.0 for part, share in zip(every, point, strict=True)]
    return Shares(
        by_place=add_up([*dict.fromkeys(first), CALIBRATION], places, stated, drawn, fate, noise),
        by_factor=add_up(drivers, factors, stated, drawn, fate, noise),
        carriers=tuple(sorted(carriers, key=lambda c: -rank_number(c.share.share))), together=together, noise=noise,
        rows=motion.rows, gap=motion.gap.reshape(-1, 3), motions=_collect_motions(every, point),
    )  # fmt: skip


def _collect_motions(parts: Sequence[Part], shares: Sequence[float]) -> dict[str, Array]:
    """Return the motion of what is claimed, named by effect and place. Shape (r, 3) each. [m]"""
    motions: dict[str, Array] = {}
    for part, _ in sorted(zip(parts, shares, strict=True), key=lambda pair: -rank_number(pair[1])):
        if part.place == CALIBRATION or part.probability >= CLAIMED:
            effect = part.effect.replace("_", " ")
            name = CALIBRATION if part.place == CALIBRATION else f"{effect}, {part.place}"
            motions[name] = motions.get(name, 0.0) + part.motion.reshape(-1, 3)
    return motions


class PosteriorMotion:
    """The gap of a diagnosis and the motion of a posterior at the rows that were fitted; the doubt's where left out."""

    def __init__(self, diagnosis: Diagnosis, rng: np.random.Generator, fitted: Fit | None = None) -> None:
        model = fitted or diagnosis.doubt
        equations, posterior = model.search.equations, model.model.posterior
        source = equations.source[0]
        chosen = np.arange(len(source.rows))[:: -(-len(source.rows) // SAMPLE)]
        self.rows, self.rng, self.diagnosis = source.rows[chosen], rng, diagnosis
        self.sigma = np.repeat(source.sigma[chosen].ravel(), 3)
        design = equations.designs[0][chosen].reshape(3 * len(chosen), equations.p)
        self.frames = np.linalg.qr(design[:, equations.columns_named(REGISTRATION)])[0]
        self.columns, self.mean = posterior.columns, posterior.mean
        self.design = self.take_frames(design[:, posterior.columns] * self.sigma[:, None])
        values, vectors = np.linalg.eigh(posterior.covariance)
        # symmetric: a draw does not hang on the signs that an eigenvector happens to have
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        self.draws = self.mean[:, None] + root @ rng.normal(size=(len(values), SAMPLE))
        first = self.take_frames((equations.observed[0][chosen] * source.sigma[chosen]).ravel()[:, None])[:, 0]
        self.first_order = first
        self.conventions = _find_conventions(diagnosis, self)
        self.gap = first + sum((motion for _, motion in self.conventions), np.zeros_like(first))
        block = np.unique(draw_blocks(diagnosis.fit.problem.campaign, rng)[self.rows], return_inverse=True)[1]
        count = int(block.max(initial=0)) + 1
        weight = rng.multinomial(count, np.full(count, 1.0 / count), size=SAMPLE).T.astype(float)
        self.weight = np.repeat(weight[block], 3, axis=0)
        square = float(self.gap @ self.gap) / len(self.rows)
        self.noise = float(np.clip(diagnosis.verdict.structure.floor**2 / max(square, 1e-300), 0.0, 1.0))

    def follow(self, name: str) -> str:
        """Say what an effect's error follows; without any load it is the robot's own weight that bends it."""
        driver, campaign = driver_of(name), self.diagnosis.fit.problem.campaign
        loaded = driver != "load" or bool(campaign.is_load(campaign.wrench[campaign.usable]).any())
        return driver if loaded else "gravity"

    def take_frames(self, columns: Array) -> Array:
        """Take out of motions what frames that are fitted anyway follow. Shape (3 r, k). [m]"""
        whitened = columns / self.sigma[:, None]
        return np.asarray(columns - self.sigma[:, None] * (self.frames @ (self.frames.T @ whitened)))

    def at(self, columns: NDArray[np.int_]) -> NDArray[np.int_]:
        """Find columns of the normal equations among those of the posterior."""
        return np.flatnonzero(np.isin(self.columns, columns))

    def divide(self, parts: Sequence[Part], added: Sequence[Part]) -> tuple[list[float], list[Array]]:
        """Return the share of each part, and drawn shares of shape (SAMPLE,)."""
        whole = np.maximum(self.weight.T @ self.gap**2, 1e-300)
        square = max(float(self.gap @ self.gap), 1e-300)
        total = sum((part.motion for part in parts), np.zeros_like(self.gap))
        every = np.zeros((len(self.gap), SAMPLE))
        for part in parts:
            every += self.draw_motion(part)
        point, drawn = [], []
        left, rest = self.gap - total, self.gap[:, None] - every
        for part in parts:
            point.append(float(part.motion @ (part.motion + 2.0 * left)))
            own = self.draw_motion(part)
            drawn.append(np.einsum("ij,ij,ij->j", self.weight, own, own + 2.0 * rest))
        explained = np.array([1.0 - float(left @ left) / square])
        point = list(_scale_to(np.array(point).reshape(-1, 1), explained)[:, 0])
        explained = 1.0 - np.einsum("ij,ij->j", self.weight, rest**2) / whole
        drawn = list(_scale_to(np.array(drawn).reshape(-1, SAMPLE), explained))
        for part in added:
            own = part.motion * (2.0 * left - part.motion)
            point.append(max(float(own.sum()) / square, 0.0))
            drawn.append(np.maximum(self.weight.T @ own / whole, 0.0))
        return [float(value) for value in point], drawn

    def draw_motion(self, part: Part) -> Array:
        """Draw the motion of a part. Shape (3 r, SAMPLE). [m]"""
        if not len(part.columns):
            return np.repeat(part.motion[:, None], SAMPLE, axis=1)
        return np.asarray(self.design[:, part.columns] @ self.draws[part.columns])

    def draw_fate(self, parts: Sequence[Part]) -> list[NDArray[np.int_]]:
        """Draw where each part sits: -1 nowhere, 0 at its place, k at its rival k. Shape (SAMPLE,) each."""
        fates = []
        for part in parts:
            rivals = self.rng.integers(1, len(part.elsewhere) + 1, SAMPLE) if part.elsewhere else np.zeros(SAMPLE, int)
            # a place that the campaign cannot tell from another is no better and no worse
            fate = self.rng.integers(2, size=SAMPLE) * rivals
            fates.append(np.where(self.rng.random(SAMPLE) < part.probability, fate, -1))
        return fates


def list_parts(diagnosis: Diagnosis, motion: PosteriorMotion) -> tuple[list[Part], list[Part]]:
    """List the parts of the posterior's motion, and findings that it has given up."""
    verdict, doubt = diagnosis.verdict, diagnosis.doubt
    equations, taken = doubt.search.equations, set(doubt.model.signatures)
    parts = [
        Part(locate_effect(finding.effect.name, finding.effect.joint), finding.effect.name,
             motion.follow(finding.effect.name), finding.probability, (), moved, np.zeros(0, int))
        for finding, moved in motion.conventions
    ]  # fmt: skip
    added: list[Part] = []
    for finding in (*verdict.findings, *verdict.doubtful, *verdict.minor):
        if finding.signature < 0:
            continue
        if finding.signature in taken:
            own = motion.at(equations.columns(finding.signature))
            moved = motion.design[:, own] @ motion.mean[own]
            parts.append(_part_of(finding, motion, moved, own, small=finding in verdict.minor))
        else:
            added.append(_part_of(finding, motion, _given_up_motion(diagnosis, motion, finding), np.zeros(0, int)))
    claimed, background = equations.join_columns(taken), diagnosis.fit.search.prior.background
    names = dict.fromkeys(s.name for s in equations.signatures)
    for name in names:
        columns = equations.columns_named(name)
        columns = columns[columns < len(background)]
        small = np.setdiff1d(columns[background[columns] >= 0], claimed)
        own = motion.at(small)
        if len(own):
            moved = motion.design[:, own] @ motion.mean[own]
            parts.append(Part(CALIBRATION, name, motion.follow(name), 1.0, (), moved, own))
    return parts, added


def draw_blocks(campaign: Campaign, rng: np.random.Generator) -> NDArray[np.int_]:
    """Put rows into groups: static rows of one pose together, rows of a path in stretches. Shape (n,)."""
    _, pose = np.unique(campaign.pose, return_inverse=True)
    label = rng.permutation(pose.max() + 1)[pose.reshape(-1)]
    on_path = campaign.on_path
    for run in np.unique(campaign.run_index[on_path]):
        inside = np.flatnonzero(on_path & (campaign.run_index == run))
        stretches = max(len(inside) // ENOUGH_ROWS, 1)
        start = int(label.max()) + 1
        label[inside] = start + np.arange(len(inside)) * stretches // len(inside)
    _, block = np.unique(label, return_inverse=True)
    return np.asarray(block)


def find_interval(share: float, drawn: Array) -> Share:
    """Return a share with the interval of its draws."""
    low, high = np.quantile(drawn, 0.5 + LEVEL * np.array([-0.5, 0.5]))
    return Share(*(float(np.clip(value, 0.0, 1.0)) for value in (share, min(low, share), max(high, share))))


def _part_of(
    finding: Finding, motion: PosteriorMotion, moved: Array, columns: NDArray[np.int_], *, small: bool = False
) -> Part:
    effect = finding.effect
    if small:
        return Part(CALIBRATION, effect.name, motion.follow(effect.name), 1.0, (), moved, columns)
    place = locate_effect(effect.name, effect.joint)
    elsewhere = [(locate_effect(r.place[0], r.place[1]), motion.follow(r.place[0])) for r in finding.rivals if r.alike]
    return Part(
        place, effect.name, motion.follow(effect.name), finding.probability, tuple(dict.fromkeys(elsewhere)), moved,
        columns,
    )  # fmt: skip


def _given_up_motion(diagnosis: Diagnosis, motion: PosteriorMotion, finding: Finding) -> Array:
    """Return the motion of a claim of the fit that errors without a name explain as well. Shape (3 r,). [m]"""
    equations, posterior = diagnosis.fit.search.equations, diagnosis.fit.model.posterior
    source, columns = equations.source[0], equations.columns(finding.signature)
    chosen = np.isin(source.rows, motion.rows)
    moved = equations.designs[0][chosen][..., columns] @ posterior.values(equations.p)[columns]
    return motion.take_frames((moved * source.sigma[chosen]).reshape(-1, 1))[:, 0]


def _find_conventions(diagnosis: Diagnosis, motion: PosteriorMotion) -> list[tuple[Finding, Array]]:
    """Return what conventions of counting, found beforehand, move: exact, one after the other."""
    problem, known = diagnosis.fit.problem, len(robot_effects(diagnosis.robot))
    found = [finding for finding in diagnosis.verdict.findings if finding.signature < 0]
    if not found:
        return []
    before = motion.take_frames(diagnosis.residual_before[motion.rows].reshape(-1, 1))[:, 0]
    left, moves = before, []
    for number in range(len(found)):
        state = FitState(problem.fixed[: known + number + 1], {}, diagnosis.registration, problem.campaign.usable)
        after = position_residual(problem.campaign, *attain_state(problem, state))[motion.rows]
        after = motion.take_frames(after.reshape(-1, 1))[:, 0]
        after = motion.first_order if number + 1 == len(found) else after
        moves.append(left - after)
        left = after
    return list(zip(found, moves, strict=True))


def add_up(
    names: Sequence[str], homes: Sequence[Sequence[str]], stated: Sequence[float], drawn: Sequence[Array],
    fate: Sequence[NDArray[np.int_]], noise: float,
) -> dict[str, Share]:  # fmt: skip
    """Add up the shares of parts by name; what no part explains comes last.

    `homes` are the name of each part and of its rivals, `fate` tells which of these it has in each draw, -1 for none.
    Shapes of `drawn` and `fate`: (SAMPLE,) each.
    """
    draws = {name: np.zeros(SAMPLE) for name in names}
    shares = dict.fromkeys(names, 0.0)
    for own, share, values, where in zip(homes, stated, drawn, fate, strict=True):
        shares[own[0]] += share
        for number, name in enumerate(own):
            draws[name] += values * (where == number)
    rest = np.maximum(1.0 - noise - sum(draws.values(), np.zeros(SAMPLE)), 0.0)
    result = {name: find_interval(shares[name], draws[name]) for name in shares}
    return {**result, UNEXPLAINED: find_interval(max(1.0 - noise - sum(shares.values()), 0.0), rest)}


def _scale_to(values: Array, explained: Array) -> Array:
    """Divide what is explained in proportion to values; negative ones count as nothing. Shapes (parts, k), (k,)."""
    positive = np.maximum(values, 0.0)
    whole = np.maximum(positive.sum(axis=0), 1e-300)
    return np.asarray(positive / whole * np.clip(explained, 0.0, 1.0))


#: Kinds of errors by what they follow; those that follow the load are the robot's own weight where it does not vary.
GEOMETRY, GEARS, WEIGHT, LOAD, OTHER = "geometry", "gears", "own weight", "load", "other"
KINDS = {
    "posture": GEOMETRY, "joint angle": GEARS, "direction of approach": GEARS, "gravity": WEIGHT, "load": LOAD,
}  # fmt: skip
#: Halves of the poses tell a group alike where their motions have this cosine at least, and a group is listed from this
#: share of the gap on (assumed: half of the way; a twentieth).
ALIKE, LISTED = 0.5, 0.05


@dataclass(frozen=True)
class Group:
    """Errors of one kind at a place; `repeats`: cosine between the motions that two halves of the poses lead to."""

    place: str
    kind: str
    share: Share
    repeats: float

    def to_json(self) -> dict[str, Any]:
        """Return the group as diagnosis.json holds it."""
        return {"place": self.place, "kind": self.kind, **self.share.to_json(), "halves_alike": round(self.repeats, 3)}


@dataclass(frozen=True)
class SmallErrors:
    """A gap divided among the errors of a calibration, by place, by kind, and by groups that both halves tell."""

    by_place: dict[str, Share]
    by_kind: dict[str, Share]
    groups: tuple[Group, ...]

    def to_json(self) -> dict[str, Any]:
        """Return what stands under `where` in diagnosis.json."""
        return {
            "by_joint": {name: share.to_json() for name, share in self.by_place.items()},
            "by_kind": {name: share.to_json() for name, share in self.by_kind.items()},
            "groups": [group.to_json() for group in self.groups],
        }


def divide_small_errors(diagnosis: Diagnosis, seed: int = SEED) -> SmallErrors | None:
    """Divide a gap among the errors of the robot that goes out; None where the nominal one does."""
    fitted = diagnosis.delivery.fitted
    if fitted is None:
        return None
    motion = PosteriorMotion(diagnosis, np.random.default_rng(seed), fitted)
    homes, parts = [], []
    for (place, kind), columns in group_columns(fitted, diagnosis.fit.problem.campaign.load_varies).items():
        own = motion.at(columns)
        if len(own):
            homes.append((place, kind))
            parts.append(Part(place, kind, kind, 1.0, (), motion.design[:, own] @ motion.mean[own], own))
    point, drawn = motion.divide(parts, [])
    noise = min(motion.noise, max(1.0 - sum(point), 0.0))
    here = [np.zeros(len(values), int) for values in drawn]
    halves = fit_halves(fitted)
    groups = []
    for home, part, share, values in zip(homes, parts, point, drawn, strict=True):
        if share >= LISTED:
            alike = compare_halves(motion, part, halves)
            if alike >= ALIKE:
                groups.append(Group(*home, find_interval(share, values), alike))

    def total(side: int) -> dict[str, Share]:
        names = list(dict.fromkeys(home[side] for home in homes))
        return add_up(names, [(home[side],) for home in homes], point, drawn, here, noise)

    return SmallErrors(total(0), total(1), tuple(sorted(groups, key=lambda group: -rank_number(group.share.share))))


def kind_of(name: str, loaded: bool) -> str:
    """Return the kind of an effect's error; `loaded`: whether the load varies."""
    kind = KINDS.get(driver_of(name), OTHER)
    return kind if loaded or kind != LOAD else WEIGHT


def group_columns(fitted: Fit, loaded: bool) -> dict[tuple[str, str], NDArray[np.int_]]:
    """Return the columns of each place and kind of error, each column once."""
    equations, found = fitted.search.equations, dict[tuple[str, str], list[int]]()
    taken: set[int] = set()
    for number, signature in enumerate(equations.signatures):
        if signature.name == REGISTRATION:
            continue
        for column, place in zip(equations.columns(number).tolist(), _places(signature), strict=True):
            if column not in taken:
                taken.add(column)
                found.setdefault((place, kind_of(signature.name, loaded)), []).append(column)
    return {home: np.array(sorted(columns)) for home, columns in found.items()}


def _places(signature: Signature) -> Sequence[str]:
    """Return where each parameter of a signature sits: bending under own weight has one for each joint."""
    joints = signature.fixed.get("joints", ())
    if len(joints) == len(signature.keys):
        return [str(joint) for joint in joints]
    return [locate_effect(signature.name, signature.joint)] * len(signature.keys)


def fit_halves(fitted: Fit) -> list[Array]:
    """Return the values of the posterior's columns that two halves of the poses lead to, prior and noise held."""
    posterior, half = fitted.model.posterior, make_folds(fitted.problem.campaign, 2)
    variance = fitted.search.prior_of(fitted.model.claims).variance(posterior.hyper.log_tau)[posterior.columns]
    products = [
        combine_channels(select_rows(fitted.search.equations, half == k, posterior.columns), posterior.hyper)
        for k in range(2)
    ]
    return [posterior_mean(gram, against, variance) for gram, against, _, _ in products]


def compare_halves(motion: PosteriorMotion, part: Part, halves: Sequence[Array]) -> float:
    """Return the cosine between the motions that two halves of the poses give a part."""
    first, second = (motion.design[:, part.columns] @ values[part.columns] for values in halves)
    return float(first @ second / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-300))
