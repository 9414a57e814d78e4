"""Sampling of a study: coordinates of the unit cube, choice of points, and conversion of points to sampled robots.

A sample is a point of the unit cube. Most coordinates become one number (a compliance factor, a zero, a force level);
some become the seed of a noise along the path. All random numbers of a sample follow from its point. Axes of arrays:
components, b samples, n waypoints.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.special import ndtri
from scipy.stats import qmc

from compplan.effects import build_model, command_campaign, solve_model_poses
from compplan.job.noise import EXPANSION, NoiseTable
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.studies.posterior import (
    RobotPosterior,
    build_posterior,
    count_coordinates,
    move_by_parameters,
    move_by_smooth_errors,
)
from compplan.toolpath.toolpath import interpolate
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.sensitivities import CORRELATION, ForceSpread, build_path_model, pick_rows

#: Knots of the noise along the path per correlation length, and their greatest number.
KNOTS, MOST_KNOTS = 10, 20000
#: Factors that are the seed of a noise along the path.
NOISES = ("wrench_path", "encoders", "force_noise")
#: Standard deviation of motor-side encoders (assumed: 17 bits behind a gear, far finer than its mounting) and of
#: link-side ones (assumed: a ring of 20 bits with its mounting error). [deg]
ENCODERS = (0.0003, 0.0008)
#: Drift of a force sensor since taring, as a multiple of its noise (assumed).
DRIFT = 2.5
#: Ratio of moment to force errors of a force sensor, for noise and drift (assumed). [m]
NOISE_ARM, BIAS_ARM = 0.05, 0.1
#: Standard deviation of the gain of a force sensor (assumed; datasheets state 1 %).
GAIN = 0.01
#: Waypoints at which motions of the tip are computed.
STATIONS = 200
#: Coordinates of a placement: three translations, three rotations.
TWIST = 6


@dataclass(frozen=True)
class SampleContext:
    """Data common to all samples; n waypoints."""

    noise: NoiseTable  #: The standard deviations of part and sensors.
    force: ForceSpread  #: Uncertainty of the force.
    factors: Factors  #: The coordinates of a sample.
    wrench: Array  #: Predicted wrench. Shape (6, n). [N, N m]
    nq: int  #: Number of joints.
    link_share: Array  #: Share of each compliance beyond the link-side encoder. Shape (s,).
    #: Motion of the tip by thermal growth, placement of the part and coordinates of the robot, per unit of growth and
    #: per standard deviation of the others. Shape (k, 3, n). [m]
    shift: Array
    knot: Array  #: Position of each waypoint among the knots of the noise along the path. Shape (n,).
    forget: float  #: Correlation of the noise at neighbouring knots.
    repeatability: float  #: Standard deviation per axis. [m]
    posterior: RobotPosterior  #: Parameter uncertainty from which robots are drawn.


class SampledRobots(NamedTuple):
    """b sampled robots with their process errors; each cuts one part."""

    factor: Array  #: Factor on each compliance. Shape (s, b).
    link_share: Array  #: Share of each compliance beyond the link-side encoder. Shape (s, b).
    zero: Array  #: True minus read position of each joint. Shape (nq, b). [rad or m]
    drive: Array  #: Link-side minus motor-side position, without deflection. Shape (nq, b, n). [rad or m]
    causes: Array  #: Thermal growth, coordinates of the placement of the part and of the robot. Shape (k, b).
    shift: Array  #: Motion of the tip due to `causes`, at the posture of the task. Shape (3, b, n). [m]
    wrench: Array  #: Wrench on the tool. Shape (6, b, n). [N, N m]
    repeat: Array  #: Scatter of the tip from part to part. Shape (3, b). [m]
    motor: Array  #: Error of motor-side encoders. Shape (nq, b, n). [rad or m]
    link: Array  #: Error of link-side encoders. Shape (nq, b, n). [rad or m]
    force: Array  #: Error of the force sensor. Shape (6, b, n). [N, N m]


def build_context(task: PlanTask, noise: NoiseTable, force: ForceSpread) -> SampleContext:
    """Compute the data common to all samples of a task."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(task.position, axis=0), axis=1))])
    knots = min(int(np.ceil(length[-1] / CORRELATION * KNOTS)) + 2, MOST_KNOTS)
    spacing = max(length[-1], 1e-9) / (knots - 1)
    return SampleContext(
        noise=noise,
        force=force,
        factors=list_factors(task.robot, noise, force),
        wrench=np.ascontiguousarray(task.wrench.T),
        nq=task.robot.nq,
        link_share=task.chain.link_share,
        shift=differentiate_placements(task, noise),
        knot=np.minimum(length / spacing, knots - 1.000001),
        forget=float(np.exp(-spacing / CORRELATION)),
        repeatability=robot_uncertainty(task.robot).repeatability or 0.0,
        posterior=build_posterior(task.robot, task.q_start, command_campaign(task.q_start).approach.T, force),
    )


