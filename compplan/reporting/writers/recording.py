"""Write deviation.csv; write and read view.npz, the file of the viewer.

deviation.csv has the rows of joints.csv: attained minus nominal tip, base frame, uncorrected and as planned, and the
radius of the 95 % band of the true tip.

view.npz holds a `PlanRecording`: shapes of the cell, and about `ROWS` rows with the pose of every link.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers import joint_convention
from compplan.errors import InputError
from compplan.io.tables import write_table
from compplan.reporting.charts import thin_path
from compplan.reporting.scenes import MESH_COLOURS, Shape, carry_links, locate_links, place_shapes, simplify_mesh
from compplan.robot import Array, Robot
from compplan.robot.solids import triangulate_box

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: Colour of the stock.
STOCK_COLOUR = (0.66, 0.70, 0.74, 0.35)
#: Name of the viewer file, and approximate greatest number of its rows.
FILE, ROWS = "view.npz", 4000
#: Display modes of the loaded tip, in displayed order.
WAYS = ("uncorrected", "planned")


def write_recording(plan: Plan, folder: Path, table: Mapping[str, NDArray[Any]], table_rows: NDArray[np.bool_]) -> None:
    """Write deviation.csv and view.npz; table: columns of joints.csv, table_rows: mask of its rows in the plan."""
    columns = write_deviation(plan, folder / "deviation.csv", table_rows)
    deviation = {way: np.column_stack([columns[f"{way}_{axis}_mm"] for axis in "xyz"]) * 1e-3 for way in WAYS}
    band, tip = columns["error_band_mm"] * 1e-3, np.column_stack([table[f"{axis}_mm"] for axis in "xyz"]) * 1e-3
    sizes = [band, *(np.linalg.norm(values, axis=1) for values in deviation.values())]
    rows = thin_path(tip, sizes, ROWS)
    robot, task = plan.robot, plan.task
    q = np.vstack([plan.approach.q, plan.q, plan.retract.q])[table_rows][rows]
    poses, shapes = joint_convention.locate_links(robot, q), [*place_arm(robot), *_place_cell(plan)]
    facts = {
        "name": plan.name, "robot": robot.name, "grade": robot.grade, "tolerance_mm": 1e3 * task.tolerance,
        "configuration": dict(task.configuration), "ground": robot.ground,
        "joints": list(robot.joint_columns(q)), "links": list(poses),
        "shapes": [{"link": shape.link, "name": shape.name, "colour": shape.colour} for shape in shapes],
    }  # fmt: skip
    arrays: dict[str, Any] = {
        "facts": np.array(json.dumps(facts)), "row": rows, "time": table["time_s"][rows], "tip": tip[rows],
        "move": table["move"][rows], "error_band": band[rows],
        "joints": np.column_stack(list(robot.joint_columns(q).values())),
        "force": np.column_stack([table[f"f{axis}_N"] for axis in "xyz"])[rows],
        "poses": np.stack(list(poses.values()), axis=1, dtype=np.float32),
    }  # fmt: skip
    arrays |= {way: values[rows] for way, values in deviation.items()}
    for k, shape in enumerate(shapes):
        arrays |= {f"vertices{k}": shape.vertices.astype(np.float32), f"faces{k}": shape.faces.astype(np.uint32)}
    np.savez(folder / FILE, **arrays)


def write_deviation(plan: Plan, path: Path, table_rows: NDArray[np.bool_]) -> dict[str, Array]:
    """Write deviation.csv and return its columns; `table_rows`: mask of the rows in joints.csv."""
    band = np.full((len(plan.task), 1), np.nan)
    if plan.error_band is not None:
        band[plan.error_band.cut, 0] = plan.error_band.radius[plan.error_band.cut]
    ends = ((len(plan.approach.q), len(plan.retract.q)), (0, 0))
    sides = dict(zip(WAYS, (plan.before.deviation, plan.after.deviation), strict=True))
    columns: dict[str, Array] = {}
    for name, values in {**sides, "error_band": band}.items():
        padded = 1e3 * np.pad(values, ends, constant_values=np.nan)[table_rows]
        titles = [f"{name}_{axis}_mm" for axis in "xyz"] if name in sides else [f"{name}_mm"]
        columns |= dict(zip(titles, padded.T, strict=True))
    write_table(path, columns, decimals=9)
    return columns


def place_arm(robot: Robot) -> list[Shape]:
    """Return the shapes of the arm, each in the frame of the chain link that carries it."""
    q, shapes = np.zeros(robot.nq), []
    poses, carriers = locate_links(robot, q), carry_links(robot, {robot.base, *(j.child for j in robot.joints)})
    for shape in place_shapes(robot, q):
        carrier = carriers[shape.link][0]
        pose = poses[carrier]
        vertices = (shape.vertices - pose[:3, 3]) @ pose[:3, :3]
        shapes.append(Shape(carrier, vertices, shape.faces, shape.colour, shape.link))
    return shapes


def _place_cell(plan: Plan) -> list[Shape]:
    """Return part, fixture and tool in the frames of their links, and the stock in the robot base frame."""
    scene = None if plan.task.start is None else plan.task.start.settings.scene
    meshes = () if scene is None else scene.meshes
    shapes = [Shape(link, *simplify_mesh(mesh), MESH_COLOURS[name], name) for name, link, mesh in meshes]
    stock = None if plan.job is None else getattr(plan.job.process, "stock", None)
    if plan.job is None or stock is None:
        return shapes
    if stock.block_mm is not None:
        corners, faces = triangulate_box(*(1e-3 * np.asarray(stock.block_mm, float)))
    else:
        from compplan.io.meshes import load_mesh

        corners, faces = simplify_mesh(load_mesh(plan.job.folder / stock.mesh, stock.unit))
    pose = plan.job.T_base_part
    return [*shapes, Shape("", corners @ pose[:3, :3].T + pose[:3, 3], faces, STOCK_COLOUR, "stock")]


@dataclass(frozen=True, eq=False)
class PlanRecording:
    """Rows of a plan for the viewer; k of the n rows of joints.csv, base frame."""

    facts: Mapping[str, Any]  #: Names of plan, robot, links and joint columns; tolerance, configuration, ground.
    solids: tuple[Shape, ...]  #: Shapes, in the frames of their links, or in the base frame.
    row: NDArray[np.int_]  #: Row of joints.csv. Shape (k,).
    time: Array  #: Shape (k,). [s]
    joints: Array  #: Commanded joints as in joints.csv. Shape (k, nq). [deg or mm]
    poses: NDArray[np.float32]  #: Pose of every link. Shape (k, links, 4, 4). [m]
    tip: Array  #: Nominal tip. Shape (k, 3). [m]
    force: Array  #: Predicted force of the environment on the tool. Shape (k, 3). [N]
    move: NDArray[np.str_]  #: "cut", "rapid", "approach" or "retract". Shape (k,).
    #: Attained minus nominal tip, uncorrected and planned; NaN if unknown. Shape (k, 3) each. [m]
    deviation: Mapping[str, Array]
    error_band: Array  #: Radius of the 95 % band of the true tip, NaN if none is stated. Shape (k,). [m]

    @property
    def tolerance(self) -> float:
        """Greatest allowed deviation. [m]"""
        return 1e-3 * float(self.facts["tolerance_mm"])


def read_recording(folder: Path) -> PlanRecording:
    """Read the recording in an output folder of `compplan plan`."""
    file = folder / FILE
    if not file.is_file():
        raise InputError(f"holds no plan to show ({FILE} is not there); name a folder of compplan plan", file=folder)
    try:
        with np.load(file, allow_pickle=False) as held:
            facts = json.loads(str(held["facts"]))
            solids = tuple(
                Shape(shape["link"], held[f"vertices{k}"], held[f"faces{k}"], tuple(shape["colour"]), shape["name"])
                for k, shape in enumerate(facts["shapes"])
            )
            names = ("row", "time", "joints", "poses", "tip", "force", "move", "error_band")
            arrays: dict[str, Any] = {name: held[name] for name in names}
            return PlanRecording(facts, solids, deviation={way: held[way] for way in WAYS}, **arrays)
    except (ValueError, KeyError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise InputError(f"is not what compplan writes ({error}); run compplan plan again", file=file) from None
