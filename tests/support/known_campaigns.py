"""Small campaigns whose truth is known, and every number that a diagnosis says of each.

`python tests/support/known_campaigns.py` writes tests/known_truth.json anew (with names: those campaigns).
"""

from __future__ import annotations

import json
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from scipy.special import logit
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.data.conventions import expect_targets, typical_gap
from compplan.diagnosis.data.noise import estimate_noise
from compplan.diagnosis.data.outliers import find_outliers
from compplan.diagnosis.data.plausibility import SIGNS, check_plausibility
from compplan.diagnosis.data.signs import fit_positive, shape_elastics
from compplan.diagnosis.results.assessment import Assessment, assess_diagnosis
from compplan.diagnosis.results.measurement_moves import list_moves
from compplan.diagnosis.results.next_measurement import propose_measurements
from compplan.diagnosis.results.where import Split, split_diagnosis
from compplan.diagnosis.validation.bounds import find_breach
from compplan.diagnosis.validation.calibrated_probability import Evidence, calibrate_probability
from compplan.effects import Effect
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot

FILE = Path(__file__).parents[1] / "known_truth.json"
#: A number is as before within this share, or this much; a probability by draws, which rounding changes, by the last.
SHARE, LITTLE, ROUGH = 0.01, 2e-3, 1e-2


def soft(joint: str, change: float) -> Effect:
    return Effect("joint_stiffness", joint, None, {"compliance_change_rad_per_Nm": change})


def zero(joint: str, offset: float) -> Effect:
    return Effect("joint_offset", joint, None, {"offset_rad": offset})


@dataclass(frozen=True)
class Known:
    """A campaign: what is wrong, how it was measured, and which causes have to be named (those there are, if None).

    `again` rows are taken at each stay, which is then met twice; a mistake is asked about and nothing diagnosed; a
    sensor reads forces to `sensed` newtons, so that no row is exactly without one.
    """

    effects: tuple[Effect, ...]
    poses: int = 12
    loads: int = 1
    path: int = 0
    register: tuple[str, ...] = ()
    orientation: bool = False
    encoders: bool = False
    sigma: float = 2e-5
    named: tuple[str, ...] | None = None
    spoiled: tuple[int, ...] = ()
    wave: float = 0.0
    seed: int = 20
    joints: int = 6
    again: int = 1
    stated: bool = True
    warm: float = 0.0
    sensed: float = 0.0
    mistake: str = ""


