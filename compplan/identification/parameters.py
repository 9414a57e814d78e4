"""What is identified: one vector of named numbers - springs, terms of links' 6x6, and whatever effects have parameters.

A spring's compliance and a link's terms enter linearly, C(p) = C_nominal + sum_k (p_k - nominal_k) E_k; everything else
is an effect of the vocabulary, geometry among them, and enters through its own exact forward model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compplan.effects import Effect, robot_effects
from compplan.effects.forward_model import link_coordinates, spring_coordinates
from compplan.effects.signature import Signature
from compplan.errors import InputError, UnknownNameError
from compplan.robot import Array, LinkElasticity, Robot, Spring
from compplan.robot.springs import is_own, label_spring, number_twins, spring_slides
from compplan.statics.chain import Chain, build_chain

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
LINK_TERMS = ("diagonal", "beam", "full", "scale")
Entry = tuple[int, int, float]

#: Typical sizes by what a parameter does: the yardstick for "cannot be told at all" where the nominal value is zero.
#: Assumed from robots of the literature: 1e-6 rad/(N m), 1e-8 m/N, and their geometric mean between them.
TYPICAL_SIZE = {"rad/(N m)": 1e-6, "m/N": 1e-8, "rad/N": 1e-7, "1": 1.0, "m": 1e-3, "rad": 1e-3}


@dataclass(frozen=True)
class Parameter:
    """One number to identify."""

    name: str  #: "joint_3" (own axis), "joint_3.rx", "link_2.tx*ry" (off-diagonal), "joint_3.offset", "base.tx", ...
    #: "joint" (a spring about or along a joint's own axis), "spring" (any other), "link", "geometry", "effect", "base"
    #: or "tool".
    kind: str
    unit: str  #: rad/(N m), m/N, rad/N, m, rad, 1 for a factor, or that of an effect's key.
    nominal: float  #: Value in the model before. [unit]
    size: float  #: Typical size, by which near-singular directions are judged. [unit]
    spring: int = -1  #: Number of its spring in the structure's robot, or -1.
    link: int = -1  #: Number of its link elasticity in the structure's robot, or -1.
    terms: tuple[Entry, ...] = ()  #: Entries (i, j, coefficient) of that link's 6x6, i <= j.
    form: Signature | None = None  #: Signature of its effect, without motions, or None.
    item: int = 0  #: Which of the signature's parameters it is.

    def entries(self, robot: Robot) -> list[Entry]:
        """List the entries (i, j, coefficient) of the elastic coordinates' compliance that it moves, i <= j."""
        if self.spring >= 0:
            own = spring_coordinates(robot)[self.spring]
            return [(own, own, 1.0)]
        first = link_coordinates(robot)[self.link] if self.link >= 0 else 0
        return [(first + i, first + j, coefficient) for i, j, coefficient in self.terms]


