"""Parts of a folder that are in doubt fade out on paths where the campaign was not, and the band says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

import compplan as cp
from compplan.diagnosis import diagnose_campaign
from compplan.effects import Effect, command_campaign, fold_effects, solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.errors import InputError
from compplan.job.job import Job, check_job
from compplan.job.loading import load_nominal
from compplan.learning.transfer import plan_updated
from compplan.planning.plan import job_robot, plan_job
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.settings import PostureProblem, read_settings
from compplan.robot import Array, Robot, load_robot
from compplan.robot.folder import read_robot_folder, write_robot_folder
from compplan.robot.uncertainty import AlternativeRobot, Uncertainty, Unknown
from compplan.robot.validity import FILE, ValidityPart, ValidityRegion
from compplan.uncertainty.assumed import assume_uncertainty, robot_uncertainty
from compplan.uncertainty.band import estimate_band
from compplan.uncertainty.posture_errors import PostureErrors, derive_force, derive_unknowns, posture_errors
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    build_path_model,
    build_varied_model,
    measure_force_slopes,
    measure_slopes,
    pick_rows,
    read_force_spread,
)
from compplan.uncertainty.shrinkage import keep_share, shrink_alike, shrink_robot

OFFSET = ValidityPart("joint_offset", "joint_2", None, ("offset_rad",), np.array([2e-3]))
WAVES = ValidityPart(
    "transmission_error", "joint_1", None, ("sine_rad#0", "cosine_rad#0"), np.array([3e-4, 2e-4]),
    {"cycles_per_turn": [1.0]},
)  # fmt: skip
FORCE = ForceSpread(0.1, 0.02, 0.03, "made up")


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    robot = write_small_robot(tmp_path_factory.mktemp("robot"))
    return replace(robot, uncertainty=assume_uncertainty(robot))


def folder(nominal: Robot, share: Array, deviation: float) -> Robot:
    """A folder with two errors in doubt that held as told at stays all around, without load."""
    q = np.random.default_rng(3).uniform(-0.6, 0.6, (len(share), nominal.nq)) + np.array([0, 0.4, -0.6, 0, 0.5, 0])
    held = ValidityRegion((OFFSET, WAVES), q, np.zeros((len(q), 6)), share, np.full(len(q), deviation))
    effects = [Effect("joint_offset", "joint_2", None, {"offset_rad": 2e-3}),
               Effect("transmission_error", "joint_1", None,
                      {"cycles_per_turn": [1.0], "sine_rad": [3e-4], "cosine_rad": [2e-4]})]  # fmt: skip
    return replace(fold_effects(nominal, effects), visited=held)


def tip(robot: Robot, q: Array) -> Array:
    return solve_model_poses(build_varied_model(robot, command_campaign(q))).position


def test_what_held_everywhere_stays_where_the_campaign_was_and_fades_under_loads_it_had_not(nominal: Robot) -> None:
    robot = folder(nominal, np.ones(40), 0.1)
    path, still = robot.visited.q[:5], np.zeros((5, 6))
    same, share = shrink_robot(robot, path, still)
    assert same is robot and share == 1.0
    pushed = still.copy()
    pushed[:, 2] = -2000.0
    assert shrink_robot(robot, path, pushed)[1] < 0.5


def test_what_held_by_chance_goes_out_and_widens_the_band_by_its_own_motion(nominal: Robot) -> None:
    chance = np.random.default_rng(5).choice([-1.0, 1.0], 40) * np.random.default_rng(6).uniform(0.5, 2.0, 40)
    robot = folder(nominal, chance, 0.2)
    path = np.array([[1.4, -0.3, 0.2, 1.0, -0.8, 0.5]]) + np.linspace(0, 0.2, 4)[:, None]
    faded, share = shrink_robot(robot, path, np.zeros((4, 6)))
    assert share == 0.0
    assert np.abs(tip(faded, path) - tip(nominal, path)).max() < 1e-9
    assert np.abs(tip(robot, path) - tip(nominal, path)).max() > 1e-4
    scene, rows = build_varied_model(faded, command_campaign(path)), pick_rows(np.ones(4, bool))

    def width(known) -> Array:
        moved = measure_slopes(scene, known.unknowns, rows) @ known.spread
        return np.einsum("nij,nij->n", moved, moved)

    motion = np.sum((tip(robot, path) - tip(nominal, path)) ** 2, axis=1)
    assert width(faded.uncertainty) - width(robot.uncertainty) == pytest.approx(motion, rel=0.02)


def test_the_share_that_stays_is_the_expected_one_and_seldom_worse_than_none(nominal: Robot) -> None:
    """What held alike stays as far as it held; what differs from place to place stays less, and nothing twice."""
    random = np.random.default_rng(8)
    for middle, spread, kept in ((0.5, 0.1, 0.5), (1.0, 0.3, 1.0), (1.0, 0.5, 0.35), (0.5, 0.5, 0.0)):
        robot = folder(nominal, middle + spread * random.standard_normal(40), 0.1)
        robot = replace(robot, visited=replace(robot.visited, spread=spread))
        path, still = robot.visited.q[:5], np.zeros((5, 6))
        faded, share = shrink_robot(robot, path, still)
        assert share == pytest.approx(kept, abs=0.2)
        if middle == 0.5:  # the same place takes nothing out once more
            assert shrink_robot(faded, path, still)[1] == 1.0


def test_a_share_of_the_parts_moves_the_tip_by_that_share(nominal: Robot) -> None:
    robot = folder(nominal, np.ones(40), 0.1)
    path = robot.visited.q[:6]
    whole, part = (tip(one, path) - tip(nominal, path) for one in (robot, keep_share(robot, robot.visited, 0.3)))
    assert np.abs(part - 0.3 * whole).max() < 2e-3 * np.abs(whole).max()


def test_a_taught_folder_is_the_robot_that_was_planned_with_wherever_it_is_planned_again(nominal: Robot) -> None:
    robot = folder(nominal, 0.5 + 0.3 * np.random.default_rng(8).standard_normal(40), 0.1)
    path, still = robot.visited.q[:6], np.zeros((6, 6))
    planned, share = shrink_robot(robot, path, still)
    assert 0.1 < share < 0.9
    known = planned.uncertainty
    taught, held = plan_updated(robot, planned, known, np.zeros(len(known.factor)), known.covariance)
    assert not held.any()
    for push in (0.0, -3000.0):
        again, kept = shrink_robot(taught, path, still + push * np.eye(6)[2])
        assert kept == 1.0
        assert tip(again, path) == pytest.approx(tip(planned, path), abs=1e-9)


def test_parts_of_one_effect_and_joint_fade_by_their_own_share(nominal: Robot) -> None:
    """Waves of other cycles have the same keys: of these the larger once told the share of the smaller."""
    more = replace(WAVES, value=10.0 * WAVES.value, fixed={"cycles_per_turn": [3.0]})
    robot = folder(nominal, np.ones(40), 0.1)
    effects = [Effect("transmission_error", "joint_1", None,
                      {"cycles_per_turn": [3.0], "sine_rad": [3e-3], "cosine_rad": [2e-3]})]  # fmt: skip
    robot = replace(fold_effects(robot, effects), visited=replace(robot.visited, parts=(WAVES, more, OFFSET)))
    path, part = robot.visited.q[:6], keep_share(robot, robot.visited, 0.4)
    assert tip(shrink_alike(robot, part), path) == pytest.approx(tip(part, path), abs=1e-12)
    assert np.abs(tip(part, path) - tip(robot, path)).max() > 1e-4


def test_the_file_is_read_back_and_a_wrong_one_is_refused(nominal: Robot, tmp_path: Path) -> None:
    robot = folder(nominal, np.linspace(0.5, 1.5, 40), 0.1)
    write_robot_folder(robot, tmp_path / "robot")
    again = read_robot_folder(tmp_path / "robot")
    assert [p.effect for p in again.visited.parts] == ["joint_offset", "transmission_error"]
    assert again.visited.q == pytest.approx(robot.visited.q, rel=1e-5)
    path = robot.visited.q[:4]
    before, after = (shrink_robot(one, path, np.zeros((4, 6)))[1] for one in (robot, again))
    assert after == pytest.approx(before, abs=1e-3)
    file = tmp_path / "robot" / FILE
    file.write_text(file.read_text().replace("share = [0.5, ", "share = ["))
    with pytest.raises(InputError, match="has 39 numbers, expected 40"):
        read_robot_folder(tmp_path / "robot")
    # another tool brings its own place and weight
    tool = ValidityPart("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.full(3, 1e-4))
    held = replace(robot.visited, parts=(*robot.visited.parts, tool))
    assert tool not in replace(robot, visited=held).with_tool(np.eye(4), 1.0).visited.parts


def test_a_plan_under_a_load_that_the_campaign_had_not_says_so_and_its_band_is_wider(nominal: Robot) -> None:
    robot = folder(nominal, np.ones(40), 0.1)
    rest = cp.predict_campaign(robot, command_campaign(robot.visited.q[:1], on_path=False))
    place = rest.position[0] + np.linspace(0, 0.02, 6)[:, None] * [1.0, 0.0, 0.0]
    axis = np.tile(-rest.rotation[0][:, 2], (6, 1))
    for force, fades in ((0.0, False), (4000.0, True)):
        load = np.tile([0.0, 0.0, force, 0.0, 0.0, 0.0], (6, 1))
        path = cp.Toolpath(place, axis, np.full(6, 0.02), np.zeros(6, bool), load, "base")
        plan = cp.plan_compensation(robot, path)
        assert any("uncertain errors" in note for note in plan.notes) == fades
        wider = np.max(plan.task.robot.uncertainty.width) > 5.0 * np.max(robot.uncertainty.width)
        assert wider == fades


def test_a_diagnosis_says_which_parts_of_its_folder_are_in_doubt(nominal: Robot) -> None:
    random = np.random.default_rng(8)
    wrong = [
        Effect("link_geometry", f"joint_{k}", axis, {f"{axis}_m": float(random.normal(0, 2e-4))})
        for k in range(2, 6) for axis in ("tx", "ty", "tz")
    ]  # fmt: skip
    campaign = measure(nominal, plan_rows(nominal, 8, poses=24, loads=0), wrong, seed=8, orientation=False)
    found = diagnose_campaign(nominal, campaign)
    robot = found.updated
    sure = [f.effect for f in found.verdict.findings]
    assert robot.visited is not None and len(robot.visited.q) > 20
    # noise makes a part of what the shares of the stays scatter by
    weight = robot.visited.deviation**-2.0
    off = robot.visited.share - np.average(robot.visited.share, weights=weight)
    assert 0.0 < robot.visited.spread**2 < 0.8 * np.average(off**2, weights=weight)
    assert not {e.place for e in sure} & {(p.effect, p.joint, p.axis) for p in robot.visited.parts}
    # what stays without them are the names, as the folder holds them
    held = [e for e in found.delivery.state.effects if e.place in {one.place for one in sure}]
    bare, q = keep_share(robot, robot.visited, 0.0), campaign.q[:4]
    assert np.abs(tip(bare, q) - tip(fold_effects(nominal, held), q)).max() < 2e-6


def test_a_cause_stays_as_far_as_what_a_campaign_cannot_tell_from_it_moves_the_tip_alike(nominal: Robot) -> None:
    """A turn of the link about the joint's axis is a rival of its zero that moves the tip by a known share of it."""
    robot = folder(nominal, np.ones(40), 0.1)
    unknowns = (
        Unknown("joint_offset", "joint_2", None, ("offset_rad",), np.array([1e-4])),
        Unknown("link_geometry", "joint_2", "ry", ("ry_rad",), np.array([1e-4])),
    )
    path, still = robot.visited.q[:5], np.zeros((5, 6))
    told = ((1.0, 0.4, 1.0), (-1.0, 0.4, 0.0), (0.25, 0.4, 0.5), (0.6, 0.4, 0.84), (-1.0, 0.03, 1.0))
    for there, weight, kept in told:
        rival = AlternativeRobot(
            "link_geometry joint_2 ry", "joint_offset joint_2", weight, 2e-3 * np.array([-1.0, there])
        )
        known = Uncertainty("measured", "drawn", unknowns, np.eye(2), rivals=(rival,))
        faded, share = shrink_robot(replace(robot, uncertainty=known), path, still)
        assert share == pytest.approx(kept, abs=0.01)
        assert shrink_robot(faded, path, still)[1] == 1.0  # nothing twice


