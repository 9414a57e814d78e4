"""Causes without a name in the format's list: instrument, line of sight, target, and corrections in space."""

from __future__ import annotations

import itertools

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, level_axis, name_unknown
from benchmarks.outsider.robots import SCALE, Robot
from benchmarks.outsider.statics import State, TipMotion
from benchmarks.outsider.turns import AXES, Array, Rng, repeat, rotate, transpose, unit

STRAIGHT = np.zeros(3)


def refraction(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Warm air near the floor bends the line of sight."""
    gradient, height = rng.uniform(0.5, 1.5), 0.4

    def apply(state: State, on: Campaign, size: float) -> None:
        def see(position: Array) -> Array:
            path = np.linalg.norm(position - on.tracker, axis=1)
            above = np.maximum(0, 0.5 * (position[:, 2] + on.tracker[2]))
            return (size * path**2 * np.exp(-(above / height) * gradient))[:, None] * AXES["z"]

        state.seen.append(see)

    note = "warm air over the floor bends the line of sight (m per m^2 of path at the floor)"
    return name_unknown("refraction", note, apply, 3e-5, 2e-6, 6e-5)


def smr_nest(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The reflector's optical centre is off, and the ball is rolled until it sees the tracker."""
    off = unit(rng)

    def apply(state: State, on: Campaign, size: float) -> None:
        def see(position: Array) -> Array:
            sight = on.tracker - position
            sight /= np.linalg.norm(sight, axis=1)[:, None]
            level = np.cross(AXES["z"], sight)
            level /= np.linalg.norm(level, axis=1)[:, None] + 1e-9
            in_tool = rotate(transpose(on.rotation), sight)
            roll = np.arctan2(in_tool[:, 1], in_tool[:, 0])
            across = (off[0] * np.cos(roll) - off[1] * np.sin(roll))[:, None]
            up = (off[0] * np.sin(roll) + off[1] * np.cos(roll))[:, None]
            return size * (level * across + np.cross(sight, level) * up + sight * off[2])

        state.seen.append(see)

    note = (
        "the optical centre is off the ball's centre, and the ball is rolled in its nest until it sees the tracker (m)"
    )
    return name_unknown("smr_nest", note, apply, 4e-4, 5e-5, 1e-3)


def two_nests(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Whichever of two nests faces the tracker is measured."""
    side = unit(rng)
    level_axis(rng)  # without use; a seed keeps its meaning

    def apply(state: State, on: Campaign, size: float) -> None:
        sight = rotate(transpose(on.rotation), on.tracker - on.position)
        facing = (sight[:, :2] @ side[:2] > 0) * 1.0
        state.tip.append(TipMotion(size * facing[:, None] * side, STRAIGHT))

    note = "whichever of two nests faces the tracker is measured, and one of them is not where it should be (m)"
    return name_unknown("two_nests", note, apply, 5e-4, 8e-5, 4e-3)


def tracker_encoder(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The tracker's angle encoders sit off-centre."""
    phases = rng.uniform(0, 6.3, 3)

    def apply(state: State, on: Campaign, size: float) -> None:
        def see(position: Array) -> Array:
            v = position - on.tracker
            azimuth, level = np.arctan2(v[:, 1], v[:, 0]), np.linalg.norm(v[:, :2], axis=1)
            elevation = np.arctan2(v[:, 2], level)
            aside = size * (np.sin(4 * azimuth + phases[0]) + 0.5 * np.sin(9 * azimuth + phases[1]))
            up = size * 0.6 * np.sin(6 * elevation + phases[2])
            across = np.c_[-np.sin(azimuth), np.cos(azimuth), 0 * azimuth]
            return (level * aside)[:, None] * across + (np.linalg.norm(v, axis=1) * up)[:, None] * AXES["z"]

        state.seen.append(see)

    note = "the circles of the tracker's angle encoders sit off-centre and carry a few harmonics (rad)"
    return name_unknown("tracker_encoder", note, apply, 4e-5, 5e-6, 1.2e-4)


def stale_error_table(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The controller applies corrections on a grid in space that are out of date."""
    pitch = 0.28 * robot.reach
    table = np.random.default_rng(int(rng.integers(1 << 30))).normal(size=(24, 24, 24, 3))

    def see(position: Array) -> Array:
        place = position / pitch + 12
        cell = np.clip(np.floor(place).astype(int), 0, 22)
        within, correction = place - cell, np.zeros_like(position)
        for corner in itertools.product((0, 1), repeat=3):
            weight = np.where(corner, within, 1 - within).prod(1)
            correction += table[tuple((cell + corner).T)] * weight[:, None]
        return correction

    def apply(state: State, on: Campaign, size: float) -> None:
        state.seen.append(lambda position: size * see(position))

    note = (
        "the controller still applies a table of corrections (grid in space) that was taken before the robot was moved"
    )
    return name_unknown("stale_error_table", note + " (m)", apply, 4e-4, 5e-5, 3e-3)


def tool_changer_rock(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The tool falls from one seat to the other as gravity turns in its frame."""
    fall = rng.normal(size=3)
    fall[2] *= 0.3
    fall /= np.linalg.norm(fall)
    axis = level_axis(rng)
    axis[2] = 0.3 * rng.normal()
    lever = 0.12 * SCALE[robot.size] * np.cross(axis, AXES["z"])

    def apply(state: State, on: Campaign, size: float) -> None:
        down = -rotate(transpose(on.rotation), repeat(AXES["z"], on.rows))
        seat = (size * np.tanh((down @ fall - 0.1) / 0.08))[:, None]
        state.tip.append(TipMotion(0.02 * seat * fall, seat * axis))
        state.seen.append(lambda position: rotate(on.rotation, seat * lever))

    note = (
        "the tool changer does not clamp: the tool falls from one seat to the other as gravity turns in its frame (rad)"
    )
    return name_unknown("tool_changer_rock", note, apply, 2e-3, 1e-4, 1.2e-2)
