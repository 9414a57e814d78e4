"""What G-code switches on the machine: spindle, coolant, tools, dwells and stops (M codes, S, T, G4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from compplan.path.cam.gcode_state import State
from compplan.path.cam.moves import MoveLog

#: Codes that happen before the move of their block, beside M6, and what they switch on.
STARTING = {3.0: ("spindle_cw",), 4.0: ("spindle_ccw",), 7.0: ("mist",), 8.0: ("coolant",),
            13.0: ("spindle_cw", "coolant"), 14.0: ("spindle_ccw", "coolant")}  # fmt: skip
#: ... and after it.
STOPPING = {0.0: "stop", 1.0: "optional_stop", 5.0: "spindle_off", 9.0: "coolant_off"}
ENDS = frozenset({2.0, 17.0, 30.0, 99.0})
#: Codes that switch nothing that a robot has, or that the reader deals with elsewhere.
SILENT = ENDS | {6.0, 48.0, 49.0, 97.0, 98.0, 128.0, 129.0}
#: Codes with which S limits the spindle, or is no speed.
LIMITS = frozenset({4.0, 25.0, 26.0, 50.0, 92.0})
#: A dwell P without a decimal point is taken in milliseconds from here up. [ms]
LEAST_MILLISECONDS = 100.0


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
    if "T" in values:
        state.tool, state.tool_name = values["T"], ""
        if 6.0 not in machine:
            log.happen("comment", line, text=f"tool T{values['T']:g} is called")
    if 6.0 in machine:
        log.happen("tool", line, value=state.tool, text=state.tool_name)
        state.turning = ""
    changed = "S" in values and LIMITS.isdisjoint(codes)
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


def stop_machine(machine: Sequence[float], state: State, log: MoveLog, line: int) -> bool:
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
