"""Drilling cycles of APT (CYCLE/DRILL ..): their depth, clearance and feed, in the dialects of CAM systems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

#: Cycles that leave the hole with the feed.
FEED_OUT = {"BORE", "TAP", "REAM", "THREAD"}
DEPTH = {"DEPTH", "DEEP"}
CLEAR = {"CLEAR", "RAPTO", "RTRCTO", "RETURN", "CLEARANCE"}
FEED_WORDS = {"MMPM", "MMPMIN", "IPM", "MMPR", "IPR", "PERMIN", "PERREV", "FEDRAT"}
#: Words followed by a number that does not shape the path.
OTHER = {"STEP", "DWELL", "CSINK", "PECK", "INCR", "DWELLR", "ORIENT", "RPM", "NUMBER", "CAM", "BOTTOM", "BRKCHP"}


@dataclass(frozen=True)
class Cycle:
    """Hold a drilling cycle.

    Args:
        kind: DRILL, TAP, ...
        depth: How far below the programmed point the hole ends, along the tool axis, file units; None: not said.
        clear: How far above it the feed begins, file units.
        feed: Feed words of the record, as those of FEDRAT, "" without any.

    """

    kind: str
    depth: float | None
    clear: float
    feed: str


def read_cycle(fields: Sequence[float | str]) -> Cycle:
    """Read CYCLE/kind with DEPTH, d or FEDTO, -d, CLEAR or RAPTO, c and MMPM, f; or CYCLE/kind, d, MMPM, f, c (ISO).

    Raises:
        ValueError: If a number belongs to no word that is known.

    """
    if not fields:
        raise ValueError("a cycle has no kind, expected CYCLE/DRILL, ..")
    kind = str(fields[0])
    depth: float | None = None
    clear, feed, bare = 0.0, "", []
    word = ""
    for field in fields[1:]:
        if isinstance(field, str):
            word = field
            continue
        if word in DEPTH:
            depth = abs(field)
        elif word == "FEDTO":
            depth = -field
        elif word in CLEAR:
            clear = max(clear, field)
        elif word in FEED_WORDS:
            feed = f"{field!r},{word}" if word != "FEDRAT" else f"{field!r}"
        elif not word or word == kind:
            bare.append(field)
        elif word not in OTHER:
            raise ValueError(f"number {field:g} after {word} in a cycle is not known")
        word = "" if word not in ("", kind) else word
    if bare and depth is None:
        depth = abs(bare.pop(0))
    if bare:
        clear = max(clear, bare.pop(0))
    if bare:
        raise ValueError(f"number {bare[0]:g} in a cycle is not known")
    return Cycle(kind, depth, clear, feed)
