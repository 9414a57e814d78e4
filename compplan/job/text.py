"""The commented job that `compplan init` writes; every key of `compplan.job.job` stands in it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.job.names import STRATEGIES
from compplan.path.cam import READERS, list_suffixes
from compplan.path.forces.materials import MATERIALS
from compplan.program import WRITERS
from compplan.program.pendant import locate_pendant
from compplan.robot import Robot
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis

#: Tables of a short job, and which of their keys; None: all that count.
SHORT: dict[str, tuple[str, ...] | None] = {
    "toolpath": None, "part": None, "tool": None, "process": None, "plan": ("strategy", "tolerance_mm"),
    "output": ("programs",),
}  # fmt: skip

_TEXT = """\
# A compplan job. Lengths in mm, angles in deg, forces in N: the unit is in the name of each key.
# Lines that begin with a single # before a key show its default or an alternative. Unknown keys are refused.

schema = 1
name = "My part"
robot = "staubli_tx200"             # a folder in robots/, or a path to one (relative to this file)

# The toolpath is a file, relative to this one: .csv, or CAM (<readers>): <suffixes>
# toolpath = "part.nc"
# or it is computed:
[toolpath]
generator = "isf_cone"              # circle | spiral | isf_cone
diameter_mm = 40.0                  # isf_cone: upper rim
depth_mm = 15.0
wall_angle_deg = 45.0               # against the horizontal
pitch_mm = 1.0                      # depth of one turn
path = "helical"                    # helical | z_level
# radius_mm = 10.0                  # circle; further: turns (negative: clockwise), centre_mm, start_deg,
                                    #   plane = "xy" | "xz" | "yz"
# outer_radius_mm = 250.0           # spiral; further: inner_radius_mm, and turns or length_mm, centre_mm
feed_mm_s = 20.0                    # or duration_s = 100.0
step_mm = 1.0                       # distance of waypoints, or waypoints = 1000, or rate_hz = 100.0
axis = [0.0, 0.0, 1.0]              # tool axis, tip to spindle, part axes
approach_mm = 20.0                  # height of the rapid approach and retract; 0: none

[part]                              # pose of the part frame, seen from the robot base
position_mm = [1500.0, 0.0, 183.0]
rotation_deg = [0.0, 0.0, 0.0]      # rotation vector; or one of abc_deg (KUKA A B C), wpr_deg (FANUC W P R, Yaskawa
                                    #   Rx Ry Rz), quaternion (ABB: w x y z), zyz_deg (Kawasaki O A T, Comau A E R,
                                    #   Doosan A B C), val3_deg (Staubli), rotation_rad (Universal Robots)
# in place of both, points measured in the robot base: best fit of three or more,
# points_mm = { nominal = [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 80.0, 0.0]], measured = [[..], [..], [..]] }
# or 3-2-1: three of the face z = 0 (counter-clockwise from above), two along x on y = 0, one on x = 0
# datum_mm = { plane = [[..], [..], [..]], line = [[..], [..]], point = [..] }

# [tool]                            # in place of the robot folder's TCP and tool mass: from flange frame to TCP frame
# frame = "flange"                  # flange: of the URDF | pendant: the maker's, as the teach pendant shows tool data
# position_mm = [0.0, 0.0, 150.0]
# rotation_deg = [0.0, 0.0, 0.0]    # or another form, as in [part]
# mass_kg = 5.0
# centre_of_mass_mm = [0.0, 0.0, 60.0]  # in the same frame

# [[tool]]                          # in place of [tool], for a CAM file of several tools: one for each T number, with
# number = 1                        #   the keys of [tool] and, if another force acts there:
# process = { model = "drill", diameter_mm = 5.0 }  # laid over [process]; one plan and program for each tool
# [tools]                           # or a table of tools, [tool] is then the spindle: CSV (number, length_mm, ..),
# file = "tools.csv"                #   Fusion, HSM, LinuxCNC or Heidenhain. unit = "mm" where it says none

