"""A measurement log as plain arrays: missing columns become zeros or NaN, lengths metres, angles radians."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.rival.chain import Array, Chain

FACTORS = {"deg": np.pi / 180.0, "rad": 1.0, "mm": 1e-3, "m": 1.0, "N": 1.0, "Nm": 1.0, "s": 1.0, "C": 1.0}


@dataclass(frozen=True, eq=False)
class Log:
    """Rows of a campaign in time order."""

    run: np.ndarray  #: Label of the run. Shape (n,).
    time: Array  #: Seconds, or the row number where there is no time. Shape (n,).
    q: Array  #: Readings. Shape (n, nq). [rad or m]
    wrench: Array  #: On the tool at the tip, base axes. Shape (n, 6). [N, N m]
    position: Array  #: Measured target. Shape (n, 3). [m]
    attitude: Array | None  #: Measured axes, or None. Shape (n, 3, 3).
    encoder: Array | None  #: Link-side minus motor-side reading, or None. Shape (n, nq).
    heat: Array | None  #: Temperature, or None. Shape (n,). [C]
    timed: bool  #: Whether there is a time.
    sigma: float  #: Stated standard deviation of one coordinate, or 0. [m]
    target: np.ndarray  #: Label of the measured point. Shape (n,).
    stay: np.ndarray  #: Number of the pose and load of a row; the same pose met again has the same number. Shape (n,).

    @property
    def moving(self) -> np.ndarray:
        """Rows that were sampled on the fly. Shape (n,)."""
        return np.array([str(r).startswith("path") for r in self.run])

    @property
    def known(self) -> np.ndarray:
        """Rows with joints and position. Shape (n,)."""
        return np.asarray(np.isfinite(self.q).all(axis=1) & np.isfinite(self.position).all(axis=1))


def read_log(file: Path, chain: Chain) -> Log:
    """Read a log of contracts.md, section 5."""
    with file.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    text = {name: [row[name] or "" for row in rows] for name in rows[0]}
    n = len(rows)

    def column(stem: str, units: str) -> Array | None:
        for unit in units.split():
            if f"{stem}_{unit}" in text:
                values = np.array([float(v) if v.strip() else np.nan for v in text[f"{stem}_{unit}"]])
                return np.asarray(values * FACTORS[unit])
        return None

    def block(stems: list[str], units: str) -> Array | None:
        found = [column(stem, units) for stem in stems]
        return None if any(f is None for f in found) else np.stack([f for f in found if f is not None], axis=1)

    count = len(chain.joints)
    q = block([f"q{k + 1}" for k in range(count)], "deg rad mm m")
    position = block(["x", "y", "z"], "mm m")
    assert q is not None and position is not None
    wrench = np.zeros((n, 6))
    for k, stem in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
        value = column(stem, "N Nm")
        if value is not None:
            wrench[:, k] = np.nan_to_num(value)
    vector = block(["rx", "ry", "rz"], "deg rad")
    link = block([f"q{k + 1}_link" for k in range(count)], "deg rad mm m")
    time, sigma = column("time", "s"), column("sigma", "mm m")
    timed = time is not None and bool(np.isfinite(time).all())
    attitude = None if vector is None else _turn(vector)
    labels = np.array(text.get("run", ["static"] * n))
    modes = np.array(text.get("mode", [""] * n))
    if link is not None and not np.isin(modes, ("", "U1", "L1")).all():
        link = None
    return Log(
        run=labels,
        time=time if timed and time is not None else np.arange(n, dtype=float),
        q=q,
        wrench=wrench,
        position=position,
        attitude=attitude,
        encoder=None if link is None else link - q,
        heat=column("temperature", "C"),
        timed=timed,
        sigma=0.0 if sigma is None or not np.isfinite(sigma).any() else float(np.nanmedian(sigma)),
        target=np.array(text.get("target", [""] * n)),
        stay=number_stays(q, wrench, labels),
    )


def _turn(vector: Array) -> Array:
    out = np.full((len(vector), 3, 3), np.nan)
    known = np.isfinite(vector).all(axis=1)
    out[known] = Rotation.from_rotvec(vector[known]).as_matrix()
    return out


def number_stays(q: Array, wrench: Array, run: np.ndarray) -> np.ndarray:
    """Number poses: rows with the same readings (0.001 deg) and the same load (3 N, 1 N m) share a number."""
    moving = np.array([str(r).startswith("path") for r in run])
    keys = [
        (-1 - k,) if moving[k] else (*np.round(q[k] / 2e-5).astype(float), *np.round(wrench[k] / [6, 6, 6, 2, 2, 2]))
        for k in range(len(q))
    ]
    numbers: dict[tuple[float, ...], int] = {}
    return np.array([numbers.setdefault(tuple(map(float, key)), len(numbers)) for key in keys])
