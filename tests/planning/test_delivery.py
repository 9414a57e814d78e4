"""What was written is read back: a planted mistake in a writer, in the counting or in joints.csv is seen."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import compplan.controllers.writers.krl as krl
import compplan.controllers.writers.language as language
import compplan.controllers.writers.program as programs
import compplan.reporting.writers.plan as outputs
from compplan.job.job import load_job
from compplan.planning.plan import plan_job
from compplan.planning.result import Plan
from compplan.reporting.writers.plan import deliver_plan, note_programs

NC = "G21 G90 G17\nG0 X0 Y0 Z20\nG1 Z0 F600\nX30\nG3 X40 Y10 I0 J10\nG1 Y25\nG0 Z20\n"
ALL = ["krl", "val3", "fanuc_ls", "rapid", "urscript", "sinumerik", "inform", "kawasaki_as", "csv"]


def plan_part(folder: Path, robot: str, languages: list[str]) -> Plan:
    """Plan a part for a robot, its programs noted."""
    (folder / "part.nc").write_text(NC)
    (folder / "part.toml").write_text(
        f'schema = 1\nrobot = "{robot}"\ntoolpath = "part.nc"\n'
        "[part]\nposition_mm = [1800.0, 100.0, 700.0]\nrotation_deg = [10.0, 0.0, 20.0]\n"
        '[process]\nmodel = "constant"\nforce_N = [50.0, 0.0, 100.0]\n'
        "[tool]\nposition_mm = [200.0, 0.0, 30.0]\nrotation_deg = [0.0, 80.0, 0.0]\nmass_kg = 10.0\n"
        f"[output]\nany_brand = true\nprograms = {json.dumps(languages)}\n"
    )
    return note_programs(plan_job(load_job(folder / "part.toml")))


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    folder = tmp_path_factory.mktemp("delivery")
    return plan_part(folder, "kuka_kr240", ALL)


def test_programs_of_every_language_and_joints_csv_are_read_back(plan: Plan, tmp_path: Path) -> None:
    told, files = deliver_plan(plan, tmp_path / "out")
    assert (told.status, told.breaches) == ("solved", ())
    assert not [note for note in told.notes if "not checked" in note]
    assert len(files) > len(ALL)


def _shift(patch: pytest.MonkeyPatch, home: Any, name: str, change: Callable[[Any], Any]) -> None:
    true = getattr(home, name)
    patch.setattr(home, name, lambda *words, **named: change(true(*words, **named)))


def _swap_angles(numbers: list[float]) -> list[float]:
    return [*numbers[:3], *numbers[:2:-1]]


def _program(change: Callable[[Any], Any]) -> Callable[[pytest.MonkeyPatch], None]:
    return lambda patch: _shift(patch, outputs, "make_program", change)


def _radians(patch: pytest.MonkeyPatch) -> None:
    true = outputs.write_table

    def write(path: Path, columns: dict[str, Any], **named: Any) -> None:
        turned = {key: np.radians(value) if key.endswith("_deg") else value for key, value in columns.items()}
        true(path, turned, **named)

    patch.setattr(outputs, "write_table", write)


def _late(patch: pytest.MonkeyPatch) -> None:
    true = outputs.write_table

    def write(path: Path, columns: dict[str, Any], **named: Any) -> None:
        true(path, {key: 2 * value if key == "time_s" else value for key, value in columns.items()}, **named)

    patch.setattr(outputs, "write_table", write)


def _negate(patch: pytest.MonkeyPatch, name: str) -> None:
    true = outputs.write_table

    def write(path: Path, columns: dict[str, Any], **named: Any) -> None:
        true(path, {key: -value if key == name else value for key, value in columns.items()}, **named)

    patch.setattr(outputs, "write_table", write)


MISTAKES: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "joints in radians": _radians,
    "times doubled": _late,
    "forces on the part": lambda patch: _negate(patch, "fz_N"),
    "the tool axis into the part": lambda patch: _negate(patch, "k"),
    "stops where it should run": _program(lambda program: replace(program, exact=np.ones_like(program.exact))),
    "runs where it should stop": lambda patch: _shift(
        patch, programs.Program, "stops", lambda stops: np.zeros_like(stops)),
    "every third row of joints.csv left out": lambda patch: _shift(
        patch, outputs, "choose_rows", lambda kept: kept & (np.arange(len(kept)) % 3 != 1)),
    "turns of other axes": lambda patch: _shift(patch, krl, "turn_bits", lambda bits: bits ^ 1),
    "the load of another tool": _program(lambda program: replace(program, mass=2.0 * program.mass)),
    "Euler angles in another order": lambda patch: _shift(patch, krl, "place_numbers", _swap_angles),
    "Euler order of every row": lambda patch: _shift(
        patch, krl, "place_table", lambda rows: rows[:, [0, 1, 2, 5, 4, 3]]),
    "a joint counted the other way": lambda patch: _shift(
        patch, programs, "to_controller", lambda joints: joints * [1, -1, 1, 1, 1, 1]),
    "a zero left out": lambda patch: _shift(
        patch, programs, "to_controller", lambda joints: joints + np.array([0, 0, 90, 0, 0, 0])),
    "the base frame elsewhere": _program(
        lambda program: replace(program, part=program.part * np.array([[1, 1, 1, 1.1]] * 3 + [[1] * 4]))),
    "a row left out": _program(lambda program: replace(
        program.take(np.arange(1, len(program))), arc_of=None, line_of=None, corner=None, events=())),
    "feed in mm a minute": lambda patch: _shift(
        patch, language, "fit_moves", lambda fitted: replace(fitted, program=replace(
            fitted.program, feed=fitted.program.feed * 60.0))),
    "an arc through a place beside it": lambda patch: _shift(
        patch, language, "fit_moves", lambda fitted: replace(fitted, program=replace(
            fitted.program, via=fitted.program.via + np.eye(4, k=3) * 1e-5))),
    "moves that cut corners": lambda patch: _shift(
        patch, language, "fit_moves", lambda fitted: replace(fitted, program=replace(
            fitted.program, via=np.full_like(fitted.program.via, np.nan)))),
    "the tool in centimetres": _program(
        lambda program: replace(program, tool=program.tool * np.array([[1, 1, 1, 0.1]] * 3 + [[1] * 4]))),
    "the positions of another tool": _program(lambda program: replace(program, tcp=program.tcp + np.diag([0, 0, 0, 0])
                                                                     + np.eye(4, k=3) * 0.002)),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_planted_mistake_in_what_is_written_is_not_called_solved(
    name: str, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    MISTAKES[name](monkeypatch)
    told, _ = deliver_plan(plan, tmp_path / "out")
    assert told.status == "not_confirmed"
    written = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert written["status"] == "not_confirmed"


def test_the_head_of_a_program_says_what_reading_back_said(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _late(monkeypatch)
    deliver_plan(plan, tmp_path / "out")
    assert "NOT CONFIRMED" in (tmp_path / "out" / "part_L.src").read_text()


def test_joints_csv_says_where_the_joints_hold_the_tool_on_the_way_to_the_path(plan: Plan) -> None:
    position, axis = outputs.place_rows(plan)
    assert len(position) == len(axis) == len(plan.approach.q) + len(plan.task) + len(plan.retract.q)
