"""Readers of CAM files, one file a language: they give the toolpath in the part frame, and the facts about the file."""

from __future__ import annotations

from pathlib import Path

from compplan.cam.apt import read_apt
from compplan.cam.gcode import read_gcode
from compplan.cam.moves import CamFacts, CamFile
from compplan.cam.options import CamTable
from compplan.errors import InputError
from compplan.tables import read_text

GCODE_SUFFIXES = (".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".mpf", ".iso", ".eia")
APT_SUFFIXES = (".apt", ".cls", ".cl", ".ncl", ".clsf", ".aptsource", ".cldata")

__all__ = ["CamFacts", "CamFile", "CamTable", "read_cam"]


def read_cam(path: str | Path, options: CamTable | None = None) -> CamFile:
    """Read a CAM file.

    Args:
        path: The file; its suffix says whether it is G-code or APT.
        options: What the file does not say by itself.

    Raises:
        InputError: With file and line, if the file is not what it has to be.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in GCODE_SUFFIXES + APT_SUFFIXES:
        known = " ".join((".csv", *GCODE_SUFFIXES, *APT_SUFFIXES))
        raise InputError(f"unknown kind of toolpath file '{path.suffix}', choose from {known}", file=path)
    text = read_text(path)
    read = read_gcode if suffix in GCODE_SUFFIXES else read_apt
    return read(text, path, options or CamTable())
