"""Programs in the form of common posts: every move ends where LinuxCNC's interpreter ends it (tests/posts/*.moves)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from compplan.toolpath.readers import read_cam

POSTS = sorted(path for path in (Path(__file__).parents[2] / "posts").iterdir() if path.suffix != ".moves")


def read_moves(file: Path) -> tuple[list[tuple[str, np.ndarray, float]], list[int], float]:
    """Return kind, end [mm] and feed [mm/min] of each move, the tools, and the length of all cuts [mm]."""
    head, *lines = file.with_suffix(".moves").read_text().splitlines()
    found = re.search(r"tools (\S+) length (\S+)", head)
    assert found is not None
    rows = [line.split() for line in lines]
    moves = [(row[0], np.array(row[1:4], dtype=float), float(row[4])) for row in rows]
    return moves, [int(n) for n in found[1].split(",") if n != "-"], float(found[2])


@pytest.mark.parametrize("file", POSTS, ids=[path.stem for path in POSTS])
def test_every_move_ends_where_another_interpreter_ends_it(file: Path) -> None:
    moves, tools, length = read_moves(file)
    path = read_cam(file).toolpath
    tips, place = path.position * 1e3, -1
    for number, (kind, end, feed) in enumerate(moves):
        ahead = tips[place + 1 :]
        near = np.flatnonzero(np.linalg.norm(ahead - end, axis=1) < 2.5e-3)
        assert len(near), f"move {number + 1}, {kind} to {end}, is not among ours"
        reached = place + 1 + int(near[0])
        if kind != "arc":
            assert reached - place <= 2, f"move {number + 1}: waypoints between {tips[place]} and {end}"
            assert bool(path.rapid[reached]) == (kind == "rapid")
        if kind != "rapid":
            assert path.feed[reached] * 6e4 == pytest.approx(feed, rel=1e-4)
        place = reached
    assert path.cutting_length * 1e3 == pytest.approx(length, rel=1e-4)
    assert np.all(path.rapid[place + 1 :]) and len(tips) - place <= 2  # the way home
    assert not tools or [event.value for event in path.events if event.kind == "tool"] == tools
