"""Canned drilling cycles of G-code (G73, G74, G76, G81 to G89)."""

from __future__ import annotations

from collections.abc import Mapping

from compplan.errors import InputError
from compplan.path.cam.arcs import Point
from compplan.path.cam.gcode_state import State
from compplan.path.cam.moves import MoveLog

#: Greatest number of holes of one block.
MOST_HOLES = 10_000


def run_cycle(
    code: float, values: Mapping[str, float], state: State, log: MoveLog, expand: bool, line: int
) -> None:
    """Carry out the holes of one block.

    Skipped: the tool moves rapidly to each hole at the level that it retracts to. Expanded: it also goes rapidly to the
    level R, cuts to Z with the feed, and goes back rapidly (out of boring and tapping cycles with the feed); pecks,
    dwells and shifts are left out.

    Args:
        code: The cycle.
        values: Words of the block; R, Z, L, K count, the others shape the cycle.
        state: State of the program; it ends where the cycle ends.
        log: Log of the moves.
        expand: Whether holes are cut.
        line: Line of the block.

    Raises:
        InputError: If the block asks for more holes than any part has.

    """
    for letter in "RZ":
        if letter in values:
            state.cycle[letter] = _level(letter, values[letter], state)
    if values.keys().isdisjoint("XYZ"):
        return
    repeats = int(values.get("L", values.get("K", 1.0))) if state.incremental else 1
    if values.get("L", values.get("K", 1.0)) == 0.0:
        return
    if repeats > MOST_HOLES:
        raise InputError(f"cycle with {repeats} repeats, at most {MOST_HOLES} are read")
    start = state.cycle_start
    clear = state.cycle.get("R", start)
    bottom = state.cycle.get("Z", clear)
    top = max(start, clear) if state.retract_to_start else clear
    for _ in range(max(1, repeats)):
        x, y, _ = state.target({letter: values[letter] for letter in "XY" if letter in values}, range(2))
        log.counts["cycles"] += 1
        _rapid(state, log, (x, y, max(state.position[2], clear)))
        if expand:
            _rapid(state, log, (x, y, clear))
            state.moved = True
            log.line((x, y, bottom), state.feed_mm_s(abs(clear - bottom)) or 0.0)
            if code in (74.0, 84.0, 85.0, 89.0):
                log.line((x, y, clear), state.feed_mm_s(abs(clear - bottom)) or 0.0)
        state.position = (x, y, top)
        _rapid(state, log, state.position)
    if not expand:
        log.note(f"drilling cycle G{code:g} is left out: the tool moves rapidly above the holes (option cycles)", line)


def _rapid(state: State, log: MoveLog, point: Point) -> None:
    state.position = point
    if state.knows_position():
        log.rapid(point)
    else:
        log.place(point)


def _level(letter: str, number: float, state: State) -> float:
    """Return the height that R or Z of a cycle names; in G91 R counts from the start and Z from R."""
    value = number * state.scale
    if not state.incremental:
        state.known.add(2)
        return value + state.zero(2)
    return value + (state.cycle_start if letter == "R" else state.cycle.get("R", state.cycle_start))
