"""Provenance of a result: version, commit, seeds and the digest of every input file."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from compplan.version import VERSION

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
    if read is not None:
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
    """Return version, commit (of a checkout), seeds and the digest of every file read so far."""
    origin: dict[str, Any] = {"compplan": VERSION}
    if commit := find_commit():
        origin["commit"] = commit
    if seeds := _SEEDS.get():
        origin["seeds"] = dict(seeds)
    if read := _READ.get():
        origin["inputs_sha256"] = dict(sorted(read.items()))
    return origin


def find_commit() -> str | None:
    """Return the commit of the checkout that holds the package, or None."""
    git = Path(__file__).resolve().parents[2] / ".git"
    with suppress(OSError, IndexError):
        if git.is_file():  # a further work tree
            git = (git.parent / git.read_text(encoding="utf-8").split(":", 1)[1].strip()).resolve()
        head = (git / "HEAD").read_text(encoding="utf-8").strip()
        if not head.startswith("ref: "):
            return head
        common = git / "commondir"
        store = (git / common.read_text(encoding="utf-8").strip()).resolve() if common.is_file() else git
        name = head.removeprefix("ref: ")
        if (store / name).is_file():
            return (store / name).read_text(encoding="utf-8").strip()
        for line in (store / "packed-refs").read_text(encoding="utf-8").splitlines():
            if line.endswith(" " + name):
                return line.split()[0]
    return None
