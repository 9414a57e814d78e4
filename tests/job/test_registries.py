"""What is added often is one new file and one line in a registry: schema, help, pages and verbs then know it."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner
from commandline import run_command
from simulated_campaigns import measure, plan_rows, write_small_robot

import compplan as cp
from compplan.cli import group
from compplan.controllers.writers import WRITERS, widest_zone
from compplan.diagnosis.results.shares import kind_of
from compplan.effects import robot_effects
from compplan.effects.attained import attain_with_effects
from compplan.errors import InputError
from compplan.job.commented_job import write_job_text
from compplan.job.job import Job
from compplan.job.names import EFFECTS
from compplan.planning.strategies import ONLINE, STRATEGIES
from compplan.process.force_models import FORCE_MODELS
from compplan.reporting.diagnosis_text import describe_effect
from compplan.toolpath.readers import READERS
from tests.cli.test_bad_input import write_job
from tests.controllers.test_golden_programs import FORMS


@pytest.fixture
def add_module(tmp_path, monkeypatch):
    """Write a module into a package of its own beside the product."""

    def add(name: str, text: str) -> ModuleType:
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        module = importlib.import_module(name)
        monkeypatch.setitem(sys.modules, name, module)
        return module

    return add


def test_a_strategy_is_one_file_and_one_line(add_module, tmp_path, monkeypatch, capsys) -> None:
    module = add_module(
        "timid", "from compplan.planning.strategies.none import command_path\nwords = 'with much care'\n"
    )
    assert run_command(["plan", write_job(tmp_path, plan='strategy = "timid"'), "--out", tmp_path / "o"],
                       monkeypatch, capsys).status == 2  # fmt: skip
    monkeypatch.setitem(STRATEGIES, "timid", module)
    assert "timid" in str(Job.model_json_schema())
    answer = run_command(["compare", write_job(tmp_path), "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0 and "timid" in answer.out
    assert "with much care" in (tmp_path / "out" / "report.html").read_text().lower()
    assert "| timid" in write_job_text()


def test_a_program_language_is_one_file_and_one_line(add_module, tmp_path, monkeypatch, capsys) -> None:
    module = add_module(
        "plainly",
        "from compplan.controllers.writers.zones import BlendZone\n"
        "name, ZONE = 'plainly', BlendZone(2e-3, 'its manual')\n"
        "def write(program, folder, most):\n"
        "    file = folder / (program.name + '.plain')\n"
        "    file.write_text(str(len(program.joints)))\n"
        "    return [file]\n",
    )
    monkeypatch.setitem(WRITERS, "plainly", module)
    assert "plainly" in str(Job.model_json_schema()) and "| plainly" in write_job_text()
    job = write_job(tmp_path, plan='[output]\nprograms = ["plainly"]')
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    assert len(list((tmp_path / "out").rglob("*.plain"))) == 1
    assert widest_zone(("krl", "plainly")).size == 2e-3


def test_a_reader_is_one_file_and_one_line(add_module, tmp_path, monkeypatch, capsys) -> None:
    module = add_module(
        "dots",
        "import dataclasses\nfrom compplan.toolpath.readers import gcode\n"
        "name, suffixes = 'dots', ('.dots',)\n"
        "def recognise(text):\n    return text.startswith('dots')\n"
        "def read(text, file, options):\n"
        "    rows = [line.split() for line in text.splitlines()[1:]]\n"
        "    code = 'G21 G90 F600 G0 X0 Y0 Z0\\n' + ''.join(f'G1 X{x} Y{y} Z0\\n' for x, y in rows)\n"
        "    cam = gcode.read(code, file, options)\n"
        "    return dataclasses.replace(cam, facts=dataclasses.replace(cam.facts, kind='dots'))\n",
    )
    (tmp_path / "part.dots").write_text("dots\n0 0\n10 0\n10 5\n")
    command = ["convert", tmp_path / "part.dots", "--out", tmp_path / "path.csv"]
    refused = run_command(command, monkeypatch, capsys)
    assert refused.status == 2 and "gcode" in refused.err
    monkeypatch.setitem(READERS, "dots", module)
    read = run_command(command, monkeypatch, capsys)
    assert read.status == 0 and "dots" in read.out and ", dots)" in write_job_text()
    assert cp.read_toolpath(tmp_path / "part.dots").cutting_length == pytest.approx(0.015)


WAVY_FLOOR = """
from dataclasses import replace
import numpy as np
from compplan.effects.checks import Rule
from compplan.effects.signature import Signature
name, words = "wavy_floor", "the floor rises and falls as {at} turns"
rule = Rule({"height_m": 0.01}, "needed", groups=(("height_m",),))

def shape(scene):
    twist = np.zeros((len(scene.campaign), 6))
    twist[:, 2] = np.sin(7.0 * scene.campaign.q[:, 0]) * np.cos(5.0 * scene.campaign.q[:, 1])
    return twist

