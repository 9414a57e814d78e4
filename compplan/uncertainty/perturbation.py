"""Robots that might be the true one: a robot whose unknown parameters have some values.

Compliances change by a spring in series, C = C_folder + dC, which holds for either sign of dC; everything else goes
through the effects' own forward model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compplan.effects import Effect, apply_effects, build_model, fold_effects, is_of_instrument, robot_effects
from compplan.effects.folding import base_joint
from compplan.effects.forward_model import ForwardModel
from compplan.effects.signature import pack_parameters
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot, Spring
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns
from compplan.uncertainty.assumed import LINK_ELASTICITY


def vary_robot(robot: Robot, unknown: Unknown, values: Array) -> tuple[Robot, Effect | None]:
    """Change the parameters of one unknown; an effect that URDF and springs cannot say is returned beside the robot."""
    change = float(values[0])
    if unknown.effect == "joint_stiffness":
        return _in_series(robot, Spring(str(unknown.joint), "own", change, actuator=True)), None
    if unknown.effect == "link_compliance":
        return _in_series(robot, Spring(str(unknown.joint), str(unknown.axis), change)), None
    if unknown.effect == "base_compliance" and (joint := base_joint(robot)) is not None:
        return _in_series(robot, Spring(joint, str(unknown.axis), change)), None
    if unknown.effect == LINK_ELASTICITY:
        children = {joint.name: joint.child for joint in robot.joints}
        link = children[str(unknown.joint)]
        blocks = tuple(
            replace(b, compliance=b.compliance * (1.0 + change)) if b.link == link else b
            for b in robot.link_elasticities
        )
        return replace(robot, link_elasticities=blocks), None
    effect = Effect(unknown.effect, unknown.joint, unknown.axis, pack_parameters(unknown.keys, values, unknown.fixed))
    if unknown.effect == "base_compliance":
        return robot, effect
    folded = fold_effects(replace(robot, effects=()), [effect])
    if folded.effects:
        return robot, effect
    return replace(folded, effects=robot.effects), None


def build_varied_model(robot: Robot, campaign: Campaign) -> ForwardModel:
    """Put a robot with the effects of its folder at rows that it is commanded to; instruments see nothing here."""
    effects = [effect for effect in robot_effects(robot) if not is_of_instrument(effect.name)]
    return apply_effects(build_model(robot, campaign, later=True), effects)


def vary_model(scene: ForwardModel, unknowns: Sequence[Unknown], values: Array) -> ForwardModel:
    """Put values of the unknowns into a scene, exactly."""
    robot, beside = scene.robot, []
    for unknown, own in split_unknowns(unknowns, values):
        robot, effect = vary_robot(robot, unknown, own)
        if effect is not None:
            beside.append(effect)
    return apply_effects(scene if robot is scene.robot else replace(scene, robot=robot), beside)


def sample_alternatives(known: Uncertainty, shifts: Array, count: int, random: np.random.Generator) -> Array:
    """Pick for each draw one explanation of each cause, by their weights, and return its shift. Shape (count, p). [SI]

    shifts: of each rival, as `split_alternatives` widens them. Shape (rivals, p).
    """
    values = np.zeros((count, len(known.factor)))
    for own, weights in group_alternatives(known):
        picked = random.choice(len(weights), size=count, p=weights)
        values += np.vstack([shifts[own], np.zeros(values.shape[1])])[picked]
    return values


def group_alternatives(known: Uncertainty) -> list[tuple[list[int], Array]]:
    """Return, for each cause that has rivals, their numbers and the weights of each and of the folder's, last."""
    found = []
    for cause in dict.fromkeys(rival.instead for rival in known.rivals):
        own = [number for number, rival in enumerate(known.rivals) if rival.instead == cause]
        weights = np.array([known.rivals[number].weight for number in own])
        weights = np.r_[weights, max(1.0 - weights.sum(), 0.0)]
        found.append((own, weights / weights.sum()))
    return found


def _in_series(robot: Robot, spring: Spring) -> Robot:
    """Add a spring behind those of its joint."""
    return replace(robot, springs=(*robot.springs, spring))
