"""The forward model: finite rotations, springs in static equilibrium under weights, tool wrench and pulls on links.

Element by element from the base: the origin (with its error), the joint's own motion, then its springs in order. The
deflections are found by fixed-point steps on theta = c tau(q, theta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from benchmarks.outsider.robots import TIP, Element, Robot, Spring
from benchmarks.outsider.turns import AXES, GRAVITY, Array, dot, repeat, rotate, turn_about, turn_by


class Frame(NamedTuple):
    """Where an element's link stands, and the axes of the link before it. Shapes (n, 3, 3), (n, 3), (n, 3, 3)."""

    rotation: Array
    origin: Array
    parent: Array


class SpringAxis(NamedTuple):
    """Where a spring acts: whether it turns, its axis and its origin in base axes. Shapes (n, 3)."""

    turns: bool
    axis: Array
    origin: Array


class Pull(NamedTuple):
    """A force on the link of an element at a point, base axes. Shapes (n, 3). [N, m]"""

    element: str
    force: Array
    point: Array


class BaseMotion(NamedTuple):
    """The whole robot turns about a point and moves. [rad, m, m]"""

    turn: Array
    shift: Array
    point: Array


class TipMotion(NamedTuple):
    """The measured point moves and turns in the axes of the tip. [m, rad]"""

    shift: Array
    turn: Array


Frames = dict[str, Frame]


class State:
    """A robot in the postures of a campaign under its loads, which causes change before it is solved.

    Args:
        robot: The nominal robot.
        q: Joint values. Shape (n, count). [rad or m]
        wrench: Wrench on the tool at the TCP, base axes, force first. Shape (n, 6). [N, N m]
        gravity: Whether weights act.
    """

    def __init__(self, robot: Robot, q: Array, wrench: Array, gravity: bool = True) -> None:
        self.robot, self.rows, self.q, self.wrench = robot, len(q), q.copy(), wrench
        self.gravity = GRAVITY if gravity else 0 * GRAVITY
        self.shifts: dict[str, Array] = {}
        self.turns: dict[str, Array] = {}
        self.springs = list(robot.springs)
        self.masses: dict[str, tuple[float, Array]] = {e.name: (e.mass, e.com) for e in robot.elements}
        self.torques: dict[str, Array] = {}
        self.crosstalk: list[tuple[str, str, float]] = []
        self.pulls: list[Callable[[Frames], Pull]] = []
        self.base: list[BaseMotion] = []
        self.tip: list[TipMotion] = []
        self.seen: list[Callable[[Array], Array]] = []

    def shift(self, element: str, by: Array) -> None:
        """Move an element's origin, parent axes. [m]"""
        self.shifts[element] = self.shifts.get(element, np.zeros(3)) + by

    def turn(self, element: str, by: Array) -> None:
        """Turn an element's frame after its origin. [rad]"""
        self.turns[element] = self.turns.get(element, np.zeros(3)) + by

    def turn_joint(self, column: int, by: Array | float) -> None:
        """Move a driven joint beside its command. [rad or m]"""
        self.q[:, column] += by

    def load_joint(self, joint: str, torque: Array) -> None:
        """Add a torque on a joint's own spring. Shape (n,). [N m]"""
        self.torques[joint] = self.torques.get(joint, 0.0) + torque


@dataclass
class Solution:
    """The equilibrium: tip, frames, torque and deflection of every spring, sums of loads from the tip down."""

    position: Array
    rotation: Array
    frames: Frames
    torque: Array
    deflection: Array
    axes: list[SpringAxis]
    carried: dict[str, tuple[Array, Array]] = field(default_factory=dict)