WAVES = {"cycles_per_turn": [1.0], "sine_rad": [3e-4], "cosine_rad": [2e-4]}
GEAR = Effect("transmission_error", "joint_1", None, WAVES)
BIAS = Effect("wrench_bias", None, None, {"axes": "sensor", "fx_N": 240.0, "fy_N": -180.0, "fz_N": 120.0})
CAMPAIGNS: dict[str, Known] = {
    "inches": Known((), mistake="inches", joints=3),
    "another clock": Known(
        (Effect("time_skew", None, None, {"skew_s": 0.15}),), poses=6, path=60, mistake="another clock", joints=3
    ),
    "mirrored": Known((), mistake="mirrored", joints=3),
    "pushed the wrong way": Known((), mistake="pushed the wrong way"),
    "nothing": Known((), joints=3),
    "a stiffer joint, noisier": Known((soft("joint_2", -2e-7),), sigma=6e-5, joints=3),
    "a zero near the noise": Known((zero("joint_2", 5e-5),), poses=16, joints=3),
    "play": Known((Effect("backlash", "joint_2", None, {"width_rad": 6e-4}),), poses=24, joints=3),
    "play seen by encoders": Known(
        (Effect("backlash", "joint_3", None, {"width_rad": 4e-4}),), encoders=True, joints=3
    ),
    "a gear": Known((GEAR,), poses=34, loads=0, joints=3),
    "a length": Known((Effect("link_geometry", "joint_3", "tx", {"tx_m": 5e-4}),), poses=20, loads=0, joints=3),
    "a link": Known((Effect("link_compliance", "joint_2", "rx", {"compliance_rad_per_Nm": 1e-6}),), joints=3),
    "the base plate": Known((Effect("base_compliance", None, "ry", {"compliance_rad_per_Nm": 2e-7}),), joints=3),
    "the tool": Known((Effect("tool_frame", None, None, {"tx_m": 4e-4, "ty_m": -3e-4, "tz_m": 0.0}),), joints=3),
    "base and tool unknown": Known((soft("joint_2", 4e-7),), register=("base", "tool")),
    "a scaled sensor": Known((Effect("wrench_scale", None, None, {"gain_error_ratio": 0.2}),), poses=16, joints=3),
    "a biased sensor": Known((BIAS,), joints=3, sensed=0.5),
    "a payload": Known((Effect("payload", None, None, {"mass_kg": 15.0, "first_moment_kg_m": [1.0, 0.0, 2.0]}),)),
    "a jump": Known(
        (Effect("frame_shift", None, None, {"row": 14, "tx_m": 5e-4, "ty_m": 0.0, "tz_m": -3e-4}),), joints=3
    ),
    "counted backwards": Known((Effect("joint_coupling", "joint_3", None, {"reversed": True}),), joints=3),
    "a coupled wrist": Known(
        (Effect("joint_coupling", "joint_3", None, {"other": "joint_2", "ratio": 3e-2}),), joints=3
    ),
    "two causes and a typing error": Known((soft("joint_2", 4e-7), zero("joint_3", 6e-4)), spoiled=(5,), joints=3),
    "errors of no effect": Known((), poses=30, loads=0, wave=3e-4, named=(), joints=3),
    "a cause beside errors of no effect": Known((soft("joint_2", 6e-7),), poses=14, wave=1e-4, joints=3),
    "twelve rows": Known((zero("joint_3", 2e-3),), loads=0, joints=3),
    "two zeros that are one length": Known(
        (zero("joint_2", 1e-4), zero("joint_3", -1e-4)), loads=0, named=("link_geometry",)
    ),
    "late on a path": Known((Effect("tracking_lag", "joint_2", None, {"lag_s": 0.02}),), poses=8, path=60, joints=3),
    "met again, nothing stated": Known((soft("joint_2", 6e-7),), poses=8, again=4, stated=False, joints=3),
    "warming up": Known((zero("joint_2", 5e-4),), poses=10, warm=3.0, orientation=True, joints=3),
}


MISTAKES = {
    "inches": lambda c: replace(c, position=c.position / 25.4 * 1.15),
    "another clock": lambda c: c,
    "mirrored": lambda c: replace(c, position=c.position * [1.0, -1.0, 1.0]),
    "pushed the wrong way": lambda c: replace(c, wrench=-c.wrench),
}


def draw(known: Known, robot: Robot) -> Campaign:
    """Measure a known campaign."""
    rows = plan_rows(robot, known.seed, poses=known.poses, loads=known.loads, path=known.path)
    if known.again > 1:
        each = np.repeat(np.arange(len(rows)), known.again)
        rows = rows.take(np.r_[each, each])
    if not known.path:
        rows = replace(rows, time=None)
    if known.warm:
        course = 1.0 - np.exp(-np.arange(len(rows)) / (0.3 * len(rows)))
        rows = replace(rows, time=20.0 * np.arange(len(rows)), temperature=20.0 + known.warm * course)
    noise = np.random.default_rng(known.seed).normal(0.0, known.sensed, rows.wrench.shape)
    rows = replace(rows, wrench=rows.wrench + noise)
    log = measure(
        robot, rows, known.effects, known.seed, orientation=known.orientation, encoders=known.encoders,
        sigma=known.sigma,
    )  # fmt: skip
    position = log.position.copy()
    position[list(known.spoiled)] += [0.02, 0.0, 0.0]
    q = log.q
    a, b, c = (np.array(joints) % robot.nq for joints in ([0, 1, 2], [2, 3, 4], [1, 0, 1]))
    position += known.wave * np.sin(3.0 * q[:, a] + 2.0 * q[:, b] * q[:, c])
    log = replace(log, position=position, sigma=log.sigma if known.stated else None)
    return MISTAKES[known.mistake](log) if known.mistake else log


@dataclass(frozen=True, eq=False)
class Run:
    """A diagnosis of a known campaign and what it is asked; `answers` holds what no diagnosis is needed for."""

    known: Known
    answers: dict[str, Any]
    found: Diagnosis | None = None
    split: Split | None = None
    assessment: Assessment | None = None
    table: dict[str, Any] = field(default_factory=dict)


