"""What is identified: compliances, geometry and frames as one vector of named parameters.

Compliance enters linearly, C(p) = C_nominal + sum_k (p_k - nominal_k) E_k, and geometry as constant elastic
coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.robot import Array, LinkElasticity, Robot, Spring
from compplan.statics.chain import Chain, build_chain

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
LINK_TERMS = ("diagonal", "beam", "full", "scale")
GEOMETRY = ("none", "offsets", "all")

#: Typical sizes by what a parameter does: the yardstick for "cannot be told at all" where the nominal value is zero.
#: Assumed from robots of the literature: 1e-6 rad/(N m), 1e-8 m/N, and their geometric mean between them.
TYPICAL_SIZE = {"rad/(N m)": 1e-6, "m/N": 1e-8, "rad/N": 1e-7, "1": 1.0, "m": 1e-3, "rad": 1e-3}


@dataclass(frozen=True)
class Parameter:
    """One number to identify.

    Attributes:
        name: "joint_3" (own axis), "joint_3.rx", "link_2.tx*ry" (off-diagonal), "joint_3.offset", "base.tx", ...
        kind: "joint" (a spring about or along a joint's own axis), "spring" (any other), "link", "geometry", "base" or
            "tool".
        unit: rad/(N m), m/N, rad/N, m, rad, or 1 for a factor.
        nominal: Value in the model before. [unit]
        size: Typical size, by which near-singular directions are judged. [unit]
        entries: Entries (i, j, coefficient) of the compliance of the elastic coordinates, i <= j.
        shift: Elastic coordinate that a geometry parameter moves by a constant, or -1.
    """

    name: str
    kind: str
    unit: str
    nominal: float
    size: float
    entries: tuple[tuple[int, int, float], ...] = ()
    shift: int = -1


@dataclass(frozen=True)
class FreeRobot:
    """A robot, its elastic chain and the parameters that are free in it.

    Attributes:
        robot: The robot, with a spring of compliance zero where one is to be identified.
        chain: Its elastic chain.
        parameters: Compliance and geometry parameters. Length p.
        spring_labels: Name of each spring of `robot`, "" where it only stands for geometry.
        link_coordinates: First elastic coordinate of each link elasticity of `robot`.
    """

    robot: Robot
    chain: Chain
    parameters: tuple[Parameter, ...]
    spring_labels: tuple[str, ...]
    link_coordinates: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nominal(self) -> Array:
        """Values in the model before. Shape (p,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    @property
    def sizes(self) -> Array:
        """Typical sizes. Shape (p,)."""
        return np.array([parameter.size for parameter in self.parameters])

    def compliance(self, values: Array) -> Array:
        """Build the compliance of the elastic coordinates. Shape (s, s). [rad, m per N m, N]"""
        matrix = self.chain.compliance.copy()
        for parameter, change in zip(self.parameters, np.asarray(values) - self.nominal, strict=True):
            for i, j, coefficient in parameter.entries:
                matrix[i, j] += coefficient * change
                if i != j:
                    matrix[j, i] += coefficient * change
        return matrix

    def shift(self, values: Array) -> Array:
        """Build the constant part of the elastic coordinates: geometry. Shape (s,). [rad or m]"""
        constant = np.zeros(self.chain.n_springs)
        for parameter, value in zip(self.parameters, values, strict=True):
            if parameter.shift >= 0:
                constant[parameter.shift] += value
        return constant

    def select(self, keep: Iterable[str]) -> FreeRobot:
        """Keep the parameters of these names free; the others stay at their nominal values."""
        wanted = set(keep)
        return replace(self, parameters=tuple(p for p in self.parameters if p.name in wanted))


def build_structure(
    robot: Robot,
    *,
    springs: Sequence[str] | None = None,
    add: Sequence[Spring] = (),
    links: str | None = None,
    geometry: str = "none",
) -> FreeRobot:
    """Choose what is free in a robot.

    Args:
        robot: The nominal robot.
        springs: Names of the springs to identify ("joint_3", "joint_3.rx"); left out: every spring of the robot,
            those in `add` included.
        add: Springs that the robot does not have yet.
        links: Terms of the 6x6 elasticities of links that are free: "diagonal" (6 each), "beam" (diagonal and the four
            couplings of bending, 10 each), "full" (21 each), "scale" (one factor each); None for none.
        geometry: "none", "offsets" (zeros of the joints) or "all" (place and direction of every joint too).

    Raises:
        InputError: If there is nothing to identify, or a choice does not exist.
    """
    if links is not None and links not in LINK_TERMS:
        raise UnknownNameError("choice of link terms", links, list(LINK_TERMS))
    if geometry not in GEOMETRY:
        raise UnknownNameError("choice of geometry", geometry, list(GEOMETRY))
    elastic = replace(robot, springs=(*robot.springs, *add))
    present = _count_twins([label_spring(spring) for spring in elastic.springs])
    wanted = present if springs is None else list(springs)
    for name in wanted:
        if name not in present:
            raise UnknownNameError("spring", name, present)
    geometric = _geometry_springs(robot, geometry)
    extended = replace(elastic, springs=(*elastic.springs, *geometric))
    spring_index, link_index = _coordinates(extended)
    free: list[Parameter] = []
    for name, spring, index in zip(present, elastic.springs, spring_index, strict=False):
        if name in wanted:
            unit = "m/N" if _slides(robot, spring) else "rad/(N m)"
            size = spring.compliance or TYPICAL_SIZE[unit]
            kind = "joint" if _is_own(robot, spring) else "spring"
            free.append(Parameter(name, kind, unit, spring.compliance, size, ((index, index, 1.0),)))
    if links is not None:
        if -1 in link_index:
            raise InputError("the elasticity of the base link cannot be identified; give its joint springs")
        names = _count_twins([block.link for block in elastic.link_elasticities])
        for name, block, first in zip(names, elastic.link_elasticities, link_index, strict=True):
            free.extend(_link_parameters(name, block, first, links))
    for spring, index in zip(geometric, spring_index[len(elastic.springs) :], strict=True):
        unit = "m" if _slides(robot, spring) else "rad"
        free.append(Parameter(_geometry_name(spring), "geometry", unit, 0.0, TYPICAL_SIZE[unit], shift=index))
    labels = (*present, *("" for _ in geometric))
    return FreeRobot(extended, build_chain(extended), tuple(free), labels, tuple(link_index))


def own_springs(robot: Robot) -> tuple[Spring, ...]:
    """List a spring of compliance zero about (or along) the own axis of every commanded joint that has none yet."""
    own = [spring for spring in robot.springs if _is_own(robot, spring)]
    taken = {spring.joint for spring in own if spring.actuator or spring.axis != "own"}
    return tuple(Spring(joint.name, "own", 0.0, actuator=True) for joint in robot.actuated if joint.name not in taken)


def label_spring(spring: Spring) -> str:
    """Name a spring; one about a joint's own axis that the link-side encoder does not see is "joint_3.link"."""
    return f"{spring.joint}.link" if spring.axis == "own" and not spring.actuator else spring.name


def link_springs(robot: Robot) -> tuple[Spring, ...]:
    """List an own-axis spring of compliance zero beyond each joint's link-side encoder [Klimchik2018, eq. 5]."""
    taken = {spring.joint for spring in robot.springs if _is_own(robot, spring) and not spring.actuator}
    return tuple(Spring(j.name, "own", 0.0, actuator=False) for j in robot.actuated if j.name not in taken)


def candidate_springs(robot: Robot, axes: Sequence[str] = ("rx", "ry", "rz")) -> tuple[Spring, ...]:
    """List springs that a robot does not have: about each axis of every moving joint's frame, and at the base.

    Args:
        robot: The robot.
        axes: Axes of the child frame to offer; the joint's own axis is left out where the joint has an own spring.
    """
    taken = {(spring.joint, spring.axis) for spring in robot.springs}
    own = {spring.joint for spring in robot.springs if _is_own(robot, spring)}
    found: list[Spring] = []
    first = robot.joints[0]
    for joint in robot.joints:
        if joint.kind == "fixed" and joint is not first:
            continue
        for axis in axes:
            along = _own_axis_name(robot, joint.name)
            if (joint.name, axis) in taken or (axis == along and joint.name in own):
                continue
            found.append(Spring(joint.name, axis, 0.0, actuator=axis == along))
    return tuple(found)


def _is_own(robot: Robot, spring: Spring) -> bool:
    return spring.axis == "own" or spring.axis == _own_axis_name(robot, spring.joint)


def _own_axis_name(robot: Robot, name: str) -> str | None:
    joint = next(joint for joint in robot.joints if joint.name == name)
    if joint.kind == "fixed":
        return None
    k = int(np.argmax(np.abs(joint.axis)))
    return ("t" if joint.kind == "prismatic" else "r") + "xyz"[k] if abs(joint.axis[k]) > 1 - 1e-9 else None


def _slides(robot: Robot, spring: Spring) -> bool:
    if spring.axis == "own":
        return next(joint for joint in robot.joints if joint.name == spring.joint).kind == "prismatic"
    return spring.axis.startswith("t")


def _count_twins(names: Sequence[str]) -> list[str]:
    """Tell names apart that occur more than once: link_2, link_2 -> link_2#1, link_2#2."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(f"{name}#{seen[name]}" if names.count(name) > 1 else name)
    return result


def _coordinates(robot: Robot) -> tuple[list[int], list[int]]:
    """Find the elastic coordinate of each spring and the first one of each link block, as `build_chain` counts."""
    spring_index, link_index = [-1] * len(robot.springs), [-1] * len(robot.link_elasticities)
    count = 0
    for joint in robot.joints:
        for k, spring in enumerate(robot.springs):
            if spring.joint == joint.name:
                spring_index[k], count = count, count + 1
        for k, block in enumerate(robot.link_elasticities):
            if block.link == joint.child:
                link_index[k], count = count, count + 6
    return spring_index, link_index


def _link_parameters(name: str, block: LinkElasticity, first: int, terms: str) -> list[Parameter]:
    matrix = block.compliance
    if terms == "scale":
        upper = [(i, j) for i in range(6) for j in range(i, 6) if matrix[i, j] != 0]
        entries = tuple((first + i, first + j, float(matrix[i, j])) for i, j in upper)
        return [Parameter(f"{name}.scale", "link", "1", 1.0, 1.0, entries)]
    pairs = [(i, i) for i in range(6)]
    if terms == "beam":
        # Bending couples a deflection across the beam with a rotation about the other cross axis: tx*ry, ty*rx and kin.
        coupled = [(i, j) for i in range(3) for j in range(3, 6) if j - 3 != i]
        pairs += [pair for pair in coupled if matrix[pair] != 0] or coupled
    elif terms == "full":
        pairs = [(i, j) for i in range(6) for j in range(i, 6)]
    found = []
    for i, j in pairs:
        unit = ("m/N", "rad/N", "rad/(N m)")[(i >= 3) + (j >= 3)]
        label = AXES[i] if i == j else f"{AXES[i]}*{AXES[j]}"
        size = abs(matrix[i, j]) or float(np.sqrt(matrix[i, i] * matrix[j, j])) or TYPICAL_SIZE[unit]
        entries = ((first + i, first + j, 1.0),)
        found.append(Parameter(f"{name}.{label}", "link", unit, float(matrix[i, j]), size, entries))
    return found


def _geometry_springs(robot: Robot, geometry: str) -> list[Spring]:
    """Place rigid elements whose constant coordinates stand for joint zeros and the origin of the next joint."""
    if geometry == "none":
        return []
    found = [Spring(joint.name, "own", 0.0) for joint in robot.actuated]
    if geometry == "all":
        for before, joint in zip(robot.joints, robot.joints[1:], strict=False):
            if joint.kind != "fixed" and joint is not robot.actuated[0]:
                found.extend(Spring(before.name, axis, 0.0, offset=joint.placement[:3, 3].copy()) for axis in AXES)
    return found


def _geometry_name(spring: Spring) -> str:
    return f"{spring.joint}.offset" if spring.axis == "own" else f"{spring.joint}.end.{spring.axis}"
