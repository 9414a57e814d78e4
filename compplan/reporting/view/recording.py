"""Read the viewer file of a plan folder: view.npz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.reporting.scenes import Shape
from compplan.reporting.writers.recording import FILE, WAYS
from compplan.robot import Array


@dataclass(frozen=True, eq=False)
class PlanRecording:
    """Rows of a plan for the viewer; k of the n rows of joints.csv, base frame."""

    facts: Mapping[str, Any]  #: Names of plan, robot, links and joint columns; tolerance, configuration, ground.
    solids: tuple[Shape, ...]  #: Shapes, in the frames of their links, or in the base frame.
    row: NDArray[np.int_]  #: Row of joints.csv. Shape (k,).
    time: Array  #: Shape (k,). [s]
    joints: Array  #: Commanded joints as in joints.csv. Shape (k, nq). [deg or mm]
    poses: NDArray[np.float32]  #: Pose of every link. Shape (k, links, 4, 4). [m]
    tip: Array  #: Nominal tip. Shape (k, 3). [m]
    force: Array  #: Predicted force of the environment on the tool. Shape (k, 3). [N]
    move: NDArray[np.str_]  #: "cut", "rapid", "approach" or "retract". Shape (k,).
    #: Attained minus nominal tip, uncorrected and planned; NaN if unknown. Shape (k, 3) each. [m]
    deviation: Mapping[str, Array]
    error_band: Array  #: Radius of the 95 % band of the true tip, NaN if none is stated. Shape (k,). [m]

    @property
    def tolerance(self) -> float:
        """Greatest allowed deviation. [m]"""
        return 1e-3 * float(self.facts["tolerance_mm"])


def read_recording(folder: Path) -> PlanRecording:
    """Read the recording in an output folder of `compplan plan`."""
    file = folder / FILE
    if not file.is_file():
        raise InputError(f"holds no plan to show ({FILE} is not there); name a folder of compplan plan", file=folder)
    try:
        with np.load(file, allow_pickle=False) as held:
            facts = json.loads(str(held["facts"]))
            solids = tuple(
                Shape(shape["link"], held[f"vertices{k}"], held[f"faces{k}"], tuple(shape["colour"]), shape["name"])
                for k, shape in enumerate(facts["shapes"])
            )
            names = ("row", "time", "joints", "poses", "tip", "force", "move", "error_band")
            arrays: dict[str, Any] = {name: held[name] for name in names}
            return PlanRecording(facts, solids, deviation={way: held[way] for way in WAYS}, **arrays)
    except (ValueError, KeyError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise InputError(f"is not what compplan writes ({error}); plan again", file=file) from None
