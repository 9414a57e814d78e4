"""Draw whole campaigns: robot, design, effects scaled to a wanted gap, background, and the truth about them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.campaigns.campaign import Campaign, gap_figures, gap_of, log_figures, register_gap, rms
from benchmarks.campaigns.description import Array, RobotDescription, Spring
from benchmarks.campaigns.designs import Design, draw_design, later_design, plan_rows, pose_ranges
from benchmarks.campaigns.effects import Effect, apply_effect
from benchmarks.campaigns.recording import record_readings
from benchmarks.campaigns.shapes import NEEDS_PATH, UNSCALED, VOCABULARY, draw_background, draw_shape, needs_of
from benchmarks.campaigns.signatures import (
    Observer,
    Signature,
    acceptable_rivals,
    best_pair_share,
    list_signatures,
    observe,
    rank_rivals,
    registered_share,
)
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, nominal_scenario, predict_rows, simulate_rows
from benchmarks.campaigns.templates import draw_robot
from benchmarks.campaigns.unknowns import MEANING, PATH_ONLY, apply_unknown, draw_unknown

KINDS = ("none", "single", "double", "triple", "unknown", "partly", "indistinguishable")
DIFFICULTIES = ("clean", "realistic")
GAP_OVER_SIGMA = {"clean": (5.0, 60.0), "realistic": (9.0, 60.0)}
BACKGROUND_OVER_NOISE = (1.0, 2.0)
SMALL_ROBOT = "m10ia_like"
# Largest size of each sign, negative first: what a robot in service may plausibly show.
LIMITS = {
    "joint_stiffness": (0.6, 2.0),
    "stiffness_nonlinearity": (0.6, 1.5),
    "base_compliance": (0.0, 1e-6),
    "link_compliance": (0.0, 3e-6),
    "joint_offset": (6e-3, 6e-3),
    "backlash": (1.5e-3, 1.5e-3),
    "transmission_error": (1.5e-3, 1.5e-3),
    "thermal_drift": (0.0, 4e-5),
    "wrench_bias": (0.0, 200.0),
    "wrench_scale": (0.35, 0.4),
    "gravity_compensator": (0.0, 12000.0),
    "tracking_lag": (0.0, 0.12),
    "time_skew": (0.12, 0.12),
    "creep": (0.0, 1.5),
    "hose_pull": (0.0, 600.0),
    "force_cross_talk": (0.0, 0.3),
}
SMALL_ROBOT_FACTOR = {"base_compliance": 15.0, "link_compliance": 10.0, "wrench_bias": 0.15, "gravity_compensator": 0.1}
SAME_PLACE: tuple[tuple[str, dict[str, str]], ...] = (
    ("joint_offset", {}),
    ("base_compliance", {}),
    ("link_geometry", {}),
    ("wrench_scale", {"loads": "one"}),
    ("wrench_bias", {"loads": "one"}),
    ("joint_stiffness", {"loads": "one"}),
    ("time_skew", {}),
    ("tracking_lag", {}),
    ("stiffness_nonlinearity", {"loads": "vertical"}),
    ("payload", {"loads": "vertical"}),
    ("gravity_compensator", {"loads": "none"}),
    ("joint_stiffness", {"loads": "none"}),
)


@dataclass(frozen=True)
class Setting:
    """What effects are put into: the nominal robot, the model that the truth starts from, the plan.

    Args:
        nominal: The robot as its folder states it.
        rows: The plan.
        design: How the campaign is run.
        true_springs: Springs of the real robot where the nominal one is rigid.
    """

    nominal: Scenario
    rows: Rows
    design: Design
    true_springs: tuple[dict[str, Any], ...] = ()

    @cached_property
    def expected(self) -> Reading:
        """What the nominal robot does."""
        return simulate_rows(self.nominal, self.rows)

    def gap(self, effects: list[Effect]) -> Array:
        """Return the gap of effects together. Shape (n, 3). [m]"""
        return gap_of(self.nominal, self.rows, simulate_rows(with_effects(self.nominal, effects), self.rows))


def with_effects(nominal: Scenario, effects: list[Effect]) -> Scenario:
    """Return the nominal robot with effects put in, in order."""
    scenario = nominal
    for effect in effects:
        scenario = apply_effect(effect, scenario) if effect.known else apply_unknown(effect, scenario)
    return scenario


def draw_campaign(
    seed: int, kind: str = "single", difficulty: str = "clean", effects: list[str] | None = None
) -> Campaign:
    """Draw a campaign. The same arguments give the same campaign.

    Args:
        seed: Seed of everything random.
        kind: One of `KINDS`.
        difficulty: "clean" or "realistic".
        effects: Names of the effects; drawn if None.
    Raises:
        ValueError: If kind or difficulty is not known, or no campaign was found that shows the effects.
    """
    if kind not in KINDS or difficulty not in DIFFICULTIES:
        raise ValueError(f"kind {kind!r}, difficulty {difficulty!r}: choose from {KINDS} and {DIFFICULTIES}")
    salt = [KINDS.index(kind), DIFFICULTIES.index(difficulty)]
    fault = ""
    for attempt in range(40):
        rng = np.random.default_rng([seed, *salt, attempt])
        # hard effects get several robots before another effect is drawn, so that none is crowded out
        names, changes = draw_names(np.random.default_rng([seed, *salt, 1000 + attempt // 10]), kind, effects)
        try:
            return _try_campaign(rng, seed, kind, difficulty, names, changes)
        except (LookupError, RuntimeError) as again:
            fault = str(again)
    raise ValueError(f"no campaign of kind {kind!r} with effects {effects} found for seed {seed}: {fault}")


def draw_names(rng: np.random.Generator, kind: str, effects: list[str] | None) -> tuple[list[str], dict[str, Any]]:
    """Draw the names of a campaign's effects and what its design has to be for them."""
    if effects is not None:
        return list(effects), {}
    single = list(VOCABULARY)
    joined = [n for n in VOCABULARY if n not in ("joint_coupling", "gravity_sag")]
    if kind == "none":
        return [], {}
    if kind == "single":
        return [str(rng.choice(single))], {}
    if kind == "double":
        return [str(n) for n in rng.choice(joined, 2, replace=rng.random() < 0.15)], {}
    if kind == "triple":
        return [str(n) for n in rng.choice(joined, 3, replace=False)], {}
    if kind == "unknown":
        return [str(rng.choice(list(MEANING)))], {}
    if kind == "partly":
        return [str(rng.choice(joined)), str(rng.choice(list(MEANING)))], {}
    name, changes = SAME_PLACE[int(rng.integers(len(SAME_PLACE)))]
    return [name], dict(changes)


