"""Every effect against MuJoCo, of known size and sign: the same poses to ten nanometres, then found in the log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_campaigns import Drawn, draw_robot_files, turn_between
from effect_cases import CASES, FITTED, ROBOTS, Place

from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.state import Problem
from compplan.effects import EFFECTS, Effect

#: What an effect has to move at least, so that a wrong sign is thousands of times beyond agreement. [m]
SEEN = 2e-5
NOISE = 1e-5
#: Effects that encoders on both sides of a gear tell on their own; here positions have to.
BETWEEN = ("joint_stiffness", "backlash", "transmission_error", "tracking_lag")
#: Parameters that say what a size refers to.
SETTINGS = {
    "axes",
    "other",
    "row",
    "compliance",
    "reference_load",
    "zone_load",
    "reference_temperature_C",
    "start_ratio",
}
SETTINGS |= {"quadratic_ratio", "cycles_per_turn"}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Place], Drawn]:
    known: dict[int, Drawn] = {}

    def find(place: Place) -> Drawn:
        description = CASES[place].base or ROBOTS[place[0]]
        if id(description) not in known:
            known[id(description)] = draw_robot_files(description, tmp_path_factory.mktemp("drawn"))
        return known[id(description)]

    return find


def test_every_effect_of_the_vocabulary_is_drawn_on_two_robots_and_fitted_on_one() -> None:
    assert {(place[0], place[1]) for place in CASES} == {(key, name) for key in ROBOTS for name in EFFECTS}
    assert {place[1] for place in FITTED} == set(EFFECTS)


@pytest.mark.parametrize("key", ROBOTS)
def test_with_nothing_wrong_folder_and_mujoco_see_the_same(key: str, tmp_path: Path) -> None:
    robot = draw_robot_files(ROBOTS[key], tmp_path)
    campaign, truth = robot.measure(robot.nominal)
    seen = robot.predict(campaign, [])
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(seen.attained.link, truth.link, rtol=0, atol=1e-9)


@pytest.mark.parametrize("place", CASES, ids="-".join)
def test_an_effect_does_to_the_folder_what_it_does_to_mujocos_robot(
    place: Place, drawn: Callable[[Place], Drawn]
) -> None:
    case, robot = CASES[place], drawn(place)
    campaign, truth = robot.measure(case.real(robot.nominal))
    without, seen = robot.predict(campaign, []), robot.predict(campaign, [case.effect])
    assert np.abs(truth.position - without.position).max() > SEEN
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=case.same)
    assert np.abs(turn_between(seen.rotation, truth.rotation)).max() < case.same
    np.testing.assert_allclose(seen.attained.link, truth.link, rtol=0, atol=case.same)


@pytest.mark.parametrize("place", FITTED, ids="-".join)
def test_the_fit_of_one_effect_finds_its_size_and_sign(place: Place, drawn: Callable[[Place], Drawn]) -> None:
    case, robot = CASES[place], drawn(place)
    campaign, truth = robot.measure(case.real(robot.nominal), noise=NOISE)
    if case.effect.name in BETWEEN:
        campaign = replace(campaign, link=None)
    others = tuple(name for name in EFFECTS if name != case.effect.name)
    fit = fit_effects(Problem(robot.robot, campaign, (), others), None)
    effects = [effect for effect in fit.state.effects if effect.place == case.effect.place]
    moved = truth.position - robot.predict(campaign, []).position
    left = truth.position - robot.predict(campaign, effects).position
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(moved**2))
    assert_sizes(effects, case.effect)


def assert_sizes(found: list[Effect], wanted: Effect) -> None:
    """Compare the sizes that have the same key in both, to a twentieth of the largest of their unit."""
    mine = {key: value for effect in found for key, value in effect.parameters.items()}
    assert mine.get("row") == wanted.parameters.get("row")
    sizes = {key: np.atleast_1d(wanted.parameters[key]) for key in mine.keys() & wanted.parameters.keys() - SETTINGS}
    assert sizes or wanted.name == "stiffness_nonlinearity"
    for key, size in sizes.items():
        unit = key.rpartition("_")[2]
        largest = max(float(np.abs(value).max()) for other, value in sizes.items() if other.rpartition("_")[2] == unit)
        assert np.atleast_1d(mine[key]) == pytest.approx(size, abs=0.05 * largest), key
