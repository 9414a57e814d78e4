"""Frames of a job: rotations in the conventions of the makers, part frames from measured points.

abc_deg      KUKA A B C: about z, then the new y, then the newest x
wpr_deg      FANUC W P R, Yaskawa Rx Ry Rz: about the fixed x, y, z
quaternion   ABB q1 q2 q3 q4: w x y z
rotation_deg rotation vector
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.robot import Robot
from compplan.robot.pose import build_pose

#: Greatest position [mm] and mass of a tool [kg].
FARTHEST_MM, HEAVIEST_KG = 1e6, 1e4
#: Greatest length of a file path.
LONGEST_PATH = 1000
#: Rounding of a quaternion's length.
QUATERNION_ROUNDING = 1e-3
#: Least size of a triangle of measured points, as the sine of an angle, and least distance of two [mm].
FLATTEST, NEAREST_MM = 1e-3, 1.0
#: Euler sequences of each form in scipy's notation: capitals intrinsic, small letters extrinsic.
ANGLES = {"abc_deg": "ZYX", "wpr_deg": "xyz"}
#: Keys of a rotation.
ROTATIONS = ("rotation_deg", "quaternion", *ANGLES)


def make_pose(position_mm: Sequence[float], rotation: Rotation) -> Array:
    """Return the pose of a frame from its origin [mm] and its rotation. Shape (4, 4) [m]."""
    return build_pose(np.asarray(position_mm) * 1e-3, rotation.as_matrix())


Coordinate = Annotated[float, Field(ge=-FARTHEST_MM, le=FARTHEST_MM)]
Place = Annotated[tuple[Coordinate, Coordinate, Coordinate], Field(strict=False)]
Places = Annotated[tuple[Place, ...], Field(strict=False)]
Quaternion = Annotated[tuple[float, float, float, float], Field(strict=False)]


class PoseTable(StrictTable):
    """A frame: X Y Z in mm, and its rotation in one of the forms above (default: none)."""

    position_mm: Place = (0.0, 0.0, 0.0)
    rotation_deg: Place | None = None
    quaternion: Quaternion | None = None
    abc_deg: Place | None = None
    wpr_deg: Place | None = None

    @model_validator(mode="after")
    def _check_rotation(self) -> PoseTable:
        given = [key for key in ROTATIONS if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"states its rotation in {len(given)} forms ({', '.join(given)}), expected one")
        if self.quaternion is not None and abs(np.linalg.norm(self.quaternion) - 1.0) > QUATERNION_ROUNDING:
            size = float(np.linalg.norm(self.quaternion))
            raise ValueError(f"has a quaternion of length {size:.4g}, expected w, x, y, z of length 1")
        return self

    @property
    def rotation(self) -> Rotation:
        """The rotation."""
        if self.quaternion is not None:
            w, x, y, z = self.quaternion
            return Rotation.from_quat([x, y, z, w])
        for key, order in ANGLES.items():
            angles = getattr(self, key)
            if angles is not None:
                return Rotation.from_euler(order, angles, degrees=True)
        return Rotation.from_rotvec(np.radians(self.rotation_deg or (0.0, 0.0, 0.0)))

    @property
    def pose(self) -> Array:
        """Pose of the frame. Shape (4, 4) [m]."""
        return make_pose(self.position_mm, self.rotation)


@dataclass(frozen=True)
class FittedFrame:
    """A part frame found from points."""

    pose: Array  #: Pose of the part frame in the base frame. Shape (4, 4). [m]
    residual: Array  #: Residual distance of each point. [mm]

    def tell(self) -> str:
        """Return a sentence with the frame and the residuals of the points."""
        z = ", ".join(f"{value:.4g}" for value in np.round(self.pose[:3, 2], 4) + 0.0)
        at = ", ".join(f"{value:.3f}" for value in 1e3 * self.pose[:3, 3])
        rms, worst, count = float(np.sqrt(np.mean(self.residual**2))), int(self.residual.argmax()), len(self.residual)
        return (f"The part frame is found from points (best fit of {count}): origin [{at}] mm, its z along ({z}) of "
                f"the base; they are {rms:.3g} mm (rms) from where it has them, at most {self.residual[worst]:.3g} mm, "
                f"point {worst + 1} of {count}.")  # fmt: skip


class PointPairs(StrictTable):
    """Nominal points of the part (part frame) and measured points (robot base)."""

    nominal: Places
    measured: Places

    @model_validator(mode="after")
    def _check(self) -> PointPairs:
        if len(self.nominal) != len(self.measured):
            counts = f"{len(self.nominal)} nominal and {len(self.measured)} measured points"
            raise ValueError(f"has {counts}, expected as many of each")
        if len(self.nominal) < 3:
            raise ValueError(f"has {len(self.nominal)} points, expected at least 3 not all on one line")
        for name, points in (("nominal", self.nominal), ("measured", self.measured)):
            size = np.linalg.svd(np.asarray(points) - np.mean(points, axis=0), compute_uv=False)
            if size[0] < NEAREST_MM or size[1] < FLATTEST * size[0]:
                raise ValueError(f"has {name} points on one line, which do not determine the rotation about it")
        return self

    def fit(self) -> FittedFrame:
        """Fit the frame by least squares [Kabsch1976]."""
        nominal, measured = np.asarray(self.nominal), np.asarray(self.measured)
        middle, seen = nominal.mean(axis=0), measured.mean(axis=0)
        turn = Rotation.align_vectors(measured - seen, nominal - middle)[0].as_matrix()
        left = np.linalg.norm(measured - seen - (nominal - middle) @ turn.T, axis=1)
        pose = make_pose(seen - turn @ middle, Rotation.from_matrix(turn))
        return FittedFrame(pose, left)


class PartTable(PoseTable):
    """[part]: pose of the part frame in the robot base (or in the link that carries the part).

    touched_off: Whether the part was found by touching it with this robot and tool; otherwise the frame is absolute in
        the robot base (tracker, calibrated cell).
    """

    points_mm: PointPairs | None = None
    touched_off: bool = True

    @model_validator(mode="after")
    def _check_one(self) -> PartTable:
        given = self.model_fields_set & {"position_mm", *ROTATIONS}
        if given and self.points_mm is not None:
            raise ValueError(f"is given by {', '.join([*sorted(given), 'points_mm'])}, expected one of them")
        return self

    @property
    def touched_points(self) -> Array | None:
        """Touched points in the part frame, or None. Shape (k, 3). [m]."""
        return None if self.points_mm is None else 1e-3 * np.asarray(self.points_mm.nominal)

    @property
    def fit(self) -> FittedFrame | None:
        """The frame found from points, or None."""
        return None if self.points_mm is None else self.points_mm.fit()

    @property
    def pose(self) -> Array:
        """Pose of the part frame in the robot base. Shape (4, 4) [m]."""
        fit = self.fit
        return super().pose if fit is None else fit.pose


class ToolTable(PoseTable):
    """[tool]: TCP frame on the flange and mass of the tool, replacing the robot folder's.

    frame: reference of position, rotation and centre of mass: the URDF's flange frame, or the maker's (pendant).
    """

    frame: Literal["flange", "pendant"] = "flange"
    mass_kg: float | None = Field(default=None, ge=0.0, le=HEAVIEST_KG)
    centre_of_mass_mm: Place = (0.0, 0.0, 0.0)

    def locate_frame(self, robot: Robot) -> Array:
        """Return the pose of the reference frame in the URDF's flange frame. Shape (4, 4) [m].

        Raises:
            InputError: If it is the frame of the pendant, and unknown.
        """
        if self.frame == "flange":
            return np.eye(4)
        found = locate_pendant(robot)
        if found is None:
            message = f"is 'pendant', but the tool frame of the pendant of {robot.name!r} is unknown"
            cure = 'write [pendant] with x and z in its controller.toml, or frame = "flange"'
            raise InputError(f"{message}; {cure}", where="tool.frame")
        return found.pose

    def mount(self, robot: Robot) -> Robot:
        """Return a robot with this tool in place of its folder's; an unstated mass is zero."""
        frame = self.locate_frame(robot)
        centre = frame[:3, :3] @ (np.asarray(self.centre_of_mass_mm) * 1e-3) + frame[:3, 3]
        return robot.with_tool(frame @ self.pose, self.mass_kg, centre)


