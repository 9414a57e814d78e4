"""Joint and link compliance told apart by double encoders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.round_trip import draw_candidates, simulate_observations
from compplan.identification import build_structure, estimate_parameters
from compplan.measurement.campaign import Campaign, make_log
from compplan.robot import Robot, load_robot
from compplan.robot.springs import link_springs
from compplan.statics.chain import build_chain
from compplan.statics.elastic import solve_equilibrium

N = 30
LINK = 2e-7


def campaign(*, vertical: bool = False, seed: int | None = None) -> tuple[Robot, Campaign]:
    robot = replace(load_robot("kuka_kr120_r3900"), link_elasticities=())
    truth = replace(robot, springs=(*robot.springs, *(replace(s, compliance=LINK) for s in link_springs(robot))))
    drawn = draw_candidates(robot, N, vertical=vertical, lever=0.0 if vertical else 0.3, force=981.0, seed=1)
    nothing = np.zeros((N, 6))
    modes = np.repeat([False, True, False, True], N)  # U1 U2 L1 L2
    loads = np.vstack([nothing, nothing, drawn.wrench, drawn.wrench])
    rows = simulate_observations(truth, np.vstack([drawn.q] * 4), loads, link_side=modes, seed=seed)
    return robot, rows


def test_joint_1_is_unobservable_under_vertical_loads_in_every_mode() -> None:
    robot, rows = campaign(vertical=True)
    structure = build_structure(robot, add=link_springs(robot))
    estimate = estimate_parameters(structure, rows, sigma="stated")
    reasons = {item.held: item.reason for item in estimate.held}
    assert {"joint_1", "joint_1.link"} <= set(reasons)
    assert "all loads are vertical" in reasons["joint_1.link"]


def test_all_modes_together_are_fitted_exactly_with_intervals() -> None:
    robot, rows = campaign(seed=3)
    structure = build_structure(robot, add=link_springs(robot))
    estimate = estimate_parameters(structure, rows)
    truth = np.array([*(spring.compliance for spring in robot.springs), *[LINK] * 6])
    score = (estimate.model_values - truth)[estimate.free] / estimate.standard_errors[estimate.free]
    assert np.abs(score).max() < 4


def test_encoder_readings_sharpen_the_gears_beside_positions() -> None:
    robot, rows = campaign(seed=3)
    loaded = rows.take(np.arange(2 * N, 3 * N))
    structure = build_structure(robot, add=link_springs(robot))
    first = estimate_parameters(structure.select(robot.joint_names), loaded)
    truth = structure.set_compliances(np.array([*(spring.compliance for spring in robot.springs), *[LINK] * 6]))
    seen = first.state.torque @ build_chain(truth).compliance
    gears = np.flatnonzero(structure.chain.actuator)
    encoder = seen[:, gears] + 1e-5 * np.random.default_rng(0).standard_normal((N, 6))
    both = make_log(
        loaded.q, loaded.wrench, loaded.position, loaded.rotation, sigma=loaded.sigma,
        sigma_rotation=loaded.sigma_rotation, encoder=encoder,
    )  # fmt: skip
    estimate = estimate_parameters(structure, both)
    gear, link = estimate.model_values[:6], estimate.model_values[6:]
    np.testing.assert_allclose(gear, [s.compliance for s in robot.springs], rtol=0.05)
    np.testing.assert_allclose(link[:3], LINK, rtol=0.15)


def test_a_spring_that_is_written_against_its_joint_keeps_its_sign() -> None:
    # Joint 3 turns about -y; a folder may write its spring about ry.
    robot = load_robot("kuka_kr270")
    springs = (replace(s, axis="ry") if s.joint == "joint_3" else s for s in robot.springs)
    written = replace(robot, springs=tuple(springs))
    drawn = draw_candidates(robot, N, seed=1)
    chain = build_chain(robot)
    yielded = solve_equilibrium(chain, drawn.q, drawn.wrench).theta  # own axes, in the order of the joints
    seen = simulate_observations(robot, drawn.q, drawn.wrench)
    rows = replace(seen, link=seen.q + yielded)
    estimate = estimate_parameters(build_structure(written, add=link_springs(written)), rows, sigma="stated")
    found = dict(zip(estimate.names, estimate.values, strict=True))
    assert found["joint_3.ry"] == pytest.approx(robot.springs[2].compliance, rel=1e-3)
    assert abs(found["joint_3.link"]) < 1e-3 * robot.springs[2].compliance
