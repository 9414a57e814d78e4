"""Plausibility checks on a measurement log and robot model, before any fit.

Checked are units, mirrored axes, rows out of step, an unstated frame or target, deviations or loads with the wrong
sign, a wrench about another point, and clocks that differ. Each check compares a figure with its limit and asks one
question. Wrong joint conventions (`conventions`) are named instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from compplan.diagnosis.data.conventions import CONVINCING, find_conventions, typical_gap
from compplan.diagnosis.data.noise import ASSUMED_SIGMA
from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, SAMPLE
from compplan.effects import apply_effects, build_model, robot_effects, solve_model_poses
from compplan.io.quantities import state_mm as _mm
from compplan.measurement.campaign import Campaign
from compplan.measurement.checks import describe_unit
from compplan.measurement.frames import fit_registration
from compplan.measurement.pooling import LIKE_LOAD
from compplan.measurement.registration import campaign_gap, fitted_parts
from compplan.robot import Array, Robot, Spring
from compplan.robot.mounting import mounted_tool
from compplan.statics.chain import build_chain, jacobian, load_elements, locate_frames
from compplan.statics.elements import ELASTIC_AXES

#: Largest gap of an effect; centimetres come from frames, tools, units or conventions (assumed). [m]
NO_EFFECT = 20e-3
#: Signs of weight and load under each hypothesis (theory).
SIGNS = {"right": (1.0, 1.0), "deviations": (-1.0, -1.0), "wrench": (1.0, -1.0), "none": (0.0, 0.0)}


@dataclass(frozen=True)
class CheckSettings:
    """Thresholds of the plausibility checks."""

    #: The sign test: least log likelihood ratio of the wrong sign, a stay counted as one value (theory: odds of 20,000
    #: to 1), and largest share of the squares left by springs of the wrong sign (assumed: they have to explain the
    #: residuals).
    least_sign_evidence: float = 10.0
    wrong_sign: float = 0.5
    #: Largest lag of a controller; a larger time shift is a clock error (assumed). [s]
    clock: float = 0.1


CHECKS = CheckSettings()


class CheckedRows(NamedTuple):
    """Checked rows with the nominal TCP predictions. Shapes (n, 3), (n, 3, 3)."""

    campaign: Campaign
    position: Array
    rotation: Array


@dataclass(frozen=True)
class Question:
    """A question about an implausible input: its subject, and a sentence with the figure that shows it."""

    about: str
    sentence: str


def check_plausibility(robot: Robot, campaign: Campaign, register: Sequence[str] = ()) -> list[Question]:
    """Return questions to be answered before a gap is explained, the most basic first."""
    sighted = check_sights(robot, campaign, register)
    if sighted:
        return [sighted]
    rows = build_rows_model(robot, campaign)
    if len(rows.campaign) < FEW_ROWS:
        return []
    if sentence := describe_unit(rows.campaign.position, rows.position):
        return [Question("unit", sentence)]
    if question := check_hand(rows) or check_step(rows):
        return [question]
    known, parts = list(robot_effects(robot)), tuple(register)
    far = typical_gap(robot, rows.campaign, parts, known) > NO_EFFECT
    conventions = find_conventions(robot, campaign, parts) if far else ()
    # the sign of springs is undefined while joint conventions are wrong
    sign = None if conventions else check_sign(robot, rows, register)
    found = [check_moment_point(robot, rows), sign, check_clock(robot, rows, register)]
    questions = [question for question in found if question]
    if far:
        gap = typical_gap(robot, rows.campaign, parts, [*known, *conventions], 0.5)
        if gap > NO_EFFECT:
            sentence = f"is it the log of this robot? The median gap is {_mm(gap)}, which no effect of a robot explains"
            beyond = Question("gap", f"{sentence}; check units, tool, frames and the signs and zeros of the joints")
            questions.insert(0, check_frames(rows, register) or beyond)
    return questions


def build_rows_model(robot: Robot, campaign: Campaign) -> CheckedRows:
    """Select rows with joints and position, thinned, and compute the predictions of the nominal robot."""
    index = np.flatnonzero(campaign.usable & campaign.measured)
    part = replace(campaign.take(index[:: max(1, len(index) // SAMPLE)]), link=None, motor=None, observations=None)
    attained = solve_model_poses(build_model(robot, part))
    return CheckedRows(part, attained.position, attained.rotation)


def check_sights(robot: Robot, campaign: Campaign, register: Sequence[str]) -> Question | None:
    """Check rows of other instruments for consistency: labels, units, directions, an unknown tool."""
    if campaign.observations is None or not campaign.observations.observed.any():
        return None
    attained = solve_model_poses(apply_effects(build_model(robot, campaign), robot_effects(robot)))
    rows = campaign.observations.observed & campaign.usable

    def leave(parts: Sequence[str], turned: Campaign) -> float:
        frames = fit_registration(turned, attained.position, attained.rotation, fitted_parts(turned, parts))
        gap = campaign_gap(turned, frames.locate_targets(campaign, attained.position, attained.rotation), frames)
        return float(np.median(np.linalg.norm(gap[rows], axis=1)))

    left = leave(register, campaign)
    if left < NO_EFFECT:
        return None
    if "tool" not in register and leave((*register, "tool"), campaign) < CONVINCING * left:
        return Question("target", f"rows of one contact lie {_mm(left)} apart, and together with the measured point"
                        " fitted; use --register tool")  # fmt: skip
    back = replace(campaign, observations=replace(campaign.observations, direction=-campaign.observations.direction))
    if leave(register, back) < CONVINCING * left:
        return Question("direction", f"readings are {_mm(left)} off along their directions, and fit the reversed ones;"
                        " is dir_i dir_j dir_k the direction in which the reading grows?")  # fmt: skip
    return Question(
        "contacts",
        f"contacts, readings and distances are {_mm(left)} off (median), which no effect of a robot explains; check"
        " labels, units and the tool; a reading whose zero is not known needs a label in column contact",
    )


def check_hand(rows: CheckedRows) -> Question | None:
    """Compare the best rigid placement with the best mirrored one (Kabsch, both determinants)."""
    proper, mirrored = (_median_distance(rows.position, rows.campaign.position, mirror) for mirror in (False, True))
    if proper > NO_EFFECT and mirrored < CONVINCING * proper:
        return Question(
            "left-handed frame",
            f"mirrored positions fit to {_mm(mirrored)}, right-handed ones to {_mm(proper)}; is an axis of the"
            " measuring frame reversed, or are two exchanged?",
        )
    return None


def check_step(rows: CheckedRows) -> Question | None:
    """Compare the rows with those one row earlier and one row later, inside runs."""
    still = _median_distance(rows.position, rows.campaign.position, False)
    if still < NO_EFFECT:
        return None
    same_run = np.diff(rows.campaign.run_index) == 0
    before, after = slice(None, -1), slice(1, None)
    for name, mine, theirs in (("earlier", after, before), ("later", before, after)):
        shifted = _median_distance(rows.position[mine][same_run], rows.campaign.position[theirs][same_run], False)
        if shifted < CONVINCING * still:
            return Question(
                "rows out of step",
                f"joints fit the positions one row {name} to {_mm(shifted)}, those of their own row to {_mm(still)};"
                " are the columns shifted by one row?",
            )
    return None


def check_frames(rows: CheckedRows, register: Sequence[str]) -> Question | None:
    """Ask for the target or a registration if one makes the gap small."""
    gap = float(np.median(np.linalg.norm(rows.campaign.position - rows.position, axis=1)))
    target_known = rows.campaign.target_offset is not None
    for parts in (("tool",), ("base",), ("base", "tool")):
        if set(parts) <= set(register) or (parts == ("tool",) and target_known):
            continue
        frames = fit_registration(rows.campaign, rows.position, rows.rotation, parts)
        expected = frames.locate_targets(rows.campaign, rows.position, rows.rotation)
        left = float(np.median(np.linalg.norm(rows.campaign.position - expected, axis=1)))
        if left >= CONVINCING * gap or left >= NO_EFFECT:
            continue
        if parts == ("tool",):
            x, y, z = frames.tool[0, :3, 3] * 1e3
            return Question(
                "target",
                f"the measured point lies {np.hypot(np.hypot(x, y), z):.0f} mm from the TCP in every pose; give"
                f" --target-offset {x:.1f},{y:.1f},{z:.1f}, the tool with --tool, or fit it with --register tool",
            )
        return Question(
            "frames",
            f"the median gap is {_mm(gap)}, and {_mm(left)} with the instrument's frame fitted"
            f" ({_mm(float(np.linalg.norm(frames.base[:3, 3])))} away); use --register {','.join(parts)}",
        )
    return None


def check_moment_point(robot: Robot, rows: CheckedRows) -> Question | None:
    """Check whether the moments are about the flange, of a force at the TCP."""
    chain = build_chain(robot)
    lever = -np.einsum("nij,j->ni", rows.rotation, np.linalg.inv(mounted_tool(robot))[:3, 3])
    force, moment = rows.campaign.wrench[:, :3], rows.campaign.wrench[:, 3:]
    about_flange = np.cross(lever, force)
    size = float(np.sqrt(np.mean(about_flange**2)))
    if not len(chain.names) or not rows.campaign.is_load(np.hstack([0 * force, moment])).any():
        return None
    left = float(np.sqrt(np.mean((moment - about_flange) ** 2)))
    if left >= LIKE_LOAD * size:
        return None
    length = float(np.median(np.linalg.norm(lever, axis=1)))
    return Question(
        "point of the wrench",
        f"the moments are those of a force at the TCP about a point {length * 1e3:.0f} mm away, the flange, and are"
        " expected about the TCP: are they the sensor's own?",
    )


def check_sign(robot: Robot, rows: CheckedRows, register: Sequence[str]) -> Question | None:
    """Compare springs that deflect with weights and loads to springs that deflect against them.

    Residuals against the rigid robot are fitted by geometry, zeros and frames (with priors), and by a compliance
    c_j >= 0 of every joint: r = ... + sum_j c_j J_j (t_weight + t_load)_j. Reversed deviations fit with both loads
    reversed, a reversed wrench with its part reversed. Deviations negated about the loaded robot resemble another
    compliance. Without loads, springs of the wrong sign need the same evidence against no springs as against the right.
    """
    shapes = shape_elastics(robot, rows.campaign, register)
    if not (np.abs(shapes.weight).any() or np.abs(shapes.load).any()):
        return None
    left = {name: fit_positive(shapes, *signs) for name, signs in SIGNS.items()}
    wrong = min(("deviations", "wrench"), key=lambda name: left[name])
    stays = len(np.unique(rows.campaign.stay))
    certainty = 0.5 * stays * float(np.log(left["right"] / max(left[wrong], 1e-300)))
    loaded, least = bool(np.abs(shapes.load).any()), CHECKS.least_sign_evidence
    there = 0.5 * stays * float(np.log(left["none"] / max(left[wrong], 1e-300))) >= least
    if certainty < least or not (left[wrong] <= CHECKS.wrong_sign * left["none"] if loaded else there):
        return None
    ratio = f"{100.0 * np.sqrt(left[wrong] / left['right']):.0f} % of what right ones leave"
    if wrong == "deviations":
        sentence = (
            f"the arm bends against its {'loads' if loaded else 'weight'}: springs with the reversed sign leave"
            f" {ratio}; are the deviations mirrored or negated (nominal minus measured)"
            f"{', or is it the wrench of the tool on the part' if loaded else ''}?"
        )
    else:
        sentence = (
            "the arm bends under its weight but against the external load: with the wrench reversed springs leave"
            f" {ratio}; is it the wrench of the tool on the part?"
        )
    return Question("sign", sentence)


def check_clock(robot: Robot, rows: CheckedRows, register: Sequence[str]) -> Question | None:
    """Check the clock: ask if positions on paths lead or lag the joints by more than a controller's lag."""
    path = rows.campaign.on_path
    if register or path.sum() < ENOUGH_ROWS or not rows.campaign.speed[path].any():
        return None
    chain = build_chain(robot)
    turn = jacobian(chain, locate_frames(chain, rows.campaign.q))[:, :3, chain.joint_elements]
    velocity = np.einsum("nij,nj->ni", turn, rows.campaign.speed)[path]
    gap = (rows.campaign.position - rows.position)[path]
    gap = gap - np.median(gap, axis=0)
    late = float(np.sum(velocity * gap) / max(np.sum(velocity**2), 1e-300))
    left = float(np.sum((gap - late * velocity) ** 2) / max(np.sum(gap**2), 1e-300))
    if abs(late) < CHECKS.clock or left > CONVINCING:
        return None
    return Question(
        "clock",
        f"positions on paths are {abs(late) * 1e3:.0f} ms {'ahead of' if late > 0 else 'behind'} the joints; are both"
        " clocks the same?",
    )


