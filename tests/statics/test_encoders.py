from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.errors import InputError, ShapeError
from compplan.robot import Robot, load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.encoders import actuator_selection, combined_gain, control_equilibrium

RNG = np.random.default_rng(5)
Q = RNG.uniform(-1, 1, (8, 6))
WRENCH = RNG.normal(size=(8, 6)) * [400, 400, 400, 40, 40, 40]


def without_link_share(robot: Robot) -> Robot:
    """Return the robot whose actuator springs are gears alone."""
    return replace(robot, springs=tuple(replace(spring, link_share=0.0) for spring in robot.springs))


def test_each_encoder_reads_its_own_side_of_the_gear() -> None:
    chain = build_chain(load_robot("staubli_tx200"))
    state = control_equilibrium(chain, Q, WRENCH)
    np.testing.assert_array_equal(state.motor, Q)
    own = [chain.spring_names.index(name) for name in ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5")]
    between = (1.0 - chain.link_share[own]) * state.loaded.theta[:, own]
    np.testing.assert_allclose(state.difference[:, :5], between, atol=1e-15)
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
    chain = build_chain(without_link_share(one_joint_arm(tmp_path, compliance=1e-5, extra=extra)))
    load, q = np.array([[0, 0, -2000.0, 0, 0, 0]]), np.zeros((1, 1))
    beta = combined_gain(np.array([1e-5]), np.array([1.4e-5]))
    assert beta == pytest.approx(0.4)
    error = {}
    for feedback in ("motor", "link", "combined"):
        state = control_equilibrium(chain, q, load, feedback=feedback, beta=beta)
        error[feedback] = np.linalg.norm(state.loaded.position - locate_frames(chain, q).tcp_position)
    assert error["link"] == pytest.approx(4 / 14 * error["motor"], rel=1e-3)
    assert error["combined"] < 1e-12


def test_one_spring_with_a_link_share_is_the_gear_and_the_link_that_it_stands_for(tmp_path: Path) -> None:
    """A spring of 1.4e-5 with a share of 4/14 beyond the encoder against a gear of 1e-5 and a link of 4e-6."""
    extra = '[[spring]]\njoint = "joint_1"\naxis = "ry"\nactuator = false\ncompliance = 4e-6'
    apart = build_chain(without_link_share(one_joint_arm(tmp_path, compliance=1e-5, extra=extra)))
    lumped = one_joint_arm(tmp_path, compliance=1.4e-5)
    springs = tuple(replace(spring, link_share=4 / 14) for spring in lumped.springs)
    together = build_chain(replace(lumped, springs=springs))
    load, q = np.array([[0, 0, -2000.0, 0, 0, 0]]), np.zeros((1, 1))
    for feedback in ("motor", "link", "combined"):
        one, two = (control_equilibrium(c, q, load, feedback=feedback, beta=0.3) for c in (apart, together))
        np.testing.assert_allclose(two.loaded.position, one.loaded.position, atol=1e-9)
        np.testing.assert_allclose(two.difference, one.difference, atol=1e-9)


def test_a_folder_that_states_no_link_share_gets_the_assumed_one_where_links_are_not_elastic(tmp_path: Path) -> None:
    assert [spring.link_share for spring in one_joint_arm(tmp_path, compliance=1e-5).springs] == [0.4]
    assert {spring.link_share for spring in load_robot("kuka_kr270_full").springs} == {0.0}
    with pytest.raises(InputError, match="not between the encoders"):
        one_joint_arm(tmp_path, compliance=1e-5, extra='[[spring]]\njoint = "joint_1"\naxis = "rx"\n'
                      "compliance = 4e-6\nlink_share = 0.2")  # fmt: skip


def test_on_a_robot_of_six_lumped_springs_the_secondary_encoder_leaves_the_link_share() -> None:
    chain = build_chain(load_robot("kuka_kr270"))
    nominal = locate_frames(chain, Q).tcp_position
    left = {}
    for feedback in ("motor", "link", "combined"):
        position = control_equilibrium(chain, Q, WRENCH, feedback=feedback, beta=0.4 / 0.6).loaded.position
        left[feedback] = np.linalg.norm(position - nominal, axis=1).mean()
    assert left["link"] / left["motor"] == pytest.approx(0.4, rel=0.01)
    assert left["combined"] < 1e-3 * left["link"]


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
