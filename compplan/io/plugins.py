"""Plug-ins: entry points of the group `compplan.<what>` that extend a registry.

A plug-in never replaces an existing name, and one that cannot be loaded is left out with a warning.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Collection, Iterable, Iterator, MutableMapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

#: Groups of entry points, and what each one names.
GROUPS = {
    "readers": "module with name, suffixes, recognise, read",
    "languages": "module with name, write",
    "effects": "module with name, words, signatures, apply, fold",
    "strategies": "module with words, command_path",
    "force_models": "module with words, table",
}

Entry = TypeVar("Entry")


class Registry(MutableMapping[str, Entry]):
    """Modules by name, imported at first access.

    A lower package may list the names; the package that holds the modules then sets itself with `held_by`.
    """

    def __init__(self, names: Iterable[str], package: str = "") -> None:
        self._package, self._names = package, dict.fromkeys(names)
        self._installed: dict[str, EntryPoint] = {}
        self._loaded: dict[str, Entry] = {}

    def held_by(self, package: str) -> Registry[Entry]:
        """Set the package that holds the modules; return the registry."""
        self._package = package
        return self

    def install(self, what: str) -> Registry[Entry]:
        """Add the names of plug-ins, one of `GROUPS`, without loading them; return the registry."""
        for entry in find_plugins(what, self._names):
            self._names[entry.name], self._installed[entry.name] = None, entry
        return self

    def load_installed(self) -> Registry[Entry]:
        """Load the plug-ins; those that cannot be loaded are left out. Return the registry."""
        for name in list(self._installed):
            if (module := _load(self._installed.pop(name))) is None:
                del self._names[name]
            else:
                self._loaded[name] = module
        return self

    def __getitem__(self, name: str) -> Entry:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._loaded:
            own = self._installed.get(name)
            module: Any = importlib.import_module(f"{self._package}.{name}") if own is None else own.load()
            self._loaded[name] = module
        return self._loaded[name]

    def __setitem__(self, name: str, entry: Entry) -> None:
        self._names[name], self._loaded[name] = None, entry

    def __delitem__(self, name: str) -> None:
        del self._names[name]
        self._loaded.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@cache
def _list_installed() -> dict[str, list[EntryPoint]]:
    """List the entry points of all groups of this package, by name (cached)."""
    every = entry_points()
    return {what: sorted(every.select(group=f"compplan.{what}"), key=lambda entry: entry.name) for what in GROUPS}


def find_plugins(what: str, taken: Collection[str]) -> Iterator[EntryPoint]:
    """Find the plug-ins of a registry, by name; those whose name is taken are left out.

    Args:
        what: One of `GROUPS`.
        taken: Names in the registry.
    """
    for entry in _list_installed()[what]:
        if entry.name in taken:
            _leave_out(entry, "its name is taken")
        else:
            yield entry


def _load(entry: EntryPoint) -> Any:
    """Load a plug-in; None where it cannot be loaded."""
    try:
        return entry.load()
    except Exception as error:  # a foreign module may raise anything
        _leave_out(entry, f"{type(error).__name__}: {error}")
        return None


def _leave_out(entry: EntryPoint, why: str) -> None:
    owner = "" if entry.dist is None else f" of {entry.dist.name}"
    warnings.warn(f"plug-in {entry.name!r}{owner} ({entry.group}) is left out: {why}", stacklevel=3)
