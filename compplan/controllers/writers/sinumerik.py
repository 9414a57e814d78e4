"""Siemens SINUMERIK part programs for robots (Run MyRobot /Direct Control): orientation transformation, STAT and TU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compplan.controllers.shapes import find_coefficients
from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.krl import turn_bits
from compplan.controllers.writers.language import MainForm, need_six_axes
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_main, render_post
from compplan.controllers.writers.program import Program, count_digits, head_lines, name_parts
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text
from compplan.toolpath.events import Event

name = "sinumerik"
#: The control drives arms of many brands.
BRAND = ""
#: Waypoints in a part program where the job says nothing.
MOST = 20000
#: A program's name has 24 letters; "_" and the number of a part take the rest.
LONGEST_NAME = 23
#: T1 where a job names no tool; base: a settable frame such as G54.
CELL = CellWords(int, str, {"tool": 1})
RESERVED = frozenset({"if", "else", "for", "while", "loop", "repeat", "until", "case", "goto", "proc", "def", "stopre"})


def _describe_natively(event: Event) -> list[str] | None:
    speed = f" S{event.value:g}" if event.value > 0.0 else ""
    return {
        "spindle_cw": [f"M3{speed}"], "spindle_ccw": [f"M4{speed}"], "spindle_off": ["M5"], "coolant": ["M8"],
        "mist": ["M7"], "coolant_off": ["M9"], "dwell": [f"G4 F{event.value:.3f}"], "stop": ["M0"],
        "optional_stop": ["M1"],
    }.get(event.kind)  # fmt: skip


#: The control has words of its own; a tool change, which would change the tool data in force, stops the program.
PHRASES = Phrases(
    say=lambda text: [f"; {text}"],
    switch=lambda signal, on: [f"$A_OUT[{signal}]={int(on)}"],
    wait=lambda seconds: [f"G4 F{seconds:.3f}"],
    expect=lambda signal: [f"WHILE $A_IN[{signal}]==0", "ENDWHILE"],
    pause=lambda task: ["M0"],
    pause_if=lambda signal, task: ["M1"],
    call=lambda name, number: [f"{name}({number:.0f})"],
    native=_describe_natively,
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.MPF, or NAME_1.SPF and so on with a NAME.MPF that calls them.

    Positions count from the part frame, set by TRANS and AROT on top of G500; X Y Z are the tool tip, A2 B2 C2 (ORIRPY)
    turn the flange about x, the fixed y and the fixed z. The tool's offset is correction D1 of a tool of the cell
    (lengths in Z, Y and X for G17), which the program fills where the job asks for that; its turn is part of the
    programmed orientation. Cutting moves are G1 in CP travel with their feed (G94, mm/min), arcs are CIP, cubics POLY
    over the interval from 0 to 1 (A2 B2 C2, which have no PO of their own, turn evenly over it: assumed), rapid moves
    and swings G0 in PTP travel with STAT (status as in KRL) and TU (a bit an axis below 0). A sliding joint is the axis
    E1. Names of axes and the transformation are the machine's: check them.
    """
    need_six_axes(program, "SINUMERIK", sliding=1)
    if program.tcp is None or program.status is None:
        raise InputError("SINUMERIK programs need poses and configuration words with status in controller.toml")
    program = fit_moves(program, curves=program.splines).program
    longest = LONGEST_NAME - 2 - count_digits(program, most or MOST)
    name = legal_name(name_main(program), longest, reserved=RESERVED).upper()
    name = name if name[1:2].isalpha() or name[1:2] == "_" else f"P_{name}"
    parts = name_parts(name, len(program), most or MOST)
    blocks = _blocks(program)
    for row, lines in phrase_events(program.events, program.wiring, PHRASES, "SINUMERIK").items():
        text = "\n".join(lines)
        blocks[max(row, 0)] = f"{text}\n{blocks[0]}" if row < 0 else f"{blocks[row]}\n{text}"
    files = []
    bodies = blocks
    if len(parts) > 1:
        bodies = [*parts]
        for part, rows in parts.items():
            files.append(folder / f"{part}.SPF")
            write_text(files[-1], "\n".join([*blocks[rows], "M17", ""]))
    files.append(folder / f"{name}.MPF")
    tool = np.eye(4) if program.tool is None else program.tool
    words = {
        "name": name, "comments": head_lines(program), "cell": check_cell(program.post, CELL, "SINUMERIK"),
        "mass": "not known" if program.mass is None else f"{program.mass:.3f} kg",
        "rail": bool(program.prismatic.any()),
        "tool": (np.round(tool[:3, 3] * 1e3, 5) + 0.0).tolist(), "base": place_numbers(program.base_frame, "ZYX"),
        "blocks": bodies,
    }  # fmt: skip
    write_text(files[-1], render_post(program, "sinumerik", words))
    return files


