"""Yaskawa INFORM jobs (.JBI): positions as joint angles, or Cartesian in a user frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import MainForm, need_six_axes
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import Program, describe_feeds, head_lines, joint_percent, name_parts
from compplan.controllers.writers.text import clean_text, legal_name, wrap_text
from compplan.controllers.writers.zones import stop_at_corners
from compplan.io.tables import Array, write_text

name = "inform"
BRAND = "Yaskawa"
#: Positions in a job where the program's job says nothing.
MOST = 2000
#: A job's name has 32 letters (older controllers 8), its remarks 32.
LONGEST_NAME, LONGEST_REMARK = 24, 32
#: Tool and user frame where a job names none, and the position variables through which jobs fill them if asked.
CELL = CellWords(int, int, {"tool": 1, "base": 1, "positioner": 1})
TOOL_VARIABLE, FRAME_VARIABLE, MOVES_PART = 98, 99, True
RAPID_PERCENT, SLOWEST_PERCENT = 20.0, 0.01
#: Position level within a cut: 1 is the one that passes nearest without a stop.
BLEND = 1


PHRASES = Phrases(
    say=lambda text: [f"'{part}" for part in wrap_text(text, LONGEST_REMARK)],
    switch=lambda signal, on: [f"DOUT OT#({signal}) {'ON' if on else 'OFF'}"],
    wait=lambda seconds: [f"TIMER T={seconds:.2f}"],
    expect=lambda signal: [f"WAIT IN#({signal})=ON"],
    pause=lambda task: ["PAUSE"],
    pause_if=lambda signal, task: [f"PAUSE IF IN#({signal})=ON"],
    call=lambda name, number: [f"CALL JOB:{name.upper()}"],
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.JBI with joint angles and, where poses and configuration words are known, NAME_L.JBI with positions.

    Cutting moves of the linear job are MOVL with their feed (mm/s), rapid moves and swings MOVJ at 20 %; the joint job
    has MOVJ with percents of the joint rates, to two digits. Positions count from a user frame of the cell, with a tool
    of the cell; the job fills them (MFRAME, SETTOOL) where that is asked for. Joint angles need a controller that takes
    POSTYPE ANGLE. Joints that carry the part are a station (ST1, angles EC); positions are joint angles then, and lines
    are driven seen from the part (SMOVL .. +MOVJ EC).
    """
    if not program.moves_part or program.prismatic.any() or len(program.joint_names) - program.outer.sum() != 6:
        need_six_axes(program, "INFORM", sliding=0)
    name = legal_name(name_main(program), LONGEST_NAME).upper()
    can = program.tcp is not None and (program.moves_part or {"shoulder", "elbow", "wrist"} <= set(program.words))
    files: list[Path] = []
    if program.writes_joints(linear=can):
        files += _write_kind(program, folder, name, most, linear=False)
    if can and program.form != "joint":
        name += name_kind(program, "_L")
        fitted = stop_at_corners(fit_moves(program, arcs=False).program, "inform")
        files += _write_kind(fitted, folder, name, most, linear=True)
    return files


def describe(program: Program) -> list[str]:
    """Return what must be said of joint angles, and where there is no job with positions."""
    moves = fit_moves(program).program if program.pieces else program
    written = np.maximum(np.round(moves.feed, 1), 0.1)
    notes = ["joint angles need a controller that takes POSTYPE ANGLE", *describe_feeds(moves, written, "0.1 mm/s")]
    if not program.moves_part and not {"shoulder", "elbow", "wrist"} <= set(program.words):
        notes.append("no job with positions: controller.toml has no configuration words")
    return notes


def configurations(program: Program) -> NDArray[np.int64]:
    """Return the first six numbers of RCONF: no flip, lower arm, rear, turns of axes R, T and S. Shape (n, 6)."""
    first = {"wrist": "noflip", "elbow": "down", "shoulder": "back"}
    words = [(program.words[key] == value).astype(np.int64) for key, value in first.items()]
    turned = (program.joints[:, [3, 5, 0]] >= 180.0).astype(np.int64)
    return np.column_stack([*words, turned])


