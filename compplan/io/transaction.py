"""Atomic writing of files and result folders.

A file is written in the folder of its target and renamed. A result folder is written to a hidden folder inside it; when
complete, its files are moved to their places one by one, the manifest last. After a crash in between, the next run
moves the rest.

`manifest.json` lists which command wrote which file, with its digest. A command removes its earlier files that the
run does not replace, if they are unchanged. Files outside the manifest belong to the user and are kept.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

from compplan.errors import InputError
from compplan.io.provenance import HIDDEN, describe_origin, is_input

LOG = logging.getLogger(__name__)
MANIFEST = "manifest.json"
#: Suffixes of hidden files and folders: incomplete; complete and to be moved. Prefix of hidden folders.
PART, READY = ".part", ".ready"
#: Remedy.
ADVICE = "move it away or name another folder"
#: Folders locked by this process.
_HELD: set[Path] = set()


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path and rename it to `path` at the end; on an exception it is removed.

    Raises:
        InputError: If the file cannot be written.
    """
    check_file(Path(path))
    place = Path(path).resolve()
    part = place.parent / f".{place.name[:200]}.{uuid4().hex[:8]}{PART}"
    with _describe_faults(Path(path)), _make_folder(place.parent):
        try:
            yield part
            _sync(part)
            part.replace(place)
            _sync(place.parent)
        finally:
            part.unlink(missing_ok=True)


@contextmanager
def replace_folder(folder: str | Path, command: str) -> Iterator[Path]:
    """Yield a temporary folder; at the end its files replace those of the last run in `folder`.

    Args:
        folder: The folder; made if needed. Files in it that the command did not write stay.
        command: Name of the command, for the manifest.

    Raises:
        InputError: If the folder cannot be written, or another run is writing into it; nothing has changed then.
    """
    folder = Path(folder)
    check_folder(folder)
    place = folder.resolve()
    with _describe_faults(folder), lock_folder(folder):
        part = place / f"{HIDDEN}{uuid4().hex[:8]}{PART}"
        part.mkdir()
        try:
            yield part
            names = list_files(part)
            for name in names:
                if is_input(place / name):
                    raise InputError("is a file that this run reads, name another folder to write", file=folder / name)
            _refuse_foreign([MANIFEST, *names], place, folder)
            _write_manifest(part, place, command)
            for path in [*part.rglob("*"), part]:
                _sync(path)
            ready = part.with_suffix(READY)
            part.rename(ready)
            _move_over(ready, place)
            _sync(place)
            LOG.info("wrote %s", folder)
        except InputError as error:
            file = Path(error.file or "")
            if not file.is_relative_to(part):
                raise
            raise InputError(error.message, file=folder / file.relative_to(part), where=error.where) from None
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def lock_folder(folder: str | Path) -> Iterator[None]:
    """Lock a folder, finish or clear files of crashed runs, and remove it at the end if empty.

    Raises:
        InputError: If the folder cannot be made, or another run writes into it.
    """
    folder = Path(folder)
    place = folder.resolve()
    if place in _HELD:
        yield
        return
    with _describe_faults(folder), _make_folder(place):
        handle = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                message = "another run of compplan writes into it; wait, or name another"
                raise InputError(message, file=folder) from None
            for ready in place.glob(f"{HIDDEN}*{READY}"):
                _move_over(ready, place)
            for part in place.glob(f"{HIDDEN}*{PART}"):
                shutil.rmtree(part, ignore_errors=True)
            _HELD.add(place)
            yield
        finally:
            _HELD.discard(place)
            os.close(handle)


def check_file(path: Path) -> None:
    """Refuse an output file that is a folder, a device, an input of this run, or not writable.

    Raises:
        InputError: With the file in the way.
    """
    with _describe_faults(path):
        if path.is_dir():
            raise InputError("cannot be written: is a folder, name a file", file=path)
        if path.exists() and not path.is_file():
            raise InputError("cannot be written: is a device or a pipe, name a file", file=path)
        if is_input(path):
            raise InputError("is a file that this run reads, name another one to write", file=path)
        _check_parent(path)


