"""Measurement logs: poses of a robot measured by an instrument, row by row, in time order.

A `Campaign` contains one log in SI, and properties derived from the order of its rows: visits (consecutive rows with
the same joint positions and load), the approach direction of every joint, and joint speeds on paths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compplan.errors import ShapeError
from compplan.io.display import Shown
from compplan.measurement.observations import Observations
from compplan.robot import Array

#: Greatest joint motion that counts as encoder jitter [rad or m]: about one unit of the third decimal of a degree.
STATIC_JITTER = 2e-5
PATH_JITTER = 1e-8
#: Reading of an unloaded force sensor (assumed: noise and drift of a 1 kN sensor). [N], [N m]
FORCE_NOISE, MOMENT_NOISE = 5.0, 2.0
#: Noise of a force sensor as a share of the largest load of the log (assumed).
SAME_LOAD = 0.02
MODES = ("U1", "U2", "L1", "L2")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
#: Default standard deviations (assumed): the initial weights of position and orientation, later re-estimated from the
#: residuals. [m, rad]
ASSUMED_SIGMA_POSITION, ASSUMED_SIGMA_ROTATION = 5e-5, 1e-4


def number_rows(values: Array) -> NDArray[np.int_]:
    """Number the distinct rows of a table, ordered by the first column, then the next. Shape (n,)."""
    number = np.zeros(len(values), np.int64)
    for column in values.T:
        inverse = np.unique(column, return_inverse=True)[1].reshape(-1)
        number = np.unique(number * (int(inverse.max(initial=0)) + 1) + inverse, return_inverse=True)[1].reshape(-1)
    return number


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Shown):
    """One measurement log; n rows, nq joints."""

    run: NDArray[np.str_]  #: Label of the run. Shape (n,).
    q: Array  #: Commanded joint positions (readings of the side that controls). Shape (n, nq). [rad or m]
    #: Wrench of the environment on the tool at the TCP, base axes, as the sensor reports it. Shape (n, 6). [N, N m]
    wrench: Array
    position: Array  #: Measured target, NaN where missing. Shape (n, 3). [m]
    rotation: Array | None = None  #: Measured orientation, NaN where missing, or None. Shape (n, 3, 3).
    time: Array | None = None  #: Seconds since the campaign began, or None. Shape (n,). [s]
    temperature: Array | None = None  #: Temperature of the structure, or None. Shape (n,). [C]
    link: Array | None = None  #: Link-side encoder readings, or None. Shape (n, nq). [rad or m]
    motor: Array | None = None  #: Motor-side encoder readings, or None. Shape (n, nq). [rad or m]
    sigma: Array | None = None  #: Stated standard deviation of the position per axis, or None. Shape (n,). [m]
    #: Stated standard deviation of the orientation per axis, or None. Shape (n,). [rad]
    sigma_rotation: Array | None = None
    target: NDArray[np.int_] | None = None  #: Index of the measured point on the tool. Shape (n,).
    target_names: tuple[str, ...] = ("",)  #: Label of each measured point.
    mode: NDArray[np.str_] | None = None  #: U1 U2 L1 L2 or "". Shape (n,).
    file: Path | None = None  #: File of the log, or None.
    lines: NDArray[np.int_] | None = None  #: Line of each row in the file. Shape (n,).
    notes: tuple[str, ...] = ()  #: Notes on ignored columns and omitted rows, one sentence each.
    #: Measured point in the TCP frame, if known; the TCP if None. Shape (3,). [m]
    target_offset: Array | None = None
    #: Last move of each joint in a pooled log, where the order of rows does not determine it; otherwise None. Shape (n,
    #: nq). [rad or m]
    moved: Array | None = None
    scatter: float = 0.0  #: Standard deviation of a single position per axis in a pooled log; otherwise 0. [m]
    #: Observations in rows without a position (contacts, readings, ball bar), or None.
    observations: Observations | None = None

    def __len__(self) -> int:
        return len(self.q)

    def summary(self) -> list[tuple[str, str]]:
        """Return the number and kinds of measurements, and notes on ignored input."""
        name = "in memory" if self.file is None else self.file.name
        runs = len(np.unique(self.run_index)) if len(self) else 0
        kinds = [("orientation", self.rotation), ("time", self.time), ("temperature", self.temperature),
                 ("link encoders", self.link), ("stated sigma", self.sigma)]  # fmt: skip
        return [
            ("measurements", f"{name}: {len(self)} rows in {runs} runs, {self.nq} joints"),
            ("usable", f"{int(self.usable.sum())} rows hold joints, load and position"),
            ("poses", f"{len(np.unique(self.pose[~self.on_path]))} at rest, {int(self.on_path.sum())} rows in motion"),
            ("load", f"{self.load_scale:.4g} N" if self.load_varies else "none, or always the same"),
            ("also", ", ".join(word for word, values in kinds if values is not None) or "positions alone"),
            *(("note", note) for note in self.notes[:6]),
        ]

    def columns(self) -> dict[str, Any]:
        """Return the log as columns: run, joints [rad or m], load [N, N m], measured position [mm]."""
        columns: dict[str, Any] = {"run": self.run}
        columns |= {f"q{k + 1}_SI": self.q[:, k] for k in range(self.nq)}
        columns |= {f"{name}_{unit}": self.wrench[:, k]
                    for k, (name, unit) in enumerate(zip(WRENCH, ("N",) * 3 + ("Nm",) * 3, strict=True))}  # fmt: skip
        return {**columns, **{f"{axis}_mm": self.position[:, k] * 1e3 for k, axis in enumerate("xyz")}}

    @property
    def nq(self) -> int:
        """Return the number of commanded joints."""
        return self.q.shape[1]

    @cached_property
    def target_index(self) -> NDArray[np.int_]:
        """Return the index of the measured point on the tool, zero if there is only one. Shape (n,)."""
        return np.zeros(len(self), int) if self.target is None else self.target

    @cached_property
    def run_index(self) -> NDArray[np.int_]:
        """Return the number of the run of each row, in order of appearance. Shape (n,).

        Rows of one run were taken without a break, so runs at rest whose rows alternate (as where the label tells the
        load of each pose) count as one.
        """
        _, label = np.unique(self.run, return_inverse=True)
        last = np.zeros(label.max(initial=-1) + 1, int)
        last[label] = np.arange(len(label))  # of repeated indices, numpy keeps the last
        ended = np.maximum.accumulate(last[label])[:-1] < np.arange(1, len(label))
        starts = (np.diff(label) != 0) & (ended | self.on_path[1:] | self.on_path[:-1])
        return np.cumsum(np.r_[False, starts])[: len(label)]

    @cached_property
    def on_path(self) -> NDArray[np.bool_]:
        """Return which rows were sampled in motion. Shape (n,)."""
        return np.char.startswith(np.char.lower(self.run.astype(str)), "path")

    @cached_property
    def link_controlled(self) -> NDArray[np.bool_]:
        """Return which rows have link-side readings in q (modes U2 and L2). Shape (n,)."""
        return np.zeros(len(self), bool) if self.mode is None else np.char.endswith(self.mode.astype(str), "2")

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Return which rows have joints, load, and a position or another observation. Shape (n,)."""
        located = self.measured if self.observations is None else self.measured | self.observations.observed
        return np.asarray(located & np.isfinite(self.q).all(axis=1) & np.isfinite(self.wrench).all(axis=1))

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Return which rows have all three coordinates of a position. Shape (n,)."""
        return np.asarray(np.isfinite(self.position).all(axis=1))

    @cached_property
    def free_base(self) -> bool:
        """Return whether all observations refer to unknown contact positions: equivalent to an unknown base frame."""
        if self.observations is None or self.measured.any():
            return False
        return bool((self.observations.contact[self.observations.observed] >= 0).all())

    @cached_property
    def load_scale(self) -> float:
        """Return a robust largest force of the log: the 95th percentile. [N]."""
        force = np.linalg.norm(np.nan_to_num(self.wrench[:, :3]), axis=1)
        return float(np.percentile(force, 95)) if len(force) else 0.0

    @cached_property
    def load_varies(self) -> bool:
        """Return whether the external load changes by more than the noise of the sensor."""
        wrench = self.wrench[self.usable]
        if not len(wrench):
            return False
        return bool(self.is_load(np.ptp(np.percentile(wrench, (3, 97), axis=0), axis=0)[None])[0])

    def is_load(self, wrench: Array) -> NDArray[np.bool_]:
        """Return whether each wrench or change of wrench (n, 6) [N, N m] exceeds the sensor's noise. Shape (n,)."""
        force = np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1)
        moment = np.linalg.norm(np.nan_to_num(wrench[:, 3:]), axis=1)
        share = SAME_LOAD * self.load_scale
        return np.asarray((force > max(FORCE_NOISE, share)) | (moment > max(MOMENT_NOISE, share)))

    @cached_property
    def visit(self) -> NDArray[np.int_]:
        """Number the visits: consecutive rows with equal joints, load, target and mode. Shape (n,).

        Every row of a path is a separate visit.
        """
        if not len(self):
            return np.zeros(0, int)
        moved = np.abs(np.diff(np.nan_to_num(self.q), axis=0)).max(1) > STATIC_JITTER
        loaded = self.is_load(np.diff(np.nan_to_num(self.wrench), axis=0))
        new = moved | loaded | (np.diff(self.run_index) > 0) | self.on_path[1:] | (np.diff(self.target_index) != 0)
        if self.mode is not None:
            new |= self.mode[1:] != self.mode[:-1]
        return np.cumsum(np.r_[False, new])

    @cached_property
    def stay(self) -> NDArray[np.int_]:
        """Number the measured poses in time order: consecutive rows with equal joints at any load. Shape (n,).

        Every row of a path counts separately.
        """
        if not len(self):
            return np.zeros(0, int)
        moved = np.abs(np.diff(np.nan_to_num(self.q), axis=0)).max(1) > STATIC_JITTER
        return np.cumsum(np.r_[False, moved | (np.diff(self.run_index) > 0) | self.on_path[1:]])

    @cached_property
    def pose(self) -> NDArray[np.int_]:
        """Return the number of the pose of each row, equal for equal joint positions. Shape (n,)."""
        return number_rows(np.round(np.nan_to_num(self.q) / (20 * STATIC_JITTER)))

    @cached_property
    def last_move(self) -> Array:
        """Return the last nonzero move of each joint, with sign, NaN if unknown. Shape (n, nq). [rad or m]."""
        if self.moved is not None:
            return self.moved
        moves = np.diff(np.nan_to_num(self.q), axis=0, prepend=np.nan_to_num(self.q[:1]))
        jitter = np.where(self.on_path, PATH_JITTER, STATIC_JITTER)
        first = np.r_[True, np.diff(self.run_index) > 0]
        known = (np.abs(moves) > jitter[:, None]) & ~first[:, None]
        start = np.maximum.accumulate(np.where(first, np.arange(len(self)), 0))
        source = np.maximum.accumulate(np.where(known, np.arange(len(self))[:, None], -1), axis=0)
        valid = source >= start[:, None]
        taken = np.take_along_axis(moves, np.maximum(source, 0), axis=0)
        return np.asarray(np.where(valid, taken, np.nan))

    @cached_property
    def approach(self) -> Array:
        """Return the sign of the last move of each joint, 0 if unknown. Shape (n, nq)."""
        return np.asarray(np.sign(np.nan_to_num(self.last_move)))

    @cached_property
    def first_visit(self) -> NDArray[np.bool_]:
        """Return which rows precede the first move of their run, so that their approach is unknown. Shape (n,)."""
        return np.asarray(np.isnan(self.last_move).all(axis=1), bool)

    @cached_property
    def speed(self) -> Array:
        """Return joint speeds on paths, zero at rest and without time. Shape (n, nq). [rad/s or m/s]."""
        result = np.zeros_like(self.q)
        if self.time is None:
            return result
        for number in np.unique(self.run_index[self.on_path]):
            rows = np.flatnonzero((self.run_index == number) & self.on_path & np.isfinite(self.time))
            if len(rows) > 2 and (np.diff(self.time[rows]) > 0).all():
                result[rows] = np.gradient(self.q[rows], self.time[rows], axis=0)
        return result

    @cached_property
    def warming(self) -> Array | None:
        """Return the temperature change since the first row, or None without a temperature. Shape (n,). [K]."""
        if self.temperature is None or not np.isfinite(self.temperature).any():
            return None
        rows = np.arange(len(self))
        known = np.isfinite(self.temperature)
        filled = np.interp(rows, rows[known], self.temperature[known])
        return np.asarray(filled - self.reference_temperature)

    @cached_property
    def reference_temperature(self) -> float:
        """Return the temperature at the first row, by linear regression of the first five readings. [C]."""
        rows = np.zeros(0, int) if self.temperature is None else np.flatnonzero(np.isfinite(self.temperature))[:5]
        if self.temperature is None or not len(rows):
            return float("nan")
        known = self.temperature[rows]
        return float(np.polyval(np.polyfit(rows, known, 1), 0.0)) if len(rows) > 2 else float(known[0])

    @cached_property
    def unloaded(self) -> NDArray[np.bool_]:
        """Return which rows have no external load beyond the noise of the sensor. Shape (n,)."""
        return ~self.is_load(self.wrench)

    def take(self, rows: NDArray[np.int_] | NDArray[np.bool_]) -> Campaign:
        """Select rows, and recompute what depends on their order."""
        fields: dict[str, Any] = {}
        for name in (
            "run", "q", "wrench", "position", "rotation", "time", "temperature", "link", "motor", "sigma",
            "sigma_rotation", "target", "mode", "lines", "moved",
        ):  # fmt: skip
            value = getattr(self, name)
            fields[name] = None if value is None else value[rows]
        return replace(self, **fields, observations=None if self.observations is None else self.observations.take(rows))


