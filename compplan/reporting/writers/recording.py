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

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import write_json, write_table
from compplan.reporting.scenes import MESH_COLOURS, locate_links, place_shapes, simplify_mesh
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
    meshes = [_describe_mesh(*entry) for entry in (() if scene is None else scene.meshes)]
    more = {
        "tolerance_mm": 1e3 * plan.task.tolerance,
        "configuration": dict(plan.task.configuration),
        "softer": plan.mismatch.cell,
    }
    known = {shape["name"] for shape in meshes}
    drawn = [*([] if "tool" in known else _describe_spindle(plan)), *([] if "part" in known else _describe_block(plan))]
    cell = summarise_cell(plan.robot, [*meshes, *_describe_stock(plan), *drawn])
    write_json(folder / "cell.json", {**cell, **more}, indent=None)
    write_deviation(plan, folder / "deviation.csv", kept)


def summarise_cell(robot: Robot, around: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Return what cell.json holds: how the arm moves, and what stands there."""
    joints = [
        {"name": joint.name, "kind": joint.kind, "parent": joint.parent, "child": joint.child,
         "placement": joint.placement.round(9), "axis": joint.axis,
         "mimic": None if joint.mimic is None else asdict(joint.mimic)}
        for joint in robot.joints
    ]  # fmt: skip
    names = {"robot": robot.name, "grade": robot.grade, "base": robot.base, "tcp": robot.tcp, "ground": robot.ground}
    return {"schema": 1, **names, "joints": joints, "shapes": [*_describe_arm(robot), *around]}


def write_deviation(plan: Plan, path: Path, kept: NDArray[np.bool_]) -> None:
    """Write deviation.csv; `kept` are the rows that joints.csv holds."""
    n, wrong = len(plan.task), plan.mismatch
    softer, promise = np.full((n, 3), np.nan), np.full(n, np.nan)
    softer[wrong.cut] = wrong.deviation[wrong.cut]
    if plan.promise is not None:
        promise[plan.promise.cut] = plan.promise.radius[plan.promise.cut]
    before, after = len(plan.approach.q), len(plan.retract.q)
    columns: dict[str, object] = {}
    for name, values in (
        ("uncorrected", plan.before.deviation), ("planned", plan.after.deviation), ("softer", softer),
    ):  # fmt: skip
        padded = _pad(values, before, after)
        columns |= {f"{name}_{axis}_mm": 1e3 * padded[:, k] for k, axis in enumerate("xyz")}
    columns["error_band_mm"] = 1e3 * _pad(promise[:, None], before, after)[:, 0]
    write_table(path, {name: np.asarray(values)[kept] for name, values in columns.items()}, decimals=9)


def write_gap(diagnosis: Diagnosis, shares: Shares, folder: Path) -> None:
    """Write cell.json and gap.csv of a diagnosis: poses, gap, what is left, and what explains most of it there."""
    robot, campaign = diagnosis.robot, diagnosis.fit.problem.campaign
    rows = shares.rows
    explained, share = name_rows(shares)
    point = diagnosis.points
    columns: dict[str, object] = {"row": rows, "run": np.asarray(campaign.run)[rows]}
    columns |= robot.joint_columns(campaign.q[rows])
    for name, values in (("", point), ("gap_", diagnosis.residual_before), ("left_", diagnosis.residual_after)):
        columns |= {f"{name}{axis}_mm": 1e3 * values[rows, k] for k, axis in enumerate("xyz")}
    columns |= {"explained_by": explained, "explained_share": share}
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


def _describe_arm(robot: Robot) -> list[dict[str, Any]]:
    q = np.zeros(robot.nq)
    poses = locate_links(robot, q)
    chain = {robot.base, *(joint.child for joint in robot.joints)}
    above = {
        element.find("child").attrib["link"]: element.find("parent").attrib["link"]  # type: ignore[union-attr]
        for element in ElementTree.fromstring(robot.urdf).findall("joint")
        if element.find("child") is not None and element.find("parent") is not None
    }
    shapes = []
    for shape in place_shapes(robot, q):
        carrier = shape.link
        while carrier not in chain:
            carrier = above[carrier]
        pose = poses[carrier]
        vertices = (shape.vertices - pose[:3, 3]) @ pose[:3, :3]
        shapes.append(_describe_shape(shape.link, carrier, shape.colour, vertices, shape.faces))
    return shapes


def _describe_mesh(name: str, link: str, mesh: Any) -> dict[str, Any]:
    return _describe_shape(name, link, MESH_COLOURS[name], *simplify_mesh(mesh))


def _describe_stock(plan: Plan) -> list[dict[str, Any]]:
    """Return the stock that the job's force model cuts, where it names one."""
    stock = None if plan.job is None else getattr(plan.job.process, "stock", None)
    if plan.job is None or stock is None:
        return []
    if stock.block_mm is not None:
        corners, faces = triangulate_box(*(1e-3 * np.asarray(stock.block_mm, float)))
    else:
        from compplan.io.meshes import load_mesh

        corners, faces = simplify_mesh(load_mesh(plan.job.folder / stock.mesh, stock.unit))
    pose = plan.job.T_base_part
    return [_describe_shape("stock", "", STOCK_COLOUR, corners @ pose[:3, :3].T + pose[:3, 3], faces)]


def _describe_spindle(plan: Plan) -> list[dict[str, Any]]:
    """Return a cutter and a spindle between tip and flange, drawn where no mesh of the tool is known."""
    robot = plan.robot
    reach = np.linalg.inv(mounted_tool(robot))
    height = -float(reach[2, 3])  # the tip's z points out of the tool
    if height < SHORTEST_TOOL:
        return []
    shapes = []
    for name, radius, low, high in (("cutter", 0.06, 0.0, 0.45), ("spindle", 0.22, 0.4, 1.0)):
        size = min(radius * height, 0.09)
        start, end = np.array([0.0, 0.0, -low * height]), np.array([0.0, 0.0, -high * height])
        vertices, faces = triangulate_rod(start, end, size, sections=24)
        shapes.append(_describe_shape(f"{name}, drawn", robot.tcp, TOOL_COLOUR, vertices, faces))
    return shapes


def _describe_block(plan: Plan) -> list[dict[str, Any]]:
    """Return a block that holds the cut, drawn where neither part nor stock is known."""
    if plan.job is None or getattr(plan.job.process, "stock", None) is not None:
        return []
    pose, tip = plan.job.T_base_part, plan.task.position[plan.task.cut]
    inside = (tip - pose[:3, 3]) @ pose[:3, :3]
    low, high = inside.min(axis=0), inside.max(axis=0)
    edge = 0.08 * float((high - low).max())
    top = np.array([high[0] + edge, high[1] + edge, low[2]])
    corners, faces = triangulate_box(low - np.array([edge, edge, 3.0 * edge]), top)
    vertices = corners @ pose[:3, :3].T + pose[:3, 3]
    return [_describe_shape("block under the path, drawn", "", STOCK_COLOUR, vertices, faces)]


def _describe_shape(name: str, link: str, colour: Sequence[float], vertices: Array, faces: Any) -> dict[str, Any]:
    shown = [round(float(value), 3) for value in colour]
    corners = (1e3 * vertices).round(2)
    return {"name": name, "link": link, "colour": shown, "vertices_mm": corners, "faces": np.asarray(faces, int)}


def _pad(values: Array, before: int, after: int) -> Array:
    return np.pad(values, ((before, after), (0, 0)), constant_values=np.nan)
