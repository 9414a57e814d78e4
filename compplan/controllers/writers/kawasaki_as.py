"""Kawasaki AS: a file with a program, its joint positions (.JOINTS) and its transformations (.TRANS)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import ProgramForm, ProgramPart, change, need_six_axes
from compplan.controllers.writers.program import Program
from compplan.controllers.writers.text import list_numbers

name = "kawasaki_as"
#: Letters of the program's name in a variable; variables have 15 at most, and all programs of a controller share them.
LONGEST_VARIABLE = 9
#: Required accuracy at a point within a cut. [mm]
ACCURACY = 0.1


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.as with joint moves (JMOVE), and NAME_L.as with lines and arcs (LMOVE, C1MOVE, C2MOVE).

    Long programs call further programs NAME_1 and so on, one file each. Transformations refer to the part frame
    (part+p1); angles are O A T: about z, the new y, the newest z. A transformation has no configuration in this
    language: linear moves keep the branch of the joint move before them. A sliding joint is the seventh value.
    """
    need_six_axes(program, "Kawasaki AS", sliding=1)
    return FORM.write(program, folder, most, can=True)


def _format_part(part: ProgramPart) -> dict[str, str]:
    usual = f"ACCURACY {ACCURACY:.3g} ALWAYS"
    # prefix of the variables: the end of the name, which holds tool and kind of move
    own = part.whole.replace("_", "")[-LONGEST_VARIABLE:].lstrip("0123456789")
    modal, lines, joints, places = {"zone": usual}, [], [], []
    for move in part.moves:
        row, zone, pause = move.row, f"{1e3 * move.zone:.3g}", ["BREAK"] if move.stops else []
        if move.kind == "joint":
            note = ["; the configuration changes: a joint move"] if move.swings else []
            joints.append(f"#{own}j{row} {list_numbers([*move.arm, *move.outer], 6, ' ')}")
            lines.append([*note, f"SPEED {move.percent:.4f}", f"JMOVE #{own}j{row}", *pause])
            continue
        accuracy = "" if move.stops else usual if move.zone == np.inf else f"ACCURACY {zone} ALWAYS"
        places.append(f"{own}p{row} {list_numbers([*move.place, *move.outer], 6, ' ')}")
        ends = [f"LMOVE part+{own}p{row}"]
        if move.via:
            places.append(f"{own}c{row} {list_numbers([*move.via, *move.outer], 6, ' ')}")
            ends = [f"C1MOVE part+{own}c{row}", f"C2MOVE part+{own}p{row}"]
        lines.append([f"SPEED {move.feed:.4f} MM/S", *change(modal, "zone", accuracy), *ends, *pause])
    body = [*part.merge_events(lines, "  "), *(f"  {line}" for line in change(modal, "zone", usual))]
    lists = [[".TRANS", *places, ".END"] if places else [], [".JOINTS", *joints, ".END"] if joints else []]
    return {f"{part.name}.as": "\n".join([f".PROGRAM {part.name}()", *body, ".END", *lists[0], *lists[1], ""])}


def _format_calls(part: ProgramPart) -> dict[str, str]:
    program, load = part.program, ""
    if program.mass is not None:
        load = list_numbers([program.mass, *program.centre * 1e3], 3)
    tool, base = (list_numbers(place_numbers(pose, "ZYZ"), 7) for pose in (program.tool, program.base_frame))
    return {f"{part.name}.as": part.render("kawasaki_as", load=load, accuracy=ACCURACY, base=base, tool=tool)}


FORM = ProgramForm.load("kawasaki_as", lambda poses: place_table(poses, "ZYZ"), _format_part, _format_calls)
