from __future__ import annotations

import numpy as np
import pytest

from compplan.process.cutting import shape_milling
from compplan.process.engagement import Cutter, Engagement
from compplan.process.engagement_search import find_engagement
from compplan.process.force_models.drill import DRILLED, DrillProcess
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.process.force_models.milling import MillingProcess, milling_wrench
from compplan.process.materials import MATERIALS, Coefficients
from compplan.process.stock import build_block

FLAT = Cutter(5e-3, 0.03)
PLAIN = Coefficients((800.0, 320.0, 0.0))


def engage(cutter: Cutter, start: tuple[float, float, float], end: tuple[float, float, float]) -> Engagement:
    path = np.array(start) + np.linspace(0, 1, 61)[:, None] * np.subtract(end, start)
    block = build_block(np.array([-0.05, -0.05, -0.02]), np.array([0.05, 0.05, 0.0]), np.eye(3))
    return find_engagement(cutter, path * 1e-3, np.ones(61, bool), block)


def mean(found: Engagement, material: Coefficients, feed_per_tooth: float, teeth: int = 2) -> np.ndarray:
    shape = shape_milling(found, teeth, material.exponent)
    return shape.wrench(material, np.full(len(found), feed_per_tooth))[-1]


@pytest.mark.parametrize(("y", "width", "side"), [(0.0, 10.0, "right"), (50.0, 5.0, "right"), (-50.0, 5.0, "left")])
def test_without_edge_force_and_exponent_it_is_the_force_of_constant_coefficients(y, width, side) -> None:
    found = engage(FLAT, (-60, y, -2), (0, y, -2))
    plain = MillingProcess.model_validate({
        "model": "milling", "depth_mm": 2.0, "width_mm": width, "diameter_mm": 10.0, "spindle_rpm": 6000.0,
        "kc_N_mm2": 800.0, "radial_ratio": 0.4, "material_side": side,
    })  # fmt: skip
    feed = 0.02
    expected = milling_wrench(plain, np.array([feed]))[0]
    wrench = mean(found, PLAIN, feed / (100 * 2))
    assert wrench[:3] == pytest.approx(expected[:3], abs=0.01 * np.linalg.norm(expected[:3]))
    assert wrench[5] == pytest.approx(expected[5], rel=0.01)


def test_the_edge_force_stays_in_thin_chips_and_goes_at_rest() -> None:
    found = engage(FLAT, (-60, 0, -2), (0, 0, -2))
    material = Coefficients((800.0, 320.0, 0.0), (20.0, 0.0, 0.0))
    wrench = mean(found, Coefficients((1e-3, 0.0, 0.0), material.edge), 1.2e-5)
    # a slot: half of each tooth's turn, tangential 20 N/mm on 2 mm, two teeth
    assert wrench[1] == pytest.approx(2 / (2 * np.pi) * 20 * 2 * 2, rel=0.01)
    assert wrench[5] == pytest.approx(0.5 * 2 * 20 * 2 * 5e-3, rel=0.01)
    assert not mean(found, material, 0.0).any()


def test_the_exponent_makes_thin_chips_dear() -> None:
    found = engage(FLAT, (-60, 0, -2), (0, 0, -2))
    material = Coefficients((800.0, 0.0, 0.0), exponent=(0.25, 0.0, 0.0))
    ratio = mean(found, material, 0.1e-3)[5] / mean(found, material, 0.05e-3)[5]
    assert ratio == pytest.approx(2**0.75, rel=1e-6)


