"""A positioner carries the part: the same arm, the same loads, seen from a plate that tilts and turns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.languages import read_fanuc, read_krl, read_rapid
from compplan.controllers.readback.poses import Move
from compplan.controllers.readback.scripts import read_inform
from compplan.controllers.writers import (
    Program,
    build_program,
    check_languages,
    fanuc_ls,
    inform,
    joint_convention,
    krl,
)
from compplan.controllers.writers import rapid as rapid_language
from compplan.controllers.writers.fit import fit_moves
from compplan.errors import InputError
from compplan.job.job import Job, check_job, load_job
from compplan.planning.plan import job_robot, plan_job
from compplan.reporting.scenes import locate_links
from compplan.reporting.writers.plan import deliver_plan
from compplan.reporting.writers.recording import place_arm
from compplan.robot import Array, Robot, load_robot, read_robot_folder, write_robot_folder
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.simulation.exact_model import read_exact_robot
from compplan.statics.chain import build_chain, joint_jacobian, load_elements, locate_frames
from compplan.statics.elastic import load_derivative, solve_equilibrium
from compplan.statics.inertia import build_moving_chain, load_motion

EXAMPLE = Path(__file__).parents[2] / "examples" / "positioner"
IDENTITY = "[[0.00000,0.00000,0.00000],[1.000000000,0.000000000,0.000000000,0.000000000]]"
TABLE, GRAVITY = EXAMPLE / "kuka_kr240_table", np.array([0.0, 0.0, -9.81])


def table(**changes: object) -> Robot:
    return replace(read_robot_folder(TABLE), gravity=GRAVITY, **changes)  # type: ignore[arg-type]


def plate_pose(tilt: float, turn: float) -> Array:
    """Pose of the plate seen from the floor, by hand: along y at (2.2, 0, 0.8), then about z 0.1 above."""
    about_y, about_z = np.eye(4), np.eye(4)
    about_y[:3, :3] = [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    about_z[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    about_y[:3, 3], about_z[2, 3] = (2.2, 0.0, 0.8), 0.1
    return about_y @ about_z


def draw(seed: int, n: int) -> tuple[Array, Array]:
    random = np.random.default_rng(seed)
    arm = np.radians([0, 70, -110, 10, 40, 20]) + 0.3 * random.uniform(-1, 1, (n, 6))
    return np.hstack([random.uniform(-1.5, 1.5, (n, 2)), arm]), 1e3 * random.uniform(-1, 1, (n, 6))


def seen_from_plate(q: Array, position: Array, rotation: Array) -> tuple[Array, Array]:
    plates = np.linalg.inv(np.array([plate_pose(*row) for row in q[:, :2]]))
    turned = (plates[:, :3, :3] @ position[..., None])[..., 0] + plates[:, :3, 3]
    return turned, plates[:, :3, :3] @ rotation


def test_joints_are_named_from_the_ground_out_and_the_part_is_seen_from_the_plate() -> None:
    robot = read_robot_folder(TABLE)
    assert robot.joint_names[:3] == ("table_tilt", "table_turn", "joint_1")
    assert (robot.base, robot.ground) == ("plate", "base_link")
    assert robot.carriers.tolist() == [True, True] + [False] * 6


def test_the_loaded_arm_is_the_arm_alone_seen_from_the_plate_under_the_same_gravity() -> None:
    arm = replace(load_robot("kuka_kr240"), gravity=GRAVITY)
    q, wrench = draw(1, 20)
    turn = np.array([plate_pose(*row)[:3, :3] for row in q[:, :2]])
    outside = np.hstack([(turn @ part[..., None])[..., 0] for part in (wrench[:, :3], wrench[:, 3:])])
    alone = solve_equilibrium(build_chain(arm), q[:, 2:], outside)
    wanted = seen_from_plate(q, alone.position, alone.rotation)
    found = solve_equilibrium(build_chain(table()), q, wrench)
    np.testing.assert_allclose(found.theta, alone.theta, atol=1e-13)
    np.testing.assert_allclose(found.position, wanted[0], atol=1e-12)
    np.testing.assert_allclose(found.rotation, wanted[1], atol=1e-12)


def test_the_judge_reads_the_table_from_its_files_and_finds_the_same(tmp_path: Path) -> None:
    write_robot_folder(table(), tmp_path)
    assert read_robot_folder(tmp_path).base == "plate"
    q, wrench = draw(2, 12)
    found = solve_equilibrium(build_chain(table()), q, wrench)
    for exact_robot in (read_exact_robot(tmp_path), build_exact_robot(table())):
        position, rotation, _ = solve_exact_pose(exact_robot, q, wrench)
        np.testing.assert_allclose(position, found.position, atol=1e-11)
        np.testing.assert_allclose(rotation, found.rotation, atol=1e-11)


def test_the_derivative_of_the_loads_holds_for_joints_that_carry_the_part() -> None:
    robot = table()
    chain = build_chain(robot)
    q, wrench = draw(3, 5)
    elements = chain.joint_elements
    frames = locate_frames(chain, q)
    exact = load_derivative(chain, frames, wrench, chain.spring_elements)[:, :, elements]
    for j in range(robot.nq):
        step = np.zeros(robot.nq)
        step[j] = 1e-6
        two = [load_elements(chain, locate_frames(chain, q + s * step), wrench) for s in (1, -1)]
        numeric = ((two[0] - two[1]) / 2e-6)[:, chain.spring_elements]
        np.testing.assert_allclose(exact[:, :, j], numeric, atol=1e-4 * np.abs(numeric).max() + 1e-3)


def test_a_turntable_under_a_tool_that_stands_lets_it_draw_a_circle_on_the_part() -> None:
    robot = read_robot_folder(TABLE)
    turn = np.radians(np.arange(0, 360, 15.0))
    q = np.tile(np.r_[0.0, 0.0, np.radians([0, 70, -110, 0, 40, 0])], (len(turn), 1))
    q[:, 1] = turn
    chain = build_chain(robot)
    position = locate_frames(chain, q).tcp_position
    middle = np.hypot(*position[0, :2])
    np.testing.assert_allclose(np.hypot(*position[:, :2].T), middle, atol=1e-12)
    np.testing.assert_allclose(np.ptp(position[:, 2]), 0.0, atol=1e-12)
    turned = np.unwrap(np.arctan2(position[:, 1], position[:, 0]))
    np.testing.assert_allclose(turned - turned[0], -turn, atol=1e-12)
    columns = joint_jacobian(chain, locate_frames(chain, q))[:, :3, 1]
    np.testing.assert_allclose(np.linalg.norm(columns, axis=1), middle, atol=1e-12)


def test_a_turning_table_puts_no_inertia_on_an_arm_that_stands() -> None:
    robot = table()
    time = np.linspace(0.0, 2.0, 41)
    q = np.tile(np.r_[0.3, 0.0, np.radians([0, 70, -110, 0, 40, 0])], (41, 1))
    q[:, 1] = 0.5 * time**2
    inside = np.r_[False, np.ones(39, bool), False]
    np.testing.assert_allclose(load_motion(build_moving_chain(robot), q, time, inside), 0.0, atol=1e-9)
    q[:, 2] = 0.5 * time**2
    assert np.abs(load_motion(build_moving_chain(robot), q, time, inside)).max() > 10.0


def test_a_joint_that_moves_both_part_and_tool_is_refused(tmp_path: Path) -> None:
    for name in ("robot.urdf", "elasticity.toml"):
        text = (TABLE / name).read_text(encoding="utf-8").replace('part   = "plate"', 'part   = "link_3"')
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="moves the part and the tool"):
        read_robot_folder(tmp_path)


def written(language: str, folder: Path, **changes: object) -> tuple[Program, list[Move]]:
    """Write a quarter turn of the table under a tool that stands still, with a way there, and read it back."""
    robot = read_robot_folder(TABLE)
    q = np.tile(np.r_[0.1, 0.0, np.radians([0, 70, -110, 0, 40, 0])], (6, 1))
    q[:, 1] = np.radians([0, 0, 10, 20, 30, 30])
    q[[0, -1], 3] -= 0.05
    rapid = np.array([True, False, False, False, False, True])
    part = np.eye(4)
    part[:3, 3] = (0.02, -0.01, 0.3)
    program = build_program(
        robot, q, np.full(6, 0.02), rapid, name="turn", part=part, time=np.array([0, 1, 3, 5, 7, 8.0])
    )
    program = replace(program, form="linear", **changes)  # type: ignore[arg-type]
    writers = {"krl": krl, "rapid": rapid_language, "fanuc_ls": fanuc_ls, "inform": inform}
    writers[language].write(program, folder)
    readers = {"krl": (read_krl, "turn_L.src"), "rapid": (read_rapid, "turn_L.mod"),
               "fanuc_ls": (read_fanuc, "TURN_L.LS"), "inform": (read_inform, "TURN_L.JBI")}  # fmt: skip
    read, file = readers[language]
    return program, read(folder / file)


@pytest.mark.parametrize("language", ["krl", "rapid", "fanuc_ls", "inform"])
def test_programs_move_the_part_as_an_external_axis_and_are_read_back(language: str, tmp_path: Path) -> None:
    program, moves = written(language, tmp_path)
    assert [move.kind for move in moves] == ["joint", *["line"] * 4, "joint"]
    assert all(move.carried for move in moves if move.kind == "line")
    for row, move in enumerate(moves):
        np.testing.assert_allclose(move.external[:2], program.joints[row, :2], atol=1e-4)
        if move.joints is not None:
            np.testing.assert_allclose(move.joints, program.joints[row, 2:], atol=1e-4)
        if move.pose is not None:
            assert move.base is not None
            assert program.tcp is not None
            np.testing.assert_allclose(move.base @ move.pose, millimetres(program.tcp[row]), atol=1e-3)


def millimetres(pose: Array | None) -> Array:
    assert pose is not None
    found = np.array(pose)
    found[:3, 3] *= 1e3
    return found


def test_lines_of_programs_that_move_the_part_are_those_of_the_makers(tmp_path: Path) -> None:
    """Words and order as the makers' controllers take them, with the numbers of a quarter turn."""
    for language in ("krl", "rapid", "fanuc_ls", "inform"):
        (tmp_path / language).mkdir()
        written(language, tmp_path / language)
    main = (tmp_path / "krl" / "turn_L.src").read_text()
    frame = "{X 20.0000000,Y -10.0000000,Z 300.0000000,A 0.0000000,B 0.0000000,C 0.0000000}"
    assert f"$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,{frame})\n" in main
    part = (tmp_path / "krl" / "turn_L1.src").read_text()
    assert "E1 5.7296,E2 10.0000,E3 0.0000" in part
    module = (tmp_path / "rapid" / "turn_L.mod").read_text()
    unit = "[[20.00000,-10.00000,300.00000],[1.000000000,0.000000000,0.000000000,0.000000000]]"
    assert f':=[FALSE,FALSE,"STN1",{IDENTITY},{unit}];' in module and "    ActUnit STN1;\n" in module
    assert "[5.72958,10.00000,9E9,9E9,9E9,9E9]" in (tmp_path / "rapid" / "turn_L_1.mod").read_text()
    pendant = (tmp_path / "fanuc_ls" / "TURN_L.LS").read_text()
    assert "DEFAULT_GROUP\t= 1,1,*,*,*;" in pendant and "L P[3] 20.0mm/sec CNT100 COORD ;" in pendant
    assert "\n   GP2:\n\tUF : 0, UT : 1,\n\tJ1=     5.729578 deg,\tJ2=    10.000000 deg\n};" in pendant
    job = (tmp_path / "inform" / "TURN_L.JBI").read_text()
    assert "///NPOS 6,0,6,0,0,0\n" in job and "///GROUP1 RB1\n///GROUP2 ST1\nNOP\n" in job
    assert "EC00002=5.729578,10.000000\n" in job and "SMOVL C00002 V=20.0 PL=1 +MOVJ EC00002\n" in job


