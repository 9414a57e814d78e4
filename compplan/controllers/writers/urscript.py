"""Universal Robots URScript: joint moves (movej), and lines and arcs (movel, movec) in the part frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.frames import rotation_vectors
from compplan.controllers.writers.language import ProgramForm, ProgramPart, need_six_axes
from compplan.controllers.writers.program import Program, joint_shares
from compplan.controllers.writers.zones import ZONES
from compplan.io.tables import Array

name = "urscript"
#: Command that sets the load: controllers of the e-Series deprecate the only one that CB3 has.
PAYLOAD = {"Universal Robots CB3": "set_payload"}
#: Accelerations, required by the language: its defaults. [rad/s^2, m/s^2]
JOINT_ACCELERATION, TOOL_ACCELERATION = 1.4, 1.2
RAPID_SHARE, UNKNOWN_SHARE, SLOWEST = 0.2, 0.1, 1e-5
#: A pose. [m, rad]
POSE = "p[{:.9f}, {:.9f}, {:.9f}, {:.9f}, {:.9f}, {:.9f}]"


def _state_poses(poses: Array) -> Array:
    """Return poses in URScript's notation: position [m] and rotation vector [rad]. Shape (n, 4, 4) -> (n, 6)."""
    return np.asarray(np.round(np.column_stack([poses[:, :3, 3], rotation_vectors(poses)]), 9) + 0.0, np.float64)


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME.script with joint moves and, where poses are known, NAME_L.script with linear ones.

    Long ones are divided into NAME_1.script and so on, each an independent program, to be run in order. Each calls
    itself at its end, so that a script that is sent to the controller runs. Positions refer to the part frame
    (pose_trans). The controller has no configuration words: linear moves keep the branch of the joint move before them.
    """
    need_six_axes(program, "URScript", sliding=0)
    return FORM.write(program, folder, most, can=True)


def _format_part(part: ProgramPart) -> dict[str, str]:
    program, load = part.program, ""
    if program.mass is not None:
        centre = ", ".join(f"{value:.6f}" for value in np.round(program.centre, 6) + 0.0)
        load = f"{program.mass:.3f}, [{centre}]"
    tool, base = _state_poses(np.stack([program.tool, program.base_frame])).tolist()
    text = part.render(
        "urscript", tool=POSE.format(*tool), base=POSE.format(*base), load=load,
        set_payload=PAYLOAD.get(program.controller, "set_target_payload"), moves=_format_moves(part),
    )  # fmt: skip
    return {f"{part.name}.script": text}


def _format_moves(part: ProgramPart) -> list[str]:
    program, lines = part.program, []
    speeds, radii = _joint_speeds(program), _blend_radii(part)
    for move in part.moves:
        end = f", r={radii[move.row]:.7f})" if radii[move.row] > 0.0 else ")"
        note = ["# the configuration changes: a joint move"] if move.swings else []
        if move.kind == "joint":
            target = ", ".join(f"{value:.9f}" for value in np.radians(program.joints[move.row]))
            lines.append([*note, f"movej([{target}], a={JOINT_ACCELERATION}, v={speeds[move.row]:.6f}{end}"])
            continue
        speed = max(move.feed * 1e-3, SLOWEST)
        target = f"pose_trans(part, {POSE.format(*move.place)}), a={TOOL_ACCELERATION}, v={speed:.6f}"
        cam = program.write_comment_line(move.row, "#")
        if move.via:
            via, arc_end = POSE.format(*move.via), end.replace(")", ", mode=0)")
            lines.append([f"movec(pose_trans(part, {via}), {target}{arc_end}{cam}"])
        else:
            lines.append([f"movel({target}{end}{cam}"])
    return part.merge_events(lines, "  ")


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


def _blend_radii(part: ProgramPart) -> Array:
    """Return the blend radius of each waypoint; 0 where it is reached exactly. Shape (n,). [m]"""
    program, zone = part.program, ZONES["urscript"]
    step = np.linalg.norm(np.diff(program.tcp[:, :3, 3], axis=0), axis=1)
    room = np.minimum(np.append(np.inf, step), np.append(step, np.inf))
    radius = np.minimum(zone.size, zone.share * room)
    stated = np.array([move.zone for move in part.every])
    radius = np.where(program.corners, stated, np.minimum(radius, stated)) if part.linear else radius
    return np.where([move.stops for move in part.every], 0.0, radius)


FORM = ProgramForm.load("urscript", _state_poses, _format_part)