def test_a_plunge_and_a_lift_do_not_push_sideways() -> None:
    down = engage(FLAT, (0, 0, 1), (0, 0, -3))
    wrench = mean(down, MATERIALS["al7075_t6"], 0.05e-3)
    assert wrench[2] > 100.0
    assert np.abs(wrench[:2]).max() < 1e-9 * wrench[2]
    path = np.zeros((40, 3))
    path[:, 2] = np.r_[np.linspace(1, -3, 20), np.linspace(-3, 5, 20)]
    block = build_block(np.array([-0.05, -0.05, -0.02]), np.array([0.05, 0.05, 0.0]), np.eye(3))
    found = find_engagement(FLAT, path * 1e-3, np.ones(40, bool), block)
    shape = shape_milling(found, 2, (0.0, 0.0, 0.0))
    force = shape.wrench(MATERIALS["al7075_t6"], np.full(40, 5e-5))
    assert force[20] == pytest.approx(force[19])  # at rest, engaged as it came
    assert not force[21:].any()


def drill(feed_mm: float, diameter_mm: float = 10.0, material: str | None = "c45", **keys: object) -> np.ndarray:
    """Return the mean wrench of a drill in full cut, two lips."""
    table = {"model": "drill", "diameter_mm": diameter_mm, "spindle_rpm": 1000.0, "material": material}
    process = DrillProcess.model_validate({**table, **keys})
    found = engage(process.cutter(), (0, 0, 1), (0, 0, -15))
    shape = process.shape(found)
    return shape.wrench(process.resistance, np.full(len(found), 0.5e-3 * feed_mm))[-1]


@pytest.mark.parametrize("feed", [0.1, 0.3])
def test_a_drill_in_full_cut_has_the_thrust_and_torque_of_the_makers_table(feed: float) -> None:
    """The thinned web takes .8 of the half of the thrust that the chisel edge of the table makes."""
    wrench = drill(feed)
    assert wrench[2] == pytest.approx(0.6 * 570.0 * 2.2 * 10.0 * feed**0.85, rel=0.01)
    assert wrench[5] == pytest.approx(0.01 * 2.2 * 100.0 * (0.630 + 16.84 * feed), rel=0.01)
    assert not wrench[[0, 1, 3, 4]].any()


def test_a_thinned_drill_in_steel_pushes_as_a_course_says() -> None:
    """10 mm, 0.3 mm a turn, mild steel: 2,500 N and 15 N m in a course on drilling; within a third."""
    wrench = drill(0.3)
    assert wrench[2] == pytest.approx(2500.0, rel=0.33)
    assert wrench[5] == pytest.approx(15.0, rel=0.33)


@pytest.mark.parametrize("material", list(DRILLED))
def test_thrust_and_torque_rise_with_feed_and_diameter(material: str) -> None:
    by_feed = np.array([drill(feed, 6.0, material) for feed in (0.05, 0.1, 0.2, 0.4)])
    by_size = np.array([drill(0.1, size, material) for size in (3.0, 6.0, 12.0)])
    for wrench in (by_feed, by_size):
        assert (wrench[:, [2, 5]] > 0.0).all() and (np.diff(wrench[:, [2, 5]], axis=0) > 0.0).all()


def test_thrust_and_torque_are_within_the_spread_of_a_second_relation() -> None:
    """Shaw and Oxford as Machinery's Handbook prints it (31st edition, p. 1152), a thinned web.

    K_d is from general knowledge of its table 6 (assumed).
    """
    constants = {"al6061_t6": 7000.0, "al6082_t6": 7000.0, "al7075_t6": 7000.0, "aluminium_cast": 7000.0, "c45": 24e3,
                 "low_carbon_steel": 24e3, "low_alloy_steel_300hb": 31e3, "cast_iron_pearlitic": 14e3}  # fmt: skip
    ratio = []
    for name, constant in constants.items():
        for feed in (0.1, 0.3):
            thrust = 0.05 * constant * (feed * 8.0) ** 0.8 * 1.100 + 0.007 * constant * 8.0**2 * 0.001
            torque = 2.5e-5 * constant * feed**0.8 * 8.0**1.8 * 1.000
            ratio.append(drill(feed, 8.0, name)[[2, 5]] / [thrust, torque])
    assert np.min(ratio) > 0.6 and np.max(ratio) < 1.7


