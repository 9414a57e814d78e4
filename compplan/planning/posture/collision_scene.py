"""Collision scene of a job: solids of arm, tool, part and fixture, pairs to check, and their distances.

Part, fixture and tool are meshes; the arm has the collision shapes of its URDF. Distances come from coal. Bounding
spheres, and bounding boxes of fixed solids, exclude the pairs that cannot be nearest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.joint_convention import locate_links
from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.io.notes import Stop
from compplan.robot import Array, Robot
from compplan.robot.shapes import BodyShapes, leave_out, read_bodies
from compplan.robot.solids import cut_tip, make_geometry

if TYPE_CHECKING:
    from compplan.job.job import Job

#: Distance below which arm and tool count as touching the arm. [m]
TOUCH = 1e-3
#: Radius of the capsule used for a tool without a mesh (assumed). [m]
CAPSULE_RADIUS = 0.025
#: Share of random postures with contact from which a pair of shapes of the arm is left out: the shapes overlap.
DRAWN_TOUCHING = 0.7
#: Distances beyond this are not computed. [m]
FAR = 0.5
#: Most pairs of a posture whose distances are differentiated, and distance above which the normal is computed from
#: the nearest points; below, coal's normal is used. [m]
MOST_PAIRS, APART = 6, 1e-6


@dataclass(frozen=True)
class Solid:
    """Solid of the scene."""

    name: str  #: Name in messages.
    link: str  #: Link that carries the solid, or "" if fixed in the base frame.
    body: int  #: Number of moving joints between base and link; 0 if fixed.
    geometry: Any  #: coal's geometry, in its local frame.
    placement: Array  #: Pose of the local frame in the frame of the link (or base). Shape (4, 4). [m]
    centre: Array  #: Centre of the bounding sphere in the frame of the link (or base). Shape (3,). [m]
    radius: float  #: Radius of the bounding sphere. [m]
    box: Array  #: Lower and upper corner of the bounding box in the frame of the link (or base). Shape (2, 3). [m]


class Contact(NamedTuple):
    """Nearest pair of one posture: names of both solids, distance [m], negative where they overlap."""

    first: str
    second: str
    distance: float


class Near(NamedTuple):
    """Nearest pairs of several postures, r in total."""

    posture: NDArray[np.int_]  #: Index of the posture. Shape (r,).
    distance: Array  #: Signed distance of the pair. Shape (r,). [m]
    rate: Array  #: Derivative of the distance with respect to the joint positions. Shape (r, nq). [m/rad or 1]


@dataclass(frozen=True)
class CollisionScene:
    """Solids, and the pairs to check."""

    robot: Robot  #: The robot with its tool.
    solids: tuple[Solid, ...]  #: Shapes of the arm, tool, part, fixture.
    outside: NDArray[np.int_]  #: Pairs of arm or tool with part or fixture. Shape (p, 2).
    own: NDArray[np.int_]  #: Pairs of arm or tool with the arm itself. Shape (o, 2).
    notes: tuple[str, ...] = ()  #: Notes for the user, one sentence each.
    bodies: tuple[BodyShapes, ...] = ()  #: Collision shapes of each body of the arm.
    #: Meshes for drawings: name, link ("" if fixed), and mesh [m].
    meshes: tuple[tuple[str, str, Any], ...] = ()

    @cached_property
    def reach(self) -> Array:
        """Upper bound of the motion of any point per motion of a joint. Shape (nq,). [m/rad or 1]"""
        lengths = [float(np.linalg.norm(joint.placement[:3, 3])) for joint in self.robot.joints]
        beyond = np.cumsum(lengths[::-1])[::-1]
        tool = max((s.radius + float(np.linalg.norm(s.centre)) for s in self.solids if s.link), default=0.0)
        actuated = [k for k, joint in enumerate(self.robot.joints) if joint.actuated]
        rows = [beyond[k] - lengths[k] + tool for k in actuated]
        return np.where(self.robot.prismatic, 1.0, np.array(rows))


def build_scene(
    robot: Robot, *, part: Any = None, fixture: Any = None, tool: Any = None, T_base_part: Array | None = None,
    tip_zone: float = 0.03, self_collision: bool = True, bodies: Sequence[BodyShapes] | None = None,
) -> CollisionScene:  # fmt: skip
    """Build the scene of a job from meshes (trimesh) of part and fixture (part frame) and tool (flange frame) [m].

    `T_base_part` (4, 4) [m] is the pose of the part frame; the tool within `tip_zone` [m] of its tip may touch the
    part; `bodies` are the collision shapes of the arm (default: of the robot's URDF).
    """
    bodies = read_bodies(robot) if bodies is None else bodies
    pose = np.eye(4) if T_base_part is None else T_base_part
    moving, behind, body = 0, {robot.flange}, {robot.base: 0}  # moving joints before every link, links of the tool
    for joint in robot.joints:
        moving += joint.kind != "fixed"
        body[joint.child] = moving
        behind |= {joint.child} if joint.parent in behind else set()
    solids, roles = [], []
    given: list[tuple[str, str, Any]] = [] if tool is None else [("tool", robot.flange, tool)]

    def add(name: str, link: str, mesh_or_shape: Any, role: str, placement: Array | None = None) -> None:
        geometry, centre, radius, box = make_geometry(mesh_or_shape, placement)
        local = np.eye(4) if placement is None else placement
        solids.append(Solid(name, link, body.get(link, 0), geometry, local, centre, radius, box))
        roles.append(role)

    def add_tool(name: str, link: str, mesh_or_shape: Any, mesh: Any, placement: Array | None = None) -> None:
        add(name, link, mesh_or_shape, "tool", placement)
        cut = cut_tip(mesh, _tip_in(robot, link), tip_zone)
        if cut is not None:
            add(f"{name} (above the tip)", link, cut, "shank")

    for shape in (shape for entry in bodies for shape in entry.shapes):
        if shape.link in behind:
            add_tool(shape.name, shape.link, shape.form, shape.mesh(), shape.placement)
        else:
            add(shape.name, shape.link, shape.form, "arm", shape.placement)
    if tool is not None:
        add_tool("tool", robot.flange, tool, tool)
    for name, mesh in (("part", part), ("fixture", fixture)):
        if mesh is not None:
            given.append((name, "", mesh.copy().apply_transform(pose)))
            add(name, "", given[-1][2], name)
    outside, own = _list_pairs(solids, roles)
    own = own[:0] if not self_collision else np.delete(own, _find_drawn_touching(robot, solids, own), axis=0)
    return CollisionScene(robot, tuple(solids), outside, own, bodies=tuple(bodies), meshes=tuple(given))


def read_scene(job: Job, robot: Robot) -> CollisionScene | None:
    """Build the collision scene of a job; None if the job has no section [collision].

    Raises:
        InputError: If a mesh is missing or cannot be read, or a moving link of the arm has no collision shape.
    """
    table = job.collision
    if table is None:
        return None
    bodies = read_bodies(robot)
    check_bodies(bodies, table.without_shapes, robot.name, job.file)
    meshes = {}
    for name in ("part", "fixture", "tool"):
        file = getattr(table, name)
        if file is None:
            continue
        try:
            meshes[name] = load_mesh(job.folder / file, table.unit)
        except InputError as error:
            raise InputError(str(error), file=job.file, where=f"collision.{name}") from None
    notes: list[str] = []
    if table.without_shapes:
        unseen = ", ".join(f"{body.link}: {body.gap}" for body in bodies if body.link in table.without_shapes)
        notes.append(Stop(f"[collision] without_shapes excludes unknown parts of the arm from the check ({unseen})."))
    if job.tool is not None and "tool" not in meshes:
        capsule = stand_in_tool(robot)
        if capsule is not None:
            meshes["tool"] = capsule
            notes.append(
                f"No mesh of the tool is given: a capsule of {2e3 * CAPSULE_RADIUS:.0f} mm diameter (assumed) from "
                "the flange to the tool's tip is used for the clearance."
            )
    scene = build_scene(
        robot, **meshes, T_base_part=job.T_base_part, tip_zone=table.tip_zone_mm * 1e-3,
        bodies=leave_out(bodies, table.without_shapes),
    )  # fmt: skip
    return replace(scene, bodies=bodies, notes=tuple(notes))


def check_bodies(bodies: Sequence[BodyShapes], without: Sequence[str], robot: str, file: Path) -> None:
    """Check that every moving link has a plausible collision shape, except links that the job excludes.

    Raises:
        InputError: With the link, the fault of its shapes, and the remedy.
    """
    gaps = [body for body in bodies if body.gap]
    for number, link in enumerate(without):
        if link not in [body.link for body in gaps]:
            message = f"{link!r} names no link with missing or implausible shapes, those are {[b.link for b in gaps]}"
            raise InputError(message, file=file, where=f"collision.without_shapes[{number}]")
    open_ = [body for body in gaps if body.link not in without]
    if not open_:
        return
    more = f" and those of {', '.join(body.link for body in open_[1:])}" if open_[1:] else ""
    raise InputError(
        f"link {open_[0].link!r} of {robot} moves; {open_[0].gap}; its collisions{more} would be missed: correct "
        "robot.urdf, or put its meshes into meshes/ of the robot folder (compplan doctor lists every link), "
        "or name the links in collision.without_shapes",
        file=file, where="collision",
    )  # fmt: skip


def stand_in_tool(robot: Robot) -> Any:
    """Return a capsule from the flange to the tool's tip as a mesh, flange frame [m]; None where they coincide."""
    import trimesh

    tip = _tip_in(robot, robot.flange)
    length = float(np.linalg.norm(tip))
    if length < 1e-3:
        return None
    place = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], tip / length)
    place[:3, 3] = 0.5 * tip
    return trimesh.creation.capsule(height=length, radius=CAPSULE_RADIUS, count=[12, 12]).apply_transform(place)


