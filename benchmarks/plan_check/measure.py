"""Judge one plan: what joints.csv does in the cell, beside what plan.json claims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.plan_check.cell import Kinematics, SimulatedRobot
from benchmarks.plan_check.clearance import least_clearance
from benchmarks.plan_check.force import acts_in_rapids, contact_share, law
from benchmarks.plan_check.job import Array, Job, Rows
from benchmarks.plan_check.match import SAME, Placed, distance_to_path, place_rows
from benchmarks.plan_check.motion import SHARES, cartesian_linear, joint_linear, runs_of, spline
from benchmarks.plan_check.robot import STANDARD_GRAVITY

#: Rows and moves that are brought to rest where a path has more.
MOST_ROWS, MOST_MOVES, MOST_POSTURES = 12000, 1500, 1500
MM = 1e3


@dataclass(frozen=True)
class Motion:
    """joints.csv, worked out: n rows.

    Attributes:
        rows: The file.
        placed: Where its rows lie on the CAM path.
        feed: Feed of the move that ends at each row. [m/s]
        full: Wrench of the force law at the driven feed, in full contact. Shape (n, 6).
        wrench: The same with the ramps at contact; where a cut begins, that of its first move. Shape (n, 6).
        loaded: Rows of a cut, the row where it begins among them.
        runs: First and last row of what is fed without a rapid between.
    """

    rows: Rows
    placed: Placed
    feed: Array
    full: Array
    wrench: Array
    loaded: np.ndarray
    runs: list[tuple[int, int]]


def work_out(job: Job, rows: Rows) -> Motion:
    """Place the rows on the path, find the feed that is driven and the force that it makes."""
    placed = place_rows(job.path, rows)
    step, gap = np.diff(rows.time), np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        driven = np.where(gap > 0, gap / step, 0.0)
    feed = np.r_[driven[:1], driven]
    full = law(job, placed, rows.wanted, rows.axis, np.where(np.isfinite(feed), feed, 0.0))
    contact = np.flatnonzero(~placed.cuts[:-1] & placed.cuts[1:])
    loaded = placed.cuts.copy()
    loaded[contact] = True
    if not acts_in_rapids(job):  # a cut begins with the force of its first move
        full[contact] = full[contact + 1]
        full[~loaded] = 0
    wrench = full * contact_share(job, placed.arc, placed.contact, placed.leave, rows.wanted)[:, None]
    _load(rows, placed, wrench, loaded)
    fed = placed.cuts if rows.move is None else rows.move != "rapid"
    return Motion(rows, placed, feed, full, wrench, loaded, runs_of(fed))


def _load(rows: Rows, placed: Placed, wrench: Array, loaded: np.ndarray) -> None:
    """Let the force grow (or fall) in rows of approach and retract that stay where a cut begins (or ends).

    joints.csv says how far it has grown, the law what it grows to.
    """
    if rows.move is None:
        return
    begins = np.flatnonzero(~placed.cuts[:-1] & placed.cuts[1:])
    ends = np.flatnonzero(placed.cuts & ~np.r_[placed.cuts[1:], False])
    for corner, step in [(row, -1) for row in begins] + [(row, 1) for row in ends]:
        i, whole = corner + step, wrench[corner].copy()
        while 0 <= i < len(rows) and rows.move[i] in ("approach", "retract") and not loaded[i]:
            if np.linalg.norm(rows.wanted[i] - rows.wanted[corner]) > SAME:
                break
            grown = float(rows.wrench[i] @ whole / max(whole @ whole, 1e-300))
            wrench[i], loaded[i] = np.clip(grown, 0.0, 1.0) * whole, True
            i += step


def examine(job: Job, plan: dict, rows: Rows) -> dict:
    """Return everything that was found of one plan, lengths in mm."""
    motion, cell, kinematics = work_out(job, rows), SimulatedRobot(job.arm), Kinematics(job.arm)
    found: dict = {"rows": len(rows), "cut_rows": int(motion.placed.cuts.sum())}
    notes = " ".join(plan.get("notes", [])).lower()
    words = ("tool weight", "weight of the tool", "tool's weight")
    excused = bool(job.arm.weights) and any(word in notes for word in words)
    found |= {"tool_weight_kg": sum(m.mass for m in job.arm.weights), "tool_weight_noted": excused}
    weights = not excused
    found |= _at_rows(job, cell, motion, weights)
    found |= _between(job, cell, kinematics, motion, weights)
    found |= _feed_and_force(job, motion)
    found |= _limits(job, motion)
    found |= _efforts(job, cell, motion)
    found |= _correction_and_contact(job, cell, kinematics, motion)
    found |= _coverage(job, motion)
    found["clearance"] = least_clearance(job, kinematics, rows.q)
    return found


def _at_rows(job: Job, cell: SimulatedRobot, motion: Motion, weights: bool) -> dict:
    rows, placed = motion.rows, motion.placed
    chosen = _choose(np.flatnonzero(motion.loaded), _jumps(motion.wrench), MOST_ROWS)
    rest = cell.rest(rows.q[chosen], motion.wrench[chosen], weights=weights)
    off = np.linalg.norm(rest.position - rows.wanted[chosen], axis=1)
    on_cam = np.stack([np.interp(placed.arc[chosen], *_strict(job.path.arc, c)) for c in job.path.position.T], axis=1)
    off_cam = np.linalg.norm(rest.position - on_cam, axis=1)
    z, axis = -rest.rotation[:, :, 2], rows.axis[chosen]
    tilt = np.arctan2(np.linalg.norm(np.cross(z, axis), axis=1), np.einsum("ni,ni->n", z, axis))
    worst = int(np.argmax(off))
    found = {
        "rows_at_rest": len(chosen),
        "unsettled": int((~rest.settled).sum()),
        "at_mm": float(off.max() * MM),
        "at_row": int(chosen[worst]),
        "at_rms_mm": float(np.sqrt(np.mean(off**2)) * MM),
        "at_cam_mm": float(off_cam[placed.on[chosen]].max() * MM),
        "tilt_deg": float(np.degrees(tilt.max())),
    }
    few = _choose(chosen, _jumps(motion.wrench), MOST_POSTURES)
    csv = cell.rest(rows.q[few], rows.wrench[few], weights=False)
    found["at_own_force_mm"] = float(np.linalg.norm(csv.position - rows.wanted[few], axis=1).max() * MM)
    if job.arm.weights:
        with_, without = (cell.rest(rows.q[few], motion.wrench[few], weights=w).position for w in (True, False))
        found["tool_weight_mm"] = float(np.linalg.norm(with_ - without, axis=1).max() * MM)
        missed = [float(np.linalg.norm(p - rows.wanted[few], axis=1).mean()) for p in (with_, without)]
        found["tool_weight_counted"] = missed[0] < missed[1]
    return found | _inertia(job, cell, motion, few, weights)


def _inertia(job: Job, cell: SimulatedRobot, motion: Motion, chosen: np.ndarray, weights: bool) -> dict:
    """Let the inertia of the timed motion load the springs too (velocity and acceleration by differences)."""
    rows, (rate, change) = motion.rows, _rates(motion)
    q, wrench = rows.q[chosen], motion.wrench[chosen]
    still = cell.rest(q, wrench, weights=weights).position
    moving = cell.rest(q, wrench, weights=weights, rate=rate[chosen], change=change[chosen]).position
    off = np.linalg.norm(moving - rows.wanted[chosen], axis=1)
    return {
        "inertia_mm": float(np.linalg.norm(moving - still, axis=1).max() * MM),
        "at_with_inertia_mm": float(off.max() * MM),
        "inertia_planned": bool(job.plan.get("inertia", False)),
    }


def _rates(motion: Motion) -> tuple[Array, Array]:
    """Return joint velocities and accelerations at every row, by differences. Shapes (n, nq)."""
    rows = motion.rows
    rate, change = np.zeros(rows.q.shape), np.zeros(rows.q.shape)
    for first, last in motion.runs:
        time = rows.time[first : last + 1]
        if last - first < 2 or np.diff(time).min() <= 0:
            continue
        rate[first : last + 1] = np.gradient(rows.q[first : last + 1], time, axis=0)
        mean = np.diff(rows.q[first : last + 1], axis=0) / np.diff(time)[:, None]
        change[first + 1 : last] = np.diff(mean, axis=0) / (0.5 * (time[2:] - time[:-2]))[:, None]
    return rate, change


def _between(job: Job, cell: SimulatedRobot, kinematics: Kinematics, motion: Motion, weights: bool) -> dict:
    rows, placed = motion.rows, motion.placed
    moves = np.flatnonzero(placed.cuts[1:])
    ends = kinematics.tip(rows.q)[:, :3, 3]
    middle = kinematics.tip(0.5 * (rows.q[moves] + rows.q[moves + 1]))[:, :3, 3]
    bow = np.zeros(len(rows))
    bow[moves] = np.linalg.norm(middle - 0.5 * (ends[moves] + ends[moves + 1]), axis=1)
    moves = _choose(moves, bow, MOST_MOVES)
    low, high, share = placed.arc[moves], placed.arc[moves + 1], SHARES[None, :, None]
    wrench = motion.full[moves][:, None] * (1 - share) + motion.full[moves + 1][:, None] * share
    arc = low[:, None] * (1 - SHARES) + high[:, None] * SHARES
    tips = rows.wanted[moves][:, None] * (1 - share) + rows.wanted[moves + 1][:, None] * share
    begin, end = placed.contact[moves + 1], placed.leave[moves + 1]
    wrench *= contact_share(job, arc, begin[:, None], end[:, None], tips)[:, :, None]
    ways = {"joint": (joint_linear(rows.q, moves), np.ones(len(moves), bool))}
    ways["cartesian"] = cartesian_linear(kinematics, rows.q, moves)
    ways["spline"] = (spline(rows.time, rows.q, motion.runs, moves), np.ones(len(moves), bool))
    found: dict = {"moves_between": len(moves)}
    moving: dict[str, Array] = {}
    if job.plan.get("inertia", False):
        for name, values in zip(("rate", "change"), _rates(motion), strict=True):
            inside = values[moves][:, None] * (1 - share) + values[moves + 1][:, None] * share
            moving[name] = inside.reshape(-1, values.shape[1])
    for name, (q, follows) in ways.items():
        rest = cell.rest(q.reshape(-1, q.shape[2]), wrench.reshape(-1, 6), weights=weights, **moving)
        off = distance_to_path(job.path, np.repeat(low, len(SHARES)), np.repeat(high, len(SHARES)), rest.position)
        off = off.reshape(len(moves), -1).max(axis=1)
        known = off[follows]
        found[f"between_{name}_mm"] = float(known.max(initial=0.0) * MM)
        found[f"between_{name}_row"] = int(moves[follows][np.argmax(known)]) if len(known) else -1
        found[f"between_{name}_beyond"] = int((known > job.tolerance).sum())
        if not follows.all():
            found[f"between_{name}_not_followed"] = int((~follows).sum())
    # just after a row the force of the next move already acts: what a jump of the force leaves there
    touch = contact_share(job, low, begin, end, rows.wanted[moves])
    after = cell.rest(rows.q[moves], motion.full[moves + 1] * touch[:, None], weights=weights).position
    found["after_jump_mm"] = float(distance_to_path(job.path, low, high, after).max() * MM)
    return found


def _feed_and_force(job: Job, motion: Motion) -> dict:
    rows, placed = motion.rows, motion.placed
    cuts = np.flatnonzero(placed.cuts & (placed.programmed > 0))
    moving = cuts[np.linalg.norm(rows.wanted[cuts] - rows.wanted[cuts - 1], axis=1) > 1e-9]
    ends = np.array([end for first, last in motion.runs for end in (first + 1, last)])
    inner = np.setdiff1d(moving, ends)  # a run starts and stops at rest
    ratio = motion.feed[inner] / placed.programmed[inner]
    force = np.linalg.norm(rows.wrench[cuts, :3] - motion.wrench[cuts, :3], axis=1)
    moment = np.linalg.norm(rows.wrench[cuts, 3:] - motion.wrench[cuts, 3:], axis=1)
    wished = law(job, placed, rows.wanted, rows.axis, placed.programmed)
    wished *= contact_share(job, placed.arc, placed.contact, placed.leave, rows.wanted)[:, None]
    greatest = np.linalg.norm(motion.wrench[cuts, :3], axis=1).max(initial=0.0)
    return {
        "feed_least_share": float(ratio.min(initial=1.0)),
        "feed_mean_share": float(rows_length(rows, moving) / max(_programmed_length(motion, moving), 1e-300)),
        "feed_lowered_rows": int((ratio < 0.99).sum()),
        "feed_above_share": float(ratio.max(initial=0.0)),
        "force_greatest_N": float(greatest),
        "force_off_N": float(force.max(initial=0.0)),
        "force_off_row": int(cuts[np.argmax(force)]) if len(cuts) else -1,
        "moment_off_Nm": float(moment.max(initial=0.0)),
        "force_at_programmed_feed_off_N": float(
            np.linalg.norm(rows.wrench[cuts, :3] - wished[cuts, :3], axis=1).max(initial=0.0)
        ),
    }


def rows_length(rows: Rows, moving: np.ndarray) -> float:
    """Return the length of the moves that end at `moving`. [m]"""
    return float(np.linalg.norm(rows.wanted[moving] - rows.wanted[moving - 1], axis=1).sum())


def _programmed_length(motion: Motion, moving: np.ndarray) -> float:
    """Return how far the programmed feed would have come in the time that these moves take. [m]"""
    step = np.diff(motion.rows.time)
    return float((step[moving - 1] * motion.placed.programmed[moving]).sum())


def _limits(job: Job, motion: Motion) -> dict:
    rows, joints, table = motion.rows, job.arm.commanded, job.table.get("limits", {})
    lower, upper = (np.array([getattr(j, side) for j in joints]) for side in ("lower", "upper"))
    room = np.minimum(rows.q - lower, upper - rows.q)
    top = np.array([j.velocity for j in joints]) * table.get("velocity_scale", 1.0)
    push = job.arm.acceleration * table.get("acceleration_scale", 1.0)
    step, move = np.diff(rows.time), np.diff(rows.q, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(move == 0, 0.0, move / step[:, None])
    bend = 0.0
    for first, last in motion.runs:  # |a| <= A bounds the difference of mean velocities, rest at both ends included
        mean, dt = rate[first:last], step[first:last]
        change = np.diff(np.vstack([np.zeros(mean.shape[1]), mean, np.zeros(mean.shape[1])]), axis=0)
        span = 0.5 * (np.r_[0.0, dt] + np.r_[dt, 0.0])
        with np.errstate(divide="ignore", invalid="ignore"):
            bend = max(bend, float(np.nanmax(np.abs(change) / span[:, None] / push, initial=0.0)))
    return {
        "time_runs_back": int((step < 0).sum()),
        "position_room_deg": float(np.degrees(room.min())),
        "velocity_ratio": float(np.nanmax(np.abs(rate) / top, initial=0.0)),
        "acceleration_ratio": bend,
        "joint_travel_deg": float(np.degrees(np.abs(move).sum())),
    }


def _efforts(job: Job, cell: SimulatedRobot, motion: Motion) -> dict:
    chosen = _choose(np.flatnonzero(motion.loaded), np.linalg.norm(motion.wrench, axis=1), MOST_POSTURES)
    most = np.array([joint.effort for joint in job.arm.commanded])
    found = {}
    for name, gravity in (("effort_ratio", job.arm.gravity), ("effort_with_weight_ratio", STANDARD_GRAVITY)):
        held = np.abs(cell.torques(motion.rows.q[chosen], motion.wrench[chosen], gravity)) / most
        found[name] = float(held.max())
        found[f"{name}_joint"] = job.arm.commanded[int(held.max(axis=0).argmax())].name
    return found


def _correction_and_contact(job: Job, cell: SimulatedRobot, kinematics: Kinematics, motion: Motion) -> dict:
    """The correction, and how deep a tip without process force stands below the path: stiff, or bent by weights."""
    rows = motion.rows
    offset = kinematics.tip(rows.q)[:, :3, 3] - rows.wanted
    size = np.linalg.norm(offset, axis=1)
    unforced = ~motion.placed.cuts & motion.placed.on if rows.move is None else rows.move == "rapid"
    unforced[0] = True
    if acts_in_rapids(job):
        unforced[:] = False
    few = np.flatnonzero(unforced)
    sagging = cell.rest(rows.q[few], np.zeros((len(few), 6))).position - rows.wanted[few]
    depth = -np.maximum(*(np.einsum("ni,ni->n", each, rows.axis[few]) for each in (offset[few], sagging)))
    return {
        "correction_mm": float(size[motion.loaded].max() * MM),
        "most_correction_mm": job.most_correction * MM,
        "rapid_inside_mm": float(max(depth.max(initial=0.0), 0.0) * MM),
    }


def _coverage(job: Job, motion: Motion) -> dict:
    """How far wanted tips and axes lie off the CAM path, and how far vertices of its cuts lie off the wanted path."""
    rows, placed, path = motion.rows, motion.placed, job.path
    on = np.flatnonzero(placed.on)
    cutting = np.flatnonzero(~path.rapid)
    cutting = cutting[cutting > 0]
    after = np.clip(np.searchsorted(placed.arc[on], path.arc[cutting] - 1e-9), 1, len(on) - 1)
    a, b, p = rows.wanted[on[after - 1]], rows.wanted[on[after]], path.position[cutting]
    along = b - a
    share = np.einsum("ni,ni->n", p - a, along) / np.maximum(np.einsum("ni,ni->n", along, along), 1e-300)
    missed = np.linalg.norm(a + np.clip(share, 0, 1)[:, None] * along - p, axis=1)
    axis = np.stack([np.interp(placed.arc[on], *_strict(path.arc, column)) for column in path.axis.T], axis=1)
    lean = np.linalg.norm(np.cross(axis, rows.axis[on]), axis=1) / np.linalg.norm(axis, axis=1)
    lean = np.where(placed.cuts[on], np.arcsin(np.clip(lean, 0, 1)), 0.0)
    return {
        "axis_off_path_deg": float(np.degrees(lean.max(initial=0.0))),
        "wanted_off_path_mm": float(placed.away[placed.cuts].max(initial=0.0) * MM),
        "vertex_missed_mm": float(missed.max(initial=0.0) * MM),
        "end_reached_mm": float((path.arc[cutting[-1]] - placed.arc[placed.cuts].max(initial=0.0)) * MM),
    }


def _choose(candidates: np.ndarray, score: Array, most: int) -> np.ndarray:
    """Take all candidates, or those with the greatest score and an even sample of the rest."""
    if len(candidates) <= most:
        return candidates
    worst = candidates[np.argsort(score[candidates])[::-1][: most // 2]]
    even = candidates[np.linspace(0, len(candidates) - 1, most - len(worst)).astype(int)]
    return np.unique(np.r_[worst, even])


def _jumps(wrench: Array) -> Array:
    step = np.linalg.norm(np.diff(wrench, axis=0), axis=1)
    return np.maximum(np.r_[0.0, step], np.r_[step, 0.0])


def _strict(arc: Array, values: Array) -> tuple[Array, Array]:
    keep = np.r_[True, np.diff(arc) > 0]
    return arc[keep], values[keep]
