"""[tolerance]: how far the tip may be off the path, part by part of it, across and along the travel apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.toolpath import Toolpath

Size = Annotated[float, Field(gt=0.0, le=100.0)]
#: Ways to say which part of a path is meant.
PLACES = ("waypoints", "s_mm", "operation")


class TolerancePart(StrictTable):
    """[[tolerance.part]]: another tolerance for some moves, such as those that rough.

    waypoints: First and last row of the toolpath file, counted from 0; the moves between them.
    s_mm: Length along the path, rapid moves included.
    operation: Number or name of a tool, or words of a comment of the CAM file: what follows until the next of its kind.
    """

    name: str = Field(default="", max_length=200)
    waypoints: Annotated[tuple[int, int], Field(strict=False)] | None = None
    s_mm: Annotated[tuple[float, float], Field(strict=False)] | None = None
    operation: str | None = Field(default=None, min_length=1)
    normal_mm: Size | None = None
    tangential_mm: Size | None = None

    @model_validator(mode="after")
    def _check(self) -> TolerancePart:
        said = [key for key in PLACES if getattr(self, key) is not None]
        if len(said) != 1:
            raise ValueError(f"says its place by {', '.join(said) or 'nothing'}, expected one of {', '.join(PLACES)}")
        if self.normal_mm is None and self.tangential_mm is None:
            raise ValueError("states no tolerance, expected normal_mm or tangential_mm")
        for key in ("waypoints", "s_mm"):
            span = getattr(self, key)
            if span is not None and span[1] <= span[0]:
                raise ValueError(f"has {key} that end at {span[1]:g}, expected more than {span[0]:g}")
        return self

    def mark(self, toolpath: Toolpath) -> NDArray[np.bool_]:
        """Tell which moves are meant, by the row that each ends at. Shape (n,)."""
        rows = np.arange(len(toolpath))
        if self.waypoints is not None:
            return (rows > self.waypoints[0]) & (rows <= self.waypoints[1])
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
    """[tolerance]: what counts where no part says otherwise; left out, plan.tolerance_mm as a distance.

    With tangential_mm the deviation along the travel counts apart from that across it, and normal_mm is for the latter.
    tube is the share of it by which a plan may leave the path where that makes its run shorter or its promise narrower.
    """

    normal_mm: Size | None = None
    tangential_mm: Size | None = None
    tube: float = Field(default=0.0, ge=0.0, le=0.9)
    part: Annotated[tuple[TolerancePart, ...], Field(strict=False, max_length=10000)] = ()

    @property
    def stated(self) -> bool:
        """Tell whether it says anything."""
        return bool(self.model_fields_set - {"tube"})

    def strictest(self, whole: float) -> float:
        """Return the least tolerance across the travel, with what counts everywhere where nothing is said. [mm]."""
        normal = whole if self.normal_mm is None else self.normal_mm
        return min([normal, *(part.normal_mm for part in self.part if part.normal_mm is not None)])

    def lay(self, toolpath: Toolpath, whole: float) -> Toolpath:
        """Return a toolpath with the tolerance of its moves; of parts that overlap the last one counts.

        Args:
            toolpath: The toolpath as its file has it.
            whole: What counts everywhere where nothing is said. [mm]

        Raises:
            InputError: If a part holds no cutting move.

        """
        if not self.stated:
            return toolpath
        allowed = np.empty((len(toolpath), 2))
        allowed[:, 0] = whole if self.normal_mm is None else self.normal_mm
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
