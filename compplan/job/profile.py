"""Shop profile: what a shop answers once, as defaults under the tables of its jobs.

A profile is a TOML file with tables of a job: robot and controller, unit and machine of the CAM system, home, work
offset, tool table. A job names it (`profile = "shop.toml"`), `compplan post` takes it (--profile).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tomlfile import read_toml

#: Keys of a job that are its own.
OWN = ("name", "toolpath", "profile")
#: Tables that a job states whole: parts of two would contradict each other.
WHOLE = frozenset({"part", "tool", "tools", "process"})
#: Tables of which a job has one.
EITHER = ({"tool", "tools"},)


def apply_profile(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """Return a job's tables with those of the profile that it names under them; one without a profile stays as it is.

    Args:
        data: The tables of the job.
        file: The job file; the profile's name counts from its folder.

    Raises:
        InputError: If the profile is not what it has to be.

    """
    named = data.get("profile")
    if named is None:
        return dict(data)
    if not isinstance(named, str):
        raise InputError(f"is {named!r}, expected the name of a TOML file", file=file, where="profile")
    merged = read_profile(Path(file).parent / named)
    for tables in EITHER:
        if tables & data.keys():
            merged = {key: value for key, value in merged.items() if key not in tables}
    return _merge(merged, data)


def read_profile(file: Path) -> dict[str, Any]:
    """Read a profile; names of files in it count from its folder.

    Raises:
        InputError: If it is no TOML file, or holds what belongs to a job.

    """
    data = read_toml(file)
    for key in OWN:
        if key in data:
            raise InputError("belongs to a job, not to a profile", file=file, where=key)
    found = _place_files(data, file.parent.absolute())
    assert isinstance(found, dict)
    return found


def write_profile_text(robot: str, language: str) -> str:
    """Return the text of a new profile.

    Args:
        robot: Robot of the cell: folder or shipped robot.
        language: Language of its controller.

    """
    text = files(__package__).joinpath("commented_profile.toml").read_text(encoding="utf-8")
    return text.replace("ROBOT", robot).replace("LANGUAGE", language)


def _merge(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(under)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping) and key not in WHOLE
        merged[key] = _merge(merged[key], value) if both else value
    return merged


def _place_files(value: Any, folder: Path) -> Any:
    """Return tables in which names of files and folders that are there are absolute."""
    if isinstance(value, dict):
        return {key: _place_files(entry, folder) for key, entry in value.items()}
    if isinstance(value, list):
        return [_place_files(entry, folder) for entry in value]
    return str(folder / value) if isinstance(value, str) and value and (folder / value).exists() else value
