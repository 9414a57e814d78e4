"""A user's own materials: a TOML file with one table of coefficients each, laid into [process] before it is checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.tomlfile import check_table, read_toml
from compplan.process.cutting import CoefficientTable
from compplan.process.materials import MATERIALS


def apply_material(process: Mapping[str, Any], job: Path, where: str) -> dict[str, Any]:
    """Return [process] with the coefficients of its own file of materials; as it is where it names none.

    A name of the file, which is relative to the job, goes before one that ships with compplan.

    Raises:
        InputError: If the file, or the material in it, is not what it has to be.
    """
    file, name = process.get("materials"), process.get("material")
    if not isinstance(file, str) or "coefficients" in process:
        return dict(process)
    path = job.parent / file
    listed = read_toml(path)
    if name in MATERIALS and name not in listed:
        return {key: value for key, value in process.items() if key != "materials"}
    if not isinstance(name, str) or name not in listed:
        fault = "missing key" if name is None else f"is {name!r}"
        message = f"{fault}, {path.name} has {list(listed)}, compplan {list(MATERIALS)}"
        raise InputError(message, file=job, where=f"{where}.material")
    if not isinstance(listed[name], dict):
        raise InputError(f"is {listed[name]!r}, expected a table with cutting_N_mm2", file=path, where=name)
    table = check_table(CoefficientTable, listed[name], file=path, key=name).model_dump(exclude_unset=True)
    table.setdefault("source", f"{name} of {path.name}")
    return {key: value for key, value in process.items() if key not in ("material", "materials")} | {
        "coefficients": table
    }
