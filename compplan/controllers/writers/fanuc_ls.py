"""FANUC teach pendant programs as ASCII (.ls), positions in joint representation or Cartesian in a user frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import ProgramForm, ProgramPart, WrittenMove, describe_feeds
from compplan.controllers.writers.program import Program, head_lines
from compplan.controllers.writers.text import clean_text
from compplan.errors import InputError
from compplan.io.tables import Array

name = "fanuc_ls"
#: Letters of a remark.
LONGEST_REMARK = 32
#: Greatest linear speed in mm/sec, speed below which cm/min is written, and least speed in cm/min.
FASTEST, SLOW, SLOWEST = 2000.0, 1.0, 1.0
#: Position register through which programs set tool and user frame if `overwrite` is set.
REGISTER = 99
#: Motion group of the part positioner (assumed).
POSITIONER = 2
#: Formats of the numbers of a Cartesian position.
PLACE = [f"{name} = {{:12.5f}}  mm" for name in "XYZ"] + [f"{name} = {{:12.6f}} deg" for name in "WPR"]


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.LS with joint positions and NAME_L.LS with Cartesian ones; long ones call NAME_1.LS and so on.

    Cutting moves are L and C with their feed; rapid moves and configuration changes are J. Cartesian positions refer to
    a user frame and a tool frame of the cell. They are written where the configuration words (native N F, U D, T B) are
    known. Sliding joints are extended axes (E1 ..), in mm. Joints that carry the part form a second motion group (GP2);
    then all positions are joint positions, and lines are straight relative to the part (COORD).
    """
    turning, sliding = np.flatnonzero(~program.outer), np.flatnonzero(program.outer)
    if len(turning) > 6 or len(sliding) > 3 or (program.moves_part and program.prismatic.any()):
        raise InputError(f"FANUC programs take six rotating and three sliding joints, not {list(program.joint_names)}")
    if program.feed.max(initial=0.0) > FASTEST:
        raise InputError(f"feed is {program.feed.max():g} mm/s, FANUC programs take at most {FASTEST:g} mm/s")
    can = len(turning) == 6 and (program.moves_part or state_configurations(program) is not None)
    return FORM.write(program, folder, most, can=can)


def describe(program: Program) -> list[str]:
    """Return notes on rounded feeds, and on a missing program with Cartesian positions."""
    notes = describe_feeds(program, "0.1 mm/s, below 1 mm/s of 0.1 cm/min", _round_feeds)
    if state_configurations(program) is None and not program.moves_part:
        notes.append("no program with positions: controller.toml has no native words N F, U D, T B")
    return notes


def state_configurations(program: Program) -> list[str] | None:
    """Return CONFIG of each position, such as "N U T, 0, 0, 0", or None where the configuration words are not known.

    The numbers count the turns of J1, J4 and J6 (assumed): 0 from -180 up to 180 deg.
    """
    wanted = {"wrist": {"N", "F"}, "elbow": {"U", "D"}, "shoulder": {"T", "B"}}
    if any(not {*program.native.get(key, np.array(["?"])).tolist()} <= letters for key, letters in wanted.items()):
        return None
    turns = np.floor((program.joints[:, ~program.outer][:, [0, 3, 5]] + 180.0) / 360.0).astype(int).tolist()
    letters = zip(*(program.native[key].tolist() for key in wanted), strict=True)
    return [f"{' '.join(word)}, {', '.join(map(str, turn))}" for word, turn in zip(letters, turns, strict=True)]


def _round_feeds(feed: Array) -> Array:
    slow = np.maximum(np.round(6.0 * feed, 1), SLOWEST) / 6.0
    return np.where(feed >= SLOW, np.round(feed, 1), slow)


def _format_part(part: ProgramPart) -> dict[str, str]:
    program, frame = part.program, _find_frame(part)
    configuration = (state_configurations(program) or []) if part.linear and not program.moves_part else []
    arcs = {move.row: number for number, move in enumerate((m for m in part.moves if m.via), len(part.moves) + 1)}
    lines, positions, vias = [], [], []
    for number, move in enumerate(part.moves, start=1):
        words = configuration[move.row] if configuration else ""
        note = ["  !the configuration changes ;"] if move.swings else []
        lines.append([*note, _format_move(program, move, number, arcs.get(move.row), part.linear)])
        positions.append(_format_position(program, move, number, frame, words))
        if move.via:
            vias.append(_format_position(program, move._replace(place=move.via), arcs[move.row], frame, words))
    events = {row: [f"  {line} ;" for line in own] for row, own in part.events.items()}
    body = replace(part, events=events).merge_events(lines)
    return _format_file(part, body, [*positions, *vias], main=len(part.parts) == 1)


