"""Contacts: which two solids of robot, tool, part and fixture are nearest to each other in a posture, and how near.

Distances come from coal; bounding spheres (and the bounding boxes of what stands still) sort out the pairs that cannot
be nearest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.robot import Array, Robot

#: Distances beyond this are not told apart. [m]
FAR = 0.5


@dataclass(frozen=True)
class Solid:
    """Something that may touch.

    Attributes:
        name: What it is called in messages.
        link: Link that it moves with, or "" for what stands still in the base frame.
        body: Number of commanded joints before it; what stands still counts as 0.
        geometry: coal's geometry, in its own frame.
        placement: Pose of that frame in the frame of the link (or base). Shape (4, 4). [m]
        centre: Centre of its bounding sphere in the frame of the link (or base). Shape (3,). [m]
        radius: Radius of its bounding sphere. [m]
        box: Lower and upper corner of its bounding box in that frame. Shape (2, 3). [m]

    """

    name: str
    link: str
    body: int
    geometry: Any
    placement: Array
    centre: Array
    radius: float
    box: Array


class Contact(NamedTuple):
    """The nearest pair of one posture: names of both solids, distance [m], negative where they overlap."""

    first: str
    second: str
    distance: float


def find_contacts(
    robot: Robot, solids: Sequence[Solid], q: Array, pairs: NDArray[np.int_], *, far: float = FAR
) -> list[Contact]:
    """Find the nearest pair of every posture.

    Args:
        robot: The robot.
        solids: What may touch.
        q: Joint positions. Shape (n, nq). [rad or m]
        pairs: Pairs to look at, as indices of solids. Shape (p, 2).
        far: Distances beyond this are not told apart. [m]

    """
    import coal

    if not len(q):
        return []
    frames = locate_link_frames(robot, q)
    bound = _bounds(solids, pairs, frames, len(q))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    transforms = [coal.Transform3s() for _ in range(2)]
    contacts = []
    for i in range(len(q)):
        best = Contact("", "", far)
        for k in np.argsort(bound[i]):
            if bound[i, k] >= best.distance:
                break
            ends = [solids[s] for s in pairs[k]]
            for transform, solid in zip(transforms, ends, strict=True):
                pose = frames[solid.link][i] @ solid.placement if solid.link else solid.placement
                transform.setRotation(np.ascontiguousarray(pose[:3, :3]))
                transform.setTranslation(np.ascontiguousarray(pose[:3, 3]))
            result.clear()
            distance = coal.distance(ends[0].geometry, transforms[0], ends[1].geometry, transforms[1], request, result)
            if distance < best.distance:
                best = Contact(ends[0].name, ends[1].name, float(distance))
        contacts.append(best)
    return contacts


def describe_contact(contact: Contact) -> str:
    """Say what is nearest to what, in words."""
    if not contact.first:
        return "nothing is near"
    if contact.distance <= 0:
        return f"{contact.first} touches {contact.second}"
    return f"{contact.first} comes within {1e3 * contact.distance:.1f} mm of {contact.second}"


def locate_link_frames(robot: Robot, q: Array) -> dict[str, Array]:
    """Locate the links of the chain at many postures: pose of each link's frame, shape (n, 4, 4) [m]."""
    n = len(q)
    value = {name: q[:, k] for k, name in enumerate(robot.joint_names)}
    pose = np.tile(np.eye(4), (n, 1, 1))
    frames = {robot.base: pose}
    for joint in robot.joints:
        pose = frames[joint.parent] @ joint.placement
        if joint.kind != "fixed":
            if joint.mimic is not None:
                position = joint.mimic.multiplier * value[joint.mimic.joint] + joint.mimic.offset
            else:
                position = value[joint.name]
            motion = np.tile(np.eye(4), (n, 1, 1))
            if joint.kind == "prismatic":
                motion[:, :3, 3] = position[:, None] * joint.axis
            else:
                motion[:, :3, :3] = Rotation.from_rotvec(position[:, None] * joint.axis).as_matrix()
            pose = pose @ motion
        frames[joint.child] = pose
    return frames


def _bounds(solids: Sequence[Solid], pairs: NDArray[np.int_], frames: dict[str, Array], n: int) -> Array:
    """Bound the distance of every pair from below by spheres, and by boxes of what stands still. Shape (n, p)."""
    centre = np.empty((len(solids), n, 3))
    for s, solid in enumerate(solids):
        pose = frames[solid.link] if solid.link else np.eye(4)[None]
        centre[s] = pose[:, :3, :3] @ solid.centre + pose[:, :3, 3]
    bound = np.empty((n, len(pairs)))
    for k, (a, b) in enumerate(pairs):
        first, second = solids[a], solids[b]
        gap = np.linalg.norm(centre[a] - centre[b], axis=1) - first.radius - second.radius
        for still, moving in ((second, a), (first, b)):
            if not still.link:
                outside = np.maximum(still.box[0] - centre[moving], centre[moving] - still.box[1])
                away = np.linalg.norm(np.maximum(outside, 0), axis=1)
                gap = np.maximum(gap, away - solids[moving].radius)
        bound[:, k] = gap
    return bound
