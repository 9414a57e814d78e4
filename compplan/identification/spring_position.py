"""Find where on a link an extra spring sits: the shift of its axis from the joint's origin [Johra2022]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from compplan.errors import CompplanError, InputError
from compplan.identification.estimate import Estimate, fit_rows
from compplan.identification.parameters import FreeRobot
from compplan.measurement.fit.linear_system import weigh
from compplan.measurement.fit.rows import Rows
from compplan.robot import Array
from compplan.statics.elements import ELASTIC_AXES

#: A spring is looked for within this distance of the joint's origin, across its axis. [m]
FARTHEST = 1.0


@dataclass(frozen=True)
class SpringPlace:
    """Where a spring sits.

    Attributes:
        estimate: The fit with the spring there; intervals of the compliances hold for this place.
        offset: Origin of the spring in the child frame of its joint. Shape (3,). [m]
        standard_errors: Of the offset; zero along the spring's own axis, where it changes nothing. Shape (3,). [m]
    """

    estimate: Estimate
    offset: Array
    standard_errors: Array


def place_spring(structure: FreeRobot, name: str, rows: Rows) -> SpringPlace:
    """Fit the two components of a turning spring's offset across its axis, everything else fitted along at each place.

    Args:
        structure: Robot and free parameters, the spring among them.
        name: Name of the spring, such as "joint_3.rx".
        rows: The measured rows.

    Raises:
        InputError: If the spring does not turn about tx ty tz rx ry rz, or no place within 1 m fits.
    """
    index = structure.spring_labels.index(name)
    springs = list(structure.robot.springs)
    spring = springs[index]
    if not spring.axis.startswith("r"):
        raise InputError(f"spring {name!r} acts about or along {spring.axis}, expected one about rx, ry or rz")
    across = np.flatnonzero(np.array(ELASTIC_AXES[spring.axis][1]) == 0)

    def fit(components: Array) -> Estimate:
        offset = spring.offset.copy()
        offset[across] = components
        springs[index] = replace(spring, offset=offset)
        return fit_rows(replace(structure, robot=replace(structure.robot, springs=tuple(springs))), rows)

    start = fit(spring.offset[across])

    def residual(components: Array) -> Array:
        system, root = fit(components).system, np.sqrt(start.weights)[:, None]
        return np.asarray(weigh(system, system.whitener(start.noise) * root, rows.group)[0].ravel())

    try:
        found = least_squares(
            residual, spring.offset[across], bounds=(-FARTHEST, FARTHEST), diff_step=0.01, x_scale=0.1, xtol=1e-5,
            method="trf", max_nfev=20,
        )  # fmt: skip
    except CompplanError as error:
        raise InputError(f"no place of spring {name!r} within {FARTHEST:g} m of its joint fits: {error}") from None
    estimate, errors = fit(found.x), np.zeros(3)
    spread = np.linalg.pinv(found.jac.T @ found.jac)
    scale = np.sqrt(2 * found.cost / max(len(found.fun) - len(start.values) - 2, 1))
    errors[across] = scale * np.sqrt(np.diag(spread))
    return SpringPlace(estimate, estimate.structure.robot.springs[index].offset, errors)
