"""Robots of four and five joints: gantries plan like an arm; palletisers and SCARAs keep their tool where it points."""

from xml.etree import ElementTree

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.planning.plan import PlanOptions, plan_compensation
from compplan.robot import read_robot_folder
from compplan.statics.chain import build_chain, locate_frames
from compplan.toolpath.generators import CircleTable
from compplan.toolpath.toolpath import place_toolpath

AXES = [
    ("x", "prismatic", "1 0 0"), ("y", "prismatic", "0 1 0"), ("z", "prismatic", "0 0 1"), ("c", "revolute", "0 0 1"),
    ("a", "revolute", "1 0 0"),
]  # fmt: skip


def write_gantry(folder):
    """Write a gantry whose spindle hangs down from a turning and a tilting axis."""
    root = ElementTree.Element("robot", name="gantry")
    ElementTree.SubElement(root, "link", name="base")
    parent = "base"
    for name, kind, axis in AXES:
        ElementTree.SubElement(root, "link", name=f"link_{name}")
        joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
        ElementTree.SubElement(joint, "parent", link=parent)
        ElementTree.SubElement(joint, "child", link=f"link_{name}")
        ElementTree.SubElement(joint, "axis", xyz=axis)
        span = "2.0" if kind == "prismatic" else "3.1"
        ElementTree.SubElement(joint, "limit", lower=f"-{span}", upper=span, velocity="1.0", effort="20000")
        parent = f"link_{name}"
    ElementTree.SubElement(root, "link", name="tool0")
    tool = ElementTree.SubElement(root, "joint", name="tool", type="fixed")
    ElementTree.SubElement(tool, "parent", link=parent)
    ElementTree.SubElement(tool, "child", link="tool0")
    ElementTree.SubElement(tool, "origin", xyz="0 0 -0.3", rpy=f"{np.pi} 0 0")
    soft = {"prismatic": 2e-8, "revolute": 1e-6}
    springs = "".join(f'[[spring]]\njoint = "{name}"\ncompliance = {soft[kind]}\n' for name, kind, _ in AXES)
    head = 'schema = 1\ngrade = "placeholder"\ntcp = "tool0"\nacceleration_limits = [2.0, 2.0, 2.0, 4.0, 4.0]\n'
    folder.mkdir()
    (folder / "robot.urdf").write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    (folder / "elasticity.toml").write_text(head + springs, encoding="utf-8")
    return read_robot_folder(folder)


@pytest.mark.parametrize("angle", [0.3, 0.0])
def test_a_gantry_of_three_slides_and_two_turning_joints_is_planned_tilted_and_flat(tmp_path, angle):
    robot = write_gantry(tmp_path / "gantry")
    pose = np.eye(4)
    pose[:3, 3] = [0.3, -0.2, -0.5]
    path = place_toolpath(CircleTable(radius_mm=100, feed_mm_s=50, waypoints=120).generate(), pose)
    tilt = np.column_stack([np.full(120, np.sin(angle)), np.zeros(120), np.full(120, np.cos(angle))])
    wrench = np.tile([300.0, -200.0, 500.0, 0.0, 0.0, 0.0], (120, 1))
    nominal = type(path)(path.position, tilt, path.feed, path.rapid, wrench, "base")
    plan = plan_compensation(robot, nominal, PlanOptions())
    assert plan.status == "solved", plan.explain_failures()
    assert plan.before.max_deviation > 1e-5 and plan.after.max_deviation < 1e-8
    assert max(plan.between.joint.max(), plan.between.cartesian.max()) < 1e-5


#: Name, kind, axis, origin and, of a joint that follows another, which one and with which factor.
FOUR = {
    "palletiser": [
        ("j1", "revolute", "0 0 1", "0 0 0.6", ""), ("j2", "revolute", "0 1 0", "0.3 0 0.35", ""),
        ("lever2", "revolute", "0 1 0", "0 0 1.2", "j2 -1"), ("j3", "revolute", "0 1 0", "0 0 0", ""),
        ("lever3", "revolute", "0 1 0", "1.3 0 0", "j3 -1"), ("j4", "revolute", "0 0 -1", "0.25 0 -0.1", ""),
    ],
    "scara": [
        ("j1", "revolute", "0 0 1", "0 0 0.5", ""), ("j2", "revolute", "0 0 1", "0.9 0 0", ""),
        ("j3", "prismatic", "0 0 1", "0.9 0 0.3", ""), ("j4", "revolute", "0 0 -1", "0 0 0", ""),
    ],
}  # fmt: skip


