"""The output folder: the old result or the new one, the user's own files, and what dead runs left."""

import hashlib
import json
import os
import subprocess
import sys

import pytest

from compplan.errors import InputError
from compplan.io.provenance import describe_origin, record_inputs
from compplan.io.tables import read_text
from compplan.io.transaction import HIDDEN, MANIFEST, READY, list_files, lock_folder, replace_file, replace_folder


def write(folder, files, command="plan"):
    with replace_folder(folder, command) as part:
        for name, text in files.items():
            (part / name).parent.mkdir(parents=True, exist_ok=True)
            (part / name).write_text(text)


def read(folder):
    return {name: (folder / name).read_text() for name in list_files(folder) if not name.startswith(HIDDEN)}


def test_a_new_result_replaces_the_old_one_and_leaves_the_users_own_files(tmp_path):
    out = tmp_path / "out"
    write(out, {"plan.json": "1", "job_J.src": "old program", "robot/a.toml": "a", "robot/b.toml": "b"})
    (out / "notes.txt").write_text("mine")
    (out / "photos").mkdir()
    (out / "photos" / "cell.png").write_text("mine too")
    write(out, {"plan.json": "2", "robot/a.toml": "c"})
    mine = {"notes.txt": "mine", "photos/cell.png": "mine too"}
    assert read(out) == {"plan.json": "2", "robot/a.toml": "c", **mine}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_manifest_cannot_reach_outside_its_folder(tmp_path):
    write(tmp_path / "out", {"a": "1"})
    victim = tmp_path / "victim.txt"
    victim.write_text("x")
    table = json.loads((tmp_path / "out" / MANIFEST).read_text())
    digest = hashlib.sha256(b"x").hexdigest()
    table["commands"]["plan"]["files"] |= {"../victim.txt": digest, str(victim): digest}
    (tmp_path / "out" / MANIFEST).write_text(json.dumps(table))
    write(tmp_path / "out", {"a": "2"})
    assert victim.read_text() == "x"


def test_an_exception_changes_nothing(tmp_path):
    write(tmp_path / "out", {"a": "1"})
    before = (tmp_path / "out").stat().st_ino
    with pytest.raises(ZeroDivisionError), replace_folder(tmp_path / "out", "plan") as part:
        (part / "a").write_text("2")
        raise ZeroDivisionError
    assert read(tmp_path / "out") == {"a": "1"}
    assert (tmp_path / "out").stat().st_ino == before
    with pytest.raises(ZeroDivisionError), replace_folder(tmp_path / "new" / "out", "plan"):
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("step", range(12))
def test_the_run_after_one_that_dies_at_any_step_finds_the_old_result_or_the_new_one(step, tmp_path):
    """Every call that changes the disk is counted; the process kills itself at the one of this case."""
    write(tmp_path / "out", {"a": "1", "b": "1", "gone": "1"})
    (tmp_path / "out" / "mine").write_text("mine")
    code = f"""
import os, pathlib, shutil, signal, sys
from compplan.io import transaction
from compplan.io.provenance import record_inputs
from compplan.io.tables import read_text
left = [{step}]
def count(function):
    def counted(*a, **k):
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1
        return function(*a, **k)
    return counted
for holder, name in ((os, "link"), (pathlib.Path, "rename"), (pathlib.Path, "replace"), (pathlib.Path, "unlink"),
                     (shutil, "rmtree"), (transaction, "_write_manifest")):
    setattr(holder, name, count(getattr(holder, name)))
with transaction.replace_folder({str(tmp_path / "out")!r}, "plan") as part:
    for name in "abc":
        (part / name).write_text("2")
"""
    subprocess.run([sys.executable, "-c", code], check=False)
    old = {"a": "1", "b": "1", "gone": "1", "mine": "mine"}
    new = {"a": "2", "b": "2", "c": "2", "mine": "mine"}
    assert all(text in (old.get(name), new.get(name)) for name, text in read(tmp_path / "out").items())
    with lock_folder(tmp_path / "out"):
        assert read(tmp_path / "out") in (old, new)
    write(tmp_path / "out", {"a": "3"})
    assert read(tmp_path / "out") == {"a": "3", "mine": "mine"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_a_dead_run_had_ready_is_finished_first(tmp_path):
    out = tmp_path / "out"
    write(out, {"a": "1", "gone": "1"})
    (out / "mine").write_text("mine")
    write(tmp_path / "later", {"a": "2", "b": "2"})
    (tmp_path / "later").rename(out / f"{HIDDEN}x{READY}")
    with lock_folder(out):
        assert read(out) == {"a": "2", "b": "2", "mine": "mine"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_runs_do_not_write_into_one_folder(tmp_path):
    code = f"""
import sys
from pathlib import Path
from compplan.io.transaction import lock_folder
with lock_folder({str(tmp_path / "out")!r}):
    print("held", flush=True)
    sys.stdin.read()
"""
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "held\n"
    with pytest.raises(InputError, match="another run of compplan writes into it"):
        write(tmp_path / "out", {"a": "1"})
    other.communicate("")
    write(tmp_path / "out", {"a": "1"})


@pytest.mark.parametrize("name", ["file", "file/out", "/proc/out"])
def test_a_folder_that_cannot_be_made_is_one_sentence(name, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        write(tmp_path / name, {"a": "1"})


def test_a_file_that_is_read_is_not_replaced_by_a_folder_of_results(tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "robot.urdf").write_text("the measured robot")
    with record_inputs(), pytest.raises(InputError, match=r"robot\.urdf: is a file that this run reads"):
        read_text(tmp_path / "robot" / "robot.urdf")
        write(tmp_path, {"robot/robot.urdf": "updated"}, "diagnose")
    assert (tmp_path / "robot" / "robot.urdf").read_text() == "the measured robot"


def test_a_device_is_never_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a device or a pipe"), replace_file(tmp_path / "pipe"):
        raise AssertionError("the place is refused before anything is written")
    with pytest.raises(InputError, match="device or a pipe"):
        read_text(tmp_path / "pipe")


def test_a_file_is_written_where_its_link_points(tmp_path):
    (tmp_path / "real.csv").write_text("old")
    (tmp_path / "link.csv").symlink_to("real.csv")
    with replace_file(tmp_path / "link.csv") as part:
        part.write_text("new")
    assert (tmp_path / "real.csv").read_text() == "new" and (tmp_path / "link.csv").is_symlink()


def test_what_a_result_reads_back_from_its_own_files_is_no_input(tmp_path):
    (tmp_path / "job.toml").write_text("given")
    with record_inputs(), replace_folder(tmp_path / "out", "plan") as part:
        (part / "robot.urdf").write_text("written")
        assert read_text(part / "robot.urdf") + read_text(tmp_path / "job.toml") == "writtengiven"
        assert list(describe_origin()["inputs_sha256"]) == [str(tmp_path / "job.toml")]