def _try_campaign(
    rng: np.random.Generator, seed: int, kind: str, difficulty: str, names: list[str], changes: dict[str, Any]
) -> Campaign:
    rail = bool(rng.random() < (0.2 if difficulty == "realistic" else 0.07))
    robot, template = draw_robot(rng, rail=rail)
    design, handicaps = draw_design(rng, difficulty, template)
    robot, design, facts = _fit_robot(rng, robot, replace(design, **changes), names)
    low, high = pose_ranges(rng, robot, template, design.region, None)
    around = 0.5 * (low + high)
    rows = plan_rows(rng, robot, template, design, around=around)
    nominal = nominal_scenario(robot)
    setting = Setting(nominal, rows, design, tuple(facts.get("true_springs", ())))
    drawn = _draw_effects(rng, setting, names, difficulty)
    background = _scaled_background(rng, setting) if difficulty == "realistic" else []
    watch = observe(nominal, rows, design.sigma, design.sigma_rotation if design.orientation else None, seed)
    signatures = list_signatures(watch, _shift_times(rows, drawn)) if drawn else []
    entries = [_describe_effect(e, setting, watch, signatures) for e in drawn]
    _check_entries(kind, entries)
    truth = with_effects(nominal, [*background, *drawn])
    after = later_design(rng, design)
    if "thermal_drift" in names and after.temperature:
        after = replace(after, warm_up=(float(rng.uniform(6.0, 20.0)), *after.warm_up[1:]))
    later_rows = plan_rows(rng, robot, template, after, around=around, later=True)
    reference = round(float(rng.uniform(20.0, 26.0)), 2)
    given = record_readings(rng, rows, simulate_rows(truth, rows), design, reference)
    fresh = record_readings(rng, later_rows, simulate_rows(truth, later_rows), after, reference)
    statement = {
        "robot": robot.name,
        "seed": seed,
        "kind": kind,
        "difficulty": difficulty,
        "expected_status": _expected_status(kind),
        "effects": entries,
        "background": [_describe_background(e, setting) for e in background],
        "background_rms_mm": rms(setting.gap(background)) * 1e3 if background else 0.0,
        "sigma_mm": design.sigma * 1e3,
        "noise_floor_rms_mm": float(np.sqrt(3.0)) * design.sigma * 1e3,
        "gap_over_sigma": [e["gap_over_sigma"] for e in entries],
        "split": {
            "given": log_figures(given, gap_figures(nominal, rows, given.truth), "measurements.csv"),
            "fresh": log_figures(fresh, gap_figures(nominal, later_rows, fresh.truth), "fresh.csv"),
        },
        "nominal": facts,
        "handicaps": [*handicaps, *(["rail"] if rail else []), *(f"{k} {v}" for k, v in changes.items())],
        "warm_up": {"given": _warm_up(design), "fresh": _warm_up(after), "reference_temperature_C": reference},
        "log": asdict(design),
    }
    return Campaign(robot, design, after, given, fresh, statement)


