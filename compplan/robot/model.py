"""Robot model: URDF chain from base to tool centre point, elasticity, masses.

`compplan.robot.folder` reads and writes it. The base frame is the root link of the URDF; units are SI.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.io.columns import to_unit
from compplan.io.display import Shown
from compplan.robot.uncertainty import Uncertainty

Array = NDArray[np.float64]

SPRING_AXES = ("own", "tx", "ty", "tz", "rx", "ry", "rz")
#: Gravity for the weight of a tool if the model states none. [m/s^2]
STANDARD_GRAVITY = 9.81
#: Greatest difference of joint origins [m] and axes [rad] between two folders of one machine (assumed: a measured
#: geometry differs by millimetres).
SAME_PLACE, SAME_AXIS = 0.05, 0.1
GRADES = ("identified", "literature", "scaled", "placeholder")


@dataclass(frozen=True)
class Mimic:
    """Coupling of a joint to another one: q = multiplier * q_joint + offset [rad or m]."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """One URDF joint of the chain."""

    name: str  #: Name in the URDF.
    kind: str  #: "revolute", "prismatic" or "fixed" ("continuous" becomes revolute with infinite limits).
    parent: str  #: Parent link.
    child: str  #: Child link.
    placement: Array  #: Pose of the joint frame in the parent link's frame. Shape (4, 4). [m]
    axis: Array  #: Unit vector of the motion in the joint frame. Shape (3,).
    lower: float = -np.inf  #: Lower position limit. [rad or m]
    upper: float = np.inf  #: Upper position limit. [rad or m]
    velocity: float = np.inf  #: Velocity limit. [rad/s or m/s]
    effort: float = np.inf  #: Effort limit. [N m or N]
    mimic: Mimic | None = None  #: Coupling to another joint, or None.

    @cached_property
    def actuated(self) -> bool:
        """Return whether the joint is commanded."""
        return self.kind != "fixed" and self.mimic is None


@dataclass(frozen=True)
class Body:
    """Mass that moves with a link, in the link's frame."""

    link: str  #: The link.
    mass: float  #: Its mass. [kg]
    centre: Array  #: Centre of the mass. Shape (3,). [m]
    #: Rotational inertia about the centre; zero if unknown. Shape (3, 3). [kg m^2]
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True)
class Spring:
    """One elastic degree of freedom, after the motion of a joint, in the frame of the joint's child link."""

    joint: str  #: Name of the URDF joint; a fixed joint may carry springs too.
    axis: str  #: "own" for the joint's axis, or tx ty tz rx ry rz of the child frame.
    compliance: float  #: Deflection per load. [rad/(N m), or m/N for a translation]
    #: Origin of the spring in the child frame. Shape (3,). [m]
    offset: Array = field(default_factory=lambda: np.zeros(3))
    actuator: bool = False  #: Whether it lies between the motor-side and the link-side encoder.
    #: Share of an actuator spring's compliance that lies beyond the link-side encoder, in links and bearings, 0 to 1:
    #: neither encoder measures it.
    link_share: float = 0.0

    @property
    def name(self) -> str:
        """Name in reports: the joint, with the axis if it is not the joint axis."""
        return self.joint if self.axis == "own" else f"{self.joint}.{self.axis}"


@dataclass(frozen=True)
class LinkElasticity:
    """The 6x6 elasticity of a link, lumped at its far end.

    The far end is the frame of the chain's next joint before that joint moves (of the last link: its frame).
    Six elementary springs tx ty tz rx ry rz act there in this order, coupled by `compliance`.
    """

    link: str  #: Name of the link.
    #: Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, far-end axes. Shape (6, 6). [m, rad per N, N m]
    compliance: Array


