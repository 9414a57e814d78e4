"""How a controller counts its joints and frames, read a second time from controller.toml."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.io.tomlfile import read_toml
from compplan.robot import Array


@dataclass(frozen=True)
class ReadCounting:
    """Hold how a controller counts: shown = sign * q + zero + coupling @ q, in deg, slides in mm.

    Attributes:
        matrix: diag(sign) + coupling. Shape (nq, nq).
        zero: Shape (nq,). [deg or mm]
        external: Which joints the controller calls external axes. Shape (nq,).
        names: The controller's names of the joints; J1, J2, .. where controller.toml states none.

    """

    matrix: Array
    zero: Array
    external: NDArray[np.bool_]
    names: tuple[str, ...]

    def show(self, degrees: Array) -> Array:
        """Return what the controller shows of the joints of the robot folder, in deg and mm. Shape (n, nq)."""
        return np.asarray(degrees @ self.matrix.T + self.zero)

    def undo(self, shown: Array) -> Array:
        """Return the joints of the robot folder from what a controller shows, in its order. Shape (n, nq)."""
        return np.asarray(np.linalg.solve(self.matrix, (shown - self.zero).T).T)


def read_counting(folder: Path, outer: tuple[bool, ...]) -> ReadCounting:
    """Read how the controller of a robot folder counts; without controller.toml it counts as the URDF does.

    Args:
        folder: The robot folder.
        outer: Which joints are external axes where controller.toml does not name them so, from the base.

    """
    file, nq = folder / "controller.toml", len(outer)
    table: Mapping[str, Any] = read_toml(file) if file.is_file() else {}
    names = tuple(str(name) for name in table.get("joint_names", ()))
    sign = np.array(table.get("sign", [1.0] * nq), float)
    matrix = np.diag(sign) + np.array(table.get("coupling", np.zeros((nq, nq))), float)
    named = np.array([bool(re.fullmatch(r"E\d+", name.upper())) for name in names] or [False] * nq, bool)
    external = named if named.any() else np.array(outer, bool)
    names = names or tuple(f"J{number}" for number in range(1, nq + 1))
    return ReadCounting(matrix, np.array(table.get("zero_deg", [0.0] * nq), float), external, names)
