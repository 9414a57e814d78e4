"""Staubli VAL3: a project folder with joint motions."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.program.program import Program, head_lines, short_name, split_parts, tool_place

#: Points in an array where the job says nothing.
MOST = 5000
PROJECT = "http://www.staubli.com/robotics/VAL3/Project/3"
PROGRAM = "http://www.staubli.com/robotics/VAL3/Program/2"
DATA = "http://www.staubli.com/robotics/VAL3/Data/2"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
HEADER = '<?xml version="1.0" encoding="utf-8"?>\n'


def write_val3(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write the project NAME/NAME.pjx with its data (.dtx) and programs (.pgx): start, stop, and one a part.

    Each waypoint is a joint position; movej runs through them, no faster along the path than the feed. Rapid moves run
    at 20 % of the joint rates and stop at their end.

    Args:
        program: The program, of an arm with six rotating joints.
        folder: Folder that the project folder is written to.
        most: Greatest number of points in an array.

    Raises:
        InputError: If the robot has not six rotating joints.

    """
    if program.joints.shape[1] != 6 or program.prismatic.any():
        message = f"VAL3 programs are written for six rotating joints, this robot has {list(program.joint_names)}"
        raise InputError(message)
    name = short_name(program.name, 30)
    project = folder / name
    parts = split_parts(len(program), most or MOST)
    names = [f"part{number}" for number in range(1, len(parts) + 1)]
    texts = {f"{name}.pjx": _project(name, names), f"{name}.dtx": _data(program, parts)}
    for number, (part, rows) in enumerate(zip(names, parts, strict=True), start=1):
        texts[f"{part}.pgx"] = _program(part, _moves(number, rows), local=True)
    calls = "".join(f"  call {part}()\n" for part in names)
    comments = "".join(f"  // {line}\n" for line in head_lines(program))
    texts["start.pgx"] = _program("start", f"{comments}  resetMotion()\n{calls}  waitEndMove()\n")
    texts["stop.pgx"] = _program("stop", "  resetMotion()\n")
    files = []
    for file, text in texts.items():
        files.append(project / file)
        write_text(files[-1], text)
    return files


def _project(name: str, parts: list[str]) -> str:
    programs = "".join(f'    <Program file="{part}.pgx" />\n' for part in ("start", "stop", *parts))
    return (
        f'{HEADER}<Project xmlns="{PROJECT}">\n'
        '  <Parameters version="s7.3.1" stackSize="5000" millimeterUnit="true" />\n'
        f"  <Programs>\n{programs}  </Programs>\n"
        f"  <Database>\n    <Data file={quoteattr(name + '.dtx')} />\n  </Database>\n"
        "  <Libraries />\n</Project>\n"
    )


def _program(name: str, code: str, *, local: bool = False) -> str:
    counter = '    <Locals>\n      <Local name="l_nIndex" type="num" xsi:type="array" size="1" />\n    </Locals>\n'
    return (
        f'{HEADER}<Programs xmlns:xsi="{INSTANCE}" xmlns="{PROGRAM}">\n'
        f'  <Program name="{name}" access="public">\n{counter if local else ""}'
        f"    <Code><![CDATA[begin\n{code}end]]></Code>\n  </Program>\n</Programs>\n"
    )


def _moves(number: int, rows: slice) -> str:
    return (
        f"  // waypoints {rows.start} to {rows.stop - 1}\n"
        f"  for l_nIndex=0 to {rows.stop - rows.start - 1}\n"
        f"    if nFeed{number}[l_nIndex]>0\n"
        f"      mPath.tvel=nFeed{number}[l_nIndex]\n"
        f"      movej(jPath{number}[l_nIndex],tTool,mPath)\n"
        "    else\n"
        f"      movej(jPath{number}[l_nIndex],tTool,mRapid)\n"
        "      waitEndMove()\n"
        "    endIf\n"
        "  endFor\n"
    )


def _data(program: Program, parts: list[slice]) -> str:
    """Return the .dtx file: points, feeds, the tool and two motion descriptors."""
    x, y, z, rx, ry, rz = tool_place(program, "XYZ")
    place = f'x="{x:.5f}" y="{y:.5f}" z="{z:.5f}" rx="{rx:.5f}" ry="{ry:.5f}" rz="{rz:.5f}"'
    limits = 'tmax="99999" rmax="99999"'
    lines = [
        f'{HEADER}<Database xmlns:xsi="{INSTANCE}" xmlns="{DATA}">',
        "  <Datas>",
        '    <Data name="tTool" access="public" xsi:type="array" type="tool" size="1">',
        f'      <Value key="0" {place} fatherId="flange[0]" />',
        "    </Data>",
        '    <Data name="mPath" access="public" xsi:type="array" type="mdesc" size="1">',
        f'      <Value key="0" accel="100" vel="100" decel="100" {limits} blend="joint" leave="0.1" reach="0.1" />',
        "    </Data>",
        '    <Data name="mRapid" access="public" xsi:type="array" type="mdesc" size="1">',
        f'      <Value key="0" accel="50" vel="20" decel="50" {limits} blend="off" leave="0" reach="0" />',
        "    </Data>",
    ]
    for number, rows in enumerate(parts, start=1):
        count = rows.stop - rows.start
        lines.append(f'    <Data name="jPath{number}" access="public" xsi:type="array" type="jointRx" size="{count}">')
        for key, joints in enumerate(program.joints[rows].tolist()):
            values = " ".join(f'j{index}="{value:.6f}"' for index, value in enumerate(joints, start=1))
            lines.append(f'      <Value key="{key}" {values} />')
        lines.append("    </Data>")
        lines.append(f'    <Data name="nFeed{number}" access="public" xsi:type="array" type="num" size="{count}">')
        feeds = np.where(program.rapid, 0.0, program.feed)[rows].tolist()
        lines += [f'      <Value key="{key}" value="{feed:.4f}" />' for key, feed in enumerate(feeds)]
        lines.append("    </Data>")
    return "\n".join([*lines, "  </Datas>", "</Database>", ""])
