"""Draw the hard campaigns of a suite: other robots, tracker designs, rough effects, unknown causes, and their truth."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaigns.columns import Placed, list_signatures
from benchmarks.campaigns.description import Array, RobotDescription, write_robot_folder
from benchmarks.campaigns.effects import Effect
from benchmarks.campaigns.everyday import Small, apply_scatter, apply_small, draw_everyday, scatter_joints
from benchmarks.campaigns.evidence import SAME, VISIBLE, Measure, gap_of, make_measure, register_gap, rms
from benchmarks.campaigns.logbook import Frames, Log, draw_frames, record
from benchmarks.campaigns.machines import Machine, draw_machine
from benchmarks.campaigns.oddities_instrument import ODDITIES
from benchmarks.campaigns.oddity import Setting
from benchmarks.campaigns.placing import OF_MOTION, UNSCALED, draw_names, draw_odd, draw_place
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, nominal_scenario, predict_rows, simulate_rows
from benchmarks.campaigns.visits import Visits, draw_visits, later_visits, plan_visits

Generator = np.random.Generator
SUITES = ("tracker", "realistic")
DEVELOPMENT = range(0, 1_000_000)
REPORTING = range(1_000_000, 2_000_000)
KINDS = {"single": 0.37, "double": 0.18, "triple": 0.06, "quadruple": 0.04, "mixed": 0.1, "unknown": 0.15}
KINDS.update(background=0.06, none=0.04)
OVER_SIGMA = (4.5, 15.0)  # rms gap of one effect over the instrument's standard deviation per axis
BESIDE = {True: (3.0, 7.0), False: (8.0, 25.0)}  # the same where a known effect is the smaller part of the story
MOST_HIDDEN = 8.0  # the whole gap of an effect over what a registration leaves of it
STATUS = {
    "mixed": ["partly_explained"],
    "unknown": ["unknown"],
    "background": ["none", "partly_explained", "unknown"],
    "none": ["none"],
}
# What a robot in service may show at most: relative changes, lost motion [rad], ...
LIMITS = {"joint_stiffness": (0.6, 2.5), "backlash": (0.0, 4e-3), "transmission_error": (0.0, 4e-3)}
LIMITS.update(joint_offset=(0.02, 0.02), thermal_drift=(0.0, 4e-5), wrench_scale=(0.35, 0.5), payload=(0.9, 1.5))
LIMITS.update(link_geometry=(4e-3, 4e-3), tool_frame=(0.0, 0.01), base_frame=(0.0, 0.01), tool_shift=(0.0, 5e-3))
LIMITS.update(stiffness_nonlinearity=(0.0, 2.0), tracking_lag=(0.0, 0.15), time_skew=(0.15, 0.15))


@dataclass(frozen=True)
class HardCampaign:
    """A drawn campaign: nominal robot, two logs and the truth.

    Args:
        robot: The robot as its folder states it.
        given: The log that a diagnosis is given.
        fresh: A later log: new poses, new loads.
        truth: What truth.json holds.
    """

    robot: RobotDescription
    given: Log
    fresh: Log
    truth: dict[str, Any]

    def write(self, folder: Path) -> Path:
        """Write robot/, measurements.csv, fresh.csv and truth.json."""
        folder.mkdir(parents=True, exist_ok=True)
        write_robot_folder(self.robot, folder / "robot", dict.fromkeys(("compliance", "geometry", "masses"), "assumed"))
        self.given.write(folder / "measurements.csv")
        self.fresh.write(folder / "fresh.csv")
        part = folder / "truth.part"
        part.write_text(json.dumps({"case": folder.name, **self.truth}, indent=1) + "\n", encoding="utf-8")
        os.replace(part, folder / "truth.json")
        return folder


def draw_hard(seed: int, suite: str, kind: str | None = None) -> HardCampaign:
    """Draw a campaign; the same arguments give the same campaign.

    Args:
        seed: Seed of everything random.
        suite: One of `SUITES`.
        kind: One of `KINDS`; drawn by their shares if None.
    Raises:
        ValueError: If the suite is not known or no campaign was found.
    """
    if suite not in SUITES:
        raise ValueError(f"no suite named {suite!r}, choose from {list(SUITES)}")
    salt = SUITES.index(suite)
    first = np.random.default_rng([seed, salt, 77])
    kind = kind or str(first.choice(list(KINDS), p=np.array(list(KINDS.values())) / sum(KINDS.values())))
    fault = ""
    for attempt in range(60):
        try:
            return _Trial.begin(np.random.default_rng([seed, salt, list(KINDS).index(kind), attempt]), suite, kind).run(
                seed
            )
        except (LookupError, RuntimeError, np.linalg.LinAlgError) as again:
            fault = str(again)
    raise ValueError(f"no {kind} campaign found for seed {seed}: {fault}")


def put_in(nominal: Scenario, effects: list[Effect]) -> Scenario:
    """Return the nominal robot with effects of any origin put in, in order."""
    scenario = nominal
    for effect in effects:
        scenario = (apply_scatter if effect.name == "repeatability" else apply_small)(effect, scenario)
    return scenario


@dataclass
class _Trial:
    """One attempt at a campaign."""

    rng: Generator
    suite: str
    kind: str
    setting: Setting
    registered: bool

    @classmethod
    def begin(cls, rng: Generator, suite: str, kind: str) -> _Trial:
        """Draw robot, design and plan."""
        machine = draw_machine(rng)
        visits = draw_visits(rng, machine, suite)
        if rng.random() < 0.07:  # the controller compensates the sag, so the model has none
            machine = replace(machine, robot=replace(machine.robot, gravity=None))
        registered = bool(rng.random() < (0.35 if suite == "tracker" else 0.12))
        return cls(rng, suite, kind, _set_up(rng, machine, visits), registered)

    def run(self, seed: int) -> HardCampaign:
        """Draw effects and everyday errors, check that they can be seen, and record both logs."""
        names, odd = self._names()
        self._fit_robot(names)
        effects = [self._scaled(e) for e in self._places(names, odd)]
        calm = self.kind == "none" and self.rng.random() < 0.5
        everyday = self._everyday(0.25 if calm else 1.0)
        scatter = self._scatter()
        measure, placed = self._measure(everyday, scatter, effects)
        entries = self._describe(effects, measure, placed)
        self._check(entries)
        s = self.setting
        truth = put_in(s.nominal, [*effects, *(m.effect for m in everyday), *([scatter] if scatter else [])])
        target = draw_frames(self.rng, None, None, s.machine.reach) if self.registered else None
        frames = {"given": target, "fresh": target}
        if target is not None:
            frames["fresh"] = draw_frames(self.rng, target.target_m, target.tool_turn, s.machine.reach)
        after = later_visits(self.rng, s.visits)
        later = plan_visits(self.rng, s.machine, after, later=True)
        warm = round(float(self.rng.uniform(19.0, 25.0)), 2)
        logs, split = {}, {}
        for name, rows, visits in (("given", s.rows, s.visits), ("fresh", later, after)):
            real = simulate_rows(truth, rows)
            logs[name] = record(self.rng, rows, real, visits, s.machine.robot, frames[name], warm)
            parts = {"dominant": effects, "background": [m.effect for m in everyday]}
            split[name] = self._figures(rows, real, logs[name], parts)
        split["given"]["file"], split["fresh"]["file"] = "measurements.csv", "fresh.csv"
        robot = s.machine.robot
        if scatter and self.rng.random() < 0.5:
            robot = replace(robot, repeatability_mm=round(scatter.size * 1e3, 3))
        statement = self._statement(seed, entries, everyday, scatter, placed, measure, split, frames, calm)
        statement["log"]["repeatability_given"] = robot.repeatability_mm is not None
        return HardCampaign(robot, logs["given"], logs["fresh"], statement)

    def _names(self) -> tuple[list[str], bool]:
        count = {"single": 1, "mixed": 1, "double": 2, "triple": 3, "quadruple": 4}.get(self.kind, 0)
        names = draw_names(self.rng, self.setting, count, registered=self.registered, alone=self.kind == "single")
        return names, self.kind in ("mixed", "unknown")

    def _fit_robot(self, names: list[str]) -> None:
        """A model without gravity where sag is the effect; a clock where time is all that tells."""
        s, visits = self.setting, self.setting.visits
        if "gravity_sag" in names:
            machine = replace(s.machine, robot=replace(s.machine.robot, gravity=None))
            self.setting = Setting(machine, nominal_scenario(machine.robot), s.rows, visits)
        if "thermal_drift" in names and not visits.temperature:
            self.setting = replace(self.setting, visits=replace(visits, time=True))

    def _places(self, names: list[str], odd: bool) -> list[Effect]:
        """Place the effects; every third group sits at one joint and its neighbours."""
        arm, near = self.setting.arm, None
        if len(names) > 1 and self.rng.random() < 0.35:
            k = int(self.rng.integers(1, len(arm) - 1))
            near = arm[k - 1 : k + 2] if self.rng.random() < 0.6 else [arm[k]]
        found = [draw_place(self.rng, n, self.setting, near) for n in names]
        return [*found, draw_odd(self.rng, self.setting)] if odd else found

    def _gap(self, effects: list[Effect]) -> Array:
        s = self.setting
        return gap_of(s.nominal, s.rows, simulate_rows(put_in(s.nominal, effects), s.rows))

    def _seen(self, effect: Effect) -> Array:
        """Return the gap that an effect is scaled by: without what frames take up, over the rows that show it."""
        gap = self._gap([effect])
        if not effect.known:
            gap = register_gap(gap, simulate_rows(self.setting.nominal, self.setting.rows))
        path = self.setting.rows.is_path
        return gap[path if effect.name in OF_MOTION else ~path]

    def _scaled(self, effect: Effect) -> Effect:
        """Scale an effect to a gap in units of the instrument; where it has no scale, take a coarser instrument."""
        s = self.setting
        sigma = float(np.median(s.visits.sigma(simulate_rows(s.nominal, s.rows).position)))
        wanted = BESIDE[effect.known] if self.kind == "mixed" else OVER_SIGMA
        over = float(np.exp(self.rng.uniform(*np.log(wanted))))
        if effect.name in UNSCALED:
            ratio = rms(self._seen(effect)) / sigma / over
            if effect.name == "gravity_sag" and ratio > 1.0:
                a, b = s.visits.noise
                self.setting = replace(s, visits=replace(s.visits, noise=(a * ratio, b * ratio)))
            return effect
        for _ in range(4):
            size = rms(self._seen(effect))
            if not size > 1e-13:
                raise LookupError(f"{effect.name} does not show in this campaign")
            effect = effect.scaled(float(np.clip(over * sigma / size, 1e-4, 1e4)))
            if effect.name in LIMITS:
                low, high = LIMITS[effect.name]
                effect = replace(effect, size=float(np.clip(effect.size, -low, high)))
        seen = rms(self._seen(effect))
        if seen < 0.5 * over * sigma:
            raise LookupError(f"{effect.name} cannot be made large enough in this campaign")
        if rms(self._gap([effect])) > MOST_HIDDEN * seen:
            raise LookupError(f"registration takes up nearly all of {effect.name}")
        return effect

    def _everyday(self, factor: float) -> list[Small]:
        s = self.setting
        small = draw_everyday(self.rng, s.machine, s.nominal, s.rows, s.visits)
        sigma = float(np.median(s.visits.sigma(simulate_rows(s.nominal, s.rows).position)))
        wanted = float(self.rng.uniform(0.8, 2.3)) * sigma * factor
        for _ in range(2):
            size = rms(self._gap([m.effect for m in small]))
            small = [m.scaled(wanted / size) for m in small]
        return small

    def _scatter(self) -> Effect | None:
        if self.rng.random() < 0.45:
            return None
        s = self.setting
        sigma = float(np.median(s.visits.sigma(simulate_rows(s.nominal, s.rows).position)))
        size = float(np.exp(self.rng.uniform(np.log(0.6), np.log(2.5)))) * sigma
        return scatter_joints(self.rng, self.setting.machine, size)

    def _measure(self, everyday: list[Small], scatter: Effect | None, effects: list[Effect]) -> tuple[Measure, Placed]:
        s = self.setting
        rows = s.rows
        still = np.flatnonzero(~rows.is_path)
        chosen = np.sort(np.r_[still[:: max(1, len(still) // 170)], np.flatnonzero(rows.is_path)[::12]])
        placed = Placed(s.machine, s.nominal, rows, chosen)
        times = list(np.quantile(rows.time[still], np.linspace(0.15, 0.85, 6)))
        times += [e.params["time_s"] for e in effects if "time_s" in e.params]
        signatures = list_signatures(placed, times)
        loose = None if scatter is None else scatter.size * np.array(scatter.params["weights"])
        measure = make_measure(
            placed,
            signatures,
            s.visits.sigma(placed.tip),
            everyday,
            loose,
            registered=self.registered,
            orientation=s.visits.orientation,
        )
        return measure, placed

    def _deviation(self, effect: Effect, measure: Measure, placed: Placed) -> Array:
        """Return an effect's deviation in the measured values of the chosen rows. Shape (m,)."""
        s = self.setting
        real = simulate_rows(put_in(s.nominal, [effect]), s.rows)
        model = predict_rows(s.nominal, s.rows, real.wrench)
        pick = placed.select
        relative = (real.rotation @ model.rotation.transpose(0, 2, 1))[pick]
        skew = 0.5 * (relative - relative.transpose(0, 2, 1))
        turned = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        return measure.flat(np.concatenate([(real.position - model.position)[pick], turned], axis=1))

    def _describe(self, effects: list[Effect], measure: Measure, placed: Placed) -> list[dict[str, Any]]:
        s = self.setting
        sigma = float(np.median(s.visits.sigma(placed.tip)))
        deviations = [self._deviation(e, measure, placed) for e in effects]
        entries = []
        for k, (effect, deviation) in enumerate(zip(effects, deviations, strict=True)):
            apart = measure.without([d for n, d in enumerate(deviations) if n != k])
            gap = self._gap([effect])
            visible = apart.visible(deviation)
            rivals = apart.rivals(deviation, (effect.name, effect.joint, effect.axis))
            known = effect.known
            entry: dict[str, Any] = {
                "effect": effect.name if known else "unknown",
                "joint": effect.joint,
                "axis": effect.axis,
                "size": effect.size,
                "unit": effect.unit,
                "params": effect.params,
                "gap_rms_mm": rms(gap) * 1e3,
                "gap_registered_rms_mm": rms(register_gap(gap, simulate_rows(s.nominal, s.rows))) * 1e3,
                "over_sigma": round(rms(gap) / sigma, 3),
                "visible": round(visible, 2),
                "required": bool(visible >= VISIBLE),
                "acceptable": [r for r in rivals if r["distance"] < SAME] if known and visible >= SAME else [],
                "nearest_rivals": rivals[:5],
            }
            if not known:
                entry.update(kind=effect.name, note=ODDITIES[effect.name].note)
                entry["left_by_two"] = round(apart.left_by_two(deviation), 2)
            entries.append(entry)
        return entries

    def _describe_small(self, small: Small, placed: Placed, measure: Measure, sigma: float) -> dict[str, Any]:
        """Return an everyday error's entry in truth.json with the gap that it makes alone."""
        e = small.effect
        rows = {(s.effect, s.joint, s.axis): s.columns for s in measure.signatures}.get((e.name, e.joint, e.axis))
        first_order = small.group in ("geometry", "compliance", "off_axis") and rows is not None
        gap = rms(rows[:, :3, 0] * e.size if first_order and rows is not None else self._gap([e]))
        return {
            "effect": e.name,
            "joint": e.joint,
            "axis": e.axis,
            "size": e.size,
            "sd": small.sd,
            "group": small.group,
            "params": e.params,
            "over_sigma": round(gap / sigma, 3),
            "gap_rms_mm": gap * 1e3,
        }

    def _check(self, entries: list[dict[str, Any]]) -> None:
        """Refuse a campaign that cannot show what it is about, or whose unknown cause two names explain."""
        odd = [e for e in entries if e["effect"] == "unknown"]
        if any(not e["required"] or e["left_by_two"] < VISIBLE for e in odd):
            raise LookupError("the unknown cause does not stand out of what names can explain")
        named = [e for e in entries if e["effect"] != "unknown"]
        if named and not any(e["required"] for e in named):
            raise LookupError("no effect stands out")
        if self.kind == "mixed" and not named[0]["required"]:
            raise LookupError("the known effect does not stand out")

    def _figures(self, rows: Rows, real: Reading, log: Log, parts: dict[str, list[Effect]]) -> dict[str, Any]:
        nominal = self.setting.nominal
        gap = gap_of(nominal, rows, real)
        labels, counts = np.unique(rows.run, return_counts=True)
        sizes = {}
        for name, effects in parts.items():
            alone = simulate_rows(put_in(nominal, effects), rows)
            sizes[f"{name}_rms_mm"] = rms(gap_of(nominal, rows, alone)) * 1e3
        return {
            "rows": len(rows.q),
            "runs": {str(a): int(b) for a, b in zip(labels, counts, strict=True)},
            "pose_visits": len(np.unique(rows.visit[~rows.is_path])),
            "gap_rms_mm": rms(gap) * 1e3,
            "gap_registered_rms_mm": rms(register_gap(gap, real)) * 1e3,
            **sizes,
            "noise_rms_mm": rms(log.noise) * 1e3,
            "outlier_rows": [int(v) for v in log.outliers],
        }

    def _statement(
        self,
        seed: int,
        entries: list[dict[str, Any]],
        everyday: list[Small],
        scatter: Effect | None,
        placed: Placed,
        measure: Measure,
        split: dict[str, Any],
        frames: dict[str, Frames | None],
        calm: bool,
    ) -> dict[str, Any]:
        s = self.setting
        sigma = float(np.median(s.visits.sigma(simulate_rows(s.nominal, s.rows).position)))
        floor = float(np.sqrt(3.0 * sigma**2 + (scatter.size if scatter else 0.0) ** 2))
        joints = [e["joint"] for e in entries if e["joint"] in s.arm]
        near = [abs(s.arm.index(a) - s.arm.index(b)) < 2 for a, b in pairwise(joints)]
        return {
            "robot": s.machine.robot.name,
            "suite": self.suite,
            "seed": seed,
            "design": s.visits.design,
            "kind": self.kind,
            "neighbours": any(near),
            "expected_status": STATUS.get(self.kind, ["explained", "partly_explained"]),
            "effects": entries,
            "gap_over_sigma": [e["over_sigma"] for e in entries],
            "background": [self._describe_small(m, placed, measure, sigma) for m in everyday],
            "background_over_sigma": round(split["given"]["background_rms_mm"] * 1e-3 / sigma, 3),
            "sigma_mm": sigma * 1e3,
            "noise_floor_rms_mm": floor * 1e3,
            "dominant_floor_rms_mm": float(np.hypot(floor * 1e3, split["given"]["background_rms_mm"])),
            "split": split,
            "nominal": {"gravity": s.machine.robot.gravity is not None},
            "register": {n: f.facts() for n, f in frames.items() if f} or None,
            "scatter": asdict(scatter) if scatter else None,
            "log": {**asdict(s.visits), "registered": self.registered, "scatter": scatter is not None, "calm": calm},
        }


def _set_up(rng: Generator, machine: Machine, visits: Visits) -> Setting:
    rows = plan_visits(rng, machine, visits)
    return Setting(machine, nominal_scenario(machine.robot), rows, visits)
