"""Drilling cycles of APT (CYCLE/DRILL ..): their depth, clearance and feed, in the dialects of CAM systems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

#: Cycles that leave the hole with the feed.
FEED_OUT = {"BORE", "TAP", "REAM", "THREAD"}
DEPTH = {"DEPTH", "DEEP"}
#: Words of the level that the feed begins at, and of the one that the tool goes back to.
CLEAR, RETRACT = ("RAPTO", "CLEAR", "CLEARANCE"), ("RTRCTO", "RETURN")
FEED_WORDS = {"MMPM", "MMPMIN", "IPM", "MMPR", "IPR", "PERMIN", "PERREV", "FEDRAT", "UPM", "UPR", "FPM", "MPM"}
#: Words followed by a number that does not shape the path.
OTHER = {"1STPECK", "BACKFEED", "BOTTOM", "BRKCHP", "CAM", "CHIP", "CSINK", "DECR", "DWELL", "DWELLR", "INCR", "LEAD",
         "MINPECK", "MMPP", "NUMBER", "OPTION", "ORIENT", "PECK", "PECKMIN", "PITCH", "REV", "RPM", "SEC", "SPINDL",
         "STEP", "STEP1", "STEP2", "SUBPECK", "TIMES", "TPI"}  # fmt: skip


@dataclass(frozen=True)
class AptCycle:
    """Hold a drilling cycle.

    Args:
        kind: DRILL, TAP, ...
        depth: How far below the programmed point the hole ends, along the tool axis, file units; None: not said.
        clear: How far above it the feed begins, file units.
        retract: How far above it the tool comes and goes, file units.
        feed: Feed words of the record, as those of FEDRAT, "" without any.

    """

    kind: str
    depth: float | None
    clear: float
    retract: float
    feed: str


def read_cycle(fields: Sequence[float | str]) -> AptCycle:
    """Read CYCLE/kind with DEPTH, d or FEDTO, d, CLEAR or RAPTO, c and MMPM, f; or their order without words.

    FEDTO is a depth of either sign. In order, a feed stands after its unit or before it:
    CYCLE/kind, d, MMPM, f, c (ISO) or CYCLE/kind, d, f, IPM, c.

    Raises:
        ValueError: If a number belongs to no word that is known.

    """
    if not fields:
        raise ValueError("a cycle has no kind, expected CYCLE/DRILL, ..")
    kind = str(fields[0])
    depth: float | None = None
    levels: dict[str, float] = {}
    feed, bare = "", list[float]()
    word = ""
    for field in fields[1:]:
        if isinstance(field, str):
            word = field
            if word in FEED_WORDS and len(bare) == 2 and depth is None and not feed:
                feed, word = f"{bare.pop()!r},{word}", kind
            continue
        if word in DEPTH:
            depth = abs(field)
        elif word == "FEDTO":
            depth = abs(field)  # a hole lies below its point, whatever sign the system gives it
        elif word in CLEAR or word in RETRACT:
            levels[word] = field
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
        levels.setdefault("CLEAR", bare.pop(0))
    if bare:
        raise ValueError(f"number {bare[0]:g} in a cycle is not known")
    clear = next((levels[word] for word in (*CLEAR, *RETRACT) if word in levels), 0.0)
    return AptCycle(kind, depth, clear, max([clear, *levels.values()]), feed)
