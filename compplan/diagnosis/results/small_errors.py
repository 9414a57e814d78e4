"""Small errors: a robot that was not calibrated, its gap divided by joint and by kind of error.

Where nothing is named and yet lawful errors of every kind, each small, leave little on poses that they never saw, the
robot is off everywhere and by nothing in particular: `calibrated`. The shares are those of `shares`,
with the posterior of the robot that goes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import SEED, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_channels, posterior_mean
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.results.shares import Part, PosteriorMotion, Share, add_up, find_interval
from compplan.diagnosis.validation.held_out import make_folds
from compplan.effects import driver_of, locate_effect
from compplan.effects.signature import Signature
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.search.state import Fit

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
    """Errors of one kind at a joint or another part of the cell, known together though not one by one.

    `repeats` is the cosine between the motions that two halves of the poses lead to.
    """

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
    fitted = diagnosis.deliveries[0].fitted
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
