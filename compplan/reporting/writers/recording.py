"""What a folder of results keeps for being looked at again: cell.json, deviation.csv, gap.csv.

cell.json holds what stands in the cell and how the arm moves, so that neither robot folder nor job is needed:

    { "schema": 1, "robot":, "grade":, "tolerance_mm":, "configuration": {}, "base":, "tcp":, "softer": its cell,
      "ground": link that stands still where a positioner carries the part, "base" then the one that carries it; or "",
      "joints": [ { "name":, "kind": "revolute" | "prismatic" | "fixed", "parent":, "child":, "placement": [[4 x 4], m],
                    "axis": [3], "mimic": null | { "joint":, "multiplier":, "offset": } } ],   from the base to the TCP
      "shapes": [ { "name":, "link": "" where it stands still, "colour": [red, green, blue, opacity, from 0 to 1],
                    "vertices_mm": [[3]], "faces": [[3]] } ] }            in the frame of its link, or in the base frame

deviation.csv has the rows of joints.csv: attained minus wanted tip, base frame, uncorrected, as planned, and as planned
on a softer robot, and the distance that holds the true tip with 95 %. gap.csv has a row for each measured pose.
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
from compplan.robot import Array, Robot
from compplan.robot.mounting import mounted_tool
from compplan.robot.solids import triangulate_box, triangulate_rod

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.shares import Shares
    from compplan.planning.plan import Plan

#: Colour of the stock.
STOCK_COLOUR = (0.66, 0.70, 0.74, 0.35)
#: Colour of a tool that is drawn because no mesh of it is known, and the shortest that is drawn. [m]
TOOL_COLOUR, SHORTEST_TOOL = (0.45, 0.47, 0.50, 1.0), 0.02
#: Below this share of a row's gap nothing is named that explains it.
LEAST_SHARE = 0.25


def write_plan_cell(plan: Plan, folder: Path, kept: NDArray[np.bool_]) -> None:
    """Write cell.json and deviation.csv of a plan; `kept` are the rows that joints.csv holds."""
    scene = None if plan.task.start is None else plan.task.start.settings.scene
    shapes = [
        Shape(link, *simplify_mesh(mesh), MESH_COLOURS[name], name)
        for name, link, mesh in (() if scene is None else scene.meshes)
    ]
    known = {shape.name for shape in shapes}
    shapes += _draw_stock(plan, part_known="part" in known)
    shapes += [] if "tool" in known else _draw_spindle(plan)
    more = {"tolerance_mm": 1e3 * plan.task.tolerance, "configuration": dict(plan.task.configuration),
            "softer": plan.mismatch.cell}  # fmt: skip
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
    n, wrong = len(plan.task), plan.mismatch
    softer, band = np.full((n, 3), np.nan), np.full((n, 1), np.nan)
    softer[wrong.cut] = wrong.deviation[wrong.cut]
    if plan.error_band is not None:
        band[plan.error_band.cut, 0] = plan.error_band.radius[plan.error_band.cut]
    ends = ((len(plan.approach.q), len(plan.retract.q)), (0, 0))
    sides = {"uncorrected": plan.before.deviation, "planned": plan.after.deviation, "softer": softer}
    columns: dict[str, object] = {}
    for name, values in {**sides, "error_band": band}.items():
        padded = 1e3 * np.pad(values, ends, constant_values=np.nan)[kept]
        titles = [f"{name}_{axis}_mm" for axis in "xyz"] if name in sides else [f"{name}_mm"]
        columns |= dict(zip(titles, padded.T, strict=True))
    write_table(path, columns, decimals=9)


def write_gap(diagnosis: Diagnosis, shares: Shares, folder: Path) -> None:
    """Write cell.json and gap.csv of a diagnosis: poses, gap, what is left, and what explains most of it there."""
    robot, campaign, rows = diagnosis.robot, diagnosis.fit.problem.campaign, shares.rows
    columns: dict[str, object] = {"row": rows, "run": np.asarray(campaign.run)[rows]}
    columns |= robot.joint_columns(campaign.q[rows])
    points = {"": diagnosis.points, "gap_": diagnosis.residual_before, "left_": diagnosis.residual_after}
    for name, values in points.items():
        columns |= {f"{name}{axis}_mm": 1e3 * values[rows, k] for k, axis in enumerate("xyz")}
    columns["explained_by"], columns["explained_share"] = name_rows(shares)
    write_table(folder / "gap.csv", columns, decimals=7)
    write_json(folder / "cell.json", summarise_cell(robot), indent=None)


def name_rows(shares: Shares) -> tuple[list[str], Array]:
    """Name, for every row, the cause whose motion accounts for most of its gap, and the share that it accounts for.

    The share of a motion m in a gap y is (m . y) / |y|^2, as far as it lies between 0 and 1.
    """
    names = list(shares.motions)
    if not names:
        return ["not explained"] * len(shares.rows), np.zeros(len(shares.rows))
    square = np.maximum((shares.gap**2).sum(axis=1), 1e-24)
    share = np.stack([np.clip((shares.motions[name] * shares.gap).sum(axis=1) / square, 0.0, 1.0) for name in names])
    best = share.argmax(axis=0)
    most = share[best, np.arange(len(best))]
    return [names[k] if part >= LEAST_SHARE else "not explained" for k, part in zip(best, most, strict=True)], most


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


def _draw_stock(plan: Plan, *, part_known: bool) -> list[Shape]:
    """Return the stock that the job's force model cuts, or a block that holds the cut where no part is known either."""
    if plan.job is None:
        return []
    stock, pose, name = getattr(plan.job.process, "stock", None), plan.job.T_base_part, "stock"
    if stock is not None and stock.block_mm is not None:
        corners, faces = triangulate_box(*(1e-3 * np.asarray(stock.block_mm, float)))
    elif stock is not None:
        from compplan.io.meshes import load_mesh

        corners, faces = simplify_mesh(load_mesh(plan.job.folder / stock.mesh, stock.unit))
    elif part_known:
        return []
    else:
        inside = (plan.task.position[plan.task.cut] - pose[:3, 3]) @ pose[:3, :3]
        low, high = inside.min(axis=0), inside.max(axis=0)
        edge, name = 0.08 * float((high - low).max()), "block under the path, drawn"
        top = np.array([high[0] + edge, high[1] + edge, low[2]])
        corners, faces = triangulate_box(low - np.array([edge, edge, 3.0 * edge]), top)
    return [Shape("", corners @ pose[:3, :3].T + pose[:3, 3], faces, STOCK_COLOUR, name)]


def _draw_spindle(plan: Plan) -> list[Shape]:
    """Return a cutter and a spindle between tip and flange, drawn where no mesh of the tool is known."""
    height = -float(np.linalg.inv(mounted_tool(plan.robot))[2, 3])  # the tip's z points out of the tool
    if height < SHORTEST_TOOL:
        return []
    shapes = []
    for name, radius, low, high in (("cutter", 0.06, 0.0, 0.45), ("spindle", 0.22, 0.4, 1.0)):
        start, end = np.array([0.0, 0.0, -low * height]), np.array([0.0, 0.0, -high * height])
        rod = triangulate_rod(start, end, min(radius * height, 0.09), sections=24)
        shapes.append(Shape(plan.robot.tcp, *rod, TOOL_COLOUR, f"{name}, drawn"))
    return shapes
