"""Writing a case: robot folder, the two logs with noise, scatter, slips and rounding, and truth.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.draw import Case
from benchmarks.outsider.observe import Seen, make_true, observe, sags
from benchmarks.outsider.robots import CAPACITY_KG, joint_name, write_robot
from benchmarks.outsider.signatures import frame_columns, stack
from benchmarks.outsider.statics import solve_statics
from benchmarks.outsider.truth import describe_truth
from benchmarks.outsider.turns import AXES, DEGREE, Array, repeat, rotate, rotation_vectors, turn_about, turn_by
from benchmarks.outsider.weighing import register, rms

USES = {
    "given": "may be given to the tool",
    "fresh": "held-out campaign: new poses and loads, never given to the tool before scoring",
}
ENCODER_NOISE = 3e-4  # of link-side encoders [deg or mm]


@dataclass(frozen=True)
class Slips:
    """What goes wrong in writing a log, and where the target sits on the tool (unknown where frames are registered)."""

    target: Array
    target_turn: Array
    outlier_rate: float
    missing_rate: float


def write_case(case: Case, out: Path) -> Path:
    """Write the folder of a case: robot/, measurements.csv, fresh.csv, truth.json; return the folder."""
    folder, rng = out / f"outside_{case.seed:05d}", case.rng
    scatter, settings = case.instrument.scatter, case.settings
    told = (
        case.instrument.repeatability / np.sqrt(3) * 1e3
        if scatter is not None and settings.repeatability_given
        else None
    )
    write_robot(case.robot, folder / "robot", told, gravity=not sags(case.causes))
    slips = Slips(
        rng.normal(size=3) * np.array([0.02, 0.02, 0.03]),
        0.02 * rng.normal(size=3),
        float(rng.uniform(0.004, 0.018)) if rng.random() < 0.25 else 0.0,
        0.01 if rng.random() < 0.07 else 0.0,
    )
    split, registration = {}, {}
    for which, campaign, file in (("given", case.given, "measurements.csv"), ("fresh", case.fresh, "fresh.csv")):
        text, split[which], registration[which] = _log(case, campaign, slips)
        split[which] = {"file": file, **split[which], "use": USES[which]}
        (folder / file).write_text(text, encoding="utf-8")
    rates = {"outlier_fraction": slips.outlier_rate, "missing_fraction": slips.missing_rate}
    truth = describe_truth(case, split, registration if settings.register else None, rates | force_noise(case))
    text = json.dumps(truth, indent=1, default=lambda value: value.tolist(), allow_nan=False)
    (folder / "truth.json").write_text(text + "\n", encoding="utf-8")
    return folder


def force_noise(case: Case) -> dict[str, float]:
    """Noise of the force sensor, 0 without one. [N]"""
    sensor = case.settings.design == "sensor"
    return {"force_noise_N": float(0.003 * 9.81 * CAPACITY_KG[case.robot.size] + 0.1) if sensor else 0.0}


def _log(case: Case, campaign: Campaign, slips: Slips) -> tuple[str, dict[str, Any], dict[str, list[float]] | None]:
    """The text of a log, what is true of it, and where frames stand if they are unknown."""
    rng, robot = case.rng, case.robot
    scatter = None
    if case.instrument.scatter is not None:
        stays = rng.normal(size=(campaign.visit[-1] + 1, robot.count)) * case.instrument.scatter
        scatter = stays[campaign.visit] * campaign.static[:, None]
    seen = observe(robot, campaign, case.causes, case.everyday, scatter)
    position, rotation, placed = seen.position, seen.rotation, None
    if case.settings.register:
        position, rotation, placed = _place(case, seen, slips)
    noise = rng.normal(size=(campaign.rows, 3)) * case.instrument.sigma(campaign)[:, None]
    outliers = _choose_outliers(case, campaign.rows, slips.outlier_rate)
    measured = position + noise
    for i in outliers:
        v = rng.normal(size=3)
        measured[i] += v / np.linalg.norm(v) * rng.uniform(0.6e-3, 6e-3)
    turned = rotation @ turn_by(rng.normal(size=(campaign.rows, 3)) * case.settings.sigma_deg * DEGREE)
    columns = _columns(case, campaign, seen.wrench, measured, turned, scatter)
    if slips.missing_rate:
        _lose_rows(case, columns, slips.missing_rate)
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    facts = _facts(case, campaign, seen, noise)
    facts |= {
        "tracker_with_outliers_rms_mm": rms(measured - position) * 1e3,
        "outlier_rows": outliers,
        "missing_rows": bool(slips.missing_rate),
    }
    return "\n".join(lines) + "\n", facts, placed


def _place(case: Case, seen: Seen, slips: Slips) -> tuple[Array, Array, dict[str, list[float]]]:
    """Pose of the target in the frame of an instrument that stands somewhere."""
    rng = case.rng
    heading = turn_about(AXES["z"], rng.uniform(-np.pi, np.pi))
    turn = rotation_vectors(heading @ turn_by(0.25 * rng.normal(size=3)))
    shift = np.array([*rng.uniform(-3, 3, 2), rng.uniform(-1.2, 0.6)])
    base = turn_by(turn)
    position = seen.position + rotate(seen.rotation, repeat(slips.target, len(seen.position)))
    told = {"base_turn": turn, "base_m": shift, "target_m": slips.target, "tool_turn": slips.target_turn}
    rotation = base @ (seen.rotation @ turn_by(slips.target_turn))
    return position @ base.T + shift, rotation, {name: value.tolist() for name, value in told.items()}


def _choose_outliers(case: Case, rows: int, rate: float) -> list[int]:
    """Rows that are wrong by up to 6 mm: at most 2 %, in short logs one or none."""
    rng = case.rng
    if not rate or not (rows >= 50 or rng.random() < 0.6):
        return []
    count = max(1, min(int(0.02 * rows), round(rate * rows)))
    return sorted(int(i) for i in rng.choice(rows, count, replace=False))


def _lose_rows(case: Case, columns: dict[str, list[str]], rate: float) -> None:
    """Blank the position of a share of the rows, never of the first."""
    rows, length = len(columns["run"]), "m" if case.settings.si_units else "mm"
    for i in case.rng.choice(rows, max(1, int(rate * rows)), replace=False):
        for axis in "xyz" if i else "":
            columns[f"{axis}_{length}"][i] = ""


# ------------------------------------------------------------------------------------------------------ columns


def _columns(
    case: Case, campaign: Campaign, wrench: Array, measured: Array, turned: Array, scatter: Array | None
) -> dict[str, list[str]]:
    """The columns of a log by name, as text."""
    settings, rng = case.settings, case.rng
    columns: dict[str, list[str]] = {"run": list(campaign.runs)}
    if settings.time:
        columns["time_s"] = _text(campaign.time, ".4f")
    columns |= _joint_columns(case, campaign)
    if settings.wrench:
        columns |= _wrench_columns(case, wrench)
    for i, axis in enumerate("xyz"):
        name, factor, form = (f"{axis}_m", 1, ".7f") if settings.si_units else (f"{axis}_mm", 1e3, ".4f")
        columns[name] = _text(measured[:, i] * factor, form)
    if settings.orientation:
        vectors = rotation_vectors(turned)
        columns |= {f"r{axis}_deg": _text(vectors[:, i] / DEGREE, ".5f") for i, axis in enumerate("xyz")}
    if settings.link_encoders:
        columns |= _link_columns(case, campaign, scatter)
    if settings.temperature:
        columns["temperature_C"] = _text(campaign.shown_C + 0.04 * rng.normal(size=campaign.rows), ".2f")
    if settings.sigma_column:
        columns["sigma_mm"] = _text(case.instrument.sigma(campaign) * 1e3, ".4f")
        if settings.orientation:
            columns["sigma_deg"] = [f"{settings.sigma_deg:g}"] * campaign.rows
    return columns


def _text(values: Array, form: str) -> list[str]:
    return [format(value, form) for value in values]


def _joint_columns(case: Case, campaign: Campaign) -> dict[str, list[str]]:
    columns = {}
    for k, prismatic in enumerate(case.robot.prismatic):
        if case.settings.si_units:
            name, factor, form = (f"q{k + 1}_m", 1.0, ".8f") if prismatic else (f"q{k + 1}_rad", 1.0, ".9f")
        else:
            name, factor, form = (f"q{k + 1}_mm", 1e3, ".4f") if prismatic else (f"q{k + 1}_deg", 1 / DEGREE, ".7f")
        columns[name] = _text(campaign.q[:, k] * factor, form)
    return columns


def _wrench_columns(case: Case, wrench: Array) -> dict[str, list[str]]:
    """Wrench as logged: with a force sensor's noise, without error for dead weights."""
    if case.settings.design == "sensor":
        noise = force_noise(case)["force_noise_N"]
        wrench = wrench + case.rng.normal(size=wrench.shape) * np.r_[np.full(3, noise), np.full(3, 0.06 * noise)]
    forces = {f"f{axis}_N": _text(wrench[:, i], "z.2f") for i, axis in enumerate("xyz")}
    return forces | {f"m{axis}_Nm": _text(wrench[:, 3 + i], "z.3f") for i, axis in enumerate("xyz")}