def test_lines_are_not_fitted_over_a_table_that_turns_unevenly(tmp_path: Path) -> None:
    robot = read_robot_folder(TABLE)
    q = np.tile(np.r_[0.0, 0.0, np.radians([0, 70, -110, 0, 40, 0])], (9, 1))
    for turned, fewest in ((np.zeros(9), 2), (np.radians([0, 0, 1, 0, 0, 0, 0, 0, 0]), 4)):
        q[:, 1] = turned
        straight = np.tile(np.eye(4), (9, 1, 1))
        straight[:, 0, 3] = 0.001 * np.arange(9)
        program = build_program(robot, q, np.full(9, 0.001), np.zeros(9, bool), name="t", time=np.arange(9.0))
        fitted = fit_moves(replace(program, tcp=straight, tolerance=1e-5)).program
        assert (len(fitted) == 2) if fewest == 2 else (len(fitted) >= 4)


@pytest.mark.parametrize("language", ["urscript", "val3", "sinumerik", "kawasaki_as"])
def test_languages_that_move_no_positioner_say_so(language: str) -> None:
    with pytest.raises(InputError, match=r"cannot move what carries the part, choose from .*'krl'"):
        check_languages(read_robot_folder(TABLE), [language], file=Path("job.toml"))


@pytest.mark.parametrize(
    ("name", "language", "said"), [("franka_fr3", "inform", "six rotating"), ("ur10e", "krl", "joints named")]
)
def test_a_language_that_a_robot_cannot_have_is_refused_before_the_plan(name: str, language: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"^job\.toml: output\.programs: .*{said}"):
        check_languages(load_robot(name), [language], file=Path("job.toml"), any_brand=True)
    check_languages(load_robot(name), ["csv"], file=Path("job.toml"), any_brand=True)


