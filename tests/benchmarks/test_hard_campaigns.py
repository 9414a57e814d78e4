"""The hard campaigns: robots of other kinds, unknown causes, what stands out, and the folder that is written."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.campaigns.__main__ import main
from benchmarks.campaigns.columns import Placed, list_signatures
from benchmarks.campaigns.description import read_description
from benchmarks.campaigns.effects import Effect, apply_effect
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.machines import KINDS_OF_MACHINE, draw_machine
from benchmarks.campaigns.oddities_instrument import ODDITIES
from benchmarks.campaigns.oddity import Setting
from benchmarks.campaigns.simulate import nominal_scenario, simulate_rows
from benchmarks.campaigns.suite import REPORTING, draw_hard
from benchmarks.campaigns.visits import draw_visits, plan_visits

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


def _setting(kind: str, seed: int = 5) -> Setting:
    rng = np.random.default_rng(seed)
    machine = draw_machine(rng, kind)
    visits = replace(
        draw_visits(rng, machine, "tracker"), stays=(12, 10), weights_kg=(0.0, machine.payload_kg), paths=0
    )
    return Setting(machine, nominal_scenario(machine.robot), plan_visits(rng, machine, visits), visits)


@pytest.mark.parametrize("kind", list(KINDS_OF_MACHINE))
def test_first_order_columns_are_the_slopes_of_the_engine(kind: str) -> None:
    s = _setting(kind)
    pick = np.arange(len(s.rows.q))
    base = simulate_rows(s.nominal, s.rows).position
    compared = 0
    for found in list_signatures(Placed(s.machine, s.nominal, s.rows, pick), []):
        name, joint, axis = found.effect, found.joint, found.axis
        if name == "joint_stiffness":
            effect, step = Effect(name, joint, size=1e-3), 1e-3
        elif name in ("link_compliance", "base_compliance"):
            effect, step = Effect(name, joint, axis, 1e-10), 1e-10
        elif name == "joint_offset":
            effect, step = Effect(name, joint, size=1e-6), 1e-6
        elif name == "link_geometry":
            direction = [float(a == axis) for a in AXES]
            effect, step = Effect(name, joint, axis, 1e-6, params={"direction": direction}), 1e-6
        else:
            continue
        slope = (simulate_rows(apply_effect(effect, s.nominal), s.rows).position - base) / step
        scale = np.linalg.norm(slope)
        assert np.linalg.norm(found.columns[:, :3, 0] - slope) < 0.02 * scale + 2e-6, (name, joint, axis)
        compared += 1
    assert compared > 30


def test_a_palletiser_keeps_its_tool_upright() -> None:
    machine = draw_machine(np.random.default_rng(2), "palletiser")
    model = ElasticModel(machine.robot, ())
    q = np.random.default_rng(3).uniform(machine.low, machine.high, (20, 4))
    rotation = model.place(q, np.zeros((20, 0)), None)[4]
    assert np.allclose(rotation[:, :, 2], [0.0, 0.0, -1.0], atol=1e-8)


@pytest.mark.parametrize("name", list(ODDITIES))
def test_every_unknown_cause_moves_the_measured_point(name: str) -> None:
    s = _setting("rail" if ODDITIES[name].needs == "rail" else "medium")
    joint, size, params = ODDITIES[name].draw(np.random.default_rng(1), s)
    effect = Effect(name, joint, None, size, params=params, known=False)
    moved = simulate_rows(ODDITIES[name].apply(effect, s.nominal), s.rows)
    twice = simulate_rows(ODDITIES[name].apply(effect.scaled(2.0), s.nominal), s.rows)
    nominal = simulate_rows(s.nominal, s.rows).position
    gap, larger = np.linalg.norm(moved.position - nominal), np.linalg.norm(twice.position - nominal)
    assert gap > 1e-8
    assert larger == pytest.approx(2.0 * gap, rel=0.05)


def test_there_are_more_than_twenty_unknown_causes() -> None:
    assert len(ODDITIES) >= 20


@pytest.mark.parametrize(("suite", "kind"), [("tracker", "double"), ("tracker", "mixed"), ("realistic", "none")])
def test_a_written_campaign_is_the_one_that_its_seed_says(tmp_path: Path, suite: str, kind: str) -> None:
    first = draw_hard(7, suite, kind).write(tmp_path / "a")
    again = draw_hard(7, suite, kind).write(tmp_path / "b")
    for file in ("measurements.csv", "fresh.csv", "robot/robot.urdf", "robot/elasticity.toml"):
        assert (first / file).read_bytes() == (again / file).read_bytes()
    truth = json.loads((first / "truth.json").read_text())
    robot = read_description(first / "robot")
    with (first / "measurements.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == truth["split"]["given"]["rows"]
    assert sum(c.startswith("q") and "_link" not in c for c in rows[0]) == len(robot.joint_names)
    assert all(e["required"] == (e["visible"] >= 4.5) for e in truth["effects"])
    assert truth["kind"] != "none" or not truth["effects"]


def test_an_unknown_cause_stands_out_of_what_two_names_can_do() -> None:
    truth = draw_hard(3, "tracker", "unknown").truth
    assert truth["effects"][0]["effect"] == "unknown"
    assert truth["effects"][0]["left_by_two"] >= 4.5


def test_seeds_for_reports_are_refused_in_development(tmp_path: Path) -> None:
    seeds = f"{REPORTING.start}:{REPORTING.start + 1}"
    answer = CliRunner().invoke(main, ["draw", "--suite", "tracker", "--seeds", seeds, "--out", str(tmp_path / "x")])
    assert answer.exit_code == 2
    assert "--reporting" in answer.output
    assert not (tmp_path / "x").exists()
