"""Settings of a process: threads of numeric libraries, freed memory."""

from __future__ import annotations

import ctypes
from contextlib import suppress

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
