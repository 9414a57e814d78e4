"""Write a plan: plan.json, joints.csv, native programs, the page. All files, or none.

An error in one file leaves no files (`compplan.io.transaction`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers import Program, build_program, describe_program, find_ends, write_program
from compplan.controllers.writers.joint_convention import load_motion
from compplan.controllers.writers.program import Post
from compplan.io.quantities import state_mm
from compplan.io.tables import write_json, write_table
from compplan.io.transaction import list_files, replace_folder
from compplan.job.frames import ToolTable
from compplan.job.job import Job
from compplan.planning.checks import Check, state_notes
from compplan.planning.executed import bound_zones
from compplan.planning.result import Plan
from compplan.planning.tolerance_verdict import state_percent
from compplan.reporting.writers.recording import write_recording
from compplan.robot import Array
from compplan.robot.pose import build_pose
from compplan.statics.chain import locate_frames
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.corners import find_corner_shifts
from compplan.toolpath.events import ENDING, Event, find_halts
from compplan.toolpath.toolpath import WRENCH_HEADERS


def write_plan(plan: Plan, folder: str | Path) -> list[Path]:
    """Write a plan: plan.json, joints.csv, report.html, the files of `compplan view`, the native programs of its job.

    Returns the files written.

    Raises:
        InputError: If the folder cannot be written, or a program does not fit its language; nothing is written then.
    """
    return deliver_plan(plan, folder)[1]


def deliver_plan(plan: Plan, folder: str | Path) -> tuple[Plan, list[Path]]:
    """Write a plan as `write_plan` does; return the plan with the checks of the files read back, and the files."""
    with replace_folder(folder, "plan") as part:
        plan = write_moves(plan, part)[0]
        write_beside(plan, part)
        names = list_files(part)
    return plan, [Path(folder) / name for name in names]


def write_moves(plan: Plan, part: Path) -> tuple[Plan, list[Path]]:
    """Write programs and joints.csv of a plan into an existing folder, and read them back.

    Returns the plan with the checks of its files, and the programs.
    """
    program = make_program(plan)
    programs = write_programs(plan, part, program)
    write_joints(plan, part / "joints.csv")
    before = plan.status
    plan = read_back(plan, part, program)
    if plan.status != before:  # the program heads contain the status
        for file in programs:
            file.unlink(missing_ok=True)
        programs = write_programs(plan, part)
    return plan, programs


def write_beside(plan: Plan, part: Path) -> None:
    """Write the files of a plan other than its moves: the page, the files of `compplan view`, plan.json."""
    from compplan.reporting.plan_page import write_plan_page

    write_recording(plan, part, tabulate_joints(plan), choose_rows(plan))
    write_plan_page(plan, part / "report.html")
    write_json(part / "plan.json", plan.to_dict(), indent=2)


def read_back(plan: Plan, folder: Path, program: Program | None = None) -> Plan:
    """Check the files of a plan with independent readers and add the findings; without a job the plan is unchanged.

    `program`: source of the files, if available.
    """
    from compplan.controllers.readback.comparison import StiffArm, compare_written
    from compplan.controllers.readback.fitted import PlannedRows
    from compplan.controllers.readback.joint_table import check_joint_table
    from compplan.simulation.exact_model import read_exact_robot
    from compplan.simulation.inertia import solve_rigid

    job, robot = plan.job, plan.robot.folder
    if job is None or robot is None or job.context.mounted is not None:
        return plan
    way, back, n = plan.approach, plan.retract, len(plan.task)
    first, last = len(way.q), len(way.q) + n
    time = _list_times(plan)
    ahead, behind = (_find_rows(part.key_q, part.q) for part in (way, back))
    rows = np.r_[ahead, first + np.arange(n), last + behind]
    feed = np.r_[np.zeros(first), np.where(plan.task.nominal.rapid, 0.0, command_feed(plan)), np.zeros(len(back.q))]
    q = np.vstack([way.q, plan.q, back.q])
    standstill = _mark_standstills(plan, len(ahead), len(behind))
    free = np.r_[np.zeros(len(ahead), bool), plan.task.lead, np.zeros(len(behind), bool)]
    position, axis = place_rows(plan)
    tip = np.hstack([1e3 * position, axis, predict_rows(plan)])
    program = program or make_program(plan)
    none = np.zeros((len(rows), 3))
    programmed = none[:, 0] if program.asked is None else program.asked
    corner = none if program.corner_shift is None else program.corner_shift
    tool = job.tool or ToolTable()
    table_of_tool = None if job.tool is None else job.tool.model_dump(exclude_unset=True)
    held, flange = (
        read_exact_robot(Path(robot), told, geometry="controller.urdf")
        for told in (table_of_tool, {"frame": "pendant"})
    )
    place, rotation = solve_rigid(held, q[rows])
    (flange_place,), (turn,) = solve_rigid(flange, q[rows[:1]])
    wanted = PlannedRows(
        1e3 * place, rotation, q[rows], time[rows], 1e3 * feed[rows], standstill, free, programmed,
        1e3 * corner, 1e3 * job.output.bound_fit(plan.task.tolerance),
    )  # fmt: skip
    centre = np.linalg.inv(tool.pose) @ np.r_[1e-3 * np.array(tool.centre_of_mass_mm), 1.0]
    arm = StiffArm(
        bool(held.ground), partial(solve_rigid, held), build_pose(1e3 * turn.T @ (place[0] - flange_place),
        turn.T @ rotation[0]), build_pose(1e3 * job.T_base_part[:3, 3], job.T_base_part[:3, :3]), tool.mass_kg,
        centre[:3],
    )  # fmt: skip
    said = check_joint_table(folder / "joints.csv", plan.robot, time, q, tip, choose_rows(plan))
    output = job.output
    breaches, notes = compare_written(
        folder, output.programs, Path(robot), arm, wanted, partial(find_ends, program), main=output.main,
        may_be_unreadable=bool(output.io.model_fields_set),
    )  # fmt: skip
    failed = (Check("read back", np.nan, 0.0, text) for text in (*said, *breaches))
    return plan.add_checks((*failed, *state_notes(notes)))


def _mark_standstills(plan: Plan, before: int, after: int) -> NDArray[np.bool_]:
    """Mark the rows of a program at which the tool has to stop, in addition to the ends of rapid moves.

    These are the start of the cut after an approach, halting events, and rests of the plan.
    """
    n = len(plan.task)
    standstill = np.zeros(before + n + after, bool)
    standstill[before : before + n] = plan.task.rests
    standstill[before] |= before > 0
    standstill[find_halts(place_events(plan.task.nominal.events, before, n, after))] = True
    return standstill


def _find_rows(some: Array, among: Array) -> NDArray[np.int_]:
    """Return the rows of `among` equal to the postures `some`, in order; the last match of each."""
    found, left = [], len(among)
    for posture in some[::-1]:
        fits = np.flatnonzero(np.abs(among[:left] - posture).max(axis=1) < 1e-12)
        left = int(fits[-1]) if len(fits) else max(left - 1, 0)
        found.append(left)
    return np.array(found[::-1], int)


def place_rows(plan: Plan, wanted: Array | None = None) -> tuple[Array, Array]:
    """Return nominal tip (n, 3) [m] and tool axis (n, 3) of the rows of joints.csv.

    Approach and retract are given by joints only: their rows contain the resulting pose of the loaded tool.
    """
    task, parts = plan.task, []
    for way in (plan.approach, plan.retract):
        if len(way.q):
            held = task.to_part_frame_pose(attain_pose(task.chain, way.q, way.wrench, slope=False))
            parts.append((held.position, -held.rotation[:, :, 2]))
        else:
            parts.append((np.zeros((0, 3)), np.zeros((0, 3))))
    position = np.vstack([parts[0][0], task.position if wanted is None else wanted, parts[1][0]])
    return position, np.vstack([parts[0][1], task.nominal.axis, parts[1][1]])


def write_joints(plan: Plan, path: Path, wanted: Array | None = None) -> None:
    """Write joints.csv; see `tabulate_joints`."""
    write_table(path, tabulate_joints(plan, wanted), decimals=10)


def tabulate_joints(plan: Plan, wanted: Array | None = None) -> dict[str, NDArray[Any]]:
    """Return the columns of joints.csv: time, commanded joints, nominal tip and tool axis, the wrench, kind of move.

    The wrench is the prediction of [process] in the job, without corrections learned from parts. `wanted`: nominal tip,
    if the plan has a displaced target. Shape (n, 3). [m]
    """
    robot, task, before, after = plan.robot, plan.task, plan.approach, plan.retract
    rows = choose_rows(plan)
    q = np.vstack([before.q, plan.q, after.q])
    position, axis = place_rows(plan, wanted)
    wrench = predict_rows(plan)
    stays = np.where(task.leaving, "retract", "approach")
    move = np.where(task.nominal.rapid, "rapid", np.where(task.lead, stays, "cut"))
    columns: dict[str, NDArray[Any]] = {"time_s": _list_times(plan)}
    columns |= robot.joint_columns(q)
    columns |= {f"{name}_mm": position[:, k] * 1e3 for k, name in enumerate("xyz")}
    columns |= {name: axis[:, k] for k, name in enumerate("ijk")}
    columns |= {name: wrench[:, k] for k, name in enumerate(WRENCH_HEADERS)}
    columns["move"] = np.array(["approach"] * len(before.q) + move.tolist() + ["retract"] * len(after.q))
    return {name: values[rows] for name, values in columns.items()}


def predict_rows(plan: Plan) -> Array:
    """Return the wrench predicted by [process] at every row of joints.csv, base axes. Shape (n, 6). [N, N m]"""
    task = plan.task
    wrench = np.vstack([plan.approach.wrench, task.wrench, plan.retract.wrench])
    if task.law is None or task.law.learned is None:
        return wrench
    return task.law.learned.invert(wrench, task.law.T_base_part[:3, :3])


def _list_times(plan: Plan) -> Array:
    """Return the time of every row: approach, path, retract. [s]"""
    before, after = plan.approach, plan.retract
    start = float(before.gap.sum())
    end = start + float(plan.timing.time[-1])
    return np.r_[np.r_[0.0, np.cumsum(before.gap)][:-1], start + plan.timing.time, end + np.cumsum(after.gap)]


def choose_rows(plan: Plan) -> NDArray[np.bool_]:
    """Mark the rows that joints.csv holds, at least one controller cycle apart except for rows that must be kept.

    Ends of cuts and rapid moves, rests and events are kept; of others that follow too soon the later ones are left out.
    """
    time, cycle = _list_times(plan), load_motion(plan.robot)[0].cycle * (1.0 - 1e-9)
    if np.diff(time).min(initial=np.inf) >= cycle:
        return np.ones(len(time), bool)
    first, n = len(plan.approach.q), len(plan.task)
    rapid = np.r_[plan.task.nominal.rapid, True]
    stay = np.zeros(len(time), bool)
    stay[[0, -1, first]] = True
    stay[first : first + n] |= rapid[:-1] | rapid[1:]
    stay[first : first + n] |= plan.task.rests
    stay[[first + event.place for event in plan.task.nominal.events if event.place >= 0]] = True
    selected: list[int] = []
    for row in range(len(time)):
        if selected and time[row] - time[selected[-1]] < cycle:
            if not stay[row]:
                continue
            if not stay[selected[-1]]:
                selected.pop()
        selected.append(row)
    chosen = np.zeros(len(time), bool)
    chosen[selected] = True
    return chosen


def write_programs(plan: Plan, folder: Path, program: Program | None = None) -> list[Path]:
    """Write the native programs requested by the job, with approach and retract."""
    if plan.job is None or not plan.job.output.programs:
        return []
    program, output, files = program or make_program(plan), plan.job.output, []
    for language in output.programs:
        post = make_post(plan.job, language)
        own = program if post == program.post else replace(program, post=post)
        files += write_program(own, language, folder, any_brand=output.any_brand)
    return files


def make_post(job: Job, language: str) -> Post:
    """Return the job settings for programs of a language: template, tool and base, main program."""
    output, cell = job.output, job.output.cell
    template = output.templates.get(language)
    main = None if output.main is None else "_".join(filter(None, [output.main, job.label]))
    own = None if template is None else job.folder / template
    return Post(own, cell.tool, cell.base, cell.overwrite, main)


def note_programs(plan: Plan) -> Plan:
    """Return a plan with notes on its native programs."""
    if plan.job is None or not plan.job.output.programs:
        return plan
    program = make_program(plan)
    posts = {language: make_post(plan.job, language) for language in plan.job.output.programs}
    notes = [note for key, post in posts.items() for note in describe_program(replace(program, post=post), key)]
    return plan.add_checks(state_notes(notes))


def make_program(plan: Plan) -> Program:
    """Build the source of native programs, with approach and retract."""
    above, below = plan.approach.key_q, plan.retract.key_q
    before, after = len(above), len(below)
    rapid = np.r_[np.ones(before, bool), plan.task.nominal.rapid, np.ones(after, bool)]
    exact = np.zeros(len(rapid), dtype=bool)
    exact[before] = before > 0  # stop at the start of the cut
    exact[before : before + len(plan.task)] |= plan.task.rests
    free = np.r_[np.zeros(before, bool), plan.task.lead, np.zeros(after, bool)]
    feed = np.r_[np.zeros(before), command_feed(plan), np.zeros(after)]
    start = float(plan.approach.key_gap.sum())
    down = np.r_[0.0, np.cumsum(plan.approach.key_gap)][:before]
    up = start + plan.timing.time[-1] + np.cumsum(plan.retract.key_gap)
    time = np.r_[down, start + plan.timing.time, up]
    program = build_program(
        plan.robot, np.vstack([above, plan.q, below]), feed, rapid, time=time, comments=_head(plan), exact=exact,
        name=plan.name if plan.job is None else "_".join(filter(None, [plan.job.file.stem, plan.job.label])),
        part=None if plan.job is None else plan.job.T_base_part,
        events=place_events(plan.task.nominal.events, before, len(plan.task), after),
        wiring=None if plan.job is None else plan.job.output.io,
    )  # fmt: skip
    if plan.job is None:
        return program
    output, motion = plan.job.output, load_motion(plan.robot)[0]
    zones = bound_zones(plan.task, motion)
    drawn, lines = (
        None if marks is None else np.r_[np.zeros(before, int), marks, np.zeros(after, int)]
        for marks in (plan.task.nominal.arc, plan.task.nominal.line)
    )
    path, shift = plan.task.nominal, None
    if program.tcp is not None and not plan.robot.carrying:
        tip = program.tcp[before : before + len(path), :3, 3]
        shift = find_corner_shifts(path, tip, zones["corner"])
    if shift is not None:
        shift = np.vstack([np.zeros((before, 3)), shift, np.zeros((after, 3))])
    zones["corner"] = np.r_[np.ones(before), zones["corner"], np.ones(after)]
    programmed = np.r_[np.zeros(before), 1e3 * path.feed, np.zeros(after)]
    return replace(
        program, tolerance=output.bound_fit(plan.task.tolerance), corner_shift=shift, asked=programmed,
        cycle=motion.cycle, free=free, form=output.form, arc_of=drawn, line_of=lines,
        **zones,
    )  # fmt: skip


def command_feed(plan: Plan) -> Array:
    """Return the feed of the move to each waypoint; of the commanded tip if the nominal tip does not move.

    Shape (n,). [m/s]
    """
    task = plan.task
    feed, still = plan.timing.feed.copy(), np.r_[True, task.nominal.steps <= 0] & ~task.nominal.rapid
    tip = np.vstack([locate_frames(task.chain, q).tcp_position for q in (plan.approach.key_q[-1:], plan.q)])
    tip = np.vstack([tip[:1], tip])[-len(feed) - 1 :]
    step = np.r_[plan.approach.key_gap[-1:] if len(plan.approach.key_gap) else 1.0, np.diff(plan.timing.time)]
    moved = np.linalg.norm(np.diff(tip, axis=0), axis=1) / np.maximum(step, 1e-9)
    return np.asarray(np.where(still, np.maximum(moved, 1e-4), feed))


def place_events(events: Sequence[Event], before: int, count: int, after: int) -> list[Event]:
    """Shift the events of a path of `count` rows to the rows of its program, which begins with the approach.

    Ending events at the last row of the path are moved to the end of the retract.
    """
    rows = [
        -1 if event.place < 0 else event.place + before + after * (event.place == count - 1 and event.kind in ENDING)
        for event in events
    ]
    in_order = np.maximum.accumulate(rows).tolist() if rows else []
    return [replace(event, place=row) for event, row in zip(events, in_order, strict=True)]


def _head(plan: Plan) -> list[str]:
    verdict = plan.verdict
    words = {"keeps": "keeps", "may_not_keep": "MAY NOT KEEP", "not_known": "NOT KNOWN if it keeps"}
    lines = [
        f"compplan: {plan.name}",
        f"robot {plan.robot.name}, robot model: {plan.robot.grade}, strategy {plan.strategy}",
        *head_of_status(plan), f"verdict: {words[verdict.word]} {state_mm(verdict.tolerance)}",
    ]  # fmt: skip
    lines += [] if verdict.band is None else [f"true tip within {state_mm(verdict.band)}, 95 %"]
    return lines + ([f"beyond: {state_percent(verdict.beyond_share)} of the cut"] if verdict.beyond_share else [])


def head_of_status(plan: Plan) -> list[str]:
    """Return the head line that warns of a plan that is not solved."""
    if plan.status == "solved":
        return []
    word = "INFEASIBLE" if plan.status == "infeasible" else "NOT CONFIRMED"
    return [f"{word}: the best compromise, not a program to run"]
