"""Machine events of the CAM file in a program: signals of the cell, waits, stops, comments.

An event without a signal stops the program with an instruction to the operator, so that a cutter without rotation is
not fed into the part. Every language has a `Phrases` table; `phrase_events` writes the events of all languages.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import BeforeValidator, Field

from compplan.controllers.writers.text import clean_text
from compplan.errors import InputError
from compplan.io.notes import Stop
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.events import Event

#: Waiting time for a spindle without `spindle_ready` (assumed). [s]
SPINDLE_WAIT = 5.0


def _check_signal(value: object) -> object:
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 99999:
        return value
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", value):
        return value
    raise ValueError(f"is {value!r}, expected the number of a signal (0 to 99999), or its name")


#: A signal: its number, or its name where the language has names.
Signal = Annotated[int | str, BeforeValidator(_check_signal)]


class Wiring(StrictTable):
    """[output.io]: signals of the cell for events of the CAM file; other events stop for the operator.

    spindle, coolant: outputs that turn the spindle, and switch flood or mist.
    spindle_ready: input that is on when the spindle has reached its speed.
    tool_change: program that changes the tool; its argument is the tool number.
    signals: outputs for the signals of an imported robot program, by their names there (case-insensitive).
    """

    spindle: Signal | None = None
    spindle_ready: Signal | None = None
    coolant: Signal | None = None
    tool_change: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")] | None = None
    signals: dict[str, Signal] = Field(default_factory=dict)


@dataclass(frozen=True)
class Phrases:
    """Phrases of a language: templates of lines (languages.toml); a signal is a number or a name."""

    say: str  #: Comment with a text.
    on: str  #: Set an output.
    off: str  #: Clear an output.
    wait: str  #: Wait for a time. [s]
    expect: str  #: Wait for an input.
    pause: str  #: Stop until the operator continues; the text is the instruction.
    call: str  #: Call a program with a number: name (unchanged, upper, lower), number.
    longest: int | None = None  #: Letters of a comment line, None for any number.
    outputs: str = ""  #: Prefix of the number of an output, in languages whose signals have names; otherwise "".
    inputs: str = ""  #: The same for inputs.
    first_input: int = 0  #: Offset of the numbers of inputs.
    native: Mapping[str, str] = field(default_factory=dict)  #: Lines of events that the language has commands for.

    def write(self, phrase: str, **words: object) -> list[str]:
        """Return the lines of a phrase."""
        return str(getattr(self, phrase)).format(**words).split("\n")

    def comment(self, text: str) -> list[str]:
        """Return a text as comments."""
        lines = [text] if self.longest is None else textwrap.wrap(text, self.longest) or [""]
        return [self.say.format(text=line) for line in lines]

    def switch(self, signal: Signal, on: bool) -> list[str]:
        """Return the lines that set an output."""
        return self.write("on" if on else "off", signal=name_signal(signal, self.outputs))


def phrase_events(events: Sequence[Event], wiring: Wiring, phrases: Phrases, language: str) -> dict[int, list[str]]:
    """Return the lines of a program's events by the row that they follow; -1: before the first move.

    Raises:
        InputError: If a signal has a name where the language only accepts numbers.
    """
    wired = {key: getattr(wiring, key) for key in ("spindle", "spindle_ready", "coolant")}
    for key, signal in {**wired, **wiring.signals}.items():
        if isinstance(signal, str) and not phrases.outputs:
            raise InputError(f"output.io {key} is {signal!r}, {language} numbers its signals; give a number")
    lines: dict[int, list[str]] = {}
    for event in events:
        lines.setdefault(event.place, [])
    for place, written in lines.items():
        instructions: list[str] = []
        for event in (event for event in events if event.place == place):
            remark, code, task = plan_event(event, wiring, phrases)
            if instructions and code:
                written += phrases.write("pause", text=", then ".join(instructions))
                instructions = []
            written += [*remark, *code]
            instructions += [task] if task else []
        written += phrases.write("pause", text=", then ".join(instructions)) if instructions else []
    return lines


def plan_event(event: Event, wiring: Wiring, phrases: Phrases) -> tuple[list[str], list[str], str]:
    """Return the comment of an event, the lines that execute it, and otherwise the instruction to the operator."""
    text = clean_text(event.describe())
    if not text:
        return [], [], ""
    code = [] if event.kind == "comment" else _phrase_event(event, wiring, phrases)
    return phrases.comment(text), code or [], text if code is None else ""


def _phrase_event(event: Event, wiring: Wiring, phrases: Phrases) -> list[str] | None:
    """Return the lines that execute an event, by native commands or signals; None where no signal is defined for it."""
    kind = event.kind
    if kind in phrases.native:
        speed = f" S{event.value:g}" if event.value > 0.0 else ""
        return [phrases.native[kind].format(speed=speed, value=event.value)]
    if kind == "spindle_cw" and wiring.spindle is not None:
        ready = wiring.spindle_ready
        if ready is None:
            return phrases.switch(wiring.spindle, True) + phrases.write("wait", value=SPINDLE_WAIT)
        number = ready + phrases.first_input if isinstance(ready, int) else ready
        wait = phrases.write("expect", signal=name_signal(number, phrases.inputs))
        return phrases.switch(wiring.spindle, True) + wait
    if kind == "spindle_off" and wiring.spindle is not None:
        return phrases.switch(wiring.spindle, False)
    if kind in ("coolant", "mist", "coolant_off"):
        return [] if wiring.coolant is None else phrases.switch(wiring.coolant, kind != "coolant_off")
    if kind == "tool" and wiring.tool_change:
        name = wiring.tool_change
        return phrases.write("call", name=name, upper=name.upper(), lower=name.lower(), value=event.value)
    if kind == "dwell":
        return phrases.write("wait", value=event.value)
    signals = {name.upper(): signal for name, signal in wiring.signals.items()}
    if kind == "output" and event.text in signals:
        return phrases.switch(signals[event.text], event.value != 0.0)
    return None


def name_signal(signal: Signal, prefix: str) -> str:
    """Return the name of a signal in a language with named signals: 3 becomes the prefix followed by 3."""
    return f"{prefix}{signal}" if isinstance(signal, int) else signal


def describe_events(events: Sequence[Event], wiring: Wiring, phrases: Phrases) -> list[str]:
    """Return notes on events without a signal, one sentence each."""
    left = [event for event in events if event.kind != "comment" and event.kind not in phrases.native]
    manual = [event for event in left if plan_event(event, wiring, phrases)[2]]
    notes = []
    if manual:
        kinds = ", ".join(dict.fromkeys(event.kind.replace("_", " ") for event in manual))
        notes.append(f"the program stops for {len(manual)} events and asks the operator ({kinds}): see [output.io]")
    if wiring.coolant is None and any(event.kind in ("coolant", "mist") for event in left):
        notes.append("coolant is a comment only: no output is named in [output.io]")
    if wiring.spindle is not None and any(event.kind.startswith("spindle_c") for event in left):
        notes.append(Stop("spindle speeds are comments: the output of [output.io] turns it, its drive sets the speed"))
        if wiring.spindle_ready is None:
            notes.append(f"the program waits {SPINDLE_WAIT:g} s for the spindle (assumed): spindle_ready")
    tools = {(event.value, event.text) for event in events if event.kind == "tool"}
    if len(tools) > 1:
        notes.append(Stop(f"{len(tools)} tools are called: the program is planned for one: write [[tool]] for each"))
    return notes
