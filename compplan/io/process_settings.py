"""Settings of a process: threads of numeric libraries, freed memory, lazy imports of heavy, rarely used modules."""

from __future__ import annotations

import ctypes
import importlib
import sys
from contextlib import suppress
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

#: Environment variables with the number of threads of numeric libraries, read at their import.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Options of glibc's mallopt [byte]: freed memory that is kept (M_TRIM_THRESHOLD), size of arrays allocated from it
#: (M_MMAP_THRESHOLD). A plan of 50,000 waypoints requests half as many pages, and needs 2 s less of CPU.
KEPT_MEMORY = {-1: 256 * 2**20, -3: 32 * 2**20}


def keep_freed_memory() -> None:
    """Let this process keep freed memory for its next arrays; without effect on other C libraries than glibc."""
    with suppress(AttributeError, TypeError):
        for option, size in KEPT_MEMORY.items():
            ctypes.CDLL(None).mallopt(option, size)


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