def stiffness(joint: str, deviation: float) -> Unknown:
    return Unknown("joint_stiffness", joint, None, ("compliance_change_rad_per_Nm",), np.array([deviation]))


def known_by(*unknowns: Unknown, **more: float) -> Uncertainty:
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.zeros(1))
    p = sum(len(unknown.keys) for unknown in unknowns) + 1
    return Uncertainty("measured", "made up", (*unknowns, tool), np.eye(p), repeatability=0.0, **more)


@pytest.mark.parametrize("name", ["kuka_kr270", "staubli_tx200"])
def test_errors_of_postures_to_first_order_are_the_secants_of_the_exact_equilibrium(name: str) -> None:
    """Every assumed unknown, one that only a secant tells, and the force: within 3 % of the greatest column."""
    robot = load_robot(name)
    errors = PostureErrors(robot, robot_uncertainty(robot), FORCE)
    some = np.random.default_rng(5)
    q = 0.5 * (robot.lower + robot.upper) + np.array([0, 0.4, 0.6, 0.2, 0.7, 0.1]) + 0.2 * some.standard_normal((12, 6))
    wrench = np.tile([300.0, -200.0, 500.0, 5.0, 0, -8.0], (12, 1))
    hardening = Unknown(
        "stiffness_nonlinearity", "joint_2", None, ("quadratic_ratio",), np.array([0.02]),
        {"compliance": 1e-7, "reference_load": 2000.0, "zone_load": 2000.0},
    )  # fmt: skip
    unknowns = (*errors.known.unknowns, hardening)
    scene = build_path_model(robot, q, wrench)
    at = linearize_model(scene, solve_model_poses(scene))
    close, exact = derive_unknowns(at, unknowns), measure_slopes(scene, unknowns, np.arange(12))
    size = np.abs(exact).max(axis=(0, 1))
    seen = size > 1e-7  # equilibria settle to 1e-12 m, secants over 1e-4 are known to 1e-8
    assert seen.sum() > 55
    assert (np.abs(close - exact).max(axis=(0, 1)) < 0.03 * size)[seen].all()
    shared, local = measure_force_slopes(scene, np.arange(12), FORCE)
    force = derive_force(at, wrench, FORCE)
    assert force == pytest.approx(np.concatenate([shared, local], axis=2), abs=0.03 * np.abs(shared).max())


JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 60.0, "feed_mm_s": 20.0, "waypoints": 40},
    "part": {"position_mm": [1900.0, 0.0, 700.0], "touched_off": False},
    "tool": {"position_mm": [150.0, 0.0, 250.0], "rotation_deg": [0.0, 30.0, 0.0], "mass_kg": 20.0},
    "process": {"model": "constant", "force_N": [300.0, 400.0, 500.0]},
}


SURE = {"wrench_level": 0.02, "wrench_direction_deg": 0.3, "wrench_path": 0.0}


@pytest.mark.parametrize("joint", ["joint_4", "joint_5"])
def test_a_posture_chosen_for_the_promise_keeps_a_smaller_one_where_one_joint_is_badly_known(joint: str) -> None:
    """One compliance is known to 50 %, the others to 2 %; the accurate preset counts ten per cent of each."""
    bands = {}
    for preset in ("accurate", "error_band"):
        job = check_job({**JOB, "posture": {"preset": preset}, "noise": SURE}, "job.toml")
        robot = job_robot(job)
        own = {spring.joint: spring.compliance for spring in robot.springs if spring.axis == "own"}
        widths = [stiffness(name, (0.5 if name == joint else 0.02) * value) for name, value in own.items()]
        bands[preset] = measure_choice(job, replace(robot, uncertainty=known_by(*widths)))
    assert bands["error_band"] < 0.9 * bands["accurate"]


