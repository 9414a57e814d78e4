from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from compplan.cli import load_command
from compplan.errors import InputError
from compplan.reporting.maps import survey
from compplan.reporting.maps.reach import POSTURES, Plane, make_plane, reach_plane, stand_of_arm, working_limits
from compplan.reporting.maps.survey import MapSettings, map_deflection, map_robot
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.ik import build_arm

FULL = load_robot("kuka_kr270_full")
WRENCH = np.array([440.0, 1370, -635, 0, 0, 0])


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("name", ["kuka_kr270_full", "staubli_tx200", "ur10", "kuka_kr240_rail"])
def test_every_posture_of_a_plane_stands_on_its_point_inside_the_limits(name: str, posture: str) -> None:
    robot = load_robot(name)
    arm = build_arm(robot)
    radius = working_limits(arm)[0]
    stand = stand_of_arm(arm)
    side = np.linspace(-radius, radius, 15)
    plane = make_plane("horizontal", stand[0] + side, stand[1] + side, 0.6)
    reached = reach_plane(arm, plane, posture)
    known = np.isfinite(reached).all(axis=-1)
    assert 0.2 < known.any(axis=2).mean() < 0.9
    q = reached[known]
    points = np.broadcast_to(plane.position[:, :, None], (*known.shape, 3))[known]
    frames = locate_frames(arm.chain, q)
    np.testing.assert_allclose(frames.tcp_position, points, atol=1e-6)
    assert ((q >= robot.lower - 2e-6) & (q <= robot.upper + 2e-6)).all()
    if posture == "straight":
        assert not q[:, arm.arm[3:]].any()
    else:
        pointing = frames.tcp_rotation[:, :, 2]
        assert np.allclose(pointing, [0, 0, -1]) if posture == "down" else np.allclose(pointing[:, 2], 0)


def test_straight_postures_are_found_wherever_random_ones_get() -> None:
    arm = build_arm(FULL)
    rng = np.random.default_rng(2)
    q = np.zeros((300, 6))
    q[:, 0] = 0.0
    q[:, 1:3] = rng.uniform(FULL.lower[1:3], FULL.upper[1:3], (300, 2))
    points = locate_frames(arm.chain, q).tcp_position
    reached = reach_plane(arm, Plane("vertical", points[:, 0], points[:1, 2], 0.0, points[None]), "straight")
    assert np.isfinite(reached).all(axis=-1).any(axis=2).mean() > 0.99


def test_the_full_model_with_a_straight_wrist_yields_3_8_um_per_newton_at_most() -> None:
    """[Mamedov2018]: about 4 um/N in both planes; beams of 70 GPa give 3.8."""
    arm = build_arm(FULL)
    radius, lowest, highest = working_limits(arm)
    side = np.linspace(-radius, radius, 60)
    for plane in (
        make_plane("horizontal", side, side, 0.5),
        make_plane("vertical", np.linspace(0, radius, 60), np.linspace(lowest, highest, 60), 0.0),
    ):
        result = map_deflection(FULL, plane, reach_plane(arm, plane, "straight"), WRENCH)
        assert np.nanmax(result.worst) == pytest.approx(3.8e-6, rel=0.03)


def test_a_map_shows_what_the_model_says_at_each_point() -> None:
    arm = build_arm(FULL)
    side = np.linspace(-2.9, 2.9, 12)
    plane = make_plane("horizontal", side, side, 0.8)
    result = map_deflection(FULL, plane, reach_plane(arm, plane, "down"), WRENCH)
    reached = result.reached
    q, chain = result.q[reached], build_chain(FULL)
    compliance = cartesian_compliance(chain, q)[:, :3, :3]
    along = np.linalg.norm(np.einsum("nij,nj->ni", compliance, result.force[reached]), axis=1)
    np.testing.assert_allclose(along, result.worst[reached], rtol=1e-9)
    moved = solve_equilibrium(chain, q, WRENCH).position - locate_frames(chain, q).tcp_position
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), result.under_wrench[reached], rtol=1e-9)


def test_the_map_turns_with_the_first_joint() -> None:
    arm = build_arm(load_robot("staubli_tx200"))
    u, v = np.linspace(0.5, 1.8, 8), np.linspace(0.2, 1.5, 8)
    here, there = (
        map_deflection(arm.robot, plane, reach_plane(arm, plane, "down"), np.zeros(6))
        for plane in (make_plane("vertical", u, v, angle) for angle in (0.0, 1.0))
    )
    np.testing.assert_allclose(here.worst, there.worst, rtol=1e-7)


def test_the_command_writes_maps_pictures_and_a_page(tmp_path: Path) -> None:
    arguments = ["kuka_kr270_full", "--out", str(tmp_path / "out"), "--points", "15", "--json"]
    result = CliRunner().invoke(load_command("map"), arguments, catch_exceptions=False)
    assert result.exit_code == 0
    summary = json.loads(result.stdout)
    table = json.loads((tmp_path / "out" / "map.json").read_text())
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "map.json", "report.html", "map_horizontal.png", "map_vertical.png", "manifest.json"
    }  # fmt: skip
    horizontal = table["planes"]["horizontal"]
    values = [x for row in horizontal["worst_unit_force_map_um_per_N"] for x in row if x is not None]
    assert max(values) == summary["planes"]["horizontal"]["worst_unit_force_um_per_N"]["max"]
    assert len(horizontal["u_mm"]) == 15


def test_degrees_and_millimetres_of_the_command_become_si(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[MapSettings] = []
    monkeypatch.setattr(survey, "map_robot", lambda robot, settings: asked.append(settings))
    words = ["kuka_kr270", "--azimuth-deg", "30", "--height-mm", "250", "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(load_command("map"), words).exit_code != 0  # nothing was mapped
    assert (asked[0].azimuth, asked[0].height) == pytest.approx((np.pi / 6, 0.25))


def test_twice_as_soft_yields_twice_as_much_on_the_map() -> None:
    robot = load_robot("kuka_kr270")
    settings = MapSettings(points=9)
    one, two = (map_robot(r, settings).summary() for r in (robot, robot.scale_compliance(2.0)))
    worst = [s["planes"]["vertical"]["worst_unit_force_um_per_N"]["max"] for s in (one, two)]
    assert worst[1] == pytest.approx(2 * worst[0], rel=1e-3)


def test_what_cannot_be_mapped_is_refused() -> None:
    with pytest.raises(InputError, match="no elasticity"):
        map_robot(load_robot("ur10"), MapSettings())
    with pytest.raises(InputError, match="choose from"):
        reach_plane(build_arm(FULL), make_plane("horizontal", np.ones(2), np.ones(2), 0.5), "sideways")
    with pytest.raises(InputError, match="choose from"):
        make_plane("oblique", np.ones(2), np.ones(2), 0.5)
