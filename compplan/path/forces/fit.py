"""A measured force log beside the prediction: which coefficients fit it, with intervals.

The mean wrench of a cutter is linear in its coefficients, so that a linear least-squares fit finds them; for every
other model one factor for each path axis is fitted. Errors along a path hang together: the 95 % intervals come from
leaving out blocks of the path in turn (jackknife), not from the scatter of single rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.files.columns import FileColumn
from compplan.files.tables import Array, read_table
from compplan.path.contact import cutting_progress, path_axes
from compplan.path.force_law import ForceLaw
from compplan.path.toolpath import WRENCH, Toolpath

#: Least share of the cut that a log spans: less is a length in metres that was called mm (assumed).
LEAST_SPAN = 0.01
#: Blocks of the path that are left out in turn, and rows in contact that a fit needs.
BLOCKS, FEWEST = 20, 40
#: Student's t of 95 % with BLOCKS - 1 degrees of freedom.
STUDENT = 2.093
#: Lengths that differ by less are the same waypoint. [m]
SAME = 1e-9
#: A force below this share of the greatest counts as the air. []
AIR = 0.02
#: No tool bears more, and no prediction errs by more than this factor: beyond, a unit is wrong (assumed). [N, 1]
MOST_FORCE, MOST_RATIO = 1e6, 100.0
NAMES = ("tangential", "radial", "axial")

COLUMNS = (
    FileColumn("s", "length", required=True),
    *(FileColumn(name, "force", required=True) for name in WRENCH[:3]),
    *(FileColumn(name, "moment", group="moment") for name in WRENCH[3:]),
)


@dataclass(frozen=True)
class ForceLog:
    """A measured log; m rows.

    Attributes:
        s: Length cut so far. Shape (m,). [m]
        force: On the tool, part axes. Shape (m, 3). [N]

    """

    s: Array
    force: Array


@dataclass(frozen=True)
class FittedNumber:
    """A number that was fitted: value in the job, best value, 95 % interval, unit."""

    name: str
    in_job: float
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class ForceFit:
    """The comparison with a log.

    Attributes:
        numbers: What was fitted.
        rms_before: Of measured minus predicted force. [N]
        rms_after: The same with the fitted numbers. [N]
        level: Root mean square of the measured force. [N]
        rows: Rows in contact that were used.
        measured: Force at the rows, path axes. Shape (m, 3). [N]
        s: Length cut so far at the rows. Shape (m,). [m]

    """

    numbers: tuple[FittedNumber, ...]
    rms_before: float
    rms_after: float
    level: float
    rows: int
    measured: Array
    s: Array


def read_force_log(path: Path) -> ForceLog:
    """Read a log: CSV with s_mm (the length cut so far) and fx_N fy_N fz_N, part axes.

    Raises:
        InputError: If it is not what it has to be.

    """
    table = read_table(path, COLUMNS)
    s = table.values["s"]
    if len(s) < 2:
        raise table.error(f"{len(s)} rows, expected at least 2")
    back = np.flatnonzero(np.diff(s) < 0.0)
    if len(back):
        raise table.error("s_mm falls here; rows must stand in the order of the path", int(back[0]) + 1)
    force = np.column_stack([table.values[name] for name in WRENCH[:3]])
    wrong = np.abs(force).max(axis=1) > MOST_FORCE
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise table.error(f"a force of {np.abs(force[row]).max():.3g} N, at most {MOST_FORCE:g} N is allowed", row)
    return ForceLog(s, force)


def fit_forces(log: ForceLog, law: ForceLaw, nominal: Toolpath, file: Path) -> ForceFit:
    """Compare a log with the prediction, and find the numbers that fit it.

    Args:
        log: What was measured.
        law: The prediction.
        nominal: The path, base frame, with its predicted wrench.
        file: The log's file, for messages.

    Raises:
        InputError: If too few rows lie in the cut.

    """
    progress = cutting_progress(nominal)
    axes = path_axes(nominal)
    near = np.clip(np.searchsorted(progress, log.s - SAME), 0, len(progress) - 1)
    measured = np.einsum("nji,nj->ni", axes[near], log.force @ law.T_base_part[:3, :3].T)
    columns, names, unit, in_job = _columns(law, nominal, axes)
    columns = np.stack(
        [np.stack([np.interp(log.s, progress, column[:, k]) for k in range(3)], axis=1) for column in columns]
    )
    predicted = np.einsum("c,cmk->mk", in_job, columns)
    size = np.linalg.norm(predicted, axis=1)
    along = (log.s >= -1e-6) & (log.s <= progress[-1] + 1e-6)
    cut = np.flatnonzero((size > AIR * size.max(initial=0.0)) & along)
    if len(cut) < FEWEST:
        raise InputError(f"{len(cut)} rows lie in the cut, a comparison needs {FEWEST}; check s_mm", file=file)
    if (places := len(np.unique(log.s[cut]))) < BLOCKS:
        raise InputError(f"s_mm has {places} values in the cut, a comparison needs {BLOCKS}", file=file)
    if (span := float(np.ptp(log.s[cut]))) < LEAST_SPAN * progress[-1]:
        message = f"s_mm spans {1e3 * span:.3g} mm of a cut of {1e3 * progress[-1]:.4g} mm: check its unit"
        raise InputError(message, file=file)
    columns, measured = columns[:, cut], measured[cut]
    _check_level(measured, predicted[cut], file)
    known = np.abs(columns).max(axis=(1, 2)) > 0.0
    matrix, target = columns[known].reshape(known.sum(), -1).T, measured.reshape(-1)
    value = np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    block = np.repeat(np.arange(len(cut)) * BLOCKS // len(cut), 3)
    left = np.array([np.linalg.lstsq(matrix[block != b], target[block != b], rcond=1e-10)[0] for b in range(BLOCKS)])
    spread = STUDENT * np.sqrt((BLOCKS - 1) / BLOCKS * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    numbers = tuple(
        FittedNumber(name, float(was), float(v), float(v - d), float(v + d), u)
        for name, was, v, d, u in zip(
            np.array(names)[known], in_job[known], value, spread, np.array(unit)[known], strict=True
        )
    )
    before = np.einsum("c,cmk->mk", in_job, columns) - measured
    after = target - matrix @ value
    return ForceFit(
        numbers, float(np.sqrt((before**2).sum(axis=1).mean())), float(np.sqrt((after**2).sum() / len(cut))),
        float(np.sqrt((measured**2).sum(axis=1).mean())), len(cut), measured, log.s[cut],
    )  # fmt: skip


def _check_level(measured: Array, predicted: Array, file: Path) -> None:
    """Refuse a log whose forces are of another magnitude than the predicted ones. Shapes (m, 3). [N]"""
    level, wanted = (float(np.sqrt((force**2).sum(axis=1).mean())) for force in (measured, predicted))
    if not wanted / MOST_RATIO <= level <= wanted * MOST_RATIO:
        message = f"force in the cut is {level:.3g} N (rms), {wanted:.3g} N is predicted: check units and s_mm"
        raise InputError(message, file=file)


def _columns(law: ForceLaw, nominal: Toolpath, axes: Array) -> tuple[Array, list[str], list[str], Array]:
    """Return what each number contributes at its unit, path axes; names, units, and values now. Shape (c, n, 3)."""
    if law.cutting is not None:
        resistance = law.cutting.process.resistance
        per_tooth = law.cutting.process.spindle().feed_per_tooth(nominal.feed)
        every = law.cutting.shape.columns(resistance.exponent, per_tooth) * ~nominal.rapid[:, None, None]
        names = [f"{part} cutting coefficient" for part in NAMES] + [f"{part} edge coefficient" for part in NAMES]
        values = np.array([*resistance.cutting, *resistance.edge])
        return np.swapaxes(every[:, :, :3], 0, 1), names, ["N/mm2"] * 3 + ["N/mm"] * 3, values
    wrench = np.zeros((len(nominal), 6)) if nominal.wrench is None else nominal.wrench
    local = np.einsum("nji,nj->ni", axes, wrench[:, :3])
    columns = np.stack([local * np.eye(3)[k] for k in range(3)])
    names = [f"factor {where}" for where in ("along the travel", "to the left", "along the tool axis")]
    return columns, names, ["1"] * 3, np.ones(3)