def _list_pairs(solids: Sequence[Solid], roles: Sequence[str]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """List the pairs to check: arm and tool with part and fixture, and with the arm.

    Links of the arm with one link between them are not checked: joint limits separate them.
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


def _find_drawn_touching(robot: Robot, solids: Sequence[Solid], own: NDArray[np.int_]) -> list[int]:
    """List pairs of shapes of the arm that touch in most postures: these shapes overlap by design."""
    low, high = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = low + (high - low) * np.random.default_rng(0).random((40, robot.nq))
    touching = ([bool(contact.first) for contact in find_contacts(robot, solids, q, own[[k]], far=TOUCH)]
                for k in range(len(own)))  # fmt: skip
    return [k for k, hits in enumerate(touching) if np.mean(hits) >= DRAWN_TOUCHING]


def _tip_in(robot: Robot, link: str) -> Array:
    """Return the tool centre point in the frame of a link beyond the flange. Shape (3,). [m]"""
    frames = locate_links(robot, np.zeros((1, robot.nq)))
    return np.asarray((np.linalg.inv(frames[link][0]) @ frames[robot.tcp][0])[:3, 3])


class _Pair(NamedTuple):
    """Distance of two solids in one posture."""

    posture: int
    pair: int  #: Index into the pairs to check.
    distance: float  #: Negative where they overlap. [m]
    points: tuple[Array, Array]  #: Nearest points of both solids. Shape (3,) each. [m]
    normal: Array  #: Unit vector from the first to the second. Shape (3,).


def _measure_pair(solids: Sequence[Solid], frames: dict[str, Array], posture: int, pair: int, ends: Array) -> _Pair:
    """Compute the distance of two solids, the `ends` (2,) of a pair, in a posture."""
    import coal

    first, second = (solids[end] for end in ends)
    poses = [frames[s.link][posture] @ s.placement if s.link else s.placement for s in (first, second)]
    at, there = (coal.Transform3s(np.ascontiguousarray(pose[:3, :3]), pose[:3, 3].copy()) for pose in poses)
    result = coal.DistanceResult()
    distance = float(coal.distance(first.geometry, at, second.geometry, there, coal.DistanceRequest(), result))
    points = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
    normal = (points[1] - points[0]) / distance if distance > APART else np.array(result.normal)
    return _Pair(posture, pair, distance, points, normal)


def _find_nearest(
    solids: Sequence[Solid], frames: dict[str, Array], pairs: NDArray[np.int_], count: int, *, far: float, most: int
) -> list[_Pair]:
    """Find at most `most` pairs nearer than `far` [m] in each of `count` postures, nearest first."""
    bound, found = _bounds(solids, pairs, frames, count), list[_Pair]()
    for i in range(count):
        nearest: list[_Pair] = []
        for k in np.argsort(bound[i]):
            limit = far if len(nearest) < most else nearest[-1].distance
            if bound[i, k] >= limit:
                break
            pair = _measure_pair(solids, frames, i, int(k), pairs[k])
            if pair.distance < limit:
                nearest = sorted([*nearest, pair], key=lambda each: each.distance)[:most]
        found += nearest
    return found


def find_contacts(
    robot: Robot, solids: Sequence[Solid], q: Array, pairs: NDArray[np.int_], *, far: float = FAR
) -> list[Contact]:
    """Find the nearest pair of every posture q (n, nq); distances beyond `far` [m] are not computed.

    pairs: indices of the solids to check. Shape (p, 2).
    """
    contacts = [Contact("", "", far)] * len(q)
    for found in _find_nearest(solids, locate_links(robot, q), pairs, len(q), far=far, most=1):
        first, second = (solids[end].name for end in pairs[found.pair])
        contacts[found.posture] = Contact(first, second, found.distance)
    return contacts


def find_near(robot: Robot, solids: Sequence[Solid], q: Array, pairs: NDArray[np.int_], *, far: float) -> Near:
    """Find the nearest pairs of every posture q (n, nq), with the gradients of their distances in joint space.

    d = n . (p_b - p_a),   dd/dq = n . (J_b - J_a),

    p the nearest points, n the normal from a to b, J the Jacobian of such a point fixed to its link.
    Pairs beyond `far` [m] are left out.
    """
    frames = locate_links(robot, q)
    found = _find_nearest(solids, frames, pairs, len(q), far=far, most=MOST_PAIRS)
    posture, rate = np.array([each.posture for each in found], int), np.zeros((len(found), robot.nq))
    normal = np.array([each.normal for each in found]).reshape(-1, 3)
    for end, sign in ((0, -1.0), (1, 1.0)):
        point = np.array([each.points[end] for each in found]).reshape(-1, 3)
        links = [solids[pairs[each.pair][end]].link for each in found]
        rate += sign * _move_points(robot, frames, posture, links, point, normal)
    return Near(posture, np.array([each.distance for each in found]), rate)


def _move_points(
    robot: Robot, frames: dict[str, Array], posture: NDArray[np.int_], links: Sequence[str], point: Array, normal: Array
) -> Array:
    """Differentiate points of links along normals with respect to the joint positions. Shape (r, nq). [m/rad or 1]"""
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


def describe_contact(contact: Contact) -> str:
    """Format a contact as text."""
    if not contact.first:
        return "nothing is near"
    if contact.distance <= 0:
        return f"{contact.first} touches {contact.second}"
    return f"{contact.first} comes within {1e3 * contact.distance:.1f} mm of {contact.second}"


def _bounds(solids: Sequence[Solid], pairs: NDArray[np.int_], frames: dict[str, Array], n: int) -> Array:
    """Compute lower bounds of the distance of every pair by bounding spheres and fixed boxes. Shape (n, p). [m]"""
    centre = np.empty((len(solids), n, 3))
    for s, solid in enumerate(solids):
        pose = frames[solid.link] if solid.link else np.eye(4)[None]
        centre[s] = pose[:, :3, :3] @ solid.centre + pose[:, :3, 3]
    bound = np.empty((n, len(pairs)))
    for k, (a, b) in enumerate(pairs):
        first, second = solids[a], solids[b]
        gap = np.linalg.norm(centre[a] - centre[b], axis=1) - first.radius - second.radius
        for fixed, moving in ((second, a), (first, b)):
            if not fixed.link:
                outside = np.maximum(fixed.box[0] - centre[moving], centre[moving] - fixed.box[1])
                away = np.linalg.norm(np.maximum(outside, 0), axis=1)
                gap = np.maximum(gap, away - solids[moving].radius)
        bound[:, k] = gap
    return bound