[process]                           # what the environment does to the tool, at the tip
model = "isf"                       # columns | constant | milling | isf | file, from what is given here, and
                                    #   end_mill | drill | isf_regression | friction_stir | grinding, from material
axial_N = 1200.0                    # isf: along the tool axis towards the spindle, at the end of the path
lateral_N = 400.0                   # isf: away from the wall that is formed
drag_N = 0.0                        # isf: against the travel
start_share = 0.4                   # isf: share of these forces at the start; they grow linearly along the path
wall_side = "right"                 # isf: side of the wall, seen down the tool axis along the travel
ramp_mm = 20.0                      # all but columns, end_mill, drill: grows from 0 over this length after contact
ramp_out_mm = 0.0                   # ... and falls to 0 over this length before the tool leaves. 0: the tool stands
                                    #   where it touches (or leaves) while force and correction come (or go) together
# model = "columns"                 # fx_N .. mz_Nm of the toolpath file, part axes
# required = true                   # columns: refuse a file without them
# model = "constant"
# force_N = [0.0, 0.0, -600.0]
# moment_Nm = [0.0, 0.0, 0.0]
# frame = "part"                    # constant, file: part | base | tool (TCP frame, see tool_x) | path (x travel)
# during_rapid = false              # constant: acts in rapid moves too (a dead weight)
# model = "milling"                 # mean force of a revolution, clockwise spindle
# depth_mm = 2.0                    # axial depth of cut
# width_mm = 6.0                    # radial width of cut
# diameter_mm = 12.0
# spindle_rpm = 8000.0
# kc_N_mm2 = 800.0                  # specific cutting force
# radial_ratio = 0.4                # radial and axial force as shares of the tangential one; axial > 0: towards spindle
# axial_ratio = 0.0
# material_side = "right"           # right: climb milling
# stock_top_mm = 0.0                # z of the part; no force above. Left out: 0 in CAM files that move above and below
# model = "end_mill"                # force from what the cutter meets of the stock along the path, clockwise spindle
# diameter_mm = 10.0
# teeth = 2
# spindle_rpm = 12000.0
# corner_radius_mm = 0.0            # end_mill: half of the diameter is a ball
# helix_deg = 30.0                  # end_mill: of the ripple; the mean does not depend on it
# runout_mm = 0.0                   # end_mill: of the ripple
# flute_mm = 30.0                   # left out: three diameters, assumed
# material = "al7075_t6"            # <materials>
# materials = "materials.toml"      # a file of your own: coefficients under each name that material then may be
# coefficients = { cutting_N_mm2 = [800.0, 300.0, 150.0], edge_N_mm = [15.0, 12.0, 2.0], exponent = [0.0, 0.0, 0.0],
#                  uncertainty = 0.1, source = "own tests" }  # in place of a material: tangential, radial, axial
# stock = { block_mm = [[0.0, 0.0, -20.0], [100.0, 80.0, 0.0]] }  # or { mesh = "blank.stl", unit = "mm" }; left out:
#                                   #   a block below stock_top_mm that is wider than the path, assumed
# model = "drill"                   # the keys of end_mill but corner_radius_mm, helix_deg and runout_mm, and
# point_deg = 118.0
# web_thinned = true                # false: a conventional chisel edge, thrust about 1.7 times (assumed)
# model = "isf_regression"          # steady force by the regression of Aerens and others (2010)
# thickness_mm = 1.2
# tool_diameter_mm = 10.0
# tensile_N_mm2 = 110.0             # or material = "aa3003_o" | "aa5754_h22" | "dc01" | "aisi304" (assumed strengths)
# wall_angle_deg = 45.0             # left out: from the path, as is the step-down
# step_down_mm = 1.0
# build_up_mm = 5.0                 # depth over which the force grows; left out: the tool's radius, assumed
# friction = 0.1                    # assumed
# model = "friction_stir"           # torque by Schmidt and others (2004)
# shoulder_diameter_mm = 15.0
# probe_diameter_mm = 5.0
# probe_length_mm = 4.0
# shoulder_cone_deg = 0.0
# shear_N_mm2 = 25.0                # contact shear stress at welding temperature
# axial_N = 5000.0                  # or pressure_N_mm2 = 30.0 under the shoulder
# traverse_ratio = 0.12             # traverse and side force as shares of the axial one, assumed
# side_ratio = 0.05
# clockwise = true
# model = "grinding"                # sanding with normal_N, or removal by its specific energy
# normal_N = 40.0
# specific_energy_J_mm3 = 30.0      # in place of normal_N: with depth_mm, width_mm and
# wheel_speed_m_s = 30.0
# force_ratio = 0.45                # tangential by normal force, assumed
# direction = "against"             # tangential force against | along the travel
# model = "file"                    # CSV: fx_N .. mz_Nm, a row a waypoint, or with s_mm, the length cut so far
# file = "wrench.csv"

