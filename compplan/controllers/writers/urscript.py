"""Universal Robots URScript: joint moves (movej), and lines and arcs (movel, movec) in the part frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.frames import rotation_vectors
from compplan.controllers.writers.language import need_six_axes
from compplan.controllers.writers.machine import Phrases, phrase_events
from compplan.controllers.writers.post import CellWords, check_cell, name_kind, name_main, render_post
from compplan.controllers.writers.program import Program, head_lines, joint_shares, name_parts
from compplan.controllers.writers.text import legal_name
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.io.tables import Array, write_text

name = "urscript"
BRAND = "Universal Robots"
#: What sets the load: controllers of the e-Series deprecate what CB3 alone knows.
PAYLOAD = {"Universal Robots CB3": "set_payload"}
#: Points in a program where the job says nothing.
MOST = 2000
LONGEST_NAME = 40
CELL = CellWords(str, str)
RESERVED = frozenset(
    {"def", "end", "if", "elif", "else", "while", "for", "return", "global", "local", "thread", "run", "join", "halt",
     "and", "or", "not", "xor", "true", "false", "none", "break", "continue", "sec", "part", "pass", "struct"}
)  # fmt: skip
#: Rounding of corners within a cut, and its greatest share of the way to a neighbour.
BLEND, BLEND_SHARE = 1e-4, 0.4
#: Accelerations, which the language wants stated: its own defaults. [rad/s^2, m/s^2]
JOINT_ACCELERATION, TOOL_ACCELERATION = 1.4, 1.2
RAPID_SHARE, UNKNOWN_SHARE, SLOWEST = 0.2, 0.1, 1e-5


def _ask(task: str) -> str:
    return f'popup("{task}", title="compplan", blocking=True)'


PHRASES = Phrases(
    say=lambda text: [f"# {text}"],
    switch=lambda signal, on: [f"set_standard_digital_out({signal}, {on})"],
    wait=lambda seconds: [f"sleep({seconds:.3f})"],
    expect=lambda signal: [f"while (not get_standard_digital_in({signal})):", "  sync()", "end"],
    pause=lambda task: [_ask(task)],
    pause_if=lambda signal, task: [f"if (get_standard_digital_in({signal})):", f"  {_ask(task)}", "end"],
    call=lambda name, number: [f"{name}({number:.0f})"],
)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.script with joint moves and, where poses are known, NAME_L.script with linear ones.

    A program calls itself behind its end, so that a script that is sent to the controller runs.
    Long ones are cut into NAME_1.script and so on, each a program of its own, to be run in order. Positions count from
    the part frame through pose_trans; they are in m and rotation vectors, joints in rad. Rapid moves and swings are
    joint moves at 20 % of the joint rates. The controller has no configuration words: linear moves keep the branch of
    the joint move before them.
    """
    need_six_axes(program, "URScript", sliding=0)
    name = legal_name(name_main(program), LONGEST_NAME, reserved=RESERVED)
    can, files = program.tcp is not None, []
    if program.writes_joints(linear=can):
        files += _write_kind(program, folder, name, most, linear=False)
    if can and program.form != "joint":
        files += _write_kind(fit_moves(program).program, folder, f"{name}{name_kind(program, '_L')}", most, linear=True)
    return files


