"""Fading: how far the parts of a robot folder that are uncertain may be trusted where a campaign has not been.

A calibration may resemble a cause that it has no name for: it then predicts poses like those that were measured, and
leads astray elsewhere. At each stay that the fit never saw, the share w of the parts' motion of the tip that was there
is known to a deviation. Over the place of the tip and the force on it, w is a normal process of mean zero and variance
one [Rasmussen2006, ch. 2] whose two lengths are what the stays say (a mean over lengths by their evidence): what held
alike everywhere reaches far, what held by chance hardly reaches the next pose, and nothing reaches endlessly far.
At a stay it differs from w by what differs from place to place beyond noise.

A share a of the parts leaves |g - a m|^2 of an error g along their motion m, w = g . m / |m|^2: its mean is least at
a = E w, and it is more than without them where w is below a / 2. Of the parts stays E w, and no more than what is worse
than none in one case of twenty: a = min(E w, 2 w_05), from 0 to 1, the mean over the path; w spreads there by what
differs from stay to stay beyond noise, too, since a path may lie all in one place. The rest is taken out of the robot,
and its covariance grows by the square of what is taken out. Of a cause with rivals no more stays than they allow.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.distance import cdist

from compplan.effects import Effect, fold_effects
from compplan.effects.signature import pack_parameters
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, spread_unknowns
from compplan.robot.validity import FILE, ValidityPart, ValidityRegion, read_visited
from compplan.statics.chain import build_chain, locate_frames
from compplan.uncertainty.sensitivities import build_path_model, group_alternatives, measure_slopes

#: Lengths over which the share may change: of places, in spreads of the visited ones; of forces, in the largest one
#: (assumed: from a quarter of what was visited to far beyond it).
PLACES, FORCES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0), (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
#: Force that counts as the largest one where none was applied (assumed). [N]
SMALL_FORCE = 50.0
#: Stays that are looked at, at most (assumed).
STAYS = 120
#: Rows of a path that are looked at, at most (assumed).
ROWS = 60
#: Share from which on the parts stay whole (theory: a tenth too much costs a hundredth of their square).
WHOLE = 0.9
#: Probability up to which a plan may be worse with what is in doubt than without it (assumed: one plan of twenty), and
#: that quantile in standard deviations (theory).
WORSE, SAFE = 0.05, 1.645
#: Rounding of the share's covariance.
ROUNDING = 1e-9


def shrink_robot(robot: Robot, q: Array, wrench: Array) -> tuple[Robot, float]:
    """Return the robot for a path, its uncertain parts taken back as far as they are not trusted there; and the share.

    q: joint positions, (n, nq) [rad or m]; wrench on the tool at the TCP, base axes, (n, 6) [N, N m].
    """
    visited = robot.visited
    if visited is None or not visited.parts or not len(q):
        return robot, 1.0
    rows = np.unique(np.linspace(0, len(q) - 1, ROWS).astype(int))
    share = float(np.mean(trust_parts(robot, visited, q[rows], wrench[rows])))
    share = min(share, weigh_alternatives(robot, visited, q[rows], wrench[rows]))
    return (robot, 1.0) if share >= WHOLE else (keep_share(robot, visited, share), share)


def trust_parts(robot: Robot, visited: ValidityRegion, q: Array, wrench: Array) -> Array:
    """Return the share of the uncertain parts that is expected, and rarely worse than none, from 0 to 1. Shape (n,)."""
    few = np.unique(np.linspace(0, len(visited.q) - 1, STAYS).astype(int))
    chain = build_chain(robot)
    place, there = (locate_frames(chain, at).tcp_position for at in (visited.q[few], q))
    force = visited.wrench[few, :3]
    spread = max(float(np.sqrt(np.mean(np.sum((place - place.mean(axis=0)) ** 2, axis=1)))), ROUNDING)
    largest = max(float(np.linalg.norm(force, axis=1).max()), SMALL_FORCE)
    known = [cdist(of, of, "sqeuclidean") / size**2 for of, size in ((place, spread), (force, largest))]
    new = [
        cdist(to, of, "sqeuclidean") / size**2
        for to, of, size in ((there, place, spread), (wrench[:, :3], force, largest))
    ]
    noise = np.diag(visited.deviation[few] ** 2 + visited.spread**2 + ROUNDING)
    evidence, means, squares = [], [], []
    for lengths in product(PLACES, FORCES):
        own, reached = (
            np.exp(-0.5 * sum(part / size**2 for part, size in zip(parts, lengths, strict=True)))
            for parts in (known, new)
        )
        root = np.linalg.cholesky(own + noise)
        solved = np.linalg.solve(root, np.column_stack([visited.share[few], reached.T]))
        evidence.append(-0.5 * solved[:, 0] @ solved[:, 0] - np.log(np.diag(root)).sum())
        means.append(solved[:, 1:].T @ solved[:, 0])
        squares.append(1.0 - np.sum(solved[:, 1:] ** 2, axis=0) + means[-1] ** 2)
    weight = np.exp(np.array(evidence) - max(evidence))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    deviation = np.sqrt(np.maximum(weight @ np.array(squares) - mean**2, 0.0))
    safe = 2.0 * (mean - SAFE * np.hypot(deviation, visited.spread))
    return np.clip(np.minimum(mean, safe), 0.0, 1.0)


def weigh_alternatives(robot: Robot, visited: ValidityRegion, q: Array, wrench: Array) -> float:
    """Return the share of uncertain causes that stays by what a campaign cannot tell from them, from 0 to 1.

    With m the motion of the tip by a cause along the path and m + d_k what it is by a rival of weight p_k, the share
    w_k = 1 + m . d_k / |m|^2 of the cause is there. A share a errs least at a = E w, and more than none from a = 2 w_k
    on: it is at most twice what is there with probability 1 - `WORSE`.
    """
    known = robot.uncertainty
    if known is None or not known.rivals:
        return 1.0
    doubted = {_place(part) for part in visited.parts}
    shifts = np.array([rival.shift for rival in known.rivals])
    places = [_place(unknown) for unknown in known.unknowns]
    of = np.repeat(np.arange(len(places)), [len(u.keys) for u in known.unknowns])
    used = [n for n in range(len(places)) if shifts[:, of == n].any()]
    scene, columns = build_path_model(robot, q, wrench), np.isin(of, used)
    slopes = measure_slopes(scene, [known.unknowns[n] for n in used], np.arange(len(q)))
    shares = [1.0]
    for own, weights in group_alternatives(known):
        cause = known.rivals[own[0]].instead
        held = np.where([places[n] == cause for n in of], -shifts[own[0]], 0.0)
        if cause not in doubted or not held.any():
            continue
        motion, other = (slopes @ held[columns]).ravel(), (slopes @ shifts[own][:, columns].T).reshape(-1, len(own))
        size = float(motion @ motion)
        there = np.r_[1.0 + motion @ other / size, 1.0] if size > 0.0 else np.ones(len(own) + 1)
        order = np.argsort(there)
        least = there[order[np.searchsorted(np.cumsum(weights[order]), WORSE)]]
        # what was taken out before is not taken out once more
        now = [part.value for part in visited.parts if _place(part) == cause]
        left = float(np.abs(np.concatenate(now)).max() / np.abs(held).max())
        shares.append(min(float(there @ weights), 2.0 * float(least)) / max(left, ROUNDING))
    return min(max(min(shares), 0.0), 1.0)


def keep_share(robot: Robot, visited: ValidityRegion, share: float) -> Robot:
    """Return the robot with a share, 0 to 1, of its uncertain parts; what is taken out counts as unknown.

    What it has visited then describes the parts as they are, so that the same place takes nothing out once more.
    """
    changed = robot
    for part in visited.parts:
        changed = _scale_part(changed, part, share)
    parts = tuple(replace(part, value=share * part.value) for part in visited.parts) if share > 0.0 else ()
    size = max(share, ROUNDING)
    told = (visited.share / size, visited.deviation / size, visited.spread / size)
    left = replace(visited, parts=parts, share=told[0], deviation=told[1], spread=told[2])
    changed, known = replace(changed, visited=left if parts else None), robot.uncertainty
    return changed if known is None else replace(changed, uncertainty=_take_out(known, visited.parts, 1.0 - share))


def has_faded(robot: Robot) -> bool:
    """Tell whether uncertain parts of a robot's folder have been taken back."""
    own = None if robot.folder is None else read_visited(robot.folder / FILE, robot.nq)
    if own is None or not own.parts:
        return False
    if robot.visited is None:
        return True
    stated, now = ({_name(part): part.value for part in region.parts} for region in (own, robot.visited))
    return any(not np.allclose(value, stated[key], rtol=1e-9, atol=0.0) for key, value in now.items() if key in stated)


