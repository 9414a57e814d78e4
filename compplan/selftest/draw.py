"""Draw cases from the virtual cell: a robot, a campaign, hidden effects scaled to a gap, noise, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects import Attained, Effect, apply_effects, attain_scene, stage_scene
from compplan.effects.linearization import Linearization, linearize_scene
from compplan.effects.scene import Scene
from compplan.effects.signature import plain
from compplan.errors import ConvergenceError
from compplan.measure.campaign import Campaign
from compplan.robot import Array, Robot, load_robot
from compplan.selftest.alike import SIGMA_ENCODER, SIGMA_ROTATION, Observer, find_alike, list_rivals
from compplan.selftest.case import Case, kind_of
from compplan.selftest.designs import Design, draw_design, later_design, lay_out_campaign
from compplan.selftest.draw_effects import (
    NEEDS_LOAD,
    NEEDS_PATH,
    UNSCALED,
    VOCABULARY,
    Drawn,
    draw_background,
    draw_effect,
    whole,
)
from compplan.selftest.unknowns import MEANING, apply_unknown

ROBOTS = ("kuka_kr270", "kuka_kr240", "staubli_tx200", "fanuc_m10ia", "kuka_kr120_r3900")
RAIL = "kuka_kr240_rail"
GRAVITY = np.array([0.0, 0.0, -9.81])
#: Rms of an effect's gap over the standard deviation of one coordinate; the background's over the noise floor.
GAP_OVER_SIGMA = {"clean": (5.0, 60.0), "realistic": (9.0, 60.0)}
BACKGROUND = (1.0, 2.0)
ATTEMPTS = 60
MOMENT_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Stage:
    """A nominal robot at the rows of a campaign.

    Attributes:
        robot: The nominal robot.
        campaign: The rows.
        design: How they are run.
        at: Linearization of the nominal robot.
        later: Whether effects happened before.
    """

    robot: Robot
    campaign: Campaign
    design: Design
    at: Linearization
    later: bool = False

    def attain(self, effects: Sequence[Effect], unknown: tuple[str, int, float, int] | None = None) -> Attained:
        """Return what the cell comes to with effects."""
        scene = apply_effects(self._scene(), effects)
        return attain_scene(scene if unknown is None else apply_unknown(unknown[0], scene, self.at, *unknown[1:]))

    def gap(self, effects: Sequence[Effect], unknown: tuple[str, int, float, int] | None = None) -> Array:
        """Return the gap that effects make. Shape (n, 3). [m]"""
        return self.attain(effects, unknown).position - self.at.attained.position

    def _scene(self) -> Scene:
        return stage_scene(self.robot, self.campaign, later=self.later)


def set_stage(robot: Robot, campaign: Campaign, design: Design, *, later: bool = False) -> Stage:
    """Put the nominal robot at the rows of a campaign."""
    scene = stage_scene(robot, campaign, later=later)
    return Stage(robot, campaign, design, linearize_scene(scene, attain_scene(scene)), later)


def draw_case(number: int, kind: str | None = None, difficulty: str | None = None, effects: Sequence[str] = ()) -> Case:
    """Draw a case; the same arguments give the same case.

    Args:
        number: Number of the case, the seed of everything in it.
        kind: Kind of the case; what the number says if left out.
        difficulty: "clean" or "realistic"; what the number says if left out.
        effects: Names of its effects; drawn if left out.

    Raises:
        LookupError: If no campaign was found that shows the effects.
    """
    mixed = kind_of(number)
    kind, difficulty = kind or mixed[0], difficulty or mixed[1]
    fault = ""
    for attempt in range(ATTEMPTS):
        random = np.random.default_rng([number, attempt])
        # hard effects get several robots before others are drawn, so that none is crowded out
        names = list(effects) or _draw_names(np.random.default_rng([number, 10**6 + attempt // 12]), kind)
        try:
            return _try_case(random, number, kind, difficulty, names)
        except (LookupError, ConvergenceError) as again:
            fault = str(again)
    raise LookupError(f"case {number} ({kind}, {difficulty}): {fault}")


def _draw_names(random: np.random.Generator, kind: str) -> list[str]:
    joined = [name for name in VOCABULARY if name not in UNSCALED]
    unknown = str(random.choice(list(MEANING)))
    counts = {"none": 0, "single": 1, "indistinguishable": 1, "double": 2, "triple": 3, "partly": 1, "unknown": 0}
    pool = list(VOCABULARY) if kind in ("single", "indistinguishable") else joined
    names = [str(n) for n in random.choice(pool, counts[kind], replace=False)]
    return [*names, unknown] if kind in ("unknown", "partly") else names


def _try_case(random: np.random.Generator, number: int, kind: str, difficulty: str, names: list[str]) -> Case:
    robot = load_robot(RAIL if random.random() < 0.1 else str(random.choice(ROBOTS)))
    weightless = "gravity_sag" in names or (random.random() < 0.15 and "payload" not in names)
    robot = replace(robot, gravity=None if weightless else GRAVITY, link_elasticities=())
    design = _fit_design(random, draw_design(random, difficulty), names)
    around = random.random(robot.nq)
    stage = set_stage(robot, lay_out_campaign(random, robot, design, around), design)
    low, high = GAP_OVER_SIGMA[difficulty]
    drawn: list[Drawn] = []
    sizes: list[float] = []
    for name in (n for n in names if n in VOCABULARY):
        others = [other.effect(its) for other, its in zip(drawn, sizes, strict=True)]
        one, size = _draw_scaled(random, name, stage, (low, high), others)
        drawn.append(one)
        sizes.append(size)
    unknown = _draw_unknown(random, next((n for n in names if n in MEANING), None), stage, low, high)
    background = _draw_background(random, stage) if difficulty == "realistic" else []
    effects = [one.effect(size) for one, size in zip(drawn, sizes, strict=True)]
    entries = _describe_effects(stage, effects, [one.name for one in drawn])
    if unknown is not None:
        gap = stage.gap([], unknown)
        entries.append({
            "effect": unknown[0], "joint": robot.joint_names[unknown[1]], "axis": None, "size": unknown[2],
            "in_vocabulary": False, "meaning": MEANING[unknown[0]], "gap_rms_mm": 1e3 * _rms(gap),
            "gap_over_sigma": _rms(gap) / design.sigma, "acceptable": [],
        })  # fmt: skip
    if kind == "indistinguishable" and not entries[0]["acceptable"]:
        raise LookupError("the effect can be told apart")
    after = later_design(random, design)
    later = set_stage(robot, lay_out_campaign(random, robot, after, around), after, later=True)
    given, outliers = _measure(random, stage, stage.attain([*background, *effects], unknown))
    fresh, fresh_outliers = _measure(random, later, later.attain([*background, *effects], unknown))
    expected = {"none": "none", "unknown": "unknown", "partly": "partly_explained"}.get(kind, "explained")
    truth = {
        "case": f"{kind}_{difficulty}_{number}", "seed": number, "kind": kind, "difficulty": difficulty,
        "robot": robot.name, "expected_status": expected, "effects": entries,
        "background": [{"effect": e.name, "joint": e.joint, "axis": e.axis} for e in background],
        "background_rms_mm": 1e3 * _rms(stage.gap(background)) if background else 0.0,
        "sigma_mm": 1e3 * design.sigma, "noise_floor_rms_mm": 1e3 * float(np.sqrt(3.0)) * design.sigma,
        "handicaps": [*design.handicaps, *(["rail"] if robot.name == RAIL else [])],
        "split": {"given": {"outlier_rows": outliers}, "fresh": {"outlier_rows": fresh_outliers}},
    }  # fmt: skip
    return Case(robot, given, fresh, truth)


def _fit_design(random: np.random.Generator, design: Design, names: list[str]) -> Design:
    """Give effects the paths, loads and warm-up without which they cannot show."""
    if any(name in NEEDS_PATH for name in names) and not design.paths:
        design = replace(design, paths=1)
    if "thermal_drift" in names:
        design = replace(design, rise=float(random.uniform(5.0, 15.0)), pace=max(design.pace, 20.0))
    if "gravity_sag" not in names and not any(name in NEEDS_LOAD for name in names) and random.random() < 0.1:
        design = replace(design, loads="none")
    return design


def _draw_scaled(
    random: np.random.Generator, name: str, stage: Stage, wanted: tuple[float, float], others: list[Effect]
) -> tuple[Drawn, float]:
    """Draw an effect and the size at which its gap is the wanted multiple of the noise."""
    drawn = draw_effect(random, name, stage.at, stage.design.time_constant)
    if name == "gravity_sag":
        drawn = whole(drawn)
    if any((e.name, e.joint) == (drawn.name, drawn.joint) for e in others):
        raise LookupError(f"{name} is there already")
    target = float(np.exp(random.uniform(*np.log(wanted)))) * stage.design.sigma
    seen = stage.campaign.on_path if name in NEEDS_PATH else ~stage.campaign.on_path
    size = 1.0
    for _ in range(0 if name in UNSCALED else 4):
        made = _rms(stage.gap([drawn.effect(size)])[seen])
        if made < 1e-9:
            raise LookupError(f"{name} does not show in this campaign")
        size = min(size * target / made, drawn.most)
    if _rms(stage.gap([drawn.effect(size)])[seen]) < 0.8 * wanted[0] * stage.design.sigma:
        raise LookupError(f"{name} cannot be made large enough in this campaign")
    trace = stage.gap([drawn.effect(size)]).ravel()
    for effect in others:
        other = stage.gap([effect]).ravel()
        if (trace @ other) ** 2 > 0.64 * (trace @ trace) * (other @ other):
            raise LookupError(f"{name} looks like {effect.name} here")
    return drawn, size


def _draw_unknown(
    random: np.random.Generator, name: str | None, stage: Stage, low: float, high: float
) -> tuple[str, int, float, int] | None:
    if name is None:
        return None
    revolute = [k for k, joint in enumerate(stage.robot.actuated) if joint.kind == "revolute"]
    joint, seed, size = int(random.choice(revolute[:5])), int(random.integers(2**31)), 1e-4
    target = float(np.exp(random.uniform(np.log(2.0 * low), np.log(high)))) * stage.design.sigma
    for _ in range(3):
        size *= target / max(_rms(stage.gap([], (name, joint, size, seed))), 1e-12)
    return name, joint, float(size), seed


def _draw_background(random: np.random.Generator, stage: Stage) -> list[Effect]:
    drawn = draw_background(random, stage.at, stage.design.time_constant)
    target = float(random.uniform(*BACKGROUND)) * float(np.sqrt(3.0)) * stage.design.sigma
    size = 1.0
    for _ in range(3):
        size *= target / _rms(stage.gap([one.effect(size) for one in drawn]))
    return [one.effect(size) for one in drawn]


def _describe_effects(stage: Stage, effects: list[Effect], names: list[str]) -> list[dict[str, Any]]:
    """Return what the truth says about each effect: place, gap, and what the campaign cannot tell from it."""
    watch = Observer(stage.campaign, stage.design.sigma)
    rivals = list_rivals(stage.at) if effects else []
    base, entries = stage.at.attained, []
    for effect in effects:
        real = stage.attain([effect])
        turn = Rotation.from_matrix(real.rotation @ np.swapaxes(base.rotation, 1, 2)).as_rotvec()
        twist = np.concatenate([real.position - base.position, turn], axis=1)[:, :, None]
        trace = watch.whiten(twist, (real.link - base.link)[:, :, None])[:, 0]
        alike = [] if effect.name == "joint_coupling" else find_alike(trace, effect.place, rivals, watch, stage.at)
        seen = stage.campaign.on_path if effect.name in NEEDS_PATH else ~stage.campaign.on_path
        entries.append({
            "effect": effect.name, "joint": effect.joint, "axis": effect.axis,
            "params": {key: plain(value) for key, value in effect.parameters.items()},
            "gap_rms_mm": 1e3 * _rms(twist[:, :3, 0]),
            "gap_over_sigma": _rms(twist[seen, :3, 0]) / stage.design.sigma, "acceptable": alike,
        })  # fmt: skip
    return entries


def _measure(random: np.random.Generator, stage: Stage, real: Attained) -> tuple[Campaign, list[int]]:
    """Measure what the cell comes to: noise of instrument, encoders and force sensor, and gross outliers."""
    design, campaign, n = stage.design, stage.campaign, len(stage.campaign)
    position = real.position + random.normal(0.0, design.sigma, (n, 3))
    count = round(design.outliers * n)
    outliers = np.sort(random.choice(n, count, replace=False))
    position[outliers] += random.normal(size=(count, 3)) * random.uniform(0.5e-3, 6e-3, (count, 1))
    rotation = None
    if campaign.rotation is not None:
        rotation = Rotation.from_rotvec(random.normal(0.0, SIGMA_ROTATION, (n, 3))).as_matrix() @ real.rotation
    link = None
    if campaign.link is not None:
        link = real.link + random.normal(0.0, SIGMA_ENCODER, real.link.shape)
    wrench = campaign.wrench
    if design.loads != "none":
        noise = design.force_noise * np.array([1.0, 1.0, 1.0, *[MOMENT_SHARE] * 3])
        wrench = wrench + random.normal(size=(n, 6)) * noise
    temperature = campaign.temperature
    if temperature is not None:
        temperature = temperature + random.normal(0.0, 0.03, n)
    sigma = np.full(n, design.sigma) if design.stated else None
    measured = replace(
        campaign, position=position, rotation=rotation, link=link, wrench=wrench, temperature=temperature, sigma=sigma
    )
    return measured, [int(row) for row in outliers]


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else 0.0
