"""Find where on a link an extra spring sits: the shift of its axis from the joint's origin [Johra2022]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from compplan.errors import CompplanError, InputError
from compplan.identify.estimate import Estimate, estimate_parameters, pose_groups
from compplan.identify.observations import Observations
from compplan.identify.parameters import FreeRobot
from compplan.identify.system import linearise, weigh
from compplan.measure.registration import Registration
from compplan.robot import Array
from compplan.statics.chain import build_chain
from compplan.statics.elements import ELASTIC_AXES

#: A spring is looked for within this distance of the joint's origin, across its axis. [m]
FARTHEST = 1.0


@dataclass(frozen=True)
class SpringPlace:
    """Where a spring sits.

    Attributes:
        structure: The structure with the spring there.
        estimate: Its fit; intervals of the compliances hold for this place.
        offset: Origin of the spring in the child frame of its joint. Shape (3,). [m]
        standard_errors: Of the offset; zero along the spring's own axis, where it changes nothing. Shape (3,). [m]
    """

    structure: FreeRobot
    estimate: Estimate
    offset: Array
    standard_errors: Array


def place_spring(
    structure: FreeRobot,
    name: str,
    observations: Observations,
    *,
    registration: Registration | None = None,
    loss: str = "least_squares",
    reference: str = "absolute",
) -> SpringPlace:
    """Fit the two components of a turning spring's offset across its axis, everything else fitted along at each place.

    Args:
        structure: Robot and free parameters, the spring among them.
        name: Name of the spring, such as "joint_3.rx".
        observations: The measured rows.
        registration: Frames of the campaign; its `parts` are fitted along.
        loss: "least_squares", "huber" or "tukey".
        reference: "absolute" or "difference".

    Raises:
        InputError: If the spring does not turn about tx ty tz rx ry rz, or no place within 1 m fits.
    """
    index = structure.spring_labels.index(name)
    spring = structure.robot.springs[index]
    if not spring.axis.startswith("r"):
        raise InputError(f"spring {name!r} acts about or along {spring.axis}, expected one about rx, ry or rz")
    across = np.flatnonzero(np.array(ELASTIC_AXES[spring.axis][1]) == 0)
    group = pose_groups(observations) if reference == "difference" else None

    def fit(components: Array) -> tuple[FreeRobot, Estimate]:
        offset = spring.offset.copy()
        offset[across] = components
        placed = move_spring(structure, index, offset)
        options = {"registration": registration, "loss": loss, "reference": reference}
        return placed, estimate_parameters(placed, observations, **options)  # type: ignore[arg-type]

    start = fit(spring.offset[across])[1]

    def residual(components: Array) -> Array:
        placed, estimate = fit(components)
        system = linearise(
            placed, observations, estimate.registration, estimate.prediction, estimate.model_values
        )
        root = np.sqrt(start.weights)[:, None]
        return np.asarray(weigh(system, system.whitener(start.noise) * root, group)[0].ravel())

    try:
        found = least_squares(
            residual, spring.offset[across], bounds=(-FARTHEST, FARTHEST), diff_step=0.01, x_scale=0.1, xtol=1e-5,
            method="trf", max_nfev=20,
        )  # fmt: skip
    except CompplanError as error:
        raise InputError(f"no place of spring {name!r} within {FARTHEST:g} m of its joint fits: {error}") from None
    placed, estimate = fit(found.x)
    errors = np.zeros(3)
    spread = np.linalg.pinv(found.jac.T @ found.jac)
    scale = np.sqrt(2 * found.cost / max(len(found.fun) - len(start.values) - 2, 1))
    errors[across] = scale * np.sqrt(np.diag(spread))
    return SpringPlace(placed, estimate, placed.robot.springs[index].offset, errors)


def move_spring(structure: FreeRobot, index: int, offset: Array) -> FreeRobot:
    """Put a spring of a structure elsewhere. Index in `structure.robot.springs`; offset shape (3,). [m]"""
    springs = list(structure.robot.springs)
    springs[index] = replace(springs[index], offset=np.asarray(offset, float))
    robot = replace(structure.robot, springs=tuple(springs))
    return replace(structure, robot=robot, chain=build_chain(robot))
