"""What a command writes to: refused before anything is computed, where it cannot be written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from compplan.errors import InputError
from compplan.files.transaction import check_file, check_folder


class Place(click.Path):
    """Path of a result; an option of this type is looked at when the command line is read."""

    def __init__(self, check: Callable[[Path], None], suffix: str = "") -> None:
        super().__init__(path_type=Path)
        self.check, self.suffix = check, suffix

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path.

        Raises:
            InputError: If nothing can be written there.

        """
        path = Path(str(super().convert(value, param, ctx)))  # type: ignore[arg-type]
        self.check(path)
        if self.suffix and path.exists() and path.suffix != self.suffix:
            raise InputError(f"is there and no {self.suffix} file, name another one to write", file=path)
        return path


OUT_FOLDER, OUT_FILE, OUT_TABLE = Place(check_folder), Place(check_file), Place(check_file, ".csv")
