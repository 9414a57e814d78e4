"""One case of a seed: kind, robot, effects, campaigns, everyday errors, causes at their sizes, labels.

What cannot be labelled fairly is drawn again, up to fourteen times. The kinds come from a low-discrepancy sequence over
the seeds, and the seed chooses the first effect, so that what is hard to draw is not drawn less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.outsider.campaign import Campaign, draw_campaign
from benchmarks.outsider.catalogue import CATALOGUE
from benchmarks.outsider.cause import Cause, Maker, Sized
from benchmarks.outsider.everyday import Everyday, draw_everyday
from benchmarks.outsider.known import KNOWN
from benchmarks.outsider.labels import Bench, label_causes
from benchmarks.outsider.observe import observe
from benchmarks.outsider.robots import SCALE, Robot
from benchmarks.outsider.settings import Settings, draw_settings
from benchmarks.outsider.signatures import linearize
from benchmarks.outsider.turns import Array, Rng
from benchmarks.outsider.unknown import ON_RAILS, UNKNOWN
from benchmarks.outsider.weighing import Instrument, draw_instrument, register, rms

KINDS: Mapping[str, float] = {
    "single": 0.38,
    "double": 0.18,
    "multi": 0.09,
    "mixed": 0.12,
    "unknown": 0.15,
    "none": 0.03,
    "background": 0.05,
}
ATTEMPTS = 14
FIRST_KEPT = 6  # attempts in which the seed's first effect and robot stay
TRIALS = 9  # of one cause
SEVERAL = ("joint_stiffness", "joint_offset", "backlash", "link_geometry", "transmission_error")
FEWEST_ROWS = (20, 12)
CLEARLY = 4.7  # standard deviations of a cause alone
LARGEST_M = 0.012


@dataclass(frozen=True)
class Case:
    """A drawn case; its logs go on drawing from `rng`."""

    seed: int
    attempt: int
    kind: str
    robot: Robot
    settings: Settings
    instrument: Instrument
    given: Campaign
    fresh: Campaign
    everyday: Sequence[Everyday]
    causes: Sequence[Sized]
    labels: Sequence[Mapping[str, Any]]
    frames: Array
    rng: Rng


def kind_of(seed: int) -> str:
    """Kind of the case of a seed."""
    place, end = (seed * 0.6180339887498949 + 0.37) % 1.0, 0.0
    for kind, share in KINDS.items():
        end += share
        if place < end:
            return kind
    return "background"


def draw_case(seed: int) -> Case | None:
    """Draw the case of a seed; None if no attempt gave one that can be labelled fairly."""
    for attempt in range(ATTEMPTS):
        case = _attempt(seed, attempt)
        if case is not None:
            return case
    return None


def _attempt(seed: int, attempt: int) -> Case | None:
    rng, habit = np.random.default_rng([seed, 77, attempt]), np.random.default_rng([seed, 3])
    kind, late = kind_of(seed), attempt >= FIRST_KEPT
    robot = CATALOGUE[(seed * 5 + seed // 14 + attempt * 3 * late) % len(CATALOGUE)]
    several = int(rng.choice([3, 3, 4]))
    count = {"single": 1, "double": 2, "multi": several, "mixed": 1}.get(kind, 0)
    design = str(rng.choice(["plain", "weights", "sensor"], p=[0.45, 0.42, 0.13]))
    effects = _choose_effects(rng, robot, count, None if late else habit)
    if effects is None:
        return None
    settings = draw_settings(rng, robot, design, effects, kind)
    given, fresh = (draw_campaign(rng, robot, settings, later) for later in (False, True))
    if given.rows < FEWEST_ROWS[0] or fresh.rows < FEWEST_ROWS[1]:
        return None
    instrument = draw_instrument(rng, robot, given)
    signatures = linearize(robot, given, settings)
    everyday: list[Everyday] = []
    if not settings.calm:
        level = instrument.floor(given) * rng.uniform(0.9 if kind == "background" else 0.5, 1.9) / np.sqrt(3)
        everyday = draw_everyday(rng, robot, given, signatures, level)
    bench = Bench(robot, given, settings, instrument, everyday, signatures)
    order = _Order(seed, attempt, bench, habit) if kind in ("mixed", "unknown") else None
    causes = _draw_causes(bench, rng, [KNOWN[effect][0] for effect in effects], order)
    labelled = None if causes is None else label_causes(bench, causes)
    if causes is None or labelled is None:
        return None
    labels, frames = labelled
    return Case(seed, attempt, kind, robot, settings, instrument, given, fresh, everyday, causes, labels, frames, rng)


def _choose_effects(rng: Rng, robot: Robot, count: int, habit: Rng | None) -> list[str] | None:
    """Names of the known effects of a case; the first by the seed's habit where that is given."""
    shares = {effect: share for effect, (_, share) in KNOWN.items()}
    if robot.size not in ("heavy", "mid"):
        shares["gravity_compensator"] = 0
    if robot.size == "scara":
        shares |= {"gravity_sag": 0, "base_compliance": 0, "gravity_compensator": 0}
        shares["joint_stiffness"] *= 0.3
    names, weights = list(shares), np.array(list(shares.values()), float)
    first = str(habit.choice(names, p=weights / weights.sum())) if habit else None
    effects: list[str] = []
    for i in range(count):
        effect = first if i == 0 and first else str(rng.choice(names, p=weights / weights.sum()))
        if effect in effects and effect not in SEVERAL:
            common = ("joint_offset", "backlash", "joint_stiffness", "transmission_error")
            effect = str(rng.choice([e for e in common if e not in effects]))
        effects.append(effect)
    if {"tracking_lag", "time_skew"} <= set(effects):
        return None
    if "joint_coupling" in effects and rng.random() < 0.6 and count > 1:
        return None
    return effects


