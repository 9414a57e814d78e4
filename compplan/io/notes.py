"""Notes of a result, with their severity.

`Stop("...")` must be resolved before the machine moves: terminal, report and setup sheet show it in full. Plain text is
a remark: report and summary show it, the terminal counts it.
"""

from __future__ import annotations

from collections.abc import Iterable


class Stop(str):
    """A note that must be resolved before the machine moves."""

    __slots__ = ()


def list_stops(notes: Iterable[str]) -> list[str]:
    """Return the notes that must be resolved before the machine moves."""
    return [note for note in notes if isinstance(note, Stop)]


def list_remarks(notes: Iterable[str]) -> list[str]:
    """Return the other notes."""
    return [note for note in notes if not isinstance(note, Stop)]
