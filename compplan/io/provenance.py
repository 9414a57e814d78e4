"""Provenance of a result: version, seeds and the digest of every input file."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from compplan.version import VERSION

#: Prefix of a folder in which a result is written; what is read back from there is no input.
HIDDEN = ".compplan."
LOG = logging.getLogger(__name__)
_READ: ContextVar[dict[str, str] | None] = ContextVar("read", default=None)
_SEEDS: ContextVar[dict[str, int] | None] = ContextVar("seeds", default=None)


@contextmanager
def record_inputs() -> Iterator[None]:
    """Record the digest of every file read from now on, for `describe_origin`."""
    tokens = _READ.set({}), _SEEDS.set({})
    try:
        yield
    finally:
        _READ.reset(tokens[0])
        _SEEDS.reset(tokens[1])


def note_input(path: Path, content: bytes) -> None:
    """Record that a file was read."""
    LOG.debug("read %s, %d bytes", path, len(content))
    read = _READ.get()
    if read is not None and not any(part.startswith(HIDDEN) for part in path.parts):
        read[str(path)] = hashlib.sha256(content).hexdigest()


def is_input(path: Path) -> bool:
    """Return whether a file was read since `record_inputs`."""
    return any(Path(name).resolve() == path.resolve() for name in _READ.get() or ())


def note_seed(name: str, seed: int) -> None:
    """Record a random seed."""
    seeds = _SEEDS.get()
    if seeds is not None:
        seeds[name] = seed


def describe_origin() -> dict[str, Any]:
    """Return version, seeds and the digest of every file read so far."""
    origin: dict[str, Any] = {"compplan": VERSION}
    if seeds := _SEEDS.get():
        origin["seeds"] = dict(seeds)
    if read := _READ.get():
        origin["inputs_sha256"] = dict(sorted(read.items()))
    return origin
