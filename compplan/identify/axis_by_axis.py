"""Identify a few parameters at a time, each from the test that loads it, sweeping over the tests [Johra2022]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.identify.estimate import Estimate, estimate_parameters
from compplan.identify.observations import Observations
from compplan.identify.parameters import FreeRobot
from compplan.robot import Array


@dataclass(frozen=True)
class AxisTest:
    """One test: rows that load few springs, and the parameters that are identified from them.

    Attributes:
        names: Names of the parameters.
        observations: The measured rows.
    """

    names: tuple[str, ...]
    observations: Observations


@dataclass(frozen=True)
class AxisByAxis:
    """Parameters identified test by test.

    Attributes:
        values: Values of all parameters; nominal where no test names them. Shape (p,).
        estimates: Last fit of each test; its intervals hold if the other parameters were exact.
        sweeps: Sweeps until nothing changed.
    """

    values: Array
    estimates: tuple[Estimate, ...]
    sweeps: int


def estimate_axis_by_axis(
    structure: FreeRobot, tests: Sequence[AxisTest], *, most: int = 30, tolerance: float = 1e-3
) -> AxisByAxis:
    """Identify the parameters of each test, all others as they stand, until a sweep changes nothing.

    Args:
        structure: Robot and all parameters.
        tests: The tests, in order.
        most: Most sweeps over all tests.
        tolerance: Change of a parameter, against itself, that counts as none.

    Raises:
        UnknownNameError: If a test names a parameter that the structure does not have.
        InputError: If the sweeps do not settle.
    """
    names = list(structure.names)
    for name in (name for test in tests for name in test.names):
        if name not in names:
            raise UnknownNameError("parameter", name, names)
    present = structure
    for sweep in range(1, most + 1):
        before, estimates = present.nominal, []
        for test in tests:
            estimate = estimate_parameters(present.select(test.names), test.observations)
            values = present.nominal
            values[[names.index(name) for name in estimate.structure.names]] = estimate.model_values
            present = move_nominal(present, values)
            estimates.append(estimate)
        if np.all(np.abs(present.nominal - before) <= tolerance * np.abs(present.nominal)):
            return AxisByAxis(present.nominal, tuple(estimates), sweep)
    raise InputError(f"the tests did not settle in {most} sweeps; identify their parameters together")


def move_nominal(structure: FreeRobot, values: Array) -> FreeRobot:
    """Make the given compliances of a structure its nominal ones."""
    chain = replace(structure.chain, compliance=structure.compliance(values))
    moved = tuple(replace(p, nominal=float(v)) for p, v in zip(structure.parameters, values, strict=True))
    return replace(structure, chain=chain, parameters=moved)
