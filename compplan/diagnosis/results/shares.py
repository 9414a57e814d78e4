"""Shares: the motion by each cause of a diagnosis, as parts of the mean square gap.

The causes are the findings of the verdict and small errors by place and kind, with the posterior of the calibration.
With the gap y (registered frames projected out), the motion m_g of each part and the residual r = y - sum m_g of all
parts, removing one part alone raises the squares by

    d_g = |r + m_g|^2 - |r|^2 = m_g . (m_g + 2 r)

The squares that all parts explain, |y|^2 - |r|^2, are divided in proportion to d_g: parts that cancel each other keep
their weight. Intervals draw parameters from the posterior, resample pose groups, and draw the presence of a finding
from its probability: one with an indistinguishable rival elsewhere is at its place half of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ENOUGH_ROWS, LEVEL, LISTED, SAMPLE, SEED, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.results.delivery import NOMINAL
from compplan.effects import driver_of, locate_effect
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis

#: Kinds of errors by driver; those that follow the load are the robot's own weight if the load does not vary.
GEOMETRY, GEARS, WEIGHT, LOAD, OTHER = "geometry", "gears", "own weight", "load", "other"
KINDS = {
    "posture": GEOMETRY, "joint angle": GEARS, "direction of approach": GEARS, "gravity": WEIGHT, "load": LOAD,
}  # fmt: skip
CALIBRATION, UNEXPLAINED = "small errors everywhere", "not explained"


@dataclass(frozen=True)
class Share:
    """A share of the mean square deviation, with its 95 % interval. All three from 0 to 1."""

    share: float
    low: float
    high: float

    def to_json(self) -> dict[str, float]:
        """Return the share in the format of diagnosis.json."""
        return {"share": round(self.share, 4), "low": round(self.low, 4), "high": round(self.high, 4)}


@dataclass(frozen=True, eq=False)
class Part:
    """One part of the motion; r rows."""

    place: str  #: Place of the error.
    kind: str  #: Kind of its error, one of `KINDS` or "other".
    follows: str  #: Driver of its error.
    probability: float  #: Probability that it is present.
    motion: Array  #: Its motion of the target, frames projected out. Shape (3 r,). [m]
    columns: NDArray[np.int_]  #: Its columns of the posterior; empty if its size is held.
    small: bool = False  #: Whether it is a small error, without a name.


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of a gap."""

    #: Share of each place: joints, other parts of the cell, small errors everywhere, not explained.
    by_place: dict[str, Share]
    by_factor: dict[str, Share]  #: Share of each driver, and unexplained share.
    noise: float  #: Share of noise.


@dataclass(frozen=True)
class SmallErrors:
    """Shares of all errors of the delivered robot, largest first: groups of place and kind."""

    by_place: dict[str, Share]
    by_kind: dict[str, Share]
    groups: tuple[tuple[str, str, Share], ...]

    def to_json(self) -> dict[str, Any]:
        """Return the content of `where` in diagnosis.json."""
        return {
            "by_joint": {name: share.to_json() for name, share in self.by_place.items()},
            "by_kind": {name: share.to_json() for name, share in self.by_kind.items()},
            "groups": [{"place": place, "kind": kind, **share.to_json()} for place, kind, share in self.groups],
        }


def divide_gap(diagnosis: Diagnosis, seed: int = SEED) -> tuple[Shares, SmallErrors | None]:
    """Divide the gap of a diagnosis among its causes, and among all errors of the delivered robot.

    The second is None if the nominal robot is delivered.
    """
    motion = PosteriorMotion(diagnosis, np.random.default_rng(seed))
    every = list_parts(diagnosis, motion)
    point, drawn = motion.divide(every)
    noise = min(motion.noise, max(1.0 - sum(point), 0.0))

    def total(names: Sequence[str], shares: Sequence[Array], first: Sequence[str] = ()) -> dict[str, Share]:
        return add_up(list(dict.fromkeys((*first, *names))), names, point, shares, noise)

    present = [share * (motion.rng.random(SAMPLE) < part.probability) for part, share in zip(every, drawn, strict=True)]
    places = [CALIBRATION if part.small else part.place for part in every]
    first = [*diagnosis.robot.joint_names, *(name for name in places if name != CALIBRATION), CALIBRATION]
    shares = Shares(total(places, present, first), total([part.follows for part in every], present), noise)
    if diagnosis.delivery.kind == NOMINAL:
        return shares, None
    found: dict[tuple[str, str], list[int]] = {}
    for number, part in enumerate(every):
        found.setdefault((part.place, part.kind), []).append(number)
    groups = [
        (*name, find_interval(sum(point[n] for n in members), np.sum([drawn[n] for n in members], axis=0)))
        for name, members in found.items()
    ]
    groups.sort(key=lambda group: -rank_number(group[2].share))
    by_place, by_kind = (total([getattr(part, key) for part in every], drawn) for key in ("place", "kind"))
    return shares, SmallErrors(by_place, by_kind, tuple(groups[:LISTED]))


