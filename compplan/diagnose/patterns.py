"""Patterns of deviation: what the TCP would do if one joint erred in one way.

Every column is a displacement of the measured point at all rows, linear in one unknown. It belongs to a place (a joint,
the base, the tool, or none), to a mechanism there (its zero, its spring, ...), and to a factor: what the error depends
on. Patterns describe a gap; effects explain it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot, Spring
from compplan.statics.chain import Chain, Frames, build_chain, locate_frames

#: What can err at a place, in the order of reports.
MECHANISMS = ("zero", "geometry", "spring", "bending", "lost motion", "periodic error", "lag", "frame", "time")
#: What an error can depend on, in the order of reports.
FACTORS = ("pose", "load", "weight", "approach", "joint angle", "speed", "time")
#: Places that are no joint.
BASE, TOOL, NOWHERE = "base", "tool", "runs and time"
#: Cycles per turn that a joint's periodic error is searched over.
HARMONICS = np.arange(1, 41)
#: Chance that noise alone lets a harmonic in, over all that are tried.
HARMONIC_CHANCE = 1e-3
#: Range of angle below which no harmonic is looked for. [rad]
NARROWEST = np.radians(20)
#: Harmonics that one joint keeps at most.
HARMONICS_KEPT = 3
#: Runs that get a shift of their own at most; the longest come first.
RUNS_SHIFTED = 8
#: Distance of the measured point from a joint's axis, rms, below which the joint's own turn is not seen. [m]
SHORTEST_LEVER = 1e-3
#: Moment of the weights that has to vary over the rows to be seen. [N m]
LEAST_MOMENT = 1e-3
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True, eq=False)
class Patterns:
    """Columns of displacement, p of them, over n rows.

    Attributes:
        columns: Displacement per unknown, base axes. Shape (n, 3, p). [m per unit]
        place: Place of each column: a joint's name, or one of base, tool, runs and time. Length p.
        mechanism: Mechanism of each column, one of `MECHANISMS`. Length p.
        factor: Factor of each column, one of `FACTORS`. Length p.
        unit: Unit of each column's unknown, "rad" for the approach of a revolute joint. Length p.
    """

    columns: Array
    place: tuple[str, ...]
    mechanism: tuple[str, ...]
    factor: tuple[str, ...]
    unit: tuple[str, ...]


class _Collector:
    def __init__(self) -> None:
        self.columns: list[Array] = []
        self.labels: list[tuple[str, str, str, str]] = []

    def add(self, place: str, mechanism: str, factor: str, columns: Array, unit: str = "") -> None:
        """Add columns of one place, mechanism and factor. Shape (n, 3) or (n, 3, k)."""
        for column in np.moveaxis(columns.reshape(len(columns), 3, -1), 2, 0):
            self.columns.append(column)
            self.labels.append((place, mechanism, factor, unit))

    def finish(self, rows: NDArray[np.int_]) -> Patterns:
        place, mechanism, factor, unit = zip(*self.labels, strict=True)
        return Patterns(np.stack([column[rows] for column in self.columns], axis=2), place, mechanism, factor, unit)


def build_patterns(
    robot: Robot,
    campaign: Campaign,
    deviation: Array,
    rows: NDArray[np.int_],
    registration: Registration | None,
) -> Patterns:
    """Build the patterns of a robot over the rows of a campaign.

    Args:
        robot: The nominal robot.
        campaign: The whole log: order and time of its rows count.
        deviation: Measured minus predicted point, base axes; it chooses the harmonics of each joint. Shape (n, 3). [m]
        rows: Rows of the log that the patterns are wanted at. Shape (k,).
        registration: Frames fitted to the campaign, or None.

    Returns:
        Patterns at the rows wanted.
    """
    site = _survey(robot, campaign, registration)
    collector = _Collector()
    for index in range(robot.nq):
        _add_own(collector, site, index)
        _add_beside(collector, site, index)
    _add_angles(collector, site, deviation, rows)
    lever = np.swapaxes(np.cross(np.eye(3)[None], site.point[:, None, :]), 1, 2)
    if campaign.load_varies:
        moments = _moments(site, np.zeros_like(site.point))
        collector.add(BASE, "bending", "load", lever * moments[:, None, :])
    if registration is None or "base" not in registration.parts:
        shift = np.broadcast_to(np.eye(3), lever.shape)
        collector.add(BASE, "frame", "pose", np.concatenate([shift, lever], axis=2))
    if registration is None or "tool" not in registration.parts:
        collector.add(TOOL, "frame", "pose", site.frames.tcp_rotation)
    _add_time(collector, campaign, site.point)
    return collector.finish(rows)


def build_nuisance(
    robot: Robot, campaign: Campaign, rows: NDArray[np.int_], registration: Registration | None
) -> Array | None:
    """Build the columns of what a registration has already fitted: base frame, a point a target. Shape (rows, 3, k)."""
    if registration is None or not registration.parts:
        return None
    frames = locate_frames(build_chain(robot), np.nan_to_num(campaign.q))
    point = target_points(campaign, frames, registration)
    columns = []
    if "base" in registration.parts:
        columns.append(np.broadcast_to(np.eye(3), (len(point), 3, 3)))
        columns.append(np.swapaxes(np.cross(np.eye(3)[None], point[:, None, :]), 1, 2))
    if "tool" in registration.parts:
        for number in range(len(campaign.target_names)):
            columns.append(frames.tcp_rotation * (campaign.target_index == number)[:, None, None])
    return np.concatenate(columns, axis=2)[rows]


def target_points(campaign: Campaign, frames: Frames, registration: Registration | None) -> Array:
    """Locate the measured point of each row in the base frame [m]. Shape (n, 3)."""
    if registration is None:
        return frames.tcp_position
    offset = registration.tool[campaign.target_index, :3, 3]
    return np.asarray(frames.tcp_position + np.einsum("nij,nj->ni", frames.tcp_rotation, offset))


@dataclass(frozen=True, eq=False)
class _Site:
    """A robot at the rows of a campaign: chain, frames, measured points, axes of the frame behind each joint."""

    robot: Robot
    campaign: Campaign
    chain: Chain
    frames: Frames
    point: Array
    behind: Array

    def joint(self, index: int) -> tuple[str, bool, Array, Array]:
        """Name of a joint, whether it slides, its axis and origin in the base frame. Shape (n, 3) each."""
        element = int(self.chain.joint_elements[index])
        axis, origin = self.frames.axis[:, element], self.frames.origin[:, element]
        return self.robot.joint_names[index], bool(self.chain.translates[element]), axis, origin

    def own(self, index: int) -> Array:
        """Move the point by a unit of a joint's own motion [m/rad or 1]. Shape (n, 3)."""
        _, slides, axis, origin = self.joint(index)
        return axis if slides else np.cross(axis, self.point - origin)

    def moves(self, index: int) -> bool:
        """Tell whether a joint's own motion is seen at the point."""
        return bool(np.sqrt((self.own(index) ** 2).sum(1).mean()) > SHORTEST_LEVER)


