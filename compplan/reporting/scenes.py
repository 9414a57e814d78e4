"""3D scenes: a robot from the shapes of its URDF, paths by kind of move, deviations as colour and shape."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.io.palette import AFTER, BEFORE, NEUTRAL
from compplan.io.quantities import format_length
from compplan.reporting.along_path import FLOOR
from compplan.reporting.charts import SEQUENTIAL, Figure, mark_decades, thin_path
from compplan.robot import Array, Robot
from compplan.robot.description import find_mesh
from compplan.robot.pose import follow_joints
from compplan.robot.shapes import load_form
from compplan.robot.solids import triangulate, triangulate_rod
from compplan.robot.urdf import Colour, read_urdf

#: Colours of part, fixture and tool, and the greatest number of triangles drawn without simplification.
MESH_COLOURS = {
    "part": (0.80, 0.68, 0.45, 0.7), "fixture": (0.45, 0.55, 0.62, 0.7), "tool": (0.55, 0.55, 0.60, 1.0),
}  # fmt: skip
FINEST = 20_000
UNPAINTED = (0.62, 0.65, 0.68, 1.0)
#: Least distance from flange to TCP drawn as a rod if the URDF has no tool; length and radius of the thin end of that
#: rod (assumed). [m]
SHORTEST_ROD, CUTTER = 0.01, (0.04, 0.003)
#: Colour of the rod.
ROD = (0.55, 0.57, 0.6, 1.0)
#: Direction towards the light, base axes, and share of ambient light.
LIGHT, AMBIENT = np.array([0.35, -0.5, 0.79]), 0.45
#: Camera position of a scene, base axes.
EYE = np.array([1.16, -1.40, 0.84])
#: Approximate number of drawn points of a path in a scene.
POINTS = 3500
#: Approximate drawn length of the largest deviation, as a share of the extent of the path.
DRAWN_SHARE = 0.09
#: Kinds of moves with colour and line width [px].
KINDS = (("cut with force", AFTER, 7), ("cut without force", BEFORE, 5), ("rapid", NEUTRAL, 2))
#: Greatest number of decades of deviation on the colour scale.
DECADES = 5.0


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one shape."""

    link: str  #: Link of the shape, "" if it does not move.
    vertices: Array  #: In the robot base frame; in a recording, in the frame of the link. Shape (v, 3). [m]
    faces: NDArray[np.int_]  #: Corners of each triangle. Shape (f, 3).
    colour: Colour  #: Red, green, blue, opacity, each from 0 to 1.
    name: str = ""  #: Name of the shape, if other than the link.


def locate_links(robot: Robot, q: Array) -> dict[str, Array]:
    """Locate every link of the URDF at joints q (nq,) [rad or m]; joints outside the chain are at zero.

    Returns the pose of each link frame in the robot base frame, by link name; in the ground frame if a positioner
    carries the part. Shape (4, 4) each. [m]
    """
    q = np.asarray(q, float)
    if q.shape != (robot.nq,):
        raise ShapeError(f"q has shape {q.shape}, expected ({robot.nq},)")
    poses = follow_joints(robot.base, robot.joints, dict(zip(robot.joint_names, q, strict=True)))
    for link, (carrier, pose, _) in carry_links(robot, poses).items():
        poses[link] = poses[carrier] @ pose
    back = np.linalg.inv(poses[robot.ground or robot.base])
    return {link: back @ pose for link, pose in poses.items()} if robot.ground else poses


def carry_links(robot: Robot, chain: Collection[str]) -> dict[str, tuple[str, Array, bool]]:
    """Find the chain link that carries each link, as `Urdf.carriers`; the tool of a job replaces that of the folder."""
    mounted = robot.flange if robot.tcp == "tool_tcp" else ""
    return read_urdf(robot.urdf, Path(robot.name) / "robot.urdf").carriers(chain, mounted)


