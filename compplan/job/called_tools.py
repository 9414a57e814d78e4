"""Tools called by a CAM file, for a new job: mill or drill, and the spindle speed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.job.tools import called_speed
from compplan.toolpath.operations import Operation, split_operations
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.reading import read_toolpath
from compplan.toolpath.toolpath import Toolpath

#: Lateral distance below which a move is along the tool axis. [m]
BESIDE = 1e-6
#: Diameter [mm], material and spindle speed [1/min] of a drill by default (assumed).
DRILL: dict[str, str | float] = {"diameter_mm": 6.0, "material": "al7075_t6", "spindle_rpm": 3000.0}
#: Placeholder of a feed that the job may state. [m/s]
ANY_FEED = 0.01


@dataclass(frozen=True)
class CalledTool:
    """A tool of a CAM file."""

    number: int  #: T number; 0 without one.
    name: str  #: Its name, or "".
    drills: bool  #: Whether all cuts are along its axis.
    spindle_rpm: float | None  #: Its only spindle speed in the file, or None. [1/min]
    top_mm: float  #: Top of the stock: the part zero where cuts pass it, else their highest point. [mm]

    @property
    def cut(self) -> dict[str, str | float]:
        """Keys of its force model beyond those of a milling cutter."""
        speed: dict[str, str | float] = {} if self.spindle_rpm is None else {"spindle_rpm": self.spindle_rpm}
        return {"model": "drill", **DRILL, "stock_top_mm": self.top_mm, **speed} if self.drills else speed

    @property
    def label(self) -> str:
        """Its name in the file."""
        return repr(self.name) if self.name else f"T{self.number}"

    @property
    def key(self) -> str:
        """The line of [[tool]] that identifies it."""
        return f"name = {json.dumps(self.name)}" if self.name else f"number = {self.number}"

    @property
    def process(self) -> str:
        """The line of [[tool]] for its cut, or ""."""
        table = ", ".join(f"{key} = {json.dumps(value)}" for key, value in self.cut.items())
        source = "assumed: put yours" if self.drills else "S of the CAM file"
        return f"process = {{ {table} }}  # {source}\n" if table else ""


def read_called_tools(path: Path) -> list[CalledTool]:
    """List the tools of a CAM file in the order of their first cut.

    Raises:
        InputError: If the file cannot be read.
    """
    operations = split_operations(read_toolpath(path, cam=CamTable(cycles="expand"), feed=ANY_FEED))
    by_tool: dict[tuple[int, str], list[Operation]] = {}
    for operation in operations:
        by_tool.setdefault((operation.number, operation.name), []).append(operation)
    tools = []
    for (number, name), own in by_tool.items():
        speeds = {called_speed(operation) for operation in own}
        drills = all(_goes_along_axis(operation.toolpath) for operation in own)
        top = max(_find_top(operation.toolpath) for operation in own)
        tools.append(CalledTool(number, name, drills, speeds.pop() if len(speeds) == 1 else None, top))
    return tools


def _goes_along_axis(toolpath: Toolpath) -> bool:
    """Return whether every cutting move is along the tool axis."""
    cuts = ~toolpath.rapid[1:]
    moves, axis = np.diff(toolpath.position, axis=0)[cuts], toolpath.axis[1:][cuts]
    beside = moves - axis * np.einsum("ni,ni->n", moves, axis)[:, None]
    return bool(cuts.any() and np.linalg.norm(beside, axis=1).max() < BESIDE)


def _find_top(toolpath: Toolpath) -> float:
    """Return the part zero where cutting moves pass it, else their highest point, to 0.1 mm. [mm]"""
    cuts = np.flatnonzero(~toolpath.rapid[1:]) + 1
    heights = 1e3 * toolpath.position[np.union1d(cuts, cuts - 1), 2]
    return 0.0 if heights.min() < 0.0 <= heights.max() else round(float(heights.max()), 1)
