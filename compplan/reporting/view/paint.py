"""Colours of a scene, and lines as plain data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.palette import CATEGORIES, NEUTRAL
from compplan.reporting.style import SEQUENTIAL
from compplan.robot import Array

Bytes = NDArray[np.uint8]
#: Deviation that gets the last colour, in tolerances; the middle one is one tolerance.
LAST = 2.0


class Lines(NamedTuple):
    """Segments of lines.

    Attributes:
        points: Both ends. Shape (k, 2, 3). [m]
        colours: Red, green, blue of both ends. Shape (k, 2, 3).
    """

    points: NDArray[np.float32]
    colours: Bytes


def read_colour(text: str) -> Bytes:
    """Return #rrggbb as three bytes."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)], np.uint8)


def paint_sizes(size: Array, tolerance: float) -> Bytes:
    """Colour deviations against the tolerance: blue is none, yellow the tolerance, dark red twice of it and more.

    Args:
        size: NaN is grey. Shape (n,). [m]
        tolerance: [m]
    """
    place = np.clip(np.nan_to_num(size) / (LAST * tolerance), 0.0, 1.0)
    stops = np.array([stop for stop, _ in SEQUENTIAL])
    shades = np.stack([read_colour(colour) for _, colour in SEQUENTIAL]).astype(float)
    told = np.column_stack([np.interp(place, stops, shades[:, k]) for k in range(3)])
    return np.where(np.isfinite(size)[:, None], told, read_colour(NEUTRAL)).astype(np.uint8)


def paint_names(names: NDArray[np.str_]) -> tuple[Bytes, dict[str, str]]:
    """Colour names by how often they come, "not explained" grey; return colours and what they mean."""
    found, count = np.unique(names, return_counts=True)
    order = [str(name) for name in found[np.argsort(-count)] if name != "not explained"]
    legend = {name: CATEGORIES[min(k, len(CATEGORIES) - 1)] for k, name in enumerate(order)}
    legend["not explained"] = NEUTRAL
    return np.stack([read_colour(legend[str(name)]) for name in names]), legend


def join_rows(points: Array, colours: Bytes) -> Lines:
    """Join neighbouring points by segments; what is not finite leaves a gap."""
    both = np.isfinite(points[:-1]).all(axis=1) & np.isfinite(points[1:]).all(axis=1)
    ends = np.stack([points[:-1], points[1:]], axis=1)[both].astype(np.float32)
    return Lines(ends, np.stack([colours[:-1], colours[1:]], axis=1)[both])


def pick_point(points: Array, origin: Array, direction: Array) -> int:
    """Return the point that a ray from the eye passes nearest to, by angle; points behind the eye are left out.

    Args:
        points: Shape (n, 3). [m]
        origin: Where the eye is. Shape (3,). [m]
        direction: Shape (3,).
    """
    away = points - origin
    along = away @ direction / np.linalg.norm(direction)
    across = np.linalg.norm(np.cross(away, direction), axis=1) / np.linalg.norm(direction)
    angle = np.where(along > 0, across / np.maximum(along, 1e-9), np.inf)
    return int(np.argmin(np.where(np.isfinite(angle), angle, np.inf)))