# [coupling]                        # the force depends on where the tool is; left out: it acts as if on the path
# stiffness_N_mm = [200.0, 200.0, 200.0]  # the force falls by this as the tool gives way (a sheet), along x y z of
# frame = "part"                    #   part | base | path (x travel, z tool axis)
# from_model = true                 # in place of stiffness_N_mm: derivative of the force of end_mill or drill

# [stability]                       # chatter of an end mill: compplan forces judges it; left out: it does not
# judge = true
# avoid = false                     # true: a posture whose cut chatters (zero-order solution) costs more
# damping = 0.03                    # assumed: share of critical damping of the robot's modes
# modes = "modes.csv"               # measured modes of tool and holder: frequency_Hz, damping, mass_kg, x, y, z
# frequency_spread = 0.1            # assumed: how far the robot's frequencies and damping may be off, for the
# damping_spread = 0.4              #   probability of chatter (standard deviations of the logarithm)

[plan]
strategy = "nlp"                    # <strategies>
rotate_about_tool_axis = true       # the redundant degree of freedom is free
configuration = "auto"              # or { shoulder = "front", elbow = "up", wrist = "noflip" }, any of them
# start_deg = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]   # start near these joint positions (prismatic joints in mm)
max_correction_mm = 10.0
tolerance_mm = 0.1                  # in-tolerance verdicts and shares refer to it
tool_x = [1.0, 0.0, 0.0]            # part axes: where the TCP frame's x points when rotation about the axis is not free
keep = "robot"                      # posture: robot (with --robot that which the job's own robot chooses) | nothing |
                                    #   joints.csv of an earlier plan
inertia = true                      # compensate the inertia of the motion (masses of the URDF); the band counts it

[output]
programs = ["val3"]                 # <programs>
form = "linear"                     # linear: lines and arcs of the tool where the language has them, else joint moves |
                                    #   joint | both
fit_tolerance_mm = 0.002            # how far lines and arcs may lie beside the corrected tip; 0: a move a waypoint
any_brand = false                   # true: programs for another brand than the robot's controller too
# header = { val3 = "spindle_on.txt" }  # lines of the language before the first move (spindle, coolant), as they are
# footer = { val3 = "spindle_off.txt" } # ... and after the last; files relative to this one
# io = { spindle = 3, coolant = 4 } # signals for what the CAM file switches: spindle, spindle_reverse, spindle_ready
                                    #   (input), spindle_wait_s, coolant, mist, tool_change (a program), optional_stop
                                    #   (input), signals = { "$OUT[3]" = 5 }; numbers, names in RAPID and VAL3.
                                    #   Left out: the program stops there and asks the operator
# max_points_per_file = 5000        # programs are cut into files; left out: what each controller takes

[sampling]                          # how cutting moves are divided; left out: toolpath files at 1 mm, others not at all
# max_step_mm = 1.0
# max_turn_deg = 1.0                # turn of the tool axis in a step
# chord_mm = 0.01                   # the loaded tip between waypoints; left out: a tenth of the tolerance

