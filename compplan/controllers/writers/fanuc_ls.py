"""FANUC teach pendant programs as ASCII (.ls), positions in joint representation or Cartesian in a user frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import MainForm
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import Program, describe_feeds, head_lines, joint_percent, name_parts
from compplan.controllers.writers.text import clean_text, legal_name, wrap_text
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text

name = "fanuc_ls"
BRAND = "FANUC"
#: Positions in a program where the job says nothing.
MOST = 1000
#: A teach pendant program takes 36 letters (R-30iB; older ones 8), a remark 32.
LONGEST_NAME = 26
LONGEST_REMARK = 32
#: Greatest and least linear speed in mm/sec; slower ones are in cm/min, at least SLOWEST of these.
FASTEST, SLOW, SLOWEST = 2000.0, 1.0, 1.0
#: Share of the axis rates that rapid moves take (assumed). [%]
RAPID = 20
#: Tool and user frame where a job names none, and the position register through which programs fill them if asked.
CELL, REGISTER = CellWords(int, int, {"tool": 1, "base": 1, "positioner": 2}), 99
MOVES_PART = True


PHRASES = Phrases(
    say=lambda text: [f"!{part}" for part in wrap_text(text, LONGEST_REMARK)],
    switch=lambda signal, on: [f"DO[{signal}]={'ON' if on else 'OFF'}"],
    wait=lambda seconds: [f"WAIT {seconds:7.2f}(sec)"],
    expect=lambda signal: [f"WAIT DI[{signal}]=ON"],
    pause=lambda task: ["PAUSE"],
    pause_if=lambda signal, task: [f"IF DI[{signal}]=OFF,JMP LBL[@]", "PAUSE", "LBL[@]"],
    call=lambda name, number: [f"CALL {name.upper()}({number:.0f})"],
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.LS with joint positions and NAME_L.LS with Cartesian ones; long ones call NAME_1.LS and so on.

    Cutting moves are lines (L) and arcs (C) with their feed, rapid moves and swings joint moves (J). Cartesian
    positions count from a user frame of the cell, with a tool frame of the cell; the program fills both, through
    PR[99], where the job asks for that, else remarks say what they have to be. Cartesian positions are written where
    poses and configuration words (native N F, U D, T B) are known. Sliding joints are extended axes (E1 ..), in mm.

    Joints that carry the part are a motion group of their own (GP2); all positions are joint positions then, and lines
    are driven seen from the part (COORD).
    """
    turning, sliding = np.flatnonzero(~program.outer), np.flatnonzero(program.outer)
    if len(turning) > 6 or len(sliding) > 3 or (program.moves_part and program.prismatic.any()):
        raise InputError(f"FANUC programs take six rotating and three sliding joints, not {list(program.joint_names)}")
    if program.feed.max(initial=0.0) > FASTEST:
        raise InputError(f"feed is {program.feed.max():g} mm/s, FANUC programs take at most {FASTEST:g} mm/s")
    name = legal_name(name_main(program), LONGEST_NAME).upper()
    cell = check_cell(program.post, CELL, "FANUC")
    base, tool = int(cell.base or 1), int(cell.tool or 1)
    can = program.tcp is not None and len(turning) == 6
    can, files = can and (program.moves_part or configurations(program) is not None), []
    if program.writes_joints(linear=can):
        joint = [_joint_entries(program, row, 0) for row in range(len(program))]
        files += _write_kind(program, folder, name, joint, 0, most)
    if can and program.form != "joint":
        program = fit_moves(program, arcs=not program.moves_part).program
        configuration = configurations(program) or []
        alone = program.alone(linear=True) | program.moves_part
        linear = []
        for row, place in enumerate(_places(program, program.positions)):
            if alone[row]:
                linear.append(_joint_entries(program, row, base))
                continue
            linear.append([f"\tUF : {base}, UT : {tool},\t\tCONFIG : '{configuration[row]}'", *place])
        files += _write_kind(program, folder, f"{name}{name_kind(program, '_L')}", linear, base, most)
    return files


