"""Self-test: plant effects of known size in the poses and the noise of a campaign, and diagnose each of them.

An effect is drawn from the prior of the diagnosis: each name of the vocabulary equally probable, at one of its places,
its parameters normal with the width of its prior. Every small error is drawn as well, with the width fitted to its
class. The exact model predicts the rows; noise and repeatability are those of the campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
from compplan.diagnosis.data.shared import SEED
from compplan.diagnosis.evidence.candidates import in_background
from compplan.diagnosis.results.result import Diagnosis, place_table
from compplan.diagnosis.results.verdict import CLAIMED, Finding, motion_of
from compplan.diagnosis.search.state import Fit, FitState, Problem, attain_state, build_state, has_equilibrium
from compplan.diagnosis.validation.bounds import find_breach
from compplan.effects import Effect
from compplan.effects.forward_model import Attained
from compplan.effects.linearization import Place
from compplan.effects.signature import plain
from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

#: Number of planted effects (assumed: as many as a minute allows on 40 poses).
PLANTED = 20
#: Most draws of an effect until it is feasible, and most passes over the vocabulary (assumed: most need one).
TRIES = 20
#: Probabilities from which on the share of right findings is counted: naming limit, and .8 (assumed).
STATED = (CLAIMED, 0.8)
FOUND, TIED, CONFUSED, MISSED = "found", "tied", "confused", "missed"


@dataclass(frozen=True, eq=False)
class PlantedEffect:
    """A planted effect and the effects that the diagnosis named."""

    effect: Effect
    moved: float  #: Rms motion of the target by it. [m]
    named: tuple[Finding, ...]

    def is_right(self, finding: Finding) -> bool:
        """Check whether a named effect is the planted one or indistinguishable from it in this campaign."""
        return self.effect.place in (finding.effect.place, *(r.place for r in finding.rivals if r.alike))

    @property
    def outcome(self) -> str:
        """One of "found", "tied" (listed with a rival of it), "confused" (others are named) and "missed"."""
        if any(finding.effect.place == self.effect.place for finding in self.named):
            return FOUND
        tied = any(self.is_right(finding) for finding in self.named)
        return TIED if tied else CONFUSED if self.named else MISSED

    def to_json(self) -> dict[str, Any]:
        """Return the effect in the format of diagnosis.json."""
        return {
            **place_table(self.effect.place), "outcome": self.outcome, "moved_rms_mm": round(1e3 * self.moved, 5),
            "parameters": {key: plain(value) for key, value in self.effect.parameters.items()},
            "named": [
                {**place_table(f.effect.place), "probability": round(f.probability, 4), "right": self.is_right(f)}
                for f in self.named
            ],
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class SelfTest:
    """Diagnoses of planted effects in a campaign."""

    planted: tuple[PlantedEffect, ...]
    asked: int  #: Requested number of effects.
    seed: int

    def to_json(self) -> dict[str, Any]:
        """Return the content of `self_test` in diagnosis.json."""
        stated = []
        for least in STATED:
            right = [one.is_right(f) for one in self.planted for f in one.named if f.probability >= least]
            stated.append({"from_probability": least, "named": len(right), "right": sum(right)})
        planted = [one.to_json() for one in self.planted]
        return {"asked": self.asked, "seed": self.seed, "planted": planted, "probabilities": stated}


def run_self_test(
    diagnosis: Diagnosis, count: int = PLANTED, seed: int = SEED,
    progress: Callable[[int, float], None] = lambda done, left: None,
) -> SelfTest:  # fmt: skip
    """Plant effects one at a time and diagnose each; Ctrl-C returns those that are done.

    Args:
        diagnosis: The diagnosis of the campaign.
        count: Number of effects.
        seed: Seed of effects, small errors and noise.
        progress: Called with the number done and the expected seconds left; NaN before the first.

    Raises:
        InputError: If a row was measured by other instruments than a tracker.
    """
    fit = diagnosis.fit
    check_self_test(fit.problem.campaign)
    rng, done, start = np.random.default_rng(seed), list[PlantedEffect](), perf_counter()
    try:
        for number in _choose_signatures(fit, rng):
            used, left = perf_counter() - start, count - len(done)
            progress(len(done), used / len(done) * left if done else float("nan"))
            if not left:
                break
            if (one := _plant(fit, number, rng)) is not None:
                done.append(one)
    except KeyboardInterrupt:
        pass
    return SelfTest(tuple(done), count, seed)


def check_self_test(campaign: Campaign) -> None:
    """Raise InputError for a log with rows of other instruments than a tracker."""
    if campaign.observations is not None:
        message = "--self-test takes logs of positions alone, without contacts, readings and distances"
        raise InputError(message, file=campaign.file)


def _choose_signatures(fit: Fit, rng: np.random.Generator) -> Iterator[int]:
    """Choose signatures to plant: every name once in random order, then again, at a random place and form."""
    search, by_name = fit.search, dict[str, dict[Place, list[int]]]()
    for number in search.candidates:
        signature = search.equations.signatures[number]
        # rows and periods found in this log do not belong to the vocabulary
        if signature.tried == 1 and signature.name not in fit.problem.excluded:
            by_name.setdefault(signature.name, {}).setdefault(signature.place, []).append(number)
    for _ in range(TRIES):
        for name in rng.permutation(sorted(by_name)):
            forms = list(by_name[str(name)].values())
            yield int(rng.choice(forms[int(rng.integers(len(forms)))]))


def _plant(fit: Fit, number: int, rng: np.random.Generator) -> PlantedEffect | None:
    """Plant an effect and diagnose it; None if no draw of it is feasible for the robot."""
    problem, equations = replace(fit.problem), fit.search.equations
    columns = equations.columns(number)
    for _ in range(TRIES):
        state = _draw_state(fit, number, rng)
        sizes = np.zeros(equations.p)
        sizes[columns] = [state.values.get(equations.names[c], 0.0) / equations.scale[c] for c in columns]
        moved = motion_of(fit.search, columns, sizes)
        if not sizes.any() or not has_equilibrium(problem, state):
            continue
        effect = state.effects[len(problem.fixed)]
        if not find_breach(fit, effect, moved, moved):
            campaign = _measure(fit, attain_state(problem, state)[1], rng)
            return PlantedEffect(effect, moved, _diagnose(problem, campaign))
    return None


def _draw_state(fit: Fit, number: int, rng: np.random.Generator) -> FitState:
    """Draw an effect of a signature together with small errors."""
    equations, prior = fit.search.equations, fit.search.prior
    width = np.sqrt(prior.variance(fit.model.posterior.hyper.log_tau))
    values = rng.normal(size=equations.p) * np.where(prior.background >= 0, width, 0.0)
    columns = equations.columns(number)
    values[columns] = rng.normal(size=len(columns))
    values[columns] = np.abs(values[columns]) if equations.signatures[number].positive else values[columns]
    small = [n for n, signature in enumerate(equations.signatures) if in_background(signature)]
    return build_state(fit, values, [number], small)


def _measure(fit: Fit, attained: Attained, rng: np.random.Generator) -> Campaign:
    """Simulate the measurement of a model: rows, columns and noise of the campaign."""
    campaign, noises = fit.problem.campaign, fit.noises
    rows, stay = np.arange(len(campaign)), campaign.stay

    def draw(name: str, values: Array) -> Array:
        if (noise := noises.get(name)) is None:
            return np.zeros_like(values)
        error = noise.sigma * noise.spread_of(rows)[:, None] * rng.normal(size=values.shape)
        return np.asarray(error + noise.stay * rng.normal(size=(int(stay.max()) + 1, values.shape[1]))[stay])

    position = attained.position + draw("position", attained.position)
    found = replace(campaign, position=np.where(campaign.measured[:, None], position, np.nan))
    if campaign.rotation is not None:
        turn = Rotation.from_rotvec(draw("orientation", attained.position)).as_matrix()
        found = replace(found, rotation=np.where(np.isfinite(campaign.rotation), turn @ attained.rotation, np.nan))
    if campaign.link is not None:
        link = attained.link + draw("encoder", attained.link)
        found = replace(found, link=np.where(np.isfinite(campaign.link), link, np.nan))
    if campaign.motor is not None:
        found = replace(found, motor=np.where(np.isfinite(campaign.motor), attained.motor, np.nan))
    return found


def _diagnose(problem: Problem, campaign: Campaign) -> tuple[Finding, ...]:
    """Return the named effects without the known ones; empty if the diagnosis rejects the log."""
    try:
        found = diagnose_campaign(problem.robot, campaign, register=problem.register, without=problem.without)
    except InputError:
        return ()
    known = {effect.place for effect in problem.fixed}
    return tuple(finding for finding in found.verdict.findings if finding.effect.place not in known)
