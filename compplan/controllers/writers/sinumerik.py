"""Siemens SINUMERIK part programs for robots (Run MyRobot /Direct Control): orientation transformation, STAT and TU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.krl import turn_bits
from compplan.controllers.writers.language import (
    ProgramForm,
    ProgramPart,
    WrittenMove,
    change,
    need_six_axes,
)
from compplan.controllers.writers.program import Program
from compplan.errors import InputError
from compplan.io.tables import Array

name = "sinumerik"


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.MPF, or NAME_1.SPF and so on with a NAME.MPF that calls them.

    Positions refer to the part frame, set by TRANS and AROT on top of G500. X Y Z are the tool tip; A2 B2 C2 (ORIRPY)
    rotate the flange about fixed x, y and z. They include the orientation of the tool; its offset is correction D1
    (lengths in Z, Y and X for G17). Cutting moves are G1 and CIP in CP mode with their feed (G94, mm/min). Rapid moves
    and configuration changes are G0 in PTP mode with STAT (status as in KRL) and TU (bit set for an axis below 0). A
    sliding joint is the axis E1. Check names of axes and the transformation on the machine.
    """
    need_six_axes(program, "SINUMERIK", sliding=1)
    if program.status is None:
        raise InputError("SINUMERIK programs need configuration words with status in controller.toml")

    def state_poses(poses: Array) -> Array:
        turned = poses.copy()
        turned[:, :3, :3] = turned[:, :3, :3] @ program.tool[:3, :3].T
        return place_table(turned, "xyz")

    form = replace(FORM, numbers=state_poses, format_part=partial(_format_part, {"zone": "G642"}))
    return form.write(replace(program, form="linear"), folder, most, can=True)


def _format_part(modal: dict[str, str], part: ProgramPart) -> dict[str, str]:
    """Format a part; `modal`: modal travel and zone commands of the part before."""
    lines = []
    for move in part.moves:
        zone = "G642" if move.zone == np.inf else f"G641 ADIS={1e3 * move.zone:.3f}"
        lines.append([
            *(["; the configuration changes: PTP travel"] if move.swings else []),
            *change(modal, "travel", "PTP" if move.kind == "joint" else "CP"),
            *change(modal, "zone", "" if move.stops else zone),
            _format_move(part, move),
        ])  # fmt: skip
    blocks = part.merge_events(lines)
    if len(part.parts) == 1:
        return {f"{part.name}.MPF": _format_program(part, blocks)}
    return {f"{part.name}.SPF": "\n".join([*blocks, "M17", ""])}


def _format_calls(part: ProgramPart) -> dict[str, str]:
    return {f"{part.name}.MPF": _format_program(part, [*part.parts])}


def _format_program(part: ProgramPart, blocks: Sequence[str]) -> str:
    program = part.program
    return part.render(
        "sinumerik", mass="not known" if program.mass is None else f"{program.mass:.3f} kg",
        rail=bool(program.prismatic.any()), tool=(np.round(program.tool[:3, 3] * 1e3, 5) + 0.0).tolist(),
        blocks=blocks, base=place_numbers(program.base_frame, "ZYX"),
    )  # fmt: skip


def _format_move(part: ProgramPart, move: WrittenMove) -> str:
    program, exact, number = part.program, " G9" if move.stops else "", f"N{10 * (move.row + 1)} "
    names, digits = ("X", "Y", "Z", "A2=", "B2=", "C2=", "E1="), (5, 5, 5, 6, 6, 6, 5)
    words = [
        f"{name}{value + 0.0:.{digit}f}"
        for name, value, digit in zip(names, [*move.place, *move.outer], digits, strict=False)
    ]
    if move.kind == "joint":
        status = 0 if program.status is None else int(program.status[move.row])
        return f"{number}G0 {' '.join(words)} STAT={status} TU={turn_bits(move.arm)}{exact}"
    code, through = "G1", ""
    if move.kind == "arc":
        code, through = "CIP", " I1=AC({:.5f}) J1=AC({:.5f}) K1=AC({:.5f})".format(*move.via[:3])
    cam = program.write_comment_line(move.row, ";")
    return f"{number}{code} {' '.join(words)}{through} F{move.feed * 60.0:.3f}{exact}{cam}"


FORM = ProgramForm.load("sinumerik", lambda poses: place_table(poses, "xyz"), partial(_format_part, {}), _format_calls)
