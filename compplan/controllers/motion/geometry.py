"""Path of a program's instructions: lines, arcs and joint moves, with a parabola in every zone.

A blend at a corner leaves the incoming move a distance r before the corner and joins the outgoing one r after it. With
w from 0 to 1 it is  p = p_c + (p_in(w) - p_c) + (p_out(w) - p_c),  p_in on the incoming move (1 - w)^2 r before the
corner, p_out on the outgoing one w^2 r after it. It is tangent to both; between lines, its distance from the corner is
half of that of a straight cut. r is the zone times `blend_share`, at most half of either move. Lines and arcs blend in
space, corners at a joint move blend in joint space. Assumed for every make.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as File

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.controllers.motion.instructions import Instructions, mark_whole
from compplan.controllers.shapes import find_arc
from compplan.controllers.writers.fit import Fitted
from compplan.controllers.writers.zones import FASTEST, mark_moves
from compplan.errors import InfeasibleError, InputError
from compplan.robot import Array
from compplan.statics.chain import Chain, locate_frames
from compplan.statics.ik import Arm, middle_of_limits, pose_error, refine_ik, solve_branches
from compplan.toolpath.contact import turn_about_axis
from compplan.toolpath.readers.arcs import Arc

#: Step between points of a path, and points of a blend. [m]
STEP, BLEND_POINTS = 1e-3, 12
#: Fewest and most points of a move.
FEWEST, MOST = 4, 3000
#: Path length per rotation of a joint, so that a pure rotation has a length, too. [m/rad]
TURN = 1e-4
#: Greatest step of a joint between two points of a line; a larger one is a change of branch. [rad]
JUMP = 0.35
#: Pose error above which a pose is out of reach. [m and rad]
MISSED = 1e-7


@dataclass(frozen=True)
class Nodes:
    """Ends of the moves of a program."""

    instructions: Instructions  #: The instructions.
    q: Array  #: Joints at the end of each move. Shape (n, nq). [rad or m]
    position: Array  #: Tip there. Shape (n, 3). [m]
    rotation: Array  #: TCP frame there. Shape (n, 3, 3).
    length: Array  #: Path length of the tip to each end, 0 for the first. Shape (n,). [m]
    arcs: Mapping[int, Arc] = field(default_factory=dict)  #: Arcs among the moves, by index of the move.

    def along(self, move: NDArray[np.int_], share: Array) -> Array:
        """Return tip positions at shares of lines and arcs. Shape (k,) -> (k, 3). [m]"""
        start = self.position[np.maximum(move - 1, 0)]
        place: Array = start + share[:, None] * (self.position[move] - start)
        for number, arc in self.arcs.items():
            low, high = np.searchsorted(move, [number, number + 1])
            place[low:high] = arc.place(arc.sweep * share[low:high])
        return place


@dataclass(frozen=True)
class Path:
    """Points along a path, spaced closely enough for cubic interpolation."""

    s: Array  #: Length up to each point: tip path plus a small part per joint rotation. Shape (m,). [m]
    q: Array  #: Joints. Shape (m, nq). [rad or m]
    position: Array  #: Tip. Shape (m, 3). [m]
    feed: Array  #: Greatest speed in s from each point to the next, as programmed. Shape (m,). [m/s]
    stops: NDArray[np.int_]  #: Points at which the robot rests, ends included.
    before: Array  #: Slope dq/ds on arrival at each point. Shape (m, nq).
    after: Array  #: Slope on departure; differs from `before` at rests. Shape (m, nq).
    ends: Array  #: Length at the end of every move, its blend included. Shape (moves,). [m]

    @cached_property
    def bends(self) -> tuple[Array, Array, Array, Array]:
        """Norms of dq/ds, d2q/ds2, shape (m, nq), and of dp/ds, d2p/ds2 of the tip, shape (m,). [rad, m, 1/m]"""
        tip = np.gradient(self.position, self.s, axis=0)
        return (np.abs(0.5 * (self.before + self.after)), np.abs(np.gradient(self.after, self.s, axis=0)),
                np.linalg.norm(tip, axis=1), np.linalg.norm(np.gradient(tip, self.s, axis=0), axis=1))  # fmt: skip


def locate_nodes(instructions: Instructions, arm: Arm, start: Array | None = None) -> Nodes:
    """Compute the joints at the end of every instruction, each in the branch nearest to the one before.

    The first is nearest to `start`, shape (nq,) [rad or m], or by default to the middle of the limits.

    Raises:
        InputError: If an end is out of reach.
    """
    n = len(instructions)
    q = np.array(instructions.q)
    bent = mark_whole(q)
    given = locate_frames(arm.chain, np.where(bent[:, None], q, 0.0))
    posed = mark_whole(instructions.position)
    position = np.where(posed[:, None], instructions.position, given.tcp_position)
    rotation = np.array(given.tcp_rotation)
    for k in range(n):  # one instruction each; minimal rotation about the tool axis
        if k and not bent[k] and not bent[k - 1] and (instructions.axis[k] == instructions.axis[k - 1]).all():
            rotation[k] = rotation[k - 1]
        elif not bent[k]:
            rotation[k] = _turn_axis(rotation[k - 1] if k else _first_frame(instructions.axis[0]), instructions.axis[k])
        elif posed[k]:
            rotation[k] = _turn_axis(rotation[k], instructions.axis[k])
    need = np.flatnonzero(posed & ~(bent & ~instructions.straight))
    near = middle_of_limits(arm.robot) if start is None else start
    if len(need):
        _choose_branches(instructions, arm, q, (position, rotation), need, near)
    frames = locate_frames(arm.chain, q)
    position, rotation = frames.tcp_position, frames.tcp_rotation
    return Nodes(instructions, q, position, rotation, _measure_moves(instructions, arm.chain, q, position))


def _first_frame(axis: Array) -> Array:
    """Return a TCP frame on a tool axis with its x nearest to the base's x (assumed)."""
    return turn_about_axis(np.array([[1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0]]), axis[None])[0]


