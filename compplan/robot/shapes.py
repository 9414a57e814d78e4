"""Collision shapes of an arm by body, with dropped and unknown shapes.

A body is a link behind a moving joint with all links fixed to it. Unreadable shapes, and shapes whose size contradicts
the kinematics (such as a mesh scaled twice), hide parts of the arm from the collision check; `gap` describes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.robot import Array, Robot
from compplan.robot.description import find_mesh
from compplan.robot.solids import UrdfShape
from compplan.robot.urdf import read_urdf

#: Greatest distance to the next joint of a body without shapes, visuals and mass that counts as a frame. [m]
FRAME = 0.03
#: Least size of the largest shape of a body as a share of the arm, and of all its shapes as a share of a long way to
#: the next joint (assumed; 42 arms: at least 1/35 and 1/2). Shapes longer than the arm are too large.
SMALLEST, SHORTEST, LONG_WAY = 0.01, 0.125, 0.1


@dataclass
class BodyShapes:
    """Collision shapes of a body."""

    link: str  #: The link that its joint moves, or the base.
    moves: bool  #: Whether a joint moves it.
    poses: dict[str, Array]  #: Pose of each of its links in the frame that its joint moves. Shape (4, 4). [m]
    way: float = 0.0  #: Distance from its joint to the next one. [m]
    shapes: list[UrdfShape] = field(default_factory=list)  #: Shapes, each with the link of the chain that carries it.
    dropped: list[str] = field(default_factory=list)  #: Reason for each shape that was not read.
    shown: bool = False  #: Whether it has visuals or mass.
    size_fault: str = ""  #: Contradiction between the size of its shapes and the kinematics, or "".

    @property
    def unknown(self) -> bool:
        """Whether it is a moving body without any shape in the URDF."""
        given = self.shapes or self.dropped or self.size_fault
        return self.moves and not given and (self.shown or self.way > FRAME)

    @property
    def gap(self) -> str:
        """Describe the parts that a collision check would miss; "" without any, and for a fixed body."""
        if not self.moves:
            return ""
        if self.dropped:
            of = len(self.shapes) + len(self.dropped)
            return f"{len(self.dropped)} of its {of} collision shapes cannot be read ({self.dropped[0]})"
        return "has no collision shape" if self.unknown else self.size_fault

    @property
    def count(self) -> dict[str, int]:
        """Counts of shapes read and dropped, and whether shapes are unknown."""
        return {"read": len(self.shapes), "dropped": len(self.dropped), "unknown": int(self.unknown)}


def read_bodies(robot: Robot) -> tuple[BodyShapes, ...]:
    """Read the collision shapes of every body of the arm, from the base.

    Links fixed to the chain count with the body that carries them; shapes of links moved by joints outside the chain
    are dropped. A tool of the job replaces the links on the flange.

    Args:
        robot: The robot.

    """
    urdf = read_urdf(robot.urdf, Path(robot.name) / "robot.urdf")
    bodies = _gather(robot)
    home = {link: body for body in bodies for link in body.poses}
    carriers = urdf.carriers(home, robot.flange if robot.tcp == "tool_tcp" else "")
    seen = {shape.link for shape in urdf.shapes if shape.kind == "visual"}
    seen |= {body.link for body in robot.bodies if body.mass > 0.0}
    for body in bodies:
        body.shown = any(carrier in body.poses for link, (carrier, _, _) in carriers.items() if link in seen)
    for shape in urdf.shapes:
        if shape.kind != "collision" or shape.link not in carriers:
            continue
        carrier, pose, moved = carriers[shape.link]
        body = home[carrier]
        if moved:
            body.dropped.append(f"{shape.link} hangs on a joint beside the chain")
            continue
        try:
            form = load_form(shape.form, robot.folder)
        except InputError as error:
            body.dropped.append(f"{shape.name}: {error}" if carrier != shape.link else str(error))
            continue
        body.shapes.append(UrdfShape(shape.name, carrier, form, pose @ shape.placement))
    for body in bodies:
        body.size_fault = _find_size_fault(body, robot.longest_reach) if body.shapes else ""
    return tuple(bodies)


def leave_out(bodies: Sequence[BodyShapes], links: Sequence[str]) -> tuple[BodyShapes, ...]:
    """Return bodies without the implausible shapes of the named links."""
    return tuple(replace(body, shapes=[]) if body.link in links and body.size_fault else body for body in bodies)


def describe_shapes(bodies: Sequence[BodyShapes]) -> str:
    """Count the collision shapes of each body that were read, dropped and are unknown."""
    texts = []
    for body in bodies:
        words = [str(len(body.shapes))]
        words += [f"{len(body.dropped)} dropped: {body.dropped[0]}"] if body.dropped else []
        words += ["unknown"] if body.unknown else []
        texts.append(f"{body.link} {words[0]}" + (f" ({', '.join(words[1:])})" if words[1:] else ""))
    return ", ".join(texts)


def load_form(form: tuple[Any, ...], folder: Path | None) -> Any:
    """Return the form of a shape, a mesh loaded from the folder of the URDF (trimesh).

    Raises:
        InputError: If its mesh is missing or cannot be read.
    """
    if form[0] != "mesh":
        return form
    file = find_mesh(form[1], folder)
    if file is None:
        raise InputError(f"mesh {form[1]!r} is not found")
    return load_mesh(file, "m").apply_scale(form[2])


def _gather(robot: Robot) -> list[BodyShapes]:
    """Divide the chain into bodies, with the distance from each body's joint to the next one."""
    bodies = [BodyShapes(robot.base, False, {robot.base: np.eye(4)})]
    for joint in robot.joints:
        last = bodies[-1]
        pose = last.poses[joint.parent] @ joint.placement
        last.way = float(np.linalg.norm(pose[:3, 3]))
        if joint.kind == "fixed":
            last.poses[joint.child] = pose
        else:
            bodies.append(BodyShapes(joint.child, True, {joint.child: np.eye(4)}))
    return bodies


def _find_size_fault(body: BodyShapes, reach: float) -> str:
    """Return the contradiction between the size of a body's shapes and the kinematics, or ""."""
    placed = ((shape.vertices, body.poses[shape.link]) for shape in body.shapes)
    points = np.vstack([vertices @ pose[:3, :3].T + pose[:3, 3] for vertices, pose in placed])
    whole = float(np.linalg.norm(np.ptp(points, axis=0)))
    sizes = [float(np.linalg.norm(np.ptp(shape.vertices, axis=0))) for shape in body.shapes]
    spans = body.way > LONG_WAY * reach
    if whole > reach:
        return f"its shape is {whole:.3g} m long, the whole arm {reach:.3g} m: a mesh in mm, or a wrong scale?"
    if max(sizes) < SMALLEST * reach or (spans and sum(sizes) < SHORTEST * body.way):
        way = f" on a way of {1e3 * body.way:.3g} mm to its next joint" if spans else ""
        return f"its largest shape measures {1e3 * max(sizes):.3g} mm{way}: scaled twice, or a wrong scale?"
    return ""
