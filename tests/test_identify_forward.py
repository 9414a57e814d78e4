"""What identification predicts is what the effects' forward model predicts of the robot that it writes.

Identification walks a chain with further elements (6x6 terms of links, origins as elements), which no effect holds;
here both forward models are held against each other.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_campaigns import plan_rows, write_small_robot

from compplan.effects import attain_scene, stage_scene
from compplan.identify.forward import KNOWN_FRAMES, predict_rows
from compplan.identify.observations import make_observations
from compplan.identify.parameters import build_structure, candidate_springs
from compplan.identify.update import update_robot
from compplan.robot import Robot, load_robot

SIZES = {"rad/(N m)": 2e-7, "m/N": 2e-9, "m": 3e-4, "rad": 4e-4, "rad/N": 1e-9, "1": 0.2}


def compare(robot: Robot, geometry: str, links: str | None, share: float = 1.0) -> float:
    """Greatest distance between both predictions. [m]"""
    structure = build_structure(robot, add=candidate_springs(robot)[:4], links=links, geometry=geometry)
    size = np.array([SIZES[parameter.unit] for parameter in structure.parameters])
    values = structure.nominal + share * size * np.random.default_rng(4).uniform(0.2, 1.0, len(size))
    rows = plan_rows(robot, 7, poses=6, region=0.4)
    predicted = predict_rows(structure, values, make_observations(rows.q, rows.wrench, rows.position), KNOWN_FRAMES)
    fit = SimpleNamespace(structure=structure, model_values=values)
    written, notes = update_robot(robot, fit, source="test")  # type: ignore[arg-type]
    assert notes == ()
    attained = attain_scene(stage_scene(written, rows))
    return float(np.linalg.norm(predicted.position - attained.position, axis=1).max())


def load(name: str, folder: Path) -> Robot:
    return write_small_robot(folder / "robot") if name == "small" else load_robot(name)


CASES = [("small", None), ("kuka_kr270_full", None), ("kuka_kr270_full", "diagonal")]


@pytest.mark.parametrize(("name", "links"), CASES)
def test_both_forward_models_say_the_same_of_springs_and_links(name: str, links: str | None, tmp_path: Path) -> None:
    assert compare(load(name, tmp_path), "none", links) < 1e-9


def test_they_differ_by_products_of_geometry_and_deflection_alone(tmp_path: Path) -> None:
    robot = load("small", tmp_path)
    full, half = (compare(robot, "all", None, share) for share in (1.0, 0.5))
    assert full < 1e-6  # of a millimetre of geometry at every joint, under 600 N
    assert 1.5 < full / half < 5.0