def _survey(robot: Robot, campaign: Campaign, registration: Registration | None) -> _Site:
    """Locate joints, points and the frames behind the joints; rigid springs stand in for the latter."""
    q = np.nan_to_num(campaign.q)
    chain = build_chain(robot)
    frames = locate_frames(chain, q)
    probes = tuple(Spring(name, axis, 0.0) for name in robot.joint_names for axis in ("rx", "ry", "rz"))
    probed = build_chain(replace(robot, springs=probes, link_elasticities=()))
    axes = locate_frames(probed, q).axis[:, probed.spring_elements]
    behind = axes.reshape(len(q), robot.nq, 3, 3)
    return _Site(robot, campaign, chain, frames, target_points(campaign, frames, registration), behind)


def _add_own(collector: _Collector, site: _Site, index: int) -> None:
    """Add what a joint does about or along its own axis: constant, by load, weight, direction of approach and speed."""
    if not site.moves(index):
        return
    name, slides, axis, origin = site.joint(index)
    own, campaign = site.own(index), site.campaign
    unit = "m" if slides else "rad"
    collector.add(name, "zero", "pose", own, unit)
    if campaign.load_varies:
        load = np.nan_to_num(campaign.wrench[:, :3]) if slides else _moments(site, origin)
        collector.add(name, "spring", "load", own * _dot(load, axis)[:, None])
    force, moment = _weights(site, index)
    weight = _dot(force if slides else moment, axis)
    if np.abs(weight).max() > LEAST_MOMENT:
        collector.add(name, "spring", "weight", own * weight[:, None])
    approach = campaign.approach[:, index]
    if (approach > 0).any() and (approach < 0).any():
        collector.add(name, "lost motion", "approach", own * approach[:, None], unit)
    if np.abs(campaign.speed[:, index]).max() > 0:
        collector.add(name, "lag", "speed", own * campaign.speed[:, index][:, None], "s")


def _add_beside(collector: _Collector, site: _Site, index: int) -> None:
    """Add what a joint does beside its own axis: wrong placement, and bending of the link behind it under its loads."""
    name, slides, axis, origin = site.joint(index)
    before = site.behind[:, index - 1] if index else np.broadcast_to(np.eye(3), (len(axis), 3, 3))
    crossing = _complete(axis, before)
    turns = [np.cross(direction, site.point - origin) for direction in crossing]
    shifts = crossing if slides else (axis, *crossing)
    collector.add(name, "geometry", "pose", np.stack([*turns, *shifts], axis=2))
    loads = {"load": _moments(site, origin)} if site.campaign.load_varies else {}
    weight = _weights(site, index)[1]
    if np.abs(weight).max() > LEAST_MOMENT:
        loads["weight"] = weight
    for direction in _complete(axis, site.behind[:, index]):
        turn = np.cross(direction, site.point - origin)
        for factor, load in loads.items():
            collector.add(name, "bending", factor, turn * _dot(load, direction)[:, None])