def test_pecks_push_only_where_the_hole_is_not_yet() -> None:
    process = DrillProcess(model="drill", diameter_mm=6.0, spindle_rpm=1000.0, material="c45")
    ways = ((1, -6, 71), (-6, 1, 20), (1, -6, 30), (-6, -12, 61))
    depth = np.concatenate([np.linspace(*way) for way in ways])
    path = np.column_stack([np.zeros((len(depth), 2)), depth])
    block = build_block(np.array([-0.05, -0.05, -0.05]), np.array([0.05, 0.05, 0.0]), np.eye(3))
    found = find_engagement(process.cutter(), path * 1e-3, np.ones(len(depth), bool), block)
    thrust = process.shape(found).wrench(process.resistance, np.full(len(depth), 5e-5))[:, 2]
    assert thrust[70] > 0.0 and not thrust[72:120].any()  # up, and down again through the hole
    assert thrust[-1] == pytest.approx(thrust[70], rel=1e-6)


def test_a_material_without_a_constant_of_drilling_is_refused_and_takes_coefficients_of_its_own() -> None:
    others = set(MATERIALS) - set(DRILLED)
    assert others
    for material in others:
        with pytest.raises(ValueError, match=r"choose from .* or give coefficients"):
            DrillProcess(model="drill", diameter_mm=6.0, spindle_rpm=1000.0, material=material)
    own = {"cutting_N_mm2": (900.0, 0.0, 1200.0), "exponent": (0.0, 0.0, 0.15)}
    by_feed = np.array([drill(feed, 6.0, material=None, coefficients=own) for feed in (0.05, 0.1, 0.2, 0.4)])
    assert (np.diff(by_feed[:, [2, 5]], axis=0) > 0.0).all()


def test_an_end_mill_without_a_stated_flute_has_one_of_three_diameters() -> None:
    table = {"model": "end_mill", "diameter_mm": 10.0, "spindle_rpm": 1000.0, "material": "c45"}
    assert EndMillProcess(**table).cutter().flute == pytest.approx(30e-3)
    assert EndMillProcess(**table, flute_mm=22.0).cutter().flute == pytest.approx(22e-3)


@pytest.mark.parametrize("point_deg", [118.0, 100.0])
def test_the_thrust_of_a_drill_grows_while_its_point_enters_and_ends_in_the_air(point_deg: float) -> None:
    process = DrillProcess(model="drill", diameter_mm=10.0, spindle_rpm=1000.0, material="c45", point_deg=point_deg)
    path = np.zeros((120, 3))
    path[:, 2] = np.r_[np.linspace(0.5, -9.5, 100), np.linspace(-9.5, 3.0, 20)]
    block = build_block(np.array([-0.05, -0.05, -0.005]), np.array([0.05, 0.05, 0.0]), np.eye(3))
    found = find_engagement(process.cutter(), path * 1e-3, np.ones(120, bool), block)
    thrust = process.shape(found).wrench(process.resistance, np.full(120, 5e-5))[:, 2]
    into = thrust[: np.searchsorted(-path[:100, 2], 5.0)]  # until the point comes out below
    assert (np.diff(into) > -1e-6).all() and into[-1] > 0.0
    assert into[-1] == pytest.approx(drill(0.1)[2], rel=1e-6)
    full = -path[np.argmax(into > 0.999 * into[-1]), 2]
    assert full == pytest.approx(5.0 / np.tan(np.radians(0.5 * point_deg)), abs=0.25)
    assert not thrust[100:].any()  # drawn out of the hole


def test_a_drill_that_moves_sideways_is_said_to_have_no_force() -> None:
    process = DrillProcess(model="drill", diameter_mm=10.0, spindle_rpm=1000.0, material="c45")
    found = engage(process.cutter(), (-20, 0, -3), (20, 0, -3))
    assert "sideways in material" in process.describe(found, np.ones(len(found), bool))[0]
    assert not process.shape(found).wrench(process.resistance, np.full(len(found), 1e-4)).any()


