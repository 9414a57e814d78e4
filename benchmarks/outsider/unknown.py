"""The causes without a name in the format's list, in the order in which seeds take them."""

from __future__ import annotations

from benchmarks.outsider import unknown_arm, unknown_base, unknown_joints, unknown_seen
from benchmarks.outsider.cause import Maker

UNKNOWN: tuple[Maker, ...] = (
    unknown_base.mount_creep,
    unknown_base.tripod_drift,
    unknown_base.floor_bending,
    unknown_arm.hose_pull,
    unknown_seen.refraction,
    unknown_arm.loose_bolt_rock,
    unknown_joints.controller_rounding,
    unknown_joints.belt_tooth_load,
    unknown_joints.stale_labels,
    unknown_seen.smr_nest,
    unknown_seen.two_nests,
    unknown_base.rail_waves,
    unknown_base.gantry_heat,
    unknown_arm.balancer_run,
    unknown_seen.stale_error_table,
    unknown_arm.bearing_wobble,
    unknown_joints.brake_drop,
    unknown_base.mobile_base,
    unknown_joints.geartrain_crosstalk,
    unknown_seen.tracker_encoder,
    unknown_seen.tool_changer_rock,
    unknown_arm.tank_empties,
    unknown_joints.region_compensation,
    unknown_joints.cardan_wrist,
    unknown_joints.zero_jump,
    unknown_arm.sunlit_arm,
    unknown_arm.cable_tray_drag,
)
ON_RAILS: tuple[Maker, ...] = (unknown_base.rail_waves, unknown_base.gantry_heat)
