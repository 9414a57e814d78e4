"""ABB RAPID: modules with joint targets and MoveAbsJ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.program.program import Program, head_lines, short_name, split_parts

#: Points in a module where the job says nothing.
MOST = 5000
LONGEST_NAME = 26
UNUSED = "9E9"
Indices = NDArray[np.int64]


def write_rapid(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.mod, whose main calls the parts, and NAME_1.mod and so on with the moves.

    Waypoints are joint targets. The tool centre point runs no faster than the feed; rapid moves run at 500 mm/s and
    stop. Sliding joints are external axes (mm).

    Args:
        program: The program.
        folder: Folder to write to.
        most: Greatest number of points in a module.

    Raises:
        InputError: If the robot has more than six rotating or six sliding joints.

    """
    turning, sliding = np.flatnonzero(~program.prismatic), np.flatnonzero(program.prismatic)
    if len(turning) > 6 or len(sliding) > 6:
        raise InputError(f"RAPID targets take six rotating and six external axes, not {list(program.joint_names)}")
    name = short_name(program.name, LONGEST_NAME)
    parts = split_parts(len(program), most or MOST)
    names = [f"{name}_{number}" for number in range(1, len(parts) + 1)]
    files = []
    for part, rows in zip(names, parts, strict=True):
        lines = [_move(program, row, turning, sliding, f"t_{name}") for row in range(rows.start, rows.stop)]
        files.append(folder / f"{part}.mod")
        body = [f"MODULE {part}", f"  PROC run_{part}()", *lines, "  ENDPROC", "ENDMODULE", ""]
        write_text(files[-1], "\n".join(body))
    comments = [f"  ! {line}" for line in head_lines(program)]
    calls = [f"    run_{part};" for part in names]
    tool = [
        "  ! mass and centre of the tool are placeholders: load its own data",
        f"  PERS tooldata t_{name}:={_tool(program)};",
    ]
    files.append(folder / f"{name}.mod")
    body = [f"MODULE {name}", *comments, *tool, "  PROC main()", *calls, "  ENDPROC", "ENDMODULE", ""]
    write_text(files[-1], "\n".join(body))
    return files


def _move(program: Program, row: int, turning: Indices, sliding: Indices, tool: str) -> str:
    values = program.joints[row]
    axes = ",".join([f"{values[column]:.6f}" for column in turning] + ["0"] * (6 - len(turning)))
    external = ",".join([f"{values[column]:.5f}" for column in sliding] + [UNUSED] * (6 - len(sliding)))
    speed = 500.0 if program.rapid[row] else max(program.feed[row], 0.01)
    last = row + 1 == len(program) or bool(program.rapid[row + 1])
    zone = "fine" if program.rapid[row] or last else "z0"
    return f"    MoveAbsJ [[{axes}],[{external}]],[{speed:.3f},500,5000,1000],{zone},{tool};"


def _tool(program: Program) -> str:
    tool = np.eye(4) if program.tool is None else program.tool
    x, y, z = (tool[:3, 3] * 1e3).tolist()
    qx, qy, qz, qw = Rotation.from_matrix(tool[:3, :3]).as_quat(canonical=True).tolist()
    frame = f"[[{x:.5f},{y:.5f},{z:.5f}],[{qw:.9f},{qx:.9f},{qy:.9f},{qz:.9f}]]"
    return f"[TRUE,{frame},[1,[0,0,1],[1,0,0,0],0,0,0]]"
