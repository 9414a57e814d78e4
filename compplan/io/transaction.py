"""Atomic writing of files and result folders.

A file is written beside its place and renamed. A result folder is written beside its place and exchanged with the old
one in one step; the user's own files are linked into both. Where an exchange is impossible (mount point, working
directory, file system without links) the new files are moved one by one; after a crash the next run moves the rest.

`manifest.json` lists which command wrote which file, with its digest. A command removes its own earlier files that the
run does not replace and nobody has changed. Files outside the manifest belong to the user and are kept.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import json
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.provenance import describe_origin, is_input

#: Remedy.
ADVICE = "move it away or name another folder"


def refuse_foreign(
    names: Iterable[str], place: Path, known: Collection[str], shown: Path,
    same: Callable[[str], bool] = lambda name: False,
) -> None:  # fmt: skip
    """Refuse to replace a directory or a file of the user, or to write into a read-only folder.

    Args:
        names: Files of the result, relative to its folder.
        place: The folder, resolved.
        known: Files in it that its manifest lists.
        shown: The folder as the user named it.
        same: Returns whether a file of the result equals the one in its place.

    Raises:
        InputError: With the file in the way; nothing has changed.

    """
    for name in names:
        target, parts = place / name, Path(name).parts
        for depth in range(1, len(parts)):
            above, inside = place.joinpath(*parts[:depth]), shown.joinpath(*parts[:depth])
            if above.is_symlink() or (above.exists() and not above.is_dir()):
                raise InputError(f"is no folder, but the result needs one of this name; {ADVICE}", file=inside)
            if above.is_dir() and not os.access(above, os.W_OK | os.X_OK):
                raise InputError("cannot be written: no permission to write", file=inside)
        if target.is_dir() and not target.is_symlink():
            raise InputError(f"is a folder, but the result is a file of this name; {ADVICE}", file=shown / name)
        if (target.exists() or target.is_symlink()) and name not in known and not same(name):
            message = f"was not written by compplan (it is in no manifest.json) and would be replaced; {ADVICE}"
            raise InputError(message, file=shown / name)


LOG = logging.getLogger(__name__)
MANIFEST = "manifest.json"
#: Endings of hidden files and folders: incomplete; complete and to be moved.
PART, READY = ".part", ".ready"
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
    home = place.parent
    made = [folder for folder in (home, *home.parents) if not folder.exists()]
    with _describe_faults(Path(path)):
        home.mkdir(parents=True, exist_ok=True)
        _clear_leftovers(home, place)
        handle, name = tempfile.mkstemp(dir=home, prefix=f".{place.name}."[:200], suffix=PART)
        part = Path(name)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield part
            part.chmod(0o666 & ~_umask())
            _sync(part)
            part.replace(place)
            _sync(home)
        finally:
            os.close(handle)
            part.unlink(missing_ok=True)
            _remove_empty(made)


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
        home = _home_of(place)
        part = Path(tempfile.mkdtemp(dir=home, prefix=f".{place.name}."[:200], suffix=PART))
        handle = os.open(part, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            yield part
            _refuse_inputs(part, folder)
            names = [MANIFEST, *list_files(part)]
            refuse_foreign(names, place, known_files(place), folder, same=lambda name: _is_same(part, place, name))
            part.chmod(0o777 & ~_umask())
            _write_manifest(part, place, command)
            for path in [*part.rglob("*"), part]:
                _sync(path)
            _put_in_place(part, place, command)
            _sync(place.parent)
            LOG.info("wrote %s", folder)
        except InputError as error:
            file = Path(error.file or "")
            if not file.is_relative_to(part):
                raise
            raise InputError(error.message, file=folder / file.relative_to(part), where=error.where) from None
        finally:
            os.close(handle)
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
    with _describe_faults(folder), ExitStack() as stack:
        made = [path for path in (place, *place.parents) if not path.exists()]
        place.mkdir(parents=True, exist_ok=True)
        handle = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
        stack.callback(os.close, handle)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError("another run of compplan writes into it; wait, or name another", file=folder) from None
        if os.fstat(handle).st_ino != place.stat().st_ino:
            raise InputError("another run of compplan has just written it; run again", file=folder)
        for home in {place.parent, place}:
            _clear_leftovers(home, place)
        _HELD.add(place)
        try:
            yield
        finally:
            _HELD.discard(place)
            _remove_empty(made)


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
    """Refuse an output folder that cannot be made or written to.

    Raises:
        InputError: With the file in the way.

    """
    with _describe_faults(path):
        if path.exists() and not path.is_dir():
            raise InputError("cannot be written: is a file; name a folder", file=path)
        _check_parent(path if path.exists() else path.resolve())


def _check_parent(path: Path) -> None:
    """Refuse a path whose nearest existing parent is no writable folder."""
    there = next(place for place in (path, *path.absolute().parents) if place.is_dir() or place.is_file())
    if there.is_file() and there != path:
        raise InputError(f"cannot be written: {there} is a file", file=path)
    if there.is_dir() and not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"cannot be written: folder {there} no permission to write", file=path)


def check_results(path: Path, names: Iterable[str]) -> None:
    """Refuse a folder in which a directory or a user file has the name of a result.

    Args:
        path: The folder; it may be missing.
        names: Names of results known before the computation.

    Raises:
        InputError: With the file in the way.

    """
    check_folder(path)
    if path.is_dir():
        refuse_foreign([MANIFEST, *names], path.resolve(), known_files(path), path)


def known_files(folder: Path) -> set[str]:
    """Return the files in the manifest of a folder, and the manifest itself."""
    commands = read_manifest(folder)
    names = {name for entry in commands.values() for name in entry["files"]}
    try:
        table = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        table = {}  # damaged: ignored
    foreign = isinstance(table, dict) and table and "commands" not in table
    return names if foreign else {MANIFEST, *names}


def _is_same(part: Path, place: Path, name: str) -> bool:
    """Return whether a new file equals the one in its place."""
    both = (part / name).is_file() and (place / name).is_file()
    return both and digest_file(part / name) == digest_file(place / name)


def _refuse_inputs(part: Path, folder: Path) -> None:
    """Refuse to replace an input of this run."""
    for name in list_files(part):
        if is_input(folder / name):
            raise InputError("is a file that this run reads, name another folder to write", file=folder / name)


def list_files(folder: Path) -> list[str]:
    """List the files of a folder, relative to it, without the manifest."""
    names = [str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()]
    return sorted(name for name in names if name != MANIFEST)


def digest_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def _describe_faults(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", file=path) from None


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove empty folders, innermost first."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


def _sync(path: Path) -> None:
    """Flush a file or folder to the disk, if supported."""
    handle = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)


def _home_of(place: Path) -> Path:
    """Return a writable folder on the same file system for temporary files."""
    inside = os.path.ismount(place) or not os.access(place.parent, os.W_OK)
    return place if inside else place.parent


def _clear_leftovers(home: Path, place: Path) -> None:
    """Move the complete files of a crashed run to their place and remove the others."""
    if not home.is_dir():
        return
    for path in [p for p in home.iterdir() if p.name.startswith(f".{place.name}."[:200])]:
        if path.suffix not in (PART, READY) or path.is_symlink() or not _is_abandoned(path):
            continue
        if path.suffix == READY:
            _move_over(path, place)
        elif path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def clear_parts(folder: Path) -> None:
    """Remove incomplete files that crashed runs left in a folder."""
    for path in folder.glob(f".*{PART}"):
        if path.is_file() and not path.is_symlink() and _is_abandoned(path):
            path.unlink(missing_ok=True)


def _is_abandoned(path: Path) -> bool:
    """Return whether no living process owns a temporary file or folder."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(handle)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a folder by command; empty if missing or invalid."""
    try:
        table = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        commands = table["commands"]
        return {str(name): entry for name, entry in commands.items() if isinstance(entry["files"], dict)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def _write_manifest(part: Path, place: Path, command: str) -> None:
    """Write the manifest of a new result and keep entries of other commands."""
    own = {name: digest_file(part / name) for name in list_files(part)}
    commands: dict[str, Any] = {}
    for name, entry in read_manifest(place).items():
        files = {file: digest for file, digest in entry["files"].items() if file not in own}
        if name != command and files:
            commands[name] = {**entry, "files": files}
    commands[command] = {"made_by": describe_origin(), "files": own}
    table = {"schema": 1, "commands": dict(sorted(commands.items()))}
    (part / MANIFEST).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def _stale_files(place: Path, manifest: Mapping[str, Any], command: str, new: set[str]) -> list[Path]:
    """List unchanged files of the last run that the command does not replace."""
    stale = []
    for name, digest in manifest.get(command, {"files": {}})["files"].items():
        path = place / name
        inside = not Path(name).is_absolute() and ".." not in Path(name).parts
        if inside and name not in new and path.is_file() and digest_file(path) == digest:
            stale.append(path)
    return stale


def _put_in_place(part: Path, place: Path, command: str) -> None:
    """Replace the old result by a complete one, in one step if possible."""
    if part.parent == place.parent and not Path.cwd().is_relative_to(place):
        stale = {str(path) for path in _stale_files(place, read_manifest(place), command, set(list_files(part)))}
        if _link_rest(place, part, stale) and _exchange(part, place):
            return
    ready = part.with_suffix(READY)
    part.rename(ready)
    _move_over(ready, place)


def _link_rest(place: Path, part: Path, stale: set[str]) -> bool:
    """Link the kept files of the old folder into the new one; return whether all were linked."""
    try:
        for path in sorted(place.rglob("*")):
            target = part / path.relative_to(place)
            if path.is_dir() and not path.is_symlink():
                if not target.is_dir() and (not any(path.iterdir()) or not _only_stale(path, stale)):
                    target.mkdir()
                    shutil.copystat(path, target)
            elif str(path) not in stale and not target.exists():
                os.link(path, target, follow_symlinks=False)
    except OSError:
        return False
    return True


def _only_stale(folder: Path, stale: set[str]) -> bool:
    """Return whether a folder holds stale files only."""
    return all(str(path) in stale for path in folder.rglob("*") if not path.is_dir())


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step (Linux renameat2); return whether it worked."""
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "renameat2"):
        return False
    here, exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    return bool(library.renameat2(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0)


def _move_over(ready: Path, place: Path) -> None:
    """Move the files of a complete result to their place, the manifest last; restartable."""
    commands, old = read_manifest(ready), read_manifest(place)
    place.mkdir(parents=True, exist_ok=True)
    for name in list_files(ready):
        target = place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (ready / name).replace(target)
    for command, entry in commands.items():
        if command in old:
            for path in _stale_files(place, old, command, set(entry["files"])):
                path.unlink()
                with suppress(OSError):
                    path.parent.rmdir()
    (ready / MANIFEST).replace(place / MANIFEST)
    shutil.rmtree(ready, ignore_errors=True)
