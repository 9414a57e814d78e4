"""The programs of tests/truth with the moves that they ask for, and how a reading is compared with them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.reading import read_toolpath
from tests.oracles.follow import Followed, find_difference
from tests.oracles.moves import ARC, LINE, RAPID, Reading, Recorder

FOLDER = Path(__file__).parents[1] / "truth"


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


def find_difference_from(case: Case, moves: Reading | None = None) -> str:
    """Say where the reader goes another way than a program (or than other moves); nothing where it does not."""
    try:
        path = read_toolpath(case.file, cam=CamTable(**case.options))
    except InputError as error:
        return f"refused: {error.message}"
    return find_difference(Followed(path.position, path.axis, path.rapid, path.feed, chord=1.2e-6), moves or case.moves)