def _median_distance(nominal: Array, measured: Array, mirror: bool) -> float:
    """Return the median distance after the best placement of points on others, mirrored or not [Kabsch1976]. [m]"""
    a, b = nominal - nominal.mean(axis=0), measured - measured.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    sign = np.sign(np.linalg.det(u @ vt)) * (-1.0 if mirror else 1.0)
    turn = u @ np.diag([1.0, 1.0, sign]) @ vt
    distance = np.linalg.norm(a @ turn - b, axis=1)
    return float(np.sqrt(np.median(distance**2)))


#: Prior deviation of geometric errors in the sign test: metres, and radians (assumed).
GEOMETRY = 2e-3


class ElasticShapes(NamedTuple):
    """Data of the sign test, in units of the noise, geometry projected out; k equations.

    `residual` is measured minus rigid (k,), `weight` and `load` the deflection per unit compliance of each joint (k,
    nq).
    """

    residual: Array
    weight: Array
    load: Array


def shape_elastics(robot: Robot, campaign: Campaign, register: Sequence[str]) -> ElasticShapes:
    """Compute the deflections by springs of every joint at the rows; the robot's springs removed, frames fitted."""
    springs = tuple(Spring(joint.name, "own", 0.0) for joint in robot.actuated)
    frames_of = tuple(Spring(joint.name, axis, 0.0) for joint in robot.joints for axis in ELASTIC_AXES)
    bare = replace(robot, springs=springs + frames_of, link_elasticities=(), gravity=robot.real_gravity, effects=())
    chain = build_chain(bare)
    frames, n = locate_frames(chain, campaign.q), len(campaign.position)
    at = chain.spring_elements
    turn = jacobian(chain, frames)[:, :3, at]
    weight = load_elements(chain, frames, np.zeros((n, 6)))[:, at]
    load = load_elements(chain, frames, campaign.wrench)[:, at] - weight
    joints = np.array(["." not in name for name in chain.spring_names])
    position, measured = frames.tcp_position, campaign.position
    if register:
        fitted = fit_registration(campaign, position, frames.tcp_rotation, register)
        position = fitted.locate_targets(campaign, position, frames.tcp_rotation)
        measured, position = ((p - fitted.base[:3, 3]) @ fitted.base[:3, :3] for p in (measured, position))
    sigma = ASSUMED_SIGMA["position"]
    swing = np.swapaxes(np.cross(np.eye(3)[None], position[:, None, :]), 1, 2)
    free = np.concatenate([turn, np.broadcast_to(np.eye(3), (n, 3, 3)), frames.tcp_rotation, swing], axis=2)
    free = np.vstack([free.reshape(3 * n, -1) / sigma, np.eye(free.shape[2]) / GEOMETRY])
    basis = np.linalg.qr(free)[0]

    def project(columns: Array) -> Array:
        padded = np.vstack([columns.reshape(3 * n, -1) / sigma, np.zeros((free.shape[1], columns[0].size // 3))])
        return np.asarray(padded - basis @ (basis.T @ padded))

    yields = (project((turn * part[:, None, :])[:, :, joints]) for part in (weight, load))
    return ElasticShapes(project((measured - position)[:, :, None])[:, 0], *yields)


def fit_positive(shapes: ElasticShapes, weight_sign: float, load_sign: float) -> float:
    """Fit compliances >= 0 under weights and loads of these signs; return the remaining sum of squares."""
    columns = weight_sign * shapes.weight + load_sign * shapes.load
    size = np.linalg.norm(columns, axis=0)
    seen = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    if not seen.any():
        return float(shapes.residual @ shapes.residual)
    return float(nnls(columns[:, seen] / size[seen], shapes.residual)[1] ** 2)
