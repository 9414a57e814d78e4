"""elasticity.toml: sections, and checks against the URDF and plausible ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, field_validator, model_validator

from compplan.errors import InputError, UnknownNameError
from compplan.io.tomlfile import Numbers, OneOf, SchemaOne, StrictTable, Vector3
from compplan.robot.model import GRADES, SPRING_AXES, Array, Joint, LinkElasticity, Spring

_ROTATIONS = {
    "z": np.eye(3),
    "x": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "y": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-z": np.diag([1.0, -1, -1]),
}
_ROTATIONS["-x"] = np.diag([-1.0, -1, 1]) @ _ROTATIONS["x"]
_ROTATIONS["-y"] = np.diag([-1.0, -1, 1]) @ _ROTATIONS["y"]


def hollow_beam_compliance(
    length: float, outer_diameter: float, inner_diameter: float, young: float, shear: float, axis: str = "z"
) -> NDArray[np.float64]:
    """Compute the compliance of a cantilevered tube at its free end.

    Euler-Bernoulli, no shear deformation: tip translation L^3/(3EI), tip rotation L/(EI), coupling L^2/(2EI),
    axial L/(EA), torsion L/(G Ip) [Mamedov2018].

    Args:
        length: Length L of the beam, from the clamped end to the free end. [m]
        outer_diameter: Outer diameter. [m]
        inner_diameter: Inner diameter, 0 for a solid bar. [m]
        young: Young's modulus E. [Pa]
        shear: Shear modulus G. [Pa]
        axis: Direction from the clamped to the free end in the free end's frame: x y z -x -y -z.

    Returns:
        Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, axes of the free end's frame. Shape (6, 6).
        [m, rad per N, N m]

    Raises:
        ValueError: If a dimension or a modulus is not positive, or the axis is not known.
    """
    if not (length > 0 and outer_diameter > inner_diameter >= 0 and young > 0 and shear > 0):
        raise ValueError("a beam needs length > 0, outer_diameter > inner_diameter >= 0, young > 0 and shear > 0")
    if axis not in _ROTATIONS:
        raise ValueError(f"no beam axis {axis!r}, choose from {sorted(_ROTATIONS)}")
    area = math.pi / 4 * (outer_diameter**2 - inner_diameter**2)
    inertia = math.pi / 64 * (outer_diameter**4 - inner_diameter**4)
    slope = length / (young * inertia)
    bend, couple = length**2 * slope / 3, length * slope / 2
    compliance = np.diag([bend, bend, length / (young * area), slope, slope, length / (2 * shear * inertia)])
    compliance[0, 4] = compliance[4, 0] = couple
    compliance[1, 3] = compliance[3, 1] = -couple
    rotation = np.kron(np.eye(2), _ROTATIONS[axis])
    return np.asarray(rotation @ compliance @ rotation.T)


#: Greatest plausible compliances: 100 N m/rad and 1 N/mm.
SOFTEST = {"r": 1e-2, "t": 1e-3}
#: Greatest gravity [m/s^2], offset of a spring [m], repeatability [mm] and number of springs or link blocks.
MOST_GRAVITY, FARTHEST, MOST_SCATTER, MOST_SPRINGS = 20.0, 10.0, 10.0, 500
#: Young's and shear modulus: from wood across its grain to diamond. [Pa]
MODULUS = Field(ge=1e7, le=2e12)


def _expect_three(value: object) -> object:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError(f"expected 3 numbers, got {value!r}")
    return value


#: Range of acceleration limits. [rad/s^2, m/s^2]
Acceleration = Annotated[float, Field(ge=1e-3, le=1e6)]
Triple = Annotated[Vector3, BeforeValidator(_expect_three)]


#: Default link share of a joint spring in a folder without elastic links, where one spring models gear, bearings and
#: link (assumed; link-side encoders leave 45 % of the deflection [Klimchik2018], hollow links of
#: 1 to 4 cm wall make 12 to 43 % of it [Mamedov2018]).
LINK_SHARE = 0.4


class SpringTable(StrictTable):
    """[[spring]]: one elastic degree of freedom."""

    joint: str
    axis: str = "own"
    compliance: float = Field(ge=0.0)
    offset: Triple = (0.0, 0.0, 0.0)
    actuator: bool | None = None
    link_share: float | None = Field(default=None, ge=0.0, le=1.0)

    @field_validator("offset")
    @classmethod
    def _check_offset(cls, value: Vector3) -> Vector3:
        if max(map(abs, value)) > FARTHEST:
            raise ValueError(f"is {list(value)}, at most {FARTHEST:g} m; is it in millimetres?")
        return value


class BeamTable(StrictTable):
    """beam of a [[link]]: a tube or bar. m, Pa."""

    length: float = Field(gt=0.0, le=FARTHEST)
    outer_diameter: float = Field(gt=0.0, le=FARTHEST)
    inner_diameter: float = Field(ge=0.0)
    young: float = MODULUS
    shear: float = MODULUS
    axis: Literal["x", "y", "z", "-x", "-y", "-z"] = "z"

    @model_validator(mode="after")
    def _check(self) -> BeamTable:
        if self.inner_diameter >= self.outer_diameter:
            raise ValueError("inner_diameter is not below outer_diameter")
        return self


class LinkTable(StrictTable):
    """[[link]]: the elasticity of a link."""

    link: str
    compliance: Annotated[tuple[Numbers, ...], Field(strict=False)] | None = None
    beam: BeamTable | None = None

    @model_validator(mode="after")
    def _check(self) -> LinkTable:
        if (self.compliance is None) == (self.beam is None):
            raise ValueError("give either compliance (6x6) or beam")
        return self

    def matrix(self) -> Array:
        """Return the 6x6 compliance.

        Raises:
            ValueError: If it is not symmetric, not positive, or implausibly soft.
        """
        if self.beam is not None:
            return hollow_beam_compliance(**self.beam.model_dump())
        rows = self.compliance or ()
        if len(rows) != 6 or any(len(row) != 6 for row in rows):
            raise ValueError("compliance is not a symmetric 6x6 matrix")
        matrix = np.array(rows, dtype=np.float64)
        if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-15):
            raise ValueError("compliance is not a symmetric 6x6 matrix")
        if np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.abs(matrix).max(), 1e-300):
            raise ValueError("compliance has a negative eigenvalue")
        return matrix


class ElasticityTable(StrictTable):
    """elasticity.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    tcp: str = Field(min_length=1)
    flange: str | None = Field(default=None, min_length=1)
    part: str | None = Field(default=None, min_length=1)
    gravity: Triple | None = None
    acceleration_limits: Annotated[tuple[Acceleration, ...], Field(strict=False)] | None = None
    repeatability_mm: float | None = Field(default=None, ge=0.0, le=MOST_SCATTER)
    sources: dict[str, str] = Field(default_factory=dict)
    grade: Annotated[str, OneOf(GRADES)] = "placeholder"
    spring: Annotated[tuple[SpringTable, ...], Field(strict=False, max_length=MOST_SPRINGS)] = ()
    link: Annotated[tuple[LinkTable, ...], Field(strict=False, max_length=MOST_SPRINGS)] = ()

    @field_validator("gravity")
    @classmethod
    def _check_gravity(cls, value: Vector3 | None) -> Vector3 | None:
        if value is not None and np.linalg.norm(value) > MOST_GRAVITY:
            raise ValueError(f"is {list(value)}, at most {MOST_GRAVITY:g} m/s^2; is it in mm/s^2?")
        return value


