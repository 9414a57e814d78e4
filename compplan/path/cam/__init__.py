"""Readers of CAM files, one file a language: they give the toolpath in the part frame, and the facts about the file."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.errors import InputError
from compplan.files.tables import read_text
from compplan.path.cam.apt import read_apt
from compplan.path.cam.gcode import read_gcode
from compplan.path.cam.moves import CamFacts, CamFile
from compplan.path.cam.options import CamTable

GCODE_SUFFIXES = (".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".mpf", ".spf", ".iso", ".eia", ".h")
APT_SUFFIXES = (".apt", ".cls", ".cl", ".ncl", ".clsf", ".aptsource", ".cldata")

__all__ = ["CamFacts", "CamFile", "CamTable", "read_cam"]


def read_cam(path: str | Path, options: CamTable | None = None) -> CamFile:
    """Read a CAM file.

    Args:
        path: The file; its suffix says whether it is G-code or APT, or its text where the suffix is unknown.
        options: What the file does not say by itself.

    Raises:
        InputError: With file and line, if the file is not what it has to be.

    """
    path = Path(path)
    suffix = path.suffix.lower()
    text = read_text(path)
    is_apt, is_gcode = suffix in APT_SUFFIXES, suffix in GCODE_SUFFIXES
    if not (is_apt or is_gcode):
        is_apt = re.search(r"^\s*GOTO\s*/", text, re.MULTILINE) is not None
        is_gcode = re.search(r"^\s*(N\d+\s*)?G\d", text, re.MULTILINE | re.IGNORECASE) is not None
    if not (is_apt or is_gcode):
        known = " ".join((".csv", *GCODE_SUFFIXES, *APT_SUFFIXES))
        raise InputError(f"unknown kind of toolpath file '{path.suffix}', choose from {known}", file=path)
    read = read_apt if is_apt else read_gcode
    return read(text, path, options or CamTable())
