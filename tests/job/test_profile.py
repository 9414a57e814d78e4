"""Shop profiles: defaults under the tables of a job."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from compplan.api.given import make_post_job
from compplan.cli.application import main
from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.job.profile import apply_profile


def write_profile(folder: Path) -> Path:
    """Write a profile as the command does, with a tool."""
    with pytest.raises(SystemExit) as done:
        main(["init", "profile", "--robot", "ur10", "--out", str(folder / "shop.toml")])
    assert done.value.code in (0, None)
    file = folder / "shop.toml"
    file.write_text(file.read_text() + "\n[tool]\nposition_mm = [0.0, 0.0, 120.0]\nmass_kg = 2.0\n")
    return file


def test_a_job_takes_what_it_does_not_say_from_its_profile(tmp_path: Path) -> None:
    write_profile(tmp_path)
    (tmp_path / "part.nc").write_text("G21 G90\nG0 X0 Y0 Z5\nG1 Z0 F600\nG1 X10\nM30\n")
    job = tmp_path / "job.toml"
    job.write_text(
        'schema = 1\nprofile = "shop.toml"\ntoolpath = "part.nc"\n[tool]\nposition_mm = [0.0, 0.0, 80.0]\n'
        '[output]\nfit_tolerance_mm = 0.01\n[process]\nmodel = "constant"\nforce_N = [0.0, 0.0, 0.0]\n'
    )
    read = load_job(job)
    assert (read.robot, read.cam.unit, read.output.programs) == ("ur10", "mm", ("urscript",))
    assert read.output.fit_tolerance_mm == 0.01
    assert read.tool.position_mm == (0.0, 0.0, 80.0) and read.tool.mass_kg is None  # the job's own tool, whole


def test_post_takes_robot_part_and_language_from_a_profile(tmp_path: Path) -> None:
    shop, cam = write_profile(tmp_path), tmp_path / "part.nc"
    cam.write_text("G90\nG0 X0 Y0 Z5\nG1 Z0 F600\nG1 X10\nM30\n")
    none = dict.fromkeys(("tool", "tools", "process", "cam", "plan", "output"))
    job = make_post_job(cam, robot=None, part=None, program=(), profile=shop, job_file=tmp_path / "x.toml", **none)
    assert job.robot == "ur10" and job.output.programs == ("urscript",)
    with pytest.raises(InputError, match="--robot is missing"):
        make_post_job(cam, robot=None, part=None, program=(), profile=None, job_file=tmp_path / "x.toml", **none)


def test_files_of_a_profile_count_from_its_folder_and_a_path_is_no_shop_s_answer(tmp_path: Path) -> None:
    folder = tmp_path / "shop"
    folder.mkdir()
    (folder / "tools.csv").write_text("number,diameter_mm\n1,10\n")
    (folder / "shop.toml").write_text('schema = 1\n[tools]\nfile = "tools.csv"\n')
    merged = apply_profile({"profile": "shop/shop.toml"}, tmp_path / "job.toml")
    assert merged["tools"]["file"] == str((folder / "tools.csv").absolute())
    own = apply_profile({"profile": "shop/shop.toml", "tool": {"mass_kg": 1.0}}, tmp_path / "job.toml")
    assert "tools" not in own
    (folder / "shop.toml").write_text('toolpath = "part.nc"\n')
    with pytest.raises(InputError, match="belongs to a job"):
        apply_profile({"profile": "shop/shop.toml"}, tmp_path / "job.toml")


def test_the_written_profile_is_toml_that_names_the_language(tmp_path: Path) -> None:
    found = tomllib.loads(write_profile(tmp_path).read_text())
    assert found["output"]["programs"] == ["urscript"] and found["cam"]["unit"] == "mm"
