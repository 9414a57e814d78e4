"""KUKA KRL: plain lines and arcs (LIN, CIRC), and joint moves (E6AXIS) that .src loops take from .dat arrays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.language import MainForm
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import (
    Program,
    count_digits,
    head_lines,
    joint_percent,
    name_parts,
    order_joints,
)
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text

name = "krl"
BRAND = "KUKA"
ARM = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
#: Points in a file where the job says nothing: a size that KRC2 and later load without complaint.
MOST = 2000
#: KRL takes 24 letters; "_J" and the number of a part take the rest.
LONGEST_NAME = 22
RAPID_PERCENT = 20
#: Letters of a message on the pendant.
LONGEST_MESSAGE = 80
#: A joint move whose whole percent is off by more than this share does not hold its feed.
UNTRUE = 0.1
#: How far before a corner lines and arcs leave the path where the job does not ask for less. [mm]
WIDE = "$APO.CDIS=0.1"
#: $BASE of a part that a positioner carries is EK of MACHINE_DEF[n], here its number (assumed).
CELL = CellWords(int, int, {"positioner": 2})
MOVES_PART = True
#: How modules begin that the controller itself writes: seen and edited by all, all lines editable.
HEAD = ("&ACCESS RVP", "&REL 1", "&PARAM EDITMASK = *")


#: Body of the loop over joint positions: SP is a percent, 0 for a rapid move.
JOINT = (
    f"  K={RAPID_PERCENT}",
    "  IF SP[I]>0.0 THEN",
    "    K=SP[I]",
    "  ENDIF",
    "  FOR J=1 TO 6",
    "    $VEL_AXIS[J]=K",
    "  ENDFOR",
    "  IF EX[I]>0 THEN",
    "    PTP PT[I]",
    "  ELSE",
    "    PTP PT[I] C_PTP",
    "  ENDIF",
)


def _tell(task: str) -> str:
    """Return the line that shows a message on the pendant (MsgLib of KSS 8; older controllers have none)."""
    return f'MsgNotify("{task[:LONGEST_MESSAGE]}")'


PHRASES = Phrases(
    say=lambda text: [f"; {text}"],
    switch=lambda signal, on: [f"$OUT[{signal}]={'TRUE' if on else 'FALSE'}"],
    wait=lambda seconds: [f"WAIT SEC {seconds:.3f}"],
    expect=lambda signal: [f"WAIT FOR $IN[{signal}]"],
    pause=lambda task: [_tell(task), "HALT"],
    pause_if=lambda signal, task: [f"IF $IN[{signal}] THEN", f"  {_tell(task)}", "  HALT", "ENDIF"],
    call=lambda name, number: [f"{name}({number:.0f})"],
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME_J.src, which moves the joints, and NAME_L.src, which moves the tool; each calls its parts.

    The joint program repeats the plan waypoint by waypoint, from arrays in .dat files. The linear one has plain motion
    lines (LIN, CIRC) through the geometry that the controller believes; its positions count from the part frame
    ($BASE), its rapid moves and swings are joint moves; it is written where poses are known. Where splines are asked
    for, lines and arcs are those of the spline planner (SLIN, SCIRC), one by one: a block of them stops wherever the
    curvature changes, and the curve of SPL is not published. A rail counts as
    coupled: $BASE stands still while it moves; where joints carry the part, $BASE moves with it (EK).
    Files end lines with CR LF.
    """
    order_joints(program, ARM, "KRL")
    name = legal_name(name_main(program), LONGEST_NAME - count_digits(program, most or MOST))
    can, files = program.tcp is not None and program.status is not None, []
    if program.writes_joints(linear=can):
        files += _write_joint(program, folder, f"{name}{name_kind(program, '_J')}", most or MOST)
    if can and program.form != "joint":
        files += _write_linear(fit_moves(program).program, folder, f"{name}{name_kind(program, '_L')}", most or MOST)
    return files


