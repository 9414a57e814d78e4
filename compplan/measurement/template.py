"""An empty measurement log of a robot, with what each column means."""

from __future__ import annotations

from compplan.measurement.campaign import WRENCH
from compplan.robot import Robot

_HEAD = """\
# Measurement log of {robot}. One row a measured pose, or a sample of a path; rows in time order. # begins a note.
# run              rows of one run were taken without a break: static1 (approached, settled, measured), path1 (moving)
# time_s           since the campaign began
# q                commanded joint positions, as the motor-side encoders read them
# fx_N .. mz_Nm    wrench of the environment on the tool, at the TCP, base axes, weights not in it; all zero: no load
# x_mm y_mm z_mm   measured point, robot base frame (or --register base); another point than the TCP: --target-offset
# temperature_C    of the structure, or the best proxy there is; sigma_mm: standard deviation of the instrument, an axis
# Columns that you do not have may be left out, but run, q and x y z. Further ones: mode, target, rx_deg ry_deg rz_deg,
# q1_link_deg, q1_motor_deg, sigma_deg. Measure some poses twice, with others between: they show the noise.
"""


def write_log_text(robot: Robot) -> str:
    """Write the head of an empty log of a robot.

    Args:
        robot: The robot: how many joints it has, and which of them slide.
    """
    wrench = [f"{name}_{'N' if number < 3 else 'Nm'}" for number, name in enumerate(WRENCH)]
    columns = ["run", "time_s", *robot.joint_headers, *wrench, "x_mm", "y_mm", "z_mm", "temperature_C", "sigma_mm"]
    return _HEAD.format(robot=robot.name) + ",".join(columns) + "\n"
