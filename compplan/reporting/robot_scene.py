"""Draw a robot from the shapes of its URDF: boxes, cylinders, spheres, and meshes where their files are at hand.

`place_shapes` gives triangles in the robot base frame; `draw_robot` turns them into plotly traces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.reporting import figure as go
from compplan.robot import Array, Joint, Robot
from compplan.robot.description import find_mesh
from compplan.robot.pose import move_joint
from compplan.robot.shapes import read_form, read_origin
from compplan.robot.solids import as_mesh, read_colour, triangulate_box, triangulate_rod

#: Colours of part, fixture and tool, and the most triangles of one of them that are drawn as they are.
MESH_COLOURS = {
    "part": (0.80, 0.68, 0.45, 0.7), "fixture": (0.45, 0.55, 0.62, 0.7), "tool": (0.55, 0.55, 0.60, 1.0),
}  # fmt: skip
FINEST = 20_000
UNPAINTED = (0.62, 0.65, 0.68, 1.0)
#: Least distance from flange to TCP that is drawn as a rod where the URDF shows no tool. [m]
SHORTEST_ROD = 0.01
#: Its colour, and length and radius of its thin end, of no cutter in particular. [m]
ROD, CUTTER = (0.55, 0.57, 0.6, 1.0), (0.04, 0.003)
#: Where the light comes from, base axes, and the share of light without a direction.
LIGHT = np.array([0.35, -0.5, 0.79])
AMBIENT = 0.45
#: Where a scene is looked at from, base axes.
EYE = np.array([1.16, -1.40, 0.84])


@dataclass(frozen=True)
class Shape:
    """Triangles of one visual in the robot base frame.

    Attributes:
        link: Link that it belongs to.
        vertices: Shape (v, 3). [m]
        faces: Corners of each triangle. Shape (f, 3).
        colour: Red, green, blue, opacity, each from 0 to 1.
    """

    link: str
    vertices: Array
    faces: NDArray[np.int_]
    colour: tuple[float, float, float, float]


def locate_links(robot: Robot, q: Array) -> dict[str, Array]:
    """Locate every link of the URDF at a pose; joints beside the chain stand at zero.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]

    Returns:
        Pose of each link's frame in the robot base frame, by the link's name; where a positioner carries the part, in
        the frame of the ground. Shape (4, 4) each. [m]

    Raises:
        ShapeError: If q does not have the shape above.
    """
    q = np.asarray(q, float)
    if q.shape != (robot.nq,):
        raise ShapeError(f"q has shape {q.shape}, expected ({robot.nq},)")
    poses = follow_joints(robot.base, robot.joints, dict(zip(robot.joint_names, q, strict=True)))
    _locate_beside(robot, poses)
    back = np.linalg.inv(poses[robot.ground or robot.base])
    return {link: back @ pose for link, pose in poses.items()} if robot.ground else poses


def follow_joints(base: str, joints: Sequence[Joint], value: Mapping[str, float]) -> dict[str, Array]:
    """Locate the links of a chain; shape (4, 4) each [m].

    Args:
        base: Link that stands still.
        joints: Joints from there, each after the one that carries it.
        value: Positions of the actuated ones, by name. [rad or m]
    """
    poses = {base: np.eye(4)}
    for joint in joints:
        position = value.get(joint.name, 0.0)
        if joint.mimic is not None:
            position = joint.mimic.multiplier * value[joint.mimic.joint] + joint.mimic.offset
        poses[joint.child] = poses[joint.parent] @ joint.placement @ move_joint(joint, position)
    return poses


def place_shapes(robot: Robot, q: Array) -> list[Shape]:
    """Build the triangles of a robot at a pose.

    A tool that a job mounts takes the place of the folder's tool: what the URDF hangs on the flange is then left out,
    and a rod from flange to tool centre point is drawn.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]

    Returns:
        One entry a visual; visuals whose mesh file is missing are left out.

    Raises:
        ShapeError: If q does not have the shape above.
    """
    root = ElementTree.fromstring(robot.urdf)
    paints = {
        element.attrib["name"]: _colour(element) for element in root.findall("material") if "name" in element.attrib
    }
    poses = locate_links(robot, q)
    shapes = []
    for link in root.findall("link"):
        name = link.attrib["name"]
        for visual in link.findall("visual") if name in poses else ():
            triangles = _triangulate(visual.find("geometry"), robot.folder)
            if triangles is None:
                continue
            pose = poses[name] @ read_origin(visual.find("origin"))
            vertices = triangles[0] @ pose[:3, :3].T + pose[:3, 3]
            shapes.append(Shape(name, vertices, triangles[1], _paint_of(visual, paints)))
    rod = _rod(robot, poses, {shape.link for shape in shapes})
    return shapes if rod is None else [*shapes, rod]


def draw_robot(robot: Robot, q: Array, *, opacity: float = 1.0) -> list[Any]:
    """Draw a robot as plotly traces, in millimetres.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]
        opacity: From 0 (invisible) to 1.
    """
    shapes = place_shapes(robot, q)
    return [_draw_mesh(shapes, robot.name, opacity)] if shapes else []


def draw_shapes(shapes: Sequence[Shape]) -> list[Any]:
    """Draw single shapes as plotly traces, in millimetres, each under its own name."""
    return [_draw_mesh([shape], shape.link, shape.colour[3]) for shape in shapes]


def _draw_mesh(shapes: list[Shape], name: str, opacity: float) -> Any:
    """Draw shapes as one trace under a name, in millimetres."""
    vertices, faces = _join(shapes)
    x, y, z = (1e3 * vertices).astype(np.float32).T
    i, j, k = faces.astype(np.int32).T
    paint = np.round(255 * shade_faces(shapes)).astype(int)
    return go.Mesh3d(
        x=x, y=y, z=z, i=i, j=j, k=k,
        facecolor=[f"rgb({red},{green},{blue})" for red, green, blue in paint],
        opacity=opacity,
        lighting={"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0},
        name=name,
        hoverinfo="name",
    )  # fmt: skip


def place_meshes(robot: Robot, q: Array, meshes: Sequence[tuple[str, str, Any]]) -> list[Shape]:
    """Put meshes of a cell where they stand at a pose of the arm.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]
        meshes: Name, link that carries it or "", mesh in that link's frame or in the base frame [m]. Finer ones than
            `FINEST` are drawn as their convex hulls.

    """
    poses, shapes = locate_links(robot, q), []
    for name, link, mesh in meshes:
        plain = mesh if len(mesh.faces) <= FINEST else mesh.convex_hull
        pose = poses[link or robot.base]
        corners = np.asarray(plain.vertices, float) @ pose[:3, :3].T + pose[:3, 3]
        shapes.append(Shape(name, corners, np.asarray(plain.faces, int), MESH_COLOURS[name]))
    return shapes


def shade_faces(shapes: list[Shape]) -> Array:
    """Shade the faces of shapes as a light from above, front and left does. Shape (f, 3), from 0 to 1."""
    colours = []
    for shape in shapes:
        corner = shape.vertices[shape.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        light = AMBIENT + (1 - AMBIENT) * (0.5 + 0.5 * normal @ LIGHT)
        colours.append(np.clip(np.asarray(shape.colour[:3]) * light[:, None] + 0.06 * light[:, None], 0, 1))
    return np.vstack(colours)


def frame_scene(points: Array, *, margin: float = 0.03, size: float = 2.1) -> dict[str, Any]:
    """Build the plotly scene that shows points with one scale on all axes.

    Args:
        points: What has to be seen. Shape (n, 3). [mm]
        margin: Free room around it, as a share of its largest extent.
        size: How large the scene is drawn, whatever its proportions.
    """
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    room = margin * max(float((high - low).max()), 1e-6)
    extent = high - low + 2 * room
    ratio = size * extent / float(np.linalg.norm(extent))
    axes = {
        f"{axis}axis": {
            "title": {"text": f"{axis}, mm"},
            "range": [float(low[k] - room), float(high[k] + room)],
            "nticks": max(2, round(6 * float(ratio[k] / ratio.max()))),
        }
        for k, axis in enumerate("xyz")
    }
    return {
        **axes,
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", ratio.tolist(), strict=True)),
        "camera": {"eye": dict(zip("xyz", EYE.tolist(), strict=True)), "projection": {"type": "orthographic"}},
    }


def _join(shapes: list[Shape]) -> tuple[Array, NDArray[np.int_]]:
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    faces = [shape.faces + start for shape, start in zip(shapes, starts, strict=True)]
    return np.vstack([shape.vertices for shape in shapes]), np.vstack(faces)


def _locate_beside(robot: Robot, poses: dict[str, Array]) -> None:
    """Add the links that hang beside the chain; behind the flange only where the folder's own tool is mounted."""
    elements = ElementTree.fromstring(robot.urdf).findall("joint")
    mounted = robot.tcp == "tool_tcp"
    while True:
        added = False
        for element in elements:
            parent, child = element.find("parent"), element.find("child")
            if parent is None or child is None:
                continue
            above, below = parent.attrib["link"], child.attrib["link"]
            if below in poses or above not in poses or (mounted and above == robot.flange):
                continue
            poses[below] = poses[above] @ read_origin(element.find("origin"))
            added = True
        if not added:
            return


