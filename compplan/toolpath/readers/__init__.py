"""Readers of CAM files, one module per language, for the toolpath in the part frame and the facts about the file.

Each reader has `name`, the `suffixes` of its files, `recognise(text)`, and `read(text, file, options) -> CamFile`.
`recognise` returns the confidence that the head of a file is in the language: 0 (False) it is not, 1 (True) possible,
2 or more: it has marks of this language alone (BEGIN PGM, %_N_NAME_MPF). The suffix decides between equal confidences.
A new reader is one new file and one line in `READERS`.

Unknown statements that may move the tool raise an InputError with file and line. Functions of the readers raise an
InputError or ValueError without file and line, which the interpreter of the program adds.
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

#: Length of the head of a file from which its language is recognised. [characters]
HEAD_LETTERS = 100_000


_OWN = ("gcode", "apt", "krl", "rapid", "heidenhain", "sinumerik")
#: Readers by the name of their language, which is the name of the module.
READERS: Registry[Any] = Registry[Any](_OWN, __name__)

__all__ = ["READERS", "CamFacts", "CamFile", "CamTable", "find_reader", "list_suffixes", "read_cam", "refuse_idle"]


def list_suffixes() -> list[str]:
    """Return the suffixes of all known CAM files."""
    return [suffix for reader in READERS.values() for suffix in reader.suffixes]


def find_reader(path: Path, text: str) -> Any:
    """Return the reader with the highest confidence for a file; the suffix decides between equals. None if unknown.

    A text that no reader recognises is read by the reader of its suffix.
    """
    head, suffix = text[:HEAD_LETTERS], path.suffix.lower()
    ranks = {name: (int(reader.recognise(head)), suffix in reader.suffixes) for name, reader in READERS.items()}
    best = max(ranks, key=lambda name: ranks[name])
    return READERS[best] if any(ranks[best]) else None


def read_cam(path: str | Path, options: CamTable | None = None) -> CamFile:
    """Read a CAM file; its language is recognised from the text, or from the suffix if the text is ambiguous.

    Raise an InputError with file and line if the file is invalid.
    """
    path = Path(path)
    text = read_bounded(path)
    reader = find_reader(path, text)
    if reader is None:
        known = f"expected {', '.join(READERS)}, or a toolpath table (.csv)"
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
    """Set the feed [mm/s] of cutting moves without feed, or with feed 0, and note their number."""
    path = file.toolpath
    bare = ~path.rapid & (path.feed == 0.0)
    bare[:1] = False
    if not bare.any():
        return file
    note = f"{int(bare.sum())} cutting moves have no feed in the file: {feed_mm_s:g} mm/s is taken (feed_mm_s)"
    notes = (*path.notes, f"{Path(file.facts.file).name}, {note}.")
    toolpath = replace(path, feed=np.where(bare, feed_mm_s * 1e-3, path.feed), notes=notes)
    return replace(file, toolpath=toolpath, facts=replace(file.facts, notes=(*file.facts.notes, note)))


def refuse_idle(cam: CamFile) -> Toolpath:
    """Return the toolpath of a file with a cut; refuse a file without cut, or with skipped drilling cycles only."""
    if cam.facts.cutting_moves or cam.facts.rotary_only_moves or cam.toolpath.cutting_length > 0.0:
        return cam.toolpath
    if cam.facts.cycles:
        message = f"drilling only, {cam.facts.cycles} holes and no other cut; the option cycles = expand cuts them"
        raise InputError(message, file=cam.facts.file)
    message = "nothing to cut: the file has no feed move (rapid and joint moves do not cut)"
    raise InputError(message, file=cam.facts.file)
