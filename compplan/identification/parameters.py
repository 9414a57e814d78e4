"""Parameters to identify: one vector of named numbers, springs and parameters of effects.

A spring's compliance enters linearly. All other parameters, geometry included, belong to effects and enter through the
exact forward model of their effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compplan.effects import Effect, robot_effects
from compplan.effects.forward_model import spring_coordinates
from compplan.effects.signature import Signature
from compplan.errors import UnknownNameError
from compplan.robot import Array, Robot, Spring
from compplan.robot.springs import is_own, label_spring, number_twins
from compplan.statics.chain import Chain, build_chain

#: Typical sizes by unit: scale for identifiability where the nominal value is zero (assumed from robots of the
#: literature: 1e-6 rad/(N m), 1e-8 m/N).
TYPICAL_SIZE = {"rad/(N m)": 1e-6, "m/N": 1e-8, "1": 1.0, "m": 1e-3, "rad": 1e-3}


@dataclass(frozen=True)
class Parameter:
    """One number to identify."""

    name: str  #: "joint_3" (own axis), "joint_3.rx", "joint_3.offset", "base.tx", ...
    #: "joint" (a spring about or along a joint's axis), "spring" (any other), "geometry", "effect", "base", "tool" or
    #: "contact".
    kind: str
    unit: str  #: rad/(N m), m/N, m, rad, 1 for a factor, or the unit of an effect's key.
    nominal: float  #: Value in the original model. [unit]
    size: float  #: Typical size, the scale for near-singular directions. [unit]
    spring: int = -1  #: Index of its spring in the structure's robot, or -1.
    form: Signature | None = None  #: Signature of its effect, without motions, or None.
    item: int = 0  #: Index among the signature's parameters.

    def coordinate(self, robot: Robot) -> int:
        """Return the index of the elastic coordinate with this compliance, -1 for none."""
        return spring_coordinates(robot)[self.spring] if self.spring >= 0 else -1


@dataclass(frozen=True)
class FreeRobot:
    """A robot with free parameters."""

    robot: Robot  #: The robot, with a spring of zero compliance where one is to be identified.
    parameters: tuple[Parameter, ...]  #: The parameters. Length p.
    spring_labels: tuple[str, ...]  #: Name of each spring of `robot`.

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def nominal(self) -> Array:
        """Values in the original model. Shape (p,)."""
        return np.array([parameter.nominal for parameter in self.parameters])

    @cached_property
    def chain(self) -> Chain:
        """Elastic chain of the robot."""
        return build_chain(self.robot)

    @cached_property
    def known(self) -> tuple[Effect, ...]:
        """Effects of the robot folder, which are held."""
        return robot_effects(self.robot)

    @property
    def forms(self) -> tuple[Signature, ...]:
        """Signatures of the effects with free parameters."""
        found = {p.form.column_names: p.form for p in self.parameters if p.form is not None}
        return tuple(found.values())

    def set_compliances(self, values: Array) -> Robot:
        """Return the robot with given compliances, which may be negative."""
        springs = list(self.robot.springs)
        for parameter, value in zip(self.parameters, values, strict=True):
            if parameter.spring >= 0:
                springs[parameter.spring] = replace(springs[parameter.spring], compliance=float(value))
        return replace(self.robot, springs=tuple(springs))

    def effects(self, values: Array) -> list[Effect]:
        """Return the effects with given values."""
        found = []
        for form in self.forms:
            sizes = np.zeros(len(form.keys))
            for parameter, value in zip(self.parameters, values, strict=True):
                if parameter.form is not None and parameter.form.column_names == form.column_names:
                    sizes[parameter.item] = value
            found.append(form.effect(sizes))
        return found

    def select(self, keep: Iterable[str]) -> FreeRobot:
        """Keep the named parameters free; the others are held at their nominal values."""
        requested = set(keep)
        return replace(self, parameters=tuple(p for p in self.parameters if p.name in requested))


def build_structure(
    robot: Robot,
    *,
    springs: Sequence[str] | None = None,
    add: Sequence[Spring] = (),
    forms: Sequence[Signature] = (),
) -> FreeRobot:
    """Select the free parameters of a robot.

    Args:
        robot: The nominal robot.
        springs: Names of the springs to identify ("joint_3", "joint_3.rx"); by default every spring of the robot and
            of `add`.
        add: Springs that the robot does not have yet.
        forms: Signatures of effects whose parameters are free (`geometry_forms`, `effect_forms`).

    Raises:
        UnknownNameError: If a spring does not exist.
    """
    elastic = replace(robot, springs=(*robot.springs, *add))
    present = number_twins([label_spring(spring) for spring in elastic.springs])
    requested = present if springs is None else list(springs)
    for name in requested:
        if name not in present:
            raise UnknownNameError("spring", name, present)
    free, sliding = list[Parameter](), {joint.name for joint in robot.joints if joint.kind == "prismatic"}
    for number, (name, spring) in enumerate(zip(present, elastic.springs, strict=True)):
        if name in requested:
            slides = spring.axis.startswith("t") or (spring.axis == "own" and spring.joint in sliding)
            unit = "m/N" if slides else "rad/(N m)"
            size = spring.compliance or TYPICAL_SIZE[unit]
            kind = "joint" if is_own(robot, spring) else "spring"
            free.append(Parameter(name, kind, unit, spring.compliance, size, spring=number))
    bare = [form.without_motion() for form in forms]
    free += [_effect_parameter(robot, form, k) for form in bare for k in range(len(form.keys))]
    return FreeRobot(elastic, tuple(free), tuple(present))


def _effect_parameter(robot: Robot, form: Signature, item: int) -> Parameter:
    """Build a parameter of an effect; zeros and origins have short names."""
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
