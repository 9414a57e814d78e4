"""The effects of the format's list, and how often each is drawn."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.outsider import known_elastic, known_motion
from benchmarks.outsider.cause import Maker

KNOWN: Mapping[str, tuple[Maker, float]] = {
    "joint_stiffness": (known_elastic.joint_stiffness, 3),
    "link_compliance": (known_elastic.link_compliance, 2),
    "base_compliance": (known_elastic.base_compliance, 1.3),
    "stiffness_nonlinearity": (known_elastic.stiffness_nonlinearity, 1.2),
    "gravity_sag": (known_elastic.gravity_sag, 1.3),
    "payload": (known_elastic.payload, 1.3),
    "gravity_compensator": (known_elastic.gravity_compensator, 1.0),
    "joint_offset": (known_motion.joint_offset, 2),
    "link_geometry": (known_motion.link_geometry, 2),
    "tool_frame": (known_motion.tool_frame, 1),
    "base_frame": (known_motion.base_frame, 0.8),
    "backlash": (known_motion.backlash, 2),
    "transmission_error": (known_motion.transmission_error, 2.2),
    "thermal_drift": (known_motion.thermal_drift, 1.5),
    "wrench_bias": (known_elastic.wrench_bias, 0.9),
    "wrench_scale": (known_elastic.wrench_scale, 0.7),
    "tracking_lag": (known_motion.tracking_lag, 0.7),
    "frame_shift": (known_motion.frame_shift, 1.3),
    "tool_shift": (known_motion.tool_shift, 1.2),
    "joint_coupling": (known_motion.joint_coupling, 0.9),
    "time_skew": (known_motion.time_skew, 0.6),
}
