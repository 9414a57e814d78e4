"""Staubli VAL3: project folders with joint motions, and with linear motions in the part frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import ProgramForm, ProgramPart, change, need_six_axes
from compplan.controllers.writers.machine import name_signal
from compplan.controllers.writers.post import render_own
from compplan.controllers.writers.program import Program, head_lines
from compplan.controllers.writers.zones import ZONES

name = "val3"
#: Formats of frames, points with their configuration, and joints in the data of a project.
FRAME = 'x="{:.7f}" y="{:.7f}" z="{:.7f}" rx="{:.7f}" ry="{:.7f}" rz="{:.7f}" fatherId="{}"'
POINT = 'x="{:.5f}" y="{:.5f}" z="{:.5f}" rx="{:.6f}" ry="{:.6f}" rz="{:.6f}" {} fatherId="fPart[0]"'
JOINTS = 'j1="{:.6f}" j2="{:.6f}" j3="{:.6f}" j4="{:.6f}" j5="{:.6f}" j6="{:.6f}"'
#: Words of a point's configuration, and the word that keeps the current one.
WORDS = {
    "shoulder": ({"righty", "lefty"}, "ssame"),
    "elbow": ({"epositive", "enegative"}, "esame"),
    "wrist": ({"wpositive", "wnegative"}, "wsame"),
}


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write the project NAME with joint motions and, where poses are known, NAME_L with linear ones.

    A project holds NAME.pjx, its data (.dtx) and programs (.pgx): start, stop, and one for each part. movej goes
    through joint positions, movel through points in the part frame, with the feed as speed limit. Rapid moves and
    configuration changes are joint motions at 20 % of the joint rates and stop at their end.
    """
    need_six_axes(program, "VAL3", sliding=0)
    return FORM.write(program, folder, most, can=True)


def _format_part(part: ProgramPart) -> dict[str, str]:
    number = [*part.parts].index(part.name) + 1
    events = {  # other than comments, events wait for the end of motion
        row: ["waitEndMove()"] * any(not line.startswith("//") for line in lines) + lines
        for row, lines in part.events.items()
    }
    code = "".join(f"{line}\n" for line in replace(part, events=events).merge_events(_format_moves(part, number), "  "))
    return {f"{part.whole}/part{number}.pgx": _format_program(f"part{number}", code)}


def _format_project(part: ProgramPart) -> dict[str, str]:
    """Return the files of a project in addition to its parts: program list, data, start and stop programs."""
    words = {"name": part.whole, "parts": [f"part{number}" for number in range(1, len(part.parts) + 1)]}
    start = part.render("val3", **words, comments=_remarks(part.program, part.linear))
    texts = {
        f"{part.whole}.pjx": render_own("val3_project", words),
        f"{part.whole}.dtx": render_own("val3_data", {"arrays": _list_data(part)}),
        "start.pgx": _format_program("start", start), "stop.pgx": _format_program("stop", "  resetMotion()\n"),
    }  # fmt: skip
    return {f"{part.whole}/{name}": text for name, text in texts.items()}


def _format_program(name: str, code: str) -> str:
    return render_own("val3_program", {"name": name, "code": code, "locals": ["l_nKey"] if "l_nKey" in code else []})


def _remarks(program: Program, linear: bool) -> list[str]:
    swings = np.flatnonzero(program.swings)[:10].tolist() if linear else []
    load = [] if program.mass is None else [f"mass of the tool {program.mass:.3f} kg: set it in the arm's load data"]
    notes = [f"waypoint {row}: the configuration changes, a joint move leads there" for row in swings]
    return [*head_lines(program), *load, *notes]