@pytest.mark.parametrize(("corner", "depth"), [(0.0, 3.0), (3.0, 1.0)])
def test_the_mean_wrench_of_a_slot_is_an_integral_over_the_teeth(corner: float, depth: float) -> None:
    """Of a flat or a ball end mill of 3 mm radius; a tooth of a ball cuts what the sphere a feed back left. [mm, N]"""
    feed, teeth, material, count = 0.05, 3, MATERIALS["al7075_t6"], 600
    u, total = (np.arange(count) + 0.5) / count * 2 * np.pi - np.pi, np.zeros(3)  # from the travel to the left
    cos, sin, zero = np.cos(u), np.sin(u), np.zeros(count)
    top = np.arccos(1.0 - depth / 3.0)
    turns = (np.arange(count) + 0.5) / count * top if corner else np.array([np.pi / 2])
    for turn in turns:
        out, up = np.sin(turn), np.cos(turn)
        way = feed * out * cos
        chip = way + 3.0 - np.sqrt(9.0 - feed**2 + way**2) if corner else way
        directions = np.array(
            [[-sin, cos, zero], [-out * cos, -out * sin, up + zero], [-up * cos, -up * sin, zero - out]]
        )
        area = (3.0 * top if corner else depth) / len(turns) * 2 * np.pi / count
        for c in range(3):
            force = material.cutting[c] * np.maximum(chip, 0.0) ** (1.0 - material.exponent[c]) + material.edge[c]
            total += teeth / (2 * np.pi) * area * (directions[c] * force * (chip > 0.0)).sum(axis=1)
    found = engage(Cutter(3e-3, 0.02, 1e-3 * corner), (-60, 0, -depth), (0, 0, -depth))
    wrench = mean(found, material, 1e-3 * feed, teeth=teeth)
    assert wrench[:3] == pytest.approx(total, abs=0.01 * np.linalg.norm(total))


def test_every_material_says_where_it_comes_from_and_which_are_assumed() -> None:
    for name, material in MATERIALS.items():
        assert material.source, name
        assert material.assumed == material.source.startswith("assumed"), name


@pytest.mark.parametrize("depth", [0.5, 2.0, 20.0])
def test_the_force_acts_at_half_the_engaged_height(depth: float) -> None:
    """A cylinder without axial force: its moments across the axis are half the depth times the force across them."""
    wrench = mean(engage(FLAT, (-60, 3, -depth), (0, 3, -depth)), PLAIN, 5e-5)
    assert wrench[3:5] == pytest.approx(0.5e-3 * depth * np.array([-wrench[1], wrench[0]]), rel=0.02)


def test_a_ball_is_in_the_cut_as_far_behind_its_widest_place_as_the_tooth_before_it_stood_back() -> None:
    found = engage(Cutter(5e-3, 0.03, 5e-3), (-60, 0, -1.5), (0, 0, -1.5))
    edge = Coefficients((0.0, 0.0, 0.0), (0.0, 10.0, 0.0))
    feed, height = 0.06, np.arange(0.0, 1.5, 1e-4) + 5e-5
    rho = np.sqrt(25.0 - (5.0 - height) ** 2)  # each circle of the ball stands a feed before that of the tooth before
    turn = np.pi + 2 * np.arcsin(np.minimum(0.5 * feed / rho, 1.0))
    up = (5.0 - height) / 5.0 * 5.0 / rho * 1e-4  # the normal's rise, and the length of the edge
    assert mean(found, edge, 1e-3 * feed)[2] == pytest.approx(2 / (2 * np.pi) * 10.0 * (up * turn).sum(), rel=0.01)
    assert mean(found, edge, 1e-3 * feed)[2] > 1.02 * mean(found, edge, 1e-5)[2]  # a sixth of the feed
