"""Tools as data: what each T number of a CAM file is, in the job ([[tool]]) or in a tool table ([tools])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.files.tomlfile import StrictTable, check_table
from compplan.job.frames import ToolTable
from compplan.job.tool_library import LibraryTool, take_tool
from compplan.path.operations import Operation
from compplan.path.process import Process

#: Force models that a tool table knows the cutter of, and what it says of it.
CUTTERS = {
    "end_mill": ("diameter_mm", "teeth", "corner_radius_mm", "flute_mm", "holder_mm"),
    "drill": ("diameter_mm", "teeth", "flute_mm", "point_deg", "holder_mm"),
    "milling": ("diameter_mm",),
}
#: Force models that know a spindle speed.
SPINNING = ("end_mill", "drill", "milling")


class NumberedTool(ToolTable):
    """[[tool]]: one a T number (or name) of the CAM file: where its tip is, its mass, the force of its cut."""

    number: int | None = Field(default=None, ge=0)
    name: str | None = None
    process: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _check_name(self) -> NumberedTool:
        if self.number is None and self.name is None:
            raise ValueError("says neither number nor name, expected the T number of the CAM file, such as number = 1")
        return self


class ToolsTable(StrictTable):
    """[tools]: a tool table; [tool] is then the spindle: its z points out, and each length counts along it.

    file: CSV, a tool library of Fusion or HSM (JSON, XML), LinuxCNC's tool.tbl or Heidenhain's TOOL.T.
    unit: of a file that does not say it.
    """

    file: str
    unit: Literal["mm", "inch"] | None = None


@dataclass(frozen=True)
class Described:
    """Hold what is known of the tool of an operation.

    Attributes:
        tool: Its [tool] table, plain.
        process: What it says of the force of its cut, plain; laid over [process].
        where: Where that is said, for messages.

    """

    tool: dict[str, Any]
    process: dict[str, Any]
    where: str


def check_tools(entries: Sequence[Any], file: str | Path) -> tuple[NumberedTool, ...]:
    """Check [[tool]].

    Raises:
        InputError: If one is not what it has to be, or two have the same number.

    """
    tools: list[NumberedTool] = []
    seen: dict[tuple[int | None, str | None], int] = {}
    for k, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            raise InputError(f"is {entry!r}, expected a table", file=file, where=f"tool[{k}]")
        tool = check_table(NumberedTool, entry, file=file, key=f"tool[{k}]")
        key = (tool.number, tool.name)
        if key in seen:
            message = f"describes {_call(tool.number or 0, tool.name or '')} again, tool[{seen[key]}] does already"
            raise InputError(message, file=file, where=f"tool[{k}]")
        seen[key] = k
        tools.append(tool)
    return tuple(tools)


def find_numbered(tools: Sequence[NumberedTool], operation: Operation) -> Described | None:
    """Return what [[tool]] says of the tool of an operation, None where it says nothing."""
    for k, tool in enumerate(tools):
        named = tool.name is not None and operation.name and tool.name.lower() == operation.name.lower()
        if named or (not operation.name and tool.number == operation.number):
            plain = tool.model_dump(exclude_unset=True, exclude={"number", "name", "process"})
            return Described(plain, dict(tool.process or {}), f"tool[{k}]")
    return None


def find_listed(
    library: Sequence[LibraryTool], operation: Operation, spindle: ToolTable | None, file: Path
) -> Described | None:
    """Return what a tool table says of the tool of an operation, mounted in the spindle; None where it says nothing."""
    entry = take_tool(library, operation.number, operation.name, file)
    return None if entry is None else Described(_mount(entry, spindle or ToolTable()), _cutter(entry), "tools.file")


def _mount(entry: LibraryTool, spindle: ToolTable) -> dict[str, Any]:
    """Return the [tool] of a listed tool: the spindle's, longer along its z; its own mass sits half-way."""
    plain = spindle.model_dump(exclude_unset=True)
    length = entry.length_mm or 0.0
    nose, out = np.asarray(spindle.position_mm), spindle.rotation.as_matrix()[:, 2]
    plain["position_mm"] = tuple((nose + length * out).tolist())
    if entry.mass_kg is not None:
        base = spindle.mass_kg or 0.0
        moment = base * np.asarray(spindle.centre_of_mass_mm) + entry.mass_kg * (nose + 0.5 * length * out)
        plain["mass_kg"] = base + entry.mass_kg
        plain["centre_of_mass_mm"] = tuple((moment / max(base + entry.mass_kg, 1e-12)).tolist())
    return plain


def _cutter(entry: LibraryTool) -> dict[str, Any]:
    """Return what a tool table says of a cutter, in the words of [process]."""
    said = {
        "diameter_mm": entry.diameter_mm, "teeth": entry.teeth, "corner_radius_mm": entry.corner_radius_mm,
        "flute_mm": entry.flute_mm, "point_deg": entry.point_deg, "holder_mm": entry.holder_mm or None,
        "model": {"drill": "drill", "mill": "end_mill"}.get(entry.kind),
    }  # fmt: skip
    return {key: value for key, value in said.items() if value is not None}


def lay_process(
    common: Mapping[str, Any], described: Described, speed: float | None, *, listed: bool
) -> dict[str, Any] | None:
    """Return the [process] of one tool: what holds for all, the tool's own keys over it, the file's spindle speed.

    Args:
        common: [process] of the job.
        described: The tool.
        speed: Spindle speed that the file calls in the operation, or None. [1/min]
        listed: Whether a tool table describes it: it knows the cutter, not what force model is wanted.

    """
    own = dict(described.process)
    if not common and not own:
        return None
    before = str(common.get("model", "columns"))
    if listed:
        if before not in CUTTERS:
            return dict(common)
        model = own.get("model", before) if before != "milling" else before
        own = {key: value for key, value in own.items() if key in CUTTERS[model]} | {"model": model}
    model = str(own.get("model", before))
    known = model_keys(model)
    kept = {key: value for key, value in common.items() if model == before or known is None or key in known}
    laid = {**kept, **own}
    if model in SPINNING and "spindle_rpm" not in own and speed is not None:
        laid["spindle_rpm"] = speed
    return laid


def model_keys(model: str) -> set[str] | None:
    """Return the keys of a force model, None for one that is not known."""
    for table in get_args(get_args(Process)[0]):
        if model in get_args(table.model_fields["model"].annotation):
            return set(table.model_fields)
    return None


def called_speed(operation: Operation) -> float | None:
    """Return the one spindle speed that a file calls in an operation, None where it calls none or several. [1/min]"""
    speeds = {event.value for event in operation.toolpath.events if event.kind in ("spindle_cw", "spindle_ccw")}
    return speeds.pop() if len(speeds) == 1 and min(speeds) > 0.0 else None


def _call(number: int, name: str) -> str:
    return repr(name) if name else f"T{number}"
