"""Sights: what instruments other than a tracker see of the measured point; the one place where their equations stand.

With the measured point p and an unknown place c, both in the robot's base frame, a row says one of

    contact    0 = c - p               ball in a socket, tip on a cone: the same place in every row of a label
    reading    s = d^T (p - o - c)     dial gauge, probe along a normal, plane contact; c where a label says that the
                                       zero is unknown, else 0; o where the zero stands
    distance   s = |p - o - c|         ball bar about a fixed centre
    position   m = p                   a tracker: no sight, the campaign holds it

and [[distance]] of the instrument file says |c_a - c_b|. A contact is three numbers, the others one, along `direction`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

POSITION, CONTACT, READING, DISTANCE = range(4)


@dataclass(frozen=True, eq=False)
class KnownDistances:
    """Distances between contacts that were measured apart; d of them."""

    #: Numbers of the two contacts. Shape (d, 2).
    between: NDArray[np.int_] = field(default_factory=lambda: np.zeros((0, 2), int))
    length: Array = field(default_factory=lambda: np.zeros(0))  #: Distances. Shape (d,). [m]
    sigma: Array = field(default_factory=lambda: np.zeros(0))  #: Their standard deviations. Shape (d,). [m]

    def __len__(self) -> int:
        return len(self.length)

    def gap(self, places: Array) -> Array:
        """Return the known distances minus those of places. Shape (contacts, 3) -> (d,). [m]"""
        return np.asarray(self.length - np.linalg.norm(self._apart(places), axis=1))

    def slopes(self, places: Array) -> Array:
        """Differentiate the distances by the places. Shape (d, contacts, 3)."""
        apart = self._apart(places)
        unit = apart / np.maximum(np.linalg.norm(apart, axis=1), 1e-12)[:, None]
        result = np.zeros((len(self), len(places), 3))
        count = np.arange(len(self))
        result[count, self.between[:, 0]], result[count, self.between[:, 1]] = unit, -unit
        return result

    def _apart(self, places: Array) -> Array:
        return np.asarray(places[self.between[:, 0]] - places[self.between[:, 1]])


@dataclass(frozen=True, eq=False)
class Observations:
    """What was seen of the measured point in rows without a position; n rows, base axes."""

    kind: NDArray[np.int_]  #: POSITION (no sight), CONTACT, READING or DISTANCE. Shape (n,).
    contact: NDArray[np.int_]  #: Number of the contact, -1 for none. Shape (n,).
    names: tuple[str, ...]  #: Label of each contact.
    origin: Array  #: Where a reading or a distance counts from, before its contact. Shape (n, 3). [m]
    direction: Array  #: Unit vector of a reading, NaN elsewhere. Shape (n, 3).
    value: Array  #: Reading or distance, NaN elsewhere. Shape (n,). [m]
    known: KnownDistances = field(default_factory=KnownDistances)  #: Distances between contacts.

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Tell which rows are sights. Shape (n,)."""
        return np.asarray(self.kind != POSITION)

    @property
    def estimate_scale(self) -> bool:
        """Tell whether any length was measured: contacts alone look the same for an arm of twice the size."""
        return bool(len(self.known) or np.isin(self.kind, (READING, DISTANCE)).any())

    def take(self, rows: NDArray[np.int_] | NDArray[np.bool_]) -> Observations:
        """Take some rows."""
        picked = {name: getattr(self, name)[rows] for name in ("kind", "contact", "origin", "direction", "value")}
        return replace(self, **picked)

    def repeat(self, times: int) -> Observations:
        """Return the rows so many times, one after the other."""
        return self.take(np.tile(np.arange(len(self.kind)), times))

    def without(self, rows: NDArray[np.bool_]) -> Observations:
        """Forget what some rows saw. Shape of `rows`: (n,)."""
        return replace(self, kind=np.where(rows, POSITION, self.kind), contact=np.where(rows, -1, self.contact))

    def drop_contacts(self, gone: NDArray[np.bool_]) -> Observations:
        """Forget contacts, what their rows saw and the distances to them. Shape of `gone`: (contacts,)."""
        number = np.append(np.cumsum(~gone) - 1, -1)
        kept = self.without(np.append(gone, False)[self.contact])
        names = tuple(name for name, out in zip(self.names, gone, strict=True) if not out)
        both = ~gone[self.known.between].any(axis=1)
        known = KnownDistances(number[self.known.between[both]], self.known.length[both], self.known.sigma[both])
        return replace(kept, contact=number[kept.contact], names=names, known=known)

    def gap(self, point: Array, places: Array) -> Array:
        """Return seen minus expected as a vector, along the direction where one number was seen; NaN for positions.

        point: measured point that a model expects, (n, 3); places: of the contacts, (contacts, 3); base frame. [m]
        """
        away = self._away(point, places)
        along = self.directions(point, places)
        expected = np.where(self.kind == DISTANCE, np.linalg.norm(away, axis=1), np.einsum("ni,ni->n", along, away))
        gap = np.where((self.kind == CONTACT)[:, None], -away, (self.value - expected)[:, None] * along)
        return np.where(self.seen[:, None], gap, np.nan)

    def directions(self, point: Array, places: Array) -> Array:
        """Return the direction in which a row tells one number, NaN where it tells all three. Shape (n, 3)."""
        away = self._away(point, places)
        unit = away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None]
        return np.where((self.kind == DISTANCE)[:, None], unit, self.direction)

    def place_slopes(self) -> Array:
        """Differentiate the gap by the places, before it is taken along the direction. Shape (n, 3, contacts, 3)."""
        of = (self.contact[:, None] == np.arange(len(self.names))) & self.seen[:, None]
        return np.asarray(np.einsum("nl,ij->nilj", of.astype(float), np.eye(3)))

    def first_rows(self) -> NDArray[np.int_]:
        """Return the first row of the first contact of each known distance: the row that it goes with. Shape (d,)."""
        rows = [np.flatnonzero(self.contact == one) for one in self.known.between[:, 0]]
        return np.array([found[0] if len(found) else 0 for found in rows], int)

    def start_places(self, point: Array) -> Array:
        """Find places to begin with: means of contacts, zeros of readings, centres of spheres. Shape (contacts, 3). [m]

        point: measured point that a model expects, base frame, NaN where it is unknown. Shape (n, 3). [m]
        """
        places = np.zeros((len(self.names), 3))
        known = np.isfinite(point).all(axis=1)
        for number in range(len(places)):
            rows = np.flatnonzero((self.contact == number) & self.seen & known)
            if len(rows):
                places[number] = _start_place(self.take(rows), point[rows])
        return places

    def _away(self, point: Array, places: Array) -> Array:
        shifted = np.vstack([places, np.zeros((1, 3))])[self.contact]
        return np.asarray(point - self.origin - shifted)