def measure_choice(job: Job, robot: Robot) -> float:
    """Return the rms of the exact band along the posture that a job's preset chooses."""
    nominal = load_nominal(job)
    settings = read_settings(job, robot, posture_errors(job, robot))
    posture_choice = choose_posture_path(PostureProblem(robot, nominal, job.tool_x_base, settings))
    scene = build_path_model(robot, posture_choice.q, nominal.wrench)
    error_band = estimate_band(robot, scene, ~nominal.rapid, read_force_spread(job))
    return float(np.sqrt(np.mean(error_band.radius[error_band.cut] ** 2)))


@pytest.mark.slow
def test_a_plan_for_the_promise_says_what_it_counts() -> None:
    few = {**JOB["toolpath"], "waypoints": 12}
    plan = plan_job(check_job({**JOB, "toolpath": few, "posture": {"preset": "error_band"}}, "job.toml"))
    posture_choice = plan.task.start.posture_choice
    assert posture_choice is not None and posture_choice.settings.errors is not None
    told = posture_choice.describe()
    assert "assumed" in told["error_band_from"] and "uncertainty_assumed" not in told
    assert plan.error_band is not None
    # what the search counted is what the plan promises: the rms error, and the quantile over errors and waypoints
    spread = np.sqrt(np.mean(np.trace(plan.error_band.covariance[plan.error_band.cut], axis1=1, axis2=2)))
    assert told["costs"]["sensitivity_rms_mm"] == pytest.approx(1e3 * spread, rel=0.03)


def test_presets_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="preset"):
        check_job({**JOB, "posture": {"preset": "error_bands"}}, "job.toml")
