"""Registries of names in a job: effects, strategies, and strategies with sensors.

Each name is a module of `compplan.effects` or `compplan.planning.strategies`, imported at first use. Other registries:
`compplan.controllers.writers`, `compplan.toolpath.readers`, `compplan.process.force_models`.
"""

from __future__ import annotations

from typing import Any

from compplan.io.registry import Registry

#: Effects in the order in which they enter the forward model: changes of the robot first.
EFFECTS: Registry[Any] = Registry[Any]((
    "joint_stiffness",
    "link_compliance",
    "base_compliance",
    "stiffness_nonlinearity",
    "gravity_sag",
    "payload",
    "gravity_compensator",
    "joint_offset",
    "link_geometry",
    "tool_frame",
    "base_frame",
    "backlash",
    "transmission_error",
    "thermal_drift",
    "wrench_bias",
    "wrench_scale",
    "tracking_lag",
    "frame_shift",
    "tool_shift",
    "joint_coupling",
    "time_skew",
))  # fmt: skip
#: Strategies of a plan: a module with `words` and `command_path(task)`.
STRATEGIES: Registry[Any] = Registry[Any](("none", "mirror", "iterated_mirror", "nlp"))
#: Strategies that read sensors while the part is cut, with the same interface.
ONLINE: Registry[Any] = Registry[Any](("secondary_encoder", "both_encoders", "force_sensor"))