def _blocks(program: Program) -> list[str]:
    tool = np.eye(4) if program.tool is None else program.tool
    turned = program.positions.copy()
    turned[:, :3, :3] = turned[:, :3, :3] @ tool[:3, :3].T
    table, external = place_table(turned, "xyz"), program.joints[:, program.prismatic]
    turns = turn_bits(program.joints[:, ~program.prismatic])
    alone, stops = program.alone(linear=True).tolist(), program.stops(linear=True).tolist()
    arcs, via = program.arcs.tolist(), 1e3 * program.via_positions[:, :3, 3] + 0.0
    curves, bend = program.curves.tolist(), np.zeros((len(program), 2, 3)) if program.bend is None else program.bend
    travelled = np.diff(table[:, :3], axis=0, prepend=table[:1, :3])
    second, third = find_coefficients(travelled, 1e3 * bend.transpose(1, 0, 2))
    blocks, travel, zone = [], "", "G642"
    zones = find_zones(program, ZONES["sinumerik"])[1].tolist()
    for row, values in enumerate(table.tolist()):
        place = _words(np.array([*values, *external[row]]))
        exact, number = " G9" if stops[row] else "", f"N{10 * (row + 1)} "
        kind, cam = "PTP" if alone[row] else "CP", program.write_comment_line(row, ";")
        change, travel = ("" if kind == travel else f"{kind}\n"), kind
        space = zone if stops[row] else "G642" if zones[row] == np.inf else f"G641 ADIS={1e3 * zones[row]:.3f}"
        change, zone = change if space == zone else f"{change}{space}\n", space
        note = "; the configuration changes: PTP travel\n" if program.swings[row] else ""
        if alone[row]:
            status = 0 if program.status is None else int(program.status[row])
            blocks.append(f"{note}{change}{number}G0 {place} STAT={status} TU={turns[row]}{exact}")
        else:
            code, through = "G1", ""
            if arcs[row]:
                x, y, z = via[row].tolist()
                code, through = "CIP", f" I1=AC({x:.5f}) J1=AC({y:.5f}) K1=AC({z:.5f})"
            if curves[row]:
                terms = zip("XYZ", values, second[row].tolist(), third[row].tolist(), strict=False)
                poly = " ".join(f"PO[{name}]=({end:.5f},{two:.6f},{three:.6f})" for name, end, two, three in terms)
                code, place, through = "POLY", f"{poly} {place.split(' ', 3)[3]}", " PL=1"
            blocks.append(f"{change}{number}{code} {place}{through} F{program.feed[row] * 60.0:.3f}{exact}{cam}")
    return blocks


def _words(values: Array) -> str:
    digits = (5, 5, 5, 6, 6, 6, 5)
    names = ("X", "Y", "Z", "A2=", "B2=", "C2=", "E1=")[: len(values)]
    return " ".join(f"{name}{value:.{digit}f}" for name, value, digit in zip(names, values + 0.0, digits, strict=False))


def _format_main(name: str, program: Program, calls: Sequence[str]) -> str:
    return "\n".join([*(f"; {line}" for line in head_lines(program)), *calls, "M30", ""])


MAIN = MainForm(".MPF", 23, _format_main, newline="\n")
