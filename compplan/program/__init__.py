"""Native robot programs, one file a language."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from compplan.errors import UnknownNameError
from compplan.program.fanuc_ls import write_fanuc_ls
from compplan.program.inform import write_inform
from compplan.program.joint_csv import write_joint_csv
from compplan.program.kawasaki_as import write_kawasaki_as
from compplan.program.krl import write_krl
from compplan.program.program import Program, build_program
from compplan.program.rapid import write_rapid
from compplan.program.sinumerik import write_sinumerik
from compplan.program.urscript import write_urscript
from compplan.program.val3 import write_val3

#: Writer of each language: (program, folder, greatest number of points in a file or None) -> files written.
WRITERS: dict[str, Callable[[Program, Path, int | None], list[Path]]] = {
    "krl": write_krl,
    "val3": write_val3,
    "fanuc_ls": write_fanuc_ls,
    "rapid": write_rapid,
    "urscript": write_urscript,
    "sinumerik": write_sinumerik,
    "inform": write_inform,
    "kawasaki_as": write_kawasaki_as,
    "csv": write_joint_csv,
}

__all__ = ["WRITERS", "Program", "build_program", "write_program"]


def write_program(program: Program, language: str, folder: str | Path, *, most: int | None = None) -> list[Path]:
    """Write a program in a controller's language.

    Args:
        program: The program.
        language: One of `WRITERS`.
        folder: Folder to write to; made if needed.
        most: Greatest number of points in a file; left out: what the controller takes.

    Returns:
        The files written.

    Raises:
        UnknownNameError: If there is no such language.
        InputError: If the program does not fit the language, or the folder cannot be written.

    """
    if language not in WRITERS:
        raise UnknownNameError("program language", language, list(WRITERS))
    return WRITERS[language](program, Path(folder), most)
