"""Staubli VAL3: project folders with joint motions, and with linear motions in the part frame."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import place_numbers, place_table
from compplan.controllers.writers.machine import Phrases, Signal, name_signal, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import Program, head_lines, name_parts
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.errors import InputError
from compplan.io.tables import Array, write_text

name = "val3"
BRAND = "Staubli"
#: Points in an array where the job says nothing.
MOST = 5000
LONGEST_NAME = 28
CELL = CellWords(None, None)
LOCALS = ("l_nIndex", "l_nKey")
PROJECT = "http://www.staubli.com/robotics/VAL3/Project/3"
PROGRAM = "http://www.staubli.com/robotics/VAL3/Program/2"
DATA = "http://www.staubli.com/robotics/VAL3/Data/2"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
HEADER = '<?xml version="1.0" encoding="utf-8"?>\n'
#: Words of a point's configuration, and the word that keeps the one at hand.
WORDS = {
    "shoulder": ({"righty", "lefty"}, "ssame"),
    "elbow": ({"epositive", "enegative"}, "esame"),
    "wrist": ({"wpositive", "wnegative"}, "wsame"),
}


def _ask(task: str) -> list[str]:
    return ["userPage()", f'putln("{task}, then press a key")', "l_nKey=get()"]


def _switch(signal: Signal, on: bool) -> list[str]:
    return [f"{name_signal(signal, 'doOut')}={'true' if on else 'false'}"]


#: Signals are data of the project: they have to be linked to the cell's.
PHRASES = Phrases(
    say=lambda text: [f"// {text}"],
    switch=_switch,
    wait=lambda seconds: [f"delay({seconds:.3f})"],
    expect=lambda signal: [f"wait({name_signal(signal, 'diIn')}==true)"],
    pause=_ask,
    pause_if=lambda signal, task: [f"if {name_signal(signal, 'diIn')}==true", *_ask(task), "endIf"],
    call=lambda name, number: [f"call {name}({number:.0f})"],
    named=True,
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write the project NAME with joint motions and, where poses are known, NAME_L with linear ones.

    A project holds NAME.pjx, its data (.dtx) and programs (.pgx): start, stop, and one a part. movej runs through joint
    positions, movel through points in the part frame, no faster along the path than the feed. Rapid moves and swings
    are joint motions at 20 % of the joint rates and stop at their end.
    """
    if program.joints.shape[1] != 6 or program.prismatic.any():
        message = f"VAL3 programs are written for six rotating joints, this robot has {list(program.joint_names)}"
        raise InputError(message)
    name = legal_name(name_main(program), LONGEST_NAME)
    can, files = program.tcp is not None, []
    if program.writes_joints(linear=can):
        files += _write_kind(program, folder / name, most, linear=False)
    if can and program.form != "joint":
        name += name_kind(program, "_L")
        files += _write_kind(fit_moves(program).program, folder / name, most, linear=True)
    return files


def _write_kind(program: Program, project: Path, most: int | None, *, linear: bool) -> list[Path]:
    name = project.name
    parts = name_parts("part", len(program), most or MOST, between="")
    texts = {f"{name}.pjx": _project(name, [*parts]), f"{name}.dtx": _data(program, [*parts.values()], linear)}
    events = phrase_events(program.events, program.wiring, PHRASES, "VAL3")
    for number, (part, rows) in enumerate(parts.items(), start=1):
        code = _plain_moves(program, number, rows, events) if linear else _moves(number, rows, events)
        texts[f"{part}.pgx"] = _program(part, code)
    check_cell(program.post, CELL, "VAL3")
    body = render_post(program, "val3", {"name": name, "parts": [*parts], "comments": _remarks(program, linear)})
    texts["start.pgx"] = _program("start", body)
    texts["stop.pgx"] = _program("stop", "  resetMotion()\n")
    files = []
    for file, text in texts.items():
        files.append(project / file)
        write_text(files[-1], text)
    return files


def _remarks(program: Program, linear: bool) -> list[str]:
    swings = np.flatnonzero(program.swings)[:10].tolist() if linear else []
    load = [] if program.mass is None else [f"mass of the tool {program.mass:.3f} kg: set it in the arm's load data"]
    notes = [f"waypoint {row}: the configuration changes, a joint move leads there" for row in swings]
    return [*head_lines(program), *load, *notes]


