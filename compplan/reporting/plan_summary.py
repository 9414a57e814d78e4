"""Summary of a plan: first screen of its page, setup sheet of the machine, lines of the terminal."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.controllers.writers.frames import flange_turn, place_numbers, rotation_vectors
from compplan.controllers.writers.joint_convention import load_controller, locate_pendant
from compplan.io.display import cut_line
from compplan.io.notes import list_remarks, list_stops
from compplan.io.quantities import (
    format_length,
    format_mm,
    format_mm_change,
    format_number,
    format_percent,
    format_set_length,
)
from compplan.io.transaction import list_files
from compplan.job.job import Job
from compplan.planning.notes import find_least_feed, find_top_feed
from compplan.planning.tolerance_verdict import KEEPS, NOT_KNOWN
from compplan.process.cutting import CuttingTable
from compplan.reporting.charts import draw_curves
from compplan.reporting.page import Block, Cell, Chart, DataTable, Section, Summary, format_files, is_program
from compplan.reporting.provenance import explain_grade
from compplan.robot import Array
from compplan.robot.mounting import mounted_tool

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: Tone of each verdict.
TONES = {"keeps": "good", "may_not_keep": "bad", "not_known": "unsure"}
#: Greatest width of a line on the terminal. [characters]
WIDTH = 120
#: Longest path of a job file shown in full; of longer ones only the name is shown. [characters]
LONGEST_FILE = 40
FIRST_RUN = "Run the program without a part at reduced override, then cut and measure one part."


def open_plan(plan: Plan, folder: Path | None = None) -> Summary:
    """Return the first screen of a plan; programs already in the folder are listed with their checksums."""
    verdict, tone = plan.verdict, TONES[plan.verdict.word]
    before = None if plan.error_band is None else plan.error_band.before
    uncorrected = "" if before is None else f" (uncorrected program {format_mm(before[1])})"
    words = f"95 % band{uncorrected}: the true tip may be up to this far from the path; "
    words += f"the tolerance is {format_set_length(verdict.tolerance)}"
    figures = [
        (_show_band(plan), words, tone if verdict.word != "not_known" else ""),
        (format_mm_change(plan.before.max_deviation, plan.after.max_deviation),
         "greatest deviation without and with correction, if the robot is as modelled"),
        (f"{format_number(float(plan.timing.time[-1]))}\u00a0s",
         f"run time of {format_length(plan.task.nominal.cutting_length)} of cut"),
    ]  # fmt: skip
    if verdict.beyond_share:
        figures[2] = (format_percent(verdict.beyond_share), "of the cut may be beyond the tolerance", "bad")
    caption = "Distance of the tool tip from the path. The 95 % band has to stay below the tolerance."
    sentence = re.split(r"(?<=[.!?])\s+(?=[A-Z])", verdict.sentence.strip(), maxsplit=1)[0]
    return Summary(
        sentence, tone, figures, Chart(draw_curves(plan.curves()), caption, 340),
        _name_job(plan, verdict.change) or FIRST_RUN, _list_stops(plan), write_sheet(plan, folder),
    )  # fmt: skip


def _list_stops(plan: Plan) -> list[str]:
    stops = list_stops(plan.notes)
    if plan.status == "not_confirmed":
        return [f"Not confirmed: {'; '.join(plan.breaches)}. Do not run the programs.", *stops]
    if plan.status != "infeasible":
        return stops
    failures = plan.command.failures
    limits = ", ".join(sorted(set(failures.values()))) or "limits"
    count = f"{len(failures)} of {len(plan.task)} waypoints fail ({limits}); " if failures else ""
    return [f"Infeasible: {count}the programs hold the best compromise, do not run them.", *stops]


def _show_band(plan: Plan) -> str:
    return "not known" if plan.verdict.band is None else format_mm(plan.verdict.band)


def _name_job(plan: Plan, step: str) -> str:
    given = "JOB" if plan.job is None else str(plan.job.file)
    return step.replace(" JOB", f" {given if plan.job is None or len(given) <= LONGEST_FILE else plan.job.file.name}")


def write_sheet(plan: Plan, folder: Path | None) -> Section:
    """Return the setup sheet: part, frames, tool, start, band, and the checksums of the programs."""
    lines = [("Job", plan.name), ("Verdict", plan.verdict.sentence), *_describe_frames(plan), *_describe_run(plan)]
    rows: list[Any] = [[Cell(name, "strong"), words] for name, words in lines]
    rows += [[Cell("Before the machine moves", "bad"), stop] for stop in list_stops(plan.notes)]
    blocks: list[Block] = [
        DataTable(["Setup", ""], rows),
        "Set\u00a0up\u00a0by\u00a0______________   Checked\u00a0by\u00a0______________   Date\u00a0______________",
    ]
    if folder is not None and (programs := list_programs(folder)):
        caption = "The file on the controller is this one if its checksum is the same."
        blocks.append(DataTable(["Program", "lines", "SHA-256, first 16 digits"], programs, caption))
    return Section("Setup sheet", blocks, "Check each line at the machine before the program runs.", True)


def list_programs(folder: Path) -> list[tuple[str, int, str]]:
    """List program files in a folder: name, lines, and the first digits of their checksum."""
    contents = {name: (folder / name).read_bytes() for name in list_files(folder) if is_program(Path(name))}
    return [(name, text.count(b"\n"), hashlib.sha256(text).hexdigest()[:16]) for name, text in contents.items()]


def describe_pose(pose: Array) -> str:
    """Format a pose (4, 4) [m] for a pendant: millimetres, angles A, B, C and rotation vector in degrees."""
    x, y, z, a, b, c = place_numbers(pose, "ZYX", 3)
    turn = np.degrees(rotation_vectors(pose[None])[0]).round(3) + 0.0
    place = f"X {x:g}  Y {y:g}  Z {z:g} mm"
    if not np.any(turn):
        return f"{place}, not turned"
    vector = ", ".join(f"{value:g}" for value in turn)
    return f"{place}; A {a:g}  B {b:g}  C {c:g} deg (z, y', x''); rotation vector {vector} deg"


def describe_part_frame(job: Job) -> str:
    """Describe in a sentence the source of the part frame, and the reference of deviations."""
    if not job.part.touched_off:
        return "absolute in the robot base ([part] touched_off = false)"
    points = job.part.touched_points
    where = "three corners of the box around the toolpath" if points is None else f"the {len(points)} points of [part]"
    return (f"touched off with this robot and tool at {where}; deviations and the 95 % band are relative "
            "to it (if the part is not touched off, set [part] touched_off = false)")  # fmt: skip


def _describe_frames(plan: Plan) -> list[tuple[str, str]]:
    """Return the rows of robot, part frame, positioner, tool and toolpath."""
    robot, job = plan.robot, plan.job
    controller = load_controller(robot)
    rows = [("Robot", f"{robot.name}; controller {controller.name or 'not known'}"),
            ("Robot model", explain_grade(robot))]  # fmt: skip
    if job is not None:
        where = f"on {robot.base}, that carries the part" if robot.ground else "in the robot base"
        rows.append((f"Part frame, {where}", describe_pose(job.T_base_part)))
        rows.append(("Part frame found by", describe_part_frame(job)))
    if robot.ground:
        ranges = []
        for k in np.flatnonzero(robot.carriers).tolist():
            joint, (low, high) = robot.actuated[k], (plan.q[:, k].min(), plan.q[:, k].max())
            size, unit = (1e3, "mm") if joint.kind == "prismatic" else (180.0 / np.pi, "deg")
            still = high - low < 1e-9
            ranges.append(f"{joint.name} stands at {size * low:.5g} {unit}" if still else
                          f"{joint.name} goes from {size * low:.5g} to {size * high:.5g} {unit}")  # fmt: skip
        rows.append(("Positioner", "; ".join(ranges)))
    tool = None if job is None else job.tool
    if tool is None:
        rows.append(("Tool", f"the robot model's own ({robot.tcp} from {robot.flange})"))
    else:
        mass = "weight not known" if tool.mass_kg is None else f"{tool.mass_kg:g} kg"
        rows.append(("Tool", f"as in the job; {mass}"))
    seen = np.linalg.inv(flange_turn(robot)) @ mounted_tool(robot)
    frame = "the URDF's flange" if locate_pendant(robot) is None else "the pendant's flange frame"
    rows.append((f"Tool centre point, in {frame}", describe_pose(seen)))
    source = Path(plan.task.nominal.source).name or "in memory"
    return [*rows, ("Toolpath", f"{source}; {len(plan.task)} waypoints")]


def _describe_run(plan: Plan) -> list[tuple[str, str]]:
    """Return the rows of start, feed, joint limits, clearance, band, force and cutter."""
    robot, task = plan.robot, plan.task
    first = plan.approach.key_q[0] if len(plan.approach.key_q) else plan.q[0]
    joints = ", ".join(f"{name.split('_')[0]} {round(float(values[0]), 2) + 0.0:.2f} {name.split('_')[1]}"
                       for name, values in robot.joint_columns(first[None]).items())  # fmt: skip
    wanted, speed = 1e3 * task.nominal.feed[task.cut & ~task.nominal.rapid], "not known"
    if len(wanted):
        ends = dict.fromkeys(f"{end:.4g}" for end in (wanted.min(), wanted.max()))
        low = find_least_feed(task, plan.timing)
        speed = f"programmed {' to '.join(ends)} mm/s{f', lowered to {1e3 * low[0]:.3g} mm/s' if low else ''}"
        top = find_top_feed(task, plan.timing)
        speed += f", not reached: at most {1e3 * top:.3g} mm/s" if top is not None else ""
    clearance = describe_clearance(plan)
    force = float(np.linalg.norm(task.wrench[:, :3], axis=1).max(initial=0.0))
    rows = [
        ("First joint position", joints),
        ("Feed of the cut", f"{speed}; {plan.timing.time[-1]:.4g} s in all"),
        ("Nearest joint limit", describe_margin(plan)),
        *([("Least clearance", clearance)] if clearance else []),
        ("Tolerance and 95 % band", f"{format_set_length(plan.verdict.tolerance)}; band {_show_band(plan)}"),
        ("Greatest predicted force", f"{force:.4g} N" if force else "none predicted"),
    ]
    process = None if plan.job is None else plan.job.process
    if not isinstance(process, CuttingTable):
        return rows
    material = process.material or "coefficients of the job"
    cutter = f"{process.model} {2e3 * process.cutter().radius:g} mm, {process.teeth} teeth, {process.spindle_rpm:g} rpm"
    moment = np.abs(np.einsum("ni,ni->n", task.wrench[:, 3:], task.rotation[:, :, 2])).max(initial=0.0)
    power = 2.0 * np.pi * (process.spindle_rpm / 60.0) * moment
    rows.append(("Cutter", f"{cutter}, in {material}"))
    return [*rows, ("Spindle", f"up to {moment:.3g} N m, {1e-3 * power:.3g} kW")]


def describe_margin(plan: Plan) -> str:
    """Describe the joint nearest to its limit, compared as a share of half a turn or of a metre."""
    robot = plan.robot
    margin = np.minimum(plan.q - robot.lower, robot.upper - plan.q).min(axis=0)
    margin[robot.lower == robot.upper] = np.inf  # held at a fixed position
    share = margin / np.where(robot.prismatic, 1.0, np.pi)
    if not np.isfinite(share).any():
        return "no limits"
    k = int(np.argmin(share))
    scale, unit = (1e3, "mm") if robot.prismatic[k] else (180 / np.pi, "deg")
    return f"{format_number(float(margin[k] * scale))} {unit} ({robot.joint_names[k]})"


def describe_clearance(plan: Plan) -> str:
    """Describe the least clearance of arm and tool; "" if it was not computed."""
    if plan.clearance is None:
        return ""
    near = min(plan.clearance.least[1], plan.clearance.own, key=lambda contact: contact.distance)
    known = np.isfinite(near.distance) and near.first
    return f"{format_length(near.distance)} ({near.first} to {near.second})" if known else ""


def format_plan(plan: Plan, folder: Path, files: Sequence[Path]) -> list[str]:
    """Return the terminal lines of a written plan: six, and before the last two each point to resolve, in full."""
    step = _name_job(plan, plan.verdict.change or FIRST_RUN)
    cause = f"largest cause: {plan.verdict.largest_cause}"
    if plan.status != "infeasible" and (low := find_least_feed(plan.task, plan.timing)):
        cause += f"; feed lowered from {1e3 * low[1]:.3g} to {1e3 * low[0]:.3g} mm/s in places ({low[2]})"
    lines = [_format_verdict(plan), _format_band(plan), cause, _format_basis(plan)]
    step = f"next: {step[0].lower()}{step[1:].rstrip('.')}"
    count = len(list_remarks(plan.notes))
    wrote = format_files(folder, files, f" ({count} note{'s' * (count > 1)})" if count else "", plan.status)
    stops = [f"before the machine moves: {stop}" for stop in list_stops([*plan.reasons, *plan.notes])]
    return [*(cut_line(line, WIDTH) for line in lines), *stops, wrote, step]


def _format_band(plan: Plan) -> str:
    """Return the 95 % band without and with correction and the deviation of the model, on one line."""
    band, model = plan.error_band, f"model alone: {format_mm(plan.before.max_deviation)} uncorrected"
    if band is None:
        kept = plan.task.cut.copy()
        kept[list(plan.command.failures)] = False
        most = format_mm(float(plan.after.distance[kept].max(initial=0.0)))
        where = f"; where all limits hold, the greatest planned deviation is {most}" if kept.any() else ""
        return f"no 95 % band: the plan is not complete{where}"
    sizes = [] if band.before is None else [f"{format_mm(band.before[1])} uncorrected"]
    sizes += [f"{format_mm(band.whole)} corrected"] if plan.strategy != "none" else []
    return f"off the path (95 %): {', '.join(sizes)} ({model})"


def _format_basis(plan: Plan) -> str:
    """Return what the band assumes, and where the part frame comes from, on one line."""
    basis = plan.verdict.basis or f"robot model: {plan.robot.grade}"
    if plan.job is None:
        return basis
    if not plan.job.part.touched_off:
        return f"{basis}; part frame absolute in the robot base"
    touch = f"{basis}; touch off the part with this robot and tool"
    other = f"{touch} (if not: part.touched_off = false)"
    return other if len(other) <= WIDTH else touch


def _format_verdict(plan: Plan) -> str:
    """Return the verdict on one line; details are in the lines below, or on stderr."""
    verdict, tolerance = plan.verdict, f"{1e3 * plan.task.tolerance:.3g} mm"
    if plan.status == "infeasible":
        return f"Do not start: no solution. Waypoints out of reach or beyond a limit: {len(plan.command.failures)}."
    if plan.status == "not_confirmed":
        return "Do not start: the independent check does not confirm the plan, see below."
    if verdict.word == NOT_KNOWN or plan.error_band is None:
        return f"Not known whether it keeps {tolerance}."
    if verdict.word == KEEPS:
        return f"Keeps {tolerance}: the tip stays within {_show_band(plan)} of the path along the whole cut (95 %)."
    worst = f"worst at {1e3 * plan.task.nominal.arc_length[plan.error_band.widest]:.4g} mm along it"
    return f"May not keep {tolerance}: the tip may be up to {_show_band(plan)} off the path (95 %), {worst}."
