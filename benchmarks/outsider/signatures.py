"""Motion of the tip by a unit of every effect and place of the format's list, analytically at the nominal robot.

An effect whose plain formula has a shape beside its size (a frequency, a time constant, a row) has one variant a shape;
a variant with several columns is fitted with all of them free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Key, follow_play
from benchmarks.outsider.robots import BASE, MOUNT, TIP, Element, Robot, joint_name
from benchmarks.outsider.settings import Settings
from benchmarks.outsider.statics import State, slide_by, solve_statics, turn_round
from benchmarks.outsider.turns import DEGREE, GRAVITY, Array, dot, repeat, rotate, rotation_vectors, transpose

FREQUENCIES = sorted(
    {*np.arange(1, 12.1, 0.5), *np.arange(13.0, 41.0), *np.arange(42.0, 121.0, 1.5), 57.3, 81.0, 101.0}
)
TIME_CONSTANTS_S = (300, 900, 2000, 5000)


@dataclass(frozen=True)
class Signatures:
    """Variants of every effect and place, each of shape (n, 6, columns), and columns of unknown frames (n, 6, m)."""

    variants: dict[Key, list[Array]]
    frames: Array


def stack(columns: list[Array]) -> Array:
    """Columns of shape (n, 6) as one variant. Shape (n, 6, m)."""
    return np.stack(columns, 2)


def axis_rows(i: int, rows: int) -> Array:
    """A base axis for every row. Shape (rows, 3)."""
    return repeat(np.eye(3)[i], rows)


def frame_columns(position: Array, rotation: Array, orientation: bool) -> tuple[list[Array], list[Array]]:
    """Motion of the tip by the base frame (6 columns) and by the target (3, with orientation 6)."""
    rows = len(position)
    base = [slide_by(axis_rows(i, rows)) for i in range(3)]
    base += [turn_round(axis_rows(i, rows), position) for i in range(3)]
    tool = [slide_by(rotation[..., i]) for i in range(3)]
    if orientation:
        tool += [np.concatenate([0 * position, rotation[..., i]], 1) for i in range(3)]
    return base, tool


def grow_links(robot: Robot, campaign: Campaign) -> Array:
    """Motion of the tip when all links grow by their own length. Shape (n, 6). [m]"""
    frames, rows = campaign.nominal.frames, campaign.rows
    return _grow(robot, {e.name: frames[e.name].parent for e in robot.elements}, rows)


def _grow(robot: Robot, parents: dict[str, Array], rows: int) -> Array:
    growth = sum(rotate(parents[e.name], repeat(e.xyz, rows)) for e in robot.elements[1:])
    return np.concatenate([growth, np.zeros((rows, 3))], 1)


def linearize(robot: Robot, campaign: Campaign, settings: Settings, gravity: bool = True) -> Signatures:
    """Signatures of everything in the format's list.

    Args:
        robot: The nominal robot.
        campaign: The campaign.
        settings: Which columns its log has.
        gravity: Whether the nominal folder has gravity; without it `gravity_sag` is possible and `payload` is not.
    """
    table = _Table(robot, campaign, settings, gravity)
    for k in range(robot.count):
        table.add_geometry(k)
        if joint_name(k) in robot.own:
            table.add_spring(k)
        table.add_gear(k)
    table.add_clock()
    table.add_base()
    table.add_loads()
    table.add_heat()
    table.add_frames()
    if not gravity:
        table.add_sag()
    return Signatures(table.variants, table.frames)


class _Table:
    """Signatures as they are gathered."""

    def __init__(self, robot: Robot, campaign: Campaign, settings: Settings, gravity: bool) -> None:
        self.robot, self.campaign, self.settings, self.gravity = robot, campaign, settings, gravity
        self.q, self.rows = campaign.q, campaign.rows
        bare = None if gravity else solve_statics(State(robot, campaign.q, campaign.wrench, gravity=False))
        self.at = bare or campaign.nominal
        self.variants: dict[Key, list[Array]] = {}
        self.base, self.tool = frame_columns(self.at.position, campaign.rotation, settings.orientation)
        self.frames = stack(self.base + self.tool)

    def add(self, effect: str, joint: str | None, axis: str | None, *variants: Array | list[Array]) -> None:
        """Add variants of an effect and place, each one column (n, 6) or a list of columns."""
        listed = self.variants.setdefault((effect, joint, axis), [])
        listed += [stack(v) if isinstance(v, list) else v[:, :, None] for v in variants]

    def by_joint(self, k: int, motion: Array) -> Array:
        """Motion of the tip when a joint moves beside its command, its mimics with it."""
        return self.campaign.jacobian[k] * np.asarray(motion)[:, None]

    def round(self, axis: Array, origin: Array) -> Array:
        """Motion of the tip by a unit turn about an axis through a point."""
        return turn_round(axis, self.at.position - origin)

    def add_geometry(self, k: int) -> None:
        """Offset of a joint, shifts and turns of its origin, bending across it and yielding along axes."""
        name, e = joint_name(k), self.robot.movers[k]
        frame, (force, moment) = self.at.frames[name], self.at.carried[name]
        self.add("joint_offset", name, None, self.campaign.jacobian[k])
        for i, letter in enumerate("xyz"):
            before, axis = frame.parent[..., i], frame.rotation[..., i]
            self.add("link_geometry", name, "t" + letter, slide_by(before))
            self.add("link_geometry", name, "r" + letter, self.round(before, frame.origin))
            if e.prismatic or abs(e.axis[i]) < 0.5:
                bending = dot(axis, moment - np.cross(frame.origin, force))
                self.add("link_compliance", name, "r" + letter, self.round(axis, frame.origin) * bending[:, None])
            along = dot(axis, force)
            if np.abs(along).max() > 0:
                self.add("link_compliance", name, "t" + letter, slide_by(axis) * along[:, None])

    def add_spring(self, k: int) -> None:
        """Compliance of a joint, its nonlinearity, and a compensator where the joint leans."""
        name, e = joint_name(k), self.robot.movers[k]
        i = self.robot.own[name]
        compliance, torque, alone = self.robot.springs[i].compliance, self.at.torque[i], self.campaign.motions[1][name]
        top = np.abs(torque).max() + 1e-9
        if top > 1e-6:
            self.add("joint_stiffness", name, None, alone * (compliance * torque)[:, None])
            x = torque / top
            shapes = (x * abs(x), x**3, np.tanh(x / 0.1), np.tanh(x / 0.3), np.sign(x) * np.maximum(abs(x) - 0.3, 0))
            bent = [alone * (compliance * top * shape)[:, None] for shape in shapes]
            self.add("stiffness_nonlinearity", name, None, *bent)
        if not e.prismatic and k <= (3 if self.robot.rail else 2) and abs(e.axis[2]) < 0.5:
            waves = [alone * wave(self.q[:, k])[:, None] for wave in (np.sin, np.cos)]
            self.add("gravity_compensator", name, None, waves)

    def add_gear(self, k: int) -> None:
        """Gear waves, lost motion from three beginnings, coupling to every joint, lag."""
        name, q = joint_name(k), self.q
        prismatic = self.robot.movers[k].prismatic
        for n in [] if prismatic else FREQUENCIES:
            waves = [self.by_joint(k, np.sin(n * q[:, k])), self.by_joint(k, np.cos(n * q[:, k]))]
            self.add("transmission_error", name, None, waves)
        for start in (-1, 0, 1):
            play = follow_play(q[:, k], start, 1.0, 0.005 if prismatic else DEGREE)
            self.add("backlash", name, None, self.by_joint(k, play))
        for i in [*(i for i in range(self.robot.count) if i != k), k]:
            self.add("joint_coupling", name, None, self.by_joint(k, q[:, i]))
        if self.settings.path:
            self.add("tracking_lag", name, None, self.by_joint(k, self.campaign.speed[:, k]))

    def add_clock(self) -> None:
        """Lag of all joints and skew of the clocks; without a path, rows that are one move late."""
        joints, campaign = range(self.robot.count), self.campaign
        if self.settings.path:
            late = np.sum([self.by_joint(k, campaign.speed[:, k]) for k in joints], axis=0)
            self.add("tracking_lag", None, None, late)
            self.add("time_skew", None, None, late)
            return
        moves = np.vstack([np.zeros(self.robot.count), np.diff(self.q, axis=0)])
        moves[campaign.first] = 0
        self.add("time_skew", None, None, np.sum([self.by_joint(k, moves[:, k]) for k in joints], axis=0))

    def add_base(self) -> None:
        """A yielding base plate."""
        moment = self.at.carried[BASE][1]
        for i, letter in enumerate("xyz"):
            axis = axis_rows(i, self.rows)
            bent = self.round(axis, np.zeros(3)) * dot(axis, moment)[:, None]
            self.add("base_compliance", None, "r" + letter, bent)

    def by_wrench(self, force: Array, moment: Array, point: Array, last: str) -> Array:
        """Motion of the tip by a wrench at a point of the link behind an element."""
        motion = np.zeros((self.rows, 6))
        for e in self.robot.elements:
            motion += self._yield_at(e, force, moment, point)
            if e.name == last:
                break
        return motion

    def _yield_at(self, e: Element, force: Array, moment: Array, point: Array) -> Array:
        motion = np.zeros((self.rows, 6))
        for spring, (turns, axis, origin) in zip(self.robot.springs, self.campaign.nominal.axes, strict=True):
            if spring.joint == e.name:
                torque = dot(axis, moment + np.cross(point - origin, force)) if turns else dot(axis, force)
                unit = self.round(axis, origin) if turns else slide_by(axis)
                motion += unit * (spring.compliance * torque)[:, None]
        return motion

    def add_loads(self) -> None:
        """A mass at the tool, bias and gain of the logged wrench."""
        none = np.zeros((self.rows, 3))
        if self.gravity:
            mount, weight = self.at.frames[MOUNT], repeat(GRAVITY, self.rows)
            centre = mount.origin + rotate(mount.rotation, repeat(self.robot.tool.com, self.rows))
            mass = self.by_wrench(weight, none, centre, MOUNT)
            levers = [np.cross(mount.rotation[..., i], weight) for i in range(3)]
            self.add("payload", None, None, mass, [mass, *(self.by_wrench(none, m, centre, MOUNT) for m in levers)])
        if not self.settings.wrench:
            return
        tip, wrench = self.at.position, self.campaign.wrench
        for in_sensor in (False, True):
            axes = [self.campaign.rotation[..., i] if in_sensor else axis_rows(i, self.rows) for i in range(3)]
            forces = [self.by_wrench(a, none, tip, TIP) for a in axes]
            moments = [self.by_wrench(none, a, tip, TIP) for a in axes]
            both = [column for pair in zip(forces, moments, strict=True) for column in pair]
            self.add("wrench_bias", None, None, forces, both)
        if np.abs(wrench).max() > 0:
            self.add("wrench_scale", None, None, self.by_wrench(wrench[:, :3], wrench[:, 3:], tip, TIP))

    def add_heat(self) -> None:
        """Links that grow with the temperature, or with time where there is no such column."""
        settings, campaign = self.settings, self.campaign
        shapes = [campaign.warmth] if settings.temperature else []
        if settings.time:
            shapes += [1 - np.exp(-campaign.time / t) for t in TIME_CONSTANTS_S]
            shapes += [campaign.time / campaign.time.max()]
        if shapes:
            parents = {name: frame.parent for name, frame in self.at.frames.items()}
            growth = _grow(self.robot, parents, self.rows)
            self.add("thermal_drift", None, None, *[growth * shape[:, None] for shape in shapes])

    def add_frames(self) -> None:
        """Base and tool frame where they count as known, and their shifts from every row on."""
        campaign = self.campaign
        if not campaign.register:
            self.add("base_frame", None, None, self.base)
            self.add("tool_frame", None, None, self.tool)
        for row in range(2, self.rows - 1):
            if self.settings.path and not (campaign.static[row] or campaign.first[row]):
                continue
            since = (np.arange(self.rows) >= row)[:, None] * 1.0
            self.add("frame_shift", None, None, [column * since for column in self.base])
            self.add("tool_shift", None, None, [column * since for column in self.tool])

    def add_sag(self) -> None:
        """The weights that the nominal folder leaves out."""
        sagged, bare = self.campaign.nominal, self.at
        turn = rotation_vectors(sagged.rotation @ transpose(bare.rotation))
        self.add("gravity_sag", None, None, np.concatenate([sagged.position - bare.position, turn], 1))