def differentiate_placements(task: PlanTask, noise: NoiseTable) -> Array:
    """Return the motion of the tip by thermal growth, placement of the part and robot. Shape (k, 3, n). [m]

    Growth is differentiated on the unloaded robot: the load changes it only by the relative deflection.
    """
    parts = [grow_arm(task.robot, task.q_start), *np.moveaxis(task.spread_part(noise), 2, 0)]
    rows = pick_rows(np.ones(len(task), bool), STATIONS)
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    posterior = build_posterior(task.robot, task.q_start, np.zeros((task.robot.nq, len(task))))
    drawn = [
        *move_by_parameters(scene, rows, posterior),
        *move_by_smooth_errors(task.position[rows], robot_uncertainty(task.robot), task.touched),
    ]
    parts += [interpolate(np.arange(len(task)), rows, values) for values in drawn]
    return np.ascontiguousarray(np.swapaxes(np.array(parts), 1, 2))


def grow_arm(robot: Robot, q: Array) -> Array:
    """Return the motion of the unloaded tip per thermal growth of the arm at joint positions (n, nq). (n, 3). [m]"""
    scene = build_model(replace(robot, springs=(), link_elasticities=(), effects=()), command_campaign(q))
    grown = solve_model_poses(replace(scene, growth=scene.growth + 1.0)).position
    return np.asarray(grown - solve_model_poses(scene).position)


def sample_robots(at: SampleContext, points: Array) -> SampledRobots:
    """Convert points of the unit cube to sampled robots. points: shape (b, size)."""
    noise, columns = at.noise, at.factors.columns
    normal = to_normal(points)

    def take(name: str) -> Array:
        return np.ascontiguousarray(normal[:, columns[name]].T)

    factor = np.ones((len(at.link_share), len(points)))
    share = np.repeat(at.link_share[:, None], len(points), axis=1)
    unsure = (at.link_share > 0.0) & (at.link_share < 1.0)
    share[unsure] = np.clip(share[unsure] + noise.link_share * take("link_share"), 0.0, 1.0)
    robot = take("posterior")
    growth = noise.temperature_K * EXPANSION * take("temperature")
    causes = np.vstack([growth, take("part_frame"), robot])
    bias, drift = take("force_bias"), DRIFT * noise.force_noise_N
    shares = np.vstack([take("wrench_level"), take("wrench_direction")])
    wrench = _draw_wrench(at, at.posterior.push(robot, shares), points)
    force = _draw_white(at, points, "force_noise", (6, at.wrench.shape[1]))
    force *= _six(noise.force_noise_N, NOISE_ARM * noise.force_noise_N)
    force += bias[:6, :, None] * _six(drift, BIAS_ARM * drift) + GAIN * bias[6, :, None] * wrench
    motor, link = (
        np.radians(size) * _draw_white(at, points, "encoders", (at.nq, at.wrench.shape[1]), side)
        for side, size in enumerate(ENCODERS)
    )
    zero = np.zeros((at.nq, len(points)))
    at.posterior.draw(robot, factor, zero)
    return SampledRobots(
        factor=factor,
        link_share=share,
        zero=zero,
        drive=at.posterior.draw_drives(robot, np.zeros((at.nq, len(points), at.wrench.shape[1]))),
        causes=causes,
        shift=shift_tip(causes, at.shift),
        wrench=wrench,
        repeat=at.repeatability * take("repeatability"),
        motor=motor,
        link=link,
        force=force,
    )


def shift_tip(causes: Array, rates: Array) -> Array:
    """Move the tip by placement errors: causes (k, b), motion per cause (k, 3, n); shape (3, b, n). [m]"""
    return np.einsum("kb,kin->ibn", causes, rates, optimize=False)


def _draw_wrench(at: SampleContext, shares: Array, points: Array) -> Array:
    """Draw the wrench on the tool: level and direction per sample, and a variation along the path.

    shares: level and rotations, in standard deviations. Shape (4, b).
    """
    force = at.force
    turn = Rotation.from_rotvec(force.direction * shares[1:].T).as_matrix()
    level = 1.0 + force.level * shares[0]
    turned = np.concatenate([np.einsum("bij,jn->ibn", turn, half) for half in (at.wrench[:3], at.wrench[3:])])
    turned *= level[:, None] + force.path * _draw_along_path(at, points)
    return turned


