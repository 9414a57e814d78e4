"""uncertainty.toml: covariance of the parameters of a robot folder, and the unmodelled error.

    schema = 1
    grade  = "measured"                # measured | literature | assumed
    source = "diagnosed from log.csv, 120 rows at 60 poses"
    repeatability_mm = 0.03            # optional; one standard deviation, per axis

    [unexplained]                      # smooth unmodelled error over the workspace
    rms_mm   = 0.02                    # of the 3D distance
    scale_mm = 300.0                   # correlation length

    [calibration]                      # conformal factor from poses left out of the fit
    factor = 1.1                       # widens unknowns and unexplained
    groups = 60

    [[unknown]]                        # parameters of one effect, as in effects.toml, relative to the folder
    effect    = "joint_stiffness"
    joint     = "joint_2"
    keys      = ["compliance_change_rad_per_Nm"]
    deviation = [1.2e-8]               # one standard deviation, SI
    factor    = [[0.6, 0.8]]           # one row per key: correlation = F F^T, rows of length 1

A row of F gives the columns from the first on; the rest are zero. Unknowns without `factor` are independent of all
others. A key "name#i" is item i of the list "name"; `fixed` holds settings of the effect that are not unknown.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import Field

from compplan.errors import InputError
from compplan.io.quantities import shorten
from compplan.io.tables import Array
from compplan.io.tomlfile import Numbers, SchemaOne, StrictTable, Words, read_toml_model

FILE = "uncertainty.toml"
#: Greatest number of parameters of a folder.
MOST_UNKNOWN = 1000
#: Least correlation length. [mm]
LEAST_LENGTH_MM = 1e-3
#: Rounding of the unit length of a row of the factor; shares below the second number are not written.
ROUNDING, NOTHING = 1e-3, 1e-5


@dataclass(frozen=True, eq=False)
class Unknown:
    """Parameters of one effect at one place, about the values of the robot folder."""

    effect: str  #: Name of the effect.
    joint: str | None  #: Its joint, or None.
    axis: str | None  #: Its axis, or None.
    keys: tuple[str, ...]  #: Parameters; "name#i" is item i of the list "name". Length k.
    deviation: Array  #: Standard deviation of each. Shape (k,). [SI]
    fixed: Mapping[str, Any] = field(default_factory=dict)  #: Settings of the effect that are not unknown.

    @property
    def names(self) -> tuple[str, ...]:
        """Readable names of the parameters."""
        place = " ".join(part for part in (self.effect, self.joint, self.axis) if part is not None)
        waves = self.fixed.get("cycles_per_turn") or self.fixed.get("cycles_per_m")
        label = f"{place}, {', '.join(f'{w:g}' for w in waves)} cycles" if waves else place
        return tuple(label if len(self.keys) == 1 else f"{label}, {key}" for key in self.keys)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Normal distribution of p parameters about the values of a robot folder, mean zero."""

    grade: str  #: "measured", "literature" or "assumed".
    source: str  #: Source.
    unknowns: tuple[Unknown, ...] = ()  #: The parameters, effect by effect; p in all.
    factor: Array = field(default_factory=lambda: np.zeros((0, 0)))  #: Correlation is F F^T. Shape (p, r).
    unexplained: float = 0.0  #: Rms 3D distance of the unmodelled error. [m]
    scale: float = 0.3  #: Its correlation length. [m]
    repeatability: float | None = None  #: Standard deviation of the robot per axis, or None. [m]
    calibration: float = 1.0  #: Factor on all deviations from poses left out of the fit.
    groups: int = 0  #: Number of groups of such poses.

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters. Length p."""
        return tuple(name for unknown in self.unknowns for name in unknown.names)

    @property
    def width(self) -> Array:
        """Standard deviation of every parameter, with calibration. Shape (p,). [SI]."""
        stated = [unknown.deviation for unknown in self.unknowns]
        return self.calibration * np.concatenate(stated) if stated else np.zeros(0)

    @property
    def spread(self) -> Array:
        """Square root of the covariance: covariance = spread spread^T. Shape (p, r). [SI]."""
        return np.asarray(self.width[:, None] * self.factor)

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, with calibration. Shape (p, p). [SI]."""
        return np.asarray(self.spread @ self.spread.T)

    @property
    def smooth(self) -> float:
        """Standard deviation of the unmodelled error per axis, with calibration. [m]."""
        return float(self.calibration * self.unexplained / np.sqrt(3.0))

    def with_covariance(self, covariance: Array) -> Uncertainty:
        """Replace the covariance (with calibration, shape (p, p))."""
        unknowns, factor = spread_unknowns(self.unknowns, covariance / self.calibration**2)
        return replace(self, unknowns=unknowns, factor=factor)

    def select(self, keep: Iterable[bool]) -> Uncertainty:
        """Keep some of the unknowns (a mask) with their marginal covariance."""
        flags = list(keep)
        rows = np.concatenate(
            [np.full(len(u.keys), flag) for u, flag in zip(self.unknowns, flags, strict=True)] or [np.zeros(0, bool)]
        )
        unknowns = tuple(u for u, flag in zip(self.unknowns, flags, strict=True) if flag)
        return replace(self, unknowns=unknowns, factor=self.factor[rows])


