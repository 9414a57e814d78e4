"""What the second readers give: the moves of a CAM file in order, in the part frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Kinds of moves.
RAPID, LINE, ARC = 0, 1, 2
NAN = math.nan


class CannotTellError(Exception):
    """What stands here is not known to the second reader; the first one may well read it."""

    def __init__(self, reason: str, line: int | None = None) -> None:
        """Keep what is not known, and where it stands."""
        super().__init__(reason if line is None else f"line {line}: {reason}")
        self.reason, self.line = reason, line


@dataclass(frozen=True)
class Reading:
    """Hold the moves of a file, part frame; a move starts where the one before it ends."""

    kind: NDArray[np.int_]  #: RAPID, LINE or ARC. Shape (n,).
    end: Array  #: End of each move. Shape (n, 3). [m]
    axis: Array  #: Tool axis at the end, tip to spindle. Shape (n, 3).
    feed: Array  #: Programmed feed, 0 in rapid moves and where none is known. Shape (n,). [m/s]
    tool: NDArray[np.int_]  #: Number of the tool, -1 where none is named. Shape (n,).
    line: NDArray[np.int_]  #: Line of the file, from 1. Shape (n,).
    centre: Array  #: Centre of an arc. Shape (n, 3). [m]
    normal: Array  #: Axis of an arc, right-handed about it. Shape (n, 3).
    sweep: Array  #: Angle of an arc, more than a turn for several. Shape (n,). [rad]
    #: Whether the move is a drill's along its axis, chips drawn in between or not. Shape (n,).
    drill: NDArray[np.bool_]
    notes: tuple[str, ...] = ()  #: What was assumed.

    def __len__(self) -> int:
        return len(self.kind)


@dataclass
class Recorder:
    """Collect moves in millimetres and millimetres a second."""

    rows: list[tuple[float, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    line: int = 0
    tool: int = -1

    def move(
        self, kind: int, end: list[float], feed: float, axis: tuple[float, ...] = (0.0, 0.0, 1.0), *,
        centre: tuple[float, ...] = (NAN, NAN, NAN), normal: tuple[float, ...] = (0.0, 0.0, 1.0), sweep: float = 0.0,
        drill: bool = False,
    ) -> None:  # fmt: skip
        """Add a move whose end is wholly known."""
        self.rows.append(
            (kind, *end, *axis, 0.0 if kind == RAPID else feed, self.tool, self.line, *centre, *normal, sweep, drill)
        )

    def note(self, text: str) -> None:
        """Add a note once."""
        if text not in self.notes:
            self.notes.append(text)

    def finish(self) -> Reading:
        """Return the moves; `CannotTellError` if there is none."""
        if not self.rows:
            raise CannotTellError("no move whose end is known")
        table = np.array(self.rows, dtype=float)
        axis = table[:, 4:7] / np.linalg.norm(table[:, 4:7], axis=1, keepdims=True)
        whole = table[:, (0, 8, 9)].astype(int)
        return Reading(
            whole[:, 0], table[:, 1:4] * 1e-3, axis, table[:, 7] * 1e-3, whole[:, 1], whole[:, 2],
            table[:, 10:13] * 1e-3, table[:, 13:16], table[:, 16], table[:, 17] > 0, tuple(self.notes),
        )  # fmt: skip