def _project(name: str, parts: list[str]) -> str:
    programs = "".join(f'    <Program file="{part}.pgx" />\n' for part in ("start", "stop", *parts))
    return (
        f'{HEADER}<Project xmlns="{PROJECT}">\n'
        '  <Parameters version="s7.3.1" stackSize="5000" millimeterUnit="true" />\n'
        f"  <Programs>\n{programs}  </Programs>\n"
        f"  <Database>\n    <Data file={quoteattr(name + '.dtx')} />\n  </Database>\n"
        "  <Libraries />\n</Project>\n"
    )


def _program(name: str, code: str) -> str:
    used = [word for word in LOCALS if word in code]
    lines = [f'      <Local name="{word}" type="num" xsi:type="array" size="1" />\n' for word in used]
    declared = f"    <Locals>\n{''.join(lines)}    </Locals>\n" if used else ""
    return (
        f'{HEADER}<Programs xmlns:xsi="{INSTANCE}" xmlns="{PROGRAM}">\n'
        f'  <Program name="{name}" access="public">\n{declared}'
        f"    <Code><![CDATA[begin\n{code}end]]></Code>\n  </Program>\n</Programs>\n"
    )


def _plain_moves(program: Program, number: int, rows: slice, events: dict[int, list[str]]) -> str:
    """Return plain motion lines of a part: lines and arcs of the tool, joint moves where they stand alone."""
    alone, stops, arcs = program.alone(linear=True).tolist(), program.stops(linear=True).tolist(), program.arcs.tolist()
    lines = _wait_for(events.get(-1, []) if rows.start == 0 else [])
    speeds, zone = dict[str, str](), f"{1e3 * ZONES['val3'].size:g}"
    whole, zones = zone, 1e3 * find_zones(program, ZONES["val3"])[1]
    quick = through = 0
    for index, row in enumerate(range(rows.start, rows.stop)):
        if alone[row]:
            lines += [f"  movej(jPath{number}[{quick}],tTool,mRapid)", "  waitEndMove()"]
            quick += 1
        else:
            how, speed = "mEnd" if stops[row] else "mPath", f"{program.feed[row]:.4f}"
            lines += [f"  {how}.tvel={speed}"] if speeds.get(how) != speed else []
            speeds[how] = speed
            space = zone if stops[row] else whole if np.isinf(zones[row]) else f"{zones[row]:.3f}"
            lines += [f"  mPath.{word}={space}" for word in ("leave", "reach")] if space != zone else []
            zone = space
            target = f"pPath{number}[{index}],tTool,{how})"
            lines.append(f"  movec(pVia{number}[{through}],{target}" if arcs[row] else f"  movel({target}")
            through += arcs[row]
        lines += _wait_for(events.get(row, []))
    return "\n".join([*lines, ""])


def _wait_for(lines: list[str]) -> list[str]:
    acts = any(not line.startswith("//") for line in lines)
    return [f"  {line}" for line in ["waitEndMove()"] * acts + lines]


def _moves(number: int, rows: slice, events: dict[int, list[str]]) -> str:
    """Return loops over the points of a part, cut where something happens beside motion: once the arm stands there."""
    body = (
        f"    if nFeed{number}[l_nIndex]>0\n"
        f"      if nExact{number}[l_nIndex]>0\n"
        f"        mEnd.tvel=nFeed{number}[l_nIndex]\n"
        f"        movej(jPath{number}[l_nIndex],tTool,mEnd)\n"
        "      else\n"
        f"        mPath.tvel=nFeed{number}[l_nIndex]\n"
        f"        movej(jPath{number}[l_nIndex],tTool,mPath)\n"
        "      endIf\n"
        "    else\n"
        f"      movej(jPath{number}[l_nIndex],tTool,mRapid)\n"
        "      waitEndMove()\n"
        "    endIf\n"
        "  endFor\n"
    )
    text = f"  // waypoints {rows.start} to {rows.stop - 1}\n"
    text += "".join(f"  {line}\n" for line in events.get(-1, [])) if rows.start == 0 else ""
    first = rows.start
    for row in [*sorted(row for row in events if rows.start <= row < rows.stop - 1), rows.stop - 1]:
        text += f"  for l_nIndex={first - rows.start} to {row - rows.start}\n{body}"
        acts = any(not line.startswith("//") for line in events.get(row, []))
        text += "".join(f"  {line}\n" for line in ["waitEndMove()"] * acts + events.get(row, []))
        first = row + 1
    return text


