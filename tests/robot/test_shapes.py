"""No collision check is silent about a part of the arm that it does not see."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from commandline import run_command
from planted_robots import PLANTS, plant_robot

from compplan.cli.doctor import examine_robot
from compplan.errors import InputError
from compplan.planning.posture.collision_scene import check_bodies
from compplan.robot import load_robot, robot_folders
from compplan.robot.shapes import read_bodies
from compplan.robot.solids import make_geometry
from compplan.robot.urdf import read_placement

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"
JOB = Path("job.toml")


@pytest.mark.parametrize("name", sorted(robot_folders()))
def test_every_shipped_arm_is_seen_whole(name: str) -> None:
    bodies = read_bodies(load_robot(name))
    assert [body.gap for body in bodies if body.gap] == []
    assert all(body.count["read"] and not body.count["dropped"] for body in bodies)


def test_the_origin_of_a_shape_turns_about_x_then_y_then_z_of_its_link() -> None:
    """Fixed axes, as URDF says: Rz(yaw) Ry(pitch) Rx(roll); a quarter about x and then about z takes y to z, x to y."""
    quarter = 0.5 * np.pi
    pose = read_placement(ElementTree.fromstring(f'<origin xyz="1 2 3" rpy="{quarter} 0 {quarter}"/>'))
    assert pose @ [0, 1, 0, 1] == pytest.approx([1, 2, 4, 1]) and pose @ [1, 0, 0, 1] == pytest.approx([1, 3, 3, 1])
    assert read_placement(None) == pytest.approx(np.eye(4))


@pytest.mark.parametrize("seed", range(60))
def test_no_planted_folder_passes_a_collision_check_unsaid(seed: int, tmp_path: Path) -> None:
    planted = plant_robot(tmp_path / "arm", seed)
    robot = load_robot(planted.folder)
    bodies = read_bodies(robot)
    odd = [remark.sentence for remark in examine_robot(robot) if (remark.state, remark.about) == ("odd", "collision")]
    if planted.plant == "capsule":
        check_bodies(bodies, (), robot.name, JOB)
        assert odd == []
        return
    with pytest.raises(InputError, match="would be missed") as refused:
        check_bodies(bodies, (), robot.name, JOB)
    named = [body.link for body in bodies if body.gap]
    assert set(named) <= set(planted.links)
    assert repr(named[0]) in str(refused.value)
    assert len(odd) == len(named)
    if planted.plant != "scale":  # inches show in long links alone
        assert named == list(planted.links)


def test_a_capsule_is_its_cylinder_with_two_half_balls() -> None:
    geometry, centre, radius, box = make_geometry(("capsule", 0.1, 0.6))
    assert box == pytest.approx(np.array([[-0.1, -0.1, -0.4], [0.1, 0.1, 0.4]]), abs=1e-9)
    assert (geometry.radius, geometry.halfLength) == (0.1, 0.3)
    assert centre == pytest.approx(np.zeros(3), abs=1e-12)
    assert radius >= 0.4


def make_work(tmp_path: Path, plant: str | None, more: str = "") -> Path:
    """Write the good job with [collision] and a robot with a plant in all its links."""
    work = tmp_path / "work"
    shutil.copytree(GOOD, work)
    if plant is not None:
        seed = next(s for s in range(100) if np.random.default_rng(s).random() >= 0.5 or plant == "scale")
        shutil.rmtree(work / "robot")
        plant_robot(work / "robot", seed, plant, "kuka_kr240")
    text = (work / "job.toml").read_text().replace("[plan]", f"[collision]\n{more}\n[plan]")
    (work / "job.toml").write_text(text)
    return work


@pytest.mark.parametrize("plant", [plant for plant in PLANTS if plant != "capsule"])
def test_a_job_with_collision_refuses_an_arm_that_it_cannot_see(plant, tmp_path, monkeypatch, capsys) -> None:
    work = make_work(tmp_path, plant)
    answer = run_command(["plan", work / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert len(answer.err.splitlines()) == 1
    assert f"{work / 'job.toml'}: collision: link 'link_" in answer.err
    assert "without_shapes" in answer.err
    assert not (tmp_path / "out").exists()


def test_links_that_the_job_names_are_checked_without_shapes_and_the_plan_says_so(
    tmp_path, monkeypatch, capsys
) -> None:
    shutil.rmtree(make_work(tmp_path, None))
    robot = load_robot("kuka_kr240")
    links = [body.link for body in read_bodies(robot) if body.moves]
    work = make_work(tmp_path, "none", f"without_shapes = {json.dumps(links)}")
    answer = run_command(["plan", work / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status in (0, 3), answer.err
    plan = json.loads((tmp_path / "out" / "plan.json").read_text())
    said = " ".join(plan["notes"])
    assert "without_shapes excludes unknown parts" in said
    assert f"{links[0]}: " in said
    assert plan["clearance"]["shapes"][links[0]] == {"read": 0, "dropped": 0, "unknown": 1}
    assert "without_shapes excludes" in answer.out


def test_a_name_that_hides_nothing_is_refused(tmp_path, monkeypatch, capsys) -> None:
    work = make_work(tmp_path, None, 'without_shapes = ["link_2"]')
    answer = run_command(["plan", work / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert "collision.without_shapes[0]: 'link_2' names no link" in answer.err


def test_shapes_fixed_beside_the_chain_move_with_it(tmp_path: Path) -> None:
    shutil.copytree(GOOD / "robot", tmp_path / "robot")
    file = tmp_path / "robot" / "robot.urdf"
    plain = {body.link: body.count["read"] for body in read_bodies(load_robot(GOOD / "robot"))}
    box = '<link name="motor"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
    hung = '<parent link="link_2"/><child link="motor"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>'
    joint = '<joint name="bolt" type="{}">' + hung + "</joint>"
    text = file.read_text()
    file.write_text(text.replace("</robot>", box + joint.format("fixed") + "</robot>"))
    body = next(body for body in read_bodies(load_robot(tmp_path / "robot")) if body.link == "link_2")
    assert body.count["read"] == plain["link_2"] + 1
    motor = next(shape for shape in body.shapes if shape.name == "motor")
    assert motor.link == "link_2"
    assert motor.mesh().bounds == pytest.approx(np.array([[-0.1, -0.1, 0.4], [0.1, 0.1, 0.6]]))
    file.write_text(text.replace("</robot>", box + joint.format("continuous") + "</robot>"))
    body = next(body for body in read_bodies(load_robot(tmp_path / "robot")) if body.link == "link_2")
    assert body.count["read"] == plain["link_2"]
    assert "motor hangs on a joint beside the chain" in body.gap