class _Mechanism:
    """What stays the same from step to step: joint values with mimics, origins, springs by element."""

    def __init__(self, state: State) -> None:
        robot, self.state = state.robot, state
        self.values = {e.name: state.q[:, e.column] for e in robot.movers}
        for e in robot.elements:
            if e.mimic:
                self.values[e.name] = e.mimic[1] * self.values[e.mimic[0]]
        self.origins = [self._origin(e) for e in robot.elements]
        self.by_element: dict[str, list[int]] = {}
        for i, spring in enumerate(state.springs):
            self.by_element.setdefault(spring.joint, []).append(i)
        self.directions = [_direction(robot.element[s.joint], s) for s in state.springs]

    def _origin(self, e: Element) -> tuple[Array, Array]:
        state = self.state
        turned = e.turned @ turn_by(repeat(state.turns[e.name], state.rows)) if e.name in state.turns else e.turned
        return turned, repeat(e.xyz + state.shifts.get(e.name, 0.0), state.rows)

    def place(self, deflection: Array) -> tuple[Frames, list[SpringAxis]]:
        """Frames of all elements and axes of all springs at given deflections."""
        state = self.state
        R, p = np.broadcast_to(np.eye(3), (state.rows, 3, 3)), np.zeros((state.rows, 3))
        frames: Frames = {}
        axes: dict[int, SpringAxis] = {}
        for e, (R_origin, p_origin) in zip(state.robot.elements, self.origins, strict=True):
            parent, p = R, p + rotate(R, p_origin)
            R = R @ R_origin
            if e.kind == "revolute":
                R = R @ turn_about(e.axis, self.values[e.name])
            elif e.prismatic:
                p = p + rotate(R, e.axis) * self.values[e.name][:, None]
            for i in self.by_element.get(e.name, ()):
                R, p, axes[i] = self._deflect(i, R, p, deflection[i])
            frames[e.name] = Frame(R, p, parent)
        return frames, [axes[i] for i in range(len(axes))]

    def _deflect(self, i: int, R: Array, p: Array, by: Array) -> tuple[Array, Array, SpringAxis]:
        turns, axis = self.directions[i]
        offset = self.state.springs[i].offset
        place = p if offset is None else p + rotate(R, np.asarray(offset, float))
        where = SpringAxis(turns, rotate(R, axis), place)
        if not turns:
            return R, p + where.axis * by[:, None], where
        R = R @ turn_about(axis, by)
        if offset is not None:
            p = place - rotate(R, np.asarray(offset, float))
        return R, p, where

    def load(self, frames: Frames, axes: list[SpringAxis]) -> tuple[Array, dict[str, tuple[Array, Array]]]:
        """Torque of every spring, and force and moment (about the base origin) that every element carries."""
        state = self.state
        force, tip = state.wrench[:, :3].copy(), frames[TIP].origin
        moment = state.wrench[:, 3:] + np.cross(tip, force)
        pulls = [pull(frames) for pull in state.pulls]
        torque, carried = np.zeros((len(axes), state.rows)), {}
        for e in reversed(state.robot.elements):
            mass, com = state.masses[e.name]
            if mass:
                weight = repeat(mass * state.gravity, state.rows)
                centre = frames[e.name].origin + rotate(frames[e.name].rotation, repeat(com, state.rows))
                force, moment = force + weight, moment + np.cross(centre, weight)
            for pull in pulls:
                if pull.element == e.name:
                    force, moment = force + pull.force, moment + np.cross(pull.point, pull.force)
            carried[e.name] = (force, moment)
            for i in self.by_element.get(e.name, ()):
                turns, axis, origin = axes[i]
                torque[i] = dot(axis, moment - np.cross(origin, force)) if turns else dot(axis, force)
        return torque, carried

    def deflect(self, torque: Array) -> Array:
        """Deflection of every spring under the torques, those that causes add included."""
        own = self.state.robot.own
        felt = torque.copy()
        for joint, extra in self.state.torques.items():
            if joint in own:
                felt[own[joint]] = felt[own[joint]] + extra
        deflection = np.array([s.deflect(felt[i]) for i, s in enumerate(self.state.springs)]).reshape(felt.shape)
        for joint, source, rate in self.state.crosstalk:
            deflection[own[joint]] = deflection[own[joint]] + rate * felt[own[source]]
        return deflection


def _direction(e: Element, spring: Spring) -> tuple[bool, Array]:
    if not isinstance(spring.axis, str):
        return True, np.asarray(spring.axis, float)
    if spring.axis == "own":
        return not e.prismatic, e.axis
    return spring.axis[0] == "r", AXES[spring.axis[1]]


def solve_statics(state: State, steps: int = 7) -> Solution:
    """Find the equilibrium of a state, to 1e-10 rad or by the given number of steps."""
    mechanism = _Mechanism(state)
    deflection = np.zeros((len(state.springs), state.rows))
    for _ in range(steps):
        frames, axes = mechanism.place(deflection)
        torque, carried = mechanism.load(frames, axes)
        before, deflection = deflection, mechanism.deflect(torque)
        if np.abs(deflection - before).max(initial=0) < 1e-10:
            break
    position, rotation = _see_tip(state, frames[TIP])
    return Solution(position, rotation, frames, torque, deflection, axes, carried)


def _see_tip(state: State, tip: Frame) -> tuple[Array, Array]:
    """Pose of the measured point: motions of the tip, then of the base, then what the instrument makes of it."""
    position, rotation = tip.origin, tip.rotation
    for shift, turn in state.tip:
        position = position + rotate(rotation, repeat(shift, state.rows))
        rotation = rotation @ turn_by(repeat(turn, state.rows))
    for turn, shift, point in state.base:
        turned = turn_by(repeat(turn, state.rows))
        position, rotation = point + rotate(turned, position - point) + shift, turned @ rotation
    for see in state.seen:
        position = position + see(position)
    return position, rotation


def move_tip(position: Array, frames: Frames, robot: Robot) -> tuple[Array, dict[str, Array]]:
    """Motion of the TCP by each driven joint (its mimics included), and by each moving element alone.

    Returns:
        Shape (count, n, 6) [m or m/rad, then rad], and by name of the element shape (n, 6).
    """
    alone = {}
    for e in robot.elements:
        if e.kind == "fixed":
            continue
        axis = rotate(frames[e.name].rotation, e.axis)
        arm = position - frames[e.name].origin
        alone[e.name] = slide_by(axis) if e.prismatic else turn_round(axis, arm)
    jacobian = np.zeros((robot.count, len(position), 6))
    for e in robot.elements:
        if e.column is not None:
            jacobian[e.column] += alone[e.name]
        if e.mimic:
            jacobian[int(robot.element[e.mimic[0]].column or 0)] += e.mimic[1] * alone[e.name]
    return jacobian, alone


def slide_by(axis: Array) -> Array:
    """Motion of the tip by a unit shift along an axis. Shape (n, 6)."""
    return np.concatenate([axis, 0 * axis], 1)


def turn_round(axis: Array, arm: Array) -> Array:
    """Motion of the tip by a unit turn about an axis that lies `arm` before it. Shape (n, 6)."""
    return np.concatenate([np.cross(axis, arm), axis], 1)
