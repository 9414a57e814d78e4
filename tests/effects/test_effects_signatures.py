"""Signatures against the exact forward model, by finite differences, for every effect, place and form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_campaigns import draw_robot_files, rail_arm
from scipy.spatial.transform import Rotation

from compplan.effects import EFFECTS, apply_effects, build_model, solve_model_poses
from compplan.effects.frame_shift import shift_at
from compplan.effects.linearization import Linearization, linearize_model
from compplan.effects.signature import Signature
from compplan.effects.transmission_error import spline_at
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot, load_robot


def make_campaign(robot: Robot, seed: int = 3) -> Campaign:
    """Make a campaign with two static runs and a path, loads, encoders and a warm-up."""
    random = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.25 * (robot.upper - robot.lower)
    static = np.repeat(middle + half * random.uniform(-1, 1, (30, robot.nq)), 2, axis=0)
    phase = np.linspace(0, 3.0, 60)[:, None]
    path = middle + 0.1 * half * np.sin(phase + np.arange(robot.nq))
    q = np.vstack([static, path])
    wrench = np.concatenate([random.normal(0, 400, (len(q), 3)), random.normal(0, 60, (len(q), 3))], axis=1)
    run = np.array(["static_1"] * 30 + ["static_2"] * 30 + ["path_1"] * 60)
    time = np.r_[np.arange(60) * 20.0, 1300.0 + 0.05 * np.arange(60)]
    n = len(q)
    return Campaign(
        run=run, q=q, wrench=wrench, position=np.zeros((n, 3)), rotation=np.broadcast_to(np.eye(3), (n, 3, 3)),
        time=time, temperature=20 + 10 * (1 - np.exp(-time / 1000)), link=q.copy(),
    )  # fmt: skip


def make_linearization(robot: Robot) -> Linearization:
    scene = build_model(robot, make_campaign(robot))
    return linearize_model(scene, solve_model_poses(scene))


def all_signatures(at: Linearization) -> list[Signature]:
    found = [s for model in EFFECTS.values() for s in model.signatures(at)]
    return [*found, *shift_at(at, 17), spline_at(at, 1)]


def worst_disagreement(at: Linearization, signature: Signature) -> float:
    """Compare a signature with central differences of the exact model; relative to its largest motion."""
    worst = 0.0
    for k, scale in enumerate(signature.scale):
        sides = []
        # play is no smooth function of its width: its signature is the secant between zero and half its scale
        ends = (0.5, 1e-9) if signature.name == "backlash" else (1e-2, -1e-2)
        for end in ends:
            values = np.zeros(len(signature.scale))
            values[k] = end * scale
            effect = signature.effect(values)
            scene = apply_effects(at.scene, [effect])
            sides.append(solve_model_poses(scene))
        step = (ends[0] - ends[1]) * scale
        linear = (sides[0].position - sides[1].position) / step
        turn = Rotation.from_matrix(sides[0].rotation @ np.swapaxes(sides[1].rotation, 1, 2)).as_rotvec() / step
        exact = np.concatenate([linear, turn], axis=1)
        twist = signature.twist[:, :, k]
        link = (sides[0].link - sides[1].link) / step
        encoder = np.zeros_like(link) if signature.encoder is None else signature.encoder[:, :, k]
        size = max(np.abs(exact).max(), np.abs(link).max(), 1e-12)
        worst = max(worst, np.abs(exact - twist).max() / size, np.abs(link - encoder).max() / size)
    return worst


ROBOT = replace(load_robot("kuka_kr270"), link_elasticities=())
AT = make_linearization(ROBOT)
EVERY = all_signatures(AT)
#: Effects whose signatures depend on slides that have travelled, and on a tool that stands askew.
OF_SLIDES_AND_TOOLS = ("joint_offset", "link_geometry", "payload", "thermal_drift", "tool_frame")


@pytest.mark.parametrize("name", sorted({s.name for s in EVERY}))
def test_signature_agrees_with_the_exact_model_at_every_place(name: str) -> None:
    # one-sided models (compliances from zero, play) are compared where they are smooth
    tolerance = {"time_skew": 0.08, "tracking_lag": 0.15, "backlash": 0.02}.get(name, 0.02)
    for signature in (s for s in EVERY if s.name == name):
        if name in ("link_compliance", "base_compliance"):
            continue
        assert worst_disagreement(AT, signature) < tolerance, (signature.place, signature.form)


def test_signatures_hold_on_a_rail_and_with_a_tool_that_stands_askew(tmp_path: Path) -> None:
    at = make_linearization(draw_robot_files(rail_arm(), tmp_path).robot)
    for signature in (s for name in OF_SLIDES_AND_TOOLS for s in EFFECTS[name].signatures(at)):
        assert worst_disagreement(at, signature) < 0.02, (signature.place, signature.form)


def test_compliance_of_rigid_links_agrees_with_the_exact_model() -> None:
    for signature in (s for s in EVERY if s.name in ("link_compliance", "base_compliance")):
        value = np.array([0.05 * signature.scale[0]])
        after = solve_model_poses(apply_effects(AT.scene, [signature.effect(value)]))
        moved = (after.position - AT.attained.position) / value[0]
        assert np.abs(moved - signature.twist[:, :3, 0]).max() <= 0.02 * np.abs(moved).max() + 1e-3, signature.place


def test_every_effect_of_the_vocabulary_is_offered_somewhere() -> None:
    without_gravity = make_linearization(replace(ROBOT, gravity=None))
    offered = {s.name for s in [*EVERY, *all_signatures(without_gravity)]}
    assert offered == set(EFFECTS)