def _fit_robot(
    rng: np.random.Generator, robot: RobotDescription, design: Design, names: list[str]
) -> tuple[RobotDescription, Design, dict[str, Any]]:
    """Adapt nominal robot and design to the effects: paths and loads where they need them, gravity where it matters."""
    wants_path, wants_load = needs_of(names)
    wants_path = wants_path or any(n in PATH_ONLY for n in names)
    if wants_path and not design.paths:
        design = replace(design, paths=("circle", "spiral"))
    if "thermal_drift" in names:
        design = replace(design, warm_up=(float(rng.uniform(6.0, 20.0)), *design.warm_up[1:]))
    if wants_load and design.loads == "none":
        design = replace(design, loads="all")
    if design.loads == "none":
        design = replace(design, preload=(0.0,) * 6)
    facts: dict[str, Any] = {"gravity": True, "extra_springs": [], "sag_compensated_by_controller": False}
    springs = list(robot.springs)
    if rng.random() < 0.15:
        stiff = float(rng.uniform(0.3e-8, 1.2e-8)) * (20.0 if robot.name == SMALL_ROBOT else 1.0)
        springs += [Spring("base_fixed", "rx", stiff), Spring("base_fixed", "ry", stiff)]
        facts["extra_springs"].append("base plate rx ry")
    if rng.random() < 0.1 and robot.name != SMALL_ROBOT:
        springs.append(Spring("joint_3", "rx", float(rng.uniform(2e-7, 7e-7)), offset=(0.0, 0.0, 0.3)))
        facts["extra_springs"].append("joint_3 rx")
    if rng.random() < 0.25:
        springs = [_named_axis(robot, s) for s in springs]
    gravity = robot.gravity
    heavy = {"payload", "gravity_compensator", "creep", "load_dependent_backlash"}
    if "gravity_sag" in names:
        gravity = None
        facts["gravity"] = False
        if len(names) == 1 and rng.random() < 0.3:
            facts["rigid"] = True
            design = replace(design, loads="none", preload=(0.0,) * 6)
    elif not heavy & set(names) and rng.random() < 0.12:
        gravity = None
        facts.update(gravity=False, sag_compensated_by_controller=True)
    robot = replace(robot, springs=tuple(springs), gravity=gravity)
    if facts.get("rigid"):
        facts["true_springs"] = [
            {"joint": s.joint, "compliance": s.compliance} for s in robot.springs if s.axis == "own"
        ]
        robot = replace(robot, springs=())
    return robot, design, facts


def _named_axis(robot: RobotDescription, spring: Spring) -> Spring:
    """Write a spring about a joint's own axis by the name of that axis."""
    if spring.axis != "own":
        return spring
    segment = robot.segments[robot.index_of(spring.joint)]
    letter = "xyz"[int(np.argmax(np.abs(segment.axis)))]
    return replace(spring, axis=("r" if segment.kind == "revolute" else "t") + letter, actuator=True)


def _draw_effects(rng: np.random.Generator, setting: Setting, names: list[str], difficulty: str) -> list[Effect]:
    drawn: list[Effect] = []
    gaps: list[Array] = []
    for name in names:
        for _ in range(12):
            effect, gap = _draw_scaled(rng, setting, name, difficulty)
            twin = any((e.name, e.joint) == (effect.name, effect.joint) for e in drawn)
            alike = any(_overlap(gap, g) > 0.8 for g in gaps)
            if not twin and not alike:
                break
        else:
            raise LookupError(f"no place for {name} beside {[e.name for e in drawn]}")
        drawn.append(effect)
        gaps.append(gap)
    return drawn


def _overlap(a: Array, b: Array) -> float:
    x, y = a.ravel(), b.ravel()
    return float((x @ y) ** 2 / ((x @ x) * (y @ y)))


def _draw_scaled(rng: np.random.Generator, setting: Setting, name: str, difficulty: str) -> tuple[Effect, Array]:
    """Draw an effect and scale it until its gap is the wanted multiple of the measurement's standard deviation."""
    if name in VOCABULARY:
        effect = draw_shape(rng, name, setting.nominal, setting.rows, setting.design)
    else:
        effect = draw_unknown(rng, name, setting.nominal, setting.rows)
    low, high = GAP_OVER_SIGMA[difficulty]
    target = float(np.exp(rng.uniform(np.log(low), np.log(high)))) * setting.design.sigma
    if name == "joint_stiffness" and rng.random() < 0.25:
        effect = effect.scaled(-1.0)
    seen = setting.rows.is_path if name in NEEDS_PATH or name in PATH_ONLY else ~setting.rows.is_path
    if name == "gravity_sag":
        effect = replace(effect, params={"springs": list(setting.true_springs)})
    # an effect outside the vocabulary has to show beyond what frames take up
    shown = (lambda g: g) if effect.known else (lambda g: register_gap(g, setting.expected))
    gap = setting.gap([effect])
    if name not in UNSCALED:
        for _ in range(4):
            size = rms(shown(gap)[seen])
            if size <= 1e-12:
                raise LookupError(f"{name} does not show in this campaign")
            effect = effect.scaled(float(np.clip(target / size, 1e-3, 1e3)))
            effect = _clipped(effect, setting.nominal.description.name)
            gap = setting.gap([effect])
    if rms(shown(gap)[seen]) < 0.8 * low * setting.design.sigma:
        raise LookupError(f"{name} cannot be made large enough in this campaign")
    return effect, gap


