"""Collision: closed forms, the bound along a path, what may touch, and a plan that keeps clear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from compplan.controllers.writers.joint_convention import locate_links
from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.job.job import check_job
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.clearance import measure_clearance, measure_margin, sweep_margin
from compplan.planning.posture.collision_scene import (
    CollisionScene,
    build_scene,
    describe_contact,
    find_contacts,
    find_near,
)
from compplan.planning.posture.settings import PostureProblem, PostureSettings, read_settings
from compplan.reporting.scenes import locate_links as locate_drawn
from compplan.robot import load_robot
from compplan.robot.solids import cut_tip
from compplan.toolpath.toolpath import Toolpath

ROBOT = load_robot("kuka_kr240")
REST = np.array([[0.0, 0.3, 0.5, 0.0, 0.8, 0.0]])


def test_link_frames_agree_with_those_that_the_report_draws() -> None:
    q = REST + 0.3 * np.random.default_rng(0).standard_normal((3, 6))
    frames = locate_links(ROBOT, q)
    for i in range(3):
        for link, pose in locate_drawn(ROBOT, q[i]).items():
            if link in frames:
                assert frames[link][i] == pytest.approx(pose, abs=1e-12)


def test_the_distance_of_a_ball_at_the_flange_from_a_wall_is_the_closed_form() -> None:
    flange = locate_links(ROBOT, REST)[ROBOT.flange][0][:3, 3]
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.4)
    wall = trimesh.creation.box((0.1, 40.0, 40.0))
    wall.apply_translation([flange[0] + 0.4 + 0.123 + 0.05, 0.0, 0.0])
    scene = build_scene(ROBOT, tool=ball, fixture=wall, self_collision=False)
    names = [{scene.solids[a].name, scene.solids[b].name} for a, b in scene.outside]
    contact = find_contacts(ROBOT, scene.solids, REST, scene.outside[[n == {"tool", "fixture"} for n in names]])[0]
    assert {contact.first, contact.second} == {"tool", "fixture"}
    assert contact.distance == pytest.approx(0.123, abs=2e-3)
    assert "comes within 12" in describe_contact(contact)


def test_the_tip_may_touch_the_part_and_the_shank_may_not() -> None:
    flange = locate_links(ROBOT, REST)[ROBOT.flange][0]
    tip = ROBOT.with_tool(np.array([[0, 0, 1.0, 0.3], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]]))
    rod = trimesh.creation.cylinder(0.01, segment=([0, 0, 0], [0.3, 0, 0]))
    part = trimesh.creation.box((0.02, 0.02, 0.02))
    for at, free in ((0.3, True), (0.15, False)):
        place = part.copy().apply_translation((flange @ [at, 0, 0, 1.0])[:3])
        scene = build_scene(tip, tool=rod, part=place, tip_zone=0.05, self_collision=False)
        assert (measure_margin(scene, REST, 0.0)[0] > 0) == free


def test_cutting_the_tip_leaves_nothing_within_the_zone() -> None:
    rod = trimesh.creation.cylinder(0.01, segment=([0, 0, 0], [0.3, 0, 0]))
    left = cut_tip(rod, np.array([0.3, 0, 0]), 0.05)
    tip = np.tile([0.3, 0, 0], (len(left.faces), 1))
    distance = np.linalg.norm(trimesh.triangles.closest_point(left.triangles, tip) - tip, axis=1)
    assert distance.min() >= 0.05
    assert left.bounds[1, 0] > 0.23


def test_the_least_clearance_along_a_path_is_found_between_the_samples() -> None:
    wall = trimesh.creation.box((0.1, 4.0, 4.0))
    wall.apply_translation([2.6, 0.0, 1.5])
    scene = build_scene(ROBOT, fixture=wall, self_collision=False)
    q = np.tile(REST, (2000, 1))
    q[:, 0] = np.linspace(-1.0, 1.0, 2000)
    q[701:709, 1] += 0.1 * np.hanning(8)
    profile = measure_clearance(scene, q, 0.005)
    exact = min(contact.distance for contact in find_contacts(ROBOT, scene.solids, q[690:720], scene.outside))
    everywhere = min(exact, min(c.distance for c in find_contacts(ROBOT, scene.solids, q[::40], scene.outside)))
    assert profile.least[1].distance == pytest.approx(everywhere, abs=2e-3)
    assert len(profile.computed) < 700


def check_slopes(scene: CollisionScene, q: np.ndarray, far: float) -> int:
    """Hold the slope of every pair that is near against central differences of its own distance; count the pairs."""
    count, step = 0, 1e-6
    for pair in scene.outside:
        near = find_near(ROBOT, scene.solids, q, pair[None], far=far)
        for j, unit in enumerate(step * np.eye(6)):
            ahead, behind = (find_contacts(ROBOT, scene.solids, q[near.posture] + side * unit, pair[None], far=9.0)
                             for side in (1.0, -1.0))  # fmt: skip
            moved = [a.distance - b.distance for a, b in zip(ahead, behind, strict=True)]
            assert near.rate[:, j] == pytest.approx(np.array(moved) / (2 * step), abs=2e-3)
        count += len(near.posture)
    return count


def test_distances_of_the_several_nearest_pairs_answer_to_the_joints_as_differences_say() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.2).apply_translation([2.4, 0.3, 1.2])
    scene = build_scene(ROBOT, fixture=ball, self_collision=False)
    q = REST + 0.3 * np.random.default_rng(0).standard_normal((12, 6))
    assert check_slopes(scene, q, 0.7) > 12
    near, nearest = find_near(ROBOT, scene.solids, q, scene.outside, far=3.0), np.full(12, 3.0)
    np.minimum.at(nearest, near.posture, near.distance)
    assert nearest == pytest.approx([c.distance for c in find_contacts(ROBOT, scene.solids, q, scene.outside, far=3.0)])
    assert np.bincount(near.posture).max() <= 6


def test_two_pairs_that_are_equally_near_have_each_a_slope_of_their_own() -> None:
    flange = locate_links(ROBOT, REST)[ROBOT.flange][0][:3, 3]
    tool = trimesh.creation.icosphere(subdivisions=3, radius=0.3)
    walls = [trimesh.creation.box((4.0, 0.1, 4.0)) for _ in range(2)]
    for wall, side in zip(walls, (-0.4, 0.4), strict=True):
        wall.apply_translation([flange[0], flange[1] + side, flange[2]])
    scene = build_scene(ROBOT, tool=tool, part=walls[0], fixture=walls[1], self_collision=False)
    place = {solid.name: k for k, solid in enumerate(scene.solids)}
    pairs = np.array([[place["tool"], place["part"]], [place["fixture"], place["tool"]]])
    near = find_near(ROBOT, scene.solids, REST, pairs, far=0.06)
    both = near.distance.argsort()
    assert near.distance == pytest.approx([0.05, 0.05], abs=3e-3)
    slopes = near.rate[both, 0]  # the first axis turns the ball from one wall to the other
    assert slopes.min() == pytest.approx(-slopes.max(), rel=0.02)
    assert slopes.max() == pytest.approx(flange[0], rel=0.02)


def test_what_is_passed_between_two_stations_is_noticed() -> None:
    q = np.tile(REST, (3, 1))
    q[:, 0] = [-1.5, -0.5, 0.5]
    middle = locate_links(ROBOT, 0.5 * (q[1:2] + q[2:]))[ROBOT.flange][0]
    post = trimesh.creation.cylinder(0.02, height=0.5).apply_translation(middle[:3, 3])
    scene = build_scene(ROBOT, fixture=post, self_collision=False)
    assert measure_margin(scene, q, 0.005).min() > 0.0
    places, margin = sweep_margin(scene, q, 0.005, np.arange(3.0))
    assert margin.min() < 0.0 and 1.0 < places[margin.argmin()] < 2.0
    aside = build_scene(ROBOT, fixture=post.copy().apply_translation([0, 0, 3.0]), self_collision=False)
    assert sweep_margin(aside, q, 0.005, np.arange(3.0))[1].min() > 0.0


def test_the_graph_turns_the_tool_away_from_an_obstacle() -> None:
    # an angled spindle whose best rotation would stand where a post is
    turn = np.radians(135.0)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    pose[:3, 3] = [0.362, 0.0, -0.212]
    robot = ROBOT.with_tool(pose)
    spindle = trimesh.creation.cylinder(0.05, segment=([0.15, 0, 0], [0.3, 0.0, -0.15]))
    n = 30
    position = np.column_stack([np.full(n, 1.7), np.linspace(-0.1, 0.1, n), np.full(n, 0.8)])
    wrench = np.tile([300.0, 100.0, 400.0, 0, 0, 0], (n, 1))
    axis, feed = np.tile([0, 0, 1.0], (n, 1)), np.full(n, 0.05)
    nominal = Toolpath(position, axis, feed, np.zeros(n, bool), wrench, frame="base")
    settings = PostureSettings(stations=15, spin_step=np.radians(10))

    free = choose_posture_path(PostureProblem(robot, nominal, np.array([1.0, 0, 0]), settings))
    middle = locate_links(robot, free.q[n // 2 : n // 2 + 1])[robot.flange][0]
    post = trimesh.creation.box((0.15, 0.15, 0.15)).apply_translation(middle[:3, 3])
    scene = build_scene(robot, tool=spindle, fixture=post)
    assert measure_margin(scene, free.q, 0.01).min() < 0
    settings = replace(settings, scene=scene, clearance=0.01)
    clear = choose_posture_path(PostureProblem(robot, nominal, np.array([1.0, 0, 0]), settings))
    assert measure_margin(scene, clear.q, 0.01).min() >= 0
    assert clear.costs["sensitivity_rms_mm"] >= free.costs["sensitivity_rms_mm"] * 0.999


def test_the_clearance_that_a_job_asks_for_is_that_of_its_posture() -> None:
    table = {"schema": 1, "robot": "kuka_kr240", "process": {"model": "constant", "force_N": [0.0, 0.0, 100.0]},
             "toolpath": {"generator": "circle", "radius_mm": 50.0, "waypoints": 20, "feed_mm_s": 20.0}}  # fmt: skip
    for collision, wanted in (({"clearance_mm": 12.5}, 0.0125), ({}, 5e-3)):
        job = check_job({**table, "collision": collision}, "job.toml")
        assert read_settings(job, ROBOT).clearance == pytest.approx(wanted)


def test_missing_and_empty_meshes_are_named(tmp_path) -> None:
    with pytest.raises(InputError, match="no mesh file"):
        load_mesh(tmp_path / "part.stl")
    (tmp_path / "part.ply").write_text("not a mesh")
    with pytest.raises(InputError, match=r"part\.ply"):
        load_mesh(tmp_path / "part.ply")


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr240", "staubli_tx200", "ur10", "fanuc_m10ia"])
def test_every_arm_keeps_clear_of_itself_in_an_ordinary_posture(name: str) -> None:
    robot = load_robot(name)
    scene = build_scene(robot)
    q = np.zeros((1, robot.nq))
    q[0, 1], q[0, 4] = 0.1, 0.3
    assert measure_margin(scene, q, 0.0)[0] > 0


def test_a_capsule_from_flange_to_tip_stands_for_a_tool_without_a_mesh():
    from compplan.planning.posture.collision_scene import CAPSULE_RADIUS, stand_in_tool

    pose = np.array([[0, 0, 1.0, 0.3], [0, 1, 0, 0], [-1, 0, 0, -0.4], [0, 0, 0, 1.0]])
    capsule = stand_in_tool(ROBOT.with_tool(pose))
    corners = capsule.vertices @ np.array([0.6, 0, -0.8])
    assert corners.min() == pytest.approx(-CAPSULE_RADIUS, abs=1e-9)
    assert corners.max() == pytest.approx(0.5 + CAPSULE_RADIUS, abs=1e-9)
    assert stand_in_tool(ROBOT.with_tool(np.eye(4))) is None
