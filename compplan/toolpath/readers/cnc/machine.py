"""What a program switches on the machine: spindle, coolant, tools, dwells and stops (M codes, S, T, G4)."""

from __future__ import annotations

from collections.abc import Iterable

from compplan.toolpath.readers.cnc.state import CncBlock, State
from compplan.toolpath.readers.moves import MoveLog

#: Codes that happen before the move of their block, beside M6, and what they switch on.
STARTING = {3.0: ("spindle_cw",), 4.0: ("spindle_ccw",), 7.0: ("mist",), 8.0: ("coolant",),
            13.0: ("spindle_cw", "coolant"), 14.0: ("spindle_ccw", "coolant")}  # fmt: skip
#: ... and after it.
STOPPING = {0.0: "stop", 1.0: "optional_stop", 5.0: "spindle_off", 9.0: "coolant_off"}
#: Codes with which S limits the spindle, or is no speed; M codes with which it stops the spindle at an angle.
LIMITS = frozenset({4.0, 25.0, 26.0, 50.0, 92.0})
ANGLES = frozenset({19.0})
#: A dwell P without a decimal point is taken in milliseconds from here up. [ms]
LEAST_MILLISECONDS = 100.0


class Machine:
    """Let happen what M codes and the words S and T switch."""

    def __init__(self, state: State, log: MoveLog, silent: frozenset[float], ends: frozenset[float]) -> None:
        self.state, self.log, self.silent, self.ends = state, log, silent | ends, ends

    def start(self, block: CncBlock, line: int) -> None:
        """Let happen what a block switches before its move."""
        state, log, values, machine = self.state, self.log, block.values, block.machine
        by_t = state.changes_by_t and values.get("T", 0.0) not in (0.0, state.tool)
        changing = 6.0 in machine or 61.0 in machine
        if "T" in values:
            state.tool, state.tool_name = values["T"], ""
            if not changing and not state.changes_by_t:
                log.happen("comment", line, text=f"tool T{values['T']:g} is called")  # it waits for the next M6
        if 61.0 in machine:
            state.tool, state.tool_name = values.get("Q", state.tool), ""
        if changing or by_t:
            if by_t:
                log.note("T without M6 is read as a tool change: the file has no M6", line)
            self.change_tool(line)
        changed = "S" in values and LIMITS.isdisjoint(block.codes) and ANGLES.isdisjoint(machine)
        if changed:
            state.spindle = values["S"]
        self.switch_on(machine, line, changed=changed)
        if 4.0 in block.codes:
            log.happen("dwell", line, value=self._read_dwell(block, line))

    def change_tool(self, line: int) -> None:
        """Change to the tool that is called."""
        self.log.happen("tool", line, value=self.state.tool, text=self.state.tool_name)
        self.state.turning = ""

    def switch_on(self, machine: Iterable[float], line: int, *, changed: bool = False) -> None:
        """Let happen what M codes switch on, and what a changed speed does to a spindle that turns."""
        state, log = self.state, self.log
        kinds = [kind for code in machine for kind in STARTING.get(code, ())]
        for kind in kinds:
            if kind.startswith("spindle"):
                state.turning, changed = kind, True
        if changed and state.turning:
            off = state.spindle == 0.0
            log.happen("spindle_off" if off and not kinds else state.turning, line, value=state.spindle)
        for kind in kinds:
            if not kind.startswith("spindle"):
                state.cooling = True
                log.happen(kind, line)
        for code in machine:
            if code not in STARTING and code not in STOPPING and code not in self.silent:
                log.note(f"M{code:g} is not read", line)
                log.happen("comment", line, text=f"M{code:g} of the CAM file")

    def stop(self, machine: Iterable[float], line: int) -> bool:
        """Let happen what M codes switch after the move of their block; return whether the program ends."""
        for code in machine:
            kind = STOPPING.get(code, "")
            if kind == "spindle_off":
                self.state.turning = ""
            elif kind == "coolant_off":
                self.state.cooling = False
            if kind:
                self.log.happen(kind, line)
        return not self.ends.isdisjoint(machine)

    def end(self, line: int) -> None:
        """Stop what still turns or runs where the program ends."""
        for running, kind in ((self.state.turning, "spindle_off"), (self.state.cooling, "coolant_off")):
            if running:
                self.log.happen(kind, line)
        self.state.turning, self.state.cooling = "", False

    def _read_dwell(self, block: CncBlock, line: int) -> float:
        """Return how long G4 waits [s]: F, X or U in seconds, S in turns, P in seconds or milliseconds."""
        values = block.values
        if "P" in values:
            if values["P"] < LEAST_MILLISECONDS:
                return max(values["P"], 0.0)
            self.log.note(f"G4 P{values['P']:g} is taken in milliseconds", line)
            return values["P"] * 1e-3
        if "S" in values:
            return 60.0 * values["S"] / self.state.spindle if self.state.spindle > 0.0 else 0.0
        return max(next((values[letter] for letter in "FXU" if letter in values), 0.0), 0.0)
