"""Write the plans of a job of several tools: the programs together, a folder for each tool, one plan.json and page.

OUT/plan.json, OUT/report.html     the whole, and a line for each tool
OUT/joints.csv                     all rows in order, with a column tool
OUT/JOB_T1.., OUT/JOB_T2..         programs, to be run in this order; each begins with its tool change
OUT/JOB_ALL..                      main programs that call them in order, in languages with calls
OUT/T1/, OUT/T2/                   all else that `compplan plan` writes for one tool
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from compplan.controllers.writers.sequence import WHOLE
from compplan.io.tables import read_text, write_json, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.planning.operations import summarise_operations
from compplan.planning.result import Plan
from compplan.reporting.operations_page import write_operations_page
from compplan.reporting.writers.plan import head_of_status, make_program, write_beside, write_moves

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
        written: list[list[Path]] = []
        for plan in plans:
            label = "" if plan.job is None else plan.job.label
            place = part / label
            place.mkdir()
            plan, files = write_moves(plan, place)
            programs[label] = [str(file.relative_to(place)) for file in files]
            for own in dict.fromkeys(Path(file).parts[0] for file in programs[label]):
                (place / own).rename(part / own)
            written.append([part / file for file in programs[label]])
            write_beside(plan, place)
            read.append(plan)
        _join_joints([part / label / "joints.csv" for label in programs], list(programs), part / "joints.csv")
        mains = _write_mains(read, written, part, name)
        summary = summarise_operations(read, name)
        summary["main_programs"] = [file.name for file in mains]
        for entry in summary["tools"]:
            entry["programs"] = programs[entry["label"]]
        write_operations_page(summary, part / "report.html")
        write_json(part / "plan.json", summary, indent=2)
        names = list_files(part)
    return read, [Path(folder) / name for name in names]


def _write_mains(plans: Sequence[Plan], written: Sequence[Sequence[Path]], folder: Path, name: str) -> list[Path]:
    """Write the programs that call those of all tools, in the languages that have calls."""
    from compplan.controllers.writers.sequence import write_sequence

    job = plans[0].job
    if job is None or not job.output.programs:
        return []
    said = [f"{plan.job.label if plan.job else ''}: {line}" for plan in plans for line in head_of_status(plan)]
    head = (f"compplan: {name}, the programs of all tools in order", *said)
    first = replace(make_program(plans[0]), name=f"{name}, all tools; the first", comments=head)
    return [
        file for language in job.output.programs
        for file in write_sequence(first, language, job.file.stem, written, folder)
    ]  # fmt: skip


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


def describe_order(summary: dict[str, Any], files: Sequence[Path]) -> str:
    """Say in which order the programs run, and which main programs among the files do it."""
    labels = [entry["label"] for entry in summary["tools"]]
    order = f"run the programs of {', then those of '.join(labels)} (so their names end); each begins with its change"
    mains = [file.name for file in files if WHOLE.search(file.stem)]
    return f"{order}; {' and '.join(mains)} {'calls' if len(mains) == 1 else 'call'} them in order" if mains else order