def test_the_picture_and_the_viewer_keep_the_ground_still_and_move_table_and_part() -> None:
    robot = read_robot_folder(TABLE)
    q = draw(5, 1)[0][0]
    drawn, seen = locate_links(robot, q), joint_convention.locate_links(robot, q[None])
    for poses in (drawn, {link: np.linalg.inv(seen[robot.ground][0]) @ pose[0] for link, pose in seen.items()}):
        np.testing.assert_allclose(poses["base_link"], np.eye(4), atol=1e-12)
        np.testing.assert_allclose(poses["plate"], plate_pose(*q[:2]), atol=1e-8)
    assert {"plate", "cradle", "base_link"} <= {solid.name for solid in place_arm(robot)}


def circle(robot: str, place: Array, **tables: Any) -> Job:
    """A small circle on the plate, the tool down, at one place and turn of the part."""
    return check_job({
        "schema": 1, "robot": robot,
        "part": {"position_mm": (1e3 * place[:3, 3]).tolist(),
                 "rotation_deg": Rotation.from_matrix(place[:3, :3]).as_rotvec(degrees=True).tolist()},
        "toolpath": {"generator": "circle", "radius_mm": 30.0, "feed_mm_s": 10.0, "waypoints": 24},
        "process": {"model": "constant", "force_N": [100.0, 0.0, 300.0]},
        "plan": {"rotate_about_tool_axis": False, "strategy": "iterated_mirror", "tolerance_mm": 0.3}, **tables,
    }, EXAMPLE / "job.toml")  # fmt: skip


