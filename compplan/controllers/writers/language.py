"""What the file of a language offers, and which robots it is written for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from compplan.controllers.writers.program import Program
from compplan.errors import InputError


def need_six_axes(program: Program, language: str, *, sliding: int) -> None:
    """Refuse a robot that has not six rotating joints, or more sliding ones than the language takes."""
    slides = int(program.outer.sum())
    if program.moves_part or len(program.joint_names) - slides != 6 or slides > sliding:
        rail = f" and up to {sliding} sliding" if sliding else ""
        own = list(program.joint_names)
        raise InputError(f"{language} programs are written for six rotating{rail} joints, this robot has {own}")


@dataclass(frozen=True)
class MainForm:
    """How a language writes a program that calls others, for jobs of several tools."""

    suffix: str  #: Ending of its files.
    longest: int  #: Letters of its name.
    #: The text, from the name, the program of the first tool (for the head), and the programs to call.
    format: Callable[[str, Program, Sequence[str]], str]
    newline: str = "\r\n"  #: What ends its lines.


class Language(Protocol):
    """What the file of a language offers; MAIN, a `MainForm`, too where it has calls."""

    name: str

    def write(self, program: Program, folder: Path, most: int | None = None) -> list[Path]:
        """Write a program into a folder, at most `most` points in a file (left out: what controllers take).

        Raises:
            InputError: If the robot's joints, or what is known of them, do not fit the language.
        """
