"""What a command writes to: refused before anything is computed, where it cannot be written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from compplan.files.transaction import check_file, check_folder


class Place(click.Path):
    """Path of a result; an option of this type is looked at when the command line is read."""

    def __init__(self, check: Callable[[Path], None]) -> None:
        super().__init__(path_type=Path)
        self.check = check

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path.

        Raises:
            InputError: If nothing can be written there.

        """
        path = Path(str(super().convert(value, param, ctx)))  # type: ignore[arg-type]
        self.check(path)
        return path


OUT_FOLDER, OUT_FILE = Place(check_folder), Place(check_file)
