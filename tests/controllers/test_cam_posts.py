"""Post-processors of CAM systems in examples/cam, on recorded calls, and in FreeCAD where it is installed."""

from __future__ import annotations

import csv
import importlib.util
import json
import shutil
import site
import subprocess
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

CAM = Path(__file__).parents[2] / "examples" / "cam"


def load_post(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, CAM / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pose(x: float, y: float, z: float, *, down: bool = False) -> Any:
    turn = np.diag([1.0, -1.0, -1.0, 1.0]) if down else np.eye(4)
    turn[:3, 3] = x, y, z
    return SimpleNamespace(Rows=turn.tolist)


def read_cut(folder: Path) -> np.ndarray:
    """Return the wanted tips of the cut, base frame. [mm]"""
    with (folder / "joints.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["move"] == "cut"]
    return np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows])


def test_robodk_hands_moves_tool_frame_and_feed_over(tmp_path: Path) -> None:
    post = load_post("robodk_post").RobotPost("compplan", "KUKA KR 240", 6)
    post.ProgStart("square")
    post.setFrame(pose(1800, 0, 700), 1, "part")
    post.setTool(pose(0, 0, 250), 1, "spindle")
    post.setZoneData(1.0)
    post.MoveJ(pose(0, 0, 50, down=True), [0, -90, 90, 0, 90, 0], [0, 0, 0])
    post.setSpeed(40.0)
    for x, y in ((0, 0), (60, 0), (60, 60), (0, 60), (0, 0)):
        post.MoveL(pose(x, y, 0, down=True), None)
    with pytest.raises(ValueError, match="splitting of arcs"):
        post.MoveC(pose(0, 0, 0), None, pose(1, 1, 0), None)
    post.ProgFinish("square")
    post.ProgSave(str(tmp_path), "square")
    folder = tmp_path / "square_corrected"
    cut = read_cut(folder)
    assert (
        post.posted.status == "solved"
        and list(folder.glob("*.src"))
        and "setZoneData(1.0,) is not carried over" in post.LOG
    )
    np.testing.assert_allclose([cut.min(axis=0), cut.max(axis=0)], [[1800, 0, 700], [1860, 60, 750]], atol=0.1)
    assert json.loads((folder / "plan.json").read_text())["strategy"] == "nlp"
    plan = post.posted.plans[0]
    assert plan.task.nominal.feed[plan.task.cut & ~plan.task.nominal.rapid] == pytest.approx(0.04)
    assert plan.job.tool.position_mm == (0.0, 0.0, 250.0)


def test_freecad_commands_become_the_corrected_program(tmp_path: Path) -> None:
    (tmp_path / "tool.toml").write_text('frame = "pendant"\nposition_mm = [0.0, 0.0, 250.0]\n')
    commands = [
        ("(Profile)", {}), ("M6", {"T": 1.0}), ("M3", {"S": 9000.0}), ("G0", {"Z": 20.0}), ("G0", {"X": 0.0, "Y": 0.0}),
        ("G1", {"Z": -1.0, "F": 5.0}), ("G1", {"X": 60.0, "F": 20.0}),
        ("G3", {"X": 60.0, "Y": 40.0, "I": 0.0, "J": 20.0, "K": 0.0, "F": 20.0}), ("G1", {"X": 0.0}),
        ("G0", {"Z": 20.0}),
    ]  # fmt: skip
    recorded = [SimpleNamespace(Name=name, Parameters=words) for name, words in commands]
    job = SimpleNamespace(
        Group=[SimpleNamespace(Path=SimpleNamespace(Commands=recorded)), SimpleNamespace(Label="none")]
    )
    post, target = load_post("freecad_post"), tmp_path / "part.txt"
    words = f"--robot kuka_kr240 --part 1800,0,700 --program krl --tool {tmp_path / 'tool.toml'}"
    text = post.export([job], str(target), words)
    assert text == target.read_text() and text.count("LIN ") > 5 and "DEF part" in text
    cut = read_cut(tmp_path / "part_corrected")
    np.testing.assert_allclose([*cut.min(axis=0), *cut.max(axis=0)[:2]], [1800, 0, 699, 1880, 40], atol=0.01)
    assert "F1200.0000" in (tmp_path / "part.nc").read_text()
    with pytest.raises(ValueError, match="arguments of the post-processor"):
        post.export([job], str(target), "--robot kuka_kr240")


#: The outline of a box of 60 x 40 x 10 mm, posted as FreeCAD's own post command does.
FREECAD = """
import site, sys
[site.addsitedir(folder) for folder in {packages}]
sys.path[:0] = [{project}, *{packages}]
import FreeCAD, Part
import PathScripts.PathJob as PathJob, PathScripts.PathProfile as PathProfile
from PathScripts.PathPostProcessor import PostProcessor
document = FreeCAD.newDocument("part")
box = document.addObject("Part::Box", "Box")
box.Length, box.Width, box.Height = 60, 40, 10
document.recompute()
job = PathJob.Create("Job", [box], None)
job.Tools.Group[0].HorizFeed, job.Tools.Group[0].VertFeed = "10 mm/s", "5 mm/s"
PathProfile.Create("Profile").processPerimeter = True
document.recompute()
FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Macro").SetString("MacroPath", {macros})
words = "--robot kuka_kr240 --part 1800,0,700 --program krl"
PostProcessor.load("compplan").export([job.Tools.Group[0], *job.Operations.Group], {target}, words)
"""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("freecadcmd"), reason="FreeCAD is not installed")
def test_freecad_itself_posts_the_outline_of_a_box(tmp_path: Path) -> None:
    shutil.copy(CAM / "freecad_post.py", tmp_path / "compplan_post.py")
    script, target = tmp_path / "box.py", tmp_path / "box.src"
    places = {"packages": site.getsitepackages(), "project": str(CAM.parents[1]), "macros": str(tmp_path)}
    script.write_text(FREECAD.format(**{name: repr(value) for name, value in places.items()}, target=repr(str(target))))
    done = subprocess.run(["freecadcmd", str(script)], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert target.exists(), done.stdout[-1000:]
    lower, upper = read_cut(tmp_path / "box_corrected").min(axis=0), read_cut(tmp_path / "box_corrected").max(axis=0)
    # The default cutter of 5 mm runs around the box, down to the lower side of the stock, 1 mm below the box.
    np.testing.assert_allclose([*lower, *upper[:2]], [1797.5, -2.5, 699.0, 1862.5, 42.5], atol=0.01)
