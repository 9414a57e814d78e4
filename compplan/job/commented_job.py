"""The commented job that `compplan init` writes, with every key of `compplan.job.job`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.controllers.writers import WRITERS
from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.job.names import STRATEGIES
from compplan.job.tools import called_speed
from compplan.process.force_models import FORCE_MODELS
from compplan.process.materials import MATERIALS
from compplan.robot import Robot
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis
from compplan.toolpath.operations import Operation, split_operations
from compplan.toolpath.readers import READERS, list_suffixes
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.reading import read_toolpath
from compplan.toolpath.toolpath import Toolpath

#: Sections of a short job and their keys; None: all active keys.
SHORT: dict[str, tuple[str, ...] | None] = {
    "toolpath": None, "part": None, "tool": None, "process": None, "plan": ("strategy", "tolerance_mm"),
    "output": ("programs",),
}  # fmt: skip

#: Lateral distance below which a move is along the tool axis. [m]
BESIDE = 1e-6
#: Diameter [mm], material and spindle speed [1/min] of a drill by default (assumed).
DRILL: dict[str, str | float] = {"diameter_mm": 6.0, "material": "al7075_t6", "spindle_rpm": 3000.0}
#: Placeholder of a feed that the job may state. [m/s]
ANY_FEED = 0.01
#: Template of the job, and default values of its fields.
TEXT = Path(__file__).with_name("commented_job.jinja")
STRAIGHT = {"off": "# ", "straight": "", "frame": "flange", "position": [0.0, 0.0, 150.0], "rotation": [0.0, 0.0, 0.0],
            "centre": [0.0, 0.0, 60.0]}  # fmt: skip
DEFAULTS: dict[str, Any] = {
    "robot": "staubli_tx200", "language": "val3", "toolpath": "", "place": "[1500.0, 0.0, 183.0]", "tool": STRAIGHT,
    "tools": (), "model": "isf", "assumed": False, "cut": {}, "spindle_rpm": None, "axial_N": 1200.0,
    "lateral_N": 400.0, "eased": "",
}  # fmt: skip


def write_job_text(**answers: Any) -> str:
    """Return the commented job with the names of the registries, and answers in place of `DEFAULTS`."""
    from jinja2 import Environment, StrictUndefined

    names = {
        "strategies": " | ".join(STRATEGIES), "programs": " | ".join(WRITERS), "materials": " | ".join(MATERIALS),
        "models": f"\n{'':36}#   ".join(wrap(" | ".join(FORCE_MODELS), 80)), "readers": ", ".join(READERS),
        "suffixes": " ".join(list_suffixes()),
    }  # fmt: skip
    made = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    template = made.from_string(TEXT.read_text(encoding="utf-8"))

    def write_key(key: str, value: Any) -> str:  # padded to the column of its comment
        return f"{key} = {json.dumps(value, ensure_ascii=False)}".ljust(35)

    return template.render({**DEFAULTS, **names, **answers, "keyed": write_key})


def describe_mount(robot: Robot, *, used: bool) -> dict[str, Any]:
    """Return the template fields of a straight tool on the flange of a robot.

    Args:
        robot: The robot of the folder.
        used: Whether the section is active if the TCP of the folder is on the flange; otherwise it is a comment.
    """
    tool, out = mounted_tool(robot), outward_axis(robot)
    pendant = locate_pendant(robot)
    if pendant is not None and pendant.stated:
        frame, axis, turn, out = "pendant", "z of the maker's flange frame", np.zeros(3), pendant.pose[:3, :3].T @ out
    else:
        frame, axis = "flange", f"{name_axis(out)} of the flange frame"
        turn = Rotation.from_matrix(tool[:3, :3]).as_rotvec(degrees=True)
    vectors = {"position": 150.0 * out, "rotation": turn, "centre": 60.0 * out}
    return {
        "off": "" if used and not tool[:3, 3].any() else "# ", "frame": frame,
        "straight": f"{axis} leaves this robot; length and mass are assumed: put yours",
        **{key: [round(number, 3) + 0.0 for number in value.tolist()] for key, value in vectors.items()},
    }  # fmt: skip


def shorten_job(text: str) -> str:
    """Return the first keys of a commented job, with their comments."""
    kept, table = ["# A compplan job: the keys that one needs first. All of them: compplan init without --short."], ""
    dropped = False
    for line in text.splitlines():
        count = len(kept)
        if line.startswith(" "):  # continues the comment of the line before
            kept += [] if dropped else [line]
        elif line.startswith("["):
            table = line.lstrip("[").partition("]")[0]
            kept += ["", line] if table in SHORT else []
        elif line.startswith("#"):
            kept += [line] if "assumed: put yours" in line and table in ("tool", "process") else []
        elif line and (not table or table in SHORT):
            wanted = SHORT[table] if table else None
            kept += [line] if wanted is None or line.partition(" = ")[0] in wanted else []
        dropped = len(kept) == count
    return "\n".join(kept) + "\n"


@dataclass(frozen=True)
class CalledTool:
    """A tool of a CAM file."""

    number: int  #: T number; 0 without one.
    name: str  #: Its name, or "".
    drills: bool  #: Whether all cuts are along its axis.
    spindle_rpm: float | None  #: Its only spindle speed in the file, or None. [1/min]
    top_mm: float  #: Top of the stock: part zero if cuts pass it, otherwise their highest point. [mm]

    @property
    def cut(self) -> dict[str, str | float]:
        """Keys of its force model beyond those of a milling cutter."""
        speed: dict[str, str | float] = {} if self.spindle_rpm is None else {"spindle_rpm": self.spindle_rpm}
        return {"model": "drill", **DRILL, "stock_top_mm": self.top_mm, **speed} if self.drills else speed


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
    """Return the part zero if cutting moves pass it, otherwise their highest point, to 0.1 mm. [mm]"""
    cuts = np.flatnonzero(~toolpath.rapid[1:]) + 1
    heights = 1e3 * toolpath.position[np.union1d(cuts, cuts - 1), 2]
    return 0.0 if heights.min() < 0.0 <= heights.max() else round(float(heights.max()), 1)