def _complete(axis: Array, triad: Array) -> tuple[Array, Array]:
    """Complete an axis by two directions that stand still in a frame in which the axis stands still too.

    Args:
        axis: Shape (n, 3).
        triad: Axes of the frame. Shape (n, 3, 3), one axis a row.
    """
    along = np.abs(np.einsum("nki,ni->nk", triad, axis)).mean(axis=0)
    helper = triad[:, int(np.argmin(along))]
    beside = helper - _dot(helper, axis)[:, None] * axis
    beside = beside / np.linalg.norm(beside, axis=1, keepdims=True)
    return beside, np.cross(axis, beside)


def _moments(site: _Site, origin: Array) -> Array:
    """Sum the moment of the external wrench [N m] about points of the base frame. Shape (n, 3)."""
    wrench = np.nan_to_num(site.campaign.wrench)
    return np.asarray(wrench[:, 3:] + np.cross(site.frames.tcp_position - origin, wrench[:, :3]))


def _weights(site: _Site, index: int) -> tuple[Array, Array]:
    """Sum force and moment of the known weights beyond a joint, about it, whether or not the model counts gravity.

    Returns:
        Force and moment. Shape (n, 3) each. [N, N m]
    """
    element = int(site.chain.joint_elements[index])
    gravity = GRAVITY if site.robot.gravity is None else site.robot.gravity
    beyond = site.chain.body_element >= element
    weight = np.asarray(site.chain.mass)[beyond, None] * gravity
    arms = site.frames.centre[:, beyond] - site.frames.origin[:, element][:, None, :]
    force = np.broadcast_to(weight.sum(0), site.point.shape)
    return force, np.asarray(np.cross(arms, weight).sum(1))


def _add_angles(collector: _Collector, site: _Site, deviation: Array, rows: NDArray[np.int_]) -> None:
    """Add the harmonics of each joint's own angle that stand out of the deviation."""
    left = _leave_constants(site, deviation, rows)
    for index in range(site.robot.nq):
        name, slides, _, _ = site.joint(index)
        angle = np.nan_to_num(site.campaign.q[:, index])
        if slides or not site.moves(index) or np.ptp(angle[rows]) < NARROWEST:
            continue
        own = site.own(index)
        for harmonic in _choose_harmonics(own[rows], angle[rows], left):
            waves = np.stack([np.cos(harmonic * angle), np.sin(harmonic * angle)], axis=1)
            collector.add(name, "periodic error", "joint angle", own[:, :, None] * waves[:, None, :])


def _leave_constants(site: _Site, deviation: Array, rows: NDArray[np.int_]) -> Array:
    """Take constant joint errors and a rigid shift out of the deviation, so that they do not pass for harmonics."""
    shift = np.broadcast_to(np.eye(3), (len(site.point), 3, 3))
    columns = [shift, site.frames.tcp_rotation, *(site.own(index)[:, :, None] for index in range(site.robot.nq))]
    design = np.concatenate(columns, axis=2)[rows].reshape(3 * len(rows), -1)
    target = deviation[rows].ravel()
    return np.asarray(target - design @ np.linalg.lstsq(design, target, rcond=1e-8)[0]).reshape(-1, 3)


def _choose_harmonics(own: Array, angle: Array, left: Array) -> list[int]:
    """Choose the harmonics that explain more than noise would, by the largest gain among all that are tried."""
    wave = np.exp(1j * angle[:, None] * HARMONICS)
    projected = (own * left).sum(1)
    lever = (own**2).sum(1)
    total = float((left**2).sum())
    visited = np.ptp(angle) * HARMONICS > np.pi
    amplitude = np.abs(projected @ wave) ** 2 / max(float(lever.sum()) / 2, 1e-300)
    share = np.where(visited, amplitude / max(total, 1e-300), 0.0)
    threshold = 2 * np.log(len(HARMONICS) / HARMONIC_CHANCE) / (3 * len(left))
    best = np.argsort(share)[::-1][:HARMONICS_KEPT]
    return [int(HARMONICS[k]) for k in best if share[k] > threshold]


def _add_time(collector: _Collector, campaign: Campaign, point: Array) -> None:
    """Add a shift of each run against the first, and growth and drift with time or temperature."""
    runs, count = np.unique(campaign.run_index, return_counts=True)
    later = [run for run in runs[np.argsort(-count, kind="stable")][: RUNS_SHIFTED + 1] if run != campaign.run_index[0]]
    for run in later[:RUNS_SHIFTED]:
        inside = (campaign.run_index == run).astype(float)
        collector.add(NOWHERE, "time", "time", inside[:, None, None] * np.eye(3)[None])
    clock = campaign.warming if campaign.warming is not None else campaign.time
    clock = np.arange(len(campaign), dtype=float) if clock is None else np.nan_to_num(clock)
    span = float(np.ptp(clock))
    if span > 0:
        share = (clock - clock[0]) / span
        collector.add(NOWHERE, "time", "time", share[:, None, None] * np.eye(3)[None])
        collector.add(NOWHERE, "time", "time", share[:, None] * point)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=1))