def describe(program: Program) -> list[str]:
    """Return what must be said of feeds, and where there is no program with positions."""
    moves = fit_moves(program).program if program.pieces else program
    slow = np.maximum(np.round(6.0 * moves.feed, 1), SLOWEST) / 6.0
    written = np.where(moves.feed >= SLOW, np.round(moves.feed, 1), slow)
    notes = describe_feeds(moves, written, "0.1 mm/s, below 1 mm/s of 0.1 cm/min")
    if configurations(program) is None and not program.moves_part:
        notes.append("no program with positions: controller.toml has no native words N F, U D, T B")
    return notes


def configurations(program: Program) -> list[str] | None:
    """Return CONFIG of each position, such as "N U T, 0, 0, 0", or None where the words are not known.

    The numbers count the turns of J1, J4 and J6 (assumed): 0 from -180 up to 180 deg.
    """
    wanted = {"wrist": {"N", "F"}, "elbow": {"U", "D"}, "shoulder": {"T", "B"}}
    if any(not {*program.native.get(key, np.array(["?"])).tolist()} <= letters for key, letters in wanted.items()):
        return None
    turns = np.floor((program.joints[:, ~program.outer][:, [0, 3, 5]] + 180.0) / 360.0).astype(int).tolist()
    letters = zip(*(program.native[key].tolist() for key in wanted), strict=True)
    return [f"{' '.join(word)}, {', '.join(map(str, turn))}" for word, turn in zip(letters, turns, strict=True)]


def _write_kind(
    program: Program,
    folder: Path,
    name: str,
    entries: list[list[str]],
    frame: int,
    most: int | None,
) -> list[Path]:
    parts = name_parts(name, len(program), most or MOST, single=True)
    alone, stops = program.alone(linear=bool(frame)), program.stops(linear=bool(frame))
    events = {
        row: [f"  {line.replace('@', str(label))} ;" for line in lines]
        for label, (row, lines) in enumerate(
            phrase_events(program.events, program.wiring, PHRASES, "FANUC").items(), start=1
        )
    }
    share = _share_zones(program) if frame else np.full(len(program), 100)
    percent = np.where(program.rapid, RAPID, np.maximum(joint_percent(program).round(), 1.0)).astype(int)
    files, via = [], _places(program, program.via_positions) if frame and program.arcs.any() else []
    for part, rows in parts.items():
        numbers = range(1, rows.stop - rows.start + 1)
        indices = range(rows.start, rows.stop)
        moves = list(events.get(-1, [])) if rows.start == 0 else []
        arcs = [row for row in indices if frame and program.arcs[row]]
        extra = {row: rows.stop - rows.start + k for k, row in enumerate(arcs, start=1)}
        for row, number in zip(indices, numbers, strict=True):
            moves += ["  !the configuration changes ;"] if frame and program.swings[row] else []
            speed = int(percent[row]) if alone[row] else None
            move = _move(program, row, number, speed, 0 if stops[row] else int(share[row]), extra.get(row))
            moves += [move, *events.get(row, [])]
        positions = [_position(entries[row], number, _second_group(program, row))
                     for row, number in zip(indices, numbers, strict=True)]  # fmt: skip
        positions += [_position([entries[row][0], *via[row]], number) for row, number in extra.items()]
        files.append(folder / f"{part}.LS")
        write_text(files[-1], format_program(part, program, frame, moves, positions, len(parts) == 1), newline="\r\n")
    if len(parts) > 1:
        files.append(folder / f"{name}.LS")
        write_text(files[-1], format_program(name, program, frame, [], [], True, [*parts]), newline="\r\n")
    return files


def _share_zones(program: Program) -> NDArray[np.int_]:
    """Return how much of CNT100 each corner may have: a share of its size (assumed). Shape (n,). [%]"""
    _, stated, whole = find_zones(program, ZONES["fanuc_ls"])
    return np.clip(100.0 * np.minimum(stated, 1e9) / np.maximum(whole, 1e-9), 1.0, 100.0).astype(int)


def _move(program: Program, row: int, number: int, percent: int | None, share: int, via: int | None) -> str:
    if percent is not None:
        return f"J P[{number}] {percent}% FINE ;"
    manner = f"{f'CNT{share}' if share else 'FINE'}{' COORD' if program.moves_part else ''}"
    end = f"P[{number}] {_speed(program.feed[row])} {manner} ;"
    return f"L {end}" if via is None else f"C P[{via}]\n    :  {end}"