def split_unknowns(unknowns: Sequence[Unknown], values: Array) -> list[tuple[Unknown, Array]]:
    """Return each unknown with its values. values: shape (p,)."""
    ends = np.cumsum([len(unknown.keys) for unknown in unknowns])
    return list(zip(unknowns, np.split(np.asarray(values, float), ends[:-1]), strict=True)) if len(ends) else []


def spread_unknowns(unknowns: Sequence[Unknown], covariance: Array) -> tuple[tuple[Unknown, ...], Array]:
    """Return unknowns with the deviations of a covariance, shape (p, p), and the factor of its correlation."""
    deviation, factor = factor_covariance(covariance)
    return tuple(replace(u, deviation=own) for u, own in split_unknowns(unknowns, deviation)), factor


def factor_covariance(covariance: Array) -> tuple[Array, Array]:
    """Return deviations, shape (p,), and the lower triangular factor of the correlation, shape (p, p).

    Args:
        covariance: Symmetric, positive semidefinite. Shape (p, p).
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(deviation > 0, deviation, 1.0)
    value, vector = np.linalg.eigh(covariance / np.outer(unit, unit))
    # triangular factor of V sqrt(D)
    triangle = np.asarray(np.linalg.qr((vector * np.sqrt(np.maximum(value, 0.0))).T).R).T.copy()
    length = np.linalg.norm(triangle, axis=1, keepdims=True)
    alone = length[:, 0] < 1e-12
    triangle[alone] = np.eye(len(covariance))[alone]
    return deviation, np.asarray(triangle / np.where(length < 1e-12, 1.0, length))


class UnexplainedTable(StrictTable):
    """[unexplained]: the unmodelled error."""

    rms_mm: float = Field(ge=0.0, le=100.0)
    scale_mm: float = Field(default=300.0, ge=LEAST_LENGTH_MM, le=1e5)


class CalibrationTable(StrictTable):
    """[calibration]: factor from poses left out of the fit."""

    factor: float = Field(ge=0.1, le=100.0)
    groups: Annotated[int, Field(ge=0, le=1_000_000)]


class UnknownTable(StrictTable):
    """[[unknown]]: parameters of one effect at a place."""

    effect: str = Field(min_length=1)
    joint: str | None = None
    axis: str | None = None
    fixed: dict[str, Any] = Field(default_factory=dict)
    keys: Annotated[Words, Field(min_length=1, max_length=MOST_UNKNOWN)]
    deviation: Annotated[tuple[Annotated[float, Field(ge=0.0)], ...], Field(strict=False)]
    factor: Annotated[tuple[Numbers, ...], Field(strict=False)] | None = None


class UncertaintyTable(StrictTable):
    """uncertainty.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    grade: Literal["measured", "literature", "assumed"]
    source: str
    repeatability_mm: float | None = Field(default=None, ge=0.0, le=10.0)
    unexplained: UnexplainedTable = UnexplainedTable.model_construct(rms_mm=0.0)
    calibration: CalibrationTable = CalibrationTable.model_construct(factor=1.0, groups=0)
    unknown: Annotated[tuple[UnknownTable, ...], Field(strict=False, max_length=MOST_UNKNOWN)] = ()