class _Order:
    """Which unknown cause is tried next: the seed's own first, then others, a new one every third trial."""

    def __init__(self, seed: int, attempt: int, bench: Bench, habit: Rng) -> None:
        before = sum(kind_of(s) in ("mixed", "unknown") for s in range(seed))
        others = np.random.default_rng([seed, 5, attempt // 4]).permutation(len(UNKNOWN))
        self.order = [10 * before % len(UNKNOWN), *(int(i) for i in others)]
        self.place = 0 if attempt < 4 else 1
        self.bench, self.habit, self.on_rails = bench, habit, ON_RAILS[seed // 14 % 2]

    def draw(self, rng: Rng, trial: int) -> Cause | None:
        """Draw the cause of a trial; None where robot or campaign is not for it."""
        robot, campaign = self.bench.robot, self.bench.campaign
        maker = UNKNOWN[self.order[(self.place + trial // 3) % len(self.order)]]
        if robot.rail and self.habit.random() < 0.6:
            maker = self.on_rails
        cause = maker(rng, robot, campaign)
        lacks = {
            "rail": not robot.rail,
            "static": self.bench.settings.path,
            "balancer": robot.size not in ("heavy", "mid"),
        }
        if any(lacks[need] for need in cause.needs):
            self.place += 1
            return None
        return cause


def _draw_causes(bench: Bench, rng: Rng, makers: Sequence[Maker], order: _Order | None) -> list[Sized] | None:
    """Draw the known causes, then the unknown one where there is an order of them; None if one cannot be drawn."""
    causes: list[Sized] = []
    for maker in [*makers, *([None] if order else [])]:
        for trial in range(TRIALS):
            if maker is not None:
                cause: Cause | None = maker(rng, bench.robot, bench.campaign)
            else:
                cause = order.draw(rng, trial) if order else None
            if cause is None or any(there.cause.key == cause.key for there in causes):
                continue
            sized = _size_cause(bench, rng, cause)
            if sized is not None:
                causes.append(sized)
                break
        else:
            return None
    return causes


def _size_cause(bench: Bench, rng: Rng, cause: Cause) -> Sized | None:
    """Scale a cause to a drawn number of standard deviations, and to some noise where it is to be seen by eye.

    None where its range of sizes leaves it hidden or makes it absurd.
    """
    robot, campaign = bench.robot, bench.campaign
    scale = bench.scale(bench.signatures.frames, cause.key)
    sigma = bench.instrument.sigma_rms(campaign)

    def look(size: float) -> tuple[float, float]:
        gap = observe(robot, campaign, [Sized(cause, size)], []).gap
        metres = register(gap[:, :3], bench.signatures.frames) if campaign.register else gap[:, :3]
        return float(np.linalg.norm(scale.whiten(gap))), rms(metres)

    size = cause.size
    deviations, metres = look(size)
    target = float(np.exp(rng.uniform(np.log(6.5), np.log(120.0))))
    if not cause.fixed:
        over = float(rng.uniform(3.0, 6.0)) if rng.random() < 0.85 else 1.5
        for _ in range(2):
            factor = max(target / max(deviations, 1e-9), over * sigma / max(metres, 1e-12))
            size = float(np.clip(size * factor, cause.lowest, cause.highest))
            deviations, metres = look(size)
    absurd = metres > LARGEST_M * max(1, SCALE[robot.size]) and not cause.fixed
    return None if deviations < CLEARLY or absurd else Sized(cause, size)
