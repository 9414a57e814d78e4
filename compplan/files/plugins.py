"""Plug-ins: what an installed package adds to a registry, by an entry point of the group `compplan.<what>`.

A plug-in never replaces what is there, and one that cannot be loaded is left out with a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any

#: What can be added, and what the entry point names.
GROUPS = {
    "readers": "module with name, suffixes, recognise, read",
    "languages": "module with name, write",
    "effects": "module with name, words, signatures, apply, fold",
    "strategies": "module with command_path",
    "force_models": "table, a subclass of compplan.path.contact.PathForceTable",
}


def find_plugins(what: str, taken: Collection[str]) -> Iterator[EntryPoint]:
    """Find the plug-ins of a registry, by name; those whose name is taken are left out.

    Args:
        what: One of `GROUPS`.
        taken: Names that the registry holds already.
    """
    for entry in sorted(entry_points(group=f"compplan.{what}"), key=lambda entry: entry.name):
        if entry.name in taken:
            _leave_out(entry, "its name is taken")
        else:
            yield entry


def load_plugins(what: str, taken: Collection[str]) -> dict[str, Any]:
    """Load the plug-ins of a registry: what each entry point names, by the name of the entry point.

    Args:
        what: One of `GROUPS`.
        taken: Names that the registry holds already.
    """
    loaded: dict[str, Any] = {}
    for entry in find_plugins(what, taken):
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:  # of a stranger's module anything may come
            _leave_out(entry, f"{type(error).__name__}: {error}")
    return loaded


def _leave_out(entry: EntryPoint, why: str) -> None:
    owner = "" if entry.dist is None else f" of {entry.dist.name}"
    warnings.warn(f"plug-in {entry.name!r}{owner} ({entry.group}) is left out: {why}", stacklevel=3)