def shrink_alike(robot: Robot, faded: Robot) -> Robot:
    """Return a robot whose uncertain parts are taken back as far as those of another that `shrink_robot` made of it.

    The robot has no tool of a job; the other may carry it.
    """
    if robot.visited is None or not robot.visited.parts:
        return robot
    now = {_name(part): part.value for part in (faded.visited.parts if faded.visited else ())}
    for part in robot.visited.parts:
        size = float(np.abs(part.value).max(initial=0.0))
        if _name(part) in now and size > 0.0:
            share = float(np.abs(now[_name(part)]).max()) / size
            return robot if share >= 1.0 - ROUNDING else keep_share(robot, robot.visited, share)
    return keep_share(robot, robot.visited, 0.0) if faded.visited is None else robot


def _scale_part(robot: Robot, part: ValidityPart, share: float) -> Robot:
    """Scale one part: where it stands in effects.toml there, else in URDF and springs."""
    place, tables = (part.effect, part.joint, part.axis), list(robot.effects)
    for number, table in enumerate(tables):
        held = dict(table["parameters"])
        own = pack_parameters(part.keys, (share - 1.0) * part.value, {})
        settings = all(held.get(key) == value for key, value in part.fixed.items())
        if (table["effect"], table.get("joint"), table.get("axis")) == place and settings and own.keys() <= held.keys():
            # a part that was learned since may stand in the same table
            for key, lost in own.items():
                both = isinstance(lost, list)
                held[key] = [a + b for a, b in zip(held[key], lost, strict=True)] if both else held[key] + lost
            tables[number] = {**table, "parameters": held}
            return replace(robot, effects=tuple(tables))
    lost = (share - 1.0) * part.value
    if "joints" in part.fixed:  # under own weight: one compliance a joint
        effects = [
            Effect("joint_stiffness", str(joint), None, {"compliance_change_rad_per_Nm": float(change)})
            for joint, change in zip(part.fixed["joints"], lost, strict=True)
        ]
    else:
        effects = [Effect(*place, pack_parameters(part.keys, lost, part.fixed))]
    return fold_effects(robot, effects)


