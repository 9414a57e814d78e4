"""Conventions: joint signs, zeros and couplings that shift a robot by centimetres, found before any fit.

A missing coupling, a reversed joint or a shifted zero is not a small error: it is named, not fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from compplan.controllers.writers.joint_convention import load_controller
from compplan.diagnosis.data.shared import ROUNDING, SAMPLE, STEPS
from compplan.effects import Effect, apply_effects, build_model, solve_model_poses
from compplan.measurement.campaign import Campaign
from compplan.measurement.frames import fit_registration
from compplan.measurement.registration import stated_registration
from compplan.robot import Array, Robot, load_robot

#: Gap from which a wrong convention is searched for (assumed). [m]
SUSPICIOUS = 5e-3
#: Largest ratio of remaining to original gap for an explanation (assumed: a third is decisive).
CONVINCING = 0.3
#: Quantile of the distances that is called the gap (assumed: a wrong coupling shows in the sweep of one joint of seven
#: alone, and one row in ten may be a gross error).
WITHIN = 0.9
#: Longest step of the search for a ratio or a zero (assumed). [-, or rad]
LONGEST_STEP = 0.3
#: Shipped robots with other joint conventions than their URDFs: joint 3 against the horizontal, axes reversed.
BRANDS = ("fanuc_m10ia", "kuka_kr240", "kuka_kr270")


def find_conventions(robot: Robot, campaign: Campaign, register: tuple[str, ...]) -> tuple[Effect, ...]:
    """Find joint conventions (signs, zeros, couplings) without which the log is far off the model, frames fitted."""
    rows = np.flatnonzero(campaign.usable & campaign.measured)
    if not len(rows):
        return ()
    part = campaign.take(rows[:: max(1, len(rows) // SAMPLE)])
    part = replace(part, link=None, motor=None, observations=None)
    found: list[Effect] = []
    gap = typical_gap(robot, part, register, found)
    while gap > SUSPICIOUS:
        trials = enumerate(list_fixed_conventions(robot))
        best = min(((typical_gap(robot, part, register, [*found, e]), n, e) for n, e in trials), key=lambda t: t[:2])
        if best[0] > CONVINCING * gap:
            several = [(typical_gap(robot, part, register, [*found, *e]), n, e)
                       for n, (_, e) in enumerate(list_conventions(robot))]  # fmt: skip
            together = min(several, key=lambda t: (t[0], t[1]), default=(np.inf, 0, ()))
            if together[0] <= CONVINCING * gap:
                found += together[2]
                gap = together[0]
                continue
            sized = [size_convention(robot, part, register, found, e) for e in list_unsized_conventions(robot)]
            best = min(((g, n, e) for n, (g, e) in enumerate(sized)), key=lambda t: (t[0], t[1]))
        if best[0] > CONVINCING * gap:
            break
        found.append(best[2])
        gap = best[0]
    return tuple(found)


def typical_gap(
    robot: Robot, campaign: Campaign, register: tuple[str, ...], effects: list[Effect], within: float = WITHIN
) -> float:
    """Return the `within` quantile of the distance between measured and expected; `register` frames fitted. [m]"""
    distance: Array = np.linalg.norm(campaign.position - expect_targets(robot, campaign, register, effects), axis=1)
    return float(np.quantile(distance, within))


def expect_targets(robot: Robot, campaign: Campaign, register: tuple[str, ...], effects: list[Effect]) -> Array:
    """Return the expected positions of the targets, `register` frames fitted. Shape (n, 3). [m]"""
    stated = None if register else stated_registration(campaign)
    attained = solve_model_poses(apply_effects(build_model(robot, campaign, registration=stated), effects))
    if not register:
        return attained.position
    registration = fit_registration(campaign, attained.position, attained.rotation, register)
    return registration.locate_targets(campaign, attained.position, attained.rotation)


def size_convention(
    robot: Robot, campaign: Campaign, register: tuple[str, ...], found: list[Effect], effect: Effect
) -> tuple[float, Effect]:  # fmt: skip
    """Find the ratio or zero of a convention by damped Gauss-Newton steps; return typical gap [m] and effect."""
    key = "ratio" if "ratio" in effect.parameters else "zero_rad"
    best, size = (np.inf, effect), 0.0
    for _ in range(STEPS):
        here = replace(effect, parameters={**effect.parameters, key: size})
        there = replace(effect, parameters={**effect.parameters, key: size + ROUNDING})
        expected = expect_targets(robot, campaign, register, [*found, here])
        slope = (expect_targets(robot, campaign, register, [*found, there]) - expected) / ROUNDING
        left = campaign.position - expected
        gap = np.linalg.norm(left, axis=1)
        best = min(best, (float(np.quantile(gap, WITHIN)), here), key=lambda b: b[0])
        weight = 1.0 / np.maximum(gap, float(np.median(gap)))
        step = float(np.sum(weight[:, None] * slope * left) / max(np.sum(weight[:, None] * slope**2), 1e-300))
        if abs(step) < ROUNDING:
            break
        size += float(np.clip(step, -LONGEST_STEP, LONGEST_STEP))
    return best


def list_unsized_conventions(robot: Robot) -> Iterator[Effect]:
    """List couplings and shifted zeros of unknown size."""
    joints = robot.actuated
    for index, joint in enumerate(joints):
        for other in (index - 1, index + 1, index - 2, index + 2):
            if 0 <= other < len(joints) and joints[other].kind == joint.kind:
                yield Effect("joint_coupling", joint.name, None, {"other": joints[other].name, "ratio": 0.0})
        if joint.kind == "revolute":
            yield Effect("joint_coupling", joint.name, None, {"zero_rad": 0.0})


def list_fixed_conventions(robot: Robot) -> Iterator[Effect]:
    """List couplings with neighbouring joints, reversed joints, and zeros shifted by a quarter or half turn."""
    joints = robot.actuated
    for index, joint in enumerate(joints):
        for other in (index - 1, index + 1, index - 2, index + 2):
            if 0 <= other < len(joints) and joints[other].kind == joint.kind:
                for ratio in (-1.0, 1.0):
                    yield Effect("joint_coupling", joint.name, None, {"other": joints[other].name, "ratio": ratio})
        if joint.kind == "revolute":
            yield Effect("joint_coupling", joint.name, None, {"reversed": True})
            for zero in np.pi * np.array([0.5, -0.5, 1.0]):
                yield Effect("joint_coupling", joint.name, None, {"zero_rad": float(zero)})
                yield Effect("joint_coupling", joint.name, None, {"reversed": True, "zero_rad": float(zero)})


def list_conventions(robot: Robot) -> list[tuple[str, tuple[Effect, ...]]]:
    """List controllers whose joint convention differs from a URDF's, and the effects that convert each.

    They are those of the robot folder and of shipped robots with as many joints. With c the controller's joints and q
    the URDF's, c = M q + z: q = M^-1 c - M^-1 z.
    """
    own = [robot] if robot.folder is not None and (robot.folder / "controller.toml").is_file() else []
    shipped = [load_robot(name) for name in BRANDS]
    found: dict[str, tuple[str, tuple[Effect, ...]]] = {}
    for one in (*own, *(s for s in shipped if s.nq == robot.nq and not robot.prismatic.any())):
        convention = load_controller(one)
        inverse = np.linalg.inv(convention.matrix)
        shift = -np.radians(inverse @ convention.zero)
        effects: list[Effect] = []
        for index, joint in enumerate(robot.actuated):
            table: dict[str, object] = {"reversed": True} if inverse[index, index] < 0 else {}
            table |= {"zero_rad": float(shift[index])} if abs(shift[index]) > ROUNDING else {}
            if table:
                effects.append(Effect("joint_coupling", joint.name, None, table))
            for other in np.flatnonzero(np.abs(inverse[index]) > ROUNDING):
                if other != index:
                    ratio = {"other": robot.joint_names[other], "ratio": float(inverse[index, other])}
                    effects.append(Effect("joint_coupling", joint.name, None, ratio))
        if effects:
            found.setdefault(repr(effects), (convention.name, tuple(effects)))
    return list(found.values())


def name_convention(robot: Robot, effects: Sequence[Effect]) -> str:
    """Name the controller with these conventions, for either direction of a coupled axis; "" if there is none."""
    stated = {_format_convention(effect) for effect in effects if effect.name == "joint_coupling"}
    if not stated:
        return ""
    return next((name for name, own in list_conventions(robot) if {_format_convention(e) for e in own} == stated), "")


def _format_convention(effect: Effect) -> str:
    """Format a convention without the direction of a coupling, which depends on the URDF alone."""
    table = {key: abs(value) if key == "ratio" else value for key, value in effect.parameters.items()}
    return repr((effect.joint, sorted((k, round(v, 6) if isinstance(v, float) else v) for k, v in table.items())))
