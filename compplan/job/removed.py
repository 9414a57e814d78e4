"""Keys of earlier releases."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError

#: Remedies, and the removed keys, dotted, that each is for.
REMEDIES = {
    "the force is that of the tool on its path; delete it": "coupling",
    "state [process] tool_mode, a plan notes the limit of depth": "stability",
    "a CAM system checks finished walls and stock; delete it":
        "surface tool_beam process.part process.holder_mm tool.process.part tool.process.holder_mm",
    "write rotation_deg (a rotation vector) or quaternion":
        "part.rotation_rad part.zyz_deg part.val3_deg tool.rotation_rad tool.zyz_deg tool.val3_deg",
    "write points_mm, nominal and measured": "part.datum_mm",
    "0.02 mm are assumed; delete it": "part.touch_repeatability_mm",
    "only rotating joints are held; delete it": "positioner.hold_mm",
    "name the tool table in [tools] file": "tool.cutter_file tool.cutter_name",
    "state the unit in the tool table": "tools.unit",
    'write toolpath = "FILE", and [cam] strict': "toolpath.file",
    "write feed_mm_s": "toolpath.duration_s",
    "write waypoints": "toolpath.rate_hz",
    "place the path by [part]": "toolpath.axis toolpath.centre_mm toolpath.plane toolpath.start_deg",
    "write [process.coefficients]": "process.materials",
    "write it as a comment": "process.coefficients.source tolerance.part.name",
    "a constant takes its place; delete it":
        "process.helix_deg process.runout_mm process.web_thinned process.axial_ratio process.shoulder_cone_deg "
        "process.traverse_ratio process.side_ratio process.force_ratio process.friction process.build_up_mm "
        "posture.measure posture.wrench_uncertainty posture.compliance_uncertainty posture.joint_zero_uncertainty_deg "
        "posture.singularity_margin posture.spin_step_deg noise.correlation_mm noise.motor_encoder_deg "
        "noise.link_encoder_deg noise.expansion_per_K noise.moment_noise_Nm noise.moment_bias_Nm noise.force_bias_N "
        "noise.force_gain",
    "write axial_N, pressure times the area of the shoulder": "process.pressure_N_mm2",
    "write normal_N": "process.specific_energy_J_mm3 process.wheel_speed_m_s",
    "delete it": "posture.weights process.ramp_out_mm process.drag_N process.step_down_mm",
    "programs are lines and arcs; delete it": "output.splines",
    "write plan.start_deg": "plan.configuration.start_deg",
    "write max_step_mm": "sampling.max_turn_deg",
    "state jerk_limits in the robot folder": "limits.full_acceleration_after_s",
    "fix the configuration by plan.configuration": "posture.reconfigure",
    "lower the part instead": "place.base_height_mm",
    "the arm always keeps clear of itself; delete it": "collision.self_collision",
    "write plan.tolerance_mm": "tolerance.normal_mm",
    "write s_mm or operation": "tolerance.part.waypoints",
    'write it in NAME.toml beside the CAM file, [cam] machine = "NAME" takes it':
        "cam.rotary_axes cam.rotary_centre_mm cam.rotary_offset_mm cam.pivot_mm cam.tip_control cam.tilt_angles",
    "the file decides; delete it": "cam.chord_tolerance_mm cam.arc_centres cam.circle_sense",
    "write it into a template, output.templates": "output.header output.footer output.cell.positioner",
    "programs are cut up as the controller takes them; delete it": "output.max_points_per_file",
    "the program stops and asks the operator; delete it": "output.io.spindle_reverse",
    "name an input, spindle_ready": "output.io.spindle_wait_s",
    "coolant switches both": "output.io.mist",
    "state it as [[unknown]] in the robot folder's uncertainty.toml": "noise.effects",
    "robots are drawn from the robot folder's uncertainty.toml, or by its grade; state it there and delete the key":
        "noise.robot noise.joint_compliance noise.link_compliance noise.joint_zero_deg noise.geometry_mm "
        "noise.geometry_deg noise.tool_frame_mm noise.backlash_deg noise.gear_error_deg noise.gear_periods "
        "noise.repeatability_mm",
    "no strategy measures a first part; delete it": "noise.tracker_mm noise.tracker_mm_per_m",
    "no strategy runs a control loop; delete it": "noise.plant_lag_ms noise.plant_delay_ms",
}  # fmt: skip


def refuse_removed(data: Mapping[str, Any], file: str | Path) -> None:
    """Refuse a job that holds a removed key.

    Raises:
        InputError: With the key and a remedy.

    """
    for advice, keys in REMEDIES.items():
        for key in keys.split():
            *tables, last = key.split(".")
            places: list[Any] = [data]
            for table in tables:
                inner = [place[table] for place in places if isinstance(place, Mapping) and table in place]
                places = [row for rows in inner for row in (rows if isinstance(rows, list) else [rows])]
            if any(isinstance(place, Mapping) and last in place for place in places):
                name = f"[{last}]" if not tables else key
                raise InputError(f"{name} is no longer supported; {advice}", file=file, where=key)