def _signals(program: Program) -> list[str]:
    """Return the digital inputs and outputs that the programs use, as data of the project."""
    wiring = program.wiring
    outputs = [wiring.spindle, wiring.coolant, *wiring.signals.values()]
    inputs = [wiring.spindle_ready, wiring.optional_stop]
    names = [name_signal(signal, "doOut") for signal in outputs if signal is not None]
    names += [name_signal(signal, "diIn") for signal in inputs if signal is not None]
    used = dict.fromkeys(names) if program.events else {}
    return [line for name in used for line in _array(name, "dio", ['link=""'])]


def _data(program: Program, parts: list[slice], linear: bool) -> str:
    """Return the .dtx file: points, feeds, tool, part frame and three motion descriptors."""
    tool = np.eye(4) if program.tool is None else program.tool
    limits = 'tmax="99999" rmax="99999"'
    full = f'accel="100" vel="100" decel="100" {limits}'
    descriptors = {
        "mPath": f'{full} blend="joint" leave="0.1" reach="0.1"',
        "mEnd": f'{full} blend="off" leave="0" reach="0"',
        "mRapid": f'accel="50" vel="20" decel="50" {limits} blend="off" leave="0" reach="0"',
    }
    lines = [f'{HEADER}<Database xmlns:xsi="{INSTANCE}" xmlns="{DATA}">', "  <Datas>"]
    lines += _array("tTool", "tool", [f'{_place(place_numbers(tool, "XYZ"))} fatherId="flange[0]"'])
    lines += _array("fPart", "frame", [f'{_place(place_numbers(program.base_frame, "XYZ"))} fatherId="world[0]"'])
    for name, text in descriptors.items():
        lines += _array(name, "mdesc", [text])
    points = _points(program, program.positions) if linear else []
    via = _points(program, program.via_positions) if linear and program.arcs.any() else []
    chosen = program.alone(linear=True) if linear else np.ones(len(program), bool)
    form = " ".join(f'j{index}="%.6f"' for index in range(1, program.joints.shape[1] + 1))
    for number, rows in enumerate(parts, start=1):
        joints = [form % tuple(row) for row in program.joints[rows][chosen[rows]].tolist()]
        lines += _array(f"jPath{number}", "jointRx", joints) if joints else []
        if linear:
            lines += _array(f"pPath{number}", "pointRx", points[rows])
            through = [via[row] for row in np.flatnonzero(program.arcs[rows]) + rows.start]
            lines += _array(f"pVia{number}", "pointRx", through) if through else []
            continue
        feeds, stops = np.where(program.rapid, 0.0, program.feed)[rows], program.stops(linear=False)[rows]
        lines += _array(f"nFeed{number}", "num", [f'value="{feed:.4f}"' for feed in feeds])
        lines += _array(f"nExact{number}", "num", [f'value="{int(stop)}"' for stop in stops])
    return "\n".join([*lines, *_signals(program), "  </Datas>", "</Database>", ""])


def _array(name: str, kind: str, values: list[str]) -> list[str]:
    head = f'    <Data name="{name}" access="public" xsi:type="array" type="{kind}" size="{len(values)}">'
    return [head, *(f'      <Value key="{key}" {value} />' for key, value in enumerate(values)), "    </Data>"]


def _place(values: list[float]) -> str:
    names = ("x", "y", "z", "rx", "ry", "rz")
    return " ".join(f'{name}="{value:.7f}"' for name, value in zip(names, values, strict=True))


def _points(program: Program, poses: Array) -> list[str]:
    """Return points in the part frame with their configuration, in the controller's words where they are known."""
    table, posed = np.zeros((len(poses), 6)), np.isfinite(poses[:, 0, 0])
    table[posed] = place_table(poses[posed], "XYZ")
    words: list[Array] = []
    for key, (known, same) in WORDS.items():
        native = program.native.get(key, np.full(len(program), same))
        words.append(native if {*native.tolist()} <= known else np.full(len(program), same))
    form = 'x="%.5f" y="%.5f" z="%.5f" rx="%.6f" ry="%.6f" rz="%.6f" '
    form += "".join(f'{key}="%s" ' for key in WORDS) + 'fatherId="fPart[0]"'
    named = zip(*(values.tolist() for values in words), strict=True)
    return [form % (*place, *own) for place, own in zip(table.tolist(), named, strict=True)]
