"""Tools of the T numbers of a CAM file, from the job ([[tool]]) or a tool table ([tools])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tomlfile import StrictTable, check_table
from compplan.job.frames import ToolTable
from compplan.job.tool_tables import LibraryTool, take_tool
from compplan.process.force_models import FORCE_MODELS
from compplan.toolpath.operations import Operation

#: Force models of a turning cutter, and the keys that a tool table supplies.
CUTTERS = {
    "end_mill": ("diameter_mm", "teeth", "corner_radius_mm", "flute_mm"),
    "drill": ("diameter_mm", "teeth", "point_deg"),
    "milling": ("diameter_mm",),
}


class NumberedTool(ToolTable):
    """[[tool]]: tip, mass and cutting force of a T number (or name) of the CAM file."""

    number: int | None = Field(default=None, ge=0)
    name: str | None = None
    process: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _check_name(self) -> NumberedTool:
        if self.number is None and self.name is None:
            raise ValueError("has neither number nor name, expected the T number of the CAM file, such as number = 1")
        return self


class ToolsTable(StrictTable):
    """[tools]: a tool table; [tool] is then the spindle, with lengths along its z.

    file: any form of `compplan.job.tool_tables`.
    """

    file: str


@dataclass(frozen=True)
class Described:
    """Description of the tool of an operation."""

    tool: dict[str, Any]  #: Its section [tool], plain.
    process: dict[str, Any]  #: Its keys of [process], plain.
    where: str  #: Key or file of the description, for messages.
    #: Cutter of a tool table in keys of [process], and its `kind`; empty without one.
    cutter: dict[str, Any] = field(default_factory=dict)


def check_tools(entries: Sequence[Any], file: str | Path) -> tuple[NumberedTool, ...]:
    """Check [[tool]].

    Raises:
        InputError: If there is none, one is invalid, or two have the same number.
    """
    if not entries:
        raise InputError("is empty, expected a section for every tool", file=file, where="tool")
    tools: list[NumberedTool] = []
    for k, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            raise InputError(f"is {entry!r}, expected a section", file=file, where=f"tool[{k}]")
        tool = check_table(NumberedTool, entry, file=file, key=f"tool[{k}]")
        if (tool.number, tool.name) in [(other.number, other.name) for other in tools]:
            call = repr(tool.name) if tool.name else f"T{tool.number}"
            raise InputError(f"describes {call} again; keep one section", file=file, where=f"tool[{k}]")
        tools.append(tool)
    return tuple(tools)


def find_numbered(tools: Sequence[NumberedTool], operation: Operation) -> Described | None:
    """Return the [[tool]] of an operation, or None."""
    for k, tool in enumerate(tools):
        named = tool.name is not None and operation.name and tool.name.lower() == operation.name.lower()
        if named or (not operation.name and tool.number == operation.number):
            plain = tool.model_dump(exclude_unset=True, exclude={"number", "name", "process"})
            return Described(plain, dict(tool.process or {}), f"tool[{k}]")
    return None


def find_listed(
    library: Sequence[LibraryTool], operation: Operation, spindle: ToolTable | None, file: Path
) -> Described | None:
    """Return the tool of an operation from a tool table, mounted in the spindle, or None."""
    entry = take_tool(library, operation.number, operation.name, file)
    if entry is None:
        return None
    keys = {"kind", *(key for own in CUTTERS.values() for key in own)}
    cutter = entry.model_dump(include=keys, exclude_none=True)
    return Described(_mount(entry, spindle or ToolTable()), {}, "tools.file", cutter)


def _mount(entry: LibraryTool, spindle: ToolTable) -> dict[str, Any]:
    """Return the [tool] of a listed tool: spindle extended along z by the tool, tool mass at half its length."""
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


def fill_process(common: Mapping[str, Any], described: Described, speed: float | None) -> dict[str, Any] | None:
    """Return the [process] of one tool: common keys, overridden by those of the tool, and spindle speed of the file.

    Args:
        common: [process] of the job.
        described: The tool.
        speed: Spindle speed of the operation in the file, or None. [1/min]
    """
    own, cutter = dict(described.process), described.cutter
    if not common and not own:
        return None
    before = str(common.get("model", "columns"))
    if cutter:  # a tool table holds the cutter, not the force model
        if before not in CUTTERS or cutter["kind"] == "other":
            return dict(common)
        model = before
        if before in ("end_mill", "drill"):
            model = {"drill": "drill", "mill": "end_mill"}.get(cutter["kind"], before)
        own = {"model": model, **{key: cutter[key] for key in CUTTERS[model] if key in cutter}}
    model = str(own.get("model", before))
    alike = model == before or model not in FORCE_MODELS  # an unknown model is refused later
    known = common if alike else FORCE_MODELS[model].table.model_fields
    kept = {key: value for key, value in common.items() if key in known}
    laid = {**kept, **own}
    if model in CUTTERS and "spindle_rpm" not in own and speed is not None:
        laid["spindle_rpm"] = speed
    return laid


def called_speed(operation: Operation) -> float | None:
    """Return the only spindle speed of an operation in the file, or None. [1/min]"""
    speeds = {event.value for event in operation.toolpath.events if event.kind in ("spindle_cw", "spindle_ccw")}
    return speeds.pop() if len(speeds) == 1 and min(speeds) > 0.0 else None