def _write_kind(program: Program, folder: Path, name: str, most: int | None, *, linear: bool) -> list[Path]:
    parts = name_parts(name, len(program), most or MOST, single=True)
    files = []
    for part, rows in parts.items():
        points, moves = _points(program, rows, linear), _moves(program, rows, linear)
        files.append(folder / f"{part}.JBI")
        write_text(files[-1], format_job(program, part, points, moves, main=len(parts) == 1), newline="\r\n")
    if len(parts) > 1:
        files.append(folder / f"{name}.JBI")
        write_text(files[-1], format_job(program, name, [], [], main=True, parts=[*parts]), newline="\r\n")
    return files


def _points(program: Program, rows: slice, linear: bool) -> list[str]:
    """Return the C positions of a job in order, each number once: joint angles, or Cartesian ones in a user frame."""
    by_joints = np.ones(rows.stop - rows.start, dtype=bool)
    alone = program.alone(linear=linear)[rows] if linear and not program.moves_part else by_joints
    joints, lines = program.joints[rows], list[str]()
    table, configuration = np.zeros((len(alone), 6)), np.zeros((len(alone), 6), np.int64)
    if not alone.all():
        table, configuration = place_table(program.positions[rows], "xyz"), configurations(program)[rows]
    user = ["///POSTYPE USER", "///RECTAN"]
    last = "none yet"
    for row, by_angle in enumerate(alone.tolist()):
        words = "" if by_angle else ",".join(map(str, [*configuration[row].tolist(), *[0] * 18]))
        if by_angle and words != last:
            lines += ["///POSTYPE ANGLE", "///ANGLE"]
        elif words != last:
            lines += [*(user if last in ("", "none yet") else []), f"///RCONF {words}"]
        last = words
        arm = joints[row, ~program.outer]
        place = f"{_values(table[row, :3], 3)},{_values(table[row, 3:], 4)}"
        lines.append(f"C{row:05d}={_values(arm, 6) if by_angle else place}")
    if program.moves_part:
        lines += [f"EC{row:05d}={_values(station, 6)}" for row, station in enumerate(joints[:, program.outer])]
    return lines


def _moves(program: Program, rows: slice, linear: bool) -> list[str]:
    alone, stops = program.alone(linear=linear), program.stops(linear=linear)
    events = phrase_events(program.events, program.wiring, PHRASES, "INFORM")
    percent = joint_percent(program, RAPID_PERCENT, SLOWEST_PERCENT)
    lines = events.get(-1, []) if rows.start == 0 else []
    for row in range(rows.start, rows.stop):
        place, level = f"C{row - rows.start:05d}", f"PL={0 if stops[row] else BLEND}"
        station = f" +MOVJ E{place}" if program.moves_part else ""
        if linear and not alone[row]:
            word = "SMOVL" if station else "MOVL"
            lines += [f"{word} {place} V={max(program.feed[row], 0.1):.1f} {level}{station}", *events.get(row, [])]
            continue
        lines += ["'the configuration changes"] if linear and program.swings[row] else []
        turned = f"{station} VJ={percent[row]:.2f}" if station else ""
        lines += [f"MOVJ {place} VJ={percent[row]:.2f} {level}{turned}", *events.get(row, [])]
    return lines


def format_job(
    program: Program, name: str, points: list[str], moves: list[str], *, main: bool, parts: Sequence[str] = ()
) -> str:
    """Return the file of a job: its head, its positions, its instructions; `main`: with frames, header and footer."""
    tool = np.eye(4) if program.tool is None else program.tool
    words = {
        "name": name, "count": sum(line.startswith("C") for line in points), "points": points, "main": main,
        "station": program.moves_part,
        "cell": check_cell(program.post, CELL, "INFORM"), "tool_variable": TOOL_VARIABLE,
        "user": "///POSTYPE USER" in points,
        "frame_variable": FRAME_VARIABLE, "tool": _values(np.array(place_numbers(tool, "xyz")), 7),
        "base": _values(np.array(place_numbers(program.base_frame, "xyz")), 7), "moves": moves, "parts": parts,
        "comments": [clean_text(line, LONGEST_REMARK) for line in head_lines(program)],
        "mass": "" if program.mass is None else f"{program.mass:.2f}",
    }  # fmt: skip
    return render_post(program, "inform", words)


def _values(values: Array, digits: int) -> str:
    return ",".join(f"{value:.{digits}f}" for value in values + 0.0)


def _format_main(name: str, program: Program, calls: Sequence[str]) -> str:
    plain = replace(program, post=replace(program.post, overwrite=False), header=(), footer=())
    return format_job(plain, name, [], [], main=False, parts=calls)


MAIN = MainForm(".JBI", 28, _format_main)
