"""Identification fits through the effects' forward model: what it fits is what it writes, whatever the effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_campaigns import plan_rows, write_small_robot

from compplan.effects import Effect, apply_effects, build_model, robot_effects, solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.effects.requested import geometry_forms
from compplan.errors import InputError, UnknownNameError
from compplan.identification import KNOWN_FRAMES, Rows, build_structure
from compplan.identification.campaign import identify_campaign
from compplan.identification.forward import attain_fit, differentiate, pose_residuals
from compplan.identification.problem import IdentifyOptions, IdentifyProblem
from compplan.identification.update import update_robot
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot, Spring, load_robot

SIZES = {"rad/(N m)": 2e-7, "m/N": 2e-9, "m": 3e-4, "rad": 4e-4, "1": 0.2}
HIDDEN = (
    Effect("backlash", "joint_2", None, {"width_rad": 6e-4}),
    Effect("transmission_error", "joint_1", None, {"cycles_per_turn": [1.0], "sine_rad": [3e-4], "cosine_rad": [2e-4]}),
    Effect("joint_coupling", "joint_5", None, {"other": "joint_4", "ratio": 1.5e-3}),
    Effect("tool_frame", None, None, {"tx_m": 4e-4, "ty_m": -3e-4, "tz_m": 0.0}),
)


def load(name: str, folder: Path) -> Robot:
    return write_small_robot(folder / "robot") if name == "small" else load_robot(name)


def every_row(log: Campaign) -> Rows:
    return Rows(log, np.arange(len(log)), KNOWN_FRAMES)


@pytest.mark.parametrize("name", ["small", "kuka_kr270_full"])
def test_the_robot_that_is_written_goes_where_the_fit_said(name: str, tmp_path: Path) -> None:
    robot, log = load(name, tmp_path), plan_rows(load(name, tmp_path), 7, poses=6, region=0.4)
    scene = build_model(robot, log)
    forms = geometry_forms(linearize_model(scene, solve_model_poses(scene)), "all")
    structure = build_structure(
        robot,
        add=[Spring(joint.name, axis, 0.0, actuator=False) for joint in robot.actuated[:2] for axis in ("rx", "ry")],
        forms=forms,
    )
    size = np.array([SIZES[parameter.unit] for parameter in structure.parameters])
    values = structure.nominal + size * np.random.default_rng(4).uniform(0.2, 1.0, len(size))
    state = attain_fit(structure, values, every_row(log), KNOWN_FRAMES)
    fit = SimpleNamespace(structure=structure, model_values=values)
    written = update_robot(robot, fit, source="test")  # type: ignore[arg-type]
    attained = solve_model_poses(build_model(written, log))
    assert np.linalg.norm(state.position - attained.position, axis=1).max() < 1e-9


def test_derivatives_are_those_of_the_exact_model() -> None:
    robot = load_robot("kuka_kr270_full")
    log = plan_rows(robot, 7, poses=20, region=0.4)
    options = IdentifyOptions(effects=("backlash@joint_2", "joint_coupling@joint_5:of joint_4"), geometry="all")
    rows = every_row(log)
    structure = build_structure(robot, forms=IdentifyProblem(robot, options, rows, options.geometry).forms())
    state = attain_fit(structure, structure.nominal, rows, KNOWN_FRAMES)
    columns = differentiate(rows, state)[0]
    for k, parameter in enumerate(structure.parameters):
        step = 1e-2 * SIZES[parameter.unit]
        values = structure.nominal + step * (np.arange(columns.shape[2]) == k)
        moved = attain_fit(structure, values, rows, KNOWN_FRAMES)
        secant = (moved.position - state.position) / step
        # the load's change with the deflection is left out: of the order of load by buckling load
        alike = [j for j, other in enumerate(structure.parameters) if other.unit == parameter.unit]
        allowed = 0.02 * np.abs(secant).max() + 1e-4 * np.abs(columns[:, :3, alike]).max()
        assert np.abs(secant - columns[:, :3, k]).max() < allowed, parameter.name
    seen = replace(log, position=state.position, rotation=state.rotation)
    assert np.nanmax(np.abs(pose_residuals(every_row(seen), state))) < 1e-12


@pytest.mark.parametrize("effect", HIDDEN, ids=lambda effect: effect.name)
def test_any_effect_is_fitted_beside_the_springs_and_written(effect: Effect, tmp_path: Path) -> None:
    robot = load("small", tmp_path)
    plan = plan_rows(robot, 3, poses=30, region=0.7)
    truth = solve_model_poses(apply_effects(build_model(robot, plan), [effect]))
    noise = np.random.default_rng(1)
    seen = truth.position + 1e-5 * noise.standard_normal(truth.position.shape)
    log = replace(plan, position=seen, rotation=truth.rotation, sigma=np.full(len(plan), 1e-5))
    other = effect.parameters.get("other")
    place = f"@{effect.joint}" + (f":of {other}" if other else "") if effect.joint else ""
    found = identify_campaign(robot, log, IdentifyOptions(effects=(effect.name + place,), geometry="none"))
    written = {entry.name: entry for entry in robot_effects(found.robot)}
    if effect.name in written:
        for key, value in effect.parameters.items():
            if not isinstance(value, str) and key != "cycles_per_turn":
                np.testing.assert_allclose(written[effect.name].parameters[key], value, rtol=0.15)
    own = [k for k, p in enumerate(found.kept.parameters) if p.kind == "effect"]
    assert own and (np.abs(found.kept.values[own]) > 4 * found.kept.standard_errors[own]).any()
    assert found.gap.held_out_after < 2.5e-5 < found.gap.held_out_before
    assert found.robot.uncertainty is not None
    assert effect.name in {unknown.effect for unknown in found.robot.uncertainty.unknowns}


def test_effects_that_a_log_cannot_show_are_refused_with_what_it_can(tmp_path: Path) -> None:
    robot = load("small", tmp_path)
    rows = every_row(plan_rows(robot, 3, poses=8))
    for asked, kind, sentence in (
        ("rust", UnknownNameError, "no effect named 'rust', choose from"),
        ("joint_stiffness", InputError, "is a spring; select it by its name"),
        ("backlash@joint_9", UnknownNameError, "no effect that this log can show named 'backlash@joint_9'"),
    ):
        with pytest.raises(kind, match=sentence):
            IdentifyProblem(robot, IdentifyOptions(effects=(asked,)), rows).forms()
