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

from compplan.controllers.writers.joint_convention import locate_links
from compplan.robot import Array, Robot

#: Distances beyond this are not told apart. [m]
FAR = 0.5
#: Pairs of a posture whose distances are differentiated at most, and distance from which on their points tell the
#: normal, Coal below it. [m]
MOST_PAIRS, APART = 6, 1e-6


@dataclass(frozen=True)
class Solid:
    """Something that may touch."""

    name: str  #: What it is called in messages.
    link: str  #: Link that it moves with, or "" for what stands still in the base frame.
    body: int  #: Number of commanded joints before it; what stands still counts as 0.
    geometry: Any  #: coal's geometry, in its own frame.
    placement: Array  #: Pose of that frame in the frame of the link (or base). Shape (4, 4). [m]
    centre: Array  #: Centre of its bounding sphere in the frame of the link (or base). Shape (3,). [m]
    radius: float  #: Radius of its bounding sphere. [m]
    box: Array  #: Lower and upper corner of its bounding box in that frame. Shape (2, 3). [m]


class Contact(NamedTuple):
    """The nearest pair of one posture: names of both solids, distance [m], negative where they overlap."""

    first: str
    second: str
    distance: float


class Near(NamedTuple):
    """The several nearest pairs of postures, r in all."""

    posture: NDArray[np.int_]  #: Which posture. Shape (r,).
    distance: Array  #: Signed distance of the pair. Shape (r,). [m]
    rate: Array  #: Its derivative by the joint positions. Shape (r, nq). [m/rad or 1]


class _Gauge:
    """Coal's distance of a pair, and the points of both solids that are nearest to each other."""

    def __init__(self, solids: Sequence[Solid], frames: dict[str, Array]) -> None:
        import coal

        self.solids, self.frames, self.distance = solids, frames, coal.distance
        self.request, self.result = coal.DistanceRequest(), coal.DistanceResult()
        self.transforms = [coal.Transform3s() for _ in range(2)]

    def measure(self, posture: int, pair: NDArray[np.int_]) -> float:
        """Return the signed distance of a pair in a posture. [m]."""
        ends = [self.solids[s] for s in pair]
        for transform, solid in zip(self.transforms, ends, strict=True):
            pose = self.frames[solid.link][posture] @ solid.placement if solid.link else solid.placement
            transform.setRotation(np.ascontiguousarray(pose[:3, :3]))
            transform.setTranslation(np.ascontiguousarray(pose[:3, 3]))
        self.result.clear()
        (first, second), (at, there) = ends, self.transforms
        return float(self.distance(first.geometry, at, second.geometry, there, self.request, self.result))

    def points(self, distance: float) -> tuple[Array, Array, Array]:
        """Return the nearest points of the pair measured last, and the normal from the first to the second."""
        first, second = (np.array(get()) for get in (self.result.getNearestPoint1, self.result.getNearestPoint2))
        normal = (second - first) / distance if distance > APART else np.array(self.result.normal)
        return first, second, normal


def find_contacts(
    robot: Robot, solids: Sequence[Solid], q: Array, pairs: NDArray[np.int_], *, far: float = FAR
) -> list[Contact]:
    """Find the nearest pair of every posture q (n, nq); distances beyond `far` [m] are not told apart.

    pairs: those to look at, as indices of solids. Shape (p, 2).
    """
    if not len(q):
        return []
    frames = locate_all_links(robot, q)
    bound, gauge, contacts = _bounds(solids, pairs, frames, len(q)), _Gauge(solids, frames), []
    for i in range(len(q)):
        best = Contact("", "", far)
        for k in np.argsort(bound[i]):
            if bound[i, k] >= best.distance:
                break
            distance = gauge.measure(i, pairs[k])
            if distance < best.distance:
                best = Contact(solids[pairs[k][0]].name, solids[pairs[k][1]].name, distance)
        contacts.append(best)
    return contacts


def find_near(robot: Robot, solids: Sequence[Solid], q: Array, pairs: NDArray[np.int_], *, far: float) -> Near:
    """Find the several nearest pairs of every posture q (n, nq), and how their distances answer to the joints.

    d = n . (p_b - p_a),   dd/dq = n . (J_b - J_a),

    p the points nearest to each other, n the normal from a to b, J the Jacobian of such a point fixed to its link.
    Pairs beyond `far` [m] are left out.
    """
    frames = locate_all_links(robot, q)
    bound, gauge = _bounds(solids, pairs, frames, len(q)), _Gauge(solids, frames)
    found: list[tuple[int, int, float, tuple[Array, Array, Array]]] = []
    for i in range(len(q)):
        nearest: list[tuple[int, int, float, tuple[Array, Array, Array]]] = []
        for k in np.argsort(bound[i]):
            most = far if len(nearest) < MOST_PAIRS else nearest[-1][2]
            if bound[i, k] >= most:
                break
            distance = gauge.measure(i, pairs[k])
            if distance < most:
                nearest = sorted([*nearest, (i, int(k), distance, gauge.points(distance))], key=lambda each: each[2])
        found += nearest[:MOST_PAIRS]
    posture, rate = np.array([each[0] for each in found], int), np.zeros((len(found), robot.nq))
    links = [[solids[s].link for s in pairs[each[1]]] for each in found]
    normal = np.array([each[3][2] for each in found]).reshape(-1, 3)
    for end, sign in ((0, -1.0), (1, 1.0)):
        point = np.array([each[3][end] for each in found]).reshape(-1, 3)
        rate += sign * _move_points(robot, frames, posture, [pair[end] for pair in links], point, normal)
    return Near(posture, np.array([each[2] for each in found]), rate)


def _move_points(
    robot: Robot, frames: dict[str, Array], posture: NDArray[np.int_], links: Sequence[str], point: Array, normal: Array
) -> Array:
    """Differentiate the way of points of links along normals by the joint positions. Shape (r, nq). [m/rad or 1]."""
    rate, names = np.zeros((len(point), robot.nq)), robot.joint_names
    beyond: list[str] = []
    for joint in reversed(robot.joints):
        beyond.append(joint.child)
        if joint.kind == "fixed":
            continue
        pose = (frames[joint.parent] @ joint.placement)[posture]
        axis = pose[:, :3, :3] @ joint.axis
        moved = axis if joint.kind == "prismatic" else np.cross(axis, point - pose[:, :3, 3])
        name, share = (joint.name, 1.0) if joint.mimic is None else (joint.mimic.joint, joint.mimic.multiplier)
        carried = np.array([link in beyond for link in links], float)
        rate[:, names.index(name)] += share * carried * np.einsum("rk,rk->r", moved, normal)
    return rate


def locate_all_links(robot: Robot, q: Array) -> dict[str, Array]:
    """Return the pose of each link's frame at postures (n, nq). Shape (n, 4, 4) each. [m]"""
    return locate_links(robot, q, [joint.child for joint in robot.joints])


def describe_contact(contact: Contact) -> str:
    """Say what is nearest to what, in words."""
    if not contact.first:
        return "nothing is near"
    if contact.distance <= 0:
        return f"{contact.first} touches {contact.second}"
    return f"{contact.first} comes within {1e3 * contact.distance:.1f} mm of {contact.second}"


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
