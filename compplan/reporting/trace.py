"""Outputs of `compplan trace`: trace.json, the robot folder with the identified controller, and the page."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from compplan.controllers.motion.identify import Identified, identify_motion, score, summarise_distance
from compplan.controllers.motion.windows import PlacedLog, cut_windows, divide_gap, load_trace
from compplan.controllers.writers.joint_convention import load_motion
from compplan.controllers.writers.motion_table import ASSUMED, ServoMotion, tabulate_motion
from compplan.errors import InputError
from compplan.io.display import Curve, Curves
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number, format_percent
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.reporting.charts import draw_curves
from compplan.reporting.page import Cell, Chart, DataTable, Provenance, Section, Summary, render_page
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Array, Robot
from compplan.statics.ik import build_arm

#: Pattern of the section [motion] of a controller.toml up to the next one, with the comments directly above it.
MOTION = re.compile(r"(?:^#[^\n]*\n)*^\[motion\][^\n]*\n(?:(?!\[)[^\n]*\n?)*", re.MULTILINE)
#: Percentile of the distance up to which rows are attributed to causes; farther rows may be misplaced. [%]
WITHIN = 95.0
#: Names of causes.
CAUSES = {"lag": "lag of the drives", "blend": "blends at corners", "jitter": "torn rows of the log",
          "lost_motion": "lost motion"}  # fmt: skip


@dataclass(frozen=True)
class Traced:
    """Controller identified from logs, and the data of the comparison."""

    robot: Robot  #: The robot.
    traces: Sequence[PlacedLog]  #: The logs, aligned with their programs.
    found: Identified  #: Identification; its motion is that of the folder if the identified one is not better.
    gaps: dict[str, Array]  #: Distance of rows from the program, by cause, and total `gap`. Shape (n, 3) each. [m]
    notes: tuple[str, ...]  #: Notes on skipped or assumed items.


def trace_logs(logs: Sequence[Path], programs: Sequence[Path], robot: Robot) -> Traced:
    """Align logs with their programs, one each in the same order or one for all, and identify the controller."""
    if len(programs) not in (1, len(logs)):
        message = f"{len(logs)} logs and {len(programs)} programs, expected one --program a log, in order, or one"
        raise InputError(message)
    programs = list(programs) * (len(logs) if len(programs) == 1 else 1)
    arm, (folder, _) = build_arm(robot), load_motion(robot)
    traces = [load_trace(log, program, robot, arm) for log, program in zip(logs, programs, strict=True)]
    windows = cut_windows(traces, arm)
    found = identify_motion(windows, folder, arm)
    source = f"identified by compplan trace from {', '.join(log.name for log in logs)}"
    found = replace(found, motion=replace(found.motion, source=source) if found.helps else folder)
    gaps = [divide_gap(window, found.motion, arm) for window in windows]
    notes = [f"{trace.log.file.name}: {note}" for trace in traces for note in trace.log.notes]
    if not found.held_out:
        notes.append(f"{len(traces[0].log)} rows are too few for validation; nothing is identified")
    elif found.held_out == "time":
        notes.append("the figures are of stretches of time that were left out; another path or speed was not held "
                     "against the model: give logs of two programs")  # fmt: skip
    if found.held_out and not found.helps:
        notes.append("no model is nearer to the rows left out than the programmed path and the folder's values, in "
                     "median and 95th percentile; the folder keeps its values")  # fmt: skip
    return Traced(robot, traces, found, {name: np.concatenate([g[name] for g in gaps]) for name in gaps[0]}, (*notes,))


def summarise_trace(traced: Traced) -> dict[str, Any]:
    """Return the content of trace.json."""
    found = traced.found
    left = found.left if found.helps else found.left_before
    if not found.helps and found.motion.source == ASSUMED:  # assumed values without improvement
        better = score(summarise_distance(found.left_before)) < score(summarise_distance(found.without))
        left = found.left_before if better else found.without
    rms = {name: 1e3 * float(np.sqrt((traced.gaps[name] ** 2).sum(axis=1).mean())) for name in CAUSES}
    return {
        "schema": 1,
        "left_mm": _summarise(summarise_distance(left)),
        "left_without_model_mm": _summarise(summarise_distance(found.without)),
        "left_with_folder_mm": _summarise(summarise_distance(found.left_before)),
        "parts": share_causes(traced.gaps), "parts_rms_mm": rms, "written": found.helps,
        "model": "identified" if found.helps else "folder", "held_out": found.held_out,
        "models_mm": {"identified": _summarise(summarise_distance(found.left))} if found.held_out else {},
        "motion": tabulate_motion(found.motion, traced.robot.prismatic), "rows_judged": len(found.without),
        "logs": [_describe_log(trace) for trace in traced.traces], "notes": list(traced.notes),
        "made_by": describe_origin(),
    }  # fmt: skip


def share_causes(gaps: dict[str, Array]) -> dict[str, float]:
    """Return the share of each cause in the mean square distance; the rest is not explained."""
    size = (gaps["gap"] ** 2).sum(axis=1)
    inliers = size <= np.percentile(size, WITHIN)
    total = float(size[inliers].sum())
    shares = {name: float((gaps[name] * gaps["gap"])[inliers].sum()) / max(total, 1e-18) for name in CAUSES}
    return {name: min(max(value, 0.0), 1.0) for name, value in shares.items()}


def _describe_log(trace: PlacedLog) -> dict[str, Any]:
    """Return rows, clock and extent along the program of a log."""
    log, s = trace.log, trace.s
    return {
        "log": log.file.name, "program": trace.nodes.instructions.file.name, "rows": len(log),
        "cycle_ms": 1e3 * log.cycle, "torn_readings": int(log.torn.sum()), "late_share": log.late,
        "missing_share": log.missing, "begins_at_s": float(log.time[0]), "begins_at_length_mm": 1e3 * float(s[0]),
        "ends_at_length_mm": 1e3 * float(s[-1]), "program_length_mm": 1e3 * float(trace.programmed.s[-1]),
    }  # fmt: skip


def _summarise(ends: tuple[float, float]) -> dict[str, float]:
    return {"median": 1e3 * ends[0], "p95": 1e3 * ends[1]}


def write_trace(traced: Traced, folder: Path) -> dict[str, Any]:
    """Write trace.json, robot/ and report.html, all or none; return the content of trace.json."""
    summary = summarise_trace(traced)
    with replace_folder(folder, "trace") as part:
        deliver_robot_folder(traced.robot, part / "robot")
        if traced.found.helps:
            _write_motion(traced.found.motion, traced.robot, part / "robot" / "controller.toml")
        write_json(part / "trace.json", summary)
        write_text(part / "report.html", _render(traced.robot.name, summary, traced.found))
    return summary


def _write_motion(motion: ServoMotion, robot: Robot, file: Path) -> None:
    """Write the section [motion] of a controller.toml; the other sections are unchanged."""
    if file.is_file():
        text = MOTION.sub("", file.read_text(encoding="utf-8")).rstrip("\n")
    else:
        begin = {"schema": 1, "sign": [1] * robot.nq, "zero_deg": [0.0] * robot.nq, "checked": False}
        text = "# Signs and zeros are not checked.\n" + tomli_w.dumps(begin).rstrip("\n")
    table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in tabulate_motion(motion, robot.prismatic).items())
    write_text(file, f"{text}\n\n# How the controller moves and how its drives follow.\n[motion]\n{table}")


def _render(robot: str, summary: Mapping[str, Any], found: Identified) -> str:
    """Return the page: distance of the executed from the programmed path, its causes, and the models."""
    parts, without = summary["parts"], summary["left_without_model_mm"]
    facts = [
        (key.replace("_", " "), ", ".join(f"{v:g}" for v in value) if isinstance(value, list) else str(value))
        for key, value in summary["motion"].items()
    ]
    assumed = ["Blends are parabolas within the zone, of every make.", "Torn rows are one cycle old."]
    if not summary["written"]:
        assumed.append("The folder's own controller values, which were not identified here.")
    causes = [[words, 100.0 * parts[name], summary["parts_rms_mm"][name]] for name, words in CAUSES.items()]
    causes.append(["not explained", 100.0 * max(0.0, 1.0 - sum(parts.values())), None])
    held = "logs" if summary["held_out"] == "log" else "stretches of time"
    models = {"programmed path": without, "folder's values": summary["left_with_folder_mm"], **summary["models_mm"]}
    tried = [
        [name, *(Cell(entry[key], "strong" if name == summary["model"] else "") for key in ("median", "p95"))]
        for name, entry in models.items()
    ]
    logs = [
        [entry["log"], entry["rows"], entry["cycle_ms"], entry["torn_readings"], 100.0 * entry["late_share"],
         100.0 * entry["missing_share"], entry["begins_at_length_mm"]]
        for entry in summary["logs"]
    ]  # fmt: skip
    heads = ["log", "rows", "cycle [ms]", "torn readings", "late [%]", "missing [%]", "begins at [mm, 4]"]
    text = "Shares of the mean square distance across the programmed path; they add up along its direction."
    sections = [
        Section("Causes", [DataTable(["cause", "share [%]", "rms [mm]"], causes, text)]),
        Section("Models", [DataTable(["model", "median [mm]", "95 % [mm]"], tried,
                                     f"Distances of rows left out: {held} were left out in turn.")]),
        Section("Logs", [DataTable(heads, logs, "Clocks of the logs, and where in the program they begin.")]),
    ]  # fmt: skip
    return render_page(f"Executed path of {robot}", open_trace(summary, found), sections, kind="Trace",
                       notes=summary["notes"], provenance=Provenance(facts, assumed))  # fmt: skip


def open_trace(summary: Mapping[str, Any], found: Identified) -> Summary:
    """Return the first screen: distance to the programmed path and to the path of the model, largest cause."""
    without, left, parts = summary["left_without_model_mm"]["p95"], summary["left_mm"]["p95"], summary["parts"]
    cause, tone = max(parts, key=lambda name: parts[name]), "bad"
    verdict = "No identified controller helps; the folder keeps its values."
    todo = "Log programs of two paths or speeds, and trace them together."
    if summary["written"]:
        ratio, tone = format_number(without / max(left, 1e-9), 2), "good"
        verdict = f"The identified controller is {ratio} times closer to the executed path than the program."
        todo = "Use it: compplan execute PROGRAM.csv --robot OUT/robot --out EXECUTED.csv."
    figures = [
        (f"{format_number(without)}\u00a0mm", "95 % of the rows are nearer to the programmed path"),
        (f"{format_number(left)}\u00a0mm", "the same, to the path that the model executes", tone),
        (format_percent(parts[cause]), f"of what is left is {CAUSES[cause]}, the largest cause"),
    ]
    share, modelled = np.linspace(0.0, 100.0, 101), found.left if found.helps else found.left_before
    lines = tuple(Curve(name, 1e3 * np.percentile(values, share), share, role)
                  for name, values, role in (("to the program", found.without, "before"),
                                             ("to the model's path", modelled, "after")))  # fmt: skip
    chart = draw_curves(Curves("", "distance [mm]", "rows nearer [%]", lines))
    picture = Chart(chart, "Share of the rows that are nearer than a distance.", 330)
    return Summary(verdict, "good" if summary["written"] else "unsure", figures, picture, todo)