@dataclass(frozen=True)
class FreeRobot:
    """A robot and the parameters that are free in it."""

    robot: Robot  #: The robot, with a spring of compliance zero where one is to be identified.
    parameters: tuple[Parameter, ...]  #: The parameters. Length p.
    spring_labels: tuple[str, ...]  #: Name of each spring of `robot`.

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nominal(self) -> Array:
        """Values in the model before. Shape (p,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    @cached_property
    def chain(self) -> Chain:
        """Elastic chain of the robot."""
        return build_chain(self.robot)

    @cached_property
    def known(self) -> tuple[Effect, ...]:
        """Effects of the robot's folder, which stay as they are."""
        return robot_effects(self.robot)

    @property
    def forms(self) -> tuple[Signature, ...]:
        """Signatures of the effects that have parameters here."""
        found = {p.form.column_names: p.form for p in self.parameters if p.form is not None}
        return tuple(found.values())

    def soften(self, values: Array) -> Robot:
        """Return the robot with the compliances of some values, below zero too."""
        springs, links = list(self.robot.springs), list(self.robot.link_elasticities)
        for parameter, value in zip(self.parameters, values, strict=True):
            if parameter.spring >= 0:
                springs[parameter.spring] = replace(springs[parameter.spring], compliance=float(value))
            elif parameter.link >= 0:
                matrix = links[parameter.link].compliance.copy()
                for i, j, coefficient in parameter.terms:
                    matrix[[i, j], [j, i]] += coefficient * (value - parameter.nominal)
                links[parameter.link] = replace(links[parameter.link], compliance=matrix)
        return replace(self.robot, springs=tuple(springs), link_elasticities=tuple(links))

    def effects(self, values: Array) -> list[Effect]:
        """Return the effects with some values."""
        found = []
        for form in self.forms:
            own = np.zeros(len(form.keys))
            for parameter, value in zip(self.parameters, values, strict=True):
                if parameter.form is not None and parameter.form.column_names == form.column_names:
                    own[parameter.item] = value
            found.append(form.effect(own))
        return found

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
    forms: Sequence[Signature] = (),
) -> FreeRobot:
    """Choose what is free in a robot.

    Args:
        robot: The nominal robot.
        springs: Names of the springs to identify ("joint_3", "joint_3.rx"); left out: every spring of the robot,
            those in `add` included.
        add: Springs that the robot does not have yet.
        links: Terms of the 6x6 elasticities of links that are free: "diagonal" (6 each), "beam" (diagonal and the four
            couplings of bending, 10 each), "full" (21 each), "scale" (one factor each); None for none.
        forms: Signatures of effects whose parameters are free (`geometry_forms`, `effect_forms`).

    Raises:
        InputError: If there is nothing to identify, or a choice does not exist.
    """
    if links is not None and links not in LINK_TERMS:
        raise UnknownNameError("choice of link terms", links, list(LINK_TERMS))
    elastic = replace(robot, springs=(*robot.springs, *add))
    present = number_twins([label_spring(spring) for spring in elastic.springs])
    wanted = present if springs is None else list(springs)
    for name in wanted:
        if name not in present:
            raise UnknownNameError("spring", name, present)
    free: list[Parameter] = []
    for number, (name, spring) in enumerate(zip(present, elastic.springs, strict=True)):
        if name in wanted:
            unit = "m/N" if spring_slides(robot, spring) else "rad/(N m)"
            size = spring.compliance or TYPICAL_SIZE[unit]
            kind = "joint" if is_own(robot, spring) else "spring"
            free.append(Parameter(name, kind, unit, spring.compliance, size, spring=number))
    if links is not None:
        if -1 in link_coordinates(elastic):
            raise InputError("the elasticity of the base link cannot be identified; give its joint springs")
        names = number_twins([block.link for block in elastic.link_elasticities])
        for number, (name, block) in enumerate(zip(names, elastic.link_elasticities, strict=True)):
            free.extend(_link_parameters(name, number, block, links))
    bare = [form.without_motion() for form in forms]
    free += [_effect_parameter(robot, form, k) for form in bare for k in range(len(form.keys))]
    return FreeRobot(elastic, tuple(free), tuple(present))


def _link_parameters(name: str, number: int, block: LinkElasticity, terms: str) -> list[Parameter]:
    matrix = block.compliance
    if terms == "scale":
        upper = tuple((i, j, float(matrix[i, j])) for i in range(6) for j in range(i, 6) if matrix[i, j] != 0)
        return [Parameter(f"{name}.scale", "link", "1", 1.0, 1.0, link=number, terms=upper)]
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
        own = ((i, j, 1.0),)
        found.append(Parameter(f"{name}.{label}", "link", unit, float(matrix[i, j]), size, link=number, terms=own))
    return found


def _effect_parameter(robot: Robot, form: Signature, item: int) -> Parameter:
    """Name a parameter of an effect; zeros and origins have names of their own."""
    key = form.keys[item]
    unit = key.partition("#")[0].rpartition("_")[2].replace("ratio", "1")
    if form.name == "joint_offset":
        return Parameter(f"{form.joint}.offset", "geometry", unit, 0.0, TYPICAL_SIZE[unit], form=form, item=item)
    if form.name == "link_geometry":
        names = [joint.name for joint in robot.joints]
        name = f"{names[names.index(str(form.joint)) - 1]}.end.{form.axis}"
        return Parameter(name, "geometry", unit, 0.0, TYPICAL_SIZE[unit], form=form, item=item)
    place = ".".join(part for part in (form.joint, form.axis) if part)
    name = f"{form.name}@{place}" if place else form.name
    label = f"{name} {key}" if len(form.keys) > 1 else name
    return Parameter(label, "effect", unit, 0.0, float(form.scale[item]), form=form, item=item)
