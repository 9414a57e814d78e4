"""Joint, configuration and tool conventions of a maker, derived from the geometry of a six-axis arm.

Zero posture and senses of the axes are stated by maker, in axes of the arm: x forward, y left, z up along axis 1.
Zeros and senses of the URDF follow from its geometry. The result is a proposal: compare it with the display.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from compplan.robot.model import Array, Joint
from compplan.robot.pose import follow_joints

#: Rounding of a URDF: greatest angle [deg] and distance [m].
ANGLE, DISTANCE = 1.0, 1e-3
#: Least horizontal offset that determines the forward direction. [m]
SHORTEST = 5e-3
#: Axes of the arm's frame, by name.
DIRECTIONS = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}


@dataclass(frozen=True)
class Brand:
    """The convention of a maker, a section of makers.toml."""

    joint_names: Sequence[str]  #: Names of the joints on the display.
    #: Direction of each axis in the zero posture; None if the controller has the joint positions of the URDF.
    senses: Sequence[str] | None = None
    upper: str = "z"  #: Direction of the upper arm in the zero posture.
    forearm: str = "x"  #: Direction of the forearm there.
    pendant_x: str = "x"  #: Direction of x of the flange frame (tool 0) there.
    coupled: bool = False  #: Whether position 3 is the angle of the forearm to the horizontal.
    raised: bool = False  #: Whether frames have their origin at the height of axis 2.
    #: Lines of each configuration word in terms of the controller.
    words: Mapping[str, str] = field(default_factory=dict)


def _load_makers() -> dict[str, tuple[str, Brand]]:
    """Return name in controller.toml and convention of each controller in makers.toml."""
    makers = tomllib.loads(Path(__file__).with_name("makers.toml").read_text(encoding="utf-8"))
    names = {maker: table.pop("controllers") for maker, table in makers.items()}
    brands = {maker: Brand(**table) for maker, table in makers.items()}
    return {key: (name, brands[maker]) for maker in makers for key, name in names[maker].items()}


#: Controllers by the name of the option --controller: name in controller.toml, and the maker's convention.
CONTROLLERS = _load_makers()


@dataclass
class ControllerProposal:
    """Joint convention of a controller, as far as the geometry determines it.

    Attributes:
        joint_names, sign, zero_deg, coupling: Keys of controller.toml.
        world_mm: Origin of the controller's world frame in the base frame; None: the base. [mm]
        words: Lines of each section [configuration.*].
        pendant: x and z of the maker's flange frame in axes of the URDF's flange; None if unknown.
        missing: Items that were not derived, with reasons.
    """

    joint_names: list[str]
    sign: list[int]
    zero_deg: list[float]
    coupling: list[list[float]] | None = None
    world_mm: list[float] | None = None
    words: dict[str, list[str]] = field(default_factory=dict)
    pendant: list[list[float]] | None = None
    missing: list[str] = field(default_factory=list)


class _NotDerivedError(Exception):
    """A step of the derivation does not fit the arm."""


def propose_counting(brand: Brand, joints: Sequence[Joint], flange: str) -> ControllerProposal:
    """Derive the joint convention of a maker's controller for an arm.

    Args:
        brand: The maker's convention.
        joints: The chain from the base to the TCP; z of its last frame points out of the tool.
        flange: Frame of the chain that tools are mounted on.
    """
    moving = [joint for joint in joints if joint.actuated]
    count = len(moving)
    proposal = ControllerProposal([f"J{k}" for k in range(1, count + 1)], [1] * count, [0.0] * count)
    slides = [joint.kind == "prismatic" for joint in moving]
    rail = count - 6
    if rail < 0 or any(slides[rail:]) or not all(slides[:rail]) or any(joint.mimic is not None for joint in joints):
        proposal.missing.append("signs, zeros and configuration words: only arms with six rotating axes are supported")
        return proposal
    proposal.joint_names = [*(f"E{k}" for k in range(1, rail + 1)), *brand.joint_names]
    if brand.senses is None:
        return proposal
    arm = _Arm(joints, moving[rail:])
    steps = (("signs and zeros", _propose_signs), ("configuration words", _propose_words),
             ("flange frame of the pendant", _propose_pendant))  # fmt: skip
    try:
        arm.find_axes(DIRECTIONS[brand.senses[1]][1])
    except _NotDerivedError as error:
        proposal.missing.append(f"signs, zeros and configuration words: {error}")
        return proposal
    for name, step in steps:
        try:
            step(proposal, arm, brand, rail, flange)
        except _NotDerivedError as error:
            proposal.missing.append(f"{name}: {error}")
    return proposal


class _Arm:
    """The geometry of an arm at its URDF zero."""

    def __init__(self, joints: Sequence[Joint], arm: Sequence[Joint]) -> None:
        self.joints, self.arm = joints, arm
        self.poses = self.locate({})

    def locate(self, q: Mapping[str, float]) -> dict[str, Array]:
        """Return the pose of each link at joint positions that default to 0. [rad]"""
        return follow_joints(self.joints[0].parent, self.joints, q)

    def axis(self, k: int, poses: Mapping[str, Array] | None = None) -> Array:
        """Return the direction of an axis, 1 to 6. Shape (3,)."""
        joint = self.arm[k - 1]
        return np.asarray((poses or self.poses)[joint.child][:3, :3] @ joint.axis)

    def origin(self, k: int) -> Array:
        """Return a point of an axis, 1 to 6, at the URDF zero. Shape (3,). [m]"""
        return np.asarray(self.poses[self.arm[k - 1].child][:3, 3])

    def find_axes(self, sense: int) -> None:
        """Find the frame of the arm (columns forward, left, up), its wrist centre and the senses of axes 2 and 3.

        Args:
            sense: Sense of the maker's axis 2, for arms without any horizontal offset.
        """
        first, second = self.axis(1), self.axis(2)
        up = first if first[2] > 0.0 else -first
        if abs(first @ second) > np.sin(np.radians(ANGLE)) or not _are_parallel(second, self.axis(3)):
            raise _NotDerivedError("axis 2 is not level or not parallel to axis 3")
        between = np.cross(self.axis(4), self.axis(5))
        if np.linalg.norm(between) < 0.5:
            raise _NotDerivedError("axes 4 and 5 do not cross")
        gap = self.origin(5) - self.origin(4)
        along = np.linalg.solve(np.column_stack([self.axis(4), -self.axis(5), between]), gap)
        self.wrist = self.origin(5) + along[1] * self.axis(5)
        self.spherical = abs(along[2]) * np.linalg.norm(between) < DISTANCE
        self.spherical &= np.linalg.norm(np.cross(self.axis(6), self.wrist - self.origin(6))) < DISTANCE
        forward = sense * np.cross(second, up)
        for point in (self.origin(2), self.wrist):
            offset = point - self.origin(1)
            offset = offset - up * (up @ offset) - second * (second @ offset)
            if np.linalg.norm(offset) > SHORTEST:
                forward = offset / np.linalg.norm(offset)
                break
        self.frame = np.column_stack([forward, np.cross(up, forward), up])

    @property
    def left(self) -> Array:
        """Direction to the left, parallel to axes 2 and 3."""
        return np.asarray(self.frame[:, 1])

    def turn(self, start: Array, end: Array) -> float:
        """Return the angle from one direction to another about the axis to the left. [deg]"""
        flat = [v - self.left * (self.left @ v) for v in (start, end)]
        if min(np.linalg.norm(flat[0]), np.linalg.norm(flat[1])) < DISTANCE:
            raise _NotDerivedError("upper arm or forearm has no length")
        return float(np.degrees(np.arctan2(self.left @ np.cross(flat[0], flat[1]), flat[0] @ flat[1])))


def _propose_signs(proposal: ControllerProposal, arm: _Arm, brand: Brand, rail: int, flange: str) -> None:
    """Compare the URDF's zero posture and senses with the maker's."""
    assert brand.senses is not None
    senses = [arm.frame @ np.array(DIRECTIONS[name], float) for name in brand.senses]
    upper = arm.turn(arm.frame @ np.array(DIRECTIONS[brand.upper], float), arm.origin(3) - arm.origin(2))
    along = arm.axis(4) * np.sign(arm.axis(4) @ (arm.wrist - arm.origin(3)))
    lower = arm.turn(arm.frame @ np.array(DIRECTIONS[brand.forearm], float), along)
    zero: dict[int, float] = {}  # axes 2 and 3 at q = 0, about the axis to the left, multiples of 90 [deg]
    for k, angle in ((2, upper), (3, lower - upper)):
        zero[k] = 90.0 * round(angle / 90.0)
        if abs(angle - zero[k]) > ANGLE:
            raise _NotDerivedError(f"an arm lies {angle:.3g} deg from the maker's zero posture at the URDF's zero")
    at_zero = {arm.arm[k - 1].name: -np.radians(zero[k]) * np.sign(arm.axis(k) @ arm.left) for k in (2, 3)}
    poses = arm.locate(at_zero)
    for k in range(1, 7):
        axis = arm.axis(k, poses)
        if not _are_parallel(axis, senses[k - 1]):
            raise _NotDerivedError(f"axis {k} does not lie as in the maker's zero posture")
        proposal.sign[rail + k - 1] = int(np.sign(axis @ senses[k - 1]))
    for k in (2, 3):
        proposal.zero_deg[rail + k - 1] = _wrap(zero[k] * float(np.sign(senses[k - 1] @ arm.left)))
    if brand.coupled:
        count = rail + 6
        proposal.coupling = [[0.0] * count for _ in range(count)]
        proposal.coupling[rail + 2][rail + 1] = -float(proposal.sign[rail + 1])
        proposal.zero_deg[rail + 2] = _wrap(proposal.zero_deg[rail + 2] - proposal.zero_deg[rail + 1])
    if brand.raised:
        up = arm.frame[:, 2]
        foot = arm.origin(1) + up * (up @ (arm.origin(2) - arm.origin(1)))
        proposal.world_mm = [round(1e3 * float(value), 3) + 0.0 for value in foot]


def _propose_words(proposal: ControllerProposal, arm: _Arm, brand: Brand, rail: int, flange: str) -> None:
    """Derive the words that distinguish the branches of the inverse kinematics."""
    if not arm.spherical:
        raise _NotDerivedError("the axes of the wrist do not meet in a point")
    points = [joint.child for joint in arm.arm[3:] if np.linalg.norm(
        arm.poses[joint.child][:3, 3] - arm.wrist) < DISTANCE]  # fmt: skip
    if not points:
        raise _NotDerivedError("no link has its origin in the wrist centre")
    frame = arm.arm[0].child
    seen = arm.poses[frame][:3, :3].T @ arm.frame[:, 0]
    k = int(np.abs(seen).argmax())
    if abs(seen[k]) < np.cos(np.radians(ANGLE)):
        raise _NotDerivedError(f"no axis of {frame!r} points forward")
    straight = -arm.turn(arm.origin(3) - arm.origin(2), arm.wrist - arm.origin(3))
    third, fifth = (float(np.sign(arm.axis(number) @ arm.left)) for number in (3, 5))
    threshold = _wrap(round(straight * third, 6))
    words = {
        "shoulder": (seen[k], ("front", "back"), [f'point         = "{points[0]}"', f'frame         = "{frame}"',
                     f'axis          = "{"xyz"[k]}"', "threshold_mm  = 0.0"]),
        "elbow": (third, ("up", "down"), [f'joint         = "{arm.arm[2].name}"', f"threshold_deg = {threshold:.9g}"]),
        "wrist": (fifth, ("noflip", "flip"), [f'joint         = "{arm.arm[4].name}"', "threshold_deg = 0.0"]),
    }  # fmt: skip
    for key, (sign, (above, below), lines) in words.items():
        above, below = (above, below) if sign > 0.0 else (below, above)
        own = [brand.words[key]] if key in brand.words else []
        proposal.words[key] = [*lines, f'above         = "{above}"', f'below         = "{below}"', *own]


def _propose_pendant(proposal: ControllerProposal, arm: _Arm, brand: Brand, rail: int, flange: str) -> None:
    """Find the maker's flange frame: z out of the flange, x as in the zero posture."""
    if any(text.startswith("signs") for text in proposal.missing):
        raise _NotDerivedError("the zero posture is not known")
    angles = np.radians(proposal.zero_deg[rail:])
    if proposal.coupling is not None:
        angles[2] += angles[1]
    q = {arm.arm[k].name: -float(angles[k]) * proposal.sign[rail + k] for k in (1, 2)}
    poses = arm.locate(q)
    out, x = poses[arm.joints[-1].child][:3, 2], arm.frame @ np.array(DIRECTIONS[brand.pendant_x], float)
    if not _are_parallel(out, arm.axis(6, poses)) or abs(out @ x) > np.sin(np.radians(ANGLE)):
        raise _NotDerivedError("the tool does not leave the flange along axis 6")
    seen = [poses[flange][:3, :3].T @ v for v in (x - out * (out @ x), out)]
    proposal.pendant = [[round(float(value), 9) + 0.0 for value in v / np.linalg.norm(v)] for v in seen]


def _are_parallel(one: Array, other: Array) -> bool:
    return abs(float(one @ other)) > np.cos(np.radians(ANGLE))


def _wrap(angle: float) -> float:
    """Return an angle between -180 (exclusive) and 180 degrees."""
    return -((-angle + 180.0) % 360.0 - 180.0) + 0.0
