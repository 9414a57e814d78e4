"""[motion] of controller.toml: how a controller executes a program, and how its drives follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from compplan.errors import InputError
from compplan.io.quantities import shorten
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable

#: Time in which a joint without a stated acceleration reaches its full velocity (assumed). [s]
FULL_SPEED = 0.3
#: Greatest valid lag of a drive. [s]
LONGEST_LAG = 0.5
#: Valid lag, acceleration lag and lost motion of a joint. [ms], [ms^2], [deg or mm]
Lag = Annotated[float, Field(ge=0.0, le=1e3 * LONGEST_LAG)]
AccelerationLag = Annotated[float, Field(ge=-1e6 * LONGEST_LAG**2, le=1e6 * LONGEST_LAG**2)]
LostMotion = Annotated[float, Field(ge=0.0, le=1.0)]
#: Source of a model without measurements.
ASSUMED = "assumed"


class MotionTable(StrictTable):
    """[motion] of controller.toml: every key is optional, with the defaults below (assumed).

    cycle_ms: step of the interpolator. blend_share: ratio of a corner's blend length to its zone.
    acceleration_mm_s2: of the tip. smoothing_ms: averaging time of the speed (S-shape).
    lag_ms, acceleration_lag_ms2, lost_motion_deg: one number for each joint; lost motion of a slide in mm.
    """

    cycle_ms: Annotated[float, Field(ge=0.1, le=100.0)] = 4.0
    blend_share: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0
    acceleration_mm_s2: Annotated[float, Field(gt=0.0, le=1e6)] = 3000.0
    smoothing_ms: Annotated[float, Field(ge=0.0, le=1000.0)] = 40.0
    lag_ms: Annotated[tuple[Lag, ...], Field(strict=False)] | None = None
    acceleration_lag_ms2: Annotated[tuple[AccelerationLag, ...], Field(strict=False)] | None = None
    lost_motion_deg: Annotated[tuple[LostMotion, ...], Field(strict=False)] | None = None
    source: str = ASSUMED


@dataclass(frozen=True)
class ServoMotion:
    """Motion model of a controller and its drives."""

    cycle: float  #: Step of the interpolator. [s]
    blend_share: float  #: Ratio of a corner's blend length to its zone.
    acceleration: float  #: Greatest acceleration of the tip along and across the path. [m/s^2]
    smoothing: float  #: Averaging time of the speed along the path. [s]
    lag: Array  #: First-order lag T1 of each drive. Shape (nq,). [s]
    acceleration_lag: Array  #: Lag of the drive per acceleration, T2. Shape (nq,). [s^2]
    lost_motion: Array  #: Full width of a joint's lost motion at reversal. Shape (nq,). [rad or m]
    velocity_limits: Array  #: Shape (nq,). [rad/s or m/s]
    acceleration_limits: Array  #: Shape (nq,). [rad/s^2 or m/s^2]
    source: str = ASSUMED  #: Origin of the data, or "assumed".


def _list_units(prismatic: NDArray[np.bool_]) -> dict[str, tuple[str, Any]]:
    """Return the attribute of `ServoMotion` and the unit of each number in a section [motion]."""
    return {
        "cycle_ms": ("cycle", 1e-3), "blend_share": ("blend_share", 1.0),
        "acceleration_mm_s2": ("acceleration", 1e-3), "smoothing_ms": ("smoothing", 1e-3), "lag_ms": ("lag", 1e-3),
        "acceleration_lag_ms2": ("acceleration_lag", 1e-6),
        "lost_motion_deg": ("lost_motion", np.where(prismatic, 1e-3, np.pi / 180.0)),
    }  # fmt: skip


def read_motion(
    table: MotionTable | None, prismatic: NDArray[np.bool_], limits: tuple[Array, Array], file: Path | None = None
) -> ServoMotion:
    """Return the motion model of a section [motion]; without the section, or without a key, the assumed values.

    `limits` are velocity and acceleration limits of the joints, infinite where unknown. Shape (nq,) each.

    Raises:
        InputError: If a list does not hold one number for each joint.
    """
    table = MotionTable() if table is None else table
    nq = len(prismatic)
    values: dict[str, Any] = {}
    for key, (name, unit) in _list_units(prismatic).items():
        given = getattr(table, key)
        given = (0.0,) * nq if given is None else given
        if isinstance(given, tuple) and len(given) != nq:
            message = f"has {len(given)} numbers, expected {nq}, one per joint"
            raise InputError(message, file=file, where=f"motion.{key}")
        values[name] = unit * (np.array(given, dtype=np.float64) if isinstance(given, tuple) else given)
    velocity, acceleration = limits
    acceleration = np.where(np.isfinite(acceleration), acceleration, velocity / FULL_SPEED)
    return ServoMotion(**values, velocity_limits=velocity, acceleration_limits=acceleration, source=table.source)


def tabulate_motion(motion: ServoMotion, prismatic: NDArray[np.bool_]) -> Mapping[str, Any]:
    """Return a motion model as a section [motion]."""
    stated = {key: getattr(motion, name) / unit for key, (name, unit) in _list_units(prismatic).items()}
    digits = {key: np.vectorize(shorten)(values) for key, values in stated.items()}
    return {**{key: values.tolist() for key, values in digits.items()}, "source": motion.source}