[cam]                               # what a CAM file does not say by itself
# unit = "mm"                       # mm | inch, for files that do not say
chord_tolerance_mm = 0.001          # greatest distance between an arc and its chords
# arc_centres = "incremental"       # G-code I J K: incremental | absolute | reversed, for files that do not say
# feed_mm_s = 10.0                  # feed of cutting moves for which the file states none, or 0
# machine = "trunnion_ac"           # rotary axes by name (compplan doctor lists them), or NAME.toml beside the CAM file
# rotary = "head"                   # A B C words turn the head (tool) | table (part) | head_table | ignore; a file
                                    #   whose A B C turn something is refused without it
# rotary_axes = ["A", "C"]          # the axis that carries the other first (head_table: the head's); "-C": left-handed
# rotary_centre_mm = [0.0, 0.0, 0.0]  # files without G43.4, TRAORI, M128: first table axis from the part zero
rotary_offset_mm = [0.0, 0.0, 0.0]  # ... and from there to the second
# pivot_mm = 250.0                  # ... and from the tool tip to where the axes of the head meet
tip_control = false                 # true: X Y Z are the tip in the part frame though the file has none of these words
# compensation = "centre_line"      # files with G41, G42, RL, RR hold the path of the tool's centre; else refused
# wcs = "G54"                       # the work offset that is the part frame, in a file that cuts in several
# tilt_angles = "spatial"           # what cycle 19 of Heidenhain programs states
cycles = "expand"                   # drilling cycles: expand into cutting moves | skip
# tool_direction = "z"              # robot programs: the axis of the TCP frame that points out of the tool
# operation = 2                     # only what the file does with its second tool (operations count from 1)
# strict = true                     # refuse a file read with any note; as [toolpath] file = "..", strict = true
circle_sense = "auto"               # APT CIRCLE: auto | right_hand | left_hand about its axis

[feed]
# constant_mm_s = 10.0              # in place of the toolpath's own feed
mode = "programmed"                 # programmed: an upper bound | constant: one feed for the whole cut
# corner_tolerance_mm = 0.025       # corners are rounded by this much, so that the tool does not rest there; the band
                                    #   counts it. Left out: a quarter of the tolerance for files whose force does not
                                    #   turn with the travel. 0: the tool rests
torque_limits = false               # keep the joint torques (inertia, weight, wrench) within the URDF's efforts

[limits]
velocity_scale = 1.0                # share of the robot's joint rates that the plan may use
acceleration_scale = 1.0

[posture]                           # configuration, rotation about the tool axis and extra axes are chosen for this
preset = "accurate"                 # accurate (least remaining deviation) | promise (least band, by what is known of
                                    #   the robot) | smooth (little motion) | fast
# weights = { motion = 1e-5 }       # in place of the preset's, in mm^2 of squared sensitivity: sensitivity, deviation,
                                    #   travel (per mm^2; travel: what joint motion does to accuracy), limits,
                                    #   dexterity, singularity, stability, rate (per unit), time (per s),
                                    #   motion (per (rad / 100 mm)^2)
measure = "expected"                # remaining deviation: expected (root mean square) | p95
wrench_uncertainty = 0.1            # assumed: relative error of each component of the wrench, one standard deviation
compliance_uncertainty = 0.1        # assumed: relative error of each elastic coordinate
joint_zero_uncertainty_deg = 0.0    # assumed: error of each joint's zero
spin_step_deg = 5.0                 # grid of rotations about the tool axis, refined afterwards
lead_deg = 0.0                      # how far the tool axis may lean along the travel
lean_deg = 0.0                      # ... and across it
limit_margin_deg = 10.0             # distance from joint limits that is kept, unless no way along the path keeps it
singularity_margin = 0.03           # inverse condition number (0: singular, 1: best) that costs steeply from here down
reconfigure = "rapid"               # configuration may change in rapid moves away from the part: rapid | never

