"""The first screen of a plan, and its setup sheet: what the person at the machine needs, on one A4."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from compplan.controllers.writers.frames import flange_turn, place_numbers, rotation_vectors
from compplan.controllers.writers.joint_convention import load_controller
from compplan.controllers.writers.pendant import locate_pendant
from compplan.io.notes import list_stops
from compplan.io.quantities import (
    format_length,
    format_mm,
    format_mm_change,
    format_number,
    format_percent,
    format_set_length,
)
from compplan.planning.notes import describe_part_frame, mark_slow
from compplan.process.cutting import CuttingTable
from compplan.reporting import page
from compplan.reporting.charts import draw_curves
from compplan.reporting.provenance import explain_grade
from compplan.robot import Array, Joint
from compplan.robot.mounting import mounted_tool

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: What the verdict looks like.
TONES = {"keeps": "good", "may_not_keep": "bad", "not_known": "unsure"}
#: Files of a result that are no program.
NO_PROGRAM = {".html", ".json", ".png", ".npz", ".glb", ".bin", ".toml", ".urdf"}
#: Tables of a result that are no program.
NO_PROGRAM_NAMES = {"deviation.csv", "forces.csv"}


def open_plan(plan: Plan, folder: Path | None = None) -> page.Summary:
    """Return the first screen of a plan; programs that stand in a folder already are listed with their checksums."""
    verdict = plan.verdict
    tone = TONES[verdict.word]
    band = "not known" if verdict.band is None else format_mm(verdict.band)
    before = None if plan.promise is None else plan.promise.before
    uncorrected = "" if before is None else f" (uncorrected program {format_mm(before[1])})"
    change = format_mm_change(plan.before.max_deviation, plan.after.max_deviation)
    figures = [
        page.KeyFigure(band, f"95 % band{uncorrected}: the true tip stays that close to the path; "
                       f"the tolerance is {format_set_length(verdict.tolerance)}",
                       tone if verdict.word != "not_known" else ""),
        page.KeyFigure(change, "greatest deviation without and with correction, if the robot is as modelled"),
        page.KeyFigure(f"{format_number(float(plan.timing.time[-1]))}\u00a0s",
                       f"for {format_length(plan.task.nominal.cutting_length)} of cut"),
    ]  # fmt: skip
    if verdict.beyond_share:
        beyond = format_percent(verdict.beyond_share)
        figures[2] = page.KeyFigure(beyond, "of the cut may be beyond the tolerance", "bad")
    told = "Distance of the tool tip from the path. The 95 % band has to stay below the tolerance."
    picture = page.Chart(draw_curves(plan.curves()), told, 340)
    step = verdict.change if plan.job is None else verdict.change.replace(" JOB", f" {plan.job.file.name}")
    todo = step or "Run the program without a part at reduced override, then cut and measure one part."
    sentence, stops = first_sentence(verdict.sentence), list_stops(plan.notes)
    return page.Summary(sentence, tone, figures, picture, todo, stops, write_sheet(plan, folder))


def first_sentence(text: str) -> str:
    """Return the first sentence of a text."""
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", text.strip(), maxsplit=1)[0]


def write_sheet(plan: Plan, folder: Path | None) -> page.Section:
    """Return the setup sheet: part, frames, tool, start, band, and the checksums of the programs."""
    lines = [("Job", plan.name), ("Verdict", plan.verdict.sentence), *_describe_frames(plan), *_describe_run(plan)]
    rows: list[page.Row] = [[page.Cell(name, "strong"), words] for name, words in lines]
    rows += [[page.Cell("Before the machine moves", "bad"), stop] for stop in list_stops(plan.notes)]
    blocks: list[page.Block] = [
        page.DataTable(["Setup", ""], rows),
        "Set up by ______________________   Checked by ______________________   Date ______________",
    ]
    programs = [] if folder is None else list_programs(folder)
    if programs:
        caption = "The file on the controller is this one if its checksum is the same."
        blocks.append(page.DataTable(["Program", "lines", "SHA-256, first 16 digits"], programs, caption))
    return page.Section("Setup sheet", blocks, "Check each line at the machine before the program runs.", True)


def list_programs(folder: Path) -> list[tuple[str, int, str]]:
    """List program files in a folder: name, lines, and the first digits of their checksum."""
    files = sorted(file for file in folder.rglob("*") if file.suffix not in NO_PROGRAM and file.is_file())
    files = [file for file in files if file.name not in NO_PROGRAM_NAMES]
    found = []
    for file in files:
        content = file.read_bytes()
        digest = hashlib.sha256(content).hexdigest()[:16]
        found.append((str(file.relative_to(folder)), content.count(b"\n"), digest))
    return found


def describe_pose(pose: Array) -> str:
    """Write a pose (4, 4) [m] as pendants take it: millimetres, and angles by the names of the common forms."""
    x, y, z, a, b, c = place_numbers(pose, "ZYX", 3)
    turn = np.degrees(rotation_vectors(pose[None])[0]).round(3) + 0.0
    place = f"X {x:g}  Y {y:g}  Z {z:g} mm"
    if not np.any(turn):
        return f"{place}, not turned"
    vector = ", ".join(f"{value:g}" for value in turn)
    return f"{place}; A {a:g}  B {b:g}  C {c:g} deg (z, y', x''); rotation vector {vector} deg"


def _say_range(joint: Joint, low: float, high: float) -> str:
    """Say over which positions [rad or m] a joint that carries the part goes."""
    size, unit = (1e3, "mm") if joint.kind == "prismatic" else (180.0 / np.pi, "deg")
    return f"{joint.name} stands at {size * low:.5g} {unit}" if high - low < 1e-9 else (
        f"{joint.name} goes from {size * low:.5g} to {size * high:.5g} {unit}")  # fmt: skip


def _describe_frames(plan: Plan) -> list[tuple[str, str]]:
    """Return robot, part and tool in words."""
    robot, job = plan.robot, plan.job
    controller = load_controller(robot)
    rows = [("Robot", f"{robot.name}; controller {controller.name or 'not known'}"),
            ("Robot model", explain_grade(robot))]  # fmt: skip
    if job is not None:
        where = f"on {robot.base}, that carries the part" if robot.ground else "in the robot base"
        rows.append((f"Part frame, {where}", describe_pose(job.T_base_part)))
        rows.append(("Part frame found by", describe_part_frame(job).removeprefix("part frame: ")))
    if robot.ground:
        low, high = plan.q.min(axis=0), plan.q.max(axis=0)
        said = [_say_range(robot.actuated[k], low[k], high[k]) for k in np.flatnonzero(robot.carriers).tolist()]
        rows.append(("Positioner", "; ".join(said)))
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
    """Return start, feed, clearance and band in words."""
    robot, verdict = plan.robot, plan.verdict
    first = plan.approach.key_q[0] if len(plan.approach.key_q) else plan.q[0]
    joints = ", ".join(f"{name.split('_')[0]} {round(float(values[0]), 2) + 0.0:.2f} {name.split('_')[1]}"
                       for name, values in robot.joint_columns(first[None]).items())  # fmt: skip
    wanted = 1e3 * plan.task.nominal.feed[plan.task.cut & ~plan.task.nominal.rapid]
    slow, speed = mark_slow(plan.task, plan.timing), "not known"
    if len(wanted):
        ends = dict.fromkeys(f"{end:.4g}" for end in (wanted.min(), wanted.max()))
        speed = f"programmed {' to '.join(ends)} mm/s"
        speed += f", lowered to {1e3 * plan.timing.feed[slow].min():.3g} mm/s" if slow.any() else ""
    rows = [
        ("First joint position", joints),
        ("Feed of the cut", f"{speed}; {plan.timing.time[-1]:.4g} s in all"),
        ("Nearest joint limit", describe_margin(plan)),
    ]
    if clearance := describe_clearance(plan):
        rows.append(("Least clearance", clearance))
    band = "not known" if verdict.band is None else format_mm(verdict.band)
    rows.append(("Tolerance and 95 % band", f"{format_set_length(verdict.tolerance)}; band {band}"))
    force = float(np.linalg.norm(plan.task.wrench[:, :3], axis=1).max(initial=0.0))
    return [*rows, ("Greatest predicted force", f"{force:.4g} N" if force else "none predicted"), *_describe_cut(plan)]


def _describe_cut(plan: Plan) -> list[tuple[str, str]]:
    """Return cutter, material and spindle in words, where a cutter's engagement predicts the force."""
    process = None if plan.job is None else plan.job.process
    if not isinstance(process, CuttingTable):
        return []
    material = process.material or "coefficients of the job"
    cutter = f"{process.model} {2e3 * process.cutter().radius:g} mm, {process.teeth} teeth, {process.spindle_rpm:g} rpm"
    moment = np.abs(np.einsum("ni,ni->n", plan.task.wrench[:, 3:], plan.task.rotation[:, :, 2])).max(initial=0.0)
    power = 2.0 * np.pi * (process.spindle_rpm / 60.0) * moment
    return [("Cutter", f"{cutter}, in {material}"), ("Spindle", f"up to {moment:.3g} N m, {1e-3 * power:.3g} kW")]


def describe_margin(plan: Plan) -> str:
    """Say which joint comes nearest to its limit, as a share of half a turn or of a metre."""
    robot = plan.robot
    margin = np.minimum(plan.q - robot.lower, robot.upper - plan.q).min(axis=0)
    margin[robot.lower == robot.upper] = np.inf  # stands where the job holds it
    share = margin / np.where(robot.prismatic, 1.0, np.pi)
    if not np.isfinite(share).any():
        return "no limits"
    k = int(np.argmin(share))
    scale, unit = (1e3, "mm") if robot.prismatic[k] else (180 / np.pi, "deg")
    return f"{format_number(float(margin[k] * scale))} {unit} ({robot.joint_names[k]})"


def describe_clearance(plan: Plan) -> str:
    """Say what comes nearest to arm and tool; "" where that was not asked for."""
    if plan.clearance is None:
        return ""
    near = min(plan.clearance.least[1], plan.clearance.own, key=lambda contact: contact.distance)
    known = np.isfinite(near.distance) and near.first
    return f"{format_length(near.distance)} ({near.first} to {near.second})" if known else ""
