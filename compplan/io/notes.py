"""Notes of a result: sentences, of which some have to be settled before the machine moves."""

from __future__ import annotations

from collections.abc import Iterable


class Stop(str):
    """A note that has to be settled before the machine moves; a note of another kind is plain text."""

    __slots__ = ()


def list_stops(notes: Iterable[str]) -> list[str]:
    """Return the notes that have to be settled before the machine moves."""
    return [note for note in notes if isinstance(note, Stop)]


def list_remarks(notes: Iterable[str]) -> list[str]:
    """Return the other notes."""
    return [note for note in notes if not isinstance(note, Stop)]