def _turn_axis(rotation: Array, axis: Array) -> Array:
    """Rotate a frame by the smallest angle that aligns its z with the reversed tool axis."""
    return np.asarray(Rotation.align_vectors(-axis, rotation[:, 2])[0].as_matrix() @ rotation)


def _choose_branches(
    instructions: Instructions, arm: Arm, q: Array, poses: tuple[Array, Array], need: NDArray[np.int_], near: Array
) -> None:
    """Fill in the joints of poses, each nearest to the given ones, or to those before."""
    held = np.tile(near[arm.held], (len(need), 1)) if len(arm.held) else None
    slots = solve_branches(arm, poses[0][need], poses[1][need], held)
    solved, given, row = mark_whole(slots.reshape(-1, q.shape[1])).reshape(slots.shape[:2]), mark_whole(q), -1
    full, lower, upper = ~arm.robot.prismatic * 2.0 * np.pi, arm.robot.lower, arm.robot.upper
    needed = np.isin(np.arange(len(q)), need).tolist()
    for k in range(len(q)):
        if needed[k]:
            row += 1
            target, found = q[k] if given[k] else near, slots[row][solved[row]]
            turned = found + np.round((target - found) / (2 * np.pi)) * full
            inside = (turned >= lower) & (turned <= upper)
            found = np.where(inside.all(axis=1)[:, None], turned, found)
            found = found[((found >= lower - 1e-9) & (found <= upper + 1e-9)).all(axis=1)]
            if not len(found):
                raise InputError("no joint positions within the limits reach this pose; move it into the workspace",
                                 file=instructions.file, where=int(instructions.lines[k]))  # fmt: skip
            q[k] = found[np.abs(found - target).max(axis=1).argmin()]
        near = q[k]


def _measure_moves(instructions: Instructions, chain: Chain, q: Array, position: Array) -> Array:
    length = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
    bent = np.flatnonzero(~instructions.straight)
    bent = bent[bent > 0]
    if len(bent):
        share = np.linspace(0.0, 1.0, 17)[:, None]
        between = (q[bent - 1][:, None] + share * (q[bent] - q[bent - 1])[:, None]).reshape(-1, q.shape[1])
        tip = locate_frames(chain, between).tcp_position.reshape(len(bent), 17, 3)
        length[bent] = np.linalg.norm(np.diff(tip, axis=1), axis=2).sum(axis=1)
    return length