def read_uncertainty(file: Path) -> Uncertainty | None:
    """Read uncertainty.toml, or return None without the file.

    Raises:
        InputError: With file and key, if it is invalid.
    """
    if not file.exists():
        return None
    table = read_toml_model(UncertaintyTable, file)
    rows: list[tuple[float, ...] | None] = []
    seen: dict[str, int] = {}
    for index, entry in enumerate(table.unknown):
        where = f"unknown[{index}]"
        place = repr((entry.effect, entry.joint, entry.axis, entry.keys, entry.fixed))
        if (first := seen.setdefault(place, index)) < index:
            raise InputError(f"repeats unknown[{first}], leave one out", file=file, where=where)
        if len(entry.deviation) != len(entry.keys):
            message = f"has {len(entry.deviation)} numbers, expected {len(entry.keys)}, one per key"
            raise InputError(message, file=file, where=f"{where}.deviation")
        if len(set(entry.keys)) < len(entry.keys):
            raise InputError("names a parameter twice", file=file, where=f"{where}.keys")
        rows += _check_factor(entry, file, where)
    if len(rows) > MOST_UNKNOWN:
        raise InputError(f"{len(rows)} parameters, at most {MOST_UNKNOWN}", file=file, where="unknown")
    unknowns = tuple(
        Unknown(e.effect, e.joint, e.axis, e.keys, np.array(e.deviation, float), dict(e.fixed)) for e in table.unknown
    )
    scatter = table.repeatability_mm
    return Uncertainty(
        grade=table.grade,
        source=table.source,
        unknowns=unknowns,
        factor=_fill_factor(rows),
        unexplained=table.unexplained.rms_mm * 1e-3,
        scale=table.unexplained.scale_mm * 1e-3,
        repeatability=None if scatter is None else scatter * 1e-3,
        calibration=table.calibration.factor,
        groups=table.calibration.groups,
    )


def format_uncertainty(uncertainty: Uncertainty) -> str:
    """Return the text of uncertainty.toml with six digits; zero entries at the end of a matrix row are left out."""
    head: dict[str, Any] = {"schema": 1, "grade": uncertainty.grade, "source": uncertainty.source}
    if uncertainty.repeatability is not None:
        head["repeatability_mm"] = shorten(uncertainty.repeatability * 1e3)
    head["unexplained"] = {
        "rms_mm": shorten(uncertainty.unexplained * 1e3), "scale_mm": shorten(uncertainty.scale * 1e3)
    }  # fmt: skip
    head["calibration"] = {"factor": shorten(uncertainty.calibration), "groups": int(uncertainty.groups)}
    lines, first = [tomli_w.dumps(head)], 0
    shape = uncertainty.factor.shape
    plain = shape[0] == shape[1] and not np.any(uncertainty.factor - np.diag(np.diag(uncertainty.factor)))
    for unknown in uncertainty.unknowns:  # texts and lists are the same in JSON and TOML
        table: dict[str, Any] = {"effect": unknown.effect, "joint": unknown.joint, "axis": unknown.axis}
        table |= {"keys": list(unknown.keys), "deviation": [shorten(value) for value in unknown.deviation]}
        if not plain:
            table["factor"] = [_shorten_row(row) for row in uncertainty.factor[first : first + len(unknown.keys)]]
        lines.append("[[unknown]]")
        lines += [
            f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items() if value is not None
        ]
        if unknown.fixed:
            lines += ["[unknown.fixed]", tomli_w.dumps(dict(unknown.fixed)).rstrip()]
        lines.append("")
        first += len(unknown.keys)
    return "\n".join(lines)


def _check_factor(entry: UnknownTable, file: Path, where: str) -> list[tuple[float, ...] | None]:
    if entry.factor is None:
        return [None] * len(entry.keys)
    if len(entry.factor) != len(entry.keys):
        message = f"has {len(entry.factor)} rows, expected {len(entry.keys)}, one per key"
        raise InputError(message, file=file, where=f"{where}.factor")
    for row in entry.factor:
        if not 0 < len(row) <= 2 * MOST_UNKNOWN:
            raise InputError(f"a row has {len(row)} numbers", file=file, where=f"{where}.factor")
        if abs(float(np.linalg.norm(row)) - 1.0) > ROUNDING:
            message = f"a row has length {float(np.linalg.norm(row)):.6g}, expected 1; deviations stand in `deviation`"
            raise InputError(message, file=file, where=f"{where}.factor")
    return list(entry.factor)


def _fill_factor(rows: list[tuple[float, ...] | None]) -> Array:
    """Return the factor; a missing row gets a separate column."""
    shared = max((len(row) for row in rows if row is not None), default=0)
    alone = [index for index, row in enumerate(rows) if row is None]
    factor = np.zeros((len(rows), shared + len(alone)))
    for index, row in enumerate(rows):
        if row is not None:
            factor[index, : len(row)] = row
    factor[alone, shared + np.arange(len(alone))] = 1.0
    return factor


def _shorten_row(row: Array) -> list[float]:
    """Return the numbers of a row up to the last significant one."""
    kept = np.where(np.abs(row) > NOTHING, row, 0.0)
    return [shorten(value) for value in kept[: int(np.flatnonzero(kept).max(initial=0)) + 1]]
