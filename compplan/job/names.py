"""What a job may name: strategies of a plan, strategies that read sensors, presets of the posture.

Each name stands for one file; the file is imported when it is first used, so that a job is checked before anything
heavy is loaded. Job schema, help texts, commented job and pages read these lists. Program languages are listed in
`compplan.program`, CAM readers in `compplan.path.cam`, effects in `compplan.effects`.
"""

from __future__ import annotations

from compplan.files.plugins import find_plugins

#: Strategies of a plan: the module that holds `command_path(task)`.
STRATEGIES = {
    "none": "compplan.plan.strategies.none",
    "mirror": "compplan.plan.strategies.mirror",
    "iterated_mirror": "compplan.plan.strategies.iterated_mirror",
    "nlp": "compplan.plan.strategies.nlp",
}
STRATEGIES.update({entry.name: entry.value for entry in find_plugins("strategies", STRATEGIES)})
#: Strategies that read sensors while the part is cut: module and the function that prepares them from (task, maps).
ONLINE = {
    "secondary_encoder": "compplan.plan.strategies.secondary_encoder:prepare",
    "both_encoders": "compplan.plan.strategies.both_encoders:prepare",
    "encoder_force": "compplan.plan.strategies.encoder_force:prepare",
    "force_sensor_reduced": "compplan.plan.strategies.force_sensor:prepare_reduced",
    "force_sensor_full": "compplan.plan.strategies.force_sensor:prepare_full",
    "online_pi": "compplan.plan.strategies.online_correction:prepare_pi",
    "online_pid": "compplan.plan.strategies.online_correction:prepare_pid",
    "first_part": "compplan.plan.strategies.first_part:prepare",
}
