"""Numbers of a controller's model that come nearest to a measured robot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from compplan.robot import Array
from compplan.robot.calibration.geometry import ZeroPose, place_flange

#: Poses that the numbers are fitted to, drawn over half a turn to either side.
POSES = 40
#: Distance from the flange of two points that count beside its centre: a tool's length, assumed. [m]
LEVER = 0.3
#: Steps of the fit; numbers that differ by millimetres settle in three.
STEPS = 6
#: Step of the derivatives. [m or rad]
STEP = 1e-6
#: Combinations of numbers that move the tip less than this share of the most moving one stay as they are.
SILENT = 1e-6


def fit_numbers(walk: Callable[[Array], ZeroPose], start: Array, wanted: ZeroPose) -> Array:
    """Fit the numbers of a model to axes and flange; what no pose tells stays as it was.

    min_p sum_q |x_q(p) - x_q|^2 by Gauss-Newton with the smallest change, x three points at the flange.

    Args:
        walk: Axes and flange at the zero pose by the model's numbers.
        start: The numbers as they are now. Shape (m,). [m or rad]
        wanted: Axes and flange of the measured robot.

    Returns:
        The numbers. Shape (m,). [m or rad]
    """
    drawn = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, len(wanted.point)))

    def see(zero: ZeroPose) -> Array:
        frames = np.array([place_flange(zero, q)[0] for q in drawn])
        centre, turned = frames[:, None, :3, 3], frames[:, :3, :2].transpose(0, 2, 1)
        return np.concatenate([centre, centre + LEVER * turned], axis=1).ravel()

    there, numbers = see(wanted), np.array(start, dtype=np.float64)
    for _ in range(STEPS):
        here = see(walk(numbers))
        slopes = np.array([(see(walk(numbers + STEP * unit)) - here) / STEP for unit in np.eye(len(numbers))]).T
        numbers = numbers + np.linalg.lstsq(slopes, there - here, rcond=SILENT)[0]
    return numbers
