"""Collision: how far arm and tool keep clear of the part, of the fixture and of the arm itself.

Part, fixture and tool are meshes; the arm is its URDF's collision shapes. Distances come from coal; bounding spheres
(and the bounding boxes of what stands still) sort out the pairs that cannot be nearest. The wanted clearance counts
against part and fixture; arm and tool only must not touch the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.solids import cut_tip, load_mesh, make_geometry, read_shapes

if TYPE_CHECKING:
    from compplan.job import Job

#: Distances beyond this are not told apart. [m]
FAR = 0.5
#: Arm and tool touch the arm where they come nearer than this. [m]
TOUCH = 1e-3
#: A pair of the arm's own shapes that touches in this share of random postures is left out: they are drawn so.
DRAWN_TOUCHING = 0.7
#: Evenly spaced waypoints whose distance is computed; others follow where the bound asks for them.
SAMPLES, FURTHER = 120, 400
#: How exactly the least distance along a path is found. [m]
EXACT = 5e-4


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


@dataclass(frozen=True)
class CollisionScene:
    """What may touch what.

    Attributes:
        robot: The robot with its tool.
        solids: Shapes of the arm, tool, part, fixture.
        outside: Pairs of arm or tool with part or fixture. Shape (p, 2).
        own: Pairs of arm or tool with the arm itself. Shape (o, 2).

    """

    robot: Robot
    solids: tuple[Solid, ...]
    outside: NDArray[np.int_]
    own: NDArray[np.int_]

    @cached_property
    def reach(self) -> Array:
        """Farthest that any point moves per motion of a joint: shape (nq,) [m/rad or 1]."""
        lengths = [float(np.linalg.norm(joint.placement[:3, 3])) for joint in self.robot.joints]
        beyond = np.cumsum(lengths[::-1])[::-1]
        tool = max((s.radius + float(np.linalg.norm(s.centre)) for s in self.solids if s.link), default=0.0)
        actuated = [k for k, joint in enumerate(self.robot.joints) if joint.actuated]
        rows = [beyond[k] - lengths[k] + tool for k in actuated]
        return np.where(self.robot.prismatic, 1.0, np.array(rows))


@dataclass(frozen=True)
class ClearanceProfile:
    """Clearance along a path.

    Attributes:
        distance: Distance of arm and tool from part and fixture at each waypoint, linear between computed ones.
            Shape (n,). [m]
        computed: Waypoints where it was computed. Shape (c,).
        contacts: The nearest pair at each of these. Length c.
        own: The nearest pair of arm or tool with the arm, where it is least along the path.
        own_waypoint: Waypoint where that is.
        wanted: Clearance that was asked for. [m]

    """

    distance: Array
    computed: NDArray[np.int_]
    contacts: tuple[Contact, ...]
    own: Contact
    own_waypoint: int
    wanted: float

    @property
    def least(self) -> tuple[int, Contact]:
        """Return the waypoint with the least distance, and what is nearest there."""
        k = int(np.argmin([contact.distance for contact in self.contacts]))
        return int(self.computed[k]), self.contacts[k]


def build_scene(
    robot: Robot, *, part: Any = None, fixture: Any = None, tool: Any = None, T_base_part: Array | None = None,
    tip_zone: float = 0.03, self_collision: bool = True,
) -> CollisionScene:  # fmt: skip
    """Build the scene of a job.

    Args:
        robot: The robot with its tool.
        part: Mesh of the part, part frame (trimesh) [m], or None.
        fixture: Mesh of the fixture, part frame [m], or None.
        tool: Mesh of the tool, flange frame [m], or None.
        T_base_part: Pose of the part frame. Shape (4, 4). [m]
        tip_zone: The tool within this distance of its tip may touch the part. [m]
        self_collision: Whether the arm has to keep clear of itself.

    """
    pose = np.eye(4) if T_base_part is None else T_base_part
    body = _bodies(robot)
    solids, roles = [], []

    def add(name: str, link: str, mesh_or_shape: Any, role: str, placement: Array | None = None) -> None:
        geometry, centre, radius, box = make_geometry(mesh_or_shape, placement)
        local = np.eye(4) if placement is None else placement
        solids.append(Solid(name, link, body.get(link, 0), geometry, local, centre, radius, box))
        roles.append(role)

    behind = _behind_flange(robot)
    for shape in read_shapes(robot):
        if shape.link in behind:
            add(shape.name, shape.link, shape.form, "tool", shape.placement)
            cut = cut_tip(shape.mesh(), _tip_in(robot, shape.link), tip_zone)
            if cut is not None:
                add(f"{shape.name} (above the tip)", shape.link, cut, "shank")
        else:
            add(shape.name, shape.link, shape.form, "arm", shape.placement)
    if tool is not None:
        add("tool", robot.flange, tool, "tool")
        cut = cut_tip(tool, _tip_in(robot, robot.flange), tip_zone)
        if cut is not None:
            add("tool (above the tip)", robot.flange, cut, "shank")
    for name, mesh in (("part", part), ("fixture", fixture)):
        if mesh is not None:
            add(name, "", mesh.copy().apply_transform(pose), name)
    outside, own = _list_pairs(solids, roles)
    if not self_collision:
        own = own[:0]
    return _leave_out_touching(CollisionScene(robot, tuple(solids), outside, own))


def load_scene(job: Job, robot: Robot) -> CollisionScene | None:
    """Build the scene that a job describes; None where it has no table [collision].

    Raises:
        InputError: If a mesh is missing or cannot be read.

    """
    table = job.collision
    if table is None:
        return None
    meshes = {}
    for name in ("part", "fixture", "tool"):
        file = getattr(table, name)
        if file is None:
            continue
        try:
            meshes[name] = load_mesh(job.folder / file, table.unit)
        except InputError as error:
            raise InputError(error.message, file=job.file, where=f"collision.{name}") from None
    return build_scene(
        robot, **meshes, T_base_part=job.T_base_part, tip_zone=table.tip_zone_mm * 1e-3,
        self_collision=table.self_collision,
    )  # fmt: skip


def find_contacts(scene: CollisionScene, q: Array, pairs: NDArray[np.int_], *, far: float = FAR) -> list[Contact]:
    """Find the nearest pair of every posture.

    Args:
        scene: The solids.
        q: Joint positions. Shape (n, nq). [rad or m]
        pairs: Pairs to look at, such as `scene.outside`. Shape (p, 2).
        far: Distances beyond this are not told apart. [m]

    """
    import coal

    frames = locate_link_frames(scene.robot, q)
    bound = _bounds(scene, pairs, frames, len(q))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    transforms = [coal.Transform3s() for _ in range(2)]
    contacts = []
    for i in range(len(q)):
        best = Contact("", "", far)
        for k in np.argsort(bound[i]):
            if bound[i, k] >= best.distance:
                break
            ends = [scene.solids[s] for s in pairs[k]]
            for transform, solid in zip(transforms, ends, strict=True):
                pose = frames[solid.link][i] @ solid.placement if solid.link else solid.placement
                transform.setRotation(np.ascontiguousarray(pose[:3, :3]))
                transform.setTranslation(np.ascontiguousarray(pose[:3, 3]))
            result.clear()
            distance = coal.distance(
                ends[0].geometry, transforms[0], ends[1].geometry, transforms[1], request, result
            )
            if distance < best.distance:
                best = Contact(ends[0].name, ends[1].name, float(distance))
        contacts.append(best)
    return contacts


def measure_margin(scene: CollisionScene, q: Array, wanted: float) -> Array:
    """Measure by how much postures keep clear: of part and fixture by more than `wanted`, of the arm at all.

    Args:
        scene: What may touch what.
        q: Joint positions. Shape (n, nq). [rad or m]
        wanted: Clearance that is asked for. [m]

    Returns:
        Negative where a posture comes too near. Shape (n,). [m]

    """
    outside = [contact.distance for contact in find_contacts(scene, q, scene.outside, far=wanted + 0.05)]
    own = [contact.distance for contact in find_contacts(scene, q, scene.own, far=0.05)]
    return np.minimum(np.array(outside) - wanted, np.array(own) - TOUCH)


def measure_clearance(scene: CollisionScene, q: Array, wanted: float, *, far: float = FAR) -> ClearanceProfile:
    """Measure the clearance along a path, computing as few distances as the least one asks for.

    No point of arm or tool moves farther between two postures than `reach` times the joint motion; so a computed
    distance bounds those around it from below, and waypoints are computed until no other can have the least distance.

    Args:
        scene: What may touch what.
        q: Joint positions along the path. Shape (n, nq). [rad or m]
        wanted: Clearance that is asked for. [m]
        far: Distances beyond this are not told apart. [m]

    """
    contacts = _least_along(scene, q, scene.outside, far)
    own = _least_along(scene, q, scene.own, 0.1)
    known = np.array(sorted(contacts))
    distance = np.array([contacts[w].distance for w in known.tolist()])
    worst = min(own, key=lambda w: own[w].distance)
    profile = np.interp(np.arange(len(q)), known, distance)
    return ClearanceProfile(profile, known, tuple(contacts[w] for w in known.tolist()), own[worst], worst, wanted)


def _least_along(scene: CollisionScene, q: Array, pairs: NDArray[np.int_], far: float) -> dict[int, Contact]:
    """Compute contacts at even samples and wherever the least distance may be."""
    n = len(q)
    known = np.unique(np.linspace(0, n - 1, min(n, SAMPLES)).astype(int))
    contacts = dict(zip(known.tolist(), find_contacts(scene, q[known], pairs, far=far), strict=True))
    travel = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)) @ scene.reach)]
    for _ in range(FURTHER // 10):
        known = np.array(sorted(contacts))
        distance = np.array([contacts[w].distance for w in known.tolist()])
        lowest = _lower_bounds(travel, known, distance)
        lowest[known] = np.inf
        wanted = np.flatnonzero(lowest < distance.min() - EXACT)
        if not len(wanted):
            break
        chosen = wanted[np.argsort(lowest[wanted])[:: max(1, len(wanted) // 10)][:10]]
        contacts.update(zip(chosen.tolist(), find_contacts(scene, q[chosen], pairs, far=far), strict=True))
    return contacts


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


def describe_contact(contact: Contact) -> str:
    """Say what is nearest to what, in words."""
    if not contact.first:
        return "nothing is near"
    if contact.distance <= 0:
        return f"{contact.first} touches {contact.second}"
    return f"{contact.first} comes within {1e3 * contact.distance:.1f} mm of {contact.second}"


def describe_clearance(profile: ClearanceProfile) -> dict[str, Any]:
    """Describe the clearance along a path for plan.json."""
    waypoint, contact = profile.least
    own = profile.own
    return {
        "wanted_mm": 1e3 * profile.wanted,
        "least_mm": 1e3 * contact.distance,
        "waypoint": waypoint,
        "between": [contact.first, contact.second] if contact.first else [],
        "own_least_mm": 1e3 * own.distance,
        "own_waypoint": profile.own_waypoint,
        "own_between": [own.first, own.second] if own.first else [],
    }


def _lower_bounds(travel: Array, known: NDArray[np.int_], distance: Array) -> Array:
    """Bound the distance at every waypoint from those that are known on either side."""
    rows = np.arange(len(travel))
    after = np.clip(np.searchsorted(known, rows), 0, len(known) - 1)
    before = np.clip(np.searchsorted(known, rows, side="right") - 1, 0, len(known) - 1)
    left = distance[before] - np.abs(travel - travel[known[before]])
    right = distance[after] - np.abs(travel[known[after]] - travel)
    return np.asarray(np.maximum(left, right))


def _bounds(scene: CollisionScene, pairs: NDArray[np.int_], frames: dict[str, Array], n: int) -> Array:
    """Bound the distance of every pair from below by spheres, and by boxes of what stands still. Shape (n, p)."""
    centre = np.empty((len(scene.solids), n, 3))
    for s, solid in enumerate(scene.solids):
        pose = frames[solid.link] if solid.link else np.eye(4)[None]
        centre[s] = pose[:, :3, :3] @ solid.centre + pose[:, :3, 3]
    bound = np.empty((n, len(pairs)))
    for k, (a, b) in enumerate(pairs):
        first, second = scene.solids[a], scene.solids[b]
        gap = np.linalg.norm(centre[a] - centre[b], axis=1) - first.radius - second.radius
        for still, moving in ((second, a), (first, b)):
            if not still.link:
                outside = np.maximum(still.box[0] - centre[moving], centre[moving] - still.box[1])
                away = np.linalg.norm(np.maximum(outside, 0), axis=1)
                gap = np.maximum(gap, away - scene.solids[moving].radius)
        bound[:, k] = gap
    return bound


def _list_pairs(solids: Sequence[Solid], roles: Sequence[str]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """List the pairs that may touch but should not: with part and fixture, and of the arm itself.

    Links with one link between them are left to the joint limits; the tool is not.
    """
    outside, own = [], []
    for a in range(len(solids)):
        for b in range(a + 1, len(solids)):
            role = {roles[a], roles[b]}
            if solids[a].body == solids[b].body == 0 or role in ({"part", "fixture"}, {"tool", "part"}):
                continue
            if "shank" in role:
                if "part" in role:
                    outside.append((a, b))
            elif role & {"part", "fixture"}:
                outside.append((a, b))
            elif abs(solids[a].body - solids[b].body) > (1 if "tool" in role else 2):
                own.append((a, b))
    return np.array(outside, int).reshape(-1, 2), np.array(own, int).reshape(-1, 2)


def _leave_out_touching(scene: CollisionScene) -> CollisionScene:
    """Leave out pairs of the arm's own shapes that touch in most postures: the drawing overlaps there."""
    robot = scene.robot
    low, high = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = low + (high - low) * np.random.default_rng(0).random((40, robot.nq))
    drawn = []
    for k in range(len(scene.own)):
        contacts = find_contacts(scene, q, scene.own[[k]], far=TOUCH)
        if np.mean([bool(contact.first) for contact in contacts]) >= DRAWN_TOUCHING:
            drawn.append(k)
    return replace(scene, own=np.delete(scene.own, drawn, axis=0))


def _bodies(robot: Robot) -> dict[str, int]:
    """Count the moving joints before every link."""
    count, bodies = 0, {robot.base: 0}
    for joint in robot.joints:
        count += joint.kind != "fixed"
        bodies[joint.child] = count
    return bodies


def _behind_flange(robot: Robot) -> set[str]:
    """Return the links of the tool: those of the chain from the flange on."""
    links, behind = set(), False
    for joint in robot.joints:
        behind = behind or joint.parent == robot.flange
        if behind:
            links.add(joint.child)
    return links | {robot.flange}


def _tip_in(robot: Robot, link: str) -> Array:
    """Return the tool centre point in the frame of a link behind the flange: shape (3,) [m]."""
    frames = locate_link_frames(robot, np.zeros((1, robot.nq)))
    return np.asarray((np.linalg.inv(frames[link][0]) @ frames[robot.tcp][0])[:3, 3])
