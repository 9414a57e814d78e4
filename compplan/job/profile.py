"""Shop profile: defaults for the sections of the jobs of a shop.

A profile is a TOML file with sections of a job: robot and controller, unit and machine of the CAM system, home, work
offset, tool table. A job names it (`profile = "shop.toml"`), `compplan post` takes it (--profile).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tomlfile import read_toml

#: Keys that a profile must not contain.
OWN = ("name", "toolpath", "profile")
#: Sections that are replaced as a whole.
WHOLE = frozenset({"part", "tool", "tools", "process"})


def apply_profile(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """Merge a job's sections over those of its profile, if any.

    Args:
        data: The sections of the job.
        file: The job file; the profile is relative to its folder.

    Raises:
        InputError: If the profile is invalid.
    """
    named = data.get("profile")
    if named is None:
        return dict(data)
    if not isinstance(named, str):
        raise InputError(f"is {named!r}, expected the name of a TOML file", file=file, where="profile")
    merged = read_profile(Path(file).parent / named)
    if {"tool", "tools"} & data.keys():  # they exclude each other
        merged = {key: value for key, value in merged.items() if key not in ("tool", "tools")}
    return _merge(merged, data)


def read_profile(file: Path) -> dict[str, Any]:
    """Read a profile; file names in it are relative to its folder.

    Raises:
        InputError: If it is not a TOML file, or contains keys reserved for jobs.
    """
    data = read_toml(file)
    for key in OWN:
        if key in data:
            raise InputError("belongs to a job, not to a profile", file=file, where=key)
    return dict(_place_files(data, file.parent.absolute()))


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
    """Return sections with absolute names of existing files and folders."""
    if isinstance(value, dict):
        return {key: _place_files(entry, folder) for key, entry in value.items()}
    if isinstance(value, list):
        return [_place_files(entry, folder) for entry in value]
    return str(folder / value) if isinstance(value, str) and value and (folder / value).exists() else value
