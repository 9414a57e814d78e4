"""The commented job that `compplan init` writes, with every key of `compplan.job.job`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

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

#: Tables of a short job and their keys; None: all active keys.
SHORT: dict[str, tuple[str, ...] | None] = {
    "toolpath": None, "part": None, "tool": None, "process": None, "plan": ("strategy", "tolerance_mm"),
    "output": ("programs",),
}  # fmt: skip

#: Keys of a force model that stay commented out.
OPTIONAL = ("# required", "# stock_top_mm")
#: Lateral distance below which a move is along the tool axis. [m]
BESIDE = 1e-6
#: Diameter [mm], material and spindle speed [1/min] of a drill by default (assumed).
DRILL: dict[str, str | float] = {"diameter_mm": 6.0, "material": "al7075_t6", "spindle_rpm": 3000.0}
#: Placeholder of a feed that the job may state. [m/s]
ANY_FEED = 0.01
#: The text, with marks for the names of registries.
TEXT = Path(__file__).with_name("commented_job.toml")


def write_job_text() -> str:
    """Return the commented job with the names of the registries."""
    text = TEXT.read_text(encoding="utf-8")
    choices = {
        "<strategies>": " | ".join(STRATEGIES),
        "<models>": _wrap_names(FORCE_MODELS),
        "<programs>": " | ".join(WRITERS),
        "<materials>": " | ".join(MATERIALS),
        "<readers>": ", ".join(READERS),
        "<suffixes>": " ".join(list_suffixes()),
    }
    for mark, names in choices.items():
        text = text.replace(mark, names)
    return text


def _wrap_names(names: Iterable[str]) -> str:
    """Wrap names into the lines of a comment."""
    return f"\n{'':36}#   ".join(wrap(" | ".join(names), 80))


def mount_tool(text: str, robot: Robot, *, used: bool) -> str:
    """Set a straight tool on the flange in the text of a job.

    Args:
        text: The commented job.
        robot: The robot of the folder.
        used: Whether the table is active where the folder's TCP is on the flange; otherwise it stays a comment.

    """
    tool, out = mounted_tool(robot), outward_axis(robot)
    pendant = locate_pendant(robot)
    head, table, rest = re.split(r"(# \[tool\].*?\n)(?=\n)", text, maxsplit=1, flags=re.DOTALL)
    if pendant is not None and pendant.stated:
        frame, axis, turn, out = "pendant", "z of the maker's flange frame", np.zeros(3), pendant.pose[:3, :3].T @ out
    else:
        frame, axis = "flange", f"{name_axis(out)} of the flange frame"
        turn = Rotation.from_matrix(tool[:3, :3]).as_rotvec(degrees=True)
    for key, value in {"position_mm": 150.0 * out, "rotation_deg": turn, "centre_of_mass_mm": 60.0 * out}.items():
        numbers = [round(float(number), 3) + 0.0 for number in value]
        table = re.sub(rf"# {key} = \[.*?\]", f"# {key} = {numbers}", table)
    table = table.replace('# frame = "flange" ', f'# frame = "{frame}" ')
    straight = f"# {axis} leaves this robot; length and mass are assumed: put yours\n"
    first, _, keys = table.partition("\n")
    if used and not tool[:3, 3].any():
        first, keys = first.removeprefix("# "), "".join(line.removeprefix("# ") for line in keys.splitlines(True))
    return f"{head}{first}\n{straight}{keys}{rest}"


def number_tools(text: str, tools: Sequence[CalledTool]) -> str:
    """Describe the tools of the CAM file in the text of a job.

    Several tools give one [[tool]] each, all like its [tool]; the cut of a single one goes into [process].
    """
    if len(tools) == 1:
        return _describe_cut(text, tools[0])
    found = re.search(r"(?m)^(?:# )?\[tool\].*?\n(?=\n)", text, flags=re.DOTALL)
    if found is None or not tools:
        return text
    body = re.sub(r"(?m)^# (?=\w+ = )", "", found.group().partition("\n")[2])
    blocks = [
        f"[[tool]]                            # {tool.label} of the CAM file\n{tool.key}\n{tool.process}{body}"
        for tool in tools
    ]
    return text[: found.start()] + "\n".join(blocks) + text[found.end() :]


def choose_process(text: str, model: str) -> str:
    """Replace sheet forming by another force model in the text of a job."""
    head, process, rest = _split_process(text)
    lines = [line if line.startswith(("#", "[")) else f"# {line}" for line in process.splitlines()]
    first = next(k for k, line in enumerate(lines) if line.startswith(f'# model = "{model}"'))
    last = next(k for k, line in enumerate(lines) if k > first and line.startswith("# model = "))
    own = [line.removeprefix("# ") for line in lines[first:last] if not line.startswith(OPTIONAL)]
    left = [line for k, line in enumerate(lines) if not first <= k < last or line.startswith(OPTIONAL)]
    note = "# the numbers of the cut are assumed: put yours" if model == "milling" else ""
    return head + "\n".join([left[0], *filter(None, [note]), *own, *left[1:]]) + "\n" + rest


def _describe_cut(text: str, tool: CalledTool) -> str:
    """Write the drill or the spindle speed of the only tool of a CAM file into [process]."""
    head, process, rest = _split_process(text)
    if tool.drills:
        lines = process.splitlines(keepends=True)
        kept = [line for line in lines[1:] if line.startswith("# ") and "assumed: put yours" not in line]
        own = [f"{key} = {json.dumps(value)}\n" for key, value in tool.cut.items()]
        process = "".join([lines[0], "# the numbers of the cut are assumed: put yours\n", *own, *kept])
    elif tool.spindle_rpm is not None:
        line = f"{f'spindle_rpm = {tool.spindle_rpm}':<36}# S of the CAM file"
        process = re.sub(r"(?m)^spindle_rpm = .*$", line, process, count=1)
    return head + process + rest


def _split_process(text: str) -> tuple[str, str, str]:
    """Return a job's text before its table [process], the table and the text after it."""
    head, process, rest = re.split(r"(?<=\n)(\[process\].*?\n)(?=\n)", text, maxsplit=1, flags=re.DOTALL)
    return head, process, rest


def set_place(text: str, position_mm: list[float], comment: str) -> str:
    """Set the position of the part in the text of a job."""
    return re.sub(r"(?<=\[part\]).*?\nposition_mm = \[.*?\].*?(?=\n)",
                  lambda found: re.sub(r"position_mm = .*", f"position_mm = {position_mm}  # {comment}", found.group()),
                  text, count=1, flags=re.DOTALL)  # fmt: skip


def set_force(text: str, axial: float, lateral: float, comment: str) -> str:
    """Set the forces of sheet forming in the text of a job. [N]"""
    for key, value in (("axial_N", axial), ("lateral_N", lateral)):
        text = re.sub(rf"(?m)^{key} = [^#\n]*# ", f"{f'{key} = {value}':<36}# {comment}; ", text, count=1)
    return text


def shorten_job(text: str) -> str:
    """Return the first keys of a commented job, with their comments."""
    kept, table = ["# A compplan job: the keys that one needs first. All of them: compplan init without --short."], ""
    dropped = False
    for line in text.splitlines():
        count = len(kept)
        if line.startswith(" "):  # goes on with the comment of the line before
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
