"""Registries: modules by name, imported at first access."""

from __future__ import annotations

import importlib
from collections import UserDict
from collections.abc import Iterable
from typing import Any, TypeVar

Entry = TypeVar("Entry")


class Registry(UserDict[str, Entry]):
    """Modules by name, imported at first access.

    A package may list names of modules that a later package holds; that package registers itself with `held_by`.
    """

    def __init__(self, names: Iterable[str], package: str = "") -> None:
        self._package = package
        self.data: dict[str, Any] = dict.fromkeys(names)

    def held_by(self, package: str) -> Registry[Entry]:
        """Set the package that holds the modules; return the registry."""
        self._package = package
        return self

    def __getitem__(self, name: str) -> Entry:
        if self.data[name] is None:
            self.data[name] = importlib.import_module(f"{self._package}.{name}")
        module: Entry = self.data[name]
        return module
