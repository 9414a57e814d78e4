"""process.toml of a robot folder: process forces learned from measured parts; docs/outputs.md has the keys.

`plan` and the 95 % band of every job of the same model use it. For a job with other numbers in [process] the level has
a larger uncertainty. From three parts on, their scatter is combined with the assumed one.
"""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from pydantic import Field
from scipy.spatial.transform import Rotation

from compplan.io.quantities import shorten
from compplan.io.tables import Array
from compplan.io.tomlfile import SchemaOne, StrictTable, Vector3, Words, read_toml_model

FILE, UNCERTAINTY = "process.toml", "uncertainty.toml"
#: Relative scatter of the level between parts (assumed: stock, edge and lubricant differ by 5 to 10 %), its weight in
#: parts, and number of parts from which on the measured scatter counts.
SCATTER, WEIGHT, PARTS = 0.07, 4, 3
#: Additional uncertainty of the level for a job with other numbers in [process] (assumed: similar for one material).
OTHER = 0.1
#: Frames in which a force has a fixed direction along the path; "columns" are in that of the part.
FIXED = ("part", "base")
#: Keys of [process] for where the force acts, not for its size.
WHERE = ("model", "ramp_mm", "during_rapid", "required", "stock", "stock_top_mm", "uncertainty", "file")


#: One number for the level and one for each of three rotations.
Shares = Annotated[tuple[float, float, float, float], Field(strict=False)]


class LearnedPartTable(StrictTable):
    """[[process.part]]: force level of one measured part."""

    date: datetime.date
    job: str
    level: float = Field(gt=0.0, le=100.0)
    sigma: float = Field(ge=0.0, le=100.0)


class EntryTable(StrictTable):
    """[[process]]: learned force of one process; `numbers` are those of its [process]."""

    model: str
    level: float = Field(gt=0.0, le=100.0)
    level_sigma: float = Field(ge=0.0, le=100.0)
    turn_deg: Vector3 = (0.0, 0.0, 0.0)
    turn_sigma_deg: float | None = Field(default=None, ge=0.0, le=180.0)
    scatter: float = Field(default=SCATTER, ge=0.0, le=10.0)
    robot: Annotated[tuple[Shares, ...], Field(strict=False)] = ()  #: See `LearnedForce.robot`.
    robot_sha256: str = ""  #: Hash of the uncertainty.toml that `robot` refers to.
    numbers: dict[str, Any] = Field(default_factory=dict)
    part: Annotated[tuple[LearnedPartTable, ...], Field(strict=False, min_length=1)]


class ProcessFile(StrictTable):
    """process.toml."""

    schema_: SchemaOne = Field(alias="schema")
    process: Annotated[tuple[EntryTable, ...], Field(strict=False)] = ()
    notes: Words = ()


@dataclass(frozen=True, eq=False)
class LearnedForce:
    """Force correction of a process, learned from measured parts."""

    level: float  #: Expected ratio of true to predicted force for the next part.
    level_sigma: float  #: Standard deviation of `level`, without the scatter between parts.
    turn: Array  #: Rotation vector from the predicted to the true direction, axes of `axes`. Shape (3,). [rad]
    turn_sigma: float | None  #: Standard deviation of `turn` per axis, or None if it is not learned. [rad]
    scatter: float  #: Relative standard deviation of the level between parts.
    parts: tuple[LearnedPartTable, ...]  #: The parts, oldest first.
    axes: str  #: "base", "part", or "" for a direction relative to path or tool, which is not learned.
    same: bool = True  #: Whether the parts had the numbers of this [process].
    #: Covariance of level and rotations, in `axes` [rad], with each parameter of the folder's uncertainty.toml: larger
    #: force and softer arm have similar effects. Shape (p, 4), or (0, 4) if unknown. [SI]
    robot: Array = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def spread(self) -> float:
        """Relative standard deviation of the level of the next part."""
        return float(np.sqrt(self.common**2 + self.scatter**2))

    @property
    def common(self) -> float:
        """The same without the scatter between parts."""
        return float(np.hypot(self.level_sigma / self.level, 0.0 if self.same else OTHER))

    @property
    def source(self) -> str:
        """Description of the data behind the correction."""
        count, scatter = len(self.parts), f"{self.scatter:.0%} from part to part"
        own = "by their scatter and what is assumed" if count >= PARTS else "assumed"
        other = "" if self.same else f"; another [process] of the same model: {OTHER:.0%} more, assumed"
        return f"{FILE}: {count} measured part{'s' * (count > 1)}, last {self.parts[-1].date}; {scatter} ({own}){other}"

    @property
    def words(self) -> str:
        """Description of the correction in a plan."""
        turned = float(np.degrees(np.linalg.norm(self.turn)))
        turn = f", turned by {turned:.1f} deg" if turned >= 0.05 else ""
        planned = f"{self.level:.3g} times the predicted one{turn}"
        return f"The force is planned {planned}, as parts were measured ({self.source})"

    def correct(self, wrench: Array, R_base_part: Array) -> Array:
        """Return the corrected wrench. wrench: the predicted one, base axes, shape (n, 6). [N, N m]"""
        if not self.turn.any():
            return np.asarray(self.level * wrench)
        turn = Rotation.from_rotvec(R_base_part @ self.turn if self.axes == "part" else self.turn).as_matrix()
        return np.asarray(self.level * (wrench.reshape(-1, 2, 3) @ turn.T).reshape(-1, 6))

    def invert(self, wrench: Array, R_base_part: Array) -> Array:
        """Return the predicted wrench from a corrected one. Shape (n, 6). [N, N m]"""
        return replace(self, level=1.0 / self.level, turn=-self.turn).correct(wrench, R_base_part)