@dataclass(frozen=True, repr=False)
class Robot(Shown):
    """A robot folder in memory."""

    name: str  #: Name of the robot (of the folder).
    urdf: str  #: Text of robot.urdf, kept for drawing and for writing the folder back.
    joints: tuple[Joint, ...]  #: Chain from the base to the TCP, fixed joints included.
    bodies: tuple[Body, ...]  #: Masses of the chain's links, with links fixed to them.
    springs: tuple[Spring, ...]  #: Elastic degrees of freedom.
    link_elasticities: tuple[LinkElasticity, ...]  #: 6x6 elasticities of links.
    base: str  #: URDF root link; its frame is the robot base frame.
    tcp: str  #: Frame of the tool centre point, z out of the tool.
    flange: str  #: Frame on which tools are mounted.
    gravity: Array | None  #: Gravity in base axes, or None if the model has no gravity load. Shape (3,). [m/s^2]
    acceleration_limits: Array  #: One per actuated joint, infinite if unknown. Shape (nq,). [rad/s^2 or m/s^2]
    repeatability: float | None = None  #: One standard deviation, or None. [m]
    sources: Mapping[str, str] = field(default_factory=dict)  #: Sources of the numbers.
    grade: str = "placeholder"  #: Grade of the compliances: identified, literature, scaled or placeholder.
    folder: Path | None = None  #: Source folder, or None.
    #: Entries of effects.toml, one mapping per effect (see `compplan.effects`).
    effects: tuple[Mapping[str, Any], ...] = ()
    #: Masses whose weight acts in a model without gravity load: that of the mounted tool and, negative, that of the
    #: tool at the identification of the springs.
    weights: tuple[Body, ...] = ()
    uncertainty: Uncertainty | None = None  #: Parameter covariance (uncertainty.toml), or None.
    #: Fixed link if a positioner carries the part, or "". The chain then begins at the link that carries the part
    #: (`base`, the reference frame of poses and wrenches), runs through the positioner to this link, in whose axes
    #: gravity is given, and on through the arm.
    ground: str = ""

    def summary(self) -> list[tuple[str, str]]:
        """Return the main facts: joints, positioner, elasticity, gravity, grade."""
        bends = f"{len(self.springs)} springs, {len(self.link_elasticities)} links that bend"
        if not self.springs and not self.link_elasticities:
            bends = "nothing: the model is rigid"
        carries = ", ".join(joint.name for joint in self.actuated[: int(self.carriers.sum())])
        return [
            ("robot", f"{self.name}: {self.nq} joints, model is {self.grade}"),
            *([("positioner", f"{carries} carry the part, link {self.base}; taken as rigid")] if carries else []),
            ("bends", bends),
            ("frames", f"base {self.base}, flange {self.flange}, tcp {self.tcp}"),
            ("weight", "in the model" if self.gravity is not None else "not in the model"),
            *([("effects", ", ".join(sorted({str(e.get("effect")) for e in self.effects})))] if self.effects else []),
            *(("source", f"{name}: {text}") for name, text in list(self.sources.items())[:6]),
        ]

    @property
    def loading_bodies(self) -> tuple[Body, ...]:
        """Masses that load the springs: all if gravity is in the model, otherwise mounted minus earlier tool."""
        return self.weights if self.gravity is None and self.weights else self.bodies

    @property
    def loading_gravity(self) -> Array | None:
        """Gravity that loads the springs, base axes, or None. Shape (3,). [m/s^2]."""
        return self.real_gravity if self.weights else self.gravity

    @property
    def real_gravity(self) -> Array:
        """Gravity of the site: that of the folder, otherwise standard gravity. Shape (3,). [m/s^2]."""
        return np.array([0.0, 0.0, -STANDARD_GRAVITY]) if self.gravity is None else self.gravity

    @cached_property
    def actuated(self) -> tuple[Joint, ...]:
        """List the commanded joints in the order of q: from the fixed link outwards, a positioner's first."""
        carrying = [joint for joint in self.joints[: self.carrying] if joint.actuated]
        return (*carrying[::-1], *(joint for joint in self.joints[self.carrying :] if joint.actuated))

    @cached_property
    def carrying(self) -> int:
        """Count the joints of the chain before the ground, fixed ones included: they carry the part."""
        return next((k for k, joint in enumerate(self.joints, 1) if joint.child == self.ground), 0)

    @property
    def carriers(self) -> NDArray[np.bool_]:
        """Return which commanded joints carry the part. Shape (nq,)."""
        return np.arange(self.nq) < sum(joint.actuated for joint in self.joints[: self.carrying])

    @property
    def arm_limits(self) -> tuple[Array, Array]:
        """Position limits that the arm keeps a margin from; joints that carry the part may reach theirs. [rad or m]"""
        return np.where(self.carriers, -np.inf, self.lower), np.where(self.carriers, np.inf, self.upper)

    def room(self, turn: float) -> Array:
        """Return margins to the limits: `turn` [rad]; 0 for slides and joints that carry the part. Shape (nq,)."""
        return np.where(self.prismatic | self.carriers, 0.0, turn)

    @property
    def alone(self) -> Robot:
        """The robot without its positioner, in the ground frame; its joints are the last ones."""
        if not self.ground:
            return self
        rest, own = self.joints[self.carrying :], ~self.carriers
        return replace(
            self, joints=rest, base=self.ground, ground="", acceleration_limits=self.acceleration_limits[own],
        )  # fmt: skip

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """List the names of the commanded joints, from the base."""
        return tuple(joint.name for joint in self.actuated)

    @property
    def nq(self) -> int:
        """Number of commanded joints."""
        return len(self.actuated)

    @property
    def lower(self) -> Array:
        """Lower position limits. Shape (nq,). [rad or m]"""
        return np.array([joint.lower for joint in self.actuated])

    @property
    def upper(self) -> Array:
        """Upper position limits. Shape (nq,). [rad or m]"""
        return np.array([joint.upper for joint in self.actuated])

    @property
    def velocity_limits(self) -> Array:
        """Velocity limits. Shape (nq,). [rad/s or m/s]"""
        return np.array([joint.velocity for joint in self.actuated])

    @property
    def effort_limits(self) -> Array:
        """Effort limits. Shape (nq,). [N m or N]"""
        return np.array([joint.effort for joint in self.actuated])

    @property
    def joint_headers(self) -> tuple[str, ...]:
        """Names of the joint columns of a table: q1_deg, or q1_mm of a slide."""
        return tuple(f"q{k}_{'mm' if slides else 'deg'}" for k, slides in enumerate(self.prismatic, 1))

    def joint_columns(self, q: Array) -> dict[str, Array]:
        """Return joint positions, shape (n, nq) [rad or m], as the columns of a table."""
        return {header: to_unit(q[:, k], header) for k, header in enumerate(self.joint_headers)}

    @property
    def prismatic(self) -> NDArray[np.bool_]:
        """Return which commanded joints are prismatic. Shape (nq,)."""
        return np.array([joint.kind == "prismatic" for joint in self.actuated])

    def with_tool(
        self, T_flange_tcp: Array, mass: float | None = None, centre: Sequence[float] | Array = (0, 0, 0)
    ) -> Robot:
        """Replace the TCP and the tool's mass.

        A fixed joint from the flange to the new TCP replaces the chain beyond the flange. Without gravity in the model
        the springs were identified under the weight of the old tool: the difference acts.

        Args:
            T_flange_tcp: Pose of the TCP frame in the flange frame. Shape (4, 4). [m]
            mass: Mass of the tool; None if unknown. [kg]
            centre: Centre of the tool's mass in the flange frame. Shape (3,). [m]
        """
        kept: list[Joint] = []
        for joint in self.joints:
            if joint.parent == self.flange:
                break
            kept.append(joint)
        links = {self.base, *(joint.child for joint in kept)}
        tool = Joint(
            "tool_joint", "fixed", self.flange, "tool_tcp", np.array(T_flange_tcp, float), np.array([0.0, 0, 1])
        )
        bodies = tuple(body for body in self.bodies if body.link in links and body.link != self.flange)
        mounted = (Body(self.flange, mass, np.asarray(centre, float)),) if mass else ()
        gone = tuple(replace(body, mass=-body.mass) for body in self.bodies_on_flange())
        weights = (*mounted, *gone) if self.gravity is None and mass is not None else ()
        bodies += mounted
        names, known = {joint.name for joint in kept}, self.uncertainty
        if known is not None:  # the frame of another tool is unknown
            keep = (u.effect != "tool_frame" and (u.joint is None or u.joint in names) for u in known.unknowns)
            known = known.select(keep)
        return replace(
            self,
            joints=(*kept, tool),
            bodies=bodies,
            springs=tuple(spring for spring in self.springs if spring.joint in names),
            link_elasticities=tuple(block for block in self.link_elasticities if block.link in links),
            tcp=tool.child,
            urdf=_urdf_with_tool(self, tool),
            weights=weights,
            uncertainty=known,
        )

    def bodies_on_flange(self) -> tuple[Body, ...]:
        """List the masses on the flange and beyond, in its frame."""
        place = {self.flange: np.eye(4)}
        for joint in self.joints:
            if joint.parent in place:
                place[joint.child] = place[joint.parent] @ joint.placement
        found = ((body, place[body.link]) for body in self.bodies if body.link in place)
        return tuple(Body(self.flange, b.mass, pose[:3, :3] @ b.centre + pose[:3, 3]) for b, pose in found)

    @property
    def longest_reach(self) -> float:
        """Upper bound of the distance of the TCP from the base: links stretched, slides at their ends. [m]"""
        slides = sum(max(abs(joint.lower), abs(joint.upper)) for joint in self.joints if joint.kind == "prismatic")
        return float(sum(np.linalg.norm(joint.placement[:3, 3]) for joint in self.joints) + slides)

    def scale_compliance(self, factor: float) -> Robot:
        """Multiply every compliance (springs and links) by a factor."""
        return replace(
            self,
            springs=tuple(replace(s, compliance=s.compliance * factor) for s in self.springs),
            link_elasticities=tuple(replace(e, compliance=e.compliance * factor) for e in self.link_elasticities),
        )


