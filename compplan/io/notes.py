"""Notes of a result. The severity is set where a note is made.

`Stop("...")` must be settled before the machine moves: it stands whole on the terminal, in the report and in the setup
sheet. Plain text is a remark: it stands in the report and in the summary, the terminal counts it.
"""

from __future__ import annotations

from collections.abc import Iterable


class Stop(str):
    """A note of the severity "must settle": to be settled before the machine moves."""

    __slots__ = ()


def list_stops(notes: Iterable[str]) -> list[str]:
    """Return the notes that have to be settled before the machine moves."""
    return [note for note in notes if isinstance(note, Stop)]


def list_remarks(notes: Iterable[str]) -> list[str]:
    """Return the other notes."""
    return [note for note in notes if not isinstance(note, Stop)]
