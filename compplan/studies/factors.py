"""The factors of a study: which coordinate of a sample's point stands for what, and how the points are chosen.

A sample is a point of the unit cube. Most coordinates become one number (a compliance factor, a zero, a force level);
some become the seed of a noise along the path. Everything random about a sample follows from its point.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from compplan.job.noise import NoiseTable
from compplan.robot import Array, Robot
from compplan.studies.posterior import count_coordinates
from compplan.uncertainty.assumed import robot_uncertainty

#: Coordinates of a placement: three translations, three rotations.
TWIST = 6


@dataclass(frozen=True)
class Factors:
    """The coordinates of a sample's point.

    Attributes:
        columns: By factor, the columns of the point that belong to it.
        groups: By group of the sensitivity analysis, its factors.
    """

    columns: Mapping[str, slice]
    groups: Mapping[str, tuple[str, ...]]

    @property
    def size(self) -> int:
        """Count the coordinates."""
        return max(part.stop for part in self.columns.values())

    def group_names(self) -> list[str]:
        """Name the group of every coordinate. Length `size`."""
        names = [""] * self.size
        for group, factors in self.groups.items():
            for factor in factors:
                for column in range(self.columns[factor].start, self.columns[factor].stop):
                    names[column] = group
        return names


def list_factors(robot: Robot, noise: NoiseTable) -> Factors:
    """List the factors of a robot; groups without any uncertainty are left out of the sensitivity analysis."""
    sizes = {
        "link_share": sum(1 for spring in robot.springs if 0.0 < spring.link_share < 1.0),
        "part_frame": TWIST,
        "temperature": 1,
        "wrench_level": 1,
        "wrench_direction": 3,
        "wrench_path": 1,
        "encoders": 1,
        "repeatability": 3,
        "force_bias": 7,
        "force_noise": 1,
        "posterior": count_coordinates(robot),
    }
    starts = np.concatenate([[0], np.cumsum(list(sizes.values()))])
    columns = {name: slice(int(a), int(a) + size) for (name, size), a in zip(sizes.items(), starts, strict=False)}
    groups = {
        "link_share": (noise.link_share, ("link_share",)),
        "part": (max(noise.part_frame_mm, noise.part_frame_deg), ("part_frame",)),
        "temperature": (noise.temperature_K, ("temperature",)),
        "wrench_level": (noise.wrench_level, ("wrench_level",)),
        "wrench_direction": (noise.wrench_direction_deg, ("wrench_direction",)),
        "wrench_path": (noise.wrench_path, ("wrench_path",)),
        "encoders": (1.0, ("encoders",)),
        "repeatability": (robot_uncertainty(robot).repeatability or 0.0, ("repeatability",)),
        "force_sensor": (1.0, ("force_bias", "force_noise")),
        "robot": (1.0, ("posterior",)),
    }
    kept = {
        name: factors
        for name, (level, factors) in groups.items()
        if level > 0.0 and sum(sizes[factor] for factor in factors) > 0
    }
    return Factors(columns, kept)


def draw_points(factors: Factors, seed: int, replicates: int, samples: range) -> Array:
    """Draw points inside the unit cube; sample i is point i // replicates of the Sobol sequence i % replicates.

    The replicates are scrambled independently, so that their scatter gives intervals of means [Owen1995]. `samples` is
    a contiguous range. Shape (len(samples), size).
    """
    points = np.empty((len(samples), factors.size))
    for replicate in range(replicates):
        rows = [i for i in samples if i % replicates == replicate]
        if not rows:
            continue
        first, count = rows[0] // replicates, len(rows)
        rng = np.random.default_rng(np.random.SeedSequence([seed, replicate]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no power of two: balanced less, not wrong
            engine = qmc.Sobol(factors.size, scramble=True, rng=rng)
            if first:
                engine.fast_forward(first)
            points[np.array(rows) - samples.start] = engine.random(count)
    return np.clip(points, 1e-12, 1.0 - 1e-12)


def to_normal(points: Array) -> Array:
    """Turn uniform coordinates into standard normal ones."""
    return np.asarray(ndtri(points))