def find_axes(process: Any) -> str:
    """Return the axes in which a process has a fixed direction: "base", "part", or "" if relative to path or tool."""
    frame = "part" if process.model == "columns" else getattr(process, "frame", "path")
    return frame if frame in FIXED else ""


def list_numbers(process: Any) -> dict[str, Any]:
    """Return the keys of a [process] that determine the size of its force, as TOML values."""
    table: dict[str, Any] = process.model_dump(mode="json", exclude_none=True)
    return {key: value for key, value in table.items() if key not in WHERE}


def read_learned_force(folder: Path | None, process: Any) -> LearnedForce | None:
    """Read the learned force of a [process] from a robot folder; None if no part of it was measured.

    Raises:
        InputError: With file and key, if process.toml is not valid.
    """
    if folder is None or not (folder / FILE).is_file():
        return None
    numbers, axes = list_numbers(process), find_axes(process)
    own = [entry for entry in read_toml_model(ProcessFile, folder / FILE).process if entry.model == process.model]
    if not own:
        return None
    equal = [entry for entry in own if entry.numbers == numbers]
    entry = equal[-1] if equal else max(own, key=lambda one: one.part[-1].date)
    keeps = bool(axes) and bool(equal) and entry.turn_sigma_deg is not None
    tied = bool(equal) and entry.robot_sha256 == _hash_uncertainty(folder)
    robot = np.reshape(entry.robot if tied else (), (-1, 4)) * np.r_[1.0, np.full(3, float(keeps))]
    return LearnedForce(
        entry.level, entry.level_sigma, np.radians(entry.turn_deg) if keeps else np.zeros(3),
        float(np.radians(entry.turn_sigma_deg)) if keeps and entry.turn_sigma_deg is not None else None,
        entry.scatter, entry.part, axes, bool(equal), robot,
    )  # fmt: skip


def _hash_uncertainty(folder: Path) -> str:
    """Return the SHA-256 of a folder's uncertainty.toml, "-" where it has none."""
    file = folder / UNCERTAINTY
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else "-"


def add_part(force: LearnedForce, part: LearnedPartTable) -> LearnedForce:
    """Add a measured part and update the scatter.

    The level of `force` already includes this part. The scatter combines the assumed one, with the weight of `WEIGHT`
    parts, with that of the measured parts: s^2 = (WEIGHT a^2 + sum (l_i - mean)^2) / (WEIGHT + n - 1).
    """
    force = replace(force, parts=(*force.parts, part))
    level = np.array([one.level for one in force.parts])
    n = len(level)
    if n < PARTS:
        return force
    away = level / level.mean() - 1.0
    return replace(force, scatter=float(np.sqrt((WEIGHT * SCATTER**2 + away @ away) / (WEIGHT + n - 1))))


def write_learned_force(force: LearnedForce, process: Any, folder: Path, source: Path | None) -> None:
    """Write process.toml into a robot folder: the updated entry of this process, and other entries from `source`.

    `force` refers to the uncertainty.toml of the same folder.
    """
    numbers = list_numbers(process)
    file = None if source is None else source / FILE
    old = read_toml_model(ProcessFile, file).process if file is not None and file.is_file() else ()
    others = [e.model_dump(exclude_none=True) for e in old if (e.model, e.numbers) != (process.model, numbers)]
    entry: dict[str, Any] = {
        "model": process.model, "level": shorten(force.level), "level_sigma": shorten(force.level_sigma),
        "turn_deg": [shorten(float(v)) for v in np.degrees(force.turn)], "scatter": shorten(force.scatter),
        "numbers": numbers, "part": [part.model_dump() for part in force.parts],
    }  # fmt: skip
    if force.turn_sigma is not None:
        entry["turn_sigma_deg"] = shorten(float(np.degrees(force.turn_sigma)))
    if len(force.robot):
        entry["robot"] = [[shorten(float(value)) for value in row] for row in force.robot]
        entry["robot_sha256"] = _hash_uncertainty(folder)
    table: Mapping[str, Any] = {"schema": 1, "process": [*others, entry]}
    (folder / FILE).write_text(tomli_w.dumps(table), encoding="utf-8")