def build_path(nodes: Nodes, arm: Arm, blend_share: float, spacing: float = STEP) -> Path:
    """Compute points along the executed path, without lag of the drives.

    Args:
        nodes: Ends of the moves.
        arm: The robot.
        blend_share: Ratio of a blend's length to its zone; 0 gives the programmed path itself.
        spacing: Approximate distance between two points. [m]

    Raises:
        InputError: If nothing moves.
        InfeasibleError: If a line cannot be followed in one branch.
    """
    length, n = nodes.length, len(nodes.length)
    reach = np.zeros(n)
    reach[1:-1] = np.minimum(blend_share * nodes.instructions.zone[1:-1], 0.5 * np.minimum(length[1:-1], length[2:]))
    reach[reach < 1e-6] = 0.0
    safe = np.maximum(length, 1e-12)
    leave, arrive = np.r_[0.0, reach[:-1] / safe[1:]], reach / safe  # shares of the move taken by blends
    move, share, corner = _lay_points(length, leave, arrive, reach, spacing)
    q = _solve_points(nodes, arm, (move, share, corner), (leave, arrive))
    position = locate_frames(arm.chain, q).tcp_position
    tip = np.linalg.norm(np.diff(position, axis=0), axis=1)
    step = tip + TURN * np.abs(np.diff(q, axis=0)).sum(axis=1)
    keep = np.r_[True, step > 1e-10]
    if keep.sum() < 2:
        source = nodes.instructions
        raise InputError("no row moves the tool, expected a move", file=source.file, where=int(source.lines[-1]))
    ends = np.flatnonzero((corner == 0) & (share == 1.0) & (reach[move] == 0.0))
    count = np.cumsum(keep) - 1
    stops = np.unique(np.r_[0, count[ends]])
    driven = np.where(corner & (share > 0.5), np.minimum(move + 1, n - 1), move)
    speed = nodes.instructions.feed[driven[1:]] * step / np.maximum(tip, 1e-12)
    s, q, position = np.r_[0.0, np.cumsum(step)][keep], q[keep], position[keep]
    feed = np.r_[speed[keep[1:]], np.inf]
    ends = s[count[np.searchsorted(move, np.arange(n), "right") - 1]]
    return Path(s, q, position, feed, stops, *_find_slopes(s, q, stops), ends)


def _lay_points(
    length: Array, leave: Array, arrive: Array, reach: Array, spacing: float
) -> tuple[NDArray[np.int_], Array, NDArray[np.bool_]]:
    """Return for every point its move (or corner), its share of it, and whether it is on a blend."""
    n = len(length)
    count = np.clip(np.ceil(length / spacing).astype(int), FEWEST, MOST)
    count[0] = 0
    move = np.repeat(np.arange(n), count + 1)
    place = np.arange(len(move)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    share = leave[move] + (1.0 - arrive[move] - leave[move]) * place / np.maximum(count[move], 1)
    share[(place == count[move]) & (reach[move] == 0.0)] = 1.0
    inner = np.arange(1, BLEND_POINTS) / BLEND_POINTS
    corners = np.flatnonzero(reach > 0.0)
    all_moves = np.r_[move, np.repeat(corners, len(inner))]
    all_shares = np.r_[share, np.tile(inner, len(corners))]
    blends = np.r_[np.zeros(len(move), bool), np.ones(len(corners) * len(inner), bool)]
    order = np.lexsort((all_shares, blends, all_moves))
    return all_moves[order], all_shares[order], blends[order]


def _solve_points(
    nodes: Nodes, arm: Arm, points: tuple[NDArray[np.int_], Array, NDArray[np.bool_]], trims: tuple[Array, Array]
) -> Array:
    """Return the joints of every point."""
    move, share, corner = points
    leave, arrive = trims
    n, lines = len(nodes.length), nodes.instructions.straight
    before, after = np.maximum(move - 1, 0), np.minimum(move + 1, n - 1)
    here = nodes.q[move]
    back, ahead = nodes.q[before] - here, nodes.q[after] - here
    into = np.where(corner, (1.0 - share) ** 2 * arrive[move], 1.0 - share)[:, None]
    out = np.where(corner, share**2 * leave[after], 0.0)[:, None]
    q = here + into * back + out * ahead
    straight = lines[move] & (move > 0) & (~corner | lines[after])
    rows = np.flatnonzero(straight)
    if len(rows):
        m = move[rows]
        p = nodes.along(m, 1.0 - into[rows, 0])
        bent = np.flatnonzero(corner[rows])
        p[bent] += nodes.along(after[rows][bent], out[rows[bent], 0]) - nodes.position[m[bent]]
        turned = np.swapaxes(nodes.rotation, 1, 2)
        back_turn = Rotation.from_matrix(turned @ nodes.rotation[np.maximum(np.arange(n) - 1, 0)]).as_rotvec()
        ahead_turn = Rotation.from_matrix(turned @ nodes.rotation[np.minimum(np.arange(n) + 1, n - 1)]).as_rotvec()
        turn = Rotation.from_rotvec(into[rows] * back_turn[m] + out[rows] * ahead_turn[m]).as_matrix()
        rotation = nodes.rotation[m] @ turn
        q[rows] = refine_ik(arm, q[rows], p, rotation, iterations=40)
        missed = np.abs(pose_error(arm.chain, q[rows], p, rotation)).max(axis=1) > MISSED
        _refuse(nodes, m[missed], "cannot be followed along a line: a point of it is out of reach")
    _blend_joints(nodes, q, points, straight)
    gap = np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) > JUMP
    _refuse(nodes, move[1:][gap & straight[1:]], "cannot be followed along a line: the arm would change its branch")
    return q


