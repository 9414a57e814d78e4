"""Robot descriptions as ROS-Industrial publishes them, of invented arms: packages with URDF or xacro and STL meshes."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import trimesh


class Arm(NamedTuple):
    """An arm: origin [m] and axis of each joint, rpy of tool0 [rad], and how its maker names joints."""

    joints: tuple[tuple[str, str], ...]
    tool0: str
    name: str


KUKA = Arm(
    (("0 0 0.45", "0 0 -1"), ("0.15 0 0", "0 1 0"), ("0.61 0 0", "0 1 0"), ("0 0 0.02", "-1 0 0"),
     ("0.66 0 0", "0 1 0"), ("0.09 0 0", "-1 0 0")), "0 1.5707963 0", "joint_a{}",
)  # fmt: skip
ABB = Arm(
    (("0 0 0.615", "0 0 1"), ("0.1 0 0", "0 1 0"), ("0 0 0.705", "0 1 0"), ("0 0 0.135", "1 0 0"),
     ("0.755 0 0", "0 1 0"), ("0.085 0 0", "1 0 0")), "0 1.5707963 0", "joint_{}",
)  # fmt: skip
FANUC = Arm(
    (("0 0 0.55", "0 0 1"), ("0.15 0 0", "0 1 0"), ("0 0 0.76", "0 -1 0"), ("0 0 0.2", "-1 0 0"),
     ("0.78 0 0", "0 -1 0"), ("0.1 0 0", "-1 0 0")), "3.1415926 -1.5707963 0", "joint_{}",
)  # fmt: skip
SIZES = (
    (0.3, 0.3, 0.4), (0.2, 0.2, 0.2), (0.3, 0.1, 0.3), (0.2, 0.1, 0.2), (0.4, 0.1, 0.1), (0.1, 0.08, 0.08),
    (0.04, 0.1, 0.1),
)  # fmt: skip


def write_package(root: Path, arm: Arm, package: str, model: str, *, xacro: bool, mass: float = 0.0) -> Path:
    """Write the package of an arm, meshes two levels above the URDF; return its URDF or xacro file."""
    folder = root / package
    (folder / "urdf" / model).mkdir(parents=True)
    for kind in ("visual", "collision"):
        (folder / "meshes" / model / kind).mkdir(parents=True)
        for k, size in enumerate(SIZES):
            trimesh.creation.box(size).export(folder / "meshes" / model / kind / f"{link_name(k)}.stl")
    body = "".join(_write_link(f"package://{package}/meshes/{model}", k, mass / 7.0) for k in range(7))
    body += "".join(_write_joint(arm, k) for k in range(6))
    body += '<link name="tool0"/>\n' + _fixed("flange_tool0", "link_6", "tool0", arm.tool0)
    body += '<link name="base"/>\n' + _fixed("base_link-base", "base_link", "base", "0 0 0")
    file = folder / "urdf" / model / f"{model}.{'xacro' if xacro else 'urdf'}"
    if not xacro:
        file.write_text(f'<?xml version="1.0"?>\n<robot name="{model}">\n{body}</robot>\n', encoding="utf-8")
        return file
    head = '<?xml version="1.0"?>\n<robot {}xmlns:xacro="http://wiki.ros.org/xacro">\n'
    macro = file.with_name(f"{model}_macro.xacro")
    macro.write_text(
        head.format("") + '<xacro:include filename="$(find arm_resources)/urdf/constants.xacro"/>\n'
        f'<xacro:macro name="arm" params="prefix">\n{body}</xacro:macro>\n</robot>\n',
        encoding="utf-8",
    )
    (root / "arm_resources" / "urdf").mkdir(parents=True, exist_ok=True)
    (root / "arm_resources" / "urdf" / "constants.xacro").write_text(
        head.format("") + '<xacro:property name="turn" value="170"/>\n</robot>\n', encoding="utf-8"
    )
    file.write_text(
        head.format(f'name="{model}" ') + f'<xacro:arg name="prefix" default=""/>\n'
        f'<xacro:include filename="$(find {package})/urdf/{model}/{macro.name}"/>\n'
        '<xacro:arm prefix="$(arg prefix)"/>\n</robot>\n',
        encoding="utf-8",
    )
    text = macro.read_text(encoding="utf-8").replace('lower="-2.9670597" upper="2.9670597"',
                                                     'lower="${radians(-turn)}" upper="${radians(turn)}"')  # fmt: skip
    macro.write_text(text, encoding="utf-8")
    return file


def link_name(k: int) -> str:
    return f"link_{k}" if k else "base_link"


def _write_link(meshes: str, k: int, mass: float) -> str:
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="{meshes}/{kind}/{link_name(k)}.stl"/></geometry></{kind}>'
        for kind in ("visual", "collision")
    )
    inertia = 'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"'
    weight = f'<inertial><mass value="{mass}"/><inertia {inertia}/></inertial>' if mass else ""
    return f'<link name="{link_name(k)}">{weight}{shapes}</link>\n'


def _write_joint(arm: Arm, k: int) -> str:
    origin, axis = arm.joints[k]
    low, high = ("-2.9670597", "2.9670597") if k not in (1, 2) else ("-2.6", "2.6")
    return (
        f'<joint name="{arm.name.format(k + 1)}" type="revolute"><origin xyz="{origin}" rpy="0 0 0"/>'
        f'<parent link="{link_name(k)}"/><child link="{link_name(k + 1)}"/><axis xyz="{axis}"/>'
        f'<limit effort="0" lower="{low}" upper="{high}" velocity="3.5"/></joint>\n'
    )


def _fixed(name: str, parent: str, child: str, rpy: str) -> str:
    return (f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0" rpy="{rpy}"/></joint>\n')  # fmt: skip
