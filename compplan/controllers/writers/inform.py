"""Yaskawa INFORM jobs (.JBI): positions as joint angles, or Cartesian in a user frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import ProgramForm, ProgramPart, WrittenMove, describe_feeds, need_six_axes
from compplan.controllers.writers.program import Program, head_lines
from compplan.controllers.writers.text import clean_text, list_numbers

name = "inform"
#: Letters of a remark.
LONGEST_REMARK = 32
#: Position variables through which jobs set tool and user frame if `overwrite` is set.
TOOL_VARIABLE, FRAME_VARIABLE = 98, 99
#: Position level within a cut: 1 passes nearest to the point without a stop.
BLEND = 1


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.JBI with joint angles and, where poses and configuration words are known, NAME_L.JBI with positions.

    Cutting moves of the linear job are MOVL with their feed, rapid moves and configuration changes MOVJ; the joint job
    has MOVJ with percentages of the joint rates. Positions refer to a user frame and a tool of the cell. Joint angles
    need a controller with POSTYPE ANGLE. Joints that carry the part are a station (ST1, angles EC); then positions are
    joint angles, and lines are straight relative to the part (SMOVL .. +MOVJ EC).
    """
    if not program.moves_part or program.prismatic.any() or len(program.joint_names) - program.outer.sum() != 6:
        need_six_axes(program, "INFORM", sliding=0)
    can = program.moves_part or {"shoulder", "elbow", "wrist"} <= set(program.words)
    return FORM.write(program, folder, most, can=can)


def describe(program: Program) -> list[str]:
    """Return notes on joint angles and rounded feeds, and on a missing job with positions."""
    feeds = describe_feeds(program, "0.1 mm/s", lambda feed: np.maximum(np.round(feed, 1), 0.1))
    notes = ["joint angles need a controller that takes POSTYPE ANGLE", *feeds]
    if not program.moves_part and not {"shoulder", "elbow", "wrist"} <= set(program.words):
        notes.append("no job with positions: controller.toml has no configuration words")
    return notes


def _format_part(part: ProgramPart) -> dict[str, str]:
    moves = part.merge_events([_format_move(part, move) for move in part.moves])
    return _format_job(part, _list_points(part), moves, main=len(part.parts) == 1)


def _format_calls(part: ProgramPart) -> dict[str, str]:
    return _format_job(part, parts=[*part.parts])


def _format_move(part: ProgramPart, move: WrittenMove) -> list[str]:
    place, level = f"C{move.row - part.rows.start:05d}", f"PL={0 if move.stops else BLEND}"
    station = f" +MOVJ E{place}" if part.program.moves_part else ""
    if move.kind != "joint":
        return [f"{'SMOVL' if station else 'MOVL'} {place} V={max(move.feed, 0.1):.1f} {level}{station}"]
    turned = f"{station} VJ={move.percent:.2f}" if station else ""
    note = ["'the configuration changes"] if move.swings else []
    return [*note, f"MOVJ {place} VJ={move.percent:.2f} {level}{turned}"]


def _list_points(part: ProgramPart) -> list[str]:
    """Return the numbered C positions of a job in order: joint angles, or Cartesian positions in a user frame."""
    program, lines, last = part.program, list[str](), "none yet"
    for number, move in enumerate(part.moves):
        by_angle = program.moves_part or move.kind == "joint"
        words = "" if by_angle else ",".join(map(str, [*find_configuration(program, move), *[0] * 18]))
        if words != last and by_angle:
            lines += ["///POSTYPE ANGLE", "///ANGLE"]
        elif words != last:
            lines += [*(["///POSTYPE USER", "///RECTAN"] if last in ("", "none yet") else []), f"///RCONF {words}"]
        last = words
        place = f"{list_numbers(move.place[:3], 3)},{list_numbers(move.place[3:], 4)}"
        lines.append(f"C{number:05d}={list_numbers(move.arm, 6) if by_angle else place}")
    if program.moves_part:
        lines += [f"EC{number:05d}={list_numbers(move.outer, 6)}" for number, move in enumerate(part.moves)]
    return lines


def find_configuration(program: Program, move: WrittenMove) -> list[int]:
    """Return the first six numbers of RCONF: no flip, lower arm, rear, turns of axes R, T and S."""
    first = {"wrist": "noflip", "elbow": "down", "shoulder": "back"}
    words = [int(program.words[key][move.row] == value) for key, value in first.items()]
    return [*words, *(int(move.arm[axis] >= 180.0) for axis in (3, 5, 0))]


def _format_job(
    part: ProgramPart, points: Sequence[str] = (), moves: Sequence[str] = (), *, main: bool = True,
    parts: Sequence[str] = (),
) -> dict[str, str]:  # fmt: skip
    """Return the file of a job: head, positions, instructions; `main` adds frames, header and footer."""
    program = part.program
    tool, base = (list_numbers(place_numbers(pose, "xyz"), 7) for pose in (program.tool, program.base_frame))
    text = part.render(
        "inform", count=sum(line.startswith("C") for line in points), points=points, main=main, moves=moves,
        parts=parts, station=program.moves_part, user="///POSTYPE USER" in points, tool=tool, base=base,
        tool_variable=TOOL_VARIABLE, frame_variable=FRAME_VARIABLE,
        comments=[clean_text(line, LONGEST_REMARK) for line in head_lines(program)],
        mass="" if program.mass is None else f"{program.mass:.2f}",
    )  # fmt: skip
    return {f"{part.name}.JBI": text}


def format_main(part: ProgramPart) -> dict[str, str]:
    """Return the job that calls the jobs of several tools."""
    return _format_job(part, main=False, parts=[*part.parts])


FORM = ProgramForm.load("inform", lambda poses: place_table(poses, "xyz"), _format_part, _format_calls)
