"""Read what the folder of a plan keeps for the viewer: cell.json, joints.csv and deviation.csv."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Table, read_table, read_text
from compplan.reporting.scenes import Shape
from compplan.robot import Array, Joint, Mimic

#: How the loaded tip is told, in the order that it is offered.
WAYS = ("uncorrected", "planned")


@dataclass(frozen=True, eq=False)
class ViewCell:
    """What stands in the cell, and how the arm moves."""

    joints: tuple[Joint, ...]  #: From the base to the TCP.
    solids: tuple[Shape, ...]  #: Shapes, in the frames of their links, or in the base frame.
    facts: Mapping[str, Any]  #: All that cell.json says.

    @property
    def base(self) -> str:
        """Link that the arm stands on."""
        return str(self.facts["base"])

    @property
    def tcp(self) -> str:
        """Frame of the tool centre point."""
        return str(self.facts["tcp"])

    @property
    def ground(self) -> str:
        """Link that stands still where a positioner carries the part and the base, else ""."""
        return str(self.facts.get("ground", ""))

    @property
    def actuated(self) -> tuple[Joint, ...]:
        """Joints that are commanded, from the base; those that carry the part first, from the ground out."""
        last = next((k for k, joint in enumerate(self.joints) if joint.child == self.ground), -1) + 1
        before, rest = (
            [joint for joint in part if joint.actuated] for part in (self.joints[:last], self.joints[last:])
        )
        return (*before[::-1], *rest)


@dataclass(frozen=True, eq=False)
class PlanRecording:
    """A plan as its folder tells it; n rows of joints.csv, base frame."""

    cell: ViewCell  #: The cell.
    name: str  #: Name of the job.
    tolerance: float  #: Greatest deviation that counts as within tolerance. [m]
    time: Array  #: Shape (n,). [s]
    q: Array  #: Commanded joints. Shape (n, nq). [rad or m]
    tip: Array  #: Wanted tip. Shape (n, 3). [m]
    wrench: Array  #: Predicted wrench of the environment on the tool. Shape (n, 6). [N, N m]
    move: NDArray[np.str_]  #: "cut", "rapid", "approach" or "retract". Shape (n,).
    #: Attained minus wanted tip by way, NaN where it is not known. Shape (n, 3) each. [m]
    deviation: Mapping[str, Array]
    error_band: Array  #: Distance that holds the true tip with 95 %, NaN where none is stated. Shape (n,). [m]


def read_recording(folder: Path) -> PlanRecording:
    """Read a folder that `compplan plan` wrote."""
    if not folder.is_dir():
        raise InputError("is no folder; name one that compplan plan wrote", file=folder)
    missing = [name for name in ("joints.csv", "deviation.csv", "cell.json") if not (folder / name).is_file()]
    if missing:
        message = f"holds no plan to show ({', '.join(missing)} not there); name a folder of compplan plan"
        raise InputError(f"{message}, or plan again", file=folder)
    cell = read_cell(folder / "cell.json")
    columns = [FileColumn("time", "time", True), *_joint_columns(cell), *(FileColumn(a, "length", True) for a in "xyz")]
    columns += [FileColumn(name, required=True) for name in "ijk"]
    columns += [FileColumn(f"f{axis}", "force", True) for axis in "xyz"]
    columns += [FileColumn(f"m{axis}", "moment", True) for axis in "xyz"] + [FileColumn("move", "text")]
    table = read_table(folder / "joints.csv", columns)
    n, names = len(table.values["time"]), [f"{way}_{axis}" for way in WAYS for axis in "xyz"]
    seen = read_table(
        folder / "deviation.csv", [FileColumn(name, "length", True, missing=True) for name in (*names, "error_band")]
    )
    if len(seen.values["error_band"]) != n:
        message = f"has {len(seen.values['error_band'])} rows, joints.csv has {n}; plan again"
        raise InputError(message, file=folder / "deviation.csv")
    try:
        name = str(json.loads(read_text(folder / "plan.json"))["name"])
    except (InputError, ValueError, KeyError, TypeError):
        name = folder.name
    return PlanRecording(
        cell, name, 1e-3 * float(cell.facts["tolerance_mm"]), table.values["time"], _read_joints(table, cell),
        _read_vectors(table, "{}"), np.hstack([_read_vectors(table, "f{}"), _read_vectors(table, "m{}")]),
        np.asarray(table.text.get("move", np.full(n, "cut"))),
        {way: _fill(_read_vectors(seen, way + "_{}")) for way in WAYS}, seen.values["error_band"],
    )  # fmt: skip


def read_cell(file: Path) -> ViewCell:
    """Read cell.json."""
    try:
        cell = build_cell(json.loads(read_text(file)))
        links = {cell.base, "", *(joint.child for joint in cell.joints)}
        if not {solid.link for solid in cell.solids} <= links or cell.tcp not in links:
            raise ValueError("a link that no joint moves")
        return cell
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError(f"is not what compplan writes ({error}); run the command again", file=file) from None


def build_cell(content: Mapping[str, Any]) -> ViewCell:
    """Build a cell from what cell.json holds."""
    joints = tuple(_read_joint(entry) for entry in content["joints"])
    return ViewCell(joints, tuple(map(_read_solid, content["shapes"])), {"robot": "", "grade": "", **content})


def _read_joint(entry: Mapping[str, Any]) -> Joint:
    mimic = entry["mimic"]
    return Joint(
        name=entry["name"], kind=entry["kind"], parent=entry["parent"], child=entry["child"],
        placement=np.array(entry["placement"], float).reshape(4, 4), axis=np.array(entry["axis"], float).reshape(3),
        mimic=None if mimic is None else Mimic(mimic["joint"], float(mimic["multiplier"]), float(mimic["offset"])),
    )  # fmt: skip


def _read_solid(entry: Mapping[str, Any]) -> Shape:
    red, green, blue, opacity = (float(value) for value in entry["colour"])
    vertices = 1e-3 * np.array(entry["vertices_mm"], float).reshape(-1, 3)
    faces = np.array(entry["faces"], int).reshape(-1, 3)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"faces of {entry['name']} name corners that are not there")
    return Shape(entry["link"], vertices, faces, (red, green, blue, opacity), entry["name"])


def _joint_columns(cell: ViewCell) -> list[FileColumn]:
    kinds = ("length" if joint.kind == "prismatic" else "angle" for joint in cell.actuated)
    return [FileColumn(f"q{number}", kind, True) for number, kind in enumerate(kinds, start=1)]


def _read_joints(table: Table, cell: ViewCell) -> Array:
    return np.column_stack([table.values[f"q{number + 1}"] for number in range(len(cell.actuated))])


def _read_vectors(table: Table, pattern: str) -> Array:
    return np.column_stack([table.values[pattern.format(axis)] for axis in "xyz"])


def _fill(values: Array) -> Array:
    """Interpolate between the rows that are known; ends stay unknown. Shape (n, 3)."""
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(known):
        return values
    rows = np.arange(len(values))
    return np.column_stack([np.interp(rows, known, values[known, k], np.nan, np.nan) for k in range(3)])
