"""The collision shapes of an arm, body by body: what was read, what was dropped and why, and where none is known.

A body is a link behind a moving joint together with all that is fixed to it. A shape that cannot be read hides a part
of the arm from the collision check; so does a shape whose size does not fit the kinematics, such as a mesh that is
scaled twice. Nothing here decides: `gap` says in words what a check would not see.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.robot import Array, Robot
from compplan.robot.description import find_mesh
from compplan.robot.pose import build_pose
from compplan.robot.solids import UrdfShape

#: A body without shapes, visuals and mass whose next joint is nearer than this is a mere frame. [m]
FRAME = 0.03
#: A body is too large where its shapes together are longer than the whole arm; too small where the largest is shorter
#: than this share of the arm, or all end to end than this share of the way to the next joint where that is a long one
#: (assumed; the bodies of 42 arms measure at least 1/35 of the arm and 1/2 of such a way).
SMALLEST, SHORTEST, LONG_WAY = 0.01, 0.125, 0.1


@dataclass(frozen=True)
class BodyShapes:
    """What is known of the collision shapes of a body.

    Attributes:
        link: The link that its joint moves, or the base.
        moves: Whether a joint moves it.
        shapes: What was read, each with a link of the chain that carries it.
        dropped: Why a shape was not read, one entry a shape.
        unknown: Whether it moves, is no mere frame and the URDF gives it no shape.
        doubt: How the size of its shapes contradicts the kinematics; "" where it does not.

    """

    link: str
    moves: bool
    shapes: tuple[UrdfShape, ...] = ()
    dropped: tuple[str, ...] = ()
    unknown: bool = False
    doubt: str = ""

    @property
    def gap(self) -> str:
        """Say what a collision check would not see of it; "" where it sees everything, and of what never moves."""
        if not self.moves:
            return ""
        if self.dropped:
            of = len(self.shapes) + len(self.dropped)
            return f"{len(self.dropped)} of its {of} collision shapes cannot be read ({self.dropped[0]})"
        return "has no collision shape" if self.unknown else self.doubt

    @property
    def count(self) -> dict[str, int]:
        """How many shapes were read and dropped, and whether none is known where one is expected."""
        return {"read": len(self.shapes), "dropped": len(self.dropped), "unknown": int(self.unknown)}


@dataclass
class _Body:
    """A body while its links are gathered: pose of each of its links in the frame that its joint moves."""

    link: str
    moves: bool
    poses: dict[str, Array]
    way: float = 0.0
    shapes: list[UrdfShape] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    shown: bool = False


def read_bodies(robot: Robot) -> tuple[BodyShapes, ...]:
    """Read the collision shapes of every body of the arm, from the base on.

    What hangs beside the chain counts with the body that carries it where it is fixed to that; where a joint moves it,
    its shapes are dropped, for nobody says where they are. A tool that a job mounts replaces what the URDF hangs there.

    Args:
        robot: The robot.

    """
    root = ElementTree.fromstring(robot.urdf)
    bodies = _gather(robot)
    home = {link: body for body in bodies for link in body.poses}
    carriers, loose = _find_beside(robot, root, set(home))
    masses = {body.link for body in robot.bodies if body.mass > 0.0}
    for element in root.findall("link"):
        link = element.attrib["name"]
        carrier, pose = carriers.get(link, (link, np.eye(4)))
        if carrier not in home:
            continue
        body = home[carrier]
        body.shown = body.shown or element.find("visual") is not None or link in masses
        elements = element.findall("collision")
        for number, shape in enumerate(elements):
            if link in loose:
                body.dropped.append(f"{link} hangs on a joint beside the chain")
                continue
            name = link if len(elements) == 1 else f"{link} ({number + 1})"
            try:
                form = read_form(shape.find("geometry"), robot.folder)
            except InputError as error:
                body.dropped.append(f"{name}: {error}" if carrier != link else str(error))
                continue
            body.shapes.append(UrdfShape(name, carrier, form, pose @ read_origin(shape.find("origin"))))
    return tuple(_judge(body, robot.longest_reach) for body in bodies)


def leave_out(bodies: Sequence[BodyShapes], links: Sequence[str]) -> tuple[BodyShapes, ...]:
    """Return bodies of which those that are named lose shapes whose size is in doubt."""
    return tuple(replace(body, shapes=()) if body.link in links and body.doubt else body for body in bodies)


def describe_shapes(bodies: Sequence[BodyShapes]) -> str:
    """Say how many collision shapes of each body were read, dropped and are unknown."""
    told = []
    for body in bodies:
        words = [str(len(body.shapes))]
        words += [f"{len(body.dropped)} dropped: {body.dropped[0]}"] if body.dropped else []
        words += ["unknown"] if body.unknown else []
        told.append(f"{body.link} {words[0]}" + (f" ({', '.join(words[1:])})" if words[1:] else ""))
    return ", ".join(told)


def read_form(geometry: ElementTree.Element | None, folder: Path | None) -> Any:
    """Read the geometry of a shape, as `UrdfShape` holds it.

    Args:
        geometry: The <geometry>.
        folder: Folder of the URDF; meshes are looked for there.

    Raises:
        InputError: If it is of no known form, or a mesh that is not found or cannot be read.

    """
    if geometry is None or not len(geometry):
        raise InputError("no geometry")
    shape = geometry[0]
    if shape.tag == "box":
        return ("box", _numbers(shape, "size"))
    if shape.tag in ("cylinder", "capsule"):
        return (shape.tag, float(shape.attrib["radius"]), float(shape.attrib["length"]))
    if shape.tag == "sphere":
        return ("sphere", float(shape.attrib["radius"]))
    name = shape.attrib.get("filename", "")
    file = find_mesh(name, folder)
    if file is None:
        raise InputError(f"mesh {name!r} is not found")
    return load_mesh(file, "m").apply_scale(_numbers(shape, "scale", "1 1 1"))


def read_origin(element: ElementTree.Element | None) -> Array:
    """Read an <origin> that is known to be sound. Shape (4, 4) [m]."""
    if element is None:
        return np.eye(4)
    turn = Rotation.from_euler("xyz", _numbers(element, "rpy", "0 0 0"))
    return build_pose(_numbers(element, "xyz", "0 0 0"), turn.as_matrix())


def _gather(robot: Robot) -> list[_Body]:
    """Part the chain into bodies, with the way from each body's joint to the next one."""
    bodies = [_Body(robot.base, False, {robot.base: np.eye(4)})]
    for joint in robot.joints:
        last = bodies[-1]
        pose = last.poses[joint.parent] @ joint.placement
        last.way = float(np.linalg.norm(pose[:3, 3]))
        if joint.kind == "fixed":
            last.poses[joint.child] = pose
        else:
            bodies.append(_Body(joint.child, True, {joint.child: np.eye(4)}))
    return bodies


