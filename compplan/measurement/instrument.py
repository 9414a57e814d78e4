"""Instruments other than a tracker: description file, and columns of a measurement log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from compplan.io.columns import FileColumn
from compplan.io.parsing import LEAST_SIGMA_MM
from compplan.io.tables import Table
from compplan.io.tomlfile import SchemaOne, StrictTable, Vector3, read_toml_model
from compplan.measurement.observations import CONTACT, DISTANCE, POSITION, READING, KnownDistances, Observations
from compplan.robot import Array

#: Default standard deviation of contacts, readings and distances (assumed: a dial gauge). [m]
ASSUMED_SIGMA = 5e-5
#: Default standard deviation of a known distance (assumed: a caliper). [mm]
ASSUMED_DISTANCE_MM = 0.02
#: Tolerance of the length of a unit vector (assumed: rounding).
ROUNDING = 0.01
#: Greatest distance of an instrument from the robot's base along an axis: a kilometre. [mm]
Place = Annotated[float, Field(ge=-1e6, le=1e6)]
COLUMNS = (
    FileColumn("contact", "text"),
    FileColumn("reading", "length", missing=True),
    *(FileColumn(f"dir_{axis}", "number", missing=True, group="direction") for axis in "ijk"),
    FileColumn("distance", "length", missing=True),
)


class DistanceTable(StrictTable):
    """[[distance]]: a known distance between two contacts."""

    between: Annotated[tuple[str, str], Field(strict=False)]
    mm: Annotated[float, Field(gt=0.0, le=1e5)]
    sigma_mm: Annotated[float, Field(ge=LEAST_SIGMA_MM, le=100.0)] = ASSUMED_DISTANCE_MM

    @model_validator(mode="after")
    def _check_two(self) -> DistanceTable:
        if self.between[0] == self.between[1]:
            raise ValueError(f"is between {self.between[0]!r} and itself, expected two contacts")
        return self


class InstrumentTable(StrictTable):
    """[instrument]: standard deviation, and pose of its frame in the base frame of the robot."""

    sigma_mm: Annotated[float, Field(ge=LEAST_SIGMA_MM, le=100.0)] | None = None
    position_mm: Annotated[tuple[Place, Place, Place], Field(strict=False)] = (0.0, 0.0, 0.0)
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)


class InstrumentFile(StrictTable):
    """instrument.toml."""

    schema_: SchemaOne = Field(alias="schema")
    instrument: InstrumentTable = InstrumentTable.model_construct()
    distance: Annotated[tuple[DistanceTable, ...], Field(strict=False)] = ()


@dataclass(frozen=True)
class ObservedRows:
    """Observations of a log without positions, and their standard deviations."""

    observations: Observations  #: The observations.
    sigma: Array  #: Standard deviation of each row, NaN for a position. Shape (n,). [m]
    notes: tuple[str, ...]  #: Notes on assumptions and missing information, one sentence each.


def read_instrument(file: Path) -> InstrumentFile:
    """Read instrument.toml.

    Raises:
        InputError: If the file is invalid.
    """
    return read_toml_model(InstrumentFile, file)


def read_observations(table: Table, position: Array, instrument: InstrumentFile | None) -> ObservedRows | None:
    """Read the columns contact, reading, dir and distance of a log; None if it has none of them.

    position: positions of the log, NaN if missing, (n, 3) [m].

    Raises:
        InputError: With file and line, if a row contains conflicting or incomplete observations.
    """
    if not any(key in table for key in ("contact", "reading", "distance")):
        return None
    said, notes = instrument or InstrumentFile.model_validate({"schema": 1}), list[str]()
    n = len(table)
    names, contact = _number_contacts(table)
    nothing = np.full(n, np.nan)
    reading, distance = table.values.get("reading", nothing), table.values.get("distance", nothing)
    kind = np.where(np.isfinite(distance), DISTANCE, np.where(np.isfinite(reading), READING, POSITION))
    measured = np.asarray(np.isfinite(position).all(axis=1))
    # a label with readings or distances in other rows is not a socket: its empty rows were not measured
    empty = (kind == POSITION) & (contact >= 0) & ~measured
    contact = np.where(empty & np.isin(contact, contact[~empty & (kind != POSITION)]), -1, contact)
    kind = np.where(empty & (contact >= 0), CONTACT, kind)
    _check_rows(table, kind, contact, reading, measured)
    turn = Rotation.from_rotvec(np.deg2rad(said.instrument.rotation_deg)).as_matrix()
    origin = np.where((kind == READING)[:, None], np.array(said.instrument.position_mm) * 1e-3, 0.0)
    origin = np.where((measured & (kind == READING))[:, None], position, origin)
    observations = Observations(
        kind=kind, contact=np.where(kind == POSITION, -1, contact), names=names, origin=origin,
        direction=read_directions(table, kind == READING) @ turn.T,
        value=np.where(kind == DISTANCE, distance, np.where(kind == READING, reading, np.nan)),
    )  # fmt: skip
    contacts_alone = (kind == CONTACT).any() and not (kind != CONTACT)[kind != POSITION].any() and not measured.any()
    if contacts_alone and np.bincount(contact[contact >= 0], minlength=1).max() < 2:
        raise table.error("every contact has one row only, expected several poses at one place under one label")
    tied, sigma = [label for one in said.distance for label in one.between], said.instrument.sigma_mm
    observations, alone = _drop_undetermined(table, observations, tied, measured)
    notes += alone
    observations, absent = _add_distances(observations, said.distance)
    if absent:
        notes.append(f"[[distance]] names contacts that the log has not, and does not count there: {', '.join(absent)}")
    if sigma is None and "sigma_position" not in table:
        notes.append(f"no sigma_mm of the instrument is stated: {ASSUMED_SIGMA * 1e3:g} mm is assumed")
    if not observations.estimate_scale and not (measured & (kind == POSITION)).any():
        notes.append(
            "these rows do not determine the scale: lengths stay near the robot folder's; add a known [[distance]]"
            " between contacts, a reading or a ball bar"
        )
    if np.isin(observations.kind, (READING, DISTANCE)).any():
        notes.append(
            "readings and distances have one direction a row, and so has the gap: in space the tip may be 1.7 times as"
            " far off; bands count all three directions"
        )
    level = ASSUMED_SIGMA if sigma is None else sigma * 1e-3
    return ObservedRows(observations, np.where(observations.observed, level, np.nan), tuple(notes))


def _number_contacts(table: Table) -> tuple[tuple[str, ...], NDArray[np.int_]]:
    labels = [str(label).strip() for label in table.text["contact"]] if "contact" in table else [""] * len(table)
    names = tuple(label for label in dict.fromkeys(labels) if label)
    return names, np.array([names.index(label) if label else -1 for label in labels], int)


def _check_rows(
    table: Table, kind: NDArray[np.int_], contact: NDArray[np.int_], reading: Array, measured: NDArray[np.bool_]
) -> None:
    """Reject rows with conflicting observations."""
    length = np.nan_to_num(table.values.get("distance", reading))
    wrong = {
        "a row has reading_mm and distance_mm, expected one of them": (kind == DISTANCE) & np.isfinite(reading),
        "distance_mm without a contact, expected the label of the fixed centre": (kind == DISTANCE) & (contact < 0),
        "x_mm y_mm z_mm beside distance_mm, expected an unknown centre: a contact alone": (kind == DISTANCE) & measured,
        "x_mm y_mm z_mm and a contact beside reading_mm, expected the place of the zero or a label of an unknown one": (
            (kind == READING) & measured & (contact >= 0)
        ),
        "distance_mm is not above zero": (kind == DISTANCE) & ~(length > 0),
    }
    for message, rows in wrong.items():
        if rows.any():
            raise table.error(message, int(np.flatnonzero(rows)[0]))


def _drop_undetermined(
    table: Table, observations: Observations, tied: Sequence[str], measured: NDArray[np.bool_]
) -> tuple[Observations, list[str]]:
    """Drop contacts with too few rows to determine more than their unknown position; also return a note.

    tied: labels with known distances; measured: rows with a position, (n,).

    Raises:
        InputError: If no informative row is left.
    """
    least = [_count_least(observations.take(observations.contact == k)) for k in range(len(observations.names))]
    rows = np.bincount(observations.contact[observations.contact >= 0], minlength=len(least))
    lonely = (rows < least) & ~np.isin(observations.names, tied)
    if not lonely.any():
        return observations, []
    one = int(np.argmax(lonely))
    few = f"contact {observations.names[one]!r} is in {rows[one]} row{'' if rows[one] == 1 else 's'}, expected at least"
    few = f"{few} {least[one]}: as many as its unknown place needs, and one more"
    out = np.append(lonely, False)[observations.contact]
    if not (observations.observed & ~out).any() and not measured.any():
        raise table.error(few, int(np.flatnonzero(observations.contact == one)[0]))
    others = [observations.names[k] for k in np.flatnonzero(lonely)[1:]]
    more = f"; nor do those of {', '.join(others)}" if others else ""
    return observations.drop_contacts(lonely), [f"{few}; its rows do not count{more}"]


def _count_least(rows: Observations) -> int:
    """Return the least number of rows of a contact: one more than its unknown position requires."""
    if (rows.kind == CONTACT).any():
        return 2
    if (rows.kind == DISTANCE).any():
        return 4
    return 1 + int(np.linalg.matrix_rank(rows.direction)) if len(rows.kind) else 0


def read_directions(table: Table, rows: NDArray[np.bool_]) -> Array:
    """Read the unit vectors of readings in selected rows, NaN elsewhere. Shape (n, 3)."""
    if not rows.any():
        return np.full((len(table), 3), np.nan)
    if "dir_i" not in table:
        raise table.error("reading_mm without dir_i dir_j dir_k, expected the direction of each reading")
    direction = table.stack(["dir_i", "dir_j", "dir_k"])
    length = np.linalg.norm(direction, axis=1)
    bad = rows & ~(np.abs(length - 1.0) < ROUNDING)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise table.error(f"dir_i dir_j dir_k has length {length[row]:.4g}, expected a unit vector", row)
    return np.where(rows[:, None], direction / np.where(rows, length, 1.0)[:, None], np.nan)


def _add_distances(observations: Observations, tables: tuple[DistanceTable, ...]) -> tuple[Observations, list[str]]:
    """Add the known distances between contacts of the log; also return the labels that are missing in the log."""
    number = {name: k for k, name in enumerate(observations.names)}
    absent = [label for table in tables for label in table.between if label not in number]
    here = [table for table in tables if all(label in number for label in table.between)]
    known = KnownDistances(
        np.array([[number[label] for label in table.between] for table in here], int).reshape(-1, 2),
        np.array([table.mm for table in here]) * 1e-3,
        np.array([table.sigma_mm for table in here]) * 1e-3,
    )
    return replace(observations, known=known), list(dict.fromkeys(absent))
