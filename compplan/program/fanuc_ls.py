"""FANUC teach pendant programs as ASCII (.ls), positions in joint representation."""

from __future__ import annotations

from pathlib import Path

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.program.program import Program, head_lines, short_name, split_parts

#: Positions in a program where the job says nothing.
MOST = 1000
LONGEST_NAME = 30
#: Greatest and smallest linear speed that the language takes [mm/s].
FASTEST, SLOWEST = 2000.0, 0.1


def write_fanuc_ls(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.LS, which calls NAME_1.LS and so on; one part alone is NAME.LS itself.

    Waypoints are joint positions. Cutting moves are linear moves (L) between them with their feed, rapid moves joint
    moves (J) at 20 %. Sliding joints are extended axes (E1 ..) in mm.

    Args:
        program: The program.
        folder: Folder to write to.
        most: Greatest number of positions in a program.

    Raises:
        InputError: If the robot has more than six rotating joints, or a feed above 2000 mm/s.

    """
    turning = [index for index, slides in enumerate(program.prismatic) if not slides]
    sliding = [index for index, slides in enumerate(program.prismatic) if slides]
    if len(turning) > 6 or len(sliding) > 3:
        raise InputError(f"FANUC programs take six rotating and three sliding joints, not {list(program.joint_names)}")
    if program.feed.max(initial=0.0) > FASTEST:
        raise InputError(f"feed is {program.feed.max():g} mm/s, FANUC programs take at most {FASTEST:g} mm/s")
    name = short_name(program.name, LONGEST_NAME - 4).upper()
    parts = split_parts(len(program), most or MOST)
    names = [name] if len(parts) == 1 else [f"{name}_{number}" for number in range(1, len(parts) + 1)]
    files = []
    for part, rows in zip(names, parts, strict=True):
        moves = [_move(program, row, row - rows.start + 1) for row in range(rows.start, rows.stop)]
        positions = [
            _position(program, row, row - rows.start + 1, turning, sliding) for row in range(rows.start, rows.stop)
        ]
        head = ["  UFRAME_NUM=0 ;", "  UTOOL_NUM=1 ;"]
        files.append(folder / f"{part}.LS")
        write_text(files[-1], _text(part, program, head + moves, positions), newline="\r\n")
    if len(parts) > 1:
        files.append(folder / f"{name}.LS")
        write_text(files[-1], _text(name, program, [f"  CALL {part} ;" for part in names], []), newline="\r\n")
    return files


def _move(program: Program, row: int, number: int) -> str:
    if program.rapid[row]:
        return f"J P[{number}] 20% FINE ;"
    last = row + 1 == len(program) or program.rapid[row + 1]
    return f"L P[{number}] {max(program.feed[row], SLOWEST):.1f}mm/sec {'FINE' if last else 'CNT100'} ;"


def _position(program: Program, row: int, number: int, turning: list[int], sliding: list[int]) -> str:
    values = program.joints[row]
    entries = [f"J{index}= {values[column]:12.6f} deg" for index, column in enumerate(turning, start=1)]
    entries += [f"E{index}= {values[column]:12.6f}  mm" for index, column in enumerate(sliding, start=1)]
    groups = [",\t".join(entries[start : start + 3]) for start in range(0, len(entries), 3)]
    return f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t" + ",\n\t".join(groups) + "\n};"


def _text(name: str, program: Program, instructions: list[str], positions: list[str]) -> str:
    comments = [f"  !{line[:32]} ;" for line in head_lines(program)]
    body = [f"{number:4d}:{line}" for number, line in enumerate([*comments, *instructions], start=1)]
    attributes = [
        f"/PROG  {name}", "/ATTR", "OWNER\t\t= MNEDITOR;", 'COMMENT\t\t= "compplan";', "FILE_NAME\t= ;",
        "VERSION\t\t= 0;", f"LINE_COUNT\t= {len(body)};", "PROTECT\t\t= READ_WRITE;", "TCD:  STACK_SIZE\t= 0,",
        "      TASK_PRIORITY\t= 50,",
        "      TIME_SLICE\t= 0,", "      BUSY_LAMP_OFF\t= 0,", "      ABORT_REQUEST\t= 0,", "      PAUSE_REQUEST\t= 0;",
        "DEFAULT_GROUP\t= 1,*,*,*,*;", "CONTROL_CODE\t= 00000000 00000000;",
    ]
    return "\n".join([*attributes, "/MN", *body, "/POS", *positions, "/END", ""])
