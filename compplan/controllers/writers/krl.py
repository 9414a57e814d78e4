"""KUKA KRL: plain lines and arcs (LIN, CIRC), and joint moves (PTP)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import ProgramForm, ProgramPart, WrittenMove, change
from compplan.controllers.writers.post import render_own
from compplan.controllers.writers.program import Program, head_lines, joint_percent, order_joints

name = "krl"
ARM = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
RAPID_PERCENT = 20
#: Relative rounding error of a joint move's percentage above which its feed is reported as not kept.
UNTRUE = 0.1
#: Distance before a corner at which lines and arcs leave the path, unless the job requires less. [mm]
WIDE = "$APO.CDIS=0.1"
#: $BASE of a part on a positioner is EK of MACHINE_DEF[n], with this n (assumed).
POSITIONER = 2
#: Formats of a pose, a frame, and joints of the arm.
PLACE = "X {:.5f},Y {:.5f},Z {:.5f},A {:.6f},B {:.6f},C {:.6f}"
FRAME = "{{X {:.7f},Y {:.7f},Z {:.7f},A {:.7f},B {:.7f},C {:.7f}}}"
JOINTS = "A1 {:.6f},A2 {:.6f},A3 {:.6f},A4 {:.6f},A5 {:.6f},A6 {:.6f}"


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME_J.src, which moves the joints, and NAME_L.src, which moves the tool; each calls its parts.

    The joint program repeats the plan waypoint by waypoint, each at a percentage of the axis rates. The linear one
    uses the controller's kinematic model. Its positions refer to the part frame ($BASE); its rapid moves and
    configuration changes are joint moves. A rail is a coupled axis: $BASE stays fixed while it moves. Where joints
    carry the part, $BASE moves with it (EK).
    """
    order_joints(program, ARM, "KRL")
    return FORM.write(program, folder, most, can=program.status is not None)


def turn_bits(arm: Sequence[float]) -> int:
    """Return T of a KRL position: bit i is set where axis i + 1 is below 0 deg."""
    return sum(1 << axis for axis, value in enumerate(arm) if value < 0.0)


def _format_part(part: ProgramPart) -> dict[str, str]:
    lines = _fold_lines(_format_moves(part))
    words = {"name": part.name, "comments": head_lines(part.program), "lines": lines, "calls": []}
    return {f"{part.name}.src": render_own("krl_main", words)}


def _format_moves(part: ProgramPart) -> list[str]:
    """Return the lines of motion of a part, each with commands for speed and zone where they change."""
    program, modal, lines = part.program, {"zone": WIDE}, []
    columns = order_joints(program, ARM, "KRL")
    for move in part.moves:
        if move.kind == "joint":
            percent = RAPID_PERCENT if program.rapid[move.row] else int(move.percent + 0.5)
            note = "; the configuration changes: a joint move\n" if move.swings else ""
            target = JOINTS.format(*program.joints[move.row, columns]) + _format_external(program, move.row)
            lines.append([
                *([] if part.linear else change(modal, "percent", f"BAS(#VEL_PTP,{percent})")),
                f"{note}PTP {{{target}}}{'' if move.stops else ' C_PTP'}",
            ])  # fmt: skip
            continue
        end = "" if move.stops else " C_DIS"
        zone = "" if move.stops else WIDE if move.zone == np.inf else f"$APO.CDIS={1e3 * move.zone:.3f}"
        lines.append([
            *change(modal, "speed", f"$VEL.CP={move.feed * 1e-3:.6f}"), *change(modal, "zone", zone),
            f"{_format_target(program, move, columns)}{end}{program.write_comment_line(move.row, ';')}",
        ])  # fmt: skip
    return [*part.merge_events(lines), *change(modal, "zone", WIDE)]


def _format_target(program: Program, move: WrittenMove, columns: list[int]) -> str:
    assert program.status is not None
    turns = turn_bits(program.joints[move.row, columns].tolist())
    words = f"S {program.status[move.row]},T {turns}{_format_external(program, move.row)}"
    target = f"{{{PLACE.format(*move.place)},{words}}}"
    return f"CIRC {{{PLACE.format(*move.via)}}},{target}" if move.via else f"LIN {target}"


def _fold_lines(lines: list[str]) -> list[str]:
    """Return lines in folds, each from the comments before some moves to the next ones; pendants show them closed."""
    folded: list[str] = []
    inside, said = False, False
    for line in lines:
        says = line.startswith("; ") and "\n" not in line
        if says and not said:
            folded += [*([";ENDFOLD"] if inside else []), f";FOLD {line[2:]}"]
            inside = True
        else:
            folded.append(line)
        said = says
    return [*folded, ";ENDFOLD"] if inside else folded


def describe(program: Program) -> list[str]:
    """Return notes on joint moves that miss the feed, since their speed is a whole percentage of the axis rates."""
    if program.form == "linear" and program.status is not None:
        return []
    percent = joint_percent(program)
    whole = np.maximum(np.round(percent), 1.0)
    wrong = ~program.rapid & (np.abs(whole - percent) > UNTRUE * percent)
    slow = ~program.rapid & (percent <= 1.0)
    if not (wrong | slow).any():
        return []
    count = int(np.count_nonzero(wrong | slow))
    return [
        f"KRL joint moves have whole percents of the axis rates: {count} of {len(program)} do not hold their feed",
        "the linear program (_L) holds it"
        if program.status is not None
        else "no linear program: controller.toml has no configuration words with status",
    ]


def _format_external(program: Program, row: int) -> str:
    """Return the external axes after a comma; an empty text for an arm without them."""
    held = dict(zip(program.joint_names, program.joints[row].tolist(), strict=True))
    return "".join(f",{name} {held.get(name, 0.0):.4f}" for name in EXTERNAL) if {*EXTERNAL} & {*held} else ""


def _format_calls(part: ProgramPart) -> dict[str, str]:
    """Return the .src file that sets base, tool and approximation, and calls the parts."""
    program, load = part.program, None
    if program.mass is not None:
        x, y, z = (program.centre * 1e3).tolist()
        centre = f"CM {{X {x:.3f},Y {y:.3f},Z {z:.3f},A 0.0,B 0.0,C 0.0}},J {{X 0.0,Y 0.0,Z 0.0}}"
        load = f"{{M {program.mass:.3f},{centre}}}"
    text = part.render(
        "krl", load=load, remarks=[] if part.linear else describe(program), positioner=POSITIONER,
        base=FRAME.format(*place_numbers(program.base_frame, "ZYX")),
        tool=FRAME.format(*place_numbers(program.tool, "ZYX")), rapid_percent=RAPID_PERCENT,
        rail=bool(program.prismatic.any()) and not program.moves_part, carried=program.moves_part,
    )  # fmt: skip
    return {f"{part.name}.src": text}


FORM = ProgramForm.load("krl", lambda poses: place_table(poses, "ZYX"), _format_part, _format_calls)
