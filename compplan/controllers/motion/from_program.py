"""The moves of a written program as a controller follows them: lines and arcs, each with the zone of its language."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.motion.geometry import Nodes
from compplan.controllers.motion.instructions import Instructions
from compplan.controllers.shapes import MoveArc, find_arc
from compplan.controllers.writers.fit import Fitted
from compplan.controllers.writers.zones import FASTEST, mark_moves
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import Arm, refine_ik


def build_moves(fitted: Fitted, q: Array, arm: Arm, zones: Array) -> tuple[Nodes, NDArray[np.int_]]:
    """Return where the moves of a fitted program end, as the geometry that the controller believes has them.

    Moves that lead nowhere are left out; a controller reads past them.

    Args:
        fitted: The program at the ends of its moves.
        q: Commanded joints of the whole program. Shape (n, nq). [rad or m]
        arm: The robot as its controller believes it.
        zones: How far before the end of each move the controller may leave the path. Shape (k,). [m]

    Returns:
        The moves, and the row of the whole program at the end of each. Shape (m,).
    """
    program = fitted.program
    alone, moves = program.alone(linear=True), mark_moves(program)
    rows, alone, feeds = fitted.rows[moves], alone[moves], program.feed[moves]
    posture, n, corners = q[rows], len(rows), np.flatnonzero(program.corners[moves])
    if len(corners):  # rows that state a corner hold the tool there, not where the corner is rounded
        assert program.tcp is not None
        tcp = program.tcp[moves][corners]
        posture[corners] = refine_ik(arm, posture[corners], tcp[:, :3, 3], tcp[:, :3, :3])
    frames = locate_frames(arm.chain, posture)
    position = frames.tcp_position
    length = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
    arcs: dict[int, MoveArc] = {}
    for k in np.flatnonzero(program.arcs[moves] & ~alone).tolist():
        assert program.via is not None
        arc = find_arc(position[k - 1], program.via[moves][k, :3, 3], position[k])
        if arc is not None:
            arcs[k], length[k] = arc, arc.length
    feed = np.where(alone | (feeds <= 0.0), FASTEST, 1e-3 * feeds)
    instructions = Instructions(
        Path(program.name), np.arange(n), ~alone, position, -frames.tcp_rotation[:, :, 2], posture, feed, zones[moves]
    )
    return Nodes(instructions, posture, position, frames.tcp_rotation, length, arcs), rows