def _colour(element: ElementTree.Element) -> tuple[float, float, float, float]:
    colour = element.find("color")
    if colour is None:
        return UNPAINTED
    return read_colour(colour) or UNPAINTED


def _paint_of(
    visual: ElementTree.Element, paints: dict[str, tuple[float, float, float, float]]
) -> tuple[float, float, float, float]:
    material = visual.find("material")
    if material is None:
        return UNPAINTED
    if material.find("color") is not None:
        return _colour(material)
    return paints.get(material.attrib.get("name", ""), UNPAINTED)


def _triangulate(geometry: ElementTree.Element | None, folder: Path | None) -> tuple[Array, NDArray[np.int_]] | None:
    if geometry is None or not len(geometry):
        return None
    if geometry[0].tag == "mesh" and find_mesh(geometry[0].attrib.get("filename", ""), folder) is None:
        return None
    form = read_form(geometry, folder)
    if geometry[0].tag == "box":
        size = np.array(form[1])
        return triangulate_box(-0.5 * size, 0.5 * size)
    if geometry[0].tag == "cylinder":
        end = np.array([0.0, 0.0, 0.5 * form[2]])
        return triangulate_rod(-end, end, form[1], sections=28)
    mesh = as_mesh(form)
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, int)


def _rod(robot: Robot, poses: dict[str, Array], drawn: set[str]) -> Shape | None:
    """Draw a rod from flange to TCP where nothing else shows the tool; thin at its end, so that the cut is seen."""
    behind, links = False, []
    for joint in robot.joints:
        behind = behind or joint.parent == robot.flange
        if behind:
            links.append(joint.child)
    start, end = poses[robot.flange][:3, 3], poses[robot.tcp][:3, 3]
    if drawn & set(links) or np.linalg.norm(end - start) < SHORTEST_ROD:
        return None
    neck = end + (start - end) * min(0.5, CUTTER[0] / float(np.linalg.norm(end - start)))
    holder, sides = triangulate_rod(start, neck, 0.02, sections=20)
    cutter, more = triangulate_rod(neck, end, CUTTER[1], sections=20)
    return Shape(robot.tcp, np.vstack([holder, cutter]), np.vstack([sides, more + len(holder)]), ROD)
