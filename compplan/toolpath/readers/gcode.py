"""G-code (RS-274, ISO 6983) of milling dialects: Fanuc, Haas, LinuxCNC, printers."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.toolpath.readers.cnc.course import OffCircleError
from compplan.toolpath.readers.cnc.rs274 import Rs274
from compplan.toolpath.readers.cnc.state import INCH, State
from compplan.toolpath.readers.lines import split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable

CENTRE_READINGS = ("incremental", "absolute", "reversed")
#: Different arcs that must fit another reading of I J K, and not the usual one, before it is taken.
FEWEST_PROOFS = 2
#: Beginning of a block that holds a G code.
BEGINNING = re.compile(
    r"^[ \t]*(/\d?[ \t]*)?([A-FH-Z:][ \t]*[-+]?[\d.]+[ \t]*){0,9}G[ \t]*\d", re.MULTILINE | re.IGNORECASE
)
#: A tool change code.
CHANGE = re.compile(r"M0*6(?!\d)", re.IGNORECASE)

#: Temperatures of hot end and bed: files of printers have them; their lengths are millimetres, E is the extruder.
PRINTER = re.compile(
    r"^[ \t]*(?:N\d+[ \t]*)?M(?:104|109|140|190)[ \t]*(?:T\d+[ \t]*)?[SR][ \t]*\d", re.MULTILINE | re.IGNORECASE
)

name = "gcode"
suffixes = (
    ".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".iso", ".eia", ".h", ".ptp", ".min", ".gc", ".g",
    ".fnc", ".dnc", ".din", ".pim", ".anc",
)  # fmt: skip


def recognise(text: str) -> bool:
    """Tell whether a text is G-code: one of its lines begins with words, a G code among them."""
    return BEGINNING.search(text) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read G-code.

    I J K count from the start of an arc. Where that leaves arcs off their circles, another reading is taken if every
    arc of the file then lies on its circle and at least two different ones prove it: a full circle fits any reading.
    """
    first_fault: OffCircleError | None = None
    lines = split_lines(text)
    changes_by_t, printer = CHANGE.search(text) is None, PRINTER.search(text) is not None
    for reading in CENTRE_READINGS:
        scale = INCH if options.unit == "inch" else 1.0
        state = State(
            scale, feed_scale=scale, centres=reading, changes_by_t=changes_by_t, printer=printer,
            siemens=file.suffix.lower() in (".mpf", ".spf"),
        )  # fmt: skip
        reader = Rs274(file, options, state)
        try:
            reader.run(lines)
        except OffCircleError as fault:
            first_fault = first_fault or fault
            if state.centres_stated:
                break
            continue
        if first_fault is not None:
            if len(reader.it.motion.proofs) < FEWEST_PROOFS:
                continue
            meaning = {"absolute": "absolute", "reversed": "counted from the centre to the start"}[reading]
            note = f"arc centres I J K are read as {meaning}: only so every arc of the file lies on a circle"
            reader.it.log.note(note, int(first_fault.where or 1))
        return reader.it.finish("gcode", ", ".join(state.units) or "not stated", len(lines))
    assert first_fault is not None
    raise first_fault
