"""ABB RAPID: modules with joint targets (MoveAbsJ), and with robot targets in the part frame (MoveL)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import quaternions
from compplan.controllers.writers.language import ProgramForm, ProgramPart, WrittenMove
from compplan.controllers.writers.program import Program
from compplan.errors import InputError
from compplan.io.tables import Array

name = "rapid"
UNUSED = "9E9"
#: Mechanical unit that carries the part (assumed).
POSITIONER = "STN1"
#: Contributions to cfx: wrist centre behind axis 1, wrist centre behind the lower arm, axis 5 below 0.
CFX = {"shoulder": {"front": 0, "back": 4}, "elbow": {"up": 0, "down": 2}, "wrist": {"noflip": 0, "flip": 1}}
#: Formats of a frame and of a custom zone [mm], [deg] (z0's ratios of tip, rotation and external axes).
FRAME = "[[{:.5f},{:.5f},{:.5f}],[{:.9f},{:.9f},{:.9f},{:.9f}]]"
ZONE = "[FALSE,{0:.3f},{0:.3f},{0:.3f},{1:.4f},{0:.3f},{1:.4f}]"


def _state_poses(poses: Array) -> Array:
    """Return poses in RAPID's notation: position [mm] and quaternion. Shape (n, 4, 4) -> (n, 7)."""
    return np.column_stack([poses[:, :3, 3] * 1e3, quaternions(poses)])


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.mod with joint moves and, where poses are known, NAME_L.mod with linear ones; each calls its parts.

    Robot targets refer to a work object at the part frame. Rapid moves (500 mm/s) and configuration changes (at the
    feed) are joint moves with a stop. Sliding joints are external axes (mm). Joints that carry the part are external
    axes as well (deg), in a mechanical unit that moves the user frame of the work object.
    """
    turning, sliding = np.flatnonzero(~program.outer), np.flatnonzero(program.outer)
    if len(turning) > 6 or len(sliding) > 6:
        raise InputError(f"RAPID targets take six rotating and six external axes, not {list(program.joint_names)}")
    return FORM.write(program, folder, most, can=len(turning) == 6)


def _format_part(part: ProgramPart) -> dict[str, str]:
    program, latest, lines = part.program, "", []
    tool_words = program.post.tool or f"t_{part.whole}"
    if part.linear:
        tool_words = f"{tool_words}\\WObj:={program.post.base or f'w_{part.whole}'}"
    for move in part.moves:
        rapid = move.kind == "joint" and program.rapid[move.row]
        speed = 500.0 if rapid else max(move.feed, 0.01)
        zone = "z0" if move.zone == np.inf else ZONE.format(1e3 * move.zone, 1e2 * move.zone)
        manner = f"[{speed:.3f},500,5000,1000],{'fine' if move.stops else zone}"
        notes = ["! the configuration changes: a joint move"] if move.swings else []
        if move.kind != "joint":
            line = program.write_comment_line(move.row, "!").strip()
            notes, latest = [line] if line and line != latest else [], line
        lines.append([*notes, f"{_state_target(program, move)},{manner},{tool_words};"])
    body = [f"MODULE {part.name}", f"  PROC run_{part.name}()", *part.merge_events(lines, "    "), "  ENDPROC"]
    return {f"{part.name}.mod": "\n".join([*body, "ENDMODULE", ""])}


def _format_calls(part: ProgramPart) -> dict[str, str]:
    program, name = part.program, part.name
    cell, none = program.post, _format_frame(np.eye(4))
    base = f'[FALSE,TRUE,"",{_format_frame(program.base_frame)},{none}]'
    if program.moves_part:
        base = f'[FALSE,FALSE,"{POSITIONER}",{none},{_format_frame(program.part)}]'
    text = part.render(
        "rapid", entry=program.post.main or f"run_{name}", parts=[f"run_{part}" for part in part.parts],
        massless=program.mass is None, tool=_format_tool(program), tool_name=cell.tool or f"t_{name}",
        base_name=cell.base or f"w_{name}", base=base, unit=POSITIONER if program.moves_part else None,
    )  # fmt: skip
    return {f"{name}.mod": text}


def _state_target(program: Program, move: WrittenMove) -> str:
    external = ",".join([f"{value:.5f}" for value in move.outer] + [UNUSED] * (6 - len(move.outer)))
    if move.kind == "joint":
        axes = [f"{value:.6f}" for value in move.arm] + ["0"] * (6 - len(move.arm))
        return f"MoveAbsJ [[{','.join(axes)}],[{external}]]"
    rest = f"[{','.join(map(str, find_configuration(program, move)))}],[{external}]]"
    targets = [
        f"[[{','.join(f'{v:.5f}' for v in pose[:3])}],[{','.join(f'{v:.10f}' for v in pose[3:])}],{rest}"
        for pose in (move.via, move.place) if pose
    ]  # fmt: skip
    return f"{'MoveC' if move.via else 'MoveL'} {','.join(targets)}"


def find_configuration(program: Program, move: WrittenMove) -> list[int]:
    """Return confdata: quadrants of axes 1, 4 and 6, and cfx (0 where the configuration words are not known)."""
    cfx = sum(shares.get(str(program.words[key][move.row]), 0) for key, shares in CFX.items() if key in program.words)
    return [*(int(np.floor(move.arm[axis] / 90.0)) for axis in (0, 3, 5)), cfx]


def _format_frame(pose: Array) -> str:
    place, turn = np.round(pose[:3, 3] * 1e3, 5), np.round(quaternions(pose[None])[0], 9)
    return FRAME.format(*place + 0.0, *turn + 0.0)


def _format_tool(program: Program) -> str:
    frame, mass, centre = _format_frame(program.tool), "1", "0,0,1"
    if program.mass is not None:
        mass, centre = f"{program.mass:.3f}", ",".join(f"{value:.3f}" for value in program.centre * 1e3)
    return f"[TRUE,{frame},[{mass},[{centre}],[1,0,0,0],0,0,0]]"


FORM = ProgramForm.load("rapid", _state_poses, _format_part, _format_calls)
