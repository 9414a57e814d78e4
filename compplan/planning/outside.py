"""What a plan reads from outside the job's folder: a job that somebody else wrote may name any file of this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from compplan.io.notes import Stop
from compplan.job.job import Job
from compplan.robot import Robot, robot_folders
from compplan.robot.description import find_mesh

#: Tables of a job whose files go into programs line by line.
COPIED = ("output.header.", "output.footer.", "output.templates.")
COPIED_NOTE = " (its lines go into the program)"


def describe_outside(job: Job, robot: Robot) -> str:
    """List the files that the plan reads from outside the job's folder, links followed; "" where there are none.

    The note must be settled where lines of such a file go into a program.
    The robots that ship with compplan do not count. A job that no file holds is measured from the working directory.

    Args:
        job: The job.
        robot: Its robot.

    """
    told = [f"{key} = {path}{COPIED_NOTE if key.startswith(COPIED) else ''}" for key, path in list_outside(job, robot)]
    if not told:
        return ""
    said = f"Read from outside the job's folder: {'; '.join(told)}."
    return Stop(said) if any(COPIED_NOTE in text for text in told) else said


def list_outside(job: Job, robot: Robot) -> list[tuple[str, Path]]:
    """List what lies outside the job's folder, and meshes outside the robot's: the key that names it, and its path."""
    home = (job.folder if job.file.is_file() else Path.cwd()).resolve()
    found = [
        (key, path)
        for key, text in _list_words(job.model_dump(by_alias=True, exclude_unset=True), "")
        if key not in ("robot", "name") and (path := _find_file(job.folder, text)) and not path.is_relative_to(home)
    ]
    if robot.folder is None:
        return found
    folder = robot.folder.resolve()
    if not folder.is_relative_to(home) and folder not in [shipped.resolve() for shipped in robot_folders().values()]:
        found.append(("robot", folder))
    meshes = {mesh.attrib.get("filename", "") for mesh in ElementTree.fromstring(robot.urdf).iter("mesh")}
    for name in sorted(meshes):
        path = find_mesh(name, robot.folder)
        if path is not None and not path.resolve().is_relative_to(folder):
            found.append((f"mesh {name!r} of robot.urdf", path.resolve()))
    return found


def _list_words(table: Any, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(table, str):
        yield key, table
    elif isinstance(table, dict):
        for name, value in table.items():
            yield from _list_words(value, f"{key}.{name}" if key else str(name))
    elif isinstance(table, list | tuple):
        for number, value in enumerate(table):
            yield from _list_words(value, f"{key}[{number}]")


def _find_file(folder: Path, text: str) -> Path | None:
    with suppress(OSError, ValueError):  # a name that is too long, or holds a null byte
        path = (folder / text).resolve()
        return path if path.is_file() else None
    return None