def test_a_table_that_is_held_plans_as_the_arm_alone_with_the_part_tilted_and_turned(tmp_path: Path) -> None:
    on_plate = np.eye(4)
    on_plate[:3, 3] = (0.05, 0.02, 0.2)
    held = {"hold_deg": {"table_tilt": -20.0, "table_turn": 30.0}}
    found = plan_job(circle("kuka_kr240_table", on_plate, positioner=held, output={"programs": ["csv", "krl"]}))
    assert deliver_plan(found, tmp_path / "out")[0].breaches == ()  # its joint table is read back too
    wanted = plan_job(circle("kuka_kr240", plate_pose(*np.radians([-20.0, 30.0])) @ on_plate))
    assert (found.status, wanted.status) == ("solved", "solved")
    np.testing.assert_allclose(found.q[:, :2], np.radians([[-20.0, 30.0]] * len(found.q)), atol=1e-12)
    np.testing.assert_allclose(found.q[:, 2:], wanted.q, atol=1e-6)
    np.testing.assert_allclose(found.before.distance, wanted.before.distance, atol=1e-9)
    np.testing.assert_allclose(found.timing.time, wanted.timing.time, rtol=1e-3)


@pytest.mark.parametrize(
    ("hold", "said"),
    [({"hold_deg": {"joint_1": 0.0}}, "carries no part"), ({"hold_deg": {"table_tilt": 100.0}}, "its range is"),
     ({"hold_deg": {"drum": 1.0}}, "carries no part")],
)  # fmt: skip
def test_what_cannot_be_held_is_refused(hold: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        job_robot(circle("kuka_kr240_table", np.eye(4), positioner=hold))


def test_the_shipped_job_turns_the_drum_under_the_tool_within_the_rates_of_the_table() -> None:
    plan = plan_job(load_job(EXAMPLE / "groove.toml"))
    robot = plan.robot
    assert (plan.status, plan.strategy) == ("solved", "nlp")
    assert np.degrees(np.ptp(plan.q[:, 1])) > 300.0
    assert not plan.q[:, 0].any()
    velocity = np.abs(np.diff(plan.q, axis=0)) / np.diff(plan.timing.time)[:, None]
    assert (velocity[:, :2].max(axis=0) <= robot.velocity_limits[:2] * 1.001).all()
    assert (np.abs(plan.timing.acceleration[:, :2]).max(axis=0) <= robot.acceleration_limits[:2] * 1.01).all()