def _find_beside(
    robot: Robot, root: ElementTree.Element, chain: set[str]
) -> tuple[Mapping[str, tuple[str, Array]], set[str]]:
    """Find the links beside the chain: the link that carries each, its pose there, and those that joints move."""
    carriers: dict[str, tuple[str, Array]] = {}
    loose: set[str] = set()
    hanging: dict[str, list[ElementTree.Element]] = {}
    for element in root.findall("joint"):
        parent = element.find("parent")
        hanging.setdefault("" if parent is None else parent.attrib["link"], []).append(element)
    replaced = robot.flange if robot.tcp == "tool_tcp" else ""
    waiting = [link for link in chain if link != replaced]
    while waiting:
        above = waiting.pop()
        for element in hanging.get(above, ()):
            child = element.find("child")
            below = "" if child is None else child.attrib["link"]
            if below in chain:
                continue
            carrier, pose = carriers.get(above, (above, np.eye(4)))
            carriers[below] = carrier, pose @ read_origin(element.find("origin"))
            if element.get("type") != "fixed" or above in loose:
                loose.add(below)
            waiting.append(below)
    return carriers, loose


def _judge(body: _Body, reach: float) -> BodyShapes:
    """Say whether a body lacks shapes, and whether their size fits the kinematics."""
    given = body.shapes or body.dropped
    unknown = body.moves and not given and (body.shown or body.way > FRAME)
    found = BodyShapes(body.link, body.moves, tuple(body.shapes), tuple(body.dropped), unknown)
    if not body.shapes:
        return found
    placed = ((shape.mesh().vertices, body.poses[shape.link]) for shape in body.shapes)
    points = np.vstack([vertices @ pose[:3, :3].T + pose[:3, 3] for vertices, pose in placed])
    whole = float(np.linalg.norm(np.ptp(points, axis=0)))
    sizes = [float(np.linalg.norm(np.ptp(shape.mesh().vertices, axis=0))) for shape in body.shapes]
    spans = body.way > LONG_WAY * reach
    if whole > reach:
        doubt = f"its shape is {whole:.3g} m long, the whole arm {reach:.3g} m: a mesh in mm, or a wrong scale?"
    elif max(sizes) < SMALLEST * reach or (spans and sum(sizes) < SHORTEST * body.way):
        way = f" on a way of {1e3 * body.way:.3g} mm to its next joint" if spans else ""
        doubt = f"its largest shape measures {1e3 * max(sizes):.3g} mm{way}: scaled twice, or a wrong scale?"
    else:
        return found
    return replace(found, doubt=doubt)


def _numbers(element: ElementTree.Element, key: str, default: str = "") -> list[float]:
    return [float(value) for value in element.attrib.get(key, default).split()]
