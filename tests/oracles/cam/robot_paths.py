"""What readers of robot programs as paths have in common: poses, the frame that counts, circles by three points."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from compplan.controllers.readback.poses import shift
from tests.oracles.cam.moves import ARC, LINE, RAPID, Array, CannotTellError, Recorder

#: Axis of the TCP frame by its name.
DIRECTIONS = {sign + name: (k, -1.0 if sign else 1.0) for sign in ("", "-") for k, name in enumerate("xyz")}


@dataclass
class RobotPath:
    """Where a robot program leads its tool, seen from the frame that its first move counts from.

    Args:
        points: Axis of the TCP frame that points out of the tool, None for z.

    """

    points: str | None = None
    start: list[float] | None = None
    record: Recorder = field(default_factory=Recorder)
    first: Array | None = None
    name: str = ""
    pose: Array | None = None

    def place(self, pose: Array, frame: Array | None, name: str) -> Array:
        """Return a pose in a frame as it is seen from the first frame; one that is not known has to stay.

        Args:
            pose: Pose of the tool in the frame. Shape (4, 4). [mm]
            frame: The frame, None where its place is not known. Shape (4, 4). [mm]
            name: Its name.

        """
        if not self.name:
            self.first, self.name = frame, name
        if name == self.name:
            return pose
        if self.first is None or frame is None:
            raise CannotTellError(f"the frames {self.name} and {name} are not both known", self.record.line)
        return np.asarray(np.linalg.inv(self.first) @ frame @ pose)

    def lead(self, pose: Array, feed: float, *, rapid: bool) -> None:
        """Move to a pose, straight or fast; from where nobody knows it is fast."""
        if not rapid and self.pose is None and self.start is not None:
            self.record.move(RAPID, list(self.start), 0.0, self._axis(pose))
            self.pose = pose
        kind = RAPID if rapid or self.pose is None else LINE
        self.record.move(kind, pose[:3, 3].tolist(), feed, self._axis(pose))
        self.pose = pose

    def circle(self, middle: Array, pose: Array, feed: float, angle: float | None = None) -> None:
        """Cut the circle through where the tool is, a middle and an end; an angle goes on from there. [deg]"""
        if self.pose is None:
            raise CannotTellError("a circle from nowhere", self.record.line)
        a, b, c = self.pose[:3, 3], middle[:3, 3], pose[:3, 3]
        normal = np.cross(b - a, c - a)
        square = float(normal @ normal)
        if square < 1e-9:
            raise CannotTellError("a circle through points in line", self.record.line)
        p, q = b - a, c - a
        centre = a + (np.dot(p, p) * np.cross(q, normal) + np.dot(q, q) * np.cross(normal, p)) / (2.0 * square)
        u, v = a - centre, c - centre
        sweep = math.atan2(float(np.cross(u, v) @ normal) / math.sqrt(square), float(u @ v))
        sweep += 2.0 * math.pi * (sweep <= 0.0)
        end = pose
        if angle is not None:
            if angle <= 0.0:
                raise CannotTellError("a circle that turns back", self.record.line)
            sweep = math.radians(angle)
            n = normal / math.sqrt(square)
            end = shift(*(centre + math.cos(sweep) * u + math.sin(sweep) * np.cross(n, u)))
            end[:3, :3] = pose[:3, :3]
        self.record.move(
            ARC, end[:3, 3].tolist(), feed, self._axis(end), centre=tuple(centre.tolist()),
            normal=tuple(normal.tolist()), sweep=sweep,
        )  # fmt: skip
        self.pose = end

    def _axis(self, pose: Array) -> tuple[float, ...]:
        """Return the tool axis of a pose, tip to spindle."""
        column, sign = DIRECTIONS[self.points or "z"]
        return tuple((-sign * pose[:3, column]).tolist())
