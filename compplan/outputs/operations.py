"""Write the plans of a job of several tools: the programs together, a folder for each tool, one plan.json and page.

OUT/plan.json, OUT/report.html     the whole, and a line for each tool
OUT/joints.csv                     all rows in order, with a column tool
OUT/JOB_T1.., OUT/JOB_T2..         programs, to be run in this order; each begins with its tool change
OUT/T1/, OUT/T2/                   all else that `compplan plan` writes for one tool
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from compplan.files.tables import read_text, write_json, write_text
from compplan.files.transaction import list_files, replace_folder
from compplan.outputs.plan import write_beside, write_moves
from compplan.plan.operations import summarise_operations
from compplan.plan.result import Plan
from compplan.report.operations_page import write_operations_page

#: Time between the last row of a tool and the first of the next in joints.csv: the change is not timed. [s]
CHANGE = 1.0


def write_operations(plans: Sequence[Plan], folder: str | Path, name: str) -> list[Path]:
    """Write the plans of all operations of a job, all files or none.

    Args:
        plans: One an operation, in order.
        folder: Folder to write to; made if needed.
        name: Name of the job.

    Returns:
        The files written.

    Raises:
        InputError: If the folder cannot be written, or a program does not fit its language; nothing is written then.

    """
    return deliver_operations(plans, folder, name)[1]


def deliver_operations(plans: Sequence[Plan], folder: str | Path, name: str) -> tuple[list[Plan], list[Path]]:
    """Write plans as `write_operations` does, read back what was written, and return them with what that says."""
    read: list[Plan] = []
    with replace_folder(folder, "plan") as part:
        programs: dict[str, list[str]] = {}
        for plan in plans:
            label = "" if plan.job is None else plan.job.label
            place = part / label
            place.mkdir()
            plan, files = write_moves(plan, place)
            programs[label] = [str(file.relative_to(place)) for file in files]
            for own in dict.fromkeys(Path(file).parts[0] for file in programs[label]):
                (place / own).rename(part / own)
            write_beside(plan, place)
            read.append(plan)
        _join_joints([part / label / "joints.csv" for label in programs], list(programs), part / "joints.csv")
        summary = summarise_operations(read, name)
        for entry in summary["tools"]:
            entry["programs"] = programs[entry["label"]]
        write_operations_page(summary, part / "report.html")
        write_json(part / "plan.json", summary, indent=2)
        names = list_files(part)
    return read, [Path(folder) / name for name in names]


def _join_joints(files: Sequence[Path], labels: Sequence[str], whole: Path) -> None:
    """Write joints.csv of all operations: their rows in order, times going on, and a column that names the tool."""
    lines: list[str] = []
    offset = 0.0
    for file, label in zip(files, labels, strict=True):
        head, *rows = read_text(file).splitlines()
        assert head.startswith("time_s,")
        lines = lines or [f"{head},tool"]
        last = offset
        for row in rows:
            time, _, rest = row.partition(",")
            last = offset + float(time)
            lines.append(f"{last:.10g},{rest},{label}")
        offset = last + CHANGE
    write_text(whole, "\n".join([*lines, ""]))


def describe_order(summary: dict[str, Any]) -> str:
    """Say in which order the programs run."""
    labels = [entry["label"] for entry in summary["tools"]]
    return f"run the programs of {', then those of '.join(labels)} (so their names end); each begins with its change"