def build_springs(table: ElasticityTable, joints: Sequence[Joint], file: Path) -> tuple[Spring, ...]:
    """Return the springs of a chain.

    Raises:
        InputError: If a spring names no joint of the chain, has no axis, or is implausibly soft.
    """
    kinds = {joint.name: joint.kind for joint in joints}
    lumped = 0.0 if table.link else LINK_SHARE
    springs = []
    for index, entry in enumerate(table.spring):
        where = f"spring[{index}]"
        if entry.joint not in kinds:
            raise UnknownNameError("joint", entry.joint, list(kinds), file=file, where=f"{where}.joint")
        if entry.axis not in SPRING_AXES:
            raise UnknownNameError("axis", entry.axis, list(SPRING_AXES), file=file, where=f"{where}.axis")
        kind = kinds[entry.joint]
        if entry.axis == "own" and kind == "fixed":
            message = f"fixed joint {entry.joint!r} has no own axis, give tx ty tz rx ry rz"
            raise InputError(message, file=file, where=f"{where}.axis")
        slides = entry.axis[0] == "t" or (entry.axis == "own" and kind == "prismatic")
        check_compliance(entry.compliance, slides=slides, file=file, where=f"{where}.compliance")
        actuator = entry.axis == "own" if entry.actuator is None else entry.actuator
        if entry.link_share is not None and not actuator:
            message = "a spring with actuator = false is not between the encoders; delete link_share"
            raise InputError(message, file=file, where=f"{where}.link_share")
        share = entry.link_share if entry.link_share is not None else lumped if actuator else 0.0
        springs.append(Spring(entry.joint, entry.axis, entry.compliance, np.array(entry.offset), actuator, share))
    return tuple(springs)


def check_compliance(value: float, *, slides: bool, file: Path | None, where: str) -> None:
    """Refuse an implausibly large compliance.

    Args:
        value: The compliance. [rad/(N m), or m/N of a translation]
        slides: Whether it is a translation.
        file: File for messages.
        where: Key for messages.

    Raises:
        InputError: If it is not plausible.
    """
    softest, unit = (SOFTEST["t"], "m/N") if slides else (SOFTEST["r"], "rad/(N m)")
    if value > softest:
        hint = "is it a stiffness?" if value > 1e2 else "is an exponent such as e-6 missing?"
        raise InputError(f"compliance {value:g} {unit}, at most {softest:g} {unit}; {hint}", file=file, where=where)


def build_links(table: ElasticityTable, chain_links: Sequence[str], file: Path) -> tuple[LinkElasticity, ...]:
    """Return the elasticities of a chain's links.

    Raises:
        InputError: If a block names no link of the chain, or its compliance is invalid.
    """
    blocks = []
    for index, entry in enumerate(table.link):
        where = f"link[{index}]"
        if entry.link not in chain_links:
            raise UnknownNameError("link", entry.link, list(chain_links), file=file, where=f"{where}.link")
        try:
            matrix = entry.matrix()
        except ValueError as error:
            raise InputError(str(error), file=file, where=f"{where}.compliance") from None
        for row, slides in enumerate((True, True, True, False, False, False)):
            check_compliance(float(matrix[row, row]), slides=slides, file=file, where=f"{where}.compliance")
        blocks.append(LinkElasticity(entry.link, matrix))
    return tuple(blocks)
