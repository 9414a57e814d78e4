"""ABB RAPID: modules with joint targets (MoveAbsJ), and with robot targets in the part frame (MoveL)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import quaternions
from compplan.controllers.writers.machine import Phrases, Signal, name_signal, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, render_post
from compplan.controllers.writers.program import Program, count_digits, head_lines, name_parts
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text

name = "rapid"
BRAND = "ABB"
#: Points in a module where the job says nothing.
MOST = 5000
#: RAPID takes 32 letters; "run_", "_L_" and the number of a part take the rest.
LONGEST_NAME = 25
RESERVED = frozenset({"test", "module", "main", "proc", "func", "trap", "record", "alias", "with", "local", "task"})
UNUSED = "9E9"
#: Mechanical unit that carries the part, where a job names none (assumed).
CELL = CellWords(str, str, {"positioner": "STN1"})
MOVES_PART = True
#: Letters of a message on the teach pendant.
LONGEST_MESSAGE = 80
#: What RAPID adds up to cfx: wrist centre behind axis 1, behind the lower arm, axis 5 below 0.
CFX = {"shoulder": {"front": 0, "back": 4}, "elbow": {"up": 0, "down": 2}, "wrist": {"noflip": 0, "flip": 1}}


def _tell(task: str) -> str:
    return f'TPWrite "{task[:LONGEST_MESSAGE]}";'


def _switch(signal: Signal, on: bool) -> list[str]:
    return [f"SetDO {name_signal(signal, 'do')},{int(on)};"]


PHRASES = Phrases(
    say=lambda text: [f"! {text}"],
    switch=_switch,
    wait=lambda seconds: [f"WaitTime {seconds:.3f};"],
    expect=lambda signal: [f"WaitDI {name_signal(signal, 'di')},1;"],
    pause=lambda task: [_tell(task), "Stop;"],
    pause_if=lambda signal, task: [f"IF {name_signal(signal, 'di')}=1 THEN", f"  {_tell(task)}", "  Stop;", "ENDIF"],
    call=lambda name, number: [f"{name} {number:.0f};"],
    named=True,
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.mod with joint moves and, where poses are known, NAME_L.mod with linear ones; each calls its parts.

    Waypoints are joint targets, or robot targets in a work object that is the part frame. The tool centre point runs no
    faster than the feed; rapid moves (500 mm/s) and swings (at the feed) are joint moves and stop. Sliding joints are
    external axes (mm); positions count from the standing base. Joints that carry the part are external axes too (deg),
    of a mechanical unit that moves the user frame of the work object.
    """
    turning, sliding = np.flatnonzero(~program.outer), np.flatnonzero(program.outer)
    if len(turning) > 6 or len(sliding) > 6:
        raise InputError(f"RAPID targets take six rotating and six external axes, not {list(program.joint_names)}")
    name = legal_name(program.name, LONGEST_NAME - count_digits(program, most or MOST), reserved=RESERVED)
    can, files = program.tcp is not None and len(turning) == 6, []
    if program.writes_joints(linear=can):
        files += _write_kind(program, folder, name, _joint_moves(program, name), most)
    if can and program.form != "joint":
        fitted = fit_moves(program).program
        files += _write_kind(fitted, folder, f"{name}_L", _linear_moves(fitted, f"{name}_L"), most)
    return files


def _write_kind(program: Program, folder: Path, name: str, moves: list[str], most: int | None) -> list[Path]:
    parts = name_parts(name, len(program), most or MOST)
    for row, lines in phrase_events(program.events, program.wiring, PHRASES, "RAPID").items():
        text = "\n".join(f"    {line}" for line in lines)
        moves[max(row, 0)] = f"{text}\n{moves[0]}" if row < 0 else f"{moves[row]}\n{text}"
    files = []
    for part, rows in parts.items():
        files.append(folder / f"{part}.mod")
        body = [f"MODULE {part}", f"  PROC run_{part}()", *moves[rows], "  ENDPROC", "ENDMODULE", ""]
        write_text(files[-1], "\n".join(body))
    cell = check_cell(program.post, CELL, "RAPID")
    words = {
        "name": name, "entry": program.post.main or f"run_{name}", "parts": [f"run_{part}" for part in parts],
        "comments": head_lines(program), "cell": cell, "massless": program.mass is None, "tool": _tool(program),
        "tool_name": cell.tool or f"t_{name}", "base_name": cell.base or f"w_{name}",
        "base": f'[FALSE,TRUE,"",{_frame(program.base_frame)},{_frame(np.eye(4))}]' if not program.moves_part else
                f'[FALSE,FALSE,"{cell.positioner}",{_frame(np.eye(4))},{_frame(program.part)}]',
        "unit": cell.positioner if program.moves_part else None,
    }  # fmt: skip
    files.append(folder / f"{name}.mod")
    write_text(files[-1], render_post(program, "rapid", words))
    return files


