"""Lazy imports of heavy, rarely used modules."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

#: Modules that the command line imports on first use, parents before their children.
SELDOM_USED = ("matplotlib", "matplotlib.pyplot", "numpy.f2py", "numpy.polynomial", "numpy.testing")


class _Later(ModuleType):
    """Placeholder of a module that is imported at the first access to an attribute."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def put_off(names: tuple[str, ...] = SELDOM_USED) -> None:
    """Defer the import of modules to their first use.

    Args:
        names: Their names, parents before their children.

    """
    for name in names:
        if name in sys.modules:
            continue
        parent, _, child = name.rpartition(".")
        later = _Later(name)
        later.__spec__ = ModuleSpec(name, None)
        sys.modules[name] = later
        if parent:  # an import reads the attribute of the parent first
            setattr(sys.modules.get(parent) or importlib.import_module(parent), child, later)
