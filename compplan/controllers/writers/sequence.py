"""The main program of a job of several tools: it calls the programs of each in order, where the language has calls."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from compplan.controllers.writers import WRITERS
from compplan.controllers.writers.program import Program
from compplan.controllers.writers.text import legal_name
from compplan.io.tables import write_text

#: Letters that a main program adds to the name of the job: _ALL, and _L for linear moves.
ADDED = 6
#: What the name of a main program ends in.
WHOLE = re.compile(r"_ALL(_[JL])?$", re.IGNORECASE)
#: Endings of names that say how a program moves: the joints, or the tool.
KINDS = re.compile(r"_[JjLl]$")


def write_sequence(
    program: Program, language: str, name: str, groups: Sequence[Sequence[Path]], folder: Path
) -> list[Path]:
    """Write the main program of a job of several tools in a language, one for joint moves and one for linear ones.

    `groups` are the files that were written for each tool, in the order in which they run. Nothing is written where the
    language has no calls of other programs.
    """
    main = getattr(WRITERS[language], "MAIN", None)
    if main is None or len(groups) < 2:
        return []
    entries = [_find_entries([file for file in files if file.suffix == main.suffix]) for files in groups]
    files = []
    for kind in entries[0]:
        if all(kind in entry for entry in entries):
            calls = [entry[kind] for entry in entries]
            whole = f"{legal_name(name, main.longest - ADDED)}_ALL{kind}"
            upper, lower = calls[0].isupper(), calls[0].islower()
            whole = whole.upper() if upper else whole.lower() if lower else whole
            files.append(folder / f"{whole}{main.suffix}")
            write_text(files[-1], main.format(whole, program, calls), newline=main.newline)
    return files


def _find_entries(files: Sequence[Path]) -> dict[str, str]:
    """Return the programs of a tool that are no part of another one, by the ending that says how they move."""
    stems = [file.stem for file in files]
    parts = {stem for stem in stems for whole in stems if re.fullmatch(rf"{re.escape(whole)}_?\d+", stem)}
    return {found.group() if (found := KINDS.search(stem)) else "": stem for stem in stems if stem not in parts}