def _write_kind(program: Program, folder: Path, name: str, most: int | None, *, linear: bool) -> list[Path]:
    moves = _moves(program, linear)
    for row, lines in phrase_events(program.events, program.wiring, PHRASES, "URScript").items():
        text = "\n".join(f"  {line}" for line in lines)
        moves[max(row, 0)] = f"{text}\n{moves[0]}" if row < 0 else f"{moves[row]}\n{text}"
    files, load = [], ""
    if program.mass is not None:
        centre = ", ".join(f"{value:.6f}" for value in np.round(program.centre, 6) + 0.0)
        load = f"{program.mass:.3f}, [{centre}]"
    for part, rows in name_parts(name, len(program), most or MOST, single=True).items():
        words = {
            "name": part, "comments": head_lines(program), "cell": check_cell(program.post, CELL, "URScript"),
            "tool": _poses((np.eye(4) if program.tool is None else program.tool)[None])[0], "load": load,
            "set_payload": PAYLOAD.get(program.controller, "set_target_payload"),
            "base": _poses(program.base_frame[None])[0], "first": rows.start == 0, "last": rows.stop == len(program),
            "moves": moves[rows],
        }  # fmt: skip
        files.append(folder / f"{part}.script")
        write_text(files[-1], render_post(program, "urscript", words))
    return files


def _moves(program: Program, linear: bool) -> list[str]:
    alone, swings = program.alone(linear=linear).tolist(), program.swings.tolist()
    speeds, radii = _joint_speeds(program), _blend_radii(program, linear)
    poses = _poses(program.positions) if linear else []
    via, arcs = program.via_positions, program.arcs.tolist()
    moves = []
    for row, joints in enumerate(np.radians(program.joints).tolist()):
        end = f", r={radii[row]:.7f})" if radii[row] > 0.0 else ")"
        if linear and not alone[row]:
            feed, cam = max(program.feed[row] * 1e-3, SLOWEST), program.write_comment_line(row, "#")
            target, how = f"pose_trans(part, {poses[row]})", f"a={TOOL_ACCELERATION}, v={feed:.6f}"
            if arcs[row]:
                middle = f"pose_trans(part, {_poses(via[row][None])[0]})"
                moves.append(f"  movec({middle}, {target}, {how}{end.replace(')', ', mode=0)')}{cam}")
            else:
                moves.append(f"  movel({target}, {how}{end}{cam}")
            continue
        note = "  # the configuration changes: a joint move\n" if linear and swings[row] else ""
        target = ", ".join(f"{value:.9f}" for value in joints)
        moves.append(f"{note}  movej([{target}], a={JOINT_ACCELERATION}, v={speeds[row]:.6f}{end}")
    return moves


def _joint_speeds(program: Program) -> Array:
    """Return the rate of the leading joint in each move. Shape (n,) [rad/s]."""
    rates = np.full(program.joints.shape[1], 60.0) if program.rates is None else program.rates
    turned = np.abs(np.diff(program.joints, axis=0, prepend=program.joints[:1]))
    deciding = np.argmax(turned / rates, axis=1)
    leading = turned.max(axis=1)
    share = joint_shares(program)
    at_share = np.where(np.isfinite(share), share, UNKNOWN_SHARE) * rates[deciding]
    ratio = np.divide(leading, turned[np.arange(len(program)), deciding], out=np.ones(len(program)), where=leading > 0)
    speeds = np.where(program.rapid, RAPID_SHARE * rates.min(), at_share * ratio)
    return np.maximum(np.radians(speeds), SLOWEST)


def _blend_radii(program: Program, linear: bool) -> Array:
    """Return how far before each waypoint its corner may be rounded; 0 where it is reached exactly. Shape (n,) [m]."""
    if program.tcp is None:
        return np.zeros(len(program))
    step = np.linalg.norm(np.diff(program.tcp[:, :3, 3], axis=0), axis=1)
    room = np.minimum(np.append(np.inf, step), np.append(step, np.inf))
    radius = np.minimum(BLEND, BLEND_SHARE * room)
    if linear:
        stated = find_zones(program, ZONES["urscript"])[1]
        radius = np.where(program.corners, stated, np.minimum(radius, stated))
    return np.where(program.stops(linear=linear), 0.0, radius)


def _poses(poses: Array) -> list[str]:
    table = np.round(np.column_stack([poses[:, :3, 3], rotation_vectors(poses)]), 9) + 0.0
    return ["p[" + ", ".join(f"{value:.9f}" for value in row) + "]" for row in table.tolist()]
