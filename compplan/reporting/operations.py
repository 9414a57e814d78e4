"""Write the plans of a job of several tools: the programs together, a folder for each tool, one plan.json and page.

OUT/plan.json, OUT/report.html     summary, and a line for each tool
OUT/joints.csv                     all rows in order, with a column tool
OUT/JOB_T1.., OUT/JOB_T2..         programs, to be run in this order; each begins with its tool change
OUT/JOB_ALL..                      main programs that call them in order, in languages with calls
OUT/T1/, OUT/T2/                   the other outputs of `compplan plan` for one tool
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from compplan.controllers.writers import WHOLE, write_sequence
from compplan.io.notes import list_remarks, list_stops
from compplan.io.palette import BAND, BEFORE
from compplan.io.quantities import format_mm, format_mm_change
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.planning.result import Plan
from compplan.reporting.charts import Bars, draw_bars
from compplan.reporting.page import Cell, Chart, DataTable, Provenance, Section, Summary, render_page
from compplan.reporting.plan_summary import TONES
from compplan.reporting.writers.plan import head_of_status, make_program, tabulate_joints, write_beside, write_moves

#: Statuses and verdicts, from the best to the worst.
STATUSES = ("solved", "not_confirmed", "infeasible")
VERDICTS = ("keeps", "not_known", "may_not_keep")
#: Nominal time between the last row of a tool and the first of the next in joints.csv; changes are not timed. [s]
CHANGE = 1.0


def write_operations(plans: Sequence[Plan], folder: str | Path, name: str) -> list[Path]:
    """Write the plans of all operations of a job, all files or none, and return the files.

    Raises:
        InputError: If the folder cannot be written, or a program does not fit its language; nothing is written then.
    """
    return deliver_operations(plans, folder, name)[1]


def deliver_operations(plans: Sequence[Plan], folder: str | Path, name: str) -> tuple[list[Plan], list[Path]]:
    """Write plans as `write_operations` does; return them with the checks of the files read back, and the files."""
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
        _join_joints(read, list(programs), part / "joints.csv")
        mains = _write_mains(read, written, part, name)
        summary = summarise_operations(read, name)
        summary["main_programs"] = [file.name for file in mains]
        for entry in summary["tools"]:
            entry["programs"] = programs[entry["label"]]
        write_text(part / "report.html", _render(summary))
        write_json(part / "plan.json", summary, indent=2)
        names = list_files(part)
    return read, [Path(folder) / name for name in names]


def worst_status(plans: Sequence[Plan]) -> str:
    """Return the status of several plans as one: the worst."""
    return max((plan.status for plan in plans), key=STATUSES.index)


def summarise_operations(plans: Sequence[Plan], name: str) -> dict[str, Any]:
    """Return the content of plan.json for a job of several tools: the worst of every figure, and each tool."""
    parts = [plan.to_dict() for plan in plans]
    verdicts, labels = [part["verdict"] for part in parts], ["" if p.job is None else p.job.label for p in plans]

    def worst(table: str, *keys: str) -> dict[str, float]:
        return {key: max(float(part[table][key]) for part in parts) for key in keys}

    kept = ("schema", "strategy", "robot", "robot_grade", "configuration", "judge", "made_by")
    whole: dict[str, Any] = {
        **{key: parts[0][key] for key in kept},
        "name": name,
        "status": worst_status(plans),
        "verdict": max(verdicts, key=lambda one: (VERDICTS.index(one["word"]), one["beyond_share"] or 0.0)),
        "waypoints": sum(part["waypoints"] for part in parts),
        "solve_time_s": round(sum(part["solve_time_s"] for part in parts), 4),
        "duration_s": sum(part["duration_s"] for part in parts),
        **{key: worst(key, "rms", "mean", "max") for key in ("error_before_mm", "error_after_mm")},
        **{key: worst(key, "max") for key in ("between_waypoints_mm", "correction_mm")},
        "margins": {
            "position_limit_deg": min(part["margins"]["position_limit_deg"] for part in parts),
            **worst("margins", "velocity_ratio", "acceleration_ratio"),
        },
        "notes": list(dict.fromkeys(
            note if note in plan.task.nominal.notes else type(note)(f"{label}: {note}")
            for plan, label in zip(plans, labels, strict=True) for note in (*plan.reasons, *plan.notes)
        )),
        "tools": [_summarise_operation(plan, part, label)
                  for plan, part, label in zip(plans, parts, labels, strict=True)],
    }  # fmt: skip
    if all("error_band_mm" in part for part in parts):
        whole["error_band_mm"] = worst("error_band_mm", "p95_max")
    failing = [f"{label}: {part['failure']}" for part, label in zip(parts, labels, strict=True) if "failure" in part]
    if failing:
        whole["failure"] = "; ".join(failing)
    return whole


def _summarise_operation(plan: Plan, part: dict[str, Any], label: str) -> dict[str, Any]:
    """Return one entry of `tools` in plan.json: tool, folder and figures."""
    kept = ("status", "verdict", "waypoints", "error_before_mm", "error_after_mm", "correction_mm", "duration_s")
    length = 1e3 * float(np.linalg.norm(plan.robot.joints[-1].placement[:3, 3]))
    return {
        "operation": None if plan.job is None else plan.job.cam.operation, "label": label, "folder": label,
        "length_mm": round(length, 6), **{key: part[key] for key in (*kept, "error_band_mm") if key in part},
    }  # fmt: skip


def _write_mains(plans: Sequence[Plan], written: Sequence[Sequence[Path]], folder: Path, name: str) -> list[Path]:
    """Write main programs that call the programs of all tools, in languages with calls."""
    job = plans[0].job
    if job is None or not job.output.programs:
        return []
    warnings = [f"{plan.job.label if plan.job else ''}: {line}" for plan in plans for line in head_of_status(plan)]
    head = (f"compplan: {name}, the programs of all tools in order", *warnings)
    first = replace(make_program(plans[0]), name=f"{name}, all tools; the first", comments=head)
    return [
        file for language in job.output.programs
        for file in write_sequence(first, language, job.file.stem, written, folder)
    ]  # fmt: skip


def _join_joints(plans: Sequence[Plan], labels: Sequence[str], file: Path) -> None:
    """Write joints.csv of all operations: their rows in order, continuous times, and a column with the tool."""
    tables, begin = [tabulate_joints(plan) for plan in plans], 0.0
    for table, label in zip(tables, labels, strict=True):
        table["time_s"] = begin + table["time_s"]
        table["tool"] = np.full(len(table["time_s"]), label)
        begin = float(table["time_s"][-1]) + CHANGE
    write_table(file, {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}, decimals=10)


def describe_order(summary: dict[str, Any], files: Sequence[Path]) -> str:
    """Describe the order of the programs, and the main programs among the files that call them."""
    labels = [entry["label"] for entry in summary["tools"]]
    order = f"run the programs of {', then those of '.join(labels)}; each begins with its tool change (program or stop)"
    mains = [file.name for file in files if WHOLE.search(file.stem)]
    return f"{order}; {' and '.join(mains)} {'calls' if len(mains) == 1 else 'call'} them in order" if mains else order


def _render(summary: Mapping[str, Any]) -> str:
    """Return the page: summary, one line per tool, and links to the pages of the tools."""
    tools, mains = summary["tools"], summary.get("main_programs", [])
    rows = [
        [Cell(tool["label"], "strong", f"./{quote(tool['folder'])}/report.html"), tool["length_mm"],
         Cell(tool["status"], "good" if tool["status"] == "solved" else "bad"),
         tool["verdict"]["word"].replace("_", " "), format_mm(1e-3 * tool["error_before_mm"]["max"]),
         format_mm(1e-3 * tool["error_after_mm"]["max"]), tool["verdict"]["band_mm"], tool["waypoints"],
         tool["duration_s"]]
        for tool in tools
    ]  # fmt: skip
    columns = ["tool", "flange to tip [mm, 5]", "status", "verdict", "uncorrected, max", "planned, max",
               "95 % band [mm]", "waypoints", "time [s]"]  # fmt: skip
    files = [[tool["label"], ", ".join(tool["programs"]) or "none asked for"] for tool in tools]
    files += [["all, in order", ", ".join(mains)]] if mains else []
    sections = [
        Section("Tools", [DataTable(columns, rows)], "One plan a tool; its name opens its page.", True),
        Section("Programs", [DataTable(["tool", "files"], files)],
                "In this order; each begins with its tool change.", True),
    ]  # fmt: skip
    return render_page(
        summary["name"], open_operations(summary), sections, kind="Plan", notes=list_remarks(summary["notes"]),
        provenance=Provenance([("robot", summary["robot"])]),
    )  # fmt: skip


def open_operations(summary: Mapping[str, Any]) -> Summary:
    """Return the first screen: verdict on all operations, and the points to resolve before the machine moves."""
    tools, verdict = summary["tools"], summary["verdict"]
    bands = [tool["verdict"]["band_mm"] for tool in tools]
    change = format_mm_change(*(1e-3 * summary[key]["max"] for key in ("error_before_mm", "error_after_mm")))
    failing = sum(tool["verdict"]["word"] == "may_not_keep" for tool in tools)
    words = {"keeps": "All operations keep", "may_not_keep": f"{failing} of {len(tools)} operations may not keep",
             "not_known": "It is not known whether all operations keep"}[verdict["word"]]  # fmt: skip
    band, tone = "not known" if None in bands else format_mm(1e-3 * max(bands)), TONES[verdict["word"]]
    figures = [
        (band, "95 % band, the widest of all operations", tone),
        (change, "greatest deviation without and with correction, if the robot is as modelled"),
        (f"{summary['duration_s']:.0f}\u00a0s", f"run time of {len(tools)} operations, without the tool changes"),
    ]
    series = {"without correction": Bars([tool["error_before_mm"]["max"] for tool in tools], BEFORE),
              "95 % band": Bars(bands, BAND)}  # fmt: skip
    names = [tool["label"] for tool in tools]
    chart = draw_bars(names, series, "greatest deviation of the tip, mm", level=verdict["tolerance_mm"])
    caption = "Each operation; dashed: the tolerance. The 95 % band has to stay below it."
    todo = "Open OUT/report.html: it has a page for each operation, and the order of the programs."
    return Summary(f"{words} {verdict['tolerance_mm']:g} mm.", tone, figures,
                   Chart(chart, caption, 120 + 70 * len(tools)), todo, list_stops(summary["notes"]))  # fmt: skip
