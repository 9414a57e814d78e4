"""Plug-ins: what an installed package adds to a registry, by an entry point of the group `compplan.<what>`.

A plug-in never replaces what is there, and one that cannot be loaded is left out with a warning.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Collection, Iterator, Mapping, MutableMapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

#: What can be added, and what the entry point names.
GROUPS = {
    "readers": "module with name, suffixes, recognise, read",
    "languages": "module with name, write",
    "effects": "module with name, words, signatures, apply, fold",
    "strategies": "module with command_path",
    "force_models": "table, a subclass of compplan.path.contact.PathForceTable",
}

Entry = TypeVar("Entry")


class Registry(MutableMapping[str, Entry]):
    """What is found by name: modules of one package, imported when they are first asked for, and what is added."""

    def __init__(self, package: str, modules: Mapping[str, str]) -> None:
        self._package, self._modules = package, dict(modules)
        self._loaded: dict[str, Entry] = {}

    def __getitem__(self, name: str) -> Entry:
        if name not in self._loaded:
            module: Any = importlib.import_module(f"{self._package}.{self._modules[name]}")
            self._loaded[name] = module
        return self._loaded[name]

    def __setitem__(self, name: str, entry: Entry) -> None:
        self._modules[name], self._loaded[name] = name, entry

    def __delitem__(self, name: str) -> None:
        del self._modules[name]
        self._loaded.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._modules

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)


@cache
def _list_installed() -> dict[str, list[EntryPoint]]:
    """List the entry points of all groups of this package, by name: installed packages are looked through once."""
    every = entry_points()
    return {what: sorted(every.select(group=f"compplan.{what}"), key=lambda entry: entry.name) for what in GROUPS}


def find_plugins(what: str, taken: Collection[str]) -> Iterator[EntryPoint]:
    """Find the plug-ins of a registry, by name; those whose name is taken are left out.

    Args:
        what: One of `GROUPS`.
        taken: Names that the registry holds already.
    """
    for entry in _list_installed()[what]:
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
