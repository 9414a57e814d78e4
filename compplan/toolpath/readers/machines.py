"""Machines by name: what the rotary words of a file turn, stored as data; a shop keeps its own in a file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from compplan.errors import InputError
from compplan.io.tomlfile import SchemaOne, StrictTable, check_table, read_toml, read_toml_model
from compplan.toolpath.readers.options import Axes, CamTable, Vector

SHIPPED = Path(__file__).with_name("machines.toml")


class NamedMachine(StrictTable):
    """[machine]: the rotary axes of a machine, by the keys of [cam].

    title: What it is.
    rotary, rotary_axes, rotary_centre_mm, rotary_offset_mm, pivot_mm, tip_control: As in [cam].
    """

    title: str = ""
    rotary: Literal["head", "table", "head_table"]
    rotary_axes: Axes
    rotary_centre_mm: Vector | None = None
    rotary_offset_mm: Vector | None = None
    pivot_mm: Annotated[float, Field(ge=0.0, le=1e5)] | None = None
    tip_control: bool | None = None


class MachineFile(StrictTable):
    """A machine in a file of one's own."""

    schema_: SchemaOne = Field(alias="schema")
    machine: NamedMachine


@lru_cache(maxsize=1)
def list_machines() -> dict[str, NamedMachine]:
    """Return the machines that ship with compplan, by name."""
    tables = {name: table for name, table in read_toml(SHIPPED).items() if name != "schema"}
    return {name: check_table(NamedMachine, table, file=SHIPPED, key=name) for name, table in tables.items()}


def find_machine(name: str, folder: Path) -> NamedMachine:
    """Return a machine by its name: one that ships, or NAME.toml in a folder, which comes first."""
    own = folder / f"{name}.toml"
    if own.is_file():
        return read_toml_model(MachineFile, own).machine
    shipped = list_machines()
    if name not in shipped:
        raise InputError(f"no machine named {name!r}, choose from {', '.join(shipped)}, or write {name}.toml "
                         "beside the CAM file", where="cam.machine")  # fmt: skip
    return shipped[name]


def use_machine(options: CamTable, file: Path) -> CamTable:
    """Return options in which the machine that they name has become its keys; keys that are stated come before it."""
    if options.machine is None:
        return options
    said = find_machine(options.machine, file.parent).model_dump(exclude_none=True, exclude={"title"})
    stated = {key: getattr(options, key) for key in options.model_fields_set & said.keys()}
    kept = {key: value for key, value in said.items() if stated.get(key) is None}
    return options.model_copy(update={**kept, "machine": None})
