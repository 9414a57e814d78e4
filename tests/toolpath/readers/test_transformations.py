"""A program that is written in another way is read as the same path, to 2e-5 mm.

Absolute and incremental, mm and inch, arcs by centre and by radius, loops and subprograms and the same written out,
frames shifted and shifted back, words of a block in another order, block numbers and remarks: none moves the tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import compplan as cp
from compplan.toolpath.readers.options import CamTable
from toolpath.readers import transform_gcode as g
from toolpath.readers import transform_others as other

TESTS = Path(__file__).parents[2]
ROOT = TESTS.parent
#: How far the path may move. [m]
CLOSE = 2e-8
GCODE = {".nc", ".ngc", ".gcode", ".tap", ".ptp"}


class Case(NamedTuple):
    """Two programs that must be read alike."""

    file: Path
    change: str
    one: str
    two: str


def list_programs() -> list[Path]:
    """List public and own programs."""
    folders = [TESTS / "truth", TESTS / "posts", TESTS / "public_programs", ROOT / "paths", ROOT / "examples"]
    suffixes = GCODE | {".h", ".mpf", ".cls", ".ncl", ".aptsource", ".apt", ".src", ".mod"}
    return sorted(file for folder in folders for file in folder.rglob("*") if file.suffix.lower() in suffixes)


def one_way(change: Callable[[str], str | None]) -> Callable[[str], tuple[str, str] | None]:
    """Compare what a transformer makes with the program itself."""

    def both(text: str) -> tuple[str, str] | None:
        changed = change(text)
        return None if changed is None else (text, changed)

    return both


CHANGES: dict[str, dict[str, Callable[[str], tuple[str, str] | None]]] = {
    "gcode": {
        "absolute and incremental": one_way(g.swap_distance_mode),
        "mm and inch": one_way(g.swap_unit),
        "centre and radius": one_way(g.swap_arc_form),
        "words shuffled": one_way(g.shuffle_words),
        "numbers and remarks": one_way(g.add_numbers_and_comments),
        "subprogram": one_way(g.call_subprogram),
        "loop": g.repeat_run,
        "shifted and back": one_way(g.shift_and_back),
    },
    "heidenhain": {
        "remarks": one_way(other.add_klartext_comments),
        "loop": other.repeat_klartext,
        "subprogram": other.call_klartext,
        "mm and inch": one_way(other.scale_klartext),
    },
    "sinumerik": {
        "numbers and remarks": one_way(other.add_sinumerik_comments),
        "words shuffled": one_way(other.shuffle_sinumerik),
        "loop": other.repeat_sinumerik,
        "shifted and back": one_way(other.shift_sinumerik),
    },
    "apt": {"remarks": one_way(other.add_apt_comments), "blanks": one_way(other.add_blank_lines)},
    "robot": {"blanks": one_way(other.add_blank_lines)},
}


def language_of(file: Path) -> str:
    """Name the family of a program by its suffix."""
    suffix = file.suffix.lower()
    if suffix in GCODE:
        return "gcode"
    return {".h": "heidenhain", ".mpf": "sinumerik", ".src": "robot", ".mod": "robot"}.get(suffix, "apt")


def read(folder: Path, file: Path, text: str) -> cp.Toolpath:
    """Read a program from text; its file stands in a folder beside nothing else."""
    program = folder / file.name
    program.write_text(text, encoding="latin-1")
    return cp.read_toolpath(program, cam=CamTable(cycles="expand", unit="mm", from_mm=[0.0, 0.0, 10.0]))


def readable(file: Path, folder: Path) -> bool:
    """Whether a program is read at all: those that are refused offer nothing to compare."""
    try:
        read(folder, file, file.read_text(encoding="latin-1"))
    except cp.InputError:
        return False
    return True


def list_cases() -> Iterator[Case]:
    for file in list_programs():
        text = file.read_text(encoding="latin-1")
        for name, change in CHANGES[language_of(file)].items():
            pair = change(text)
            if pair is not None and pair[0] != pair[1]:
                yield Case(file, name, *pair)


CASES = list(list_cases())


def columns(path: cp.Toolpath) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return position, axis, rapid, feed without waypoints at which nothing moves: what rounding leaves of a move."""
    step = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    turn = np.linalg.norm(np.diff(path.axis, axis=0), axis=1)
    keep = np.r_[True, (step > CLOSE) | (turn > 1e-9)]
    return path.position[keep], path.axis[keep], path.rapid[keep], path.feed[keep]


def find_difference(one: cp.Toolpath, two: cp.Toolpath) -> str:
    """Say where two paths differ; nothing where they do not."""
    (position, axis, rapid, feed), (position2, axis2, rapid2, feed2) = columns(one), columns(two)
    if len(position) != len(position2):
        return f"{len(position)} and {len(position2)} waypoints"
    apart = np.linalg.norm(position - position2, axis=1)
    if apart.max() > CLOSE:
        return f"waypoint {apart.argmax()} is {1e3 * apart.max():.3g} mm away"
    if not np.allclose(axis, axis2, rtol=0.0, atol=1e-9):
        return "the tool axis differs"
    if not np.array_equal(rapid, rapid2):
        return f"waypoint {(rapid != rapid2).argmax()} is rapid in one of them only"
    if not np.allclose(feed, feed2, rtol=1e-6):
        return f"the feed differs at waypoint {np.abs(feed - feed2).argmax()}"
    return ""


@pytest.mark.parametrize("case", CASES, ids=[f"{c.file.parent.name}/{c.file.name}, {c.change}" for c in CASES])
def test_a_program_written_in_another_way_is_the_same_path(case: Case, tmp_path: Path) -> None:
    if not readable(case.file, tmp_path):
        pytest.skip("the program is refused as it is")
    one, two = (read(tmp_path, case.file, text) for text in (case.one, case.two))
    assert find_difference(one, two) == ""


def test_every_change_is_made_to_several_programs() -> None:
    counts = {name: sum(case.change == name for case in CASES) for name in {case.change for case in CASES}}
    assert min(counts.values()) >= 3, counts
    assert len(CASES) >= 200


def test_a_path_that_moved_is_seen(tmp_path: Path) -> None:
    file = TESTS / "truth" / "fusion_fanuc.nc"
    text = file.read_text()
    one, two = read(tmp_path, file, text), read(tmp_path, file, text.replace("X30.", "X30.0001"))
    assert "mm away" in find_difference(one, two)
