"""Machines by name: what the rotary words of a file turn, stored as data; a shop keeps its own in a file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

from pydantic import Field

from compplan.errors import InputError
from compplan.io.tomlfile import SchemaOne, StrictTable, check_table, read_toml, read_toml_model
from compplan.toolpath.readers.options import CamTable, MachineAxes

SHIPPED = Path(__file__).with_name("machines.toml")


class NamedMachine(MachineAxes):
    """[machine]: what turns (`rotary`, as in [cam]), and the rotary axes; `title` says what it is."""

    title: str = ""
    rotary: Literal["head", "table", "head_table"]


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
    """Return options with the machine that they name."""
    if options.machine is None:
        return options
    machine = find_machine(options.machine, file.parent)
    return options.with_axes(machine.rotary, machine)