def _joint_moves(program: Program, name: str) -> list[str]:
    tool = program.post.tool or f"t_{name}"
    stops = program.stops(linear=False)
    return [
        f"    MoveAbsJ {_joint_target(program, row)},{_manner(program, row, rapid, stop)},{tool};"
        for row, (rapid, stop) in enumerate(zip(program.rapid.tolist(), stops.tolist(), strict=True))
    ]


def _joint_target(program: Program, row: int) -> str:
    axes = [f"{value:.6f}" for value in program.joints[row, ~program.outer]]
    return f"[[{','.join([*axes, *['0'] * (6 - len(axes))])}],[{_external(program, row)}]]"


def _linear_moves(program: Program, name: str) -> list[str]:
    positions, turns = program.positions, quaternions(program.positions)
    alone, stops = program.alone(linear=True).tolist(), program.stops(linear=True).tolist()
    arcs, via, moves, said = program.arcs.tolist(), program.via_positions, list[str](), ""
    zones = [_zone(zone) for zone in find_zones(program, ZONES["rapid"])[1].tolist()]
    seen = f"{program.post.tool or f't_{name}'}\\WObj:={program.post.base or f'w_{name}'}"
    for row, (place, turn, configuration) in enumerate(
        zip((positions[:, :3, 3] * 1e3).tolist(), turns.tolist(), configurations(program).tolist(), strict=True)
    ):
        rest = f"[{','.join(map(str, configuration))}],[{_external(program, row)}]]"
        if alone[row]:
            target = f"MoveAbsJ {_joint_target(program, row)}"
        else:
            target = f"MoveL {_robot_target(place, turn, rest)}"
            if arcs[row]:
                middle = _robot_target((via[row, :3, 3] * 1e3).tolist(), quaternions(via[row][None])[0].tolist(), rest)
                target = f"MoveC {middle},{_robot_target(place, turn, rest)}"
        manner = _manner(program, row, alone[row], stops[row], zones[row])
        note = "    ! the configuration changes: a joint move\n" if program.swings[row] else ""
        if not alone[row] and (cam := program.write_comment_line(row, "!")) != said:
            note, said = f"{note}   {cam}\n" if cam else note, cam
        moves.append(f"{note}    {target},{manner},{seen};")
    return moves


def _robot_target(place: list[float], turn: list[float], rest: str) -> str:
    return f"[[{','.join(f'{v:.5f}' for v in place)}],[{','.join(f'{v:.10f}' for v in turn)}],{rest}"


def configurations(program: Program) -> NDArray[np.int64]:
    """Return confdata: quadrants of axes 1, 4 and 6, and cfx (0 where the words are not known). Shape (n, 4)."""
    arm = program.joints[:, ~program.outer]
    quadrants = np.floor(arm[:, [0, 3, 5]] / 90.0).astype(np.int64)
    sums = np.zeros(len(program), dtype=np.int64)
    for key, shares in CFX.items():
        if key in program.words:
            sums += np.array([shares.get(value, 0) for value in program.words[key].tolist()], dtype=np.int64)
    return np.column_stack([quadrants, sums])


def _manner(program: Program, row: int, alone: bool, stop: bool, zone: str = "z0") -> str:
    speed = 500.0 if alone and program.rapid[row] else max(program.feed[row], 0.01)
    return f"[{speed:.3f},500,5000,1000],{'fine' if stop else zone}"


def _zone(zone: float) -> str:
    """Return zonedata: a zone of one's own [m] where it is finite; z0's ratios of tip, turn and external axes."""
    if zone == np.inf:
        return "z0"
    size, turn = f"{1e3 * zone:.3f}", f"{1e2 * zone:.4f}"
    return f"[FALSE,{size},{size},{size},{turn},{size},{turn}]"


def _external(program: Program, row: int) -> str:
    values = [f"{value:.5f}" for value in program.joints[row, program.outer]]
    return ",".join(values + [UNUSED] * (6 - len(values)))


def _frame(pose: Array) -> str:
    place = ",".join(f"{value:.5f}" for value in np.round(pose[:3, 3] * 1e3, 5) + 0.0)
    turn = ",".join(f"{value:.9f}" for value in np.round(quaternions(pose[None])[0], 9) + 0.0)
    return f"[[{place}],[{turn}]]"


def _tool(program: Program) -> str:
    frame = _frame(np.eye(4) if program.tool is None else program.tool)
    if program.mass is None:
        return f"[TRUE,{frame},[1,[0,0,1],[1,0,0,0],0,0,0]]"
    centre = ",".join(f"{value:.3f}" for value in program.centre * 1e3)
    return f"[TRUE,{frame},[{program.mass:.3f},[{centre}],[1,0,0,0],0,0,0]]"