def _link_columns(case: Case, campaign: Campaign, scatter: Array | None) -> dict[str, list[str]]:
    """Link-side encoders: motor and gear and spring, but no zero, which both encoders share."""
    robot, columns = case.robot, {}
    causes = [c for c in case.causes if c.cause.effect != "joint_offset"]
    everyday = [b for b in case.everyday if b.key[0] != "joint_offset"]
    state = make_true(robot, campaign, causes, everyday, scatter)
    deflection = solve_statics(state).deflection
    for k in range(robot.count):
        value, prismatic = state.q[:, k].copy(), robot.prismatic[k]
        if joint_name(k) in robot.own:
            value += deflection[robot.own[joint_name(k)]]
        value = value * (1e3 if prismatic else 1 / DEGREE) + case.rng.normal(size=campaign.rows) * ENCODER_NOISE
        columns[f"q{k + 1}_link_" + ("mm" if prismatic else "deg")] = _text(value, ".7f")
    return columns


def _facts(case: Case, campaign: Campaign, seen: Seen, noise: Array) -> dict[str, Any]:
    """What truth.json tells of a log: rows, runs, and how large gap, everyday errors and noise are."""
    robot = case.robot
    gap = observe(robot, campaign, case.causes, case.everyday).gap
    everyday = observe(robot, campaign, [], case.everyday).gap
    caused = gap if sags(case.causes) else gap - everyday
    base, tool = frame_columns(campaign.position, campaign.rotation, False)
    moved = np.abs(np.diff(campaign.q, axis=0)).max(1) > 1e-9
    return {
        "rows": campaign.rows,
        "runs": {run: campaign.runs.count(run) for run in dict.fromkeys(campaign.runs)},
        "pose_visits": 1 + int(moved.sum()),
        "gap_rms_mm": rms(gap[:, :3]) * 1e3,
        "gap_registered_rms_mm": rms(register(gap[:, :3], stack(base + tool))) * 1e3,
        "dominant_rms_mm": rms(caused[:, :3]) * 1e3,
        "background_rms_mm": rms(everyday[:, :3]) * 1e3,
        "noise_rms_mm": rms(noise + (seen.gap - gap)[:, :3]) * 1e3,
    }
