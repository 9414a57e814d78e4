"""Robots of five joints: a gantry of three slides and two turning joints plans like an arm."""

from xml.etree import ElementTree

import numpy as np
import pytest

from compplan.path.generators import Pace, generate_circle
from compplan.path.toolpath import place_toolpath
from compplan.plan.plan import PlanOptions, plan_compensation
from compplan.robot import read_robot_folder

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
    path = place_toolpath(generate_circle(0.1, Pace(feed=0.05, waypoints=120)), pose)
    tilt = np.column_stack([np.full(120, np.sin(angle)), np.zeros(120), np.full(120, np.cos(angle))])
    wrench = np.tile([300.0, -200.0, 500.0, 0.0, 0.0, 0.0], (120, 1))
    nominal = type(path)(path.position, tilt, path.feed, path.rapid, wrench, "base")
    plan = plan_compensation(robot, nominal, PlanOptions())
    assert plan.status == "solved", plan.explain_failures()
    assert plan.before.max_deviation > 1e-5 and plan.after.max_deviation < 1e-8
    assert max(plan.between.joint.max(), plan.between.cartesian.max()) < 1e-5
