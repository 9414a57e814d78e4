"""The strategies of a study: those of a plan, which command blindly, and those that read sensors while the part is cut.

A new online strategy is one new file with `prepare(task, maps) -> Controller` and one line here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from compplan.errors import UnknownNameError
from compplan.plan.strategies import (
    STRATEGIES,
    both_encoders,
    command_path,
    encoder_force,
    first_part,
    force_sensor,
    online_correction,
    secondary_encoder,
)
from compplan.plan.strategies.controller import Controller
from compplan.plan.strategies.path_map import PathMaps
from compplan.plan.task import Command, PlanTask

#: Strategies that read sensors, by name.
ONLINE: dict[str, Callable[[PlanTask, PathMaps], Controller]] = {
    "secondary_encoder": secondary_encoder.prepare,
    "both_encoders": both_encoders.prepare,
    "encoder_force": encoder_force.prepare,
    "force_sensor_reduced": force_sensor.prepare_reduced,
    "force_sensor_full": force_sensor.prepare_full,
    "online_pi": online_correction.prepare_pi,
    "online_pid": online_correction.prepare_pid,
    "first_part": first_part.prepare,
}
#: The nonlinear program at a posture that was not chosen for accuracy: what the choice of posture brings. The strategy
#: "nlp" is the robust one where the job asks for an accurate posture, as it does by default.
PLAIN = "nlp_plain_posture"
#: Every strategy of a study, by name.
ALL_STRATEGIES = (*STRATEGIES, PLAIN, *ONLINE)

_OFFLINE_KNOWLEDGE = {"none": "geometry"}


def prepare_controllers(
    task: PlanTask, strategies: Sequence[str] = ALL_STRATEGIES, commands: Mapping[str, Command] | None = None
) -> dict[str, Controller]:
    """Let strategies prepare themselves for a task.

    Args:
        task: The task.
        strategies: Names of the strategies.
        commands: Commands of plan strategies that are known already.

    Raises:
        UnknownNameError: If there is no such strategy.
        InputError: If a strategy does not suit the robot.

    """
    maps, controllers = PathMaps(task), {}
    for name in strategies:
        if name in ONLINE:
            controllers[name] = ONLINE[name](task, maps)
        elif name in STRATEGIES:
            command = (commands or {}).get(name) or command_path(task, name)
            controllers[name] = Controller(
                name=name,
                knows=_OFFLINE_KNOWLEDGE.get(name, "the full stiffness model and the predicted wrench"),
                measures="nothing",
                commands="a joint program made beforehand",
                q=command.q,
            )
        else:
            raise UnknownNameError("strategy", name, list(ALL_STRATEGIES))
    return controllers