class PosteriorMotion:
    """The gap of a diagnosis and the motion of the calibration's posterior at the fitted rows."""

    def __init__(self, diagnosis: Diagnosis, rng: np.random.Generator) -> None:
        equations, posterior = diagnosis.equations, diagnosis.delivery.posterior
        source = equations.source[0]
        chosen = np.arange(len(source.rows))[:: -(-len(source.rows) // SAMPLE)]
        self.rows, self.rng, self.diagnosis = source.rows[chosen], rng, diagnosis
        self.sigma = np.repeat(source.sigma[chosen].ravel(), 3)
        design = equations.designs[0][chosen].reshape(3 * len(chosen), equations.p)
        self.frames = np.linalg.qr(design[:, equations.columns_named(REGISTRATION)])[0]
        self.columns, self.mean = posterior.columns, posterior.mean
        self.design = self.take_frames(design[:, posterior.columns] * self.sigma[:, None])
        values, vectors = np.linalg.eigh(posterior.covariance)
        # symmetric root: draws do not depend on the signs of the eigenvectors
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        self.draws = self.mean[:, None] + root @ rng.normal(size=(len(values), SAMPLE))
        self.first_order = self.take_frames(equations.observed[0][chosen].ravel() * self.sigma)
        # conventions found beforehand move the target by centimetres; their motion is not in the first-order gap
        self.gap = self.first_order
        self.conventions = [finding for finding in diagnosis.verdict.findings if finding.signature < 0]
        if self.conventions:
            self.gap = self.take_frames(diagnosis.residual_before[self.rows].reshape(-1))
        block = np.unique(draw_blocks(diagnosis.fit.problem.campaign, rng)[self.rows], return_inverse=True)[1]
        count = int(block.max(initial=0)) + 1
        weight = rng.multinomial(count, np.full(count, 1.0 / count), size=SAMPLE).T.astype(float)
        self.weight = np.repeat(weight[block], 3, axis=0)
        square = float(self.gap @ self.gap) / len(self.rows)
        self.noise = float(np.clip(diagnosis.verdict.structure.floor**2 / max(square, 1e-300), 0.0, 1.0))

    def driver(self, name: str) -> str:
        """Return the driver of an effect's error; without any load, "load" becomes "gravity"."""
        driver, campaign = driver_of(name), self.diagnosis.fit.problem.campaign
        loaded = driver != "load" or bool(campaign.is_load(campaign.wrench[campaign.usable]).any())
        return driver if loaded else "gravity"

    def take_frames(self, columns: Array) -> Array:
        """Project registered frames out of motions. Shape (3 r,) or (3 r, k). [m]"""
        sigma = self.sigma.reshape(-1, *[1] * (columns.ndim - 1))
        return np.asarray(columns - sigma * (self.frames @ (self.frames.T @ (columns / sigma))))

    def part(
        self, name: str, columns: NDArray[np.int_], place: str, probability: float = 1.0, *, small: bool = False
    ) -> Part:
        """Return the part of given columns of the normal equations."""
        index = np.flatnonzero(np.isin(self.columns, columns))
        kind = kind_of(name, self.diagnosis.fit.problem.campaign.load_varies)
        moved = self.design[:, index] @ self.mean[index]
        return Part(place, kind, self.driver(name), probability, moved, index, small)

    def divide(self, parts: Sequence[Part]) -> tuple[list[float], list[Array]]:
        """Return the share of each part, and drawn shares of shape (SAMPLE,)."""
        whole = np.maximum(self.weight.T @ self.gap**2, 1e-300)
        square = max(float(self.gap @ self.gap), 1e-300)
        moves = [self.draw_motion(part) for part in parts]
        left = self.gap - sum((part.motion for part in parts), np.zeros_like(self.gap))
        rest = self.gap[:, None] - sum(moves, np.zeros((len(self.gap), SAMPLE)))
        back = [float(part.motion @ (part.motion + 2.0 * left)) for part in parts]
        drawn_back = [np.einsum("ij,ij,ij->j", self.weight, move, move + 2.0 * rest) for move in moves]
        explained = np.array([1.0 - float(left @ left) / square])
        point = _scale_to(np.array(back).reshape(-1, 1), explained)[:, 0].tolist()
        explained = 1.0 - np.einsum("ij,ij->j", self.weight, rest**2) / whole
        return point, list(_scale_to(np.array(drawn_back).reshape(-1, SAMPLE), explained))

    def draw_motion(self, part: Part) -> Array:
        """Draw the motion of a part. Shape (3 r, SAMPLE). [m]"""
        if not len(part.columns):
            return np.repeat(part.motion[:, None], SAMPLE, axis=1)
        return np.asarray(self.design[:, part.columns] @ self.draws[part.columns])


def list_parts(diagnosis: Diagnosis, motion: PosteriorMotion) -> list[Part]:
    """List the parts of the posterior's motion: findings, then small errors by place and effect."""
    equations, nothing = diagnosis.equations, np.zeros(0, int)
    parts: list[Part] = []
    for finding in motion.conventions:
        place = locate_effect(finding.effect.name, finding.effect.joint)
        part = motion.part(finding.effect.name, nothing, place, finding.probability)
        # several conventions share it equally
        parts.append(replace(part, motion=(motion.gap - motion.first_order) / len(motion.conventions)))
    used = set[int]()
    for finding in (f for f in diagnosis.verdict.findings if f.signature >= 0):
        name, columns = finding.effect.name, equations.columns(finding.signature)
        parts.append(motion.part(name, columns, locate_effect(name, finding.effect.joint), finding.probability))
        used.update(columns.tolist())
    small: dict[tuple[str, str], list[int]] = {}
    for number, signature in enumerate(equations.signatures):
        if signature.name == REGISTRATION:
            continue
        # bending under own weight has a parameter for each joint
        joints = signature.fixed.get("joints", ())
        places = [str(joint) for joint in joints] if len(joints) == len(signature.keys) else []
        places = places or [locate_effect(signature.name, signature.joint)] * len(signature.keys)
        for column, place in zip(equations.columns(number).tolist(), places, strict=True):
            if column not in used:
                used.add(column)
                small.setdefault((signature.name, place), []).append(column)
    found = [motion.part(name, np.array(columns), place, small=True) for (name, place), columns in small.items()]
    return [*parts, *(part for part in found if len(part.columns))]


def draw_blocks(campaign: Campaign, rng: np.random.Generator) -> NDArray[np.int_]:
    """Group the rows for resampling: static rows of one pose together, rows of a path in sections. Shape (n,)."""
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


def add_up(
    names: Sequence[str], part_names: Sequence[str], stated: Sequence[float], drawn: Sequence[Array], noise: float
) -> dict[str, Share]:
    """Add up the shares of parts by name; the unexplained share is last.

    `part_names` are the names of the parts, `stated` their shares, `drawn` their drawn shares. Shape (SAMPLE,) each.
    """
    draws = {name: np.zeros(SAMPLE) for name in names}
    shares = dict.fromkeys(names, 0.0)
    for name, share, values in zip(part_names, stated, drawn, strict=True):
        shares[name] += share
        draws[name] = draws[name] + values
    rest = np.maximum(1.0 - noise - sum(draws.values(), np.zeros(SAMPLE)), 0.0)
    result = {name: find_interval(shares[name], draws[name]) for name in shares}
    return {**result, UNEXPLAINED: find_interval(max(1.0 - noise - sum(shares.values()), 0.0), rest)}


def _scale_to(values: Array, explained: Array) -> Array:
    """Divide the explained share in proportion to values; negative ones count as zero. Shapes (parts, k), (k,)."""
    positive = np.maximum(values, 0.0)
    whole = np.maximum(positive.sum(axis=0), 1e-300)
    return np.asarray(positive / whole * np.clip(explained, 0.0, 1.0))


def kind_of(name: str, loaded: bool) -> str:
    """Return the kind of an effect's error; `loaded`: whether the load varies."""
    kind = KINDS.get(driver_of(name), OTHER)
    return kind if loaded or kind != LOAD else WEIGHT
