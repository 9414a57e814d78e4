"""What a program switches on the machine where the CAM file does: signals of the cell, waits, stops, comments.

An event that no signal is named for stops the program and says what the operator has to do, so that no cutter that
stands still is fed into the part. Every language has a `Phrases`; `phrase_events` writes all of them the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import BeforeValidator, Field

from compplan.controllers.writers.text import clean_text
from compplan.errors import InputError
from compplan.io.notes import Stop
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.events import Event

#: How long a program waits for a spindle that has no `spindle_ready` (assumed). [s]
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
    """[output.io]: signals of the cell for events of the CAM file; events without one ask the operator.

    spindle, coolant: outputs that turn the spindle, and switch flood or mist.
    spindle_ready: input that is on when the spindle has its speed.
    tool_change: program that changes the tool; it gets the tool's number.
    signals: outputs for signals of a robot program that was read, by their name there in any case of letters.
    """

    spindle: Signal | None = None
    spindle_ready: Signal | None = None
    coolant: Signal | None = None
    tool_change: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")] | None = None
    signals: dict[str, Signal] = Field(default_factory=dict)


@dataclass(frozen=True)
class Phrases:
    """Hold how a language says things; each gives lines."""

    say: Callable[[str], list[str]]  #: Comment of a text.
    switch: Callable[[Signal, bool], list[str]]  #: Sets an output: (signal, on).
    wait: Callable[[float], list[str]]  #: Waits: (seconds).
    expect: Callable[[Signal], list[str]]  #: Waits for an input: (signal).
    pause: Callable[[str], list[str]]  #: Stops until the operator goes on: (what to do).
    call: Callable[[str, float], list[str]]  #: Calls a program with a number: (name, number).
    named: bool = False  #: Whether signals may have names.
    #: Lines of events that the language has words of its own for, None for others.
    native: Callable[[Event], list[str] | None] = lambda event: None


def phrase_events(events: Sequence[Event], wiring: Wiring, phrases: Phrases, language: str) -> dict[int, list[str]]:
    """Return the lines of a program's events by the row after which they stand; -1: before the first move.

    Raises:
        InputError: If a signal is a name where the language takes numbers only.
    """
    wired = {key: getattr(wiring, key) for key in ("spindle", "spindle_ready", "coolant")}
    for key, signal in {**wired, **wiring.signals}.items():
        if isinstance(signal, str) and not phrases.named:
            raise InputError(f"output.io {key} is {signal!r}, {language} numbers its signals; give a number")
    lines: dict[int, list[str]] = {}
    for event in events:
        lines.setdefault(event.place, [])
    for place, written in lines.items():
        asked: list[str] = []
        for event in (event for event in events if event.place == place):
            remark, code, task = plan_event(event, wiring, phrases)
            if asked and code:
                written += phrases.pause(", then ".join(asked))
                asked = []
            written += [*remark, *code]
            asked += [task] if task else []
        written += phrases.pause(", then ".join(asked)) if asked else []
    return lines


def plan_event(event: Event, wiring: Wiring, phrases: Phrases) -> tuple[list[str], list[str], str]:
    """Return the comment of an event, the lines that do it, or else what the operator is asked to do."""
    text = clean_text(event.describe())
    if not text:
        return [], [], ""
    code = [] if event.kind == "comment" else phrases.native(event)
    code = _phrase_event(event, wiring, phrases) if code is None else code
    return phrases.say(text), code or [], text if code is None else ""


def _phrase_event(event: Event, wiring: Wiring, phrases: Phrases) -> list[str] | None:
    """Return the lines that do an event by the signals of the cell; None where nothing is wired for it."""
    kind = event.kind
    if kind == "spindle_cw" and wiring.spindle is not None:
        ready = wiring.spindle_ready
        wait = phrases.wait(SPINDLE_WAIT) if ready is None else phrases.expect(ready)
        return phrases.switch(wiring.spindle, True) + wait
    if kind == "spindle_off" and wiring.spindle is not None:
        return phrases.switch(wiring.spindle, False)
    if kind in ("coolant", "mist", "coolant_off"):
        return [] if wiring.coolant is None else phrases.switch(wiring.coolant, kind != "coolant_off")
    if kind == "tool" and wiring.tool_change:
        return phrases.call(wiring.tool_change, event.value)
    if kind == "dwell":
        return phrases.wait(event.value)
    signals = {name.upper(): signal for name, signal in wiring.signals.items()}
    if kind == "output" and event.text in signals:
        return phrases.switch(signals[event.text], event.value != 0.0)
    return None


def name_signal(signal: Signal, prefix: str) -> str:
    """Return the name of a signal in a language that names them: 3 becomes the prefix with 3."""
    return f"{prefix}{signal}" if isinstance(signal, int) else signal


def describe_events(events: Sequence[Event], wiring: Wiring, phrases: Phrases) -> list[str]:
    """Return what has to be said of events that nothing is wired for, one sentence each."""
    left = [event for event in events if event.kind != "comment" and phrases.native(event) is None]
    asked = [event for event in left if plan_event(event, wiring, phrases)[2]]
    notes = []
    if asked:
        kinds = ", ".join(dict.fromkeys(event.kind.replace("_", " ") for event in asked))
        notes.append(f"the program stops for {len(asked)} events and asks the operator ({kinds}): see [output.io]")
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
