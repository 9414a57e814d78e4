"""Construction of the elements of a chain from the base to the TCP: joints, springs, links, bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from compplan.robot import Array, Body, Joint, Robot, Spring
from compplan.robot.pose import build_pose

ELASTIC_AXES = {
    "tx": (True, (1.0, 0.0, 0.0)),
    "ty": (True, (0.0, 1.0, 0.0)),
    "tz": (True, (0.0, 0.0, 1.0)),
    "rx": (False, (1.0, 0.0, 0.0)),
    "ry": (False, (0.0, 1.0, 0.0)),
    "rz": (False, (0.0, 0.0, 1.0)),
}


class ElementRow:
    """Elements collected from the base to the TCP."""

    def __init__(self) -> None:
        self.pending = np.eye(4)
        self.elements: list[tuple[str, Array, Array, bool, int, float, float, int]] = []
        self.bodies: list[tuple[int, float, Array]] = []
        self.blocks: list[Array] = []
        self.actuator: list[bool] = []
        self.link_share: list[float] = []
        self.ground, self.ground_rotation = -1, np.eye(3)

    def set_ground(self) -> None:
        """Set the current frame as the frame of gravity."""
        self.ground, self.ground_rotation = len(self.elements) - 1, self.pending[:3, :3].copy()

    def move(self, pose: Array) -> None:
        """Append a constant pose. Shape (4, 4). [m]"""
        self.pending = self.pending @ pose

    def _append(
        self, name: str, axis: Array, translates: bool, q: int, multiplier: float, offset: float, theta: int
    ) -> None:
        self.elements.append((name, self.pending, axis, translates, q, multiplier, offset, theta))
        self.pending = np.eye(4)

    def add_joint(self, joint: Joint, names: tuple[str, ...]) -> None:
        """Add a commanded or mimic joint; `names` are the commanded joints in order."""
        driver, multiplier, offset = joint.name, 1.0, 0.0
        if joint.mimic is not None:
            driver, multiplier, offset = joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset
        translates = joint.kind == "prismatic"
        self._append(joint.name, joint.axis, translates, names.index(driver), multiplier, offset, -1)

    def add_elastic(self, spring: Spring, joint: Joint) -> None:
        """Add the elastic coordinate of a spring of a joint."""
        translates, axis = joint.kind == "prismatic", joint.axis
        if spring.axis != "own":
            translates, axis = ELASTIC_AXES[spring.axis][0], np.array(ELASTIC_AXES[spring.axis][1])
        self.move(build_pose(spring.offset, np.eye(3)))
        self._append(spring.name, axis, translates, -1, 0.0, 0.0, len(self.actuator))
        self.move(build_pose(-spring.offset, np.eye(3)))
        self.blocks.append(np.array([[spring.compliance]]))
        self.actuator.append(spring.actuator)
        self.link_share.append(spring.link_share)

    def add_link(self, link: str, compliance: Array) -> None:
        """Add the six elastic coordinates of a link, coupled by its compliance. Shape (6, 6)."""
        for name, (translates, axis) in ELASTIC_AXES.items():
            self._append(f"{link}.{name}", np.array(axis), translates, -1, 0.0, 0.0, len(self.actuator))
            self.actuator.append(False)
            self.link_share.append(0.0)
        self.blocks.append(compliance)

    def add_bodies(self, bodies: Sequence[Body]) -> None:
        """Attach bodies to the current frame."""
        for body in bodies:
            centre = self.pending[:3, :3] @ body.centre + self.pending[:3, 3]
            self.bodies.append((len(self.elements) - 1, body.mass, centre))

    def arrays(self, robot: Robot) -> dict[str, Any]:
        """Return the fields of the chain."""
        names, poses, axes, translates, q, multiplier, offset, theta = zip(*self.elements, strict=True)
        pose = np.array(poses)
        driver = {name: k for k, name in enumerate(names) if q[k] >= 0}
        down = robot.loading_gravity
        return {
            "names": tuple(names),
            "rotation": pose[:, :3, :3].copy(),
            "position": pose[:, :3, 3].copy(),
            "axis": np.array(axes),
            "translates": np.array(translates, bool),
            "q_index": np.array(q, int),
            "multiplier": np.array(multiplier, float),
            "q_offset": np.array(offset, float),
            "theta_index": np.array(theta, int),
            "tcp_rotation": self.pending[:3, :3].copy(),
            "tcp_position": self.pending[:3, 3].copy(),
            "body_element": np.array([body[0] for body in self.bodies], int),
            "mass": np.array([body[1] for body in self.bodies], float),
            "centre": np.array([body[2] for body in self.bodies], float).reshape(-1, 3),
            "compliance": block_diag(np.zeros((0, 0)), *self.blocks),
            "gravity": np.zeros(3) if down is None else np.asarray(down, float),
            "actuator": np.array(self.actuator, bool),
            "link_share": np.array(self.link_share, float),
            "ground": self.ground,
            "ground_rotation": self.ground_rotation,
            "joint_elements": np.array([driver[name] for name in robot.joint_names], int),
        }