[place]                             # compplan place: where the part may stand; left out: 500 mm around its place
# x_mm = [1000.0, 2000.0]
# y_mm = [-500.0, 500.0]
# z_mm = [0.0, 500.0]
base_height_mm = [0.0, 0.0]         # how far the robot base may be raised
step_mm = 100.0                     # of the grid, refined afterwards
turn_deg = [0.0]                    # turns of the part about the vertical through its origin

[noise]                             # Monte Carlo: one standard deviation each; what is left out takes the value shown,
                                    #   assumed or from literature: measure your own where it matters
robot = "spread"                    # spread: robots by the keys below | posterior: by the folder's uncertainty.toml,
                                    #   or widths assumed by its grade; the keys of the robot are then left out
joint_compliance = 0.10             # assumed: relative error of each joint spring (log-normal)
link_compliance = 0.20              # assumed: of each elastic link, bearing or extra spring (log-normal)
joint_zero_deg = 0.003              # assumed, after calibration, as are the geometry errors
geometry_mm = 0.03                  # of each placement in the chain, an axis
geometry_deg = 0.001
tool_frame_mm = 0.03                # assumed
part_frame_mm = 0.05                # assumed: part touched off with the robot
part_frame_deg = 0.005
backlash_deg = 0.002                # assumed: full width
gear_error_deg = 0.002              # assumed: amplitude of an error periodic in the joint's angle ...
gear_periods = 60.0                 # ... with so many periods a turn
wrench_level = 0.15                 # assumed: relative error of the predicted level
wrench_direction_deg = 3.0          # assumed
wrench_path = 0.05                  # assumed: relative variation of the level along the path ...
correlation_mm = 20.0               # ... over this distance
motor_encoder_deg = 0.0003          # assumed, at the joint
link_encoder_deg = 0.0008           # assumed
# repeatability_mm = 0.02           # left out: the robot folder's, else 0.02 assumed
temperature_K = 3.0                 # assumed: difference from the calibration
expansion_per_K = 12e-6             # handbook
force_noise_N = 2.0                 # force sensor, assumed: noise, drift since taring, gain
moment_noise_Nm = 0.1
force_bias_N = 5.0
moment_bias_Nm = 0.5
force_gain = 0.01
tracker_mm = 0.015                  # laser tracker, datasheets: 15 um + 6 um/m
tracker_mm_per_m = 0.006
plant_lag_ms = 13.5                 # how the robot follows online corrections, derived from Johra 2022
plant_delay_ms = 37.0
# [[noise.effects]]                 # any effect of the vocabulary (compplan.effects), one table each:
# effect = "link_compliance"        # parameters are standard deviations in SI, as in effects.toml
# joint = "joint_2"
# axis = "rx"
# parameters = { compliance_rad_per_Nm = 1e-8 }

