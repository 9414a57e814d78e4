"""[tolerance]: tolerance across and along the travel, for parts of the path."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.toolpath import Toolpath

Size = Annotated[float, Field(ge=1e-6, le=100.0)]
#: Keys that select a part of a path.
PLACES = ("s_mm", "operation")


class TolerancePart(StrictTable):
    """[[tolerance.part]]: another tolerance for some moves, such as roughing.

    s_mm: Length along the path, rapid moves included.
    operation: Number or name of a tool, or words of a comment of the CAM file, until the next one.
    """

    s_mm: Annotated[tuple[float, float], Field(strict=False)] | None = None
    operation: str | None = Field(default=None, min_length=1)
    normal_mm: Size | None = None
    tangential_mm: Size | None = None

    @model_validator(mode="after")
    def _check(self) -> TolerancePart:
        given = [key for key in PLACES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"has {', '.join(given) or 'no place'}, expected one of {', '.join(PLACES)}")
        if self.normal_mm is None and self.tangential_mm is None:
            raise ValueError("states no tolerance, expected normal_mm or tangential_mm")
        if self.s_mm is not None and self.s_mm[1] <= self.s_mm[0]:
            raise ValueError(f"has s_mm that end at {self.s_mm[1]:g}, expected more than {self.s_mm[0]:g}")
        return self

    def mark(self, toolpath: Toolpath) -> NDArray[np.bool_]:
        """Return which moves are selected, by the row of their end. Shape (n,)."""
        rows = np.arange(len(toolpath))
        if self.s_mm is not None:
            middle = 1e3 * (toolpath.arc_length - 0.5 * np.r_[0.0, toolpath.steps])
            return np.asarray((middle > self.s_mm[0]) & (middle < self.s_mm[1]))
        marked, wanted = np.zeros(len(toolpath), bool), str(self.operation).lower()
        for kind in ("tool", "comment"):
            events = [event for event in toolpath.events if event.kind == kind]
            ends = [event.place for event in events[1:]] + [len(toolpath)]
            for event, end in zip(events, ends, strict=True):
                if wanted in event.text.lower() or (kind == "tool" and wanted == f"t{event.value:g}"):
                    marked |= (rows > event.place) & (rows <= end)
        return marked


class ToleranceTable(StrictTable):
    """[tolerance]: directions and parts of the tolerance; plan.tolerance_mm is that of the path outside its parts.

    tangential_mm: Tolerance along the travel; plan.tolerance_mm is then for the deviation across it.
    tube: Share of the tolerance by which a plan may leave the path for a shorter run or a narrower band.
    """

    tangential_mm: Size | None = None
    tube: float = Field(default=0.0, ge=0.0, le=0.9)
    part: Annotated[tuple[TolerancePart, ...], Field(strict=False, max_length=10000)] = ()

    @property
    def stated(self) -> bool:
        """Return whether any key is set."""
        return bool(self.model_fields_set - {"tube"})

    def strictest(self, whole: float) -> float:
        """Return the least tolerance across the travel, given the default. [mm]"""
        return min([whole, *(part.normal_mm for part in self.part if part.normal_mm is not None)])

    def lay(self, toolpath: Toolpath, whole: float) -> Toolpath:
        """Return a toolpath with the tolerance of its moves; the last of overlapping parts holds.

        Args:
            toolpath: The toolpath of the file.
            whole: Default tolerance. [mm]

        Raises:
            InputError: If a part holds no cutting move.

        """
        if not self.stated:
            return toolpath
        allowed = np.empty((len(toolpath), 2))
        allowed[:, 0] = whole
        allowed[:, 1] = np.nan if self.tangential_mm is None else self.tangential_mm
        for number, part in enumerate(self.part):
            rows = part.mark(toolpath)
            if not (rows & ~toolpath.rapid)[1:].any():
                key = next(key for key in PLACES if getattr(part, key) is not None)
                span = f"{len(toolpath)} waypoints over {1e3 * toolpath.arc_length[-1]:.6g} mm"
                raise InputError(
                    f"is {getattr(part, key)!r} and holds no cutting move, the toolpath has {span}",
                    where=f"tolerance.part[{number}].{key}",
                )
            for column, size in enumerate((part.normal_mm, part.tangential_mm)):
                allowed[rows, column] = allowed[rows, column] if size is None else size
        return replace(toolpath, tolerance=1e-3 * allowed)