def run_known(name: str) -> Run:
    """Ask a campaign and diagnose it, where nothing has to be answered first."""
    known = CAMPAIGNS[name]
    robot = make_robot(known.joints)
    campaign = draw(known, robot)
    asked = {
        "questions": [question.sentence for question in check_plausibility(robot, campaign, known.register)],
        "gap_mm": 1e3 * typical_gap(robot, campaign, known.register, []), "moves": count_moves(robot, campaign),
        "noise": look_at_noise(robot, campaign, known.register), "certainty": rate_claims(),
        "signs": [fit_positive(shape_elastics(robot, campaign, known.register), *signs) for signs in SIGNS.values()],
    }  # fmt: skip
    if known.mistake:
        return Run(known, asked)
    steps: list[str] = []
    found = diagnose_campaign(robot, campaign, register=known.register, progress=steps.append)
    split, assessment = split_diagnosis(found), assess_diagnosis(found)
    extra = {"where": split.to_json(), **assessment.to_json(), "next_measurement": propose_measurements(found)}
    return Run(known, asked | {"steps": steps}, found, split, assessment, found.to_table(extra))


def answer_run(run: Run) -> dict[str, Any]:
    """Return everything that is said of a campaign and that it rests on, as plain values."""
    if run.found is None:
        return run.answers
    table = run.table | run.answers | {"fit": look_inside(run.found), "candidates": run.table["candidates"][:3]}
    table["next_measurement"] = [
        {key: value for key, value in one.items() if not isinstance(value, list)} | {"poses": len(one.get("poses", ()))}
        for one in table["next_measurement"]
    ]
    return json.loads(json.dumps(plain(table)))


def diagnose_known(name: str) -> dict[str, Any]:
    """Diagnose a campaign anew; everything that is said of it and that it rests on, as plain values."""
    return answer_run(run_known(name))


def look_at_noise(robot: Robot, campaign: Campaign, register: tuple[str, ...]) -> list[list[float]]:
    """Estimate the noise of positions, with and without what the log and a data sheet state of it. [um, -, um]"""
    gap = campaign.position - expect_targets(robot, campaign, register, [])
    told = [(sigma, sheet) for sigma in (campaign.sigma, None) for sheet in (None, 1e-5)]
    seen = [estimate_noise(campaign, gap, sigma, "position", sheet) for sigma, sheet in told]
    return [[1e6 * noise.sigma, noise.witnesses, 1e6 * noise.stay] for noise in seen]


def rate_claims() -> list[float]:
    """Rate claims of much and of little evidence, that chance imitates often or hardly, alone and beside more.

    Returns:
        Log odds that they are stated with.
    """
    cases = product((2.0, 30.0, 1e4), (0.5, 1.0), (0.03, 0.1, 0.4), (0.02, 0.15, 0.7))
    rated = [
        calibrate_probability(Evidence(m, m, again, 9.0, 0.5, 0.1, often, alike)) for m, again, often, alike in cases
    ]
    return [float(logit(probability)) for probability in rated]


def look_inside(found: Diagnosis) -> dict[str, Any]:
    """Return what an answer rests on: noise, sizes of small errors, gains of effects, forms that were offered."""
    fit, doubt, known_by = found.fit, found.doubt, found.deliveries[0].uncertainty
    search, first = fit.search, fit.model.posterior.hyper
    alone = search.gains(search.model([], first, fit=False))
    signatures = search.ledger.signatures
    best: dict[str, float] = {}
    for gain in alone:
        best.setdefault(signatures[gain.signature].name, gain.log_evidence)
    tried = [s for s in signatures if s.tried > 1]
    return {
        "noises": {k: [1e6 * n.sigma, n.witnesses, 1e6 * n.stay, n.leeway] for k, n in fit.noises.items()},
        "noise_shared_tau": first.vector, "loose": doubt.model.posterior.hyper.vector,
        "gains": best, "score": [fit.model.score - search.model([], first, fit=False).score, doubt.model.score],
        "offered": {s.name + " " + s.form.split(" ")[0]: float(np.log(s.tried)) for s in tried},
        "columns": [search.ledger.p, doubt.search.ledger.p, len(tried), len(fit.state.effects), len(fit.state.claims)],
        "unexplained_mm": known_by.unexplained * 1e3, "scale": known_by.scale, "calibration": known_by.calibration,
        "rivals": [rival.weight for rival in known_by.rivals],
        "log_width": [float(np.log(d)) if d > 0 else 0.0 for u in known_by.unknowns[:8] for d in u.deviation],
        "generic_mm": 1e3 * found.gap.generic,
        "alike": [sum(r.alike for r in f.rivals) for f in found.verdict.findings],
        "looked_at": [len(search.cache), len(doubt.search.cache)], "bounds": find_bounds(found),
        "outlying": [
            len(find_outliers(fit.problem.campaign, found.residual_after, share * fit.state.scatter, fit.state.use))
            for share in (1.0, 0.5, 0.3, 0.1)
        ],
        "traces": [[len(t.driver), float(np.mean(np.abs(t.error)))] for t in split_diagnosis(found).traces],
    }  # fmt: skip