class PositionerTable(StrictTable):
    """[positioner]: fixed positions of joints that carry the part, by name; the plan chooses the others."""

    hold_deg: dict[str, float] = Field(default_factory=dict)

    def hold(self, robot: Robot) -> Robot:
        """Return a robot whose held joints have equal limits.

        Raises:
            InputError: If a name is not that of a rotating joint that carries the part, or a position is out of range.
        """
        names = [joint.name for joint, carries in zip(robot.actuated, robot.carriers, strict=True)
                 if carries and joint.kind != "prismatic"]  # fmt: skip
        for name, value in self.hold_deg.items():
            where = f"positioner.hold_deg.{name}"
            if name not in names:
                raise InputError(f"carries no part in robot {robot.name!r}, choose from {names}", where=where)
            joint = robot.actuated[robot.joint_names.index(name)]
            low, high = np.degrees(joint.lower), np.degrees(joint.upper)
            if not low - 1e-6 <= value <= high + 1e-6:
                raise InputError(f"is {value:g} deg, its range is [{low:.6g}, {high:.6g}]", where=where)
            at = float(np.clip(value * np.pi / 180.0, joint.lower, joint.upper))
            held = tuple(replace(each, lower=at, upper=at) if each is joint else each for each in robot.joints)
            robot = replace(robot, joints=held)
        return robot