def _clipped(effect: Effect, robot: str) -> Effect:
    """Keep a size within what a robot in service may plausibly show."""
    if effect.name == "payload":
        return replace(effect, size=float(np.clip(effect.size, 0.0, 1.5 if effect.params["mass_kg"] > 0.0 else 0.8)))
    if effect.name not in LIMITS:
        return effect
    factor = SMALL_ROBOT_FACTOR.get(effect.name, 1.0) if robot == SMALL_ROBOT else 1.0
    below, above = LIMITS[effect.name]
    return replace(effect, size=float(np.clip(effect.size, -below * factor, above * factor)))


def _scaled_background(rng: np.random.Generator, setting: Setting) -> list[Effect]:
    """Draw the background and scale it so that its rms is one to two times the noise's."""
    background = draw_background(rng, setting.nominal, setting.rows, setting.design)
    target = float(rng.uniform(*BACKGROUND_OVER_NOISE)) * float(np.sqrt(3.0)) * setting.design.sigma
    for _ in range(4):
        factor = target / rms(setting.gap(background))
        background = [e.scaled(factor) for e in background]
    return background


def _shift_times(rows: Rows, drawn: list[Effect]) -> list[float]:
    statics = rows.time[~rows.is_path]
    times = list(np.quantile(statics, np.linspace(0.1, 0.9, 9)))
    return times + [e.params["time_s"] for e in drawn if "time_s" in e.params]


def _describe_effect(effect: Effect, setting: Setting, watch: Observer, signatures: list[Signature]) -> dict[str, Any]:
    """Return an effect's entry in truth.json: place, size, gap, and what cannot be told from it."""
    scenario = with_effects(setting.nominal, [effect])
    real = simulate_rows(scenario, setting.rows)
    model = predict_rows(setting.nominal, setting.rows, real.wrench)
    deviation = watch.chosen(real, model)
    rows = setting.rows
    figures = gap_figures(setting.nominal, rows, real)
    whole = watch.whiten(real, model)
    share = registered_share(deviation, signatures)
    rivals = rank_rivals(effect, deviation, 3 * len(watch.select), signatures, share)
    main = figures["gap_path_rms_mm"] if effect.name in NEEDS_PATH | PATH_ONLY else figures["gap_static_rms_mm"]
    entry = {
        "effect": effect.name,
        "joint": effect.joint,
        "axis": effect.axis,
        "size": effect.size,
        "unit": effect.unit,
        "params": effect.params,
        **figures,
        "gap_over_sigma": float(main or 0.0) * 1e-3 / setting.design.sigma,
        "registered_share": share,
        "acceptable": acceptable_rivals(rivals, float(whole @ whole)) if effect.known else [],
        "nearest_rivals": rivals[:5],
    }
    if not effect.known:
        entry.update(in_vocabulary=False, meaning=MEANING[effect.name])
        entry["two_effects_r2"] = best_pair_share(deviation, signatures)
    return entry


def _check_entries(kind: str, entries: list[dict[str, Any]]) -> None:
    """Refuse a campaign that is not of its kind."""
    for entry in entries:
        if "meaning" in entry and (entry["nearest_rivals"][0]["r2"] > 0.85 or entry["two_effects_r2"] > 0.93):
            raise LookupError("an effect of the vocabulary explains the unknown one")
    if kind == "indistinguishable" and not entries[0]["acceptable"]:
        raise LookupError("the effect can be told apart")


def _expected_status(kind: str) -> str:
    return {"none": "none", "unknown": "unknown", "partly": "partly_explained"}.get(kind, "explained")


def _describe_background(effect: Effect, setting: Setting) -> dict[str, Any]:
    entry = {
        "effect": effect.name,
        "joint": effect.joint,
        "axis": effect.axis,
        "size": effect.size,
        "unit": effect.unit,
    }
    return {**entry, "params": effect.params, "gap_rms_mm": rms(setting.gap([effect])) * 1e3}


def _warm_up(design: Design) -> dict[str, float]:
    rise, tau, wobble, period = design.warm_up
    return {"start_K": design.start_rise, "rise_K": rise, "tau_s": tau, "wobble_K": wobble, "period_s": period}