def make_log(
    q: ArrayLike, wrench: ArrayLike, position: ArrayLike, rotation: ArrayLike | None = None, *,
    sigma: ArrayLike | None = None, sigma_rotation: ArrayLike | None = None, link_side: ArrayLike = False,
    encoder: ArrayLike | None = None,
) -> Campaign:  # fmt: skip
    """Build a log of static poses from arrays.

    Args:
        q: Commanded joint positions. Shape (n, nq). [rad, m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
        position: Measured point. Shape (n, 3). [m]
        rotation: Measured orientation of the TCP frame as matrices. Shape (n, 3, 3).
        sigma: Standard deviation of position per axis; 0.05 mm is assumed if left out. Scalar or shape (n,). [m]
        sigma_rotation: The same of orientation; 0.1 mrad is assumed if left out. Scalar or shape (n,). [rad]
        link_side: Rows whose q are link-side readings (modes U2 and L2). Scalar or shape (n,).
        encoder: Link-side minus motor-side readings. Shape (n, nq). [rad, m]

    Raises:
        ShapeError: If an array does not have the shape above.
    """
    joints = np.atleast_2d(np.asarray(q, float))
    n = len(joints)

    def shaped(name: str, value: ArrayLike | None, *allowed: tuple[int, ...]) -> Array | None:
        array = None if value is None else np.asarray(value, float)
        if array is not None and array.shape not in allowed:
            raise ShapeError(f"{name} has shape {array.shape}, expected {' or '.join(map(str, allowed))}")
        return None if array is None else np.broadcast_to(array, allowed[0])

    side = np.broadcast_to(np.asarray(link_side, bool), (n,))
    extra, place = shaped("encoder", encoder, joints.shape), shaped("position", position, (n, 3))
    load = shaped("wrench", wrench, (n, 6), (6,))
    assert place is not None and load is not None
    return Campaign(
        run=np.array(["static_1"] * n),
        q=joints,
        wrench=load,
        position=place,
        rotation=shaped("rotation", rotation, (n, 3, 3)),
        link=None if extra is None else joints + extra,
        sigma=shaped("sigma", ASSUMED_SIGMA_POSITION if sigma is None else sigma, (n,), ()),
        sigma_rotation=shaped(
            "sigma_rotation", ASSUMED_SIGMA_ROTATION if sigma_rotation is None else sigma_rotation, (n,), ()
        ),
        mode=np.where(side, "L2", "L1") if side.any() else None,
    )
