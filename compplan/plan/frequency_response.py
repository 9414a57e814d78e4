"""Measured answers of a tool's tip to a force on it, as frequency responses, and the modes that make them up.

Read are CSV tables and universal files (UNV, UFF) with a data set 58 in text: function type 4, complex, evenly spaced
or not, displacement, velocity or acceleration by force, SI units. A drive point's compliance is taken for

    H(w) = sum over modes r / (w_n^2 - w^2 + 2 i z w_n w) + stiffer ones - softer ones / w^2,    r, both rests >= 0.

Frequencies and dampings are sought from the greatest peak that is left, all of them together after each; residues
follow linearly. A further mode has to take a fifth of the squares that are left.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.plan.tool_modes import ToolModes
from compplan.process.stability import Modes

COLUMNS = (
    FileColumn("frequency_Hz", required=True),
    *(FileColumn(name) for name in ("real_um_N", "imag_um_N", "amplitude_um_N", "phase_deg")),
)
#: Endings of universal files.
UNIVERSAL = (".unv", ".uff", ".uf58", ".58")
#: Derivatives in time that a data set's numerator is: displacement, velocity, acceleration.
NUMERATORS = {8: 0, 11: 1, 12: 2}
#: Modes that a response is taken for at most, squares that a further one has to take, share that may be left over.
MOST, TAKES, LEFT = 8, 0.2, 0.3
#: Points that a response has at least, and compliances that are taken for true. [m/N]
POINTS, COMPLIANCE = 20, (1e-10, 1e-2)
#: A compliance at each frequency.
Response = NDArray[np.complex128]
FLOAT = re.compile(r"[-+]?\d*\.\d+(?:[EeDd][-+]?\d+)?")


def fit_responses(files: Mapping[str, Path]) -> tuple[ToolModes, str]:
    """Fit modes to the response along each axis of the tool; return them and a sentence for the user.

    Args:
        files: One file for each of x, y, z of the tool that was measured.

    Raises:
        InputError: If a file is not a response, or modes do not explain it.

    """
    parts, told = [], []
    for axis, file in files.items():
        frequency, response = read_response(file)
        modes, left = fit_modes(2.0 * np.pi * frequency, response)
        if left > LEFT:
            raise InputError(f"modes leave {100 * left:.0f} % of this response unexplained, {100 * LEFT:.0f} % at most "
                             "is allowed: is it a drive point, and in the right unit?", file=file)  # fmt: skip
        way = np.eye(3)[:, ["xyz".index(axis)]]
        parts.append(ToolModes(modes.omega, np.asarray(modes.damping), way * modes.shape))
        rings = ", ".join(f"{value / (2 * np.pi):.4g}" for value in modes.omega)
        told.append(f"{axis}: {rings} Hz, {100 * left:.2g} % of the response left over")
    together = ToolModes(*(np.concatenate(each, axis=-1) for each in (
        [part.omega for part in parts], [part.damping for part in parts], [part.shape for part in parts])))  # fmt: skip
    return together, f"Modes fitted to the measured responses of the tip ({'; '.join(told)})."


def read_response(file: Path) -> tuple[Array, Response]:
    """Read a frequency response: frequencies [Hz] and complex compliance [m/N], each of shape (p,).

    Raises:
        InputError: With file and line, if it is not what it has to be.

    """
    frequency, response = _read_universal(file) if file.suffix.lower() in UNIVERSAL else _read_columns(file)
    keep = frequency > 0.0
    frequency, response = frequency[keep], response[keep]
    if len(frequency) < POINTS or (np.diff(frequency) <= 0.0).any():
        message = f"has {len(frequency)} frequencies above 0, at least {POINTS} that rise are expected"
        raise InputError(message, file=file)
    most = float(np.abs(response).max())
    if not COMPLIANCE[0] <= most <= COMPLIANCE[1]:
        raise InputError(f"greatest compliance is {1e6 * most:.3g} um/N, {1e6 * COMPLIANCE[0]:g} to "
                         f"{1e6 * COMPLIANCE[1]:g} is allowed: check the unit", file=file)  # fmt: skip
    if response.imag.sum() > 0.0:
        raise InputError("imaginary part is above 0 on the whole; a tip lags behind a force on it: negative", file=file)
    return frequency, response


def _read_columns(file: Path) -> tuple[Array, Response]:
    table = read_table(file, COLUMNS)
    if "real_um_N" in table and "imag_um_N" in table:
        response = table.values["real_um_N"] + 1j * table.values["imag_um_N"]
    elif "amplitude_um_N" in table and "phase_deg" in table:
        response = table.values["amplitude_um_N"] * np.exp(1j * np.radians(table.values["phase_deg"]))
    else:
        message = "needs the columns real_um_N and imag_um_N, or amplitude_um_N and phase_deg"
        raise InputError(message, file=file, where=1)
    return table.values["frequency_Hz"], np.asarray(1e-6 * response, np.complex128)


def _read_universal(file: Path) -> tuple[Array, Response]:
    """Read the one frequency response of a universal file."""
    try:
        lines = file.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file) from None
    marks = [i for i, line in enumerate(lines) if line.strip() == "-1"]
    sets = [(first, last) for first, last in pairwise(marks) if lines[first + 1].strip() == "58"]
    if len(sets) != 1:
        raise InputError(f"has {len(sets)} data sets 58 in text, expected one, the drive point of the tip", file=file)
    first, last = sets[0]
    try:
        kind = int(lines[first + 7][:5])
        stored, count, even = (int(word) for word in lines[first + 8].split()[:3])
        start, step = (float(word) for word in lines[first + 8].split()[3:5])
        numerator = int(lines[first + 10].split()[0])
    except (ValueError, IndexError):
        message = "is not a data set 58: records 6 to 9 hold other than numbers"
        raise InputError(message, file=file, where=first + 8) from None
    if kind != 4 or stored not in (5, 6) or numerator not in NUMERATORS:
        message = (f"function type {kind}, data type {stored}, numerator {numerator}; a complex frequency response "
                   "(4; 5 or 6) of displacement, velocity or acceleration (8, 11, 12) is expected")  # fmt: skip
        raise InputError(message, file=file, where=first + 8)
    words = FLOAT.findall(" ".join(lines[first + 13 : last]))
    numbers = [float(word.upper().replace("D", "E")) for word in words]
    wide = 2 if even else 3
    if len(numbers) != wide * count:
        raise InputError(f"has {len(numbers)} numbers, {wide * count} are announced", file=file, where=first + 9)
    rows = np.array(numbers).reshape(count, wide)
    frequency = start + step * np.arange(count) if even else rows[:, 0]
    rate = np.where(frequency > 0.0, 2j * np.pi * frequency, 1.0) ** NUMERATORS[numerator]
    return np.asarray(frequency), np.asarray((rows[:, -2] + 1j * rows[:, -1]) / rate)


def fit_modes(omega: Array, response: Response) -> tuple[Modes, float]:
    """Fit modes to a drive point's response.

    Args:
        omega: Shape (p,). [rad/s]
        response: Complex compliance. Shape (p,). [m/N]

    Returns:
        The modes along one way, shape (1, m), and the share of the response that they leave.

    """
    size = float(np.abs(response).max())
    target = np.concatenate([response.real, response.imag]) / size
    low, high = omega[0], omega[-1]

    def solve(found: Array) -> tuple[Array, Array]:
        w, z = np.exp(found.reshape(2, -1))
        peaks = w**2 / (w**2 - omega[:, None] ** 2 + 2j * z * w * omega[:, None])
        peaks = np.column_stack([peaks, np.ones_like(omega), -((low / omega) ** 2)])
        basis = np.vstack([peaks.real, peaks.imag])
        scale = np.linalg.norm(basis, axis=0)
        share, _ = nnls(basis / scale, target)
        return share / scale, basis @ (share / scale) - target

    found = np.zeros((2, 0))
    share, miss = solve(found)
    while found.shape[1] < MOST:
        lag = (omega / high) * miss[len(omega) :]  # what is left of the part that lags, stiff modes not overlooked
        start = np.column_stack([found, np.log([omega[int(lag.argmax())], 0.02])])
        bounds = np.repeat([np.log([low, 1e-4]), np.log([high, 0.5])], start.shape[1], axis=1)
        start = np.clip(start.ravel(), bounds[0] + 1e-6, bounds[1] - 1e-6)
        better = least_squares(lambda each: solve(each)[1], start, bounds=bounds, max_nfev=60).x
        shared, missed = solve(better)
        if missed @ missed > (1.0 - TAKES) * (miss @ miss):
            break
        found, share, miss = better.reshape(2, -1), shared, missed
    w, z = np.exp(found)
    kept = np.flatnonzero(share[: len(w)] > 1e-6 * share.max(initial=1e-30))
    kept = kept[np.argsort(w[kept])]
    residue = size * share[kept] * w[kept] ** 2
    return Modes(w[kept], np.sqrt(residue)[None, :], z[kept]), float(np.sqrt((miss @ miss) / (target @ target)))