def _format_calls(part: ProgramPart) -> dict[str, str]:
    return _format_file(part, parts=[*part.parts])


def _find_frame(part: ProgramPart) -> int:
    """Return the number of the user frame of the positions, 0 for joint positions."""
    return int(part.program.post.base or 1) if part.linear else 0


def _format_move(program: Program, move: WrittenMove, number: int, via: int | None, linear: bool) -> str:
    if move.kind == "joint" and (linear or program.rapid[move.row]):
        return f"J P[{number}] {int(max(round(move.percent), 1))}% FINE ;"
    # share of CNT100 at a corner: ratio of the zone sizes (assumed)
    share = 100.0 * min(move.zone, 1e9) / max(move.default_zone, 1e-9) if linear else 100.0
    ending = "FINE" if move.stops else f"CNT{int(min(max(share, 1.0), 100.0))}"
    feed = f"{move.feed:.1f}mm/sec" if move.feed >= SLOW else f"{max(6.0 * move.feed, SLOWEST):.1f}cm/min"
    end = f"P[{number}] {feed} {ending}{' COORD' if program.moves_part else ''} ;"
    return f"L {end}" if via is None else f"C P[{via}]\n    :  {end}"


def _format_position(program: Program, move: WrittenMove, number: int, frame: int, words: str) -> str:
    """Return a position: joint angles for joint moves, otherwise a pose in a user frame; then the external axes."""
    head, second = f"UF : {frame}, UT : {program.post.tool}", ""
    if words and move.kind != "joint":
        head += f",\t\tCONFIG : '{words}'"
        values = [text.format(value) for text, value in zip(PLACE, move.place, strict=True)]
    else:
        values = [f"J{axis}= {value:12.6f} deg" for axis, value in enumerate(move.arm, start=1)]
    if program.moves_part:
        others = ",\t".join(f"J{axis}= {value:12.6f} deg" for axis, value in enumerate(move.outer, start=1))
        second = f"\n   GP{POSITIONER}:\n\tUF : 0, UT : 1,\n\t{others}"
    else:
        values += [f"E{axis}= {value:12.6f}  mm" for axis, value in enumerate(move.outer, start=1)]
    groups = ",\n\t".join(",\t".join(values[start : start + 3]) for start in range(0, len(values), 3))
    return f"P[{number}]{{\n   GP1:\n\t{head},\n\t{groups}{second}\n}};"


def _format_file(
    part: ProgramPart, moves: Sequence[str] = (), positions: Sequence[str] = (), *, main: bool = True,
    parts: Sequence[str] = (),
) -> dict[str, str]:  # fmt: skip
    """Return the file of a program: its head, its numbered instructions, its positions.

    Frames are set only in a `main` program; `parts` are the programs that it calls.
    """
    program, cell, frame = part.program, part.program.post, _find_frame(part)
    second = POSITIONER if program.moves_part else 0
    base = program.base_frame if frame and not program.moves_part else None
    wanted = [("UTOOL", cell.tool, program.tool), ("UFRAME", cell.base, base)]
    text = part.render(
        "fanuc_ls", comments=[clean_text(line, LONGEST_REMARK) for line in head_lines(program)], main=main,
        frame=frame, register=REGISTER, moves=moves, parts=parts, positions=positions,
        groups=["1", *("1" if number == second else "*" for number in range(2, 6))],
        frames=[(key, number, place_numbers(pose, "xyz")) for key, number, pose in wanted if pose is not None],
    )  # fmt: skip
    before, rest = text.split("/MN\n", 1)
    body, after = rest.split("/POS\n", 1)
    lines, numbered = 0, list[str]()
    for line in body.split("\n")[:-1]:
        lines += not line.startswith("    :")
        numbered.append(line if line.startswith("    :") else f"{lines:4d}:{line}")
    before = re.sub(r"(?m)^LINE_COUNT\t= \d+;$", f"LINE_COUNT\t= {lines};", before)
    return {f"{part.name}.LS": "\n".join([f"{before}/MN", *numbered, f"/POS\n{after}"])}


def format_main(part: ProgramPart) -> dict[str, str]:
    """Return the program that calls the programs of several tools."""
    return _format_file(part, main=False, parts=[*part.parts])


FORM = ProgramForm.load("fanuc_ls", lambda poses: place_table(poses, "xyz"), _format_part, _format_calls)
