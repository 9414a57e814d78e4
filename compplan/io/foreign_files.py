"""Checks that a result replaces no directory and no file that compplan did not write."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from compplan.errors import InputError

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