def along(direction: Array, vectors: Array) -> Array:
    """Take vectors along the direction of their rows; those of rows without one stay. Shapes (n, 3), (n, 3, ...)."""
    one = np.isfinite(direction).all(axis=1)
    result = vectors.copy()
    result[one] = np.einsum("ni,nj,nj...->ni...", direction[one], direction[one], vectors[one])
    return result


def _start_place(rows: Observations, point: Array) -> Array:
    """Find the place of one contact. Shape (3,). [m]"""
    point = point - rows.origin
    if (rows.kind == DISTANCE).any():
        return fit_sphere(point, rows.value)
    if (rows.kind == CONTACT).any():
        return np.asarray(np.median(point[rows.kind == CONTACT], axis=0))
    left = np.einsum("ni,ni->n", rows.direction, point) - rows.value
    return np.asarray(np.linalg.lstsq(rows.direction, left, rcond=1e-9)[0])


def fit_sphere(point: Array, distance: Array) -> Array:
    """Find the centre that points, (n, 3), have distances from. [m]

    |p|^2 - s^2 = 2 c^T p - |c|^2 is linear in c and |c|^2; about the mean, so that far places lose nothing.
    """
    middle = point.mean(axis=0)
    near = point - middle
    a = np.column_stack([2.0 * near, -np.ones(len(near))])
    return np.asarray(middle + np.linalg.lstsq(a, np.sum(near**2, axis=1) - distance**2, rcond=1e-9)[0][:3])
