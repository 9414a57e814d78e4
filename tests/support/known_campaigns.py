"""Small campaigns whose truth is known, and every number that a diagnosis says of each.

`python tests/support/known_campaigns.py` writes tests/known_truth.json anew (with names: those campaigns).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.data.conventions import typical_gap
from compplan.diagnosis.data.plausibility import check_plausibility
from compplan.diagnosis.results.assessment import Assessment, assess_diagnosis
from compplan.diagnosis.results.next_measurement import propose_measurements
from compplan.diagnosis.results.where import Split, split_diagnosis
from compplan.effects import Effect
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot

FILE = Path(__file__).parents[1] / "known_truth.json"
#: A number is as before within this share, or this much; a probability by draws, which rounding changes, by the last.
SHARE, LITTLE = 0.01, 2e-3


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
        "gap_mm": 1e3 * typical_gap(robot, campaign, known.register, []),
    }
    if known.mistake:
        return Run(known, asked)
    found = diagnose_campaign(robot, campaign, register=known.register)
    split, assessment = split_diagnosis(found), assess_diagnosis(found)
    extra = {"where": split.to_json(), **assessment.to_json(), "next_measurement": propose_measurements(found)}
    return Run(known, asked, found, split, assessment, found.to_table(extra))


def answer_run(run: Run) -> dict[str, Any]:
    """Return the verdict of a campaign, its sizes and the figures of its gap, as plain values."""
    if run.found is None:
        return run.answers
    told = {key: run.table[key] for key in ("verdict", "gap", "outliers") if key in run.table}
    return json.loads(json.dumps(plain(told | run.answers)))


def diagnose_known(name: str) -> dict[str, Any]:
    """Diagnose a campaign anew; everything that is said of it and that it rests on, as plain values."""
    return answer_run(run_known(name))


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
        if abs(old - new) > SHARE * abs(old) + LITTLE:
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
