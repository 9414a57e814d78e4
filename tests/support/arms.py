"""Small robot folders that tests build: arms with closed forms."""

from __future__ import annotations

from pathlib import Path

from compplan.robot import Robot, load_robot


def one_joint_arm(
    folder: Path, length: float = 1.0, compliance: float = 1e-5, mass: float = 0.0, extra: str = ""
) -> Robot:
    """Write and load an arm of a length [m] along x that turns about y, its mass at the tip; compliance [rad/Nm]."""
    folder.mkdir(parents=True, exist_ok=True)
    inertial = f'<inertial><origin xyz="{length} 0 0"/><mass value="{mass}"/></inertial>' if mass else ""
    (folder / "robot.urdf").write_text(
        f"""<robot name="arm"><link name="base"/><link name="arm">{inertial}</link><link name="tool0"/>
        <joint name="joint_1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
        <limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
        <joint name="tip" type="fixed"><parent link="arm"/><child link="tool0"/><origin xyz="{length} 0 0"/></joint>
        </robot>""",
        encoding="utf-8",
    )
    lines = ["schema = 1", 'tcp = "tool0"']
    if compliance:
        lines += ["[[spring]]", 'joint = "joint_1"', f"compliance = {compliance!r}"]
    (folder / "elasticity.toml").write_text("\n".join([*lines, extra]), encoding="utf-8")
    return load_robot(folder)


def beam_arm(folder: Path, pieces: int, length: float = 2.0, tube: str = "") -> Robot:
    """Write and load a straight tube along x, clamped at the base and cut into equal pieces, each an elastic link."""
    folder.mkdir(parents=True, exist_ok=True)
    tube = tube or "outer_diameter = 0.2, inner_diameter = 0.16, young = 70e9, shear = 26e9"
    step = length / pieces
    parts = ['<link name="base"/>', '<link name="piece_0"/>']
    parts.append(
        '<joint name="joint_1" type="revolute"><parent link="base"/><child link="piece_0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
    )
    lines = ["schema = 1", 'tcp = "tool0"']
    for k in range(pieces):
        child = "tool0" if k == pieces - 1 else f"piece_{k + 1}"
        parts.append(f'<link name="{child}"/><joint name="seam_{k}" type="fixed"><parent link="piece_{k}"/>')
        parts.append(f'<child link="{child}"/><origin xyz="{step!r} 0 0"/></joint>')
        lines += ["[[link]]", f'link = "piece_{k}"', f'beam = {{ length = {step!r}, {tube}, axis = "x" }}']
    (folder / "robot.urdf").write_text(f'<robot name="tube">{"".join(parts)}</robot>', encoding="utf-8")
    (folder / "elasticity.toml").write_text("\n".join(lines), encoding="utf-8")
    return load_robot(folder)
