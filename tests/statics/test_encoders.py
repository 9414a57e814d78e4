from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.errors import InputError, ShapeError
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.encoders import actuator_selection, control_equilibrium, link_share

RNG = np.random.default_rng(5)
Q = RNG.uniform(-1, 1, (8, 6))
WRENCH = RNG.normal(size=(8, 6)) * [400, 400, 400, 40, 40, 40]


def test_each_encoder_reads_its_own_side_of_the_gear() -> None:
    chain = build_chain(load_robot("staubli_tx200"))
    state = control_equilibrium(chain, Q, WRENCH)
    np.testing.assert_array_equal(state.motor, Q)
    own = [chain.spring_names.index(name) for name in ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5")]
    np.testing.assert_allclose(state.difference[:, :5], state.loaded.theta[:, own], atol=1e-15)
    assert not state.difference[:, 5].any()  # rigid there


def test_a_second_spring_beside_the_axis_is_seen_by_no_encoder() -> None:
    chain = build_chain(load_robot("staubli_tx200"))
    sideways = chain.spring_names.index("joint_3.rx")
    assert not actuator_selection(chain)[:, sideways].any()
    assert actuator_selection(chain).sum() == 5


def test_link_feedback_takes_out_the_gears_and_leaves_the_links() -> None:
    robot = load_robot("kuka_kr270_full")
    chain = build_chain(robot)
    links_alone = build_chain(replace(robot, springs=()))
    state = control_equilibrium(chain, Q, WRENCH, feedback="link")
    np.testing.assert_allclose(state.link, Q, atol=1e-15)
    np.testing.assert_allclose(state.loaded.position, solve_equilibrium(links_alone, Q, WRENCH).position, atol=1e-12)


@pytest.mark.parametrize("feedback", ["motor", "link", "combined"])
def test_the_arm_stands_where_its_motor_readings_put_it(feedback: str) -> None:
    chain = build_chain(load_robot("kuka_kr270_full"))
    state = control_equilibrium(chain, Q, WRENCH, feedback=feedback, beta=0.3)
    from_motor = solve_equilibrium(chain, state.motor, WRENCH)
    np.testing.assert_allclose(from_motor.position, state.loaded.position, atol=1e-11)
    if feedback == "combined":
        np.testing.assert_allclose(state.link + 0.3 * state.difference, Q, atol=1e-14)


def test_combined_feedback_cancels_a_link_that_bends_about_the_joints_own_axis(tmp_path: Path) -> None:
    extra = '[[spring]]\njoint = "joint_1"\naxis = "ry"\nactuator = false\ncompliance = 4e-6'
    chain = build_chain(one_joint_arm(tmp_path, compliance=1e-5, extra=extra))
    load, q = np.array([[0, 0, -2000.0, 0, 0, 0]]), np.zeros((1, 1))
    beta = link_share(np.array([1e-5]), np.array([1.4e-5]))
    assert beta == pytest.approx(0.4)
    error = {}
    for feedback in ("motor", "link", "combined"):
        state = control_equilibrium(chain, q, load, feedback=feedback, beta=beta)
        error[feedback] = np.linalg.norm(state.loaded.position - locate_frames(chain, q).tcp_position)
    assert error["link"] == pytest.approx(4 / 14 * error["motor"], rel=1e-3)
    assert error["combined"] < 1e-12


def test_what_cannot_be_controlled_is_refused() -> None:
    chain = build_chain(load_robot("kuka_kr270"))
    with pytest.raises(InputError, match="choose from"):
        control_equilibrium(chain, Q, feedback="camera")
    with pytest.raises(ShapeError, match="beta"):
        control_equilibrium(chain, Q, feedback="combined", beta=np.zeros(5))
    coupled = chain.compliance.copy()
    coupled[0, 1] = coupled[1, 0] = 1e-8
    with pytest.raises(InputError, match="coupled"):
        control_equilibrium(replace(chain, compliance=coupled), Q)
