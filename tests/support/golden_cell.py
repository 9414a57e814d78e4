"""A cell whose numbers can be worked out by hand: an arm, with or without a rail, counted by each controller its way.

Unturned, the upper arm stands upright and the forearm lies along x; the rail runs along y. All lengths in mm. Joints
two and three turn about -y: positive lifts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from compplan.controllers.readback.poses import Pose, shift, turn

#: Tool seen from the flange as controllers see it (z out of the flange): off the axis, and turned by 30 deg about z,
#: then 20 deg about the new y, then 10 deg about the newest x.
TOOL = shift(-50.0, 30.0, 140.0) @ turn("z", 30.0) @ turn("y", 20.0) @ turn("x", 10.0)
#: The flange of the URDF has x out of the flange: its z axis is -x of the controllers'.
FLANGE = turn("y", 90.0)
#: The part is turned by 120 deg about (1, 1, 1): its x, y, z axes are y, z, x of the base.
PART = np.array([[0.0, 0, 1, 1300], [1, 0, 0, -200], [0, 1, 0, 700], [0, 0, 0, 1]])
PART_ROTATION = 120.0 / math.sqrt(3.0)  #: each component of the rotation vector
FEED = 12.5
#: Mass of the tool, and its centre: the job states (60, 7, -20) mm in the URDF's flange frame, whose x is out of the
#: flange; z of the controllers' flange is that x, their x its -z.
MASS, CENTRE = 4.5, (20.0, 7.0, 60.0)
#: Waypoints in the part frame: x, y, z, direction of the tool axis (of any length), rapid.
WAYPOINTS = np.array(
    [
        [0.0, 80, 0, 0.1, 1, -0.2, 1],
        [0, 0, 0, 0.1, 1, -0.2, 0],
        [10, 2, 0, 0.1, 1, -0.15, 0],
        [20, 3, 5, 0.1, 1, -0.1, 0],
        [30, 3, 15, 0.1, 1, -0.1, 0],
        [30, 80, 15, 0.1, 1, -0.1, 1],
        [-40, 80, 30, -0.1, 1, 0.1, 1],
        [-40, 1, 30, -0.1, 1, 0.1, 0],
        [-45, 1, 40, -0.1, 1, 0.2, 0],
        [-45, 80, 40, -0.1, 1, 0.2, 1],
    ]
)


@dataclass(frozen=True)
class Counting:
    """Hold how a controller counts: the lines of controller.toml, and the same undone by hand.

    `undo` takes the controller's arm joints and the rail (None without one); it returns the slide [mm] and six angles
    of the URDF [deg]. `counted` is what the controller shows at a slide of 100 mm and 10, 20, 30, 40, 50, 60 deg.
    """

    toml: str
    undo: Callable[[tuple[float, ...], float | None], tuple[float, ...]]
    counted: tuple[float, ...]
    rail: bool = True
    #: Native words of shoulder (front, back), elbow (up, down) and wrist (noflip, flip).
    words: tuple[tuple[str, str], ...] = ()
    #: Frame that the controller's frames count from, seen from the base, as worked out by hand.
    world: Pose = field(default_factory=lambda: np.eye(4))


NAMES = 'joint_names = ["E1", "A1", "A2", "A3", "A4", "A5", "A6"]'
COUNTING = {
    "krl": Counting(
        f"{NAMES}\nsign = [-1, -1, -1, -1, 1, -1, 1]\nzero_deg = [250.0, 5.0, -90.0, 90.0, -20.0, 5.0, -35.0]",
        lambda a, e: (250 - e, 5 - a[0], -90 - a[1], 90 - a[2], a[3] + 20, 5 - a[4], a[5] + 35),
        (150.0, -5.0, -110.0, 60.0, 20.0, -45.0, 25.0),
    ),
    "fanuc_ls": Counting(
        "sign = [1, 1, -1, 1, -1, 1, -1]\nzero_deg = [-30.0, 0.0, 0.0, 0.0, 90.0, 0.0, 180.0]\n"
        "coupling = [[0,0,0,0,0,0,0],[0,0,0,0,0,0,0],[0,0,0,0,0,0,0],[0,0,1,0,0,0,0],[0,0,0,0,0,0,0],"
        "[0,0,0,0,0,0,0],[0,0,0,0,0,0.5,0]]",
        lambda a, e: (e + 30, a[0], -a[1], a[2] + a[1], 90 - a[3], a[4], 180 + 0.5 * a[4] - a[5]),
        (70.0, 10.0, -20.0, 50.0, 50.0, 50.0, 145.0),
        words=(("T", "B"), ("U", "D"), ("N", "F")),
        world=shift(0, 0, 450),
    ),
    "rapid": Counting(
        "sign = [-1, 1, -1, -1, 1, -1, 1]\nzero_deg = [1000.0, -5.0, 0.0, 10.0, 0.0, 0.0, 90.0]",
        lambda a, e: (1000 - e, a[0] + 5, -a[1], 10 - a[2], a[3], -a[4], a[5] - 90),
        (900.0, 5.0, -20.0, -20.0, 40.0, -50.0, 150.0),
        world=shift(100, -200, 300) @ turn("z", 90),
    ),
    "csv": Counting(
        f"{NAMES}\nsign = [1, -1, 1, -1, 1, -1, 1]\nzero_deg = [7.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]",
        lambda a, e: (e - 7, 1 - a[0], a[1] - 2, 3 - a[2], a[3] - 4, 5 - a[4], a[5] - 6),
        (107.0, -9.0, 22.0, -27.0, 44.0, -45.0, 66.0),
    ),
    "sinumerik": Counting(
        f"{NAMES}\nsign = [1, -1, -1, -1, 1, -1, 1]\nzero_deg = [-20.0, 5.0, -90.0, 90.0, -20.0, 5.0, -35.0]",
        lambda a, e: (e + 20, 5 - a[0], -90 - a[1], 90 - a[2], a[3] + 20, 5 - a[4], a[5] + 35),
        (80.0, -5.0, -110.0, 60.0, 20.0, -45.0, 25.0),
        world=shift(0, 0, 250),
    ),
    "kawasaki_as": Counting(
        "sign = [-1, 1, 1, -1, 1, 1, -1]\nzero_deg = [40.0, 0.0, 90.0, 0.0, 0.0, -5.0, 0.0]",
        lambda a, e: (40 - e, a[0], a[1] - 90, -a[2], a[3], a[4] + 5, -a[5]),
        (-60.0, 10.0, 110.0, -30.0, 40.0, 45.0, -60.0),
        world=shift(10, 20, 30),
    ),
    "urscript": Counting(
        "sign = [1, -1, 1, 1, 1, 1]\nzero_deg = [180.0, -90.0, 0.0, 0.0, 0.0, 15.0]",
        lambda a, e: (0.0, a[0] - 180, -90 - a[1], a[2], a[3], a[4], a[5] - 15),
        (190.0, -110.0, 30.0, 40.0, 50.0, 75.0),
        rail=False,
        world=turn("z", 180),
    ),
    "inform": Counting(
        "sign = [1, 1, 1, -1, -1, -1]\nzero_deg = [0.0, 0.0, 0.0, 0.0, 0.0, 30.0]\n"
        "coupling = [[0,0,0,0,0,0],[0,0,0,0,0,0],[0,-1,0,0,0,0],[0,0,0,0,0,0],[0,0,0,0,0,0],[0,0,0,0,0,0]]",
        lambda a, e: (0.0, a[0], a[1], a[2] + a[1], -a[3], -a[4], 30 - a[5]),
        (10.0, 20.0, 10.0, -40.0, -50.0, -30.0),
        rail=False,
        world=shift(0, 0, 500),
    ),
    "val3": Counting(
        "sign = [1, -1, 1, -1, 1, -1]\nzero_deg = [0.0, 0.0, 90.0, 0.0, -10.0, 45.0]",
        lambda a, e: (0.0, a[0], -a[1], a[2] - 90, -a[3], a[4] + 10, 45 - a[5]),
        (10.0, -20.0, 120.0, -40.0, 40.0, -15.0),
        rail=False,
        words=(("righty", "lefty"), ("epositive", "enegative"), ("wpositive", "wnegative")),
        world=shift(0, 0, 500),
    ),
}

WORLDS = {
    "fanuc_ls": "[world]\nposition_mm = [0.0, 0.0, 450.0]\n",
    "rapid": "[world]\nposition_mm = [100.0, -200.0, 300.0]\nrotation_deg = [0.0, 0.0, 90.0]\n",
    "val3": "[world]\nposition_mm = [0.0, 0.0, 500.0]\n",
    "sinumerik": "[world]\nposition_mm = [0.0, 0.0, 250.0]\n",
    "kawasaki_as": "[world]\nposition_mm = [10.0, 20.0, 30.0]\n",
    "urscript": "[world]\nrotation_deg = [0.0, 0.0, 180.0]\n",
    "inform": "[world]\nposition_mm = [0.0, 0.0, 500.0]\n",
}
WORDS = """
[configuration.shoulder]
point = "link_5"
frame = "link_1"
axis = "x"
above = "front"
below = "back"
status = { front = 0, back = 1 }
%s
[configuration.elbow]
joint = "joint_3"
threshold_deg = 90.0
above = "down"
below = "up"
status = { up = 2, down = 0 }
%s
[configuration.wrist]
joint = "joint_5"
threshold_deg = 5.0
above = "flip"
below = "noflip"
status = { noflip = 0, flip = 4 }
%s
"""


def forward(slide: float, angles: tuple[float, ...]) -> Pose:
    """Return the flange as the controller sees it, base frame. [mm]"""
    q1, q2, q3, q4, q5, q6 = angles
    arm = turn("z", q1) @ shift(300, 0, 0) @ turn("y", -q2) @ shift(0, 0, 800) @ turn("y", -q3) @ shift(200, 0, 0)
    wrist = turn("x", q4) @ shift(500, 0, 0) @ turn("y", q5) @ turn("x", q6) @ shift(150, 0, 0)
    return shift(0, slide, 500) @ arm @ wrist @ FLANGE


def rotation_vector(rotation: np.ndarray) -> list[float]:
    """Return axis times angle of a rotation by less than 180 deg. [deg]"""
    angle = math.acos((np.trace(rotation) - 1) / 2)
    x, y, z = rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    return [float(math.degrees(angle) / (2 * math.sin(angle)) * value) for value in (x, y, z)]


def _joint(number: str, kind: str, parent: str, child: str, xyz: str, axis: str, limit: float) -> str:
    head = (
        f'<link name="{child}"/><joint name="{number}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
    )
    if kind == "fixed":
        return f'{head}<origin xyz="{xyz}" rpy="{axis}"/></joint>'
    bounds = f'<limit lower="{-limit}" upper="{limit}" velocity="2" effort="1000"/>'
    return f'{head}<origin xyz="{xyz}"/><axis xyz="{axis}"/>{bounds}</joint>'


def write_robot(folder: Path, language: str) -> Path:
    """Write the robot folder of a controller: rigid, so that the command is the path."""
    counting = COUNTING[language]
    folder.mkdir(parents=True)
    root = "carriage" if counting.rail else "base"
    parts = [_joint("rail", "prismatic", "base", "carriage", "0 0 0", "0 1 0", 1.5)] if counting.rail else []
    parts += [
        _joint("joint_1", "revolute", root, "link_1", "0 0 0.5", "0 0 1", 3),
        _joint("joint_2", "revolute", "link_1", "link_2", "0.3 0 0", "0 -1 0", 2),
        _joint("joint_3", "revolute", "link_2", "link_3", "0 0 0.8", "0 -1 0", 2.5),
        _joint("joint_4", "revolute", "link_3", "link_4", "0.2 0 0", "1 0 0", 3.1),
        _joint("joint_5", "revolute", "link_4", "link_5", "0.5 0 0", "0 1 0", 2.2),
        _joint("joint_6", "revolute", "link_5", "link_6", "0 0 0", "1 0 0", 6),
        _joint("flange_joint", "fixed", "link_6", "flange", "0.15 0 0", "0 0 0", 0),
        _joint("tool0_joint", "fixed", "flange", "tool0", "0 0 0", f"0 {math.pi / 2!r} 0", 0),
    ]
    (folder / "robot.urdf").write_text(f'<robot name="golden"><link name="base"/>{"".join(parts)}</robot>')
    (folder / "elasticity.toml").write_text('schema = 1\ntcp = "tool0"\nflange = "flange"\n')
    names = (("front", "back"), ("up", "down"), ("noflip", "flip"))
    native = [
        f'native = {{ {name[0]} = "{word[0]}", {name[1]} = "{word[1]}" }}'
        for name, word in zip(names, counting.words, strict=False)
    ]
    words = WORDS % tuple(native or ["", "", ""])
    head = f'schema = 1\ncontroller = "golden"\n{counting.toml}\n'
    (folder / "controller.toml").write_text(head + WORLDS.get(language, "") + words)
    return folder


def write_job(folder: Path, language: str, *, fills: bool = True) -> Path:
    """Write a job for the cell, its robot and its toolpath."""
    write_robot(folder / "cell", language)
    axes = WAYPOINTS[:, 3:6] / np.linalg.norm(WAYPOINTS[:, 3:6], axis=1)[:, None]
    table = np.column_stack([WAYPOINTS[:, :3], axes, np.full(len(WAYPOINTS), FEED), WAYPOINTS[:, 6]])
    rows = [",".join(f"{value:.17g}" for value in row) for row in table]
    (folder / "path.csv").write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid", *rows, ""]))
    tool = FLANGE @ TOOL
    file = folder / "golden.toml"
    file.write_text(
        f'schema = 1\nname = "golden"\nrobot = "cell"\ntoolpath = "path.csv"\n'
        f"[part]\nposition_mm = {PART[:3, 3].tolist()}\nrotation_deg = {[PART_ROTATION] * 3}\n"
        f"[tool]\nposition_mm = {tool[:3, 3].tolist()}\nrotation_deg = {rotation_vector(tool[:3, :3])}\n"
        f"mass_kg = {MASS}\ncentre_of_mass_mm = [60.0, 7.0, -20.0]\n"
        f'[process]\nmodel = "constant"\nforce_N = [0.0, 0.0, 0.0]\n'
        f'[plan]\nstrategy = "none"\nrotate_about_tool_axis = false\ntool_x = [0.0, 0.0, 1.0]\n'
        f"[feed]\ncorner_tolerance_mm = 0.0\n"
        f'[output]\nform = "both"\nfit_tolerance_mm = 0.0\nprograms = ["{language}"]\n'
        f"cell = {{ overwrite = {'true' if fills else 'false'} }}\n"
    )
    return file
