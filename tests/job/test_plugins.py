"""What an installed package adds by entry points, and the JSON schema of a job."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from commandline import run_command

ROOT = Path(__file__).parents[2]
CODE = {
    "careful": "from compplan.planning.strategies.mirror import command_path\n",
    "dots": (
        "import dataclasses\nfrom compplan.toolpath.readers import gcode\nname, suffixes = 'dots', ('.dots',)\n"
        "def recognise(text):\n    return text.startswith('dots')\n"
        "def read(text, file, options):\n"
        "    return gcode.read('G21 G90 F600\\nG1 X0 Y0 Z0\\nG1 X9\\n', file, options)\n"
    ),
    "plainly": (
        "name = 'plainly'\n"
        "def write(program, folder, most):\n    file = folder / 'p.plain'\n    file.write_text(program.name)\n"
        "    return [file]\n"
    ),
    "loose_bolt": (
        "name, words = 'loose_bolt', 'a bolt of {at} is loose'\ndef signatures(at):\n    return iter(())\n"
        "def apply(scene, effect):\n    return scene\ndef fold(robot, effect):\n    return None\n"
    ),
    "polishing": (
        "from typing import Literal\nimport numpy as np\nfrom pydantic import Field\n"
        "from compplan.toolpath.contact import PathForceTable\nwords = 'a polishing pad'\n"
        "class Polishing(PathForceTable):\n"
        "    model: Literal['polishing']\n    press_N: float = Field(gt=0.0)\n"
        "    def wrench_along(self, nominal):\n"
        "        return np.tile([0.0, 0.0, self.press_N, 0.0, 0.0, 0.0], (len(nominal), 1))\n"
        "table = Polishing\n"
    ),
}
ENTRIES = """
[compplan.readers]
dots = dots
[compplan.languages]
plainly = plainly
krl = plainly
[compplan.effects]
loose_bolt = loose_bolt
broken = no_such_module
[compplan.strategies]
careful = careful
[compplan.force_models]
polishing = polishing
"""
ASK = """
import json, warnings
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    import numpy as np
    import compplan as cp
    from compplan.job.job import Job
    from compplan.job.commented_job import write_job_text
    from compplan.controllers.writers import WRITERS
    from click.testing import CliRunner
    from compplan.cli import group
    angle = np.linspace(0, 6, 60)
    xyz = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), 0 * angle])
    plan = cp.plan({"position_mm": xyz, "feed_mm_s": 20.0}, robot="kuka_kr270", part=(2000, 0, 800),
                   process={"model": "polishing", "press_N": 200.0}, plan={"strategy": "careful"},
                   output={"programs": ["plainly"], "any_brand": True}, out="out")
    path = cp.read_toolpath("part.dots")
print(json.dumps({"status": plan.status, "strategy": plan.strategy, "before": plan.before.max_deviation,
    "force": float(np.abs(plan.task.wrench[:, :3]).max()), "effects": "loose_bolt" in cp.EFFECTS,
    "path": path.cutting_length, "help": CliRunner().invoke(group, ["forces", "--help"]).output,
    "krl": WRITERS["krl"].__name__,
    "unsaid": [name for name in ("careful", "plainly", "polishing")
               if name not in str(Job.model_json_schema()) or name not in write_job_text()],
    "told": [str(w.message) for w in told]}))
"""


@pytest.fixture
def package(tmp_path) -> Path:
    """An installed package that adds one of each, one whose name is taken and one that cannot be loaded."""
    site = tmp_path / "site"
    (site / "strange-1.0.dist-info").mkdir(parents=True)
    (site / "strange-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: strange\nVersion: 1.0\n")
    (site / "strange-1.0.dist-info" / "entry_points.txt").write_text(ENTRIES)
    for name, code in CODE.items():
        (site / f"{name}.py").write_text(code)
    return site


def test_a_package_adds_one_of_each_and_no_other_is_touched(package, tmp_path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    (work / "part.dots").write_text("dots\n")
    path = os.pathsep.join([str(package), str(ROOT)])
    answer = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, cwd=work,
                            env={**os.environ, "PYTHONPATH": path})  # fmt: skip
    assert answer.returncode == 0, answer.stderr[-800:]
    said = json.loads(answer.stdout)
    assert said["status"] == "solved" and said["strategy"] == "careful" and said["effects"]
    assert said["force"] == pytest.approx(200.0) and said["before"] > 1e-5
    assert said["path"] == pytest.approx(0.009) and (work / "out" / "p.plain").is_file()
    assert said["unsaid"] == [] and said["krl"] == "compplan.controllers.writers.krl"
    assert "polishing" in said["help"] and "a polishing pad (polishing)" in (work / "out" / "report.html").read_text()
    left = [line for line in said["told"] if "is left out" in line]
    assert len(left) == 2 and any("'krl' of strange" in line and "its name is taken" in line for line in left)
    assert any("'broken' of strange" in line and "no_such_module" in line for line in left)


def test_the_schema_takes_every_shipped_job_and_the_commented_one_and_refuses_what_the_reader_refuses(
    tmp_path, monkeypatch, capsys
) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    answer = run_command(["init", "--schema"], monkeypatch, capsys)
    assert answer.status == 0
    schema = json.loads(answer.out)
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    run_command(["init", tmp_path / "new.toml"], monkeypatch, capsys)
    jobs = [*sorted((ROOT / "paths").glob("*.toml")), tmp_path / "new.toml"]
    assert len(jobs) > 5
    for file in jobs:
        faults = list(check.iter_errors(tomllib.loads(file.read_text())))
        assert not faults, (file.name, faults[0].message)
    job = tomllib.loads(jobs[0].read_text())
    for wrong in ({"plan": {"strategy": "hope"}}, {"plan": {"tolerance_mm": -1}}, {"feeed": {}}, {"schema": 2}):
        assert not check.is_valid({**job, **wrong})
    refused = run_command(["init", "job.toml", "--schema"], monkeypatch, capsys)
    assert refused.status == 2 and "has no meaning" in refused.err