def _six(force: float, moment: float) -> Array:
    return np.repeat([force, moment], 3)[:, None, None]


def _draw_white(at: SampleContext, points: Array, factor: str, shape: tuple[int, int], part: int = 0) -> Array:
    """Draw white noise seeded by a coordinate of each point, its own for every part. Shape (rows, b, columns).

    It is independent of the position of a point in its batch. shape: rows and columns.
    """
    column = at.factors.columns[factor].start
    drawn = np.empty((shape[0], len(points), shape[1]))
    for b, point in enumerate(points):
        key = np.random.SeedSequence([int(point[column] * 2.0**53), NOISES.index(factor), part])
        drawn[:, b] = np.random.Generator(np.random.SFC64(key)).standard_normal(shape)
    return drawn


def _draw_along_path(at: SampleContext, points: Array) -> Array:
    """Draw noise of variance 1 that is correlated along the path. Shape (b, n)."""
    white = _draw_white(at, points, "wrench_path", (1, int(at.knot[-1]) + 2))[0]
    white[:, 1:] *= np.sqrt(1.0 - at.forget**2)
    coloured = lfilter([1.0], [1.0, -at.forget], white, axis=-1)
    before = at.knot.astype(int)
    share = at.knot - before
    return np.asarray(coloured[:, before] * (1.0 - share) + coloured[:, before + 1] * share)


@dataclass(frozen=True)
class Factors:
    """The coordinates of a sample."""

    columns: Mapping[str, slice]  #: Columns of the point, by factor.
    groups: tuple[str, ...]  #: Group of every coordinate in the sensitivity analysis; empty: no uncertainty.


def list_factors(robot: Robot, noise: NoiseTable, force: ForceSpread) -> Factors:
    """List the factors of a robot; groups without any uncertainty are left out of the sensitivity analysis."""
    unsure = sum(1 for spring in robot.springs if 0.0 < spring.link_share < 1.0)
    # number of coordinates, group of the sensitivity analysis, and a standard deviation: no uncertainty if it is 0
    factors = {
        "link_share": (unsure, "link_share", noise.link_share),
        "part_frame": (TWIST, "part", max(noise.part_frame_mm, noise.part_frame_deg)),
        "temperature": (1, "temperature", noise.temperature_K),
        "wrench_level": (1, "wrench_level", force.level),
        "wrench_direction": (3, "wrench_direction", force.direction),
        "wrench_path": (1, "wrench_path", force.path),
        "encoders": (1, "encoders", 1.0),
        "repeatability": (3, "repeatability", robot_uncertainty(robot).repeatability or 0.0),
        "force_bias": (7, "force_sensor", 1.0),
        "force_noise": (1, "force_sensor", 1.0),
        "posterior": (count_coordinates(robot), "robot", 1.0),
    }
    columns, groups = dict[str, slice](), list[str]()
    for name, (size, group, level) in factors.items():
        columns[name] = slice(len(groups), len(groups) + size)
        groups += [group if level > 0.0 else ""] * size
    return Factors(columns, tuple(groups))


def draw_points(factors: Factors, seed: int, replicates: int, samples: range) -> Array:
    """Draw points of the unit cube; sample i is point i // replicates of the Sobol sequence i % replicates.

    The replicates are scrambled independently, so that their scatter gives intervals of means [Owen1995]. `samples` is
    a contiguous range. Shape (len(samples), size).
    """
    points = np.empty((len(samples), len(factors.groups)))
    for replicate in range(replicates):
        rows = [i for i in samples if i % replicates == replicate]
        if not rows:
            continue
        engine, first = _scramble_sequence(len(factors.groups), seed, replicate), rows[0] // replicates
        if engine.num_generated > first:
            engine.reset()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # not a power of two: less balanced, still valid
            if first > engine.num_generated:
                engine.fast_forward(first - engine.num_generated)
            points[np.array(rows) - samples.start] = engine.random(len(rows))
    return np.clip(points, 1e-12, 1.0 - 1e-12)


@lru_cache(maxsize=32)
def _scramble_sequence(size: int, seed: int, replicate: int) -> qmc.Sobol:
    """Scramble the Sobol sequence of a replicate; cached, as it costs as much as thousands of points."""
    return qmc.Sobol(size, scramble=True, rng=np.random.default_rng(np.random.SeedSequence([seed, replicate])))


def to_normal(points: Array) -> Array:
    """Convert uniform coordinates to standard normal ones."""
    return np.asarray(ndtri(points))
