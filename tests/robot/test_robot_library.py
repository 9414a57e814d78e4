"""The library stands where the description packages say, by chains walked in plain numpy, and is solved back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from robot_library import REDUNDANT
from robot_sources import SOURCES, Source

from compplan.robot import load_robot, robot_folders
from compplan.statics import ik
from compplan.statics.chain import build_chain, locate_frames

Array = NDArray[np.float64]
ROBOTS = Path(__file__).parents[2] / "robots"


def turn(axis: Array, angle: float) -> Array:
    """Rodrigues' rotation."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def place(rpy: tuple[float, ...]) -> Array:
    roll, pitch, yaw = (turn(np.eye(3)[k], angle) for k, angle in enumerate(rpy))
    return yaw @ pitch @ roll


def walk(source: Source, q: Array) -> tuple[list[Array], Array, Array]:
    """Return the joints' origins, and position and orientation of tool0."""
    position, rotation, origins = np.zeros(3), np.eye(3), []
    for row, angle in zip(source.joints, q, strict=True):
        position = position + rotation @ np.array(row[:3])
        rotation = rotation @ place(row[3:6]) @ turn(np.array(row[6:]), angle)
        origins.append(position)
    return origins, position + rotation @ np.array(source.tool[:3]), rotation @ place(source.tool[3:])


def test_at_least_twenty_arms_of_ten_makers_came_from_description_packages() -> None:
    makers = {"abb", "comau", "doosan", "fanuc", "franka", "kawasaki", "kuka", "staubli", "ur", "yaskawa"}
    assert len(SOURCES) >= 20 and set(SOURCES) <= set(robot_folders())
    assert {"ur" if name.startswith("ur") else name.split("_")[0] for name in SOURCES} == makers


@pytest.mark.parametrize("name", SOURCES)
def test_the_arm_stands_where_its_source_puts_it_at_zero_and_at_work(name: str) -> None:
    robot, source = load_robot(name), SOURCES[name]
    postures = np.radians([np.zeros(robot.nq), source.work])
    frames = locate_frames(build_chain(robot), postures)
    for row, q in enumerate(postures):
        _, position, rotation = walk(source, q)
        assert frames.tcp_position[row] == pytest.approx(position, abs=2e-7)
        assert frames.tcp_rotation[row] == pytest.approx(rotation, abs=1e-7)
    assert frames.tcp_rotation[1, 2, 2] == pytest.approx(-1, abs=2e-3) or name in REDUNDANT


@pytest.mark.parametrize("name", SOURCES)
def test_limits_are_ordered_and_the_working_posture_comes_back_from_its_pose(name: str) -> None:
    robot, source = load_robot(name), SOURCES[name]
    q = np.radians([source.work])
    assert (robot.lower < robot.upper).all() and (robot.lower < q).all() and (q < robot.upper).all()
    assert (robot.velocity_limits > 0).all() and (robot.effort_limits > 0).all()
    if name in REDUNDANT:
        return
    arm = ik.build_arm(robot)
    frames = locate_frames(arm.chain, q)
    slots = ik.solve_branches(arm, frames.tcp_position, frames.tcp_rotation, q[:, arm.held])
    found = np.abs((slots - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    assert np.nanmin(found) < 1e-6


@pytest.mark.parametrize("name", SOURCES)
def test_the_folder_says_where_its_numbers_come_from_and_no_grade_claims_a_measurement(name: str) -> None:
    robot = load_robot(name)
    assert robot.grade in ("scaled", "placeholder") and robot.sources["compliance"].startswith("assumed")
    text = (ROBOTS / name / "SOURCE.md").read_text(encoding="utf-8")
    licence = next(word for word in ("Apache-2.0", "BSD-3-Clause", "MIT") if f"licensed {word}" in text)
    assert "copyright" in text and (ROBOTS / "LICENSES" / f"{licence}.txt").is_file()
    assert "commit" in robot.sources["geometry"]


SOURCED = {"kuka_kr270": (270.0, 2.70), "kuka_kr240": (240.0, 2.70), "staubli_tx200": (130.0, 2.194)}  # kg, m
RULE = np.array([2.0, 1.5, 1.9, 19.0, 31.0, 14.0]) * 1e-3


def test_the_rule_is_the_geometric_mean_of_the_three_sourced_arms_and_they_scatter_as_documented() -> None:
    twists = np.full((3, 6), np.nan)
    for row, (name, (payload, reach)) in enumerate(SOURCED.items()):
        for spring in load_robot(name).springs:
            if spring.axis == "own":
                twists[row, int(spring.joint[-1]) - 1] = spring.compliance * payload * 9.81 * reach
    logs = np.log(twists)
    assert np.exp(np.nanmean(logs, axis=0)) == pytest.approx(RULE, rel=0.03)
    assert np.exp(np.nanstd(logs, axis=0, ddof=1)) == pytest.approx([1.86, 1.50, 1.53, 1.66, 3.92, 1.08], rel=0.02)
