"""What a job may name: effects, strategies of a plan, and those that read sensors while the part is cut.

Each name is that of one file in `compplan.effects` or `compplan.planning.strategies`, which open these registries; a
file
is imported when it is first used, so that a job is checked before anything heavy is loaded. Job schema, help texts,
commented job and pages read these lists. Program languages are listed in `compplan.controllers.writers`, CAM readers in
`compplan.toolpath.readers`, force models in `compplan.process.force_models`.
"""

from __future__ import annotations

from typing import Any

from compplan.io.plugins import Registry

#: Effects, in the order in which they enter a scene: what changes the robot first, what needs its poses later.
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
)).install("effects")  # fmt: skip
#: Strategies of a plan: a file with `words` and `command_path(task)`.
STRATEGIES: Registry[Any] = Registry[Any](("none", "mirror", "iterated_mirror", "nlp")).install("strategies")
#: Strategies that read sensors while the part is cut: a file with `words` and `prepare(task, maps)`.
ONLINE: Registry[Any] = Registry[Any](("secondary_encoder", "both_encoders", "force_sensor"))
