"""What the folder of a plan keeps for the viewer: cell.json and deviation.csv.

cell.json holds what stands in the cell and how the arm moves, so that neither robot folder nor job is needed:

    { "schema": 1, "robot":, "grade":, "tolerance_mm":, "configuration": {}, "base":, "tcp":,
      "ground": link that stands still where a positioner carries the part, "base" then the one that carries it; or "",
      "joints": [ { "name":, "kind": "revolute" | "prismatic" | "fixed", "parent":, "child":, "placement": [[4 x 4], m],
                    "axis": [3], "mimic": null | { "joint":, "multiplier":, "offset": } } ],   from the base to the TCP
      "shapes": [ { "name":, "link": "" where it stands still, "colour": [red, green, blue, opacity, from 0 to 1],
                    "vertices_mm": [[3]], "faces": [[3]] } ] }            in the frame of its link, or in the base frame

deviation.csv has the rows of joints.csv: attained minus wanted tip, base frame, uncorrected and as planned, and the
distance that holds the true tip with 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import write_json, write_table
from compplan.reporting.scenes import MESH_COLOURS, Shape, locate_links, place_shapes, read_parents, simplify_mesh
from compplan.robot import Robot
from compplan.robot.solids import triangulate_box

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: Colour of the stock.
STOCK_COLOUR = (0.66, 0.70, 0.74, 0.35)


def write_plan_cell(plan: Plan, folder: Path, kept: NDArray[np.bool_]) -> None:
    """Write cell.json and deviation.csv of a plan; `kept` are the rows that joints.csv holds."""
    scene = None if plan.task.start is None else plan.task.start.settings.scene
    shapes = [
        Shape(link, *simplify_mesh(mesh), MESH_COLOURS[name], name)
        for name, link, mesh in (() if scene is None else scene.meshes)
    ]
    shapes += _place_stock(plan)
    more = {"tolerance_mm": 1e3 * plan.task.tolerance, "configuration": dict(plan.task.configuration)}
    write_json(folder / "cell.json", {**summarise_cell(plan.robot, shapes), **more}, indent=None)
    write_deviation(plan, folder / "deviation.csv", kept)


def summarise_cell(robot: Robot, around: Sequence[Shape] = ()) -> dict[str, Any]:
    """Return what cell.json holds: how the arm moves, and what stands there."""
    joints = [
        {"name": joint.name, "kind": joint.kind, "parent": joint.parent, "child": joint.child,
         "placement": joint.placement.round(9), "axis": joint.axis,
         "mimic": None if joint.mimic is None else asdict(joint.mimic)}
        for joint in robot.joints
    ]  # fmt: skip
    shapes = [
        {"name": shape.name or shape.link, "link": shape.link, "faces": np.asarray(shape.faces, int),
         "colour": [round(float(value), 3) for value in shape.colour], "vertices_mm": (1e3 * shape.vertices).round(2)}
        for shape in (*_place_arm(robot), *around)
    ]  # fmt: skip
    names = {"robot": robot.name, "grade": robot.grade, "base": robot.base, "tcp": robot.tcp, "ground": robot.ground}
    return {"schema": 1, **names, "joints": joints, "shapes": shapes}


def write_deviation(plan: Plan, path: Path, kept: NDArray[np.bool_]) -> None:
    """Write deviation.csv; `kept` are the rows that joints.csv holds."""
    band = np.full((len(plan.task), 1), np.nan)
    if plan.error_band is not None:
        band[plan.error_band.cut, 0] = plan.error_band.radius[plan.error_band.cut]
    ends = ((len(plan.approach.q), len(plan.retract.q)), (0, 0))
    sides = {"uncorrected": plan.before.deviation, "planned": plan.after.deviation}
    columns: dict[str, object] = {}
    for name, values in {**sides, "error_band": band}.items():
        padded = 1e3 * np.pad(values, ends, constant_values=np.nan)[kept]
        titles = [f"{name}_{axis}_mm" for axis in "xyz"] if name in sides else [f"{name}_mm"]
        columns |= dict(zip(titles, padded.T, strict=True))
    write_table(path, columns, decimals=9)


def _place_arm(robot: Robot) -> list[Shape]:
    """Return the shapes of the arm, each in the frame of the link of the chain that carries it."""
    q, shapes = np.zeros(robot.nq), []
    poses, parents = locate_links(robot, q), read_parents(robot)
    chain = {robot.base, *(joint.child for joint in robot.joints)}
    for shape in place_shapes(robot, q):
        carrier = shape.link
        while carrier not in chain:
            carrier = parents[carrier][0]
        pose = poses[carrier]
        vertices = (shape.vertices - pose[:3, 3]) @ pose[:3, :3]
        shapes.append(Shape(carrier, vertices, shape.faces, shape.colour, shape.link))
    return shapes


def _place_stock(plan: Plan) -> list[Shape]:
    """Return the stock that the job's force model cuts, in the robot base frame."""
    stock = None if plan.job is None else getattr(plan.job.process, "stock", None)
    if plan.job is None or stock is None:
        return []
    if stock.block_mm is not None:
        corners, faces = triangulate_box(*(1e-3 * np.asarray(stock.block_mm, float)))
    else:
        from compplan.io.meshes import load_mesh

        corners, faces = simplify_mesh(load_mesh(plan.job.folder / stock.mesh, stock.unit))
    pose = plan.job.T_base_part
    return [Shape("", corners @ pose[:3, :3].T + pose[:3, 3], faces, STOCK_COLOUR, "stock")]
