"""process.toml of a robot folder: what measured parts said of the force of its processes; docs/outputs.md has the keys.

`plan` and the 95 % band of every job of the same model read it. A job whose [process] has other numbers takes the
level with a further spread. From three parts on the scatter is theirs, weighed against the assumed one.
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

from compplan.io.tables import Array
from compplan.io.tomlfile import SchemaOne, StrictTable, Vector3, Words, read_toml_model

FILE, UNCERTAINTY = "process.toml", "uncertainty.toml"
#: Level from part to part (assumed: stock, edge and lubricant differ by 5 to 10 %), as many parts as it counts for, and
#: parts from which on their own scatter counts.
SCATTER, WEIGHT, PARTS = 0.07, 4, 3
#: Further spread of the level where a job's [process] has other numbers (assumed: models err alike for one material).
OTHER = 0.1
#: Frames in which a force keeps its direction wherever the path goes; "columns" are in that of the part.
FIXED = ("part", "base")
#: Keys of [process] that say where it acts, not how hard it pushes.
WHERE = ("model", "ramp_mm", "during_rapid", "required", "stock", "stock_top_mm", "uncertainty", "file")


#: Numbers of the level and three turns.
Shares = Annotated[tuple[float, float, float, float], Field(strict=False)]


class LearnedPartTable(StrictTable):
    """[[process.part]]: the level of one measured part."""

    date: datetime.date
    job: str
    level: float = Field(gt=0.0, le=100.0)
    sigma: float = Field(ge=0.0, le=100.0)


class EntryTable(StrictTable):
    """[[process]]: what is known of the force of one process; `numbers` are those of its [process]."""

    model: str
    level: float = Field(gt=0.0, le=100.0)
    level_sigma: float = Field(ge=0.0, le=100.0)
    turn_deg: Vector3 = (0.0, 0.0, 0.0)
    turn_sigma_deg: float | None = Field(default=None, ge=0.0, le=180.0)
    scatter: float = Field(default=SCATTER, ge=0.0, le=10.0)
    robot: Annotated[tuple[Shares, ...], Field(strict=False)] = ()  #: See `LearnedForce.robot`.
    robot_sha256: str = ""  #: Of the uncertainty.toml that `robot` belongs to.
    numbers: dict[str, Any] = Field(default_factory=dict)
    part: Annotated[tuple[LearnedPartTable, ...], Field(strict=False, min_length=1)]


class ProcessFile(StrictTable):
    """process.toml."""

    schema_: SchemaOne = Field(alias="schema")
    process: Annotated[tuple[EntryTable, ...], Field(strict=False)] = ()
    notes: Words = ()


@dataclass(frozen=True, eq=False)
class LearnedForce:
    """What measured parts said of the force of a process."""

    level: float  #: Force over the predicted one that the next part is expected to have.
    level_sigma: float  #: Standard deviation of it, what differs from part to part left out.
    turn: Array  #: Rotation vector from the predicted to the true direction, axes of `axes`. Shape (3,). [rad]
    turn_sigma: float | None  #: Standard deviation of it per axis, or None where nothing was learned of it. [rad]
    scatter: float  #: Standard deviation of the level from part to part, relative.
    parts: tuple[LearnedPartTable, ...]  #: The parts, oldest first.
    axes: str  #: "base", "part", or "" where the direction goes with the path and is not learned.
    same: bool = True  #: Whether the parts were cut with the numbers of this [process].
    #: Covariance of level and turns, in `axes` [rad], with each parameter of the folder's uncertainty.toml: a harder
    #: push and a softer arm bend alike. Shape (p, 4), or (0, 4) where none is known. [SI]
    robot: Array = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def spread(self) -> float:
        """Relative standard deviation of the level of the next part."""
        return float(np.sqrt(self.common**2 + self.scatter**2))

    @property
    def common(self) -> float:
        """The same without what differs from part to part."""
        return float(np.hypot(self.level_sigma / self.level, 0.0 if self.same else OTHER))

    @property
    def source(self) -> str:
        """Say what it rests on."""
        count, scatter = len(self.parts), f"{self.scatter:.0%} from part to part"
        own = "by their scatter and what is assumed" if count >= PARTS else "assumed"
        other = "" if self.same else f"; another [process] of the same model: {OTHER:.0%} more, assumed"
        return f"{FILE}: {count} measured part{'s' * (count > 1)}, last {self.parts[-1].date}; {scatter} ({own}){other}"

    @property
    def words(self) -> str:
        """Say what is planned with."""
        turned = float(np.degrees(np.linalg.norm(self.turn)))
        turn = f", turned by {turned:.1f} deg" if turned >= 0.05 else ""
        planned = f"{self.level:.3g} times the predicted one{turn}"
        return f"The force is planned {planned}, as parts were measured ({self.source})"

    def push(self, wrench: Array, R_base_part: Array) -> Array:
        """Return the wrench that is planned with. wrench: the predicted one, base axes, shape (n, 6). [N, N m]"""
        if not self.turn.any():
            return np.asarray(self.level * wrench)
        turn = Rotation.from_rotvec(R_base_part @ self.turn if self.axes == "part" else self.turn).as_matrix()
        return np.asarray(self.level * (wrench.reshape(-1, 2, 3) @ turn.T).reshape(-1, 6))

    def undo(self, wrench: Array, R_base_part: Array) -> Array:
        """Return the predicted wrench of one that is planned with. Shape (n, 6). [N, N m]"""
        return replace(self, level=1.0 / self.level, turn=-self.turn).push(wrench, R_base_part)


def find_axes(process: Any) -> str:
    """Tell in which axes a process keeps its direction: "base", "part", or "" where it goes with path or tool."""
    frame = "part" if process.model == "columns" else getattr(process, "frame", "path")
    return frame if frame in FIXED else ""


def list_numbers(process: Any) -> dict[str, Any]:
    """Return what a [process] says of how hard it pushes, as TOML holds it."""
    table: dict[str, Any] = process.model_dump(mode="json", exclude_none=True)
    return {key: value for key, value in table.items() if key not in WHERE}


def read_learned_force(folder: Path | None, process: Any) -> LearnedForce | None:
    """Read what parts said of the force of a [process] from a robot folder; None where no part of it was measured.

    Raises:
        InputError: With file and key, if process.toml is not what it has to be.
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
    """Add a measured part; its scatter counts from then on.

    The level of `force` is that after this part. The scatter is the assumed one as if seen at `WEIGHT` parts, with
    those that there are: s^2 = (WEIGHT a^2 + sum (l_i - mean)^2) / (WEIGHT + n - 1).
    """
    force = replace(force, parts=(*force.parts, part))
    level = np.array([one.level for one in force.parts])
    n = len(level)
    if n < PARTS:
        return force
    away = level / level.mean() - 1.0
    return replace(force, scatter=float(np.sqrt((WEIGHT * SCATTER**2 + away @ away) / (WEIGHT + n - 1))))


