"""Effects: errors of a robot, its instrument and its sensors, one module each.

A module holds `name`, its description `words` ({at} is the place), the place it `sits` at if no joint, the quantity
that its error `follows`, `of_instrument` for errors of instrument, sensor or clock alone, and up to three functions:

    signatures(at)          possible places and forms of the effect, to first order
    fold(robot, effect)     the robot with the effect in URDF and springs, or None; left out: they cannot express it
    apply(model, effect)    the exact forward model where `fold` returns None or is left out

To simulate any mixture of effects exactly:

    model    = build_model(robot, campaign)                  compplan.effects.forward_model
    model    = apply_effects(model, robot_effects(robot))    effects of effects.toml, or others
    attained = solve_model_poses(model)                           attained.position, .rotation, .link, .motor

An effect is `Effect(name, joint, axis, parameters)`; parameters are SI, their keys end in the unit. For rows that are
commands rather than measurements build a campaign with `command_campaign(q, wrench, time=..., on_path=True)`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from compplan.effects.checks import check_effect
from compplan.effects.forward_model import Attained, ForwardModel, build_model, solve_model_poses
from compplan.effects.signature import Effect, EffectModel, Signature
from compplan.errors import InputError, UnknownNameError
from compplan.io.registry import Registry
from compplan.job import names
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot

#: Every effect of the vocabulary, by name. A new effect is one new file and one line in `compplan.job.names`.
EFFECTS: Registry[EffectModel] = names.EFFECTS.held_by(__name__)


def is_of_instrument(name: str) -> bool:
    """Return whether an effect is one of instrument, sensor or clock."""
    return bool(getattr(EFFECTS[name], "of_instrument", False))


def locate_effect(name: str, joint: str | None) -> str:
    """Return the place of an effect: its joint, or another part of the cell."""
    sits = getattr(EFFECTS[name], "sits", "robot")
    return str(joint or sits)


def driver_of(name: str) -> str:
    """Return the quantity that the error of an effect follows, such as the load."""
    return str(getattr(EFFECTS[name], "follows", "posture"))


def _in_order(effects: Iterable[Effect]) -> list[Effect]:
    order = list(EFFECTS)
    return sorted(effects, key=lambda effect: order.index(effect.name))


def apply_effects(model: ForwardModel, effects: Iterable[Effect]) -> ForwardModel:
    """Apply effects to a model, exactly, in the order of the vocabulary; several of one name and place add up."""
    for effect in _in_order(effects):
        folded = fold_effect(model.robot, effect)
        apply: Any = getattr(EFFECTS[effect.name], "apply", None)
        model = apply(model, effect) if folded is None else replace(model, robot=folded)
    return model


def fold_effect(robot: Robot, effect: Effect) -> Robot | None:
    """Write an effect into URDF and springs; None if they cannot express it."""
    fold = getattr(EFFECTS[effect.name], "fold", None)
    return None if fold is None else fold(robot, effect)


def robot_effects(robot: Robot) -> tuple[Effect, ...]:
    """Return the effects of a robot folder's effects.toml.

    Raises:
        InputError: If an entry names an unknown effect or joint.
    """
    file = None if robot.folder is None else robot.folder / "effects.toml"
    effects = []
    for number, table in enumerate(robot.effects):
        where = f"effect[{number}]"
        name = str(table.get("effect", ""))
        if name not in EFFECTS:
            raise UnknownNameError("effect", name, list(EFFECTS), file=file, where=f"{where}.effect")
        joint = table.get("joint")
        names = [known.name for known in robot.joints]
        if joint is not None and joint not in names:
            raise UnknownNameError("joint", str(joint), names, file=file, where=f"{where}.joint")
        parameters = table.get("parameters")
        if not isinstance(parameters, Mapping):
            raise InputError("expected a section of parameters", file=file, where=f"{where}.parameters")
        check_effect(table, robot, file, where)
        effects.append(Effect(name, joint, table.get("axis"), dict(parameters)))
    return tuple(effects)


def fold_effects(robot: Robot, effects: Iterable[Effect]) -> Robot:
    """Add effects to a robot: to URDF and springs if possible, otherwise to its table of effects."""
    tables: list[dict[str, Any]] = [dict(table) for table in robot.effects]
    for effect in _in_order(effects):
        folded = fold_effect(robot, effect)
        if folded is None:
            tables.append(effect.to_table())
        else:
            robot = folded
    return replace(robot, effects=tuple(tables))


def command_campaign(
    q: Array, wrench: Array | None = None, *, time: Array | None = None, on_path: bool = True
) -> Campaign:
    """Build a campaign of commanded rows.

    q: joint positions, (n, nq) [rad or m]; wrench: on the tool, base axes, none if left out, (n, 6) [N, N m]; time:
    since the beginning, for effects of motion, (n,) [s]; on_path: whether the rows are passed in motion.
    """
    q = np.atleast_2d(np.asarray(q, float))
    load = np.zeros((len(q), 6)) if wrench is None else np.broadcast_to(np.asarray(wrench, float), (len(q), 6))
    run = np.array(["path" if on_path else "static"] * len(q), dtype=np.str_)
    nowhere = np.full((len(q), 3), np.nan)
    return Campaign(run=run, q=q, wrench=load, position=nowhere, time=time)
