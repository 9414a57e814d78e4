"""Registries: modules by name, imported at first access."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator, MutableMapping
from typing import Any, TypeVar

Entry = TypeVar("Entry")


class Registry(MutableMapping[str, Entry]):
    """Modules by name, imported at first access.

    A lower package may list the names; the package that holds the modules then sets itself with `held_by`.
    """

    def __init__(self, names: Iterable[str], package: str = "") -> None:
        self._package = package
        self._modules: dict[str, Any] = dict.fromkeys(names)

    def held_by(self, package: str) -> Registry[Entry]:
        """Set the package that holds the modules; return the registry."""
        self._package = package
        return self

    def __getitem__(self, name: str) -> Entry:
        if self._modules[name] is None:
            self._modules[name] = importlib.import_module(f"{self._package}.{name}")
        module: Entry = self._modules[name]
        return module

    def __setitem__(self, name: str, entry: Entry) -> None:
        self._modules[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._modules[name]

    def __contains__(self, name: object) -> bool:
        return name in self._modules

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)