def write_learned_force(force: LearnedForce, process: Any, folder: Path, source: Path | None) -> None:
    """Write process.toml into a robot folder: this process as it is known now, others as `source` holds them.

    The folder's uncertainty.toml is the one that `force` goes with.
    """
    numbers = list_numbers(process)
    file = None if source is None else source / FILE
    old = read_toml_model(ProcessFile, file).process if file is not None and file.is_file() else ()
    others = [e.model_dump(exclude_none=True) for e in old if (e.model, e.numbers) != (process.model, numbers)]
    entry: dict[str, Any] = {
        "model": process.model, "level": _short(force.level), "level_sigma": _short(force.level_sigma),
        "turn_deg": [_short(float(v)) for v in np.degrees(force.turn)], "scatter": _short(force.scatter),
        "numbers": numbers, "part": [part.model_dump() for part in force.parts],
    }  # fmt: skip
    if force.turn_sigma is not None:
        entry["turn_sigma_deg"] = _short(float(np.degrees(force.turn_sigma)))
    if len(force.robot):
        entry["robot"] = [[_short(float(value)) for value in row] for row in force.robot]
        entry["robot_sha256"] = _hash_uncertainty(folder)
    table: Mapping[str, Any] = {"schema": 1, "process": [*others, entry]}
    (folder / FILE).write_text(tomli_w.dumps(table), encoding="utf-8")


def _short(value: float) -> float:
    return float(f"{value:.6g}")
