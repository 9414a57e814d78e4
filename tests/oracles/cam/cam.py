"""A CAM file read a second time: which language it is, and its moves."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles.cam.apt import read_apt
from tests.oracles.cam.gcode import GCode
from tests.oracles.cam.heidenhain import read_heidenhain
from tests.oracles.cam.krl import read_krl_path
from tests.oracles.cam.machine import DrivenMachine
from tests.oracles.cam.moves import RAPID, CannotTellError, Reading
from tests.oracles.cam.rapid import read_rapid_path
from tests.oracles.cam.sinumerik import read_sinumerik_program

#: Languages besides G-code, by what stands in their files, and by endings.
OTHERS = {
    "Heidenhain": re.compile(r"^\s*\d*\s*BEGIN PGM\b", re.M),
    "APT": re.compile(r"^\s*(?:GOTO\s*/|PARTNO|TOOL PATH\s*/|\$\$)", re.M),
    "Sinumerik": re.compile(
        r"^[^;(#]*(?:\b[XYZIJKR]\d*=|\bMCALL\b|\bCYCLE\d+|\bSUPA\b|\bTRAORI\b|\bA?TRANS\b|\bA?ROT\b)", re.M
    ),
    "KRL": re.compile(r"^\s*(?:DEF\s+\w+\s*\(|(?:PTP|LIN)\s)", re.M),
    "RAPID": re.compile(r"^\s*(?:MODULE\s|Move[LJC]\s|MoveAbsJ\s)", re.M),
}
ENDINGS = {
    "Sinumerik": (".mpf", ".spf", ".arc"), "Heidenhain": (".h",), "APT": (".apt", ".cls", ".cl", ".aptsource", ".ncl"),
    "KRL": (".src",), "RAPID": (".mod",),
}  # fmt: skip
_PRINTER = re.compile(r"^\s*M(?:104|109|140|190)\b", re.M)


def read_moves(file: Path, options: dict[str, Any] | None = None) -> Reading:
    """Read the moves of a CAM file.

    Args:
        file: The file.
        options: The table [cam] of a job as it stands in the file.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    options = options or {}
    text = file.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff")
    reading = read_language(find_language(text, file.suffix.lower()), text, options, file)
    return reading if options.get("operation") is None else pick_operation(reading, options["operation"])


def find_language(text: str, ending: str) -> str:
    """Tell which language a file is written in: its text says so, else its ending; G-code otherwise."""
    marked = [language for language, mark in OTHERS.items() if mark.search(text)]
    ended = [language for language, endings in ENDINGS.items() if ending in endings]
    return [*marked, *ended, "G-code"][0]


def read_language(language: str, text: str, options: dict[str, Any], file: Path | None = None) -> Reading:
    """Read a file in a language.

    Args:
        language: A key of `OTHERS`, or "G-code".
        text: The file.
        options: The table [cam] of a job as it stands in the file.
        file: Where it stands, None in memory.

    Raises:
        CannotTellError: If something in it is not known here.

    """
    expand, start = options.get("cycles", "expand") == "expand", options.get("from_mm")
    if language == "G-code":
        return read_gcode(text, options)
    if language == "APT":
        return read_apt(text, unit=options.get("unit"), sense=options.get("circle_sense", "auto"), expand=expand,
                        start=start)  # fmt: skip
    if language == "Heidenhain":
        return read_heidenhain(text, expand=expand, rotary=options.get("rotary"), start=start)
    if language == "Sinumerik":
        return read_sinumerik_program(text, expand=expand, start=start)
    points = options.get("tool_direction")
    if language == "RAPID":
        return read_rapid_path(text, points=points, start=start)
    folder, name = (None, "") if file is None else (file.parent, file.stem)
    return read_krl_path(text, folder=folder, name=name, points=points, start=start)


def pick_operation(reading: Reading, number: int) -> Reading:
    """Return what the file cuts between two tool changes, counted from 1; calls that cut nothing do not count.

    Raises:
        CannotTellError: If there is no such stretch.

    """
    edges = [0, *(np.flatnonzero(np.diff(reading.tool)) + 1).tolist(), len(reading)]
    runs: list[list[int]] = []
    for first, after in pairwise(edges):
        if not (reading.kind[first:after] != RAPID).any():
            continue
        if runs and reading.tool[runs[-1][0]] == reading.tool[first]:
            runs[-1][1] = after
        else:
            runs.append([first, after])
    if number > len(runs):
        raise CannotTellError(f"operation {number} of {len(runs)}")
    first, after = runs[number - 1]
    if reading.kind[first] != RAPID and first > 0:
        first -= 1  # the cut begins where the tool before ended
    rows = slice(first, after)
    taken = {item.name: getattr(reading, item.name)[rows].copy() for item in fields(reading) if item.name != "notes"}
    taken["kind"][0], taken["feed"][0] = RAPID, 0.0
    return replace(reading, **taken)


def read_gcode(text: str, options: dict[str, Any]) -> Reading:
    """Read G-code."""
    printer = bool(_PRINTER.search(text))
    reader = GCode(
        inch=options.get("unit") == "inch", centres=options.get("arc_centres") or "incremental",
        expand=options.get("cycles", "expand") == "expand", rotary=options.get("rotary"),
        rotary_axes=options.get("rotary_axes"), tracking=bool(options.get("tip_control")), wcs=options.get("wcs"),
        printer=printer, machine=DrivenMachine(start=None if printer else options.get("from_mm")),
    )  # fmt: skip
    try:
        return reader.run(text)
    except (ValueError, OverflowError) as error:
        raise CannotTellError(f"{error}") from None