def _take_out(known: Uncertainty, parts: tuple[ValidityPart, ...], share: float) -> Uncertainty:
    """Let the second moment of what is unknown grow by the square of a share of some parts."""
    names = [_name(unknown) for unknown in known.unknowns]
    unknowns, moved = list(known.unknowns), [np.zeros(len(u.keys)) for u in known.unknowns]
    for part in parts:
        if _name(part) in names:
            moved[names.index(_name(part))] = share * part.value
        else:
            zero = np.zeros(len(part.keys))
            unknowns.append(Unknown(part.effect, part.joint, part.axis, part.keys, zero, part.fixed))
            moved.append(share * part.value)
    shift = np.concatenate(moved) / known.calibration
    grown = len(shift) - len(known.factor)
    stated = np.concatenate([np.zeros(0), *(u.deviation for u in known.unknowns)])[:, None] * known.factor
    covariance = np.pad(stated @ stated.T, (0, grown)) + np.outer(shift, shift)
    named, factor = spread_unknowns(unknowns, covariance)
    rivals = tuple(replace(rival, shift=np.pad(rival.shift, (0, grown))) for rival in known.rivals)
    return replace(known, unknowns=named, factor=factor, rivals=rivals)


def _name(part: ValidityPart | Unknown) -> str:
    return repr((part.effect, part.joint, part.axis, part.keys, part.fixed))


def _place(part: ValidityPart | Unknown) -> str:
    return " ".join(word for word in (part.effect, part.joint, part.axis) if word)