def _blend_joints(
    nodes: Nodes, q: Array, points: tuple[NDArray[np.int_], Array, NDArray[np.bool_]], straight: NDArray[np.bool_]
) -> None:
    """Blend in joint space between a joint move and a line: from the last point before to the first one after."""
    move, share, corner = points
    rows = np.flatnonzero(corner & ~straight)
    if not len(rows):
        return
    last = np.searchsorted(move, move[rows], "right")  # first point of the next move
    plain = np.flatnonzero(~corner)
    entry = plain[np.searchsorted(plain, rows) - 1]
    leaving = np.minimum(last, len(move) - 1)
    w, here = share[rows, None], nodes.q[move[rows]]
    q[rows] = here + (1.0 - w) ** 2 * (q[entry] - here) + w**2 * (q[leaving] - here)


def _refuse(nodes: Nodes, moves: NDArray[np.int_], message: str) -> None:
    if len(moves):
        instructions = nodes.instructions
        line = int(instructions.lines[moves[0]])
        raise InfeasibleError(f"{instructions.file}:{line}: {message}; make it a joint move or divide it",
                              waypoints=sorted({int(move) for move in moves}))  # fmt: skip


def _find_slopes(s: Array, q: Array, stops: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return the slopes on either side of every point; they differ at rests."""
    slope = np.gradient(q, s, axis=0, edge_order=2 if len(s) > 2 else 1)
    chord = np.diff(q, axis=0) / np.diff(s)[:, None]
    before, after = slope.copy(), slope.copy()
    inner = stops[(stops > 0) & (stops < len(s) - 1)]
    before[inner], after[inner] = chord[inner - 1], chord[inner]
    return before, after


def follow_path(path: Path, s: Array) -> Array:
    """Return the joints at lengths of a path, by cubic interpolation. Shape (k,) -> (k, nq)."""
    s = np.clip(s, path.s[0], path.s[-1])
    i = np.clip(np.searchsorted(path.s, s, "right") - 1, 0, len(path.s) - 2)
    step = (path.s[i + 1] - path.s[i])[:, None]
    u = (s - path.s[i])[:, None] / step
    q = (1 + 2 * u) * (1 - u) ** 2 * path.q[i] + u**2 * (3 - 2 * u) * path.q[i + 1]
    return np.asarray(q + step * (u * (1 - u) ** 2 * path.after[i] - u**2 * (1 - u) * path.before[i + 1]))


def build_moves(fitted: Fitted, q: Array, arm: Arm, zones: Array) -> tuple[Nodes, NDArray[np.int_]]:
    """Return the ends of a fitted program's moves, by the controller's kinematic model.

    Moves of zero length are left out, because a controller skips them.

    Args:
        fitted: The program at the ends of its moves.
        q: Commanded joints of the complete program. Shape (n, nq). [rad or m]
        arm: The robot with the controller's kinematic model.
        zones: Distance before the end of each move at which the controller may leave the path. Shape (k,). [m]

    Returns:
        The moves, and the row of the complete program at the end of each. Shape (m,).
    """
    program = fitted.program
    alone, moves = program.alone(linear=True), mark_moves(program)
    rows, alone, feeds = fitted.rows[moves], alone[moves], program.feed[moves]
    posture, n, corners = q[rows], len(rows), np.flatnonzero(program.corners[moves])
    if len(corners):  # corner rows: place the tool at the corner, not on its rounding
        assert program.tcp is not None
        tcp = program.tcp[moves][corners]
        posture[corners] = refine_ik(arm, posture[corners], tcp[:, :3, 3], tcp[:, :3, :3])
    frames = locate_frames(arm.chain, posture)
    position = frames.tcp_position
    length = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
    arcs: dict[int, Arc] = {}
    for k in np.flatnonzero(program.arcs[moves] & ~alone).tolist():
        assert program.via is not None
        arc = find_arc(position[k - 1], program.via[moves][k, :3, 3], position[k])
        if arc is not None:
            arcs[k], length[k] = arc, arc.length
    feed = np.where(alone | (feeds <= 0.0), FASTEST, 1e-3 * feeds)
    instructions = Instructions(
        File(program.name), np.arange(n), ~alone, position, -frames.tcp_rotation[:, :, 2], posture, feed, zones[moves]
    )
    return Nodes(instructions, posture, position, frames.tcp_rotation, length, arcs), rows