def signatures(at):
    yield Signature(name, "joint_1", None, "", ("height_m",), np.array([1e-3]), shape(at.scene)[:, :, None])

def apply(scene, effect):
    return replace(scene, base_twist=scene.base_twist + effect.parameters["height_m"] * shape(scene))

def fold(robot, effect):
    return None
"""


def test_an_effect_is_one_file_and_one_line(add_module, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(cp.EFFECTS, "wavy_floor", add_module("wavy_floor", WAVY_FLOOR))
    robot = write_small_robot(tmp_path / "robot")
    effect = cp.Effect("wavy_floor", "joint_1", None, {"height_m": 4e-4})
    assert "rises and falls as joint_1 turns" in describe_effect({"effect": "wavy_floor", "joint": "joint_1"})
    for joint, height, sentence in ((None, 4e-4, "needs a joint"), ("joint_1", 0.02, "at most 0.01")):
        with pytest.raises(InputError, match=sentence):
            robot_effects(cp.fold_effects(robot, [cp.Effect("wavy_floor", joint, None, {"height_m": height})]))
    assert {kind_of("wavy_floor", loaded) for loaded in (True, False)} == {"geometry"}
    folded = cp.fold_effects(robot, [effect])
    cp.write_robot_folder(folded, tmp_path / "folded")
    again = cp.load_robot(tmp_path / "folded")

    rows = plan_rows(robot, 5)
    predicted = cp.predict_campaign(again, rows).position - cp.predict_campaign(robot, rows).position
    expected = 4e-4 * np.sin(7.0 * rows.q[:, 0]) * np.cos(5.0 * rows.q[:, 1])
    np.testing.assert_allclose(predicted[:, 2], expected, atol=1e-12)

    at_work = [attain_with_effects(r, rows.q, rows.wrench, np.ones(len(rows) - 1))[0] for r in (again, robot)]
    np.testing.assert_allclose((at_work[0] - at_work[1])[:, 2], expected, atol=1e-12)
    cell = [cp.run_simulated_robot(cp.build_simulated_robot(r), rows.q, rows.wrench).position for r in (again, robot)]
    np.testing.assert_allclose((cell[0] - cell[1])[:, 2], expected, atol=1e-9)

    diagnosis = cp.diagnose_campaign(robot, measure(robot, rows, [effect], seed=6))
    assert [finding.effect.name for finding in diagnosis.verdict.findings] == ["wavy_floor"]
    assert diagnosis.updated.effects[0]["parameters"]["height_m"] == pytest.approx(4e-4, rel=0.05)


def test_every_language_is_read_back_by_a_reader_of_the_tests_own_and_every_module_declares_what_it_is_called() -> None:
    assert {form.split()[0] for form in FORMS} == set(WRITERS) - {"own"}
    assert all(module.name == name for registry in (WRITERS, READERS, EFFECTS) for name, module in registry.items())
    assert all(module.words for registry in (STRATEGIES, ONLINE, EFFECTS, FORCE_MODELS) for module in registry.values())


@pytest.mark.parametrize(
    ("command", "names"),
    [("post", WRITERS), ("forces", FORCE_MODELS),
     ("convert", READERS), ("montecarlo", (*STRATEGIES, *ONLINE)), ("diagnose", EFFECTS),
     ("compare", (*STRATEGIES, *ONLINE)), ("identify", EFFECTS)],
)  # fmt: skip
def test_help_lists_what_can_be_named(command: str, names: Iterable[str]) -> None:
    said = CliRunner().invoke(group, [command, "--help"]).output
    assert set(names) <= set(re.findall(r"\w+", re.sub(r"-\s+", "", said)))


def test_no_room_names_a_module_of_another_as_a_string() -> None:
    """The import contract sees every arrow: strings such as "compplan.plan.x" stand at the front door alone."""
    root = Path(cp.__file__).parent
    named = {
        f"{file.relative_to(root)}: {node.value}"
        for file in root.rglob("*.py")
        if file.parent != root
        if "'compplan." in (text := file.read_text(encoding="utf-8")).replace('"', "'")
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and re.fullmatch(r"compplan(\.\w+)+(:\w+)?", str(node.value))
        if root.parent.joinpath(*str(node.value).partition(":")[0].split(".")).with_suffix(".py").is_file()
    }
    assert not named


def test_the_door_opens_every_name_and_loads_nothing_heavy() -> None:
    import subprocess

    heavy = ["numpy", "scipy", "casadi", "pinocchio", "pydantic", "matplotlib", "plotly"]
    code = f"import sys, compplan; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
    assert all(getattr(cp, name) is not None for name in cp.__all__)
    assert (Path(cp.__file__).parent / "py.typed").is_file()
    assert {"plan", "plan_job", "diagnose_campaign", "predict_campaign", "fold_effects"} <= set(dir(cp))
