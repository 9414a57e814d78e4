"""The programs of tests/truth with the moves that they ask for, and how a reading is compared with them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.robot import Array
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.reading import read_toolpath
from tests.oracles.cam.follow import Followed, find_difference
from tests.oracles.cam.moves import ARC, LINE, RAPID, Reading, Recorder

FOLDER = Path(__file__).parents[1] / "truth"
#: How far an end may lie from the one expected. [m]
CLOSE = 1e-7


def follow_arc(start: Array, end: Array, centre: Array, normal: Array, sweep: float, shares: Array) -> Array:
    """Return points of an arc, a helix or a spiral at shares of its angle. Shape (k, 3)."""
    n = normal / np.linalg.norm(normal)
    arm, last = start - centre, end - centre
    rise0, rise1 = float(arm @ n), float(last @ n)
    flat0, flat1 = arm - rise0 * n, last - rise1 * n
    radius0, radius1 = float(np.linalg.norm(flat0)), float(np.linalg.norm(flat1))
    u = flat0 / radius0
    v = np.cross(n, u)
    angle = sweep * shares[:, None]
    radius = radius0 + (radius1 - radius0) * shares[:, None]
    rise = rise0 + (rise1 - rise0) * shares[:, None]
    return np.asarray(centre + radius * (np.cos(angle) * u + np.sin(angle) * v) + rise * n)


@dataclass(frozen=True)
class Case:
    """A program in the form of a post, where its moves come from, and the moves.

    Expected moves stand a line each: rapid X Y Z; line X Y Z FEED; drill, a line with chips drawn; arc X Y Z c CENTRE
    [n AXIS] s DEGREES FEED; a I J K at the end of any of them is the tool axis; tool N. Lengths in mm, feeds in mm/min.
    """

    file: Path
    form: str
    truth: str
    options: dict[str, str]
    moves: Reading


def list_cases() -> list[Case]:
    return [read_case(file) for file in sorted(FOLDER.glob("*.moves"))]


def read_case(file: Path) -> Case:
    heads: dict[str, str] = {}
    record = Recorder()
    for line in file.read_text().splitlines():
        if line.startswith("#"):
            key, _, value = line[1:].partition(":")
            heads[key.strip()] = value.strip()
        elif line:
            _add(record, line.split())
    options = dict(entry.split("=") for entry in heads.get("cam", "").split())
    return Case(file.with_suffix(""), heads["form"], heads["truth"], options, record.finish())


def _add(record: Recorder, words: list[str]) -> None:
    if words[0] == "tool":
        record.tool = int(words[1])
        return
    axis = (0.0, 0.0, 1.0)
    if "a" in words:
        at = words.index("a")
        axis = (float(words[at + 1]), float(words[at + 2]), float(words[at + 3]))
        words = words[:at]
    end = [float(word) for word in words[1:4]]
    if words[0] == "arc":
        c, s = words.index("c"), words.index("s")
        n = words.index("n") if "n" in words else None
        normal = (0.0, 0.0, 1.0) if n is None else tuple(float(word) for word in words[n + 1 : n + 4])
        centre = tuple(float(word) for word in words[c + 1 : c + 4])
        sweep, feed = math.radians(float(words[s + 1])), float(words[s + 2]) / 60.0
        record.move(ARC, end, feed, axis, centre=centre, normal=normal, sweep=sweep)
    else:
        kind = RAPID if words[0] == "rapid" else LINE
        record.move(kind, end, 0.0 if kind == RAPID else float(words[4]) / 60.0, axis, drill=words[0] == "drill")


def find_wrong_move(found: Reading, wanted: Reading) -> str:
    """Say which move of a reading is not the one expected; nothing where all are."""
    found, wanted = (_drop_still(reading) for reading in (found, wanted))
    for k in range(min(len(found), len(wanted))):
        pairs = ((found.kind[k], wanted.kind[k], 0.0), (found.end[k], wanted.end[k], CLOSE),
                 (found.axis[k], wanted.axis[k], 1e-6), (found.feed[k], wanted.feed[k], 1e-6))  # fmt: skip
        same = all(np.abs(np.subtract(a, b)).max() <= room for a, b, room in pairs)
        if same and wanted.kind[k] == ARC:
            half = np.array([0.3, 0.7])
            a, b = (
                follow_arc(r.end[k - 1], r.end[k], r.centre[k], r.normal[k], float(r.sweep[k]), half)
                for r in (found, wanted)
            )
            same = bool(np.abs(a - b).max() <= CLOSE and abs(abs(found.sweep[k]) - abs(wanted.sweep[k])) < 1e-6)
        if not same:
            return f"move {k}: {_say(found, k)}, expected {_say(wanted, k)}"
    return "" if len(found) == len(wanted) else f"{len(found)} moves, expected {len(wanted)}"


def find_difference_from(case: Case) -> str:
    """Say where the first reader goes another way than a program; nothing where it does not."""
    try:
        path = read_toolpath(case.file, cam=CamTable(**case.options))
    except InputError as error:
        return f"refused: {error.message}"
    return find_difference(Followed(path.position, path.axis, path.rapid, path.feed, chord=1.2e-6), case.moves)


def _drop_still(reading: Reading) -> Reading:
    """Leave out rapid moves that lead nowhere."""
    step = np.r_[1.0, np.linalg.norm(np.diff(reading.end, axis=0), axis=1)]
    keep = (step > 1e-9) | (reading.kind == ARC)
    names = ("kind", "end", "axis", "feed", "tool", "line", "centre", "normal", "sweep", "drill")
    return Reading(*(getattr(reading, name)[keep] for name in names))


def _say(reading: Reading, k: int) -> str:
    place = ", ".join(f"{1e3 * value:.6g}" for value in reading.end[k])
    return f"{('rapid', 'line', 'arc')[reading.kind[k]]} to ({place}) at {60e3 * reading.feed[k]:.6g} mm/min"
