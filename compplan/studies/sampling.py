"""What a sample's point means in the cell: compliances, zeros, gear errors, geometry, wrench, and the noise of sensors.

Arrays are components first, then b samples, then n waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from compplan.effects import build_model, command_campaign, solve_model_poses
from compplan.job.noise import EXPANSION, NoiseTable
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.robot.pose import rigid_columns
from compplan.studies.factors import Factors, to_normal
from compplan.studies.posterior import RobotPosterior, move_by_posterior, take_posterior
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.motion import read_placement
from compplan.uncertainty.sensitivities import ForceSpread

#: Knots of the noise along the path per correlation length, and their greatest number.
KNOTS, MOST_KNOTS = 10, 20000
_PATH, _ENCODERS, _FORCE = range(3)
#: Correlation length of the force along the path (assumed). [m]
CORRELATION = 0.02
#: Errors of motor-side encoders (assumed: 17 bits behind a gear, far finer than its mounting) and of link-side ones
#: (assumed: a ring of 20 bits with its mounting error). [deg]
ENCODERS = (0.0003, 0.0008)
#: Drift of a force sensor since taring, as a multiple of its noise (assumed).
DRIFT = 2.5
#: Moments of a force sensor by its forces, noise and drift (assumed). [m]
NOISE_ARM, BIAS_ARM = 0.05, 0.1
#: Gain of a force sensor, one standard deviation (assumed; datasheets state 1 %).
GAIN = 0.01


@dataclass(frozen=True)
class Surroundings:
    """What all samples share; n waypoints.

    Attributes:
        noise: The standard deviations.
        factors: The coordinates of a sample's point.
        wrench: Predicted wrench. Shape (6, n). [N, N m]
        q: Commanded joints, for what depends on angle and direction of travel. Shape (nq, n). [rad or m]
        travel: Direction of travel of each joint, -1, 0 or 1. Shape (nq, n).
        link_share: Share of each compliance beyond the link-side encoder. Shape (s,).
        n_springs: Number of elastic coordinates.
        shift: Motion of the tip per growth, place of the part and coordinate of the robot. Shape (k, 3, n).
            [m per m, rad, 1]
        scale: Standard deviation of each of them. Shape (k,). [m, rad, 1]
        knot: Position of each waypoint among the knots of the noise along the path. Shape (n,).
        forget: What is left of the noise from one knot to the next.
        repeatability: Standard deviation, an axis. [m]
        posterior: What is known of the robot, which robots are drawn from.
    """

    noise: NoiseTable
    factors: Factors
    wrench: Array
    q: Array
    travel: Array
    link_share: Array
    n_springs: int
    shift: Array
    scale: Array
    knot: Array
    forget: float
    repeatability: float
    posterior: RobotPosterior


class Cells(NamedTuple):
    """b cells; a part is cut in each.

    Attributes:
        factor: Factor on each compliance. Shape (s, b).
        link_share: Share of each compliance beyond the link-side encoder. Shape (s, b).
        zero: True minus read position of each joint. Shape (nq, b). [rad or m]
        drive: Link-side minus motor-side position, elastic part left out. Shape (nq, b, n). [rad or m]
        causes: Growth, place of the part and robot. Shape (k, b). [m, rad, 1]
        shift: Motion of the tip by them, at the posture of the task. Shape (3, b, n). [m]
        wrench: Wrench on the tool. Shape (6, b, n). [N, N m]
        repeat: Scatter of the tip from part to part. Shape (3, b). [m]
        motor: Error of motor-side encoders. Shape (nq, b, n). [rad or m]
        link: Error of link-side encoders. Shape (nq, b, n). [rad or m]
        force: Error of the force sensor. Shape (6, b, n). [N, N m]
    """

    factor: Array
    link_share: Array
    zero: Array
    drive: Array
    causes: Array
    shift: Array
    wrench: Array
    repeat: Array
    motor: Array
    link: Array
    force: Array


def survey_surroundings(
    task: PlanTask, noise: NoiseTable, factors: Factors, force: ForceSpread | None = None
) -> Surroundings:
    """Work out what all samples of a task share; `force`: what measured parts said of it."""
    chain, q = task.chain, task.q_start
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(task.position, axis=0), axis=1))])
    knots = min(int(np.ceil(length[-1] / CORRELATION * KNOTS)) + 2, MOST_KNOTS)
    spacing = max(length[-1], 1e-9) / (knots - 1)
    shift, scale = differentiate_placements(task, noise)
    return Surroundings(
        noise=noise,
        factors=factors,
        wrench=np.ascontiguousarray(task.wrench.T),
        q=np.ascontiguousarray(q.T),
        travel=find_travel(q).T,
        link_share=chain.link_share,
        n_springs=chain.n_springs,
        shift=shift,
        scale=scale,
        knot=np.minimum(length / spacing, knots - 1.000001),
        forget=float(np.exp(-spacing / CORRELATION)),
        repeatability=robot_uncertainty(task.robot).repeatability or 0.0,
        posterior=take_posterior(task, find_travel(q).T, force),
    )


def find_travel(q: Array) -> Array:
    """Find the direction in which each joint moved last, 0 before it first moves. Shape (n, nq)."""
    step = np.diff(q, axis=0)
    sign = np.vstack([np.zeros(q.shape[1]), np.sign(np.where(np.abs(step) > 1e-9, step, 0.0))])
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(q))[:, None], 0), axis=0)
    return np.asarray(np.take_along_axis(sign, last, axis=0))


def differentiate_placements(task: PlanTask, noise: NoiseTable) -> tuple[Array, Array]:
    """Return the tip's motion by growth, part frame and robot, (k, 3, n), and their sigmas, (k,).

    To first order, of the unloaded robot: the load changes it by its own relative deflection.
    """
    bare = replace(task.robot, springs=(), link_elasticities=(), effects=())
    scene = build_model(bare, command_campaign(task.q_start))
    grown = solve_model_poses(replace(scene, growth=scene.growth + 1.0)).position
    parts = [grown - solve_model_poses(scene).position]
    scale = [noise.temperature_K * EXPANSION]
    if task.touched is not None and read_placement(noise) is None:
        parts += list(np.moveaxis(task.touched.spread_part(task.position), 2, 0))
        scale += [1.0] * 6
    else:
        parts += list(np.moveaxis(rigid_columns(task.position, task.position.mean(axis=0)), 2, 0))
        scale += [noise.part_frame_mm * 1e-3] * 3 + [float(np.radians(noise.part_frame_deg))] * 3
    drawn = move_by_posterior(task, robot_uncertainty(task.robot))
    parts, scale = parts + drawn, scale + [1.0] * len(drawn)
    return np.ascontiguousarray(np.swapaxes(np.array(parts), 1, 2)), np.array(scale)


def sample_robots(at: Surroundings, points: Array) -> Cells:
    """Make cells of points of the unit cube. points: shape (b, size)."""
    noise, columns = at.noise, at.factors.columns
    normal = to_normal(points)

    def take(name: str) -> Array:
        return np.ascontiguousarray(normal[:, columns[name]].T)

    factor = np.ones((at.n_springs, len(points)))
    share = np.repeat(at.link_share[:, None], len(points), axis=1)
    unsure = (at.link_share > 0.0) & (at.link_share < 1.0)
    share[unsure] = np.clip(share[unsure] + noise.link_share * take("link_share"), 0.0, 1.0)
    moving = ("temperature", "part_frame")
    robot = at.posterior.settle(take("posterior"))
    causes = np.vstack([*(take(name) for name in moving), robot])
    causes *= at.scale[:, None]
    bias, noises, drift = take("force_bias"), _Noises(at, points), DRIFT * noise.force_noise_N
    shares = np.vstack([take("wrench_level"), take("wrench_direction")])
    shares = at.posterior.push(robot, shares)
    wrench = _draw_wrench(at, shares, noises)
    force = noises.white(_FORCE, "force_noise", 0, 6)
    force *= _six(noise.force_noise_N, NOISE_ARM * noise.force_noise_N)
    force += (bias[:6, :, None] * _six(drift, BIAS_ARM * drift)
              + GAIN * bias[6, :, None] * wrench)  # fmt: skip
    nq, n = at.q.shape
    zero, drive = np.zeros((nq, len(points))), np.zeros((nq, len(points), n))
    at.posterior.draw(robot, factor, zero, drive)
    return Cells(
        factor=factor,
        link_share=share,
        zero=zero,
        drive=drive,
        causes=causes,
        shift=shift_tip(causes, at.shift),
        wrench=wrench,
        repeat=at.repeatability * take("repeatability"),
        motor=noises.encoder(0),
        link=noises.encoder(1),
        force=force,
    )


def shift_tip(causes: Array, rates: Array) -> Array:
    """Move the tip by placement errors: causes (k, b), motion per cause (k, 3, n); shape (3, b, n). [m]"""
    return np.einsum("kb,kin->ibn", causes, rates, optimize=False)


def _draw_wrench(at: Surroundings, shares: Array, noises: _Noises) -> Array:
    """Draw the wrench on the tool: level and direction hold for the cell, what varies along the path for a part.

    shares: level and turns, in their deviations. Shape (4, b).
    """
    noise = at.noise
    turn = Rotation.from_rotvec(np.radians(noise.wrench_direction_deg) * shares[1:].T).as_matrix()
    level = 1.0 + noise.wrench_level * shares[0]
    turned = np.concatenate([np.einsum("bij,jn->ibn", turn, half) for half in (at.wrench[:3], at.wrench[3:])])
    turned *= level[:, None] + noise.wrench_path * noises.along_path()
    return turned


def _six(force: float, moment: float) -> Array:
    return np.repeat([force, moment], 3)[:, None, None]


class _Noises:
    """Noise along the path, drawn from the seeds in the points: the same for a point wherever it stands."""

    def __init__(self, at: Surroundings, points: Array) -> None:
        self.at = at
        self.points = points
        self.n = at.wrench.shape[1]

    def _fill(self, kind: int, factor: str, part: int, shape: tuple[int, int]) -> Array:
        column = self.at.factors.columns[factor].start
        drawn = np.empty((shape[0], len(self.points), shape[1]))
        for b, point in enumerate(self.points):
            key = np.random.SeedSequence([int(point[column] * 2.0**53), kind, part])
            drawn[:, b] = np.random.Generator(np.random.SFC64(key)).standard_normal(shape)
        return drawn

    def white(self, kind: int, factor: str, part: int, rows: int) -> Array:
        """Draw white noise. Shape (rows, b, n)."""
        return self._fill(kind, factor, part, (rows, self.n))

    def along_path(self) -> Array:
        """Draw noise of variance 1 that is correlated along the path. Shape (b, n)."""
        at = self.at
        forget, knots = at.forget, int(at.knot[-1]) + 2
        white = self._fill(_PATH, "wrench_path", 0, (1, knots))[0]
        white[:, 1:] *= np.sqrt(1.0 - forget**2)
        coloured = lfilter([1.0], [1.0, -forget], white, axis=-1)
        before = at.knot.astype(int)
        share = at.knot - before
        return np.asarray(coloured[:, before] * (1.0 - share) + coloured[:, before + 1] * share)

    def encoder(self, side: int) -> Array:
        """Draw the errors of motor-side (0) or link-side (1) encoders. Shape (nq, b, n). [rad]"""
        return np.radians(ENCODERS[side]) * self.white(_ENCODERS, "encoders", side, len(self.at.q))