def _format_moves(part: ProgramPart, number: int) -> list[list[str]]:
    """Return the motion lines of a part: joint moves, lines and arcs, with speed and zone where they change."""
    usual = f"{1e3 * ZONES['val3'].size:g}"
    modal, lines, quick, through = {"leave": f"mPath.leave={usual}", "reach": f"mPath.reach={usual}"}, [], 0, 0
    for index, move in enumerate(part.moves):
        how, feed = "mEnd" if move.stops else "mPath", f"{move.feed:.4f}"
        if move.kind == "joint":
            target = f"movej(jPath{number}[{quick}],tTool"
            rapid = part.linear or part.program.rapid[move.row]
            alone = [f"{target},mRapid)", "waitEndMove()"]
            lines.append(alone if rapid else [*change(modal, how, f"{how}.tvel={feed}"), f"{target},{how})"])
            quick += 1
            continue
        space = usual if move.stops or move.zone == np.inf else f"{1e3 * move.zone:.3f}"
        via = f"pVia{number}[{through}]," if move.via else ""
        through += bool(via)
        lines.append([
            *change(modal, how, f"{how}.tvel={feed}"),
            *(line for word in ("leave", "reach") for line in change(modal, word, f"mPath.{word}={space}")),
            f"move{'c' if via else 'l'}({via}pPath{number}[{index}],tTool,{how})",
        ])  # fmt: skip
    return lines


def _list_signals(program: Program) -> list[tuple[str, str, list[str]]]:
    """Return the digital inputs and outputs of the programs, as data of the project."""
    wiring, phrases = program.wiring, FORM.phrases
    outputs = [(signal, phrases.outputs) for signal in (wiring.spindle, wiring.coolant, *wiring.signals.values())]
    named = [*outputs, (wiring.spindle_ready, phrases.inputs)] if program.events else []
    names = dict.fromkeys(name_signal(signal, prefix) for signal, prefix in named if signal is not None)
    return [(name, "dio", ['link=""']) for name in names]


def _list_data(part: ProgramPart) -> list[tuple[str, str, list[str]]]:
    """Return name, type and values of the data of a project: points, feeds, tool, part frame, motion descriptors."""
    program, limits = part.program, 'tmax="99999" rmax="99999"'
    tool, base = (place_numbers(pose, "XYZ") for pose in (program.tool, program.base_frame))
    full = f'accel="100" vel="100" decel="100" {limits}'
    arrays = [
        ("tTool", "tool", [FRAME.format(*tool, "flange[0]")]), ("fPart", "frame", [FRAME.format(*base, "world[0]")]),
        ("mPath", "mdesc", [f'{full} blend="joint" leave="0.1" reach="0.1"']),
        ("mEnd", "mdesc", [f'{full} blend="off" leave="0" reach="0"']),
        ("mRapid", "mdesc", [f'accel="50" vel="20" decel="50" {limits} blend="off" leave="0" reach="0"']),
    ]  # fmt: skip
    words = _name_configurations(program)
    for number, rows in enumerate(part.parts.values(), start=1):
        moves = part.every[rows]
        joints = [JOINTS.format(*program.joints[move.row]) for move in moves if move.kind == "joint"]
        arrays += [(f"jPath{number}", "jointRx", joints)] if joints else []
        if part.linear:
            points = [POINT.format(*move.place, words[move.row]) for move in moves]
            vias = [POINT.format(*move.via, words[move.row]) for move in moves if move.via]
            arrays.append((f"pPath{number}", "pointRx", points))
            arrays += [(f"pVia{number}", "pointRx", vias)] if vias else []
    return [*arrays, *_list_signals(program)]


def _name_configurations(program: Program) -> list[str]:
    """Return the configuration at each row, in the controller's words if known, otherwise as "same"."""
    columns = []
    for key, (known, same) in WORDS.items():
        native = program.native[key].tolist() if key in program.native else []
        words = native if native and {*native} <= known else [same] * len(program)
        columns.append([f'{key}="{word}"' for word in words])
    return [" ".join(words) for words in zip(*columns, strict=True)]


FORM = ProgramForm.load("val3", lambda poses: place_table(poses, "XYZ"), _format_part, _format_project)
