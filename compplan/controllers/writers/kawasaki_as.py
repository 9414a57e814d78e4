"""Kawasaki AS: a file with a program, its joint positions (.JOINTS) and its transformations (.TRANS)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import MainForm, need_six_axes
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import Program, count_digits, head_lines, joint_percent, name_parts
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.io.tables import Array, write_text

name = "kawasaki_as"
BRAND = "Kawasaki"
#: Points in a program where the job says nothing.
MOST = 2000
#: AS takes 15 letters of a program's name; "_l_" and the number of a part take the rest.
LONGEST_NAME = 12
#: Letters of the program's name in a variable; variables have 15 too, and all programs of a controller share them.
LONGEST_VARIABLE = 9
CELL = CellWords(str, str)
RESERVED = frozenset({"if", "then", "else", "end", "for", "to", "while", "do", "case", "of", "goto", "call", "return",
                      "tool", "base", "speed", "here", "point", "not", "and", "or", "mod", "on", "off"})  # fmt: skip
#: How near a point within a cut has to be passed [mm], and percents of the joint rates.
ACCURACY, RAPID_PERCENT, SLOWEST_PERCENT = 0.1, 20.0, 0.01


#: Inputs are counted from here.
INPUTS = 1000
PHRASES = Phrases(
    say=lambda text: [f"; {text}"],
    switch=lambda signal, on: [f"SIGNAL {signal if on else f'-{signal}'}"],
    wait=lambda seconds: [f"TWAIT {seconds:.3f}"],
    expect=lambda signal: [f"SWAIT {INPUTS + int(signal)}"],
    pause=lambda task: [f'TYPE "{task}"', "PAUSE"],
    pause_if=lambda signal, task: [f"IF SIG({INPUTS + int(signal)}) THEN", f'  TYPE "{task}"', "  PAUSE", "END"],
    call=lambda name, number: [f"CALL {name.lower()}({number:.0f})"],
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.as with joint moves (JMOVE), and NAME_L.as with lines and arcs (LMOVE, C1MOVE, C2MOVE).

    Long ones hold further programs NAME_1 and so on, a file each, which the first calls. Transformations count from the
    part frame (part+p1), angles are O A T: about z, the new y, the newest z. The language has no configuration in a
    transformation: linear moves keep the branch of the joint move before them. A sliding joint is the seventh value.
    """
    need_six_axes(program, "Kawasaki AS", sliding=1)
    name = legal_name(name_main(program), LONGEST_NAME - count_digits(program, most or MOST), reserved=RESERVED).lower()
    can, files = program.tcp is not None, []
    if program.writes_joints(linear=can):
        files += _write_kind(program, folder, name, most, linear=False)
    if can and program.form != "joint":
        files += _write_kind(fit_moves(program).program, folder, f"{name}{name_kind(program, '_l')}", most, linear=True)
    return files


def _write_kind(program: Program, folder: Path, name: str, most: int | None, *, linear: bool) -> list[Path]:
    parts = name_parts(name, len(program), most or MOST)
    files = []
    for part, rows in parts.items():
        files.append(folder / f"{part}.as")
        write_text(files[-1], _part_text(program, part, name_variables(name), rows, linear), newline="\r\n")
    load = ""
    if program.mass is not None:
        x, y, z = (program.centre * 1e3).tolist()
        load = f"{program.mass:.3f},{x:.3f},{y:.3f},{z:.3f}"
    words = {
        "name": name, "parts": [*parts], "comments": head_lines(program), "load": load, "accuracy": ACCURACY,
        "cell": check_cell(program.post, CELL, "Kawasaki AS"), "base": _numbers(program.base_frame),
        "tool": _numbers(np.eye(4) if program.tool is None else program.tool),
    }  # fmt: skip
    files.append(folder / f"{name}.as")
    write_text(files[-1], render_post(program, "kawasaki_as", words), newline="\r\n")
    return files


def name_variables(name: str) -> str:
    """Return how the variables of a program begin: with the end of its name, where tool and kind of move stand."""
    return name.replace("_", "")[-LONGEST_VARIABLE:].lstrip("0123456789")


def _part_text(program: Program, part: str, name: str, rows: slice, linear: bool) -> str:
    alone, stops, arcs = program.alone(linear=linear), program.stops(linear=linear), program.arcs.tolist()
    lines, joints, places = [f".PROGRAM {part}()"], [".JOINTS"], [".TRANS"]
    percent, slides = joint_percent(program, RAPID_PERCENT, SLOWEST_PERCENT), program.joints[:, program.prismatic]
    table = place_table(program.positions, "ZYZ") if linear else np.zeros((len(program), 6))
    arm = np.column_stack([program.joints[:, ~program.prismatic], slides])
    events = phrase_events(program.events, program.wiring, PHRASES, "Kawasaki AS")
    lines += [f"  {line}" for line in events.get(-1, [])] if rows.start == 0 else []
    zones = 1e3 * find_zones(program, ZONES["kawasaki_as"])[1] if linear else np.full(len(program), np.inf)
    zone = f"{ACCURACY:.3g}"
    for row in range(rows.start, rows.stop):
        if linear and not alone[row]:
            places.append(f"{name}p{row} " + " ".join(f"{value:.6f}" for value in [*table[row], *slides[row]]))
            lines.append(f"  SPEED {program.feed[row]:.4f} MM/S")
            said = zone if stops[row] else f"{zones[row] if np.isfinite(zones[row]) else ACCURACY:.3g}"
            lines += [f"  ACCURACY {said} ALWAYS"] if said != zone else []
            zone = said
            if arcs[row]:
                middle = place_table(program.via_positions[row][None], "ZYZ")[0]
                places.append(f"{name}c{row} " + " ".join(f"{value:.6f}" for value in [*middle, *slides[row]]))
                lines += [f"  C1MOVE part+{name}c{row}", f"  C2MOVE part+{name}p{row}"]
            else:
                lines.append(f"  LMOVE part+{name}p{row}")
        else:
            if linear and program.swings[row]:
                lines.append("  ; the configuration changes: a joint move")
            joints.append(f"#{name}j{row} " + " ".join(f"{value:.6f}" for value in arm[row]))
            lines += [f"  SPEED {percent[row]:.4f}", f"  JMOVE #{name}j{row}"]
        lines += ["  BREAK"] if stops[row] else []
        lines += [f"  {line}" for line in events.get(row, [])]
    lines += [f"  ACCURACY {ACCURACY:.3g} ALWAYS"] if float(zone) != ACCURACY else []
    lists = [*places, ".END"] * (len(places) > 1) + [*joints, ".END"] * (len(joints) > 1)
    return "\n".join([*lines, ".END", *lists, ""])


def _numbers(pose: Array) -> str:
    return ",".join(f"{value:.7f}" for value in place_numbers(pose, "ZYZ"))


def _format_main(name: str, program: Program, calls: Sequence[str]) -> str:
    head = [f"  ; {line}" for line in head_lines(program)]
    return "\n".join([f".PROGRAM {name}()", *head, *(f"  CALL {call}" for call in calls), ".END", ""])


MAIN = MainForm(".as", 12, _format_main)