def place_shapes(robot: Robot, q: Array) -> list[Shape]:
    """Build the triangles of a robot at joints q (nq,), one entry per visual; meshes without a file are left out.

    The tool of a job replaces the tool of the folder: links attached to the flange in the URDF are then left out, and a
    rod from flange to tool centre point is drawn.
    """
    poses, shapes = locate_links(robot, q), list[Shape]()
    for shape in read_urdf(robot.urdf, Path(robot.name) / "robot.urdf").shapes:
        missing = shape.form[0] == "mesh" and find_mesh(shape.form[1], robot.folder) is None
        if shape.kind == "visual" and shape.link in poses and not missing:
            vertices, faces = triangulate(load_form(shape.form, robot.folder))
            pose = poses[shape.link] @ shape.placement
            vertices = vertices @ pose[:3, :3].T + pose[:3, 3]
            shapes.append(Shape(shape.link, vertices, faces, shape.colour or UNPAINTED))
    links = [robot.base, *(joint.child for joint in robot.joints)]
    behind = set(links[links.index(robot.flange) + 1 :])
    start, end = poses[robot.flange][:3, 3], poses[robot.tcp][:3, 3]
    long = float(np.linalg.norm(end - start))
    if behind & {shape.link for shape in shapes} or long < SHORTEST_ROD:
        return shapes
    neck = end + (start - end) * min(0.5, CUTTER[0] / long)  # thin end, so that the cut stays visible
    holder, sides = triangulate_rod(start, neck, 0.02, sections=20)
    cutter, more = triangulate_rod(neck, end, CUTTER[1], sections=20)
    return [*shapes, Shape(robot.tcp, np.vstack([holder, cutter]), np.vstack([sides, more + len(holder)]), ROD)]


def place_meshes(robot: Robot, q: Array, meshes: Sequence[tuple[str, str, Any]]) -> list[Shape]:
    """Place meshes of a cell at joints q; meshes: name, carrying link or "", and mesh in the frame of the link [m]."""
    poses, shapes = locate_links(robot, q), []
    for name, link, mesh in meshes:
        pose, (corners, faces) = poses[link or robot.base], simplify_mesh(mesh)
        shapes.append(Shape(name, corners @ pose[:3, :3].T + pose[:3, 3], faces, MESH_COLOURS[name]))
    return shapes


def simplify_mesh(mesh: Any) -> tuple[Array, NDArray[np.int_]]:
    """Return corners and triangles of a mesh; of its convex hull if it has more than `FINEST` triangles."""
    plain = mesh if len(mesh.faces) <= FINEST else mesh.convex_hull
    return np.asarray(plain.vertices, float), np.asarray(plain.faces, int)


def add_shapes(figure: Figure, shapes: Sequence[Shape], name: str, opacity: float, panel: int = 0) -> None:
    """Add shapes to a scene as one trace, in millimetres."""
    if not shapes:
        return
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    x, y, z = 1e3 * np.vstack([shape.vertices for shape in shapes]).T
    i, j, k = np.vstack([shape.faces + start for shape, start in zip(shapes, starts, strict=True)]).T
    paint = np.round(255 * shade_faces(shapes)).astype(int)
    figure.add(
        "mesh3d", panel, x=x, y=y, z=z, i=i, j=j, k=k, opacity=opacity, name=name, hoverinfo="name",
        facecolor=[f"rgb({red},{green},{blue})" for red, green, blue in paint],
        lighting={"ambient": 1.0, "diffuse": 0.0, "specular": 0.0, "fresnel": 0.0},
    )  # fmt: skip