def find_bounds(found: Diagnosis) -> dict[str, float]:
    """Return the size from which on no robot can have an effect, in steps of a quarter; 0 where any can."""
    fit, gap = found.fit, found.verdict.structure.gap
    law = {"reference_load": 100.0, "zone_load": 100.0}
    effects = {
        "mass": lambda size: Effect("payload", None, None, {"mass_kg": size, "first_moment_kg_m": [0.0, 0.0, 0.0]}),
        "behind": lambda size: Effect("payload", None, None, {"mass_kg": 1.0, "first_moment_kg_m": [-size] * 3}),
        "law": lambda size: Effect("stiffness_nonlinearity", "joint_2", None, {**law, "cubic_ratio": size}),
        "zone": lambda size: Effect("stiffness_nonlinearity", "joint_2", None, {**law, "soft_zone_ratio": size}),
        "slow gear": lambda size: Effect("joint_coupling", "joint_2", None, {"ratio": 1.0 / size}),
    }
    sizes = (1e-3 * 1.25 ** np.arange(64)).tolist()

    def first(breaks: Callable[[float], bool]) -> float:
        at = bisect_left(sizes, True, key=breaks)
        return sizes[at] if at < len(sizes) else 0.0

    found = {n: first(lambda s, make=make: bool(find_breach(fit, make(s), 0.0, gap))) for n, make in effects.items()}
    return found | {"motion": first(lambda s: bool(find_breach(fit, zero("joint_2", 0.0), s * gap, gap)))}


def count_moves(robot: Robot, campaign: Campaign) -> dict[str, list[float]]:
    """Count the moves that may come next, kind by kind: rows, their spread, speed and loads."""
    pool, moves = list_moves(robot, campaign)
    said = {}
    for kind in sorted({move.kind for move in moves}):
        rows = np.array([row for move in moves if move.kind == kind for row in move.rows])
        clock = 0.0 if pool.time is None else float(pool.time[rows].max() - pool.time[rows].min())
        warm = 0.0 if pool.temperature is None else float(pool.temperature[rows].max())
        force = float(np.linalg.norm(pool.wrench[rows, :3], axis=1).mean())
        back = float(np.abs(np.diff(pool.q[rows[0] - 1 : rows[0] + 1], axis=0)).sum())
        said[kind] = [float(len(rows)), float(pool.q[rows].std()), clock, warm, force, back]
    return said


def plain(value: Any) -> Any:
    """Return a value with arrays as lists and floats of five digits."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(entry) for entry in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def differences(old: Any, new: Any, at: str = "") -> Iterator[str]:
    """Say where two answers differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key), new.get(key), f"{at}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, (before, after) in enumerate(zip(old, new, strict=True)):
            yield from differences(before, after, f"{at}[{number}]")
    elif isinstance(old, float) and isinstance(new, float | int):
        little = ROUGH if at.endswith(".imitated") else LITTLE
        if abs(old - new) > SHARE * abs(old) + little:
            yield f"{at}: {old:.6g} -> {new:.6g}"
    elif old != new:
        yield f"{at}: {old} -> {new}"


@cache
def make_robot(joints: int) -> Robot:
    return write_small_robot(Path(mkdtemp()) / "small", joints=joints)


if __name__ == "__main__":
    answers = json.loads(FILE.read_text()) if sys.argv[1:] else {}
    answers |= {name: diagnose_known(name) for name in sys.argv[1:] or CAMPAIGNS}
    lines = [f"{json.dumps(name)}: {json.dumps(answers[name])}" for name in CAMPAIGNS if name in answers]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
