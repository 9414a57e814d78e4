"""What is decided about a campaign before its rows are drawn: design, columns of the log, warm-up, instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.outsider.robots import SCALE, Robot
from benchmarks.outsider.turns import Array, Rng


@dataclass(frozen=True)
class WarmUp:
    """Temperature of the arm above the reference: two exponentials and a slow wave. [K, s]"""

    start: float
    rise: float
    tau1: float
    tau2: float
    wobble: float
    period: float
    fresh_start: float

    def at(self, time: Array, fresh: bool) -> Array:
        """Temperature above the reference at times of the campaign. Shape (n,). [K]"""
        start = self.fresh_start if fresh else self.start
        warming = 0.7 * (1 - np.exp(-time / self.tau1)) + 0.3 * (1 - np.exp(-time / self.tau2))
        return start + (self.rise - start * 0.5) * warming + self.wobble * np.sin(6.283 * time / self.period)


@dataclass(frozen=True)
class Settings:
    """Decisions of one case; both of its campaigns share them."""

    design: str
    path: bool
    register: bool
    poses: int
    style: str
    weights: int
    order: str
    again: float
    pace_s: float
    hook: Array
    wrench: bool
    time: bool
    temperature: bool
    orientation: bool
    sigma_column: bool
    si_units: bool
    repeatability_given: bool
    sigma_deg: float
    calm: bool
    link_encoders: bool
    warm_up: WarmUp
    room_C: float
    tracker: Array
    fresh_tracker: Array


def draw_settings(rng: Rng, robot: Robot, design: str, effects: Sequence[str], kind: str) -> Settings:
    """Draw the settings that let the wanted effects be seen.

    Args:
        rng: Random numbers; the order of the draws is part of what a seed means.
        robot: The robot.
        design: "plain", "weights" or "sensor", where no effect asks for another.
        effects: Names of the known effects that the case shall hold.
        kind: Kind of the case.
    """
    wanted = set(effects)
    if wanted & {"wrench_bias", "wrench_scale"}:
        design = "sensor"
    path = bool(wanted & {"tracking_lag", "time_skew"}) or (design == "sensor" and bool(rng.random() < 0.15))
    if "joint_stiffness" in wanted and robot.size == "scara":
        design = "sensor"
    register = not wanted & {"tool_frame", "base_frame"} and bool(rng.random() < 0.42)
    visits = _draw_visits(rng, robot)
    columns = _draw_columns(rng, design, path, wanted, kind)
    warm_up, room = _draw_warm_up(rng, columns["temperature"]), float(rng.uniform(18, 25))
    tracker, fresh_tracker = _place_tracker(rng, robot, register)
    return Settings(
        design=design,
        path=path,
        register=register,
        **visits,
        **columns,
        warm_up=warm_up,
        room_C=room,
        tracker=tracker,
        fresh_tracker=fresh_tracker,
    )


def _draw_visits(rng: Rng, robot: Robot) -> dict[str, Any]:
    """How many poses, in which style and order, how often again, with which weights at which hook."""
    counts = [rng.integers(25, 40), rng.integers(38, 61), rng.integers(90, 105)]
    poses = int(rng.choice(counts, p=[0.42, 0.48, 0.1]))
    styles = ["spread", "stations", "front", "axes", "narrow", "wristless"]
    style = str(rng.choice(styles, p=[0.42, 0.16, 0.2, 0.08, 0.07, 0.07]))
    return {
        "poses": poses,
        "style": "spread" if robot.size == "scara" and style == "wristless" else style,
        "weights": int(rng.choice([1, 2])),
        "order": str(rng.choice(["runs", "pairs"])),
        "again": float(rng.choice([0.03, 0.08, 0.2])),
        "pace_s": float(rng.uniform(20, 90)),
        "hook": 0.06 * SCALE[robot.size] * rng.normal(size=3) * (rng.random() < 0.7),
    }


def _draw_columns(rng: Rng, design: str, path: bool, wanted: set[str], kind: str) -> dict[str, Any]:
    """Which columns the log has, and how the instrument and the robot's repeatability are told."""
    wrench = design != "plain" or bool(rng.random() < 0.35)
    time = path or bool(rng.random() < 0.55)
    temperature = bool(rng.random() < 0.2)
    drawn: dict[str, Any] = {
        "wrench": wrench,
        "time": time or ("thermal_drift" in wanted and not temperature),
        "temperature": temperature,
        "orientation": bool(rng.random() < 0.13),
        "sigma_column": bool(rng.random() < 0.45),
        "si_units": bool(rng.random() < 0.1),
        "repeatability_given": bool(rng.random() < 0.5),
        "sigma_deg": float(rng.choice([0.003, 0.006, 0.01])),
    }
    drawn["calm"] = (bool(rng.random() < 0.15) and kind != "background") or kind == "none"
    sound = not wanted & {"joint_coupling", "time_skew"} and kind not in ("mixed", "unknown", "background")
    drawn["link_encoders"] = bool(rng.random() < 0.1) and sound
    return drawn


def _draw_warm_up(rng: Rng, temperature: bool) -> WarmUp:
    """A warm-up from the reference; with a temperature column the later campaign may start warm."""
    tau1, rise = float(rng.uniform(900, 3000)), float(rng.uniform(3, 12))
    tau2, wobble = float(tau1 * rng.uniform(0.12, 0.3)), float(rng.uniform(0, 0.4))
    period = float(rng.uniform(1500, 4000))
    return WarmUp(0.0, rise, tau1, tau2, wobble, period, float(rng.uniform(0, 4)) if temperature else 0.0)


def _place_tracker(rng: Rng, robot: Robot, register: bool) -> tuple[Array, Array]:
    """Where the instrument stands; a later campaign of a registered robot has another place. Shape (3,). [m]"""
    angles = rng.uniform(-0.9, 0.9, 2)
    away = robot.reach * rng.uniform(1.5, 2.6, 2) + 0.6

    def place(i: int) -> Array:
        return np.array([away[i] * np.cos(angles[i]), away[i] * np.sin(angles[i]), rng.uniform(1.0, 1.8)])

    first = place(0)
    return first, place(1) if register else first