# [collision]                       # meshes that the arm keeps clear of, relative to this file
# part = "part.stl"
# fixture = "fixture.stl"
# tool = "tool.stl"
# unit = "mm"                       # of the meshes: mm | m | inch
# clearance_mm = 5.0                # least distance that is allowed
# tip_zone_mm = 30.0                # the tool within this distance of its tip may touch the part
# self_collision = true             # keep the arm clear of itself too
# without_shapes = ["link_2"]       # links that move and are checked without their shapes; else such an arm is refused
"""


def write_job_text() -> str:
    """Write the commented job; what can be chosen stands as the registries say it."""
    choices = {
        "<strategies>": " | ".join(STRATEGIES),
        "<programs>": " | ".join(WRITERS),
        "<materials>": " | ".join(MATERIALS),
        "<readers>": ", ".join(READERS),
        "<suffixes>": " ".join(list_suffixes()),
    }
    text = _TEXT
    for mark, names in choices.items():
        text = text.replace(mark, names)
    return text


def mount_tool(text: str, robot: Robot, *, used: bool) -> str:
    """Let the tool of a job's text leave the flange of its robot straight.

    Args:
        text: The commented job.
        robot: The robot as its folder has it.
        used: Whether the table counts where the folder's own TCP is on the flange; otherwise it stays a comment.

    """
    tool, out = mounted_tool(robot), outward_axis(robot)
    pendant = locate_pendant(robot)
    head, table, rest = re.split(r"(# \[tool\].*?\n)(?=\n)", text, maxsplit=1, flags=re.DOTALL)
    if pendant is not None and pendant.stated:
        frame, said, turn, out = "pendant", "z of the maker's flange frame", np.zeros(3), pendant.pose[:3, :3].T @ out
    else:
        frame, said = "flange", f"{name_axis(out)} of the flange frame"
        turn = Rotation.from_matrix(tool[:3, :3]).as_rotvec(degrees=True)
    for key, value in {"position_mm": 150.0 * out, "rotation_deg": turn, "centre_of_mass_mm": 60.0 * out}.items():
        numbers = [round(float(number), 3) + 0.0 for number in value]
        table = re.sub(rf"# {key} = \[.*?\]", f"# {key} = {numbers}", table)
    table = table.replace('# frame = "flange" ', f'# frame = "{frame}" ')
    straight = f"# {said} leaves this robot; length and mass are assumed: put yours\n"
    first, _, keys = table.partition("\n")
    if used and not tool[:3, 3].any():
        first, keys = first.removeprefix("# "), "".join(line.removeprefix("# ") for line in keys.splitlines(True))
    return f"{head}{first}\n{straight}{keys}{rest}"


def number_tools(text: str, numbers: Sequence[int]) -> str:
    """Let a job's text have one [[tool]] for each T number, all like its [tool]; one number leaves it as it is."""
    found = re.search(r"(?m)^(?:# )?\[tool\].*?\n(?=\n)", text, flags=re.DOTALL)
    if found is None or len(numbers) < 2:
        return text
    keys = found.group().partition("\n")[2].replace("# ", "") if found.group().startswith("# ") else None
    blocks = []
    for number in numbers:
        body = found.group().partition("\n")[2] if keys is None else keys
        blocks.append(f"[[tool]]                            # T{number} of the CAM file\nnumber = {number}\n{body}")
    return text[: found.start()] + "\n".join(blocks) + text[found.end() :]


def set_place(text: str, position_mm: list[float], comment: str) -> str:
    """Put the part of a job's text elsewhere."""
    return re.sub(r"(?<=\[part\]).*?\nposition_mm = \[.*?\].*?(?=\n)",
                  lambda found: re.sub(r"position_mm = .*", f"position_mm = {position_mm}  # {comment}", found.group()),
                  text, count=1, flags=re.DOTALL)  # fmt: skip


def set_force(text: str, axial: float, lateral: float, comment: str) -> str:
    """Put other forces of sheet forming into a job's text. [N]"""
    for key, value in (("axial_N", axial), ("lateral_N", lateral)):
        text = re.sub(rf"(?m)^{key} = [^#\n]*# ", f"{f'{key} = {value}':<36}# {comment}; ", text, count=1)
    return text


def shorten_job(text: str) -> str:
    """Return the keys of a commented job that one needs first, with their comments."""
    kept, table = ["# A compplan job: the keys that one needs first. All of them: compplan init without --short."], ""
    for line in text.splitlines():
        if line.startswith("["):
            table = line.lstrip("[").partition("]")[0]
            kept += ["", line] if table in SHORT else []
        elif line.startswith("#"):
            kept += [line] if "assumed: put yours" in line and table in ("tool", "process") else []
        elif line and (not table or table in SHORT):
            wanted = SHORT[table] if table else None
            kept += [line] if wanted is None or line.partition(" = ")[0] in wanted else []
    return "\n".join(kept) + "\n"
