"""Strategies in words, for charts, tables and sentences; the job and the result files call them by their names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from compplan.io.palette import AFTER, BEFORE, NEUTRAL
from compplan.planning.strategies.online import ONLINE, STRATEGIES


def name_strategy(name: str) -> str:
    """Name a strategy in a few words: those of its file, its name where that has none."""
    module = STRATEGIES.get(name) or ONLINE.get(name)
    return str(getattr(module, "words", name.replace("_", " ")))


def colour_strategies(names: Iterable[str], best: str) -> list[str]:
    """Return a colour a strategy: one for no correction, one for the best, grey for the others."""
    return [AFTER if name == best else BEFORE if name == "none" else NEUTRAL for name in names]


def join_names(names: Sequence[str]) -> str:
    """Join names as a sentence does."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
