"""Strategies against closed forms, rates and invariants, judged by Pinocchio."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.errors import UnknownNameError
from compplan.planning.evaluate import evaluate_run
from compplan.planning.plan import PlanOptions, build_task
from compplan.planning.posture.settings import PostureSettings
from compplan.planning.strategies import command_path
from compplan.robot import LinkElasticity, Robot, Spring, load_robot
from compplan.robot.elasticity import hollow_beam_compliance
from compplan.simulation.simulated_robot import build_simulated_robot
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames
from compplan.toolpath.toolpath import Toolpath

FORCE = np.array([440.0, 1370.0, -635.0, 20.0, -10.0, 15.0])


def make_path(n=40, force=FORCE, centre=(1.7, 0.1, 0.9)):
    angle = np.linspace(0, 1.5 * np.pi, n)
    position = np.array(centre) + 0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0.3 * np.sin(2 * angle)])
    wrench = np.tile(force, (n, 1))
    return Toolpath(position, np.tile([0.0, 0, 1], (n, 1)), np.full(n, 0.02), np.zeros(n, bool), wrench, "base")


def make_task(robot="kuka_kr270", *, spin_free=False, path=None, **options):
    robot = load_robot(robot) if isinstance(robot, str) else robot
    return build_task(robot, path or make_path(), PlanOptions(spin_free=spin_free, inertia=False, **options))


def worst(task, strategy):
    run = evaluate_run(task, command_path(task, strategy).q, build_simulated_robot(task.robot))
    return run.max_deviation, run.max_tilt


@pytest.mark.parametrize("strategy", ["iterated_mirror", "nlp"])
def test_joint_springs_alone_are_wound_up_by_exactly_their_torque(strategy):
    """With springs on the joints' own axes the link side stands on the path: q = q_path - C J(q_path)^T w."""
    task = make_task()
    rigid = build_chain(replace(task.robot, springs=()))
    columns = joint_jacobian(rigid, locate_frames(rigid, task.q_start))
    compliance = np.array([spring.compliance for spring in task.robot.springs])
    wound = task.q_start - compliance * np.einsum("nij,ni->nj", columns, task.wrench)
    assert np.abs(command_path(task, strategy).q - wound).max() < 1e-9


def test_a_path_that_leaves_no_choice_comes_to_the_answer_of_the_repeated_mirror():
    mirrored, program = (command_path(make_task(), name) for name in ("iterated_mirror", "nlp"))
    assert np.abs(mirrored.q - program.q).max() < 1e-8 and mirrored.status == program.status == "solved"


def test_one_soft_joint_is_wound_up_by_lever_times_force():
    arm = load_robot("kuka_kr270")
    arm = replace(arm, springs=(Spring("joint_1", "own", 2e-6, actuator=True),))
    force = np.array([0.0, 800.0, 0.0, 0, 0, 0])
    task = make_task(arm, path=make_path(force=force))
    q = command_path(task, "nlp").q
    assert q[:, 0] == pytest.approx(task.q_start[:, 0] - 2e-6 * 800.0 * task.position[:, 0], abs=1e-10)
    assert np.abs(q[:, 1:5] - task.q_start[:, 1:5]).max() < 1e-9


def test_a_beam_as_tool_is_lifted_by_its_tip_deflection():
    """Cantilever: w = F L^3 / (3 E I) + F L / (G k A) sideways, to first order the correction against it."""
    length, young, shear = 0.4, 70e9, 26e9
    tube = {"outer_diameter": 0.05, "inner_diameter": 0.03, "young": young, "shear": shear}
    block = LinkElasticity("flange", hollow_beam_compliance(length=length, axis="z", **tube))
    robot = load_robot("kuka_kr270")
    pose = np.eye(4)
    pose[2, 3] = length
    robot = replace(robot.with_tool(pose), springs=())
    last = [joint.child for joint in robot.joints if joint.child != robot.tcp][-1]
    robot = replace(robot, link_elasticities=(replace(block, link=last),))
    task = make_task(robot, path=make_path(force=np.array([100.0, 0, 0, 0, 0, 0])))
    mirrored = command_path(task, "mirror").q
    lifted = (locate_frames(task.chain, mirrored).tcp_position - task.position)[:, 0]
    inertia = np.pi * (0.05**4 - 0.03**4) / 64
    bending = 100.0 * length**3 / (3 * young * inertia)
    assert -lifted == pytest.approx(100.0 * block.compliance[0, 0], rel=1e-3)
    assert -lifted == pytest.approx(bending, rel=0.05)
    assert worst(task, "nlp")[0] < 1e-9


