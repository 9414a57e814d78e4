"""Readers of CAM files, one file a language: they give the toolpath in the part frame, and the facts about the file.

Each reader offers `name`, the `suffixes` of its files, `recognise(text)` for files with another suffix, and
`read(text, file, options) -> CamFile`. A new reader is one new file and one line in `READERS`.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from compplan.errors import InputError
from compplan.path.cam import apt, gcode, krl, rapid
from compplan.path.cam.lines import read_bounded
from compplan.path.cam.moves import CamFacts, CamFile
from compplan.path.cam.options import CamTable
from compplan.path.toolpath import Toolpath

#: Every reader, by the name of its language.
READERS: dict[str, ModuleType] = {module.name: module for module in (gcode, apt, krl, rapid)}

__all__ = ["READERS", "CamFacts", "CamFile", "CamTable", "list_suffixes", "read_cam", "refuse_idle"]


def list_suffixes() -> list[str]:
    """List the suffixes of CAM files that are known."""
    return [suffix for reader in READERS.values() for suffix in reader.suffixes]


def read_cam(path: str | Path, options: CamTable | None = None) -> CamFile:
    """Read a CAM file.

    Args:
        path: The file; its suffix says what language it is in, or its text where the suffix is unknown.
        options: What the file does not say by itself.

    Raises:
        InputError: With file and line, if the file is not what it has to be.

    """
    path = Path(path)
    text = read_bounded(path)
    by_suffix = (reader for reader in READERS.values() if path.suffix.lower() in reader.suffixes)
    by_text = (reader for reader in READERS.values() if reader.recognise(text))
    reader = next(by_suffix, None) or next(by_text, None)
    if reader is None:
        known = " ".join((".csv", *list_suffixes()))
        raise InputError(f"unknown kind of toolpath file '{path.suffix}', choose from {known}", file=path)
    options = options or CamTable()
    file: CamFile = reader.read(text, path, options)
    notes = file.facts.notes
    if options.strict and notes:
        message = f"{len(notes)} notes, strict allows none; the first: {notes[0]}"
        raise InputError(message, file=path)
    return file


def refuse_idle(cam: CamFile) -> Toolpath:
    """Return the toolpath of a file that cuts something.

    Raises:
        InputError: If it holds drilling alone, or nothing to cut.

    """
    if cam.facts.cutting_moves or cam.facts.rotary_only_moves:
        return cam.toolpath
    if cam.facts.cycles:
        message = f"drilling only, {cam.facts.cycles} holes and no other cut; the option cycles = expand cuts them"
        raise InputError(message, file=cam.facts.file)
    raise InputError("nothing to cut: no move with feed in this file", file=cam.facts.file)
