"""Is the path that was planned the one that the job asks for? Its file, its frame, its feed read a second time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.readback.frames import read_part
from compplan.robot import Array
from tests.oracles.cam.follow import FEED_SHARE, Followed, find_difference
from tests.oracles.cam.moves import CannotTellError, Reading
from tests.oracles.cam.tables import read_generator, read_table
from tests.oracles.forces import DrivenRows

#: Tolerance where the job does not say [mm], and the share of it by which corners of a file are rounded then.
TOLERANCE, ROUNDED = 0.1, 0.25
#: Chords of arcs where the job says nothing, and rounding of planned waypoints. [m]
CHORD, ROUNDING = 1e-6, 2e-7


@dataclass(frozen=True)
class Check:
    """What a second look at a part of a plan says: sentences that speak against it, and what was not looked at.

    `unread` says why the path was not read a second time, "" where it was.
    """

    breaches: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unread: str = ""


def check_required_path(tables: Mapping[str, Any], folder: Path, rows: DrivenRows, feed: Array) -> Check:
    """Read what a job asks for a second time and follow the planned path along it.

    Args:
        tables: The tables of the job as they are written.
        folder: Folder that file names in it are relative to.
        rows: What is driven.
        feed: Programmed feed of the move to each row. Shape (n,). [m/s]

    """
    source = tables.get("toolpath")
    if source is None:
        return Check()
    name = source if isinstance(source, str) else "generated path"
    try:
        reading, chord = read_wanted(tables, folder)
    except CannotTellError as error:
        said = f"not checked by a second reading: path of {name}, {error}"
        return Check(notes=(said,), unread=f"{name}, {error}")
    part, table = read_part(tables.get("part") or {}), tables.get("feed", {})
    posture = tables.get("posture", {})
    constant, one_feed = table.get("constant_mm_s"), table.get("mode") == "constant"
    rounded = table.get("corner_tolerance_mm")
    if rounded is None:
        rounded = ROUNDED * read_strictest(tables) * isinstance(source, str)
    path = Followed(
        (rows.position - part.translation) @ part.rotation, rows.axis @ part.rotation, rows.rapid,
        feed if constant is None and not one_feed else None, chord + ROUNDING, 1e-3 * rounded,
        float(np.radians(np.hypot(posture.get("lead_deg", 0.0), posture.get("lean_deg", 0.0)))),
    )  # fmt: skip
    breaches = []
    if difference := find_difference(path, reading):
        breaches.append(f"{name}: {difference}")
    cut = ~rows.rapid & ~rows.lead
    programmed = reading.feed[reading.feed > 0.0].min(initial=np.inf) if constant is None else 1e-3 * constant
    if one_feed and cut.any():
        least, most = float(feed[cut].min()), float(feed[cut].max())
        if most - least > 1e-6 * most or most > programmed * (1.0 + FEED_SHARE):
            said = f"{1e3 * least:.4g} to {1e3 * most:.4g} mm/s, not one of {1e3 * programmed:.4g} mm/s at most"
            breaches.append(f"{name}: the path has a feed of {said}")
    elif constant is not None and np.abs(feed[cut] - programmed).max(initial=0.0) > 1e-6 * programmed:
        breaches.append(f"the path has not the feed of {constant:g} mm/s that the job states")
    return Check(tuple(breaches))


def read_wanted(tables: Mapping[str, Any], folder: Path) -> tuple[Reading, float]:
    """Return the moves that a job asks for, part frame, and how far chords may stray from its arcs [m].

    Raises:
        CannotTellError: If the file is of a kind that is not known here.

    """
    source = tables["toolpath"]
    if not isinstance(source, str):
        return read_generator(source)
    file, options = folder / source, tables.get("cam", {})
    if file.suffix.lower() == ".csv":
        return read_table(file), 0.0
    from tests.oracles.cam.cam import read_moves

    return read_moves(file, options), 1e-3 * options.get("chord_tolerance_mm", 1e3 * CHORD)


def read_strictest(tables: Mapping[str, Any]) -> float:
    """Return the least tolerance that a job states for any part of its path. [mm]"""
    field = tables.get("tolerance") or {}
    everywhere = field.get("normal_mm") or tables.get("plan", {}).get("tolerance_mm", TOLERANCE)
    return float(min([everywhere, *(part["normal_mm"] for part in field.get("part") or () if part.get("normal_mm"))]))
