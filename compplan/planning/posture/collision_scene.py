"""The collision scene of a job: the arm, its tool, the part, the fixture, and which of them may not touch.

Part, fixture and tool are meshes; the arm is its URDF's collision shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.io.notes import Stop
from compplan.planning.posture.contacts import Solid, find_contacts, locate_all_links
from compplan.robot import Array, Robot
from compplan.robot.shapes import BodyShapes, leave_out, read_bodies
from compplan.robot.solids import cut_tip, make_geometry

if TYPE_CHECKING:
    from compplan.job.job import Job

#: Arm and tool touch the arm where they come nearer than this. [m]
TOUCH = 1e-3
#: Radius of the capsule that stands for a tool without a mesh. [m]
STAND_IN_RADIUS = 0.025
#: A pair of the arm's own shapes that touches in this share of random postures is left out: they are drawn so.
DRAWN_TOUCHING = 0.7


@dataclass(frozen=True)
class CollisionScene:
    """What may touch what."""

    robot: Robot  #: The robot with its tool.
    solids: tuple[Solid, ...]  #: Shapes of the arm, tool, part, fixture.
    outside: NDArray[np.int_]  #: Pairs of arm or tool with part or fixture. Shape (p, 2).
    own: NDArray[np.int_]  #: Pairs of arm or tool with the arm itself. Shape (o, 2).
    notes: tuple[str, ...] = ()  #: What a user should know of it, one sentence each.
    bodies: tuple[BodyShapes, ...] = ()  #: What is known of the collision shapes of each body of the arm.
    #: What was given, to be drawn: name, link that carries it ("" where it stands still), and mesh [m].
    meshes: tuple[tuple[str, str, Any], ...] = ()

    @cached_property
    def reach(self) -> Array:
        """Farthest that any point moves per motion of a joint: shape (nq,) [m/rad or 1]."""
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
    part; `bodies` are the collision shapes of the arm, those of the robot's URDF if left out.
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

    for shape in (shape for entry in bodies for shape in entry.shapes):
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
            given.append((name, "", mesh.copy().apply_transform(pose)))
            add(name, "", given[-1][2], name)
    outside, own = _list_pairs(solids, roles)
    own = own[:0] if not self_collision else np.delete(own, _find_drawn_touching(robot, solids, own), axis=0)
    return CollisionScene(robot, tuple(solids), outside, own, bodies=tuple(bodies), meshes=tuple(given))


def read_scene(job: Job, robot: Robot) -> CollisionScene | None:
    """Build the scene that a job describes; None where it has no table [collision].

    Raises:
        InputError: If a mesh is missing or cannot be read, or a part of the arm that moves would not be seen.
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
                f"No mesh of the tool is given: a capsule of {2e3 * STAND_IN_RADIUS:.0f} mm diameter (assumed) from "
                "the flange to the tool's tip is used for the clearance."
            )
    scene = build_scene(
        robot, **meshes, T_base_part=job.T_base_part, tip_zone=table.tip_zone_mm * 1e-3,
        bodies=leave_out(bodies, table.without_shapes),
    )  # fmt: skip
    return replace(scene, bodies=bodies, notes=tuple(notes))


def check_bodies(bodies: Sequence[BodyShapes], without: Sequence[str], robot: str, file: Path) -> None:
    """Refuse an arm of which a collision check would not see a part that moves, unless the job names that link.

    Raises:
        InputError: With the link, what is wrong with its shapes, and what to do.
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
    return trimesh.creation.capsule(height=length, radius=STAND_IN_RADIUS, count=[12, 12]).apply_transform(place)


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


def _find_drawn_touching(robot: Robot, solids: Sequence[Solid], own: NDArray[np.int_]) -> list[int]:
    """List pairs of the arm's own shapes that touch in most postures: the drawing overlaps there."""
    low, high = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = low + (high - low) * np.random.default_rng(0).random((40, robot.nq))
    touching = ([bool(contact.first) for contact in find_contacts(robot, solids, q, own[[k]], far=TOUCH)]
                for k in range(len(own)))  # fmt: skip
    return [k for k, hits in enumerate(touching) if np.mean(hits) >= DRAWN_TOUCHING]


def _tip_in(robot: Robot, link: str) -> Array:
    """Return the tool centre point in the frame of a link behind the flange: shape (3,) [m]."""
    frames = locate_all_links(robot, np.zeros((1, robot.nq)))
    return np.asarray((np.linalg.inv(frames[link][0]) @ frames[robot.tcp][0])[:3, 3])
