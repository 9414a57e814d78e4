"""What G-code switches on the machine: spindle, coolant, tools, dwells and stops (M codes, S, T, G4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from compplan.toolpath.readers.cnc.state import State
from compplan.toolpath.readers.moves import MoveLog

#: Codes that happen before the move of their block, beside M6, and what they switch on.
STARTING = {3.0: ("spindle_cw",), 4.0: ("spindle_ccw",), 7.0: ("mist",), 8.0: ("coolant",),
            13.0: ("spindle_cw", "coolant"), 14.0: ("spindle_ccw", "coolant")}  # fmt: skip
#: ... and after it.
STOPPING = {0.0: "stop", 1.0: "optional_stop", 5.0: "spindle_off", 9.0: "coolant_off"}
ENDS = frozenset({2.0, 17.0, 30.0, 99.0})
#: Codes that switch nothing that a robot has, or that the reader deals with elsewhere.
SILENT = ENDS | {6.0, 48.0, 49.0, 61.0, 97.0, 98.0, 128.0, 129.0}
#: Codes of printers (Marlin, RepRap) that own the words of their block: they set the machine, and move nothing.
OWNERS = frozenset(float(code) for code in (
    16, 20, 22, 23, 24, 25, 26, 27, 28, 31, 32, 36, 42, 43, 73, 74, 84, 85, 92, *range(104, 126), 140, 141, 143, 144,
    145, 149, 150, *range(155, 196), *range(200, 300), *range(300, 310), 350, 351, 355, 360, 361, 362, 363, 364,
    *range(380, 382), *range(400, 430), 486, *range(500, 620), *range(665, 675), 701, 702, 710, 851, 852, 862, 865,
    871, 876, 900, *range(906, 920), 928, 951, 993, 994, 995, 997, 999, 1000, 1002, 1006,
))  # fmt: skip
#: ... those among them that take coordinates.
PLACING = frozenset(float(code) for code in (
    92, 122, 125, *range(200, 230), 301, 303, 304, 350, 351, 420, 425, 540, 558, 566, 569, 574, 579, 584, 593, 665, 666,
    669, 671, 672, 851, 852, 871, 900, *range(906, 920), 951, 1006,
))  # fmt: skip
#: Codes with which S limits the spindle, or is no speed.
LIMITS = frozenset({4.0, 25.0, 26.0, 50.0, 92.0})
#: M codes with which S is no speed: it stops the spindle at an angle.
ANGLES = frozenset({19.0})
#: A dwell P without a decimal point is taken in milliseconds from here up. [ms]
LEAST_MILLISECONDS = 100.0


class Running(Protocol):
    """What of a machine runs: the spindle ("" or how it turns), and coolant."""

    turning: str
    cooling: bool


def owns_words(code: float) -> bool:
    """Return whether the words of a block belong to an M code."""
    return code in OWNERS or (code > 16.0 and code != int(code))


def start_machine(
    machine: Sequence[float], values: Mapping[str, float], codes: Sequence[float], state: State, log: MoveLog, line: int
) -> None:
    """Let happen what a block switches before its move.

    Args:
        machine: Its M codes.
        values: Its words.
        codes: Its G codes.
        state: State of the program.
        log: Log of the moves.
        line: Line of the block.

    """
    by_t = state.changes_by_t and values.get("T", 0.0) not in (0.0, state.tool)
    if "T" in values:
        state.tool, state.tool_name = values["T"], ""
    if "T" in values and 6.0 not in machine and 61.0 not in machine and not state.changes_by_t:
        log.happen("comment", line, text=f"tool T{values['T']:g} is called")  # it waits for the next M6
    if 61.0 in machine:
        state.tool, state.tool_name = values.get("Q", state.tool), ""
    if 6.0 in machine or 61.0 in machine or by_t:
        if by_t:
            log.note("T without M6 is read as a tool change: the file has no M6", line)
        log.happen("tool", line, value=state.tool, text=state.tool_name)
        state.turning = ""
    changed = "S" in values and LIMITS.isdisjoint(codes) and ANGLES.isdisjoint(machine)
    if changed:
        state.spindle = values["S"]
    kinds = [kind for code in machine for kind in STARTING.get(code, ())]
    for kind in kinds:
        if kind.startswith("spindle"):
            state.turning, changed = kind, True
    if changed and state.turning:
        off = state.spindle == 0.0 and "S" in values
        log.happen("spindle_off" if off else state.turning, line, value=0.0 if off else state.spindle)
    for kind in kinds:
        if not kind.startswith("spindle"):
            state.cooling = True
            log.happen(kind, line)
    if 4.0 in codes:
        log.happen("dwell", line, value=_read_dwell(values, state, log, line))
    for code in machine:
        if code not in STARTING and code not in STOPPING and code not in SILENT:
            log.note(f"M{code:g} is not read", line)
            log.happen("comment", line, text=f"M{code:g} of the CAM file")


def stop_machine(machine: Sequence[float], state: Running, log: MoveLog, line: int) -> bool:
    """Let happen what a block switches after its move; return whether the program ends."""
    for code in machine:
        kind = STOPPING.get(code, "")
        if kind == "spindle_off":
            state.turning = ""
        elif kind == "coolant_off":
            state.cooling = False
        if kind:
            log.happen(kind, line)
    return not ENDS.isdisjoint(machine)


def end_machine(state: State, log: MoveLog, line: int) -> None:
    """Stop what still turns or runs where the program ends."""
    if state.turning:
        log.happen("spindle_off", line)
    if state.cooling:
        log.happen("coolant_off", line)
    state.turning, state.cooling = "", False


def _read_dwell(values: Mapping[str, float], state: State, log: MoveLog, line: int) -> float:
    """Return how long G4 waits [s]: F, X or U in seconds, S in turns, P in seconds or milliseconds."""
    if "P" in values:
        if values["P"] < LEAST_MILLISECONDS:
            return max(values["P"], 0.0)
        log.note(f"G4 P{values['P']:g} is taken in milliseconds", line)
        return values["P"] * 1e-3
    if "S" in values:
        return 60.0 * values["S"] / state.spindle if state.spindle > 0.0 else 0.0
    return max(next((values[letter] for letter in "FXU" if letter in values), 0.0), 0.0)