def write_four(folder, kind):
    """Write a robot of four joints whose tool hangs down."""
    parts, parent = ['<link name="base"/>'], "base"
    for name, form, axis, origin, follows in FOUR[kind]:
        mimic = f'<mimic joint="{follows.split()[0]}" multiplier="{follows.split()[1]}"/>' if follows else ""
        parts.append(
            f'<link name="link_{name}"/><joint name="{name}" type="{form}"><parent link="{parent}"/>'
            f'<child link="link_{name}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>{mimic}'
            '<limit lower="-2.6" upper="2.6" velocity="2" effort="9000"/></joint>'
        )
        parent = f"link_{name}"
    parts.append(f'<link name="tool0"/><joint name="tool" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
                 f'<origin xyz="0 0 -0.12" rpy="{np.pi} 0 0"/></joint>')  # fmt: skip
    own = [name for name, form, *_, follows in FOUR[kind] if form == "revolute" and not follows]
    springs = [f'[[spring]]\njoint = "{name}"\ncompliance = 3e-7\n' for name in own]
    bends = {"palletiser": "rx", "scara": "ry"}[kind]  # takes the tool out of the vertical
    springs.append(f'[[spring]]\njoint = "j2"\naxis = "{bends}"\ncompliance = 4e-7\n')
    head = 'schema = 1\ngrade = "placeholder"\ntcp = "tool0"\nacceleration_limits = [2.0, 2.0, 2.0, 4.0]\n'
    folder.mkdir()
    text = f'<robot name="{kind}">{"".join(parts)}</robot>'
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    (folder / "elasticity.toml").write_text(head + "".join(springs), encoding="utf-8")
    return read_robot_folder(folder)


def four_joint_path(tilt=0.0):
    place = np.eye(4)
    place[:3, 3] = [1.3, 0.3, 0.55]
    path = place_toolpath(CircleTable(radius_mm=100, feed_mm_s=50, waypoints=80).generate(), place)
    axis = np.column_stack([np.full(80, np.sin(tilt)), np.zeros(80), np.full(80, np.cos(tilt))])
    wrench = np.tile([300.0, -200.0, 400.0, 0.0, 0.0, 0.0], (80, 1))
    return type(path)(path.position, axis, path.feed, path.rapid, wrench, "base")


@pytest.mark.parametrize("spin_free", [True, False])
@pytest.mark.parametrize("kind", FOUR)
def test_a_robot_of_four_joints_puts_its_tip_on_the_path_and_says_what_it_cannot(tmp_path, kind, spin_free):
    robot = write_four(tmp_path / kind, kind)
    assert robot.nq == 4
    plan = plan_compensation(robot, four_joint_path(), PlanOptions(spin_free=spin_free))
    assert plan.status == "solved", plan.explain_failures()
    assert plan.before.max_deviation > 1e-4 and plan.after.max_deviation < 1e-8
    assert plan.after.max_tilt > 1e-5  # the load leans the tool, and no joint can take that off
    assert any("four joints" in note and "tilt_after_deg" in note for note in plan.notes)
    frames = locate_frames(build_chain(robot), plan.q)
    assert frames.tcp_rotation[:, 2, 2] == pytest.approx(-1.0)
    if not spin_free:
        assert plan.after.rotation[:, 1, 0] == pytest.approx(0.0, abs=1e-4)  # x of the tool stays along x of the base


def test_a_path_that_leans_is_refused_on_four_joints(tmp_path):
    robot = write_four(tmp_path / "palletiser", "palletiser")
    with pytest.raises(InputError, match="of 4 joints, which keep the tool where it points: reaches no waypoint"):
        plan_compensation(robot, four_joint_path(0.1), PlanOptions())