def check_folder(path: Path) -> None:
    """Refuse a folder that cannot be made or written to, or whose manifest another program wrote.

    Raises:
        InputError: With the file in the way.
    """
    with _describe_faults(path):
        if path.exists() and not path.is_dir():
            raise InputError("cannot be written: is a file; name a folder", file=path)
        _check_parent(path if path.exists() else path.resolve())
        _refuse_foreign([MANIFEST], path.resolve(), path)


def _check_parent(path: Path) -> None:
    """Refuse a path whose nearest existing parent is not a writable folder."""
    there = next(place for place in (path, *path.absolute().parents) if place.is_dir() or place.is_file())
    if there.is_file() and there != path:
        raise InputError(f"cannot be written: {there} is a file", file=path)
    if there.is_dir() and not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"cannot be written: no permission to write into {there}", file=path)


def _refuse_foreign(names: Iterable[str], place: Path, shown: Path) -> None:
    """Refuse to replace a folder or a file that no manifest lists, or to write into a read-only folder.

    Args:
        names: Files of the result, relative to its folder.
        place: The folder, resolved.
        shown: The folder as the user named it.
    """
    commands = read_manifest(place)
    known = {name for entry in commands.values() for name in entry["files"]} | ({MANIFEST} if commands else set())
    for name in names:
        target = place / name
        for parent in Path(name).parents[:-1]:
            above = place / parent
            if above.is_symlink() or (above.exists() and not above.is_dir()):
                message = f"is not a folder, but the result needs one of this name; {ADVICE}"
                raise InputError(message, file=shown / parent)
            if above.is_dir() and not os.access(above, os.W_OK | os.X_OK):
                raise InputError("cannot be written: no permission to write", file=shown / parent)
        if target.is_dir() and not target.is_symlink():
            raise InputError(f"is a folder, but the result is a file of this name; {ADVICE}", file=shown / name)
        if (target.exists() or target.is_symlink()) and name not in known:
            message = f"was not written by compplan (no manifest.json names it) and would be replaced; {ADVICE}"
            raise InputError(message, file=shown / name)


def list_files(folder: Path) -> list[str]:
    """List the files of a folder, relative to it, without the manifest."""
    names = [str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()]
    return sorted(name for name in names if name != MANIFEST)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a folder by command; empty if missing or invalid."""
    try:
        commands = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["commands"]
        return {str(name): entry for name, entry in commands.items() if isinstance(entry["files"], dict)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def _write_manifest(part: Path, place: Path, command: str) -> None:
    """Write the manifest of a new result and keep entries of other commands."""
    own = {name: _digest(part / name) for name in list_files(part)}
    commands: dict[str, Any] = {}
    for name, entry in read_manifest(place).items():
        files = {file: digest for file, digest in entry["files"].items() if file not in own}
        if name != command and files:
            commands[name] = {**entry, "files": files}
    commands[command] = {"made_by": describe_origin(), "files": own}
    table = {"schema": 1, "commands": dict(sorted(commands.items()))}
    (part / MANIFEST).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def _move_over(ready: Path, place: Path) -> None:
    """Move the files of a complete result to their place, the manifest last; restartable.

    Files of earlier runs of its commands that are not replaced are removed, if they are unchanged.
    """
    new, old = read_manifest(ready), read_manifest(place)
    for name in list_files(ready):
        target = place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (ready / name).replace(target)
    earlier = {name: digest for command in new for name, digest in old.get(command, {"files": {}})["files"].items()}
    for name in earlier.keys() - {name for entry in new.values() for name in entry["files"]}:
        path, inside = place / name, not Path(name).is_absolute() and ".." not in Path(name).parts
        if inside and path.is_file() and _digest(path) == earlier[name]:
            path.unlink()
            with suppress(OSError):
                path.parent.rmdir()
    if new:
        (ready / MANIFEST).replace(place / MANIFEST)
    shutil.rmtree(ready, ignore_errors=True)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def _describe_faults(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", file=path) from None


@contextmanager
def _make_folder(place: Path) -> Iterator[None]:
    """Make a folder with its parents; at the end those that are new and empty are removed."""
    made = [path for path in (place, *place.parents) if not path.exists()]
    try:
        place.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def _sync(path: Path) -> None:
    """Flush a file or folder to the disk, if supported."""
    handle = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)
