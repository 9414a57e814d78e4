"""Readers of CAM files, one file a language: they give the toolpath in the part frame, and the facts about the file.

Each reader offers `name`, the `suffixes` of its files, `recognise(text)`, and `read(text, file, options) -> CamFile`.
`recognise` gets the head of a file and says how surely it is of that language: 0 (or False) not, 1 (True) it may be,
2 it has marks that no other language has (BEGIN PGM, %_N_NAME_MPF). The suffix only decides between equals.
A new reader is one new file and one line in `READERS`.

What a reader does not know and may move the tool is refused: an InputError with file and line. Functions of the readers
raise it, or a ValueError, without them; whoever follows the program adds them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.io.registry import Registry
from compplan.toolpath.readers.lines import read_bounded
from compplan.toolpath.readers.moves import CamFacts, CamFile
from compplan.toolpath.readers.options import CamTable, use_machine
from compplan.toolpath.toolpath import Toolpath

#: Letters of the head of a file by which its language is known.
HEAD_LETTERS = 100_000


_OWN = ("gcode", "apt", "krl", "rapid", "heidenhain", "sinumerik")
#: Every reader, by the name of its language, which is that of its module.
READERS: Registry[Any] = Registry[Any](_OWN, __name__)

__all__ = ["READERS", "CamFacts", "CamFile", "CamTable", "find_reader", "list_suffixes", "read_cam", "refuse_idle"]


def list_suffixes() -> list[str]:
    """List the suffixes of CAM files that are known."""
    return [suffix for reader in READERS.values() for suffix in reader.suffixes]


def find_reader(path: Path, text: str) -> Any:
    """Return the reader of a file: that whose language the text is most surely in, its suffix between equals; or None.

    A text that no reader recognises goes to the reader of its suffix.
    """
    head, suffix = text[:HEAD_LETTERS], path.suffix.lower()
    ranks = {name: (int(reader.recognise(head)), suffix in reader.suffixes) for name, reader in READERS.items()}
    best = max(ranks, key=lambda name: ranks[name])
    return READERS[best] if any(ranks[best]) else None


def read_cam(path: str | Path, options: CamTable | None = None) -> CamFile:
    """Read a CAM file: its text says what language it is in, and its suffix where the text leaves it open.

    An InputError with file and line says what is not as it has to be.
    """
    path = Path(path)
    text = read_bounded(path)
    reader = find_reader(path, text)
    if reader is None:
        known = f"read are {', '.join(READERS)} files, and toolpath tables (.csv)"
        raise InputError(f"no CAM language is recognised in this file, nor by its ending {path.suffix!r}; {known}",
                         file=path)  # fmt: skip
    options = use_machine(options or CamTable(), path)
    file: CamFile = reader.read(text, path, options)
    if options.feed_mm_s is not None:
        file = set_missing_feed(file, options.feed_mm_s)
    notes = file.facts.notes
    if options.strict and notes:
        message = f"{len(notes)} notes, strict allows none; the first: {notes[0]}"
        raise InputError(message, file=path)
    return file


def set_missing_feed(file: CamFile, feed_mm_s: float) -> CamFile:
    """Give a feed [mm/s] to the cutting moves for which a file states none, or 0; a note says how many."""
    path = file.toolpath
    bare = ~path.rapid & (path.feed == 0.0)
    bare[:1] = False
    if not bare.any():
        return file
    note = f"{int(bare.sum())} cutting moves have no feed in the file: {feed_mm_s:g} mm/s is taken (feed_mm_s)"
    told = (*path.notes, f"{Path(file.facts.file).name}, {note}.")
    toolpath = replace(path, feed=np.where(bare, feed_mm_s * 1e-3, path.feed), notes=told)
    return replace(file, toolpath=toolpath, facts=replace(file.facts, notes=(*file.facts.notes, note)))


def refuse_idle(cam: CamFile) -> Toolpath:
    """Return the toolpath of a file that cuts something; refuse one that cuts nothing, or drills holes alone."""
    if cam.facts.cutting_moves or cam.facts.rotary_only_moves or cam.toolpath.cutting_length > 0.0:
        return cam.toolpath
    if cam.facts.cycles:
        message = f"drilling only, {cam.facts.cycles} holes and no other cut; the option cycles = expand cuts them"
        raise InputError(message, file=cam.facts.file)
    message = "nothing to cut: the file has no feed move (rapid and joint moves do not cut)"
    raise InputError(message, file=cam.facts.file)