def _speed(feed: float) -> str:
    return f"{feed:.1f}mm/sec" if feed >= SLOW else f"{max(6.0 * feed, SLOWEST):.1f}cm/min"


def _external(program: Program, row: int) -> list[str]:
    values = program.joints[row, program.outer].tolist()
    return [f"E{index}= {value:12.6f}  mm" for index, value in enumerate(values, start=1)]


def _joint_entries(program: Program, row: int, frame: int) -> list[str]:
    values = program.joints[row, ~program.outer].tolist()
    entries = [f"J{index}= {value:12.6f} deg" for index, value in enumerate(values, start=1)]
    tool = check_cell(program.post, CELL, "FANUC").tool
    return [f"\tUF : {frame}, UT : {tool}", *entries, *([] if program.moves_part else _external(program, row))]


def _second_group(program: Program, row: int) -> str:
    """Return the motion group that carries the part, in a position."""
    if not program.moves_part:
        return ""
    group = check_cell(program.post, CELL, "FANUC").positioner
    values = program.joints[row, program.outer].tolist()
    entries = ",\t".join(f"J{index}= {value:12.6f} deg" for index, value in enumerate(values, start=1))
    return f"\n   GP{group}:\n\tUF : 0, UT : 1,\n\t{entries}"


def _places(program: Program, poses: Array) -> list[list[str]]:
    names = ("X = {:12.5f}  mm", "Y = {:12.5f}  mm", "Z = {:12.5f}  mm", "W = {:12.6f} deg", "P = {:12.6f} deg",
             "R = {:12.6f} deg")  # fmt: skip
    known = np.isfinite(poses[:, 0, 0])
    table = np.full((len(poses), 6), np.nan)
    table[known] = place_table(poses[known], "xyz")
    return [
        [*(name.format(value) for name, value in zip(names, values, strict=True)), *_external(program, row)]
        for row, values in enumerate(table.tolist())
    ]


def _position(entries: list[str], number: int, second: str = "") -> str:
    head, *values = entries
    groups = [",\t".join(values[start : start + 3]) for start in range(0, len(values), 3)]
    return f"P[{number}]{{\n   GP1:\n{head},\n\t" + ",\n\t".join(groups) + f"{second}\n}};"


def format_program(
    name: str, program: Program, frame: int, moves: Sequence[str], positions: Sequence[str], main: bool,
    parts: Sequence[str] = (),
) -> str:  # fmt: skip
    """Return the file of a program: its head, its instructions with their numbers, its positions.

    `frame` is the user frame that positions count from, 0 for joint positions; a main program has frames, header and
    footer, and calls its parts.
    """
    cell = check_cell(program.post, CELL, "FANUC")
    second = cell.positioner if program.moves_part else 0
    base = program.base_frame if frame and not program.moves_part else None
    wanted = [("UTOOL", cell.tool, program.tool), ("UFRAME", cell.base, base)]
    words = {
        "name": name, "comments": [clean_text(line, LONGEST_REMARK) for line in head_lines(program)], "cell": cell,
        "main": main, "frame": frame, "register": REGISTER, "moves": moves, "parts": parts, "positions": positions,
        "groups": ["1", *("1" if number == second else "*" for number in range(2, 6))],
        "frames": [(key, number, place_numbers(pose, "xyz")) for key, number, pose in wanted if pose is not None],
    }  # fmt: skip
    before, rest = render_post(program, "fanuc_ls", words).split("/MN\n", 1)
    body, after = rest.split("/POS\n", 1)
    lines, numbered = 0, []
    for line in body.split("\n")[:-1]:
        lines += not line.startswith("    :")
        numbered.append(line if line.startswith("    :") else f"{lines:4d}:{line}")
    before = re.sub(r"(?m)^LINE_COUNT\t= \d+;$", f"LINE_COUNT\t= {lines};", before)
    return "\n".join([f"{before}/MN", *numbered, f"/POS\n{after}"])


def _format_main(name: str, program: Program, calls: Sequence[str]) -> str:
    plain = replace(program, post=replace(program.post, overwrite=False), tool=None, header=(), footer=())
    return format_program(name, plain, 0, [], [], True, calls)


MAIN = MainForm(".LS", 26, _format_main)