def shade_faces(shapes: Sequence[Shape]) -> Array:
    """Compute the face colours of shapes under directional and ambient light. Shape (f, 3), from 0 to 1."""
    colours = []
    for shape in shapes:
        corner = shape.vertices[shape.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        light = AMBIENT + (1 - AMBIENT) * (0.5 + 0.5 * normal @ LIGHT)
        colours.append(np.clip(np.asarray(shape.colour[:3]) * light[:, None] + 0.06 * light[:, None], 0, 1))
    return np.vstack(colours)


def frame_scenes(figure: Figure, points: Array, *, margin: float = 0.03, size: float = 2.1, top: float = 0.0) -> None:
    """Set equal scales and ranges for points (n, 3) [mm] on the axes of every scene of a figure.

    margin: free space as a share of the extent; size: diagonal of the drawn box; top: space above the scenes [px].
    """
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    room = margin * max(float((high - low).max()), 1e-6)
    extent = high - low + 2 * room
    ratio = size * extent / float(np.linalg.norm(extent))
    scene: dict[str, Any] = {
        f"{axis}axis": {
            "title": {"text": f"{axis}, mm"}, "range": [float(low[k] - room), float(high[k] + room)],
            "nticks": max(2, round(6 * float(ratio[k] / ratio.max()))),
        }
        for k, axis in enumerate("xyz")
    }  # fmt: skip
    scene["aspectmode"], scene["aspectratio"] = "manual", dict(zip("xyz", ratio.tolist(), strict=True))
    eye = dict(zip("xyz", EYE.tolist(), strict=True))
    scene["camera"] = {"eye": eye, "projection": {"type": "orthographic"}}
    for key in [key for key in figure.layout if key.startswith("scene")]:
        figure.layout[key] |= scene
    figure.layout["margin"] = {"l": 0, "r": 0, "t": top, "b": 0}


def add_path(
    figure: Figure, points: Array, name: str, colour: str | Array, width: float, *, panel: int = 0, custom: Any = None,
    hover: str | None = None, **line: Any,
) -> None:  # fmt: skip
    """Add a line through points (n, 3) [mm] to a scene; NaN leaves a gap.

    colour: of the line, or a value at each point; width [px]; hover: template of the text for the custom data.
    """
    words = {"hoverinfo": "skip"} if hover is None else {"hovertemplate": hover}
    figure.add(
        "scatter3d", panel, **dict(zip("xyz", points.astype(np.float32).T, strict=True)), mode="lines", name=name,
        line={"color": colour, "width": width, **line}, customdata=custom, **words,
    )  # fmt: skip


def add_moves(
    figure: Figure, position: Array, kind: NDArray[np.int_], styles: Sequence[tuple[str, str, float]],
    limit: int = POINTS, hover: str | None = None,
) -> Array:  # fmt: skip
    """Add a path by kinds of moves, one line per kind, and return the drawn points [mm].

    position: shape (n, 3) [m]; kind: index into `styles` of the move to each waypoint, shape (n,); styles: name, colour
    and width of each; limit: approximate number of drawn points.
    """
    rows = thin_path(position, np.column_stack([position, 1e-3 * kind]), limit)
    points, waypoint = 1e3 * position[rows], rows[:, None].astype(np.float32)
    for number, (name, colour, width) in enumerate(styles):
        if (kind[1:] == number).any():
            mine = kind[rows] == number
            mine[0] = False
            mine |= np.r_[mine[1:], False]  # a move begins at the waypoint before
            shown = np.where(mine[:, None], points, np.nan)
            add_path(figure, shown, name, colour, width, custom=waypoint, hover=hover)
    figure.layout["legend"] = {"x": 0.01, "y": 0.01, "xanchor": "left", "yanchor": "bottom"}
    return points


def draw_cell(
    robot: Robot, q: Array, path: Array, *, start: int = 0, around: Sequence[Shape] = (),
    kinds: NDArray[np.int_] | None = None, beside: Array | None = None,
) -> Figure:  # fmt: skip
    """Draw the robot at one waypoint, its path, and the shapes around it: part, fixture, tool.

    q: commanded joints, shape (n, nq); path: nominal path of the tip, base frame, shape (n, 3) [m]; kinds: index
    into `KINDS` of the move to each waypoint; beside: further points within the view, (k, 3) [m].
    """
    figure, own = Figure(scenes=True), place_shapes(robot, q[start])
    add_shapes(figure, own, robot.name, 1.0)
    for shape in around:
        add_shapes(figure, [shape], shape.link, shape.colour[3])
    carried = locate_links(robot, q[start])[robot.base]
    seen = path @ carried[:3, :3].T + carried[:3, 3] if robot.ground else path
    points = add_moves(figure, seen, np.zeros(len(path), int) if kinds is None else kinds, KINDS)
    room = [] if beside is None else [1e3 * beside]
    frame_scenes(figure, np.vstack([points, *room, *(1e3 * shape.vertices for shape in (*own, *around))]))
    figure.layout["showlegend"] = kinds is not None
    return figure


def draw_deviation_paths(
    path: Array, before: Array, after: Array, *, names: tuple[str, str] = ("before", "after")
) -> Figure:
    """Draw the path twice, with the deviation before and after as colour and, magnified, as shape; (n, 3) each [m]."""
    sizes = [np.linalg.norm(deviation, axis=1) for deviation in (before, after)]
    rows = thin_path(path, np.column_stack([before, *sizes]), POINTS)
    titles = [f"{name}: largest {format_length(float(size.max()))}" for name, size in zip(names, sizes, strict=True)]
    figure = Figure(titles, 2, gaps=(0.01, 0.0), scenes=True)
    nominal, factor = 1e3 * path[rows], choose_magnification(path, before)
    shown = [nominal]
    for panel, (deviation, size) in enumerate(zip((before, after), sizes, strict=True)):
        shown.append(nominal + 1e3 * factor * deviation[rows])
        add_path(figure, nominal, "nominal", NEUTRAL, 2, panel=panel)
        add_path(
            figure, shown[-1], names[panel], np.log10(np.maximum(size[rows], FLOOR)), 6, panel=panel,
            custom=np.column_stack([rows, 1e3 * size[rows]]), coloraxis="coloraxis",
            hover="waypoint %{customdata[0]:.0f}: %{customdata[1]:.4g} mm",
        )  # fmt: skip
    frame_scenes(figure, np.vstack(shown), margin=0.02, size=1.75, top=30)  # space for the z labels
    both = np.log10(np.maximum(sizes, FLOOR))
    top = float(both.max())
    bottom = min(max(float(both.min()), top - DECADES), top - 1.0)
    ticks, words = mark_decades(10**bottom, 10**top)
    marks = {"tickvals": [float(np.log10(tick)) for tick in ticks], "ticktext": words}
    figure.layout |= {"coloraxis": colour_axis("deviation", bottom, top, **marks), "showlegend": False}
    return figure


def colour_axis(title: str, low: float, high: float, **bar: Any) -> dict[str, Any]:
    """Return the colour axis of values from low to high, with its bar."""
    style = {"title": {"text": title, "side": "top"}, "len": 0.8, "thickness": 12, "outlinewidth": 0}
    return {"colorscale": [list(stop) for stop in SEQUENTIAL], "cmin": low, "cmax": high, "colorbar": {**style, **bar}}


def choose_magnification(path: Array, deviation: Array) -> float:
    """Choose 1, 2 or 5 times a power of ten that makes the largest deviation visible; both (n, 3) [m]."""
    largest = float(np.linalg.norm(deviation, axis=1).max(initial=0))
    extent = float(np.ptp(path, axis=0).max())
    if largest < 1e-12 or extent == 0:
        return 1.0
    wanted = max(DRAWN_SHARE * extent / largest, 1.0)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)) * power)


def describe_magnification(path: Array, deviation: Array) -> str:
    """Describe the magnification of the drawn deviation."""
    factor = choose_magnification(path, deviation)
    return "to scale" if factor == 1 else f"magnified {factor:g} times"
