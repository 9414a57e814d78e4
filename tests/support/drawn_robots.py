"""Robots drawn from what is known of one, and how many of their true tips a band holds, by the exact equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.effects import Effect, apply_effects, solve_model_poses
from compplan.effects.forward_model import ForwardModel
from compplan.measurement.distance import LEVEL
from compplan.robot import Array
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.band import ErrorBand
from compplan.uncertainty.sensitivities import (
    pick_rows,
    select_model_rows,
    turn_wrench,
    vary_model,
)

#: Waves that a drawn field is made of.
WAVES = 64


@dataclass(frozen=True, eq=False)
class Field:
    """A smooth random error over the workspace: e(x) = a sum_k c_k cos(w_k . x + f_k), Gaussian of a given scale."""

    frequency: Array  #: Shape (k, 3). [rad/m]
    phase: Array  #: Shape (k,). [rad]
    amplitude: Array  #: Shape (k, 3). [m]

    def at(self, position: Array) -> Array:
        """Return the error at places in the base frame. Shape (n, 3). [m]."""
        return np.asarray(np.cos(position @ self.frequency.T + self.phase) @ self.amplitude)


def draw_values(known: Uncertainty, count: int, seed: int) -> Array:
    """Draw parameters about the folder's values. Shape (count, p). [SI]"""
    root = known.spread
    return np.asarray(np.random.default_rng(seed).standard_normal((count, root.shape[1])) @ root.T)


def draw_field(known: Uncertainty, seed: int, number: int) -> Field:
    """Draw what no parameter explains of robot `number`: covariance exp(-d^2 / 2 l^2), by random waves."""
    random = np.random.default_rng(seed + 7919 * (number + 1))
    frequency = random.standard_normal((WAVES, 3)) / known.scale
    phase = random.uniform(0.0, 2.0 * np.pi, WAVES)
    return Field(frequency, phase, known.smooth * np.sqrt(2.0 / WAVES) * random.standard_normal((WAVES, 3)))


class Sampled(NamedTuple):
    """What drawn robots do; b draws, k rows."""

    held: float  #: Share of true tips, over draws and rows, that lie within the band.
    by_row: Array  #: The same at every row. Shape (k,).
    rows: NDArray[np.int_]  #: The rows. Shape (k,).
    distance: Array  #: Distance of the true tip from the planned one. Shape (b, k). [m]
    oracle: Array  #: Distance that holds them with 95 %, as who knows the truth of all draws has it. Shape (k,). [m]


def sample_band(
    scene: ForwardModel, error_band: ErrorBand, draws: int, seed: int, most: int = 24, *,
    true: Uncertainty | None = None, hide: Callable[[np.random.Generator], Iterable[Effect]] = lambda random: (),
) -> Sampled:  # fmt: skip
    """Draw robots (of `true`) with `hide` unknown to the band, solve each exactly, and count tips in the band."""
    rows, known = pick_rows(error_band.cut, most), true or error_band.known
    rest = solve_model_poses(select_model_rows(scene, rows)).position
    random = np.random.default_rng(seed + 1)
    distance = np.zeros((draws, len(rows)))
    for number, values in enumerate(draw_values(known, draws, seed)):
        here = select_model_rows(vary_model(scene, known.unknowns, values), rows)
        here = replace(here, wrench=draw_wrench(here.wrench, error_band, random))
        here = apply_effects(here, list(hide(random)))
        tip = solve_model_poses(here).position + draw_field(known, seed, number).at(rest)
        tip = tip + (known.repeatability or 0.0) * random.standard_normal(3)
        distance[number] = np.linalg.norm(tip - rest, axis=1)
    held = distance <= error_band.radius[rows]
    return Sampled(float(held.mean()), held.mean(axis=0), rows, distance, np.quantile(distance, LEVEL, axis=0))


def draw_wrench(wrench: Array, error_band: ErrorBand, random: np.random.Generator) -> Array:
    """Draw the wrench that really acts. Shape (k, 6). [N, N m]."""
    force = error_band.force
    turn = Rotation.from_rotvec(force.direction * random.standard_normal(3))
    level = 1.0 + force.level * random.standard_normal() + force.path * random.standard_normal((len(wrench), 1))
    return np.asarray(level * turn_wrench(wrench, turn))
