"""An output folder with a directory or a user's own file under the name of a result is refused, and stays as it is."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.io.transaction import check_folder, replace_folder

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"


def write(folder: Path, files: dict[str, str], command: str = "plan") -> None:
    with replace_folder(folder, command) as part:
        for name, text in files.items():
            (part / name).parent.mkdir(parents=True, exist_ok=True)
            (part / name).write_text(text)


def list_all(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() if p.is_file() else "/" for p in sorted(folder.rglob("*"))}


def put(folder: Path, what: str, name: str) -> None:
    place = folder / name
    place.parent.mkdir(parents=True, exist_ok=True)
    if what == "file":
        place.write_text("mine")
    elif what == "folder":
        place.mkdir()
        (place / "mine.txt").write_text("mine")
    elif what == "empty folder":
        place.mkdir()
    else:
        place.symlink_to("nowhere")


@pytest.mark.parametrize("what", ["file", "folder", "empty folder", "link"])
@pytest.mark.parametrize("name", ["plan.json", "robot/robot.urdf", "robot"])
def test_a_result_replaces_nothing_that_compplan_did_not_write(name, what, tmp_path) -> None:
    out = tmp_path / "out"
    write(out, {"joints.csv": "old"})
    put(out, what, name)
    before = list_all(out)
    new = {"plan.json": "new", "joints.csv": "new", "robot/robot.urdf": "new"}
    if name == "robot" and "folder" in what:  # a folder of the user's, in which no result has a name
        write(out, new)
        assert list_all(out)["robot/robot.urdf"] == "new"
        assert list_all(out).get("robot/mine.txt") == before.get("robot/mine.txt")
        return
    with pytest.raises(InputError, match="move it away or name another folder"):
        write(out, new)
    assert list_all(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_results_of_any_command_are_replaced(tmp_path) -> None:
    out = tmp_path / "out"
    write(out, {"report.html": "1"}, "compare")
    write(out, {"report.html": "2"})
    assert list_all(out)["report.html"] == "2"


def test_a_manifest_of_another_program_is_not_replaced(tmp_path) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "my page", "icons": []}')
    with pytest.raises(InputError, match=r"manifest\.json: was not written by compplan"):
        write(tmp_path, {"plan.json": "1"})
    with pytest.raises(InputError, match=r"manifest\.json"):
        check_folder(tmp_path)


def test_a_program_of_the_users_own_is_not_replaced(tmp_path, monkeypatch, capsys) -> None:
    work = tmp_path / "work"
    shutil.copytree(GOOD, work)
    put(work / "out", "file", "job_L.src")
    before = list_all(work)
    answer = run_command(["plan", work / "job.toml", "--out", work / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert "job_L.src: was not written by compplan" in answer.err
    assert list_all(work) == before