def roll_pitch_yaw_of(rotation: Array) -> Array:
    """Convert a rotation matrix to URDF's roll, pitch, yaw; yaw is 0 at a pitch of 90 degrees. [rad]"""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        return np.asarray(Rotation.from_matrix(rotation).as_euler("xyz"))


def _urdf_with_tool(robot: Robot, tool: Joint) -> str:
    root = ElementTree.fromstring(robot.urdf)
    for element in (*root.findall(f"link[@name='{tool.child}']"), *root.findall(f"joint[@name='{tool.name}']")):
        root.remove(element)  # an earlier mounted tool
    ElementTree.SubElement(root, "link", name=tool.child)
    joint = ElementTree.SubElement(root, "joint", name=tool.name, type="fixed")
    ElementTree.SubElement(joint, "parent", link=tool.parent)
    ElementTree.SubElement(joint, "child", link=tool.child)
    text = {"xyz": tool.placement[:3, 3], "rpy": roll_pitch_yaw_of(tool.placement[:3, :3])}
    ElementTree.SubElement(joint, "origin", {key: " ".join(repr(float(v)) for v in row) for key, row in text.items()})
    return ElementTree.tostring(root, encoding="unicode")


def is_same_machine(one: Robot, other: Robot) -> bool:
    """Return whether two folders describe one machine: the same joints, at nearly the same places."""
    if one.joint_names != other.joint_names or len(one.joints) != len(other.joints):
        return False
    for a, b in zip(one.joints, other.joints, strict=True):
        gap = np.linalg.inv(a.placement) @ b.placement
        turn = np.arccos(np.clip(0.5 * (np.trace(gap[:3, :3]) - 1.0), -1.0, 1.0))
        if np.linalg.norm(gap[:3, 3]) > SAME_PLACE or turn > SAME_AXIS:
            return False
    return True
