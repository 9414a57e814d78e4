"""Observations of the measured point by instruments other than a tracker, and their equations.

With the measured point p and an unknown contact position c, both in the robot's base frame, the kinds of rows are

    contact    0 = c - p               ball in a socket, tip on a cone: the same position in every row of a label
    reading    s = d^T (p - o - c)     dial gauge, probe along a normal, plane contact; o: position of the zero; c: its
                                       unknown offset if the row has a label, otherwise 0
    distance   s = |p - o - c|         ball bar about a fixed centre
    position   m = p                   tracker: stored in the campaign

and [[distance]] of the instrument file is |c_a - c_b|. A contact has three components, the others one (`direction`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

POSITION, CONTACT, READING, DISTANCE = range(4)


@dataclass(frozen=True, eq=False)
class KnownDistances:
    """Distances between contacts that were measured separately; d distances."""

    #: Indices of the two contacts. Shape (d, 2).
    between: NDArray[np.int_] = field(default_factory=lambda: np.zeros((0, 2), int))
    length: Array = field(default_factory=lambda: np.zeros(0))  #: Distances. Shape (d,). [m]
    sigma: Array = field(default_factory=lambda: np.zeros(0))  #: Their standard deviations. Shape (d,). [m]

    def __len__(self) -> int:
        return len(self.length)

    def gap(self, places: Array) -> Array:
        """Return each known distance minus that between its two places. Shape (contacts, 3) -> (d,). [m]"""
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
    """Observations of the measured point in rows without a position; n rows, base axes."""

    kind: NDArray[np.int_]  #: POSITION (not an observation), CONTACT, READING or DISTANCE. Shape (n,).
    contact: NDArray[np.int_]  #: Index of the contact, -1 for none. Shape (n,).
    names: tuple[str, ...]  #: Label of each contact.
    origin: Array  #: Origin o of a reading or a distance. Shape (n, 3). [m]
    direction: Array  #: Unit vector of a reading, NaN elsewhere. Shape (n, 3).
    value: Array  #: Reading or distance, NaN elsewhere. Shape (n,). [m]
    known: KnownDistances = field(default_factory=KnownDistances)  #: Distances between contacts.

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Return which rows are observations other than positions. Shape (n,)."""
        return np.asarray(self.kind != POSITION)

    @property
    def estimate_scale(self) -> bool:
        """Return whether any length was measured: contacts alone do not determine the scale of the arm."""
        return bool(len(self.known) or np.isin(self.kind, (READING, DISTANCE)).any())

    def take(self, rows: NDArray[np.int_] | NDArray[np.bool_]) -> Observations:
        """Return the selected rows."""
        picked = {name: getattr(self, name)[rows] for name in ("kind", "contact", "origin", "direction", "value")}
        return replace(self, **picked)

    def repeat(self, times: int) -> Observations:
        """Repeat all rows `times` times, one block after the other."""
        return self.take(np.tile(np.arange(len(self.kind)), times))

    def without(self, rows: NDArray[np.bool_]) -> Observations:
        """Remove the observations of selected rows. Shape of `rows`: (n,)."""
        return replace(self, kind=np.where(rows, POSITION, self.kind), contact=np.where(rows, -1, self.contact))

    def drop_contacts(self, gone: NDArray[np.bool_]) -> Observations:
        """Remove contacts, the observations of their rows and their known distances. Shape of `gone`: (contacts,)."""
        number = np.append(np.cumsum(~gone) - 1, -1)
        kept = self.without(np.append(gone, False)[self.contact])
        names = tuple(name for name, out in zip(self.names, gone, strict=True) if not out)
        both = ~gone[self.known.between].any(axis=1)
        known = KnownDistances(number[self.known.between[both]], self.known.length[both], self.known.sigma[both])
        return replace(kept, contact=number[kept.contact], names=names, known=known)

    def gap(self, point: Array, places: Array) -> Array:
        """Return observed minus expected as a vector, along the direction for one component; NaN for positions.

        point: measured point by a model, (n, 3); places: contact positions, (contacts, 3); base frame. Shape (n, 3) [m]
        """
        away = self._away(point, places)
        along = self.directions(point, places)
        expected = np.where(self.kind == DISTANCE, np.linalg.norm(away, axis=1), np.einsum("ni,ni->n", along, away))
        gap = np.where((self.kind == CONTACT)[:, None], -away, (self.value - expected)[:, None] * along)
        return np.where(self.observed[:, None], gap, np.nan)

    def directions(self, point: Array, places: Array) -> Array:
        """Return the direction of an observation of one component, NaN for all three. Shape (n, 3)."""
        away = self._away(point, places)
        unit = away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None]
        return np.where((self.kind == DISTANCE)[:, None], unit, self.direction)

    def place_slopes(self) -> Array:
        """Differentiate the gap by the places, before projection on the direction. Shape (n, 3, contacts, 3)."""
        of = (self.contact[:, None] == np.arange(len(self.names))) & self.observed[:, None]
        return np.asarray(np.einsum("nl,ij->nilj", of.astype(float), np.eye(3)))

    def first_rows(self) -> NDArray[np.int_]:
        """Return the first row of the first contact of each known distance, 0 without one. Shape (d,)."""
        rows = [np.flatnonzero(self.contact == one) for one in self.known.between[:, 0]]
        return np.array([found[0] if len(found) else 0 for found in rows], int)

    def start_places(self, point: Array) -> Array:
        """Estimate initial contact positions: medians of contacts, zeros of readings, sphere centres. (contacts, 3) [m]

        point: measured point by a model, base frame, NaN if unknown. Shape (n, 3). [m]
        """
        places = np.zeros((len(self.names), 3))
        known = np.isfinite(point).all(axis=1)
        for number in range(len(places)):
            rows = np.flatnonzero((self.contact == number) & self.observed & known)
            if len(rows):
                places[number] = _start_place(self.take(rows), point[rows])
        return places

    def _away(self, point: Array, places: Array) -> Array:
        shifted = np.vstack([places, np.zeros((1, 3))])[self.contact]
        return np.asarray(point - self.origin - shifted)


def along(direction: Array, vectors: Array) -> Array:
    """Project vectors, (n, 3, ...), on the directions of their rows, (n, 3); rows without direction are unchanged."""
    one = np.isfinite(direction).all(axis=1)
    result = vectors.copy()
    result[one] = np.einsum("ni,nj,nj...->ni...", direction[one], direction[one], vectors[one])
    return result


def _start_place(rows: Observations, point: Array) -> Array:
    """Estimate the position of one contact. Shape (3,). [m]"""
    point = point - rows.origin
    if (rows.kind == DISTANCE).any():
        return fit_sphere(point, rows.value)
    if (rows.kind == CONTACT).any():
        return np.asarray(np.median(point[rows.kind == CONTACT], axis=0))
    left = np.einsum("ni,ni->n", rows.direction, point) - rows.value
    return np.asarray(np.linalg.lstsq(rows.direction, left, rcond=1e-9)[0])


def fit_sphere(point: Array, distance: Array) -> Array:
    """Fit the centre c of points p, (n, 3), with given distances s, (n,), from it. Shape (3,). [m]

    |p|^2 - s^2 = 2 c^T p - |c|^2 is linear in c and |c|^2; points relative to their mean, against cancellation.
    """
    middle = point.mean(axis=0)
    near = point - middle
    a = np.column_stack([2.0 * near, -np.ones(len(near))])
    return np.asarray(middle + np.linalg.lstsq(a, np.sum(near**2, axis=1) - distance**2, rcond=1e-9)[0][:3])