def turn_bits(joints: Array) -> NDArray[np.int64]:
    """Return T of KRL positions: bit i is set where axis i + 1 stands below 0 deg. Shape (n, 6) -> (n,)."""
    return np.asarray((joints < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def _write_joint(program: Program, folder: Path, name: str, most: int) -> list[Path]:
    parts = name_parts(name, len(program), most, between="")
    events = phrase_events(program.events, program.wiring, PHRASES, "KRL")
    points, percent, files = _joint_points(program), joint_percent(program), []
    for part, rows in parts.items():
        files.append(folder / f"{part}.dat")
        write_text(files[-1], _data(part, points[rows], program, percent, rows), newline="\r\n")
        files.append(folder / f"{part}.src")
        write_text(files[-1], _source(part, program, rows, events), newline="\r\n")
    files.append(folder / f"{name}.src")
    write_text(files[-1], _main(name, [*parts], program, describe(program)), newline="\r\n")
    return files


def _write_linear(program: Program, folder: Path, name: str, most: int) -> list[Path]:
    parts = name_parts(name, len(program), most, between="")
    events = phrase_events(program.events, program.wiring, PHRASES, "KRL")
    moves, files = _linear_moves(program), []
    for part, rows in parts.items():
        lines = [*HEAD, f"DEF {part}()", *(f"; {line}" for line in head_lines(program))]
        body = list(events.get(-1, [])) if rows.start == 0 else []
        speed, zone = "", WIDE
        for row in range(rows.start, rows.stop):
            wanted, space, move = moves[row]
            body += [wanted] if wanted and wanted != speed else []
            body += [space] if space and space != zone else []
            speed, zone = wanted or speed, space or zone
            body += [move, *events.get(row, [])]
        body += [WIDE] if zone != WIDE else []
        lines += _fold_lines(body)
        files.append(folder / f"{part}.src")
        write_text(files[-1], "\n".join([*lines, "END", ""]), newline="\r\n")
    files.append(folder / f"{name}.src")
    write_text(files[-1], _main(name, [*parts], program, []), newline="\r\n")
    return files


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
    """Return what must be said where joint moves, which know whole percents of the axis rates only, miss the feed."""
    if not program.writes_joints(linear=program.status is not None):
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


def _external(program: Program, row: int, *, whole: bool = False) -> str:
    """Return the external axes behind a comma; nothing of an arm without, unless a declared array wants them all."""
    names = program.joint_names
    if not whole and not set(EXTERNAL) & set(names):
        return ""
    values = [program.joints[row, names.index(name)] if name in names else 0.0 for name in EXTERNAL]
    return "".join(f",{name} {value:.4f}" for name, value in zip(EXTERNAL, values, strict=True))


def _axis_point(program: Program, row: int, columns: list[int], *, whole: bool = False) -> str:
    arm = ",".join(f"{name} {program.joints[row, column]:.6f}" for name, column in zip(ARM, columns, strict=True))
    return f"{{{arm}{_external(program, row, whole=whole)}}}"


def _joint_points(program: Program) -> list[str]:
    columns = order_joints(program, ARM, "KRL")
    return [_axis_point(program, row, columns, whole=True) for row in range(len(program))]


def _linear_moves(program: Program) -> list[tuple[str, str, str]]:
    """Return what sets the speed of each move ("" before joint moves), its zone ("" at stops), and its line."""
    if program.status is None:
        raise InputError("KRL positions need configuration words with status in controller.toml")
    columns = order_joints(program, ARM, "KRL")
    turns, alone = turn_bits(program.joints[:, columns]), program.alone(linear=True).tolist()
    stops, arcs, vias = program.stops(linear=True).tolist(), program.arcs.tolist(), program.via_positions
    moves, planner, zones = [], "S" if program.splines else "", find_zones(program, ZONES["krl"])[1].tolist()
    for row, place in enumerate(place_table(program.positions, "ZYX").tolist()):
        end, cam = "" if stops[row] else " C_DIS", program.write_comment_line(row, ";")
        if alone[row]:
            note = "; the configuration changes: a joint move\n" if program.swings[row] else ""
            moves.append(("", "", f"{note}PTP {_axis_point(program, row, columns)}{end}"))
            continue
        words = f"S {program.status[row]},T {turns[row]}{_external(program, row)}"
        target = f"{{{_place(place)},{words}}}"
        speed = f"$VEL.CP={program.feed[row] * 1e-3:.6f}"
        zone = "" if stops[row] else WIDE if zones[row] == np.inf else f"$APO.CDIS={1e3 * zones[row]:.3f}"
        if arcs[row]:
            via = place_table(vias[row][None], "ZYX")[0].tolist()
            moves.append((speed, zone, f"{planner}CIRC {{{_place(via)}}},{target}{end}{cam}"))
        else:
            moves.append((speed, zone, f"{planner}LIN {target}{end}{cam}"))
    return moves


def _place(values: list[float]) -> str:
    x, y, z, a, b, c = values
    return f"X {x:.5f},Y {y:.5f},Z {z:.5f},A {a:.6f},B {b:.6f},C {c:.6f}"


def _data(name: str, points: list[str], program: Program, percent: Array, rows: slice) -> str:
    """Return a .dat file: the points, how fast each is reached (0: rapid), and which are reached exactly."""
    count = len(points)
    lines = [*HEAD, f"DEFDAT {name} PUBLIC", f"DECL E6AXIS PT[{count}]"]
    lines += [f"PT[{index}]={point}" for index, point in enumerate(points, start=1)]
    lines += ["; percent of the axis rates; 0: rapid", f"DECL REAL SP[{count}]"]
    speeds = np.where(program.rapid, 0.0, percent)[rows]
    lines += [f"SP[{index}]={speed:.6f}" for index, speed in enumerate(speeds, start=1)]
    lines += ["; 1: reached exactly", f"DECL INT EX[{count}]"]
    lines += [f"EX[{index}]={int(exact)}" for index, exact in enumerate(program.stops(linear=False)[rows], start=1)]
    return "\n".join([*lines, "ENDDAT", ""])


def _source(name: str, program: Program, rows: slice, events: dict[int, list[str]]) -> str:
    """Return a .src file: loops over the points of its .dat file, cut where something happens beside motion."""
    lines = [*HEAD, f"DEF {name}()", "DECL INT I,J,K", *(f"; {line}" for line in head_lines(program))]
    lines += [f"; waypoints {rows.start} to {rows.stop - 1}"]
    lines += events.get(-1, []) if rows.start == 0 else []
    first = rows.start
    for row in [*sorted(row for row in events if rows.start <= row < rows.stop - 1), rows.stop - 1]:
        lines += [f"FOR I={first - rows.start + 1} TO {row - rows.start + 1}", *JOINT, "ENDFOR"]
        lines += events.get(row, [])
        first = row + 1
    return "\n".join([*lines, "END", ""])


def _main(name: str, parts: list[str], program: Program, remarks: list[str]) -> str:
    """Return the .src file that sets base, tool and approximation, and calls the parts."""
    load = None
    if program.mass is not None:
        x, y, z = (program.centre * 1e3).tolist()
        centre = f"CM {{X {x:.3f},Y {y:.3f},Z {z:.3f},A 0.0,B 0.0,C 0.0}},J {{X 0.0,Y 0.0,Z 0.0}}"
        load = f"{{M {program.mass:.3f},{centre}}}"
    words = {
        "name": name, "parts": parts, "comments": head_lines(program), "remarks": remarks, "load": load,
        "cell": check_cell(program.post, CELL, "KRL"), "base": _frame(program.base_frame),
        "tool": None if program.tool is None else _frame(program.tool), "rapid_percent": RAPID_PERCENT,
        "rail": bool(program.prismatic.any()) and not program.moves_part, "carried": program.moves_part,
    }  # fmt: skip
    return render_post(program, "krl", words)


def _frame(pose: Array) -> str:
    values = place_numbers(pose, "ZYX")
    return "{" + ",".join(f"{name} {value:.7f}" for name, value in zip("XYZABC", values, strict=True)) + "}"


def _format_main(name: str, program: Program, calls: Sequence[str]) -> str:
    head = [f"; {line}" for line in head_lines(program)]
    return "\n".join([*HEAD, f"DEF {name}()", *head, *(f"{call}()" for call in calls), "END", ""])


MAIN = MainForm(".src", 22, _format_main)