@pytest.mark.parametrize("name", ["kuka_kr270_full", "staubli_tx200", "kuka_kr240_rail"])
def test_exact_strategies_reach_the_path_on_every_kind_of_robot(name):
    centre = (1.5, 0.1, 0.5) if "rail" not in name else (2.2, 1.4, 0.9)
    task = make_task(name, path=make_path(20, centre=centre), spin_free=True)
    for strategy in ("iterated_mirror", "nlp"):
        deviation, tilt = worst(task, strategy)
        assert deviation < 1e-8
        assert tilt < 1e-8


def test_links_own_weight_is_compensated_where_the_robot_carries_gravity():
    robot = replace(load_robot("kuka_kr270_full"), gravity=np.array([0.0, 0.0, -9.81]))
    task = make_task(robot, path=make_path(20, centre=(1.5, 0.1, 0.6), force=np.zeros(6)))
    assert worst(task, "none")[0] > 1e-4
    assert worst(task, "nlp")[0] < 1e-8


def test_effects_of_the_robot_folder_are_compensated():
    table = {"effect": "joint_offset", "joint": "joint_3", "parameters": {"offset_rad": 5e-4}}
    robot = replace(load_robot("kuka_kr270"), effects=(table,))
    task = make_task(robot)
    ignorant = replace(task, robot=replace(robot, effects=()))
    cell = build_simulated_robot(robot)
    assert evaluate_run(task, command_path(ignorant, "nlp").q, cell).max_deviation > 3e-4
    assert evaluate_run(task, command_path(task, "nlp").q, cell).max_deviation < 2e-8


def test_an_unknown_strategy_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="no strategy named 'magic', choose from \\['none', 'mirror'"):
        command_path(make_task(), "magic")


def test_a_correction_limit_is_kept_where_it_binds_and_exact_elsewhere():
    path = make_path(60)
    path = replace(path, wrench=path.wrench * np.linspace(0.2, 1.0, 60)[:, None])
    free = command_path(make_task(path=path), "nlp")
    limit = 0.0012
    task = make_task(path=path, max_correction=limit)
    command = command_path(task, "nlp")
    assert free.status == "solved" and command.status == "infeasible"
    assert set(command.failures.values()) == {"correction limit"}
    failing = np.array(sorted(command.failures))
    correction = np.linalg.norm(locate_frames(task.chain, command.q).tcp_position - task.position, axis=1)
    assert correction.max() < limit + 1e-7
    assert correction[failing].min() > limit - 1e-6
    run = evaluate_run(task, command.q, build_simulated_robot(task.robot))
    others = np.setdiff1d(np.arange(60), failing)
    assert run.distance[others].max() < 1e-6
    unlimited = np.linalg.norm(locate_frames(task.chain, free.q).tcp_position - task.position, axis=1)
    assert run.distance[failing] == pytest.approx(unlimited[failing] - limit, rel=0.1, abs=2e-6)


def load_spindle_robot() -> Robot:
    """Return a robot whose spindle stands under 45 degrees."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    pose[:3, 3] = [0.15, 0.0, 0.2]
    return load_robot("kuka_kr270").with_tool(pose, 30.0)


def test_position_limits_are_used_up_by_rotating_about_the_tool_axis():
    """The start leaves a limit that a rotation about the tool axis can keep."""
    robot = load_spindle_robot()
    flipped = PostureSettings(search=False, configuration={"wrist": "flip"})
    task = make_task(robot, spin_free=True, posture=flipped)
    free = command_path(task, "nlp")
    assert free.status == "solved"
    top = np.r_[robot.upper[:4], free.q[:, 4].max() - 0.02, robot.upper[5]]
    joints = [
        replace(j, upper=float(dict(zip(robot.joint_names, top, strict=True)).get(j.name, j.upper)))
        for j in robot.joints
    ]
    narrow = replace(task, robot=replace(robot, joints=tuple(joints)))
    command = command_path(narrow, "nlp")
    assert command.status == "solved"
    assert command.q[:, 4].max() <= top[4] + 1e-12
    assert command.q[:, 4].max() > top[4] - 1e-4
    assert evaluate_run(narrow, command.q, build_simulated_robot(robot)).max_deviation < 1e-8
