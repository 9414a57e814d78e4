"""The band against drawn robots: how many true tips it holds, by the exact loaded equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.effects import Effect, apply_effects, attain_scene
from compplan.effects.scene import Scene
from compplan.known.slopes import pick_rows, take_rows, turn_wrench
from compplan.known.vary import draw_field, draw_values, vary_scene
from compplan.measure.distance import LEVEL
from compplan.promise.band import Promise
from compplan.robot import Array
from compplan.robot.uncertainty import Uncertainty


class Sampled(NamedTuple):
    """What drawn robots do; b draws, k rows.

    Attributes:
        held: Share of true tips, over draws and rows, that lie within the band.
        by_row: The same at every row. Shape (k,).
        rows: The rows. Shape (k,).
        distance: Distance of the true tip from the planned one. Shape (b, k). [m]
        oracle: Distance that holds them with 95 %, as who knows the truth of all draws has it. Shape (k,). [m]
    """

    held: float
    by_row: Array
    rows: NDArray[np.int_]
    distance: Array
    oracle: Array


def sample_promise(
    scene: Scene, promise: Promise, draws: int, seed: int, most: int = 24, *, true: Uncertainty | None = None,
    hide: Callable[[np.random.Generator], Iterable[Effect]] = lambda random: (),
) -> Sampled:  # fmt: skip
    """Draw robots and forces, solve each exactly, and count how many tips the band holds.

    Args:
        scene: The robot at all rows of the path.
        promise: The promise.
        draws: How many robots.
        seed: Seed.
        most: Rows that are looked at, at most.
        true: What the robots are drawn from; what the promise knows if left out.
        hide: Draws effects that the promise knows nothing of.
    """
    rows, known = pick_rows(promise.cut, most), true or promise.known
    rest = attain_scene(take_rows(scene, rows)).position
    random = np.random.default_rng(seed + 1)
    distance = np.zeros((draws, len(rows)))
    for number, values in enumerate(draw_values(known, draws, seed)):
        here = take_rows(vary_scene(scene, known.unknowns, values), rows)
        here = replace(here, wrench=draw_wrench(here.wrench, promise, random))
        here = apply_effects(here, list(hide(random)))
        tip = attain_scene(here).position + draw_field(known, seed, number).at(rest)
        tip = tip + (known.repeatability or 0.0) * random.standard_normal(3)
        distance[number] = np.linalg.norm(tip - rest, axis=1)
    held = distance <= promise.radius[rows]
    return Sampled(float(held.mean()), held.mean(axis=0), rows, distance, np.quantile(distance, LEVEL, axis=0))


def draw_wrench(wrench: Array, promise: Promise, random: np.random.Generator) -> Array:
    """Draw the wrench that really acts. Shape (k, 6). [N, N m]."""
    force = promise.force
    turn = Rotation.from_rotvec(force.direction * random.standard_normal(3))
    level = 1.0 + force.level * random.standard_normal() + force.path * random.standard_normal((len(wrench), 1))
    return np.asarray(level * turn_wrench(wrench, turn))
