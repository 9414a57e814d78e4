"""Fit of force coefficients to a measured force log, with intervals.

The mean wrench of a cutter is linear in its coefficients; for every other model one factor for each path axis is
fitted. Errors of the log are fitted as well: an offset and a drift of each channel (rows in the air determine them)
and one lag, the length by which the log is behind the path. The lag is found by search up to `MOST_LAG`, the rest is
linear. Channels are weighted by their residuals. Errors along a path are correlated. The 95 % intervals are therefore
from a jackknife over blocks of the path (with the lag as a derivative), not from the scatter of single rows. The same
blocks give the share of variance that the fit explains of left-out rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize_scalar

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.process.force_law import ForceLaw
from compplan.process.force_models.file import FILE_COLUMNS
from compplan.process.materials import Coefficients
from compplan.toolpath.contact import cutting_progress, path_axes
from compplan.toolpath.toolpath import WRENCH, Toolpath

#: Least share of the cut in a log; below, its length is assumed to be in metres instead of mm.
LEAST_SPAN = 0.01
#: Jackknife blocks of the path, and fewest rows in contact for a fit.
BLOCKS, FEWEST = 40, 80
#: Student's t for 95 % with BLOCKS - 1 degrees of freedom.
STUDENT = 2.023
#: Difference of length below which waypoints are the same. [m]
SAME = 1e-9
#: Share of the greatest force below which a row counts as in the air. []
AIR = 0.02
#: Share of the greatest contribution below which a number is rounding and cannot be determined from the log. []
ROUNDING = 1e-9
#: Ratio of measured and predicted force beyond which a unit must be wrong (assumed). []
MOST_RATIO = 100.0
#: Range of fitted over predicted force; outside, the log may be of another cut (assumed).
PLAUSIBLE = (0.2, 5.0)
#: Greatest lag in the search, to either side: as a length [m], and as a share of the cut (assumed).
MOST_LAG, LAG_SHARE = 0.02, 0.2
#: Steps of the lag search to either side; greatest number of rows in the search and in the fit (means of neighbours).
LAGS, LAG_ROWS, MOST_ROWS = 60, 1500, 50_000
#: Least half step of the derivative to the lag [m]; otherwise half of a row, because a force jumps between rows.
LAG_STEP = 1e-5
#: Least explained share of the variance of left-out rows for an acceptable fit (assumed).
EXPLAINED = 0.3
NAMES = ("tangential", "radial", "axial")
#: Force above which a unit must be wrong (assumed). [N]
MOST_FORCE = 1e6

COLUMNS = (FILE_COLUMNS[0], FileColumn("t", "time"), *FILE_COLUMNS[1:])


@dataclass(frozen=True)
class ForceLog:
    """A measured force log; m rows."""

    place: Array  #: Length cut so far [m], or time of cutting so far [s]. Shape (m,).
    timed: bool  #: Whether `place` is a time.
    wrench: Array  #: Wrench on the tool at its tip, part axes; 3 columns without moments. Shape (m, 3 or 6). [N, N m]


def read_force_log(path: Path) -> ForceLog:
    """Read a log: CSV with s_mm or t_s (length or time cut so far), fx_N fy_N fz_N and moments, part axes.

    Raises:
        InputError: If the file is not valid.
    """
    table = read_table(path, COLUMNS)
    timed = "t" in table.values
    if timed == ("s" in table.values):
        raise table.error("needs one of the columns s_mm and t_s, the length or the time cut so far")
    place = table.values["t" if timed else "s"]
    if len(place) < 2:
        raise table.error(f"{len(place)} rows, expected at least 2")
    back = np.flatnonzero(np.diff(place) < 0.0)
    if len(back):
        name = "t_s" if timed else "s_mm"
        raise table.error(f"{name} falls here; rows must be in the order of the path", int(back[0]) + 1)
    wrench = np.column_stack([table.values[name] for name in WRENCH if name in table.values])
    wrong = np.abs(wrench[:, :3]).max(axis=1) > MOST_FORCE
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise table.error(f"a force of {np.abs(wrench[row, :3]).max():.3g} N, at most {MOST_FORCE:g} N is allowed", row)
    return ForceLog(place, timed, wrench)


@dataclass(frozen=True)
class FittedNumber:
    """A fitted number: value in the job, best value, 95 % interval, unit."""

    name: str
    in_job: float
    value: float
    low: float
    high: float
    unit: str

    @property
    def determined(self) -> bool:
        """Return whether the interval excludes half and double the value; lag, offset and drift count as determined."""
        return self.in_job == 0.0 or self.high - self.low < abs(self.value)


@dataclass(frozen=True)
class ForceFit:
    """Result of the comparison with a log."""

    #: Fitted numbers: those of the force, then lag, and offset and drift of each force.
    numbers: tuple[FittedNumber, ...]
    rms_before: float  #: Root mean square of measured minus predicted force. [N]
    rms_after: float  #: The same with the fitted numbers. [N]
    level: float  #: Root mean square of the measured force. [N]
    rows: int  #: Number of rows in contact.
    notes: tuple[str, ...]  #: Notes on the fit, one sentence each.
    #: Coefficients of the cutter in the form of a job, edge ones not below 0; None for other models.
    coefficients: Coefficients | None
    ratio: tuple[float, float]  #: Fitted over predicted force along the log, and its standard deviation.

    @property
    def level_warning(self) -> str:
        """Warning that the log may be of another cut, "" if the force ratio is plausible within two sigma."""
        level, wide = self.ratio[0], 2.0 * self.ratio[1]
        if level + wide >= PLAUSIBLE[0] and level - wide <= PLAUSIBLE[1]:
            return ""
        return f"The log fits {level:.2g} times the predicted force: check that it is of this cut, and the force frame."


@dataclass(frozen=True)
class _Prediction:
    """Contribution of each of c numbers along the path, per unit; n waypoints."""

    progress: Array  #: Length cut so far. Shape (n,). [m]
    columns: Array  #: Contributions in path axes; forces, then moments. Shape (c, n, 6).
    axes: Array  #: Path axes as columns, part frame. Shape (n, 3, 3).
    names: list[str]
    units: list[str]
    in_job: Array

    def at(self, s: Array, channels: int) -> Array:
        """Return the contributions at lengths cut, part axes; zero off the cut. Shape (c, m, k)."""
        near = np.clip(np.searchsorted(self.progress, s - SAME), 1, len(self.progress) - 1)
        span = self.progress[near] - self.progress[near - 1]
        share = np.clip((s - self.progress[near - 1]) / np.maximum(span, SAME), 0.0, 1.0)[:, None]
        local = (1.0 - share) * self.columns[:, near - 1] + share * self.columns[:, near]
        local *= ((s >= -SAME) & (s <= self.progress[-1] + SAME))[:, None]
        turned = [np.einsum("mij,cmj->cmi", self.axes[near], local[:, :, k : k + 3]) for k in range(0, channels, 3)]
        return np.concatenate(turned, axis=2)


def fit_forces(log: ForceLog, law: ForceLaw, nominal: Toolpath, file: Path) -> ForceFit:
    """Compare a log with the prediction along the path in the base frame, and fit the numbers of the force.

    Raises:
        InputError: If too few rows are in the cut, or the prediction does not explain the log.
    """
    model = _predict(law, nominal)
    # forces and moments for a cutter, only forces for other models
    channels = 3 if law.cutting is None else log.wrench.shape[1]
    s, measured = _pool(_lengths(log, nominal, model.progress), log.wrench[:, :channels], MOST_ROWS)
    columns = model.at(s, channels)
    predicted, most_of = np.einsum("c,cmk->mk", model.in_job, columns), np.abs(columns).max(axis=(1, 2))
    known = most_of > ROUNDING * most_of.max(initial=0.0)
    cut = _find_cut(s, predicted, model.progress[-1], file)
    _check_level(measured[cut, :3], predicted[cut, :3], file)
    tare = np.column_stack([np.ones(len(s)), (s - s.mean()) / max(float(np.ptp(s)), SAME)])
    scale, most = measured.std(axis=0) + 1e-12, min(MOST_LAG, LAG_SHARE * float(model.progress[-1]))
    for _ in range(2):
        lag = _find_lag(model, s, measured / scale, channels, scale, tare, most)
        design = _design(model, s - lag, channels, known, tare)
        value, left = _solve(design / scale[:, None], measured / scale)
        scale = scale * left.std(axis=0) + 1e-12
    matrix = np.concatenate([design, _slope(model, s - lag, channels, known, value)], axis=2) / scale[:, None]
    left = (measured - np.einsum("mkc,c->mk", design, value)) / scale
    value = np.append(value, lag)
    covariance, unseen = _jackknife(matrix, measured / scale, len(s))
    if unseen < EXPLAINED:
        message = (f"the prediction explains {100 * max(unseen, 0.0):.0f} % of the log, {100 * EXPLAINED:.0f} % needed "
                   f"(tried lags: {1e3 * most:.3g} mm); check that job and log are of the same cut, the frame of the "
                   f"force, and {'t_s' if log.timed else 's_mm'}")  # fmt: skip
        raise InputError(message, file=file)
    sigma = np.sqrt(np.diag(covariance))
    # the position of a jump of force is not known better than a row of the log
    sigma[-1] = np.hypot(sigma[-1], float(np.median(np.diff(s))) / np.sqrt(12.0))
    numbers = _list_numbers(model, known, value, sigma)
    notes = [f"No fit of the {model.names[k]}: no such force is predicted." for k in np.flatnonzero(~known)]
    notes += _describe(numbers, int(known.sum()), lag, most)
    before = predicted[cut, :3] - measured[cut, :3]
    after = (left * scale)[cut, :3]
    return ForceFit(
        numbers, _rms(before), _rms(after), _rms(measured[cut, :3]), len(cut), tuple(notes),
        _as_job_holds(law, known, matrix, measured / scale, covariance, file),
        _compare_levels(design[:, :3], model.in_job[known], value, covariance),
    )  # fmt: skip


def _compare_levels(columns: Array, wanted: Array, value: Array, covariance: Array) -> tuple[float, float]:
    """Return the ratio of fitted to wanted force, in the direction of the wanted one, and its standard deviation.

    `columns` is the contribution of each number to the force at the rows, shape (m, 3, c), the c wanted ones first.
    """
    own = len(wanted)
    force = columns[:, :, :own] @ wanted
    slope = np.einsum("mkc,mk->c", columns[:, :, :own], force) / max(float((force**2).sum()), 1e-300)
    return float(slope @ value[:own]), float(np.sqrt(max(slope @ covariance[:own, :own] @ slope, 0.0)))


def _rms(force: Array) -> float:
    return float(np.sqrt((force**2).sum(axis=1).mean()))


def _predict(law: ForceLaw, nominal: Toolpath) -> _Prediction:
    """Return the contribution of each number of the force along the path."""
    axes = path_axes(nominal)
    if law.cutting is not None:
        process = law.cutting.process
        resistance, per_tooth = process.resistance, process.feed_per_tooth(nominal.feed)
        columns = law.cutting.shape.columns(resistance.exponent, per_tooth) * ~nominal.rapid[:, None, None]
        columns = np.swapaxes(columns, 0, 1)
        names = [f"{part} {kind} coefficient" for kind in ("cutting", "edge") for part in NAMES]
        units, in_job = ["N/mm2"] * 3 + ["N/mm"] * 3, np.array([*resistance.cutting, *resistance.edge])
    else:
        wrench = np.zeros((len(nominal), 6)) if nominal.wrench is None else nominal.wrench
        local = np.concatenate([np.einsum("nji,nj->ni", axes, wrench[:, k : k + 3]) for k in (0, 3)], axis=1)
        columns = np.stack([local * np.tile(np.eye(3)[k], 2) for k in range(3)])
        names = [f"factor {where}" for where in ("along the travel", "to the left", "along the tool axis")]
        units, in_job = ["1"] * 3, np.ones(3)
    R = np.einsum("ji,njk->nik", law.T_base_part[:3, :3], axes)
    return _Prediction(cutting_progress(nominal), columns, R, names, units, in_job)


def _lengths(log: ForceLog, nominal: Toolpath, progress: Array) -> Array:
    """Return the length cut so far at each row. Shape (m,). [m]"""
    if not log.timed:
        return log.place
    step = np.diff(progress) / np.maximum(nominal.feed[1:], 1e-9)
    time = np.concatenate([[0.0], np.cumsum(step)])
    inside = np.interp(log.place, time, progress)
    # before and after the cut at the median feed
    feed = max(float(np.median(nominal.feed[~nominal.rapid])), 1e-9)
    beyond = np.minimum(log.place - time[0], 0.0) + np.maximum(log.place - time[-1], 0.0)
    return np.asarray(inside + feed * beyond)


def _pool(s: Array, measured: Array, most: int) -> tuple[Array, Array]:
    """Return means of consecutive rows, so that at most `most` remain."""
    size = -(-len(s) // most)
    if size < 2:
        return s, measured
    start = np.arange(0, len(s), size)
    count = np.diff(np.append(start, len(s)))
    return np.add.reduceat(s, start) / count, np.add.reduceat(measured, start) / count[:, None]


def _find_cut(s: Array, predicted: Array, end: float, file: Path) -> NDArray[np.int_]:
    """Return the rows in the cut.

    Raises:
        InputError: If there are too few.
    """
    size = np.linalg.norm(predicted[:, :3], axis=1)
    cut = np.flatnonzero(size > AIR * size.max(initial=0.0))
    if len(cut) < FEWEST:
        raise InputError(f"{len(cut)} rows lie in the cut, a comparison needs {FEWEST}; check s_mm", file=file)
    if (places := len(np.unique(s[cut]))) < BLOCKS:
        raise InputError(f"s_mm has {places} different values in the cut, a comparison needs {BLOCKS}", file=file)
    if (span := float(np.ptp(s[cut]))) < LEAST_SPAN * end:
        message = f"s_mm spans {1e3 * span:.3g} mm of a cut of {1e3 * end:.4g} mm: check its unit"
        raise InputError(message, file=file)
    return cut


def _design(model: _Prediction, s: Array, channels: int, known: NDArray[np.bool_], tare: Array) -> Array:
    """Return the columns of the linear fit: the numbers, then offset and drift of each channel. Shape (m, k, c)."""
    own = np.moveaxis(model.at(s, channels)[known], 0, 2)
    each = np.einsum("mt,kl->mklt", tare, np.eye(channels)).reshape(len(s), channels, 2 * channels)
    return np.concatenate([own, each], axis=2)


def _slope(model: _Prediction, s: Array, channels: int, known: NDArray[np.bool_], value: Array) -> Array:
    """Return the derivative of the predicted channels to the lag. Shape (m, k, 1). [N or N m per metre]"""
    step = max(LAG_STEP, 0.5 * float(np.median(np.diff(s))))
    behind, ahead = (model.at(s + side * step, channels)[known] for side in (-1.0, 1.0))
    return np.asarray(np.einsum("cmk,c->mk", behind - ahead, value[: known.sum()])[:, :, None] / (2.0 * step))


def _solve(matrix: Array, target: Array) -> tuple[Array, Array]:
    """Return the least-squares solution and its residuals. Shapes (c,), (m, k)."""
    value = np.linalg.lstsq(matrix.reshape(-1, matrix.shape[2]), target.reshape(-1), rcond=1e-10)[0]
    return np.asarray(value), np.asarray(target - np.einsum("mkc,c->mk", matrix, value))


def _find_lag(
    model: _Prediction, s: Array, target: Array, channels: int, scale: Array, tare: Array, most: float
) -> float:
    """Return the lag with the least residual. [m]"""
    rows = np.arange(0, len(s), -(-len(s) // LAG_ROWS))
    every, wanted = np.ones(len(model.names), dtype=bool), target[rows]

    def left(lag: float) -> float:
        flat = (_design(model, s[rows] - lag, channels, every, tare[rows]) / scale[:, None]).reshape(wanted.size, -1)
        value = np.linalg.lstsq(flat.T @ flat, flat.T @ wanted.reshape(-1), rcond=1e-12)[0]
        return float(((wanted.reshape(-1) - flat @ value) ** 2).sum())

    steps = np.linspace(-most, most, 2 * LAGS + 1)
    found = np.array([left(float(lag)) for lag in steps])
    best = int(np.argmin(found))
    low, high = steps[max(best - 1, 0)], steps[min(best + 1, 2 * LAGS)]
    refined = minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    return float(refined.x) if refined.fun < found[best] else float(steps[best])


def _jackknife(matrix: Array, target: Array, rows: int) -> tuple[Array, float]:
    """Return the jackknife covariance of the numbers, and the explained share of the variance of left-out rows.

    The last column is the derivative to the lag, relative to the fitted lag.
    """
    c, block = matrix.shape[2], np.arange(rows) * BLOCKS // rows
    normal = np.stack([np.einsum("mkc,mkd->cd", matrix[block == b], matrix[block == b]) for b in range(BLOCKS)])
    right = np.stack([np.einsum("mkc,mk->c", matrix[block == b], target[block == b]) for b in range(BLOCKS)])
    size = np.sqrt(np.maximum(np.diag(normal.sum(axis=0)), 1e-300))
    left_out = np.stack([
        np.linalg.lstsq((normal.sum(axis=0) - normal[b]) / np.outer(size, size), (right.sum(axis=0) - right[b]) / size,
                        rcond=1e-12)[0] / size
        for b in range(BLOCKS)
    ])  # fmt: skip
    away = left_out - left_out.mean(axis=0)
    covariance = (BLOCKS - 1) / BLOCKS * np.einsum("bc,bd->cd", away, away)
    own = c - 1 - 2 * target.shape[1]
    unseen = target - np.einsum("mkc,mc->mk", matrix, left_out[block])
    flat = target - np.einsum("mkc,mc->mk", matrix[:, :, own:-1], left_out[block][:, own:-1])
    return covariance, float(1.0 - (unseen**2).sum() / max(float((flat**2).sum()), 1e-300))


def _list_numbers(model: _Prediction, known: NDArray[np.bool_], value: Array, sigma: Array) -> tuple[FittedNumber, ...]:
    """Return the numbers with their intervals: those of the model, the lag, offsets and drifts of the forces."""
    own = int(known.sum())
    kept = np.flatnonzero(known)
    rows = [(model.names[k], float(model.in_job[k]), i, 1.0, model.units[k]) for i, k in enumerate(kept)]
    rows.append(("lag of the log", 0.0, len(value) - 1, 1e3, "mm"))
    for axis, name in enumerate("xyz"):
        rows += [(f"offset of f{name}", 0.0, own + 2 * axis, 1.0, "N"),
                 (f"drift of f{name} over the log", 0.0, own + 2 * axis + 1, 1.0, "N")]  # fmt: skip
    return tuple(
        FittedNumber(name, was, float(u * value[i]), float(u * (value[i] - STUDENT * sigma[i])),
                     float(u * (value[i] + STUDENT * sigma[i])), unit)
        for name, was, i, u, unit in rows
    )  # fmt: skip


def _describe(numbers: tuple[FittedNumber, ...], own: int, lag: float, most: float) -> list[str]:
    """Return notes on an unusual fit."""
    notes = []
    if abs(lag) > 0.98 * most:
        notes.append(f"The log fits best at the end of the lags that were tried, {1e3 * lag:.3g} mm: check s_mm.")
    for number in numbers[:own]:
        if number.value < 0.0 <= number.high:
            notes.append(f"The {number.name} is fitted below 0 and may as well be 0 by this log.")
        elif number.high < 0.0 and not number.name.startswith("axial"):
            notes.append(f"The {number.name} is fitted below 0 for sure, which no cut does: the model does not fit "
                         "this log; check cutter, stock, direction of cut and frame of the log.")  # fmt: skip
        elif not number.determined:
            air = ", it may be an offset of the sensor: log stretches in the air before and after the cut, too"
            notes.append(f"The {number.name} is NOT DETERMINED by this log{air * (number.unit == '1')}.")
    return notes


def _as_job_holds(
    law: ForceLaw, known: NDArray[np.bool_], matrix: Array, target: Array, covariance: Array, file: Path
) -> Coefficients | None:
    """Return coefficients in the form of a job: edge ones not below 0, uncertainty of the level along this cut."""
    if law.cutting is None:
        return None
    own = int(known.sum())
    edge = np.flatnonzero(known) >= 3
    low = np.full(matrix.shape[2], -np.inf)
    low[:own][edge] = 0.0
    flat = matrix.reshape(-1, matrix.shape[2])
    upper = np.linalg.qr(np.column_stack([flat, target.reshape(-1)]))[1]
    held = lsq_linear(upper[:, :-1], upper[:, -1], bounds=(low, np.inf)).x[:own]
    every = np.zeros(6)
    every[known] = held
    spread = _compare_levels(matrix[:, :3], held, held, covariance)[1]
    resistance = law.cutting.process.resistance
    return Coefficients(
        (every[0], every[1], every[2]), (every[3], every[4], every[5]), resistance.exponent,
        uncertainty=max(round(spread, 4), 1e-4), source=f"fitted to {file.name}",
    )  # fmt: skip


def _check_level(measured: Array, predicted: Array, file: Path) -> None:
    """Refuse a log with forces of another magnitude than the predicted ones. Shapes (m, 3). [N]"""
    level, wanted = _rms(measured), _rms(predicted)
    if not wanted / MOST_RATIO <= level <= wanted * MOST_RATIO:
        message = f"force in the cut is {level:.3g} N (rms), {wanted:.3g} N is predicted: check units and s_mm"
        raise InputError(message, file=file)
