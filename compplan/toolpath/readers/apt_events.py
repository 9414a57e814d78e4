"""What APT records switch on the machine: SPINDL, COOLNT, LOADTL, DELAY, STOP, OPSTOP, AUXFUN; text as comments."""

from __future__ import annotations

import re
from dataclasses import dataclass

from compplan.toolpath.readers.apt_words import NUMBER
from compplan.toolpath.readers.cnc.machine import STARTING, STOPPING
from compplan.toolpath.readers.moves import MoveLog

RECORDS = {"SPINDL", "COOLNT", "LOADTL", "LOAD", "TLCHG", "DELAY", "DWELL", "STOP", "OPSTOP", "AUXFUN"}
TEXT = ("PARTNO", "PPRINT", "REMARK", "TPRINT", "TITLES", "TOOL PATH", "LETTER", "$$")


@dataclass
class AptMachine:
    """Hold what turns and runs: the spindle's sense and speed [1/min], coolant."""

    log: MoveLog
    turning: str = ""
    speed: float = 0.0
    cooling: bool = False

    def switch(self, major: str, words: str, line: int) -> None:
        """Carry out a record of `RECORDS`."""
        number = next((float(text) for text in NUMBER.findall(words)), None)
        if major == "SPINDL":
            self._spin(words, number, line)
        elif major == "COOLNT":
            off = "OFF" in words or "NONE" in words
            self._happen("coolant_off" if off else "mist" if "MIST" in words else "coolant", line)
        elif major in ("LOADTL", "LOAD", "TLCHG"):
            self.turning = ""
            self.log.happen("tool", line, value=number or 0.0, text="" if number is not None else words[:32])
        elif major in ("DELAY", "DWELL"):
            self.log.happen("dwell", line, value=max(number or 0.0, 0.0))
        elif major == "AUXFUN":
            self._auxiliary(-1.0 if number is None else number, line)
        else:
            self.log.happen("stop" if major == "STOP" else "optional_stop", line)

    def tell(self, record: str, line: int) -> None:
        """Keep text as a comment."""
        text = re.sub(r"^(PPRINT|REMARK|TPRINT|\$\$)\s*/?\s*", "", record.strip(), flags=re.IGNORECASE)
        if text:
            self.log.happen("comment", line, text=text)

    def end(self, line: int) -> None:
        """Stop what still turns or runs where the file ends."""
        for running, kind in ((self.turning, "spindle_off"), (self.cooling, "coolant_off")):
            if running:
                self._happen(kind, line)

    def _spin(self, words: str, number: float | None, line: int) -> None:
        if "OFF" in words or number == 0.0:
            self._happen("spindle_off", line)
            return
        self.speed = self.speed if number is None else number
        against = re.search(r"\bC?CCLW\b|\bCCW\b|COUNTER", words) is not None
        self._happen("spindle_ccw" if against else "spindle_cw", line)

    def _auxiliary(self, number: float, line: int) -> None:
        kinds = STARTING.get(number, (STOPPING[number],) if number in STOPPING else ())
        for kind in kinds:
            self._happen(kind, line)
        if not kinds:
            self.log.note(f"AUXFUN/{number:g} is not read", line)

    def _happen(self, kind: str, line: int) -> None:
        if kind.startswith("spindle"):
            self.turning = "" if kind == "spindle_off" else kind
        elif kind in ("coolant", "mist", "coolant_off"):
            self.cooling = kind != "coolant_off"
        self.log.happen(kind, line, value=self.speed if kind in ("spindle_cw", "spindle_ccw") else 0.0)
