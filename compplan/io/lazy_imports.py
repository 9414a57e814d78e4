"""Modules that others ask for and seldom use, loaded when something of theirs is used at all."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

#: What a command line loads when it is used, parents before their children: pyplot for pictures alone;
#: scipy.sparse looks at every part of numpy, the reader of Fortran and the tests too.
SELDOM_USED = ("matplotlib", "matplotlib.pyplot", "numpy.f2py", "numpy.testing")


class _Later(ModuleType):
    """Stand for a module until an attribute of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def put_off(names: tuple[str, ...] = SELDOM_USED) -> None:
    """Let modules that are not loaded yet be loaded when they are first used.

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
        if parent:  # its attribute is what an import looks at first
            setattr(sys.modules.get(parent) or importlib.import_module(parent), child, later)
