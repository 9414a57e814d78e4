"""What a sample's point means in the cell: compliances, zeros, gear errors, geometry, wrench, and the noise of sensors.

Arrays are components first, then b samples, then n waypoints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from compplan.effects import (
    build_model,
    command_campaign,
    fold_effects,
    is_of_instrument,
    robot_effects,
    solve_model_poses,
)
from compplan.effects.attained import attain_with_effects
from compplan.effects.linearization import AXES, linearize_model
from compplan.job.noise import EffectNoise, NoiseTable
from compplan.plan.task import PlanTask
from compplan.robot import Array
from compplan.studies.factors import PARTS, Factors, link_blocks, to_normal
from compplan.studies.posterior import RobotPosterior, move_by_posterior, take_posterior
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.motion import read_placement
from compplan.uncertainty.sensitivities import ForceSpread

#: Assumed where neither job nor robot folder states one, an axis. [m]
REPEATABILITY = 2e-5
#: Assumed distance of the tracker. [m]
TRACKER_DISTANCE = 3.0
#: Knots of the noise along the path per correlation length, and their greatest number.
KNOTS, MOST_KNOTS = 10, 20000
_PATH, _ENCODERS, _FORCE, _TRACKER = range(4)


@dataclass(frozen=True)
class Surroundings:
    """What all samples share; n waypoints.

    Attributes:
        noise: The standard deviations.
        factors: The coordinates of a sample's point.
        wrench: Predicted wrench. Shape (6, n). [N, N m]
        q: Commanded joints, for what depends on angle and direction of travel. Shape (nq, n). [rad or m]
        travel: Direction of travel of each joint, -1, 0 or 1. Shape (nq, n).
        gears: Elastic coordinates between the encoders. Shape (g,).
        links: Elastic coordinates beside them, by block.
        n_springs: Number of elastic coordinates.
        zero: Standard deviation of each joint's zero; the place of a rail is the part's. Shape (nq,). [rad]
        shift: Motion of the tip per placement error, growth, tool and part frame. Shape (k, 3, n). [m per m, rad, 1]
        scale: Standard deviation of each of them. Shape (k,). [m, rad, 1]
        knot: Position of each waypoint among the knots of the noise along the path. Shape (n,).
        forget: What is left of the noise from one knot to the next.
        repeatability: Standard deviation, an axis. [m]
        posterior: What is known of the robot, where robots are drawn from that; or None.

    """

    noise: NoiseTable
    factors: Factors
    wrench: Array
    q: Array
    travel: Array
    gears: NDArray[np.int_]
    links: list[list[int]]
    n_springs: int
    zero: Array
    shift: Array
    scale: Array
    knot: Array
    forget: float
    repeatability: float
    posterior: RobotPosterior | None = None


class Cells(NamedTuple):
    """b cells; each has PARTS parts cut in it, the last one is judged.

    Attributes:
        factor: Factor on each compliance. Shape (s, b).
        zero: True minus read position of each joint. Shape (nq, b). [rad or m]
        drive: Link-side minus motor-side position, elastic part left out. Shape (nq, b, n). [rad or m]
        causes: Placement errors, growth, tool and part frame. Shape (k, b). [m, rad, 1]
        shift: Motion of the tip by them, at the posture of the task. Shape (3, b, n). [m]
        wrench: Wrench on the tool, by part. PARTS arrays of shape (6, b, n). [N, N m]
        repeat: Scatter of the tip from part to part. Shape (PARTS, 3, b). [m]
        motor: Error of motor-side encoders, by part. Shape (nq, b, n) each. [rad or m]
        link: Error of link-side encoders, by part. Shape (nq, b, n) each. [rad or m]
        force: Error of the force sensor on the judged part. Shape (6, b, n). [N, N m]
        tracker: Error of the tracker, by measured part. Shape (3, b, n) each. [m]

    """

    factor: Array
    zero: Array
    drive: Array
    causes: Array
    shift: Array
    wrench: list[Array]
    repeat: Array
    motor: list[Array]
    link: list[Array]
    force: Array
    tracker: list[Array]


def survey_surroundings(
    task: PlanTask, noise: NoiseTable, factors: Factors, force: ForceSpread | None = None
) -> Surroundings:
    """Work out what all samples of a task share; `force`: what measured parts said of it."""
    chain, q = task.chain, task.q_start
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(task.position, axis=0), axis=1))])
    knots = min(int(np.ceil(length[-1] / (noise.correlation_mm * 1e-3) * KNOTS)) + 2, MOST_KNOTS)
    spacing = max(length[-1], 1e-9) / (knots - 1)
    shift, scale = differentiate_placements(task, noise)
    stated = task.robot.repeatability if noise.repeatability_mm is None else noise.repeatability_mm * 1e-3
    return Surroundings(
        noise=noise,
        factors=factors,
        wrench=np.ascontiguousarray(task.wrench.T),
        q=np.ascontiguousarray(q.T),
        travel=find_travel(q).T,
        gears=np.flatnonzero(chain.actuator),
        links=link_blocks(task.robot),
        n_springs=chain.n_springs,
        zero=np.where(task.robot.prismatic, 0.0, np.radians(noise.joint_zero_deg)),
        shift=shift,
        scale=scale,
        knot=np.minimum(length / spacing, knots - 1.000001),
        forget=float(np.exp(-spacing / (noise.correlation_mm * 1e-3))),
        repeatability=REPEATABILITY if stated is None else stated,
        posterior=take_posterior(task, find_travel(q).T, force) if noise.robot == "posterior" else None,
    )


def find_travel(q: Array) -> Array:
    """Find the direction in which each joint moved last, 0 before it first moves. Shape (n, nq)."""
    step = np.diff(q, axis=0)
    sign = np.vstack([np.zeros(q.shape[1]), np.sign(np.where(np.abs(step) > 1e-9, step, 0.0))])
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(q))[:, None], 0), axis=0)
    return np.asarray(np.take_along_axis(sign, last, axis=0))


def differentiate_placements(task: PlanTask, noise: NoiseTable) -> tuple[Array, Array]:
    """Differentiate the tip with respect to placements, growth, tool and part frame: (k, 3, n), and their sigmas (k,).

    First order: placement errors of 0.1 mm and 0.1 mrad leave out less than a micrometre. The unloaded robot is looked
    at; the load changes it by its own relative deflection.
    """
    bare = replace(task.robot, springs=(), link_elasticities=(), effects=())
    scene = build_model(bare, command_campaign(task.q_start))
    at = linearize_model(scene, solve_model_poses(scene))
    names = [joint.name for joint in bare.actuated]
    translation, rotation = noise.geometry_mm * 1e-3, float(np.radians(noise.geometry_deg))
    placed = [at.parent_twist(name, axis) for name in names for axis in AXES]
    parts = [twist[:, :3] for twist in (*placed, *(at.twist(names[-1], axis) for axis in AXES))]
    scale = (len(names) + 1) * [*3 * [translation], *3 * [rotation]]
    grown = solve_model_poses(replace(scene, growth=scene.growth + 1.0)).position
    parts.append(grown - at.point)
    scale.append(noise.temperature_K * noise.expansion_per_K)
    parts += [at.attained.frames.tcp_rotation[:, :, k] for k in range(3)]
    scale += [noise.tool_frame_mm * 1e-3] * 3
    if task.touched is not None and read_placement(noise) is None:
        parts += list(np.moveaxis(task.touched.spread_part(task.position), 2, 0))
        scale += [1.0] * 6
    else:
        axes, lever = np.eye(3), task.position - task.position.mean(axis=0)
        parts += [np.broadcast_to(axis, lever.shape) for axis in axes] + [np.cross(axis, lever) for axis in axes]
        scale += [noise.part_frame_mm * 1e-3] * 3 + [float(np.radians(noise.part_frame_deg))] * 3
    parts += [move_by_effect(task, entry) for entry in noise.effects]
    scale += [1.0] * len(noise.effects)
    if noise.robot == "posterior":
        drawn = move_by_posterior(task, robot_uncertainty(task.robot))
        parts, scale = parts + drawn, scale + [1.0] * len(drawn)
    return np.ascontiguousarray(np.swapaxes(np.array(parts), 1, 2)), np.array(scale)


def move_by_effect(task: PlanTask, entry: EffectNoise) -> Array:
    """Move the tip by one standard deviation of an effect, by the effects' own forward model. Shape (n, 3). [m]

    Samples scale it: exact where the effect is linear in its parameters. Effects of instruments and sensors move
    nothing.

    Raises:
        UnknownNameError: If there is no such effect, or no such joint.

    """
    table = entry.model_dump(exclude_none=True)
    (effect,) = robot_effects(replace(task.robot, effects=(table,), folder=None))
    if is_of_instrument(effect.name):
        return np.zeros((len(task), 3))
    with_it, without = (
        attain_with_effects(robot, task.q_start, task.wrench, task.step_time)[0]
        for robot in (fold_effects(task.robot, [effect]), task.robot)
    )
    return with_it - without


def sample_robots(at: Surroundings, points: Array) -> Cells:
    """Make cells of points.

    Args:
        at: What all samples share.
        points: Points of the unit cube. Shape (b, size).

    """
    noise, columns = at.noise, at.factors.columns
    normal = to_normal(points)

    def take(name: str) -> Array:
        return np.ascontiguousarray(normal[:, columns[name]].T)

    factor = np.ones((at.n_springs, len(points)))
    factor[at.gears] = log_normal(take("gear_compliance"), noise.joint_compliance)
    for block, z in zip(at.links, take("link_compliance"), strict=True):
        factor[block] = log_normal(z, noise.link_compliance)
    moving = ("geometry", "temperature", "tool_frame", "part_frame", "effects")
    robot = take("posterior") if at.posterior is None else at.posterior.settle(take("posterior"))
    causes = np.vstack([*(take(name) for name in moving), robot])
    causes *= at.scale[:, None]
    bias, noises = take("force_bias"), _Noises(at, points)
    shares = np.vstack([take("wrench_level"), take("wrench_direction")])
    if at.posterior is not None:
        shares = at.posterior.push(robot, shares)
    wrench = [_draw_wrench(at, shares, noises, part) for part in range(PARTS)]
    force = noises.white(_FORCE, "force_noise", 0, 6)
    force *= _six(noise.force_noise_N, noise.moment_noise_Nm)
    force += (bias[:6, :, None] * _six(noise.force_bias_N, noise.moment_bias_Nm)
              + noise.force_gain * bias[6, :, None] * wrench[-1])  # fmt: skip
    zero, drive = at.zero[:, None] * take("joint_zero"), _draw_drive(at, take, points)
    if at.posterior is not None:
        at.posterior.draw(robot, factor, zero, drive)
    return Cells(
        factor=factor,
        zero=zero,
        drive=drive,
        causes=causes,
        shift=shift_tip(causes, at.shift),
        wrench=wrench,
        repeat=at.repeatability * take("repeatability").reshape(PARTS, 3, -1),
        motor=[noises.encoder(part, 0) for part in range(PARTS)],
        link=[noises.encoder(part, 1) for part in range(PARTS)],
        force=force,
        tracker=[noises.tracker(part) for part in range(PARTS - 1)],
    )


def shift_tip(causes: Array, rates: Array) -> Array:
    """Move the tip by placement errors: causes (k, b), motion per cause (k, 3, n); shape (3, b, n). [m]"""
    return np.einsum("kb,kin->ibn", causes, rates, optimize=False)


def log_normal(z: Array, relative: float) -> Array:
    """Return log-normal factors of mean 1 and a relative standard deviation."""
    sigma = np.sqrt(np.log1p(relative**2))
    return np.asarray(np.exp(sigma * z - 0.5 * sigma**2))


def _draw_drive(at: Surroundings, take: Callable[[str], Array], points: Array) -> Array:
    """Draw lost motion and periodic gear error. Shape (nq, b, n)."""
    noise, nq = at.noise, len(at.q)
    width = np.radians(noise.backlash_deg) * np.abs(take("backlash"))
    drive = -0.5 * width[:, :, None] * at.travel[:, None, :]
    if noise.gear_error_deg > 0.0:
        amplitude = np.radians(noise.gear_error_deg) * take("gear_error")[:nq]
        phase = 2 * np.pi * points[:, at.factors.columns["gear_error"]].T[nq:]
        drive += amplitude[:, :, None] * np.sin(noise.gear_periods * at.q[:, None, :] + phase[:, :, None])
    return drive


def _draw_wrench(at: Surroundings, shares: Array, noises: _Noises, part: int) -> Array:
    """Draw the wrench on the tool: level and direction hold for the cell, what varies along the path for a part.

    Args:
        at: What all samples share.
        shares: Level and turns, in their deviations. Shape (4, b).
        noises: What varies along the path.
        part: Number of the part.
    """
    noise = at.noise
    turn = Rotation.from_rotvec(np.radians(noise.wrench_direction_deg) * shares[1:].T).as_matrix()
    level = 1.0 + noise.wrench_level * shares[0]
    turned = np.concatenate([np.einsum("bij,jn->ibn", turn, half) for half in (at.wrench[:3], at.wrench[3:])])
    turned *= level[:, None] + noise.wrench_path * noises.along_path(part)
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

    def along_path(self, part: int) -> Array:
        """Draw noise of variance 1 that is correlated along the path. Shape (b, n)."""
        at = self.at
        forget, knots = at.forget, int(at.knot[-1]) + 2
        white = self._fill(_PATH, "wrench_path", part, (1, knots))[0]
        white[:, 1:] *= np.sqrt(1.0 - forget**2)
        coloured = lfilter([1.0], [1.0, -forget], white, axis=-1)
        before = at.knot.astype(int)
        share = at.knot - before
        return np.asarray(coloured[:, before] * (1.0 - share) + coloured[:, before + 1] * share)

    def encoder(self, part: int, side: int) -> Array:
        """Draw the errors of motor-side (0) or link-side (1) encoders. Shape (nq, b, n). [rad]"""
        noise = self.at.noise
        level = (noise.motor_encoder_deg, noise.link_encoder_deg)[side]
        return np.radians(level) * self.white(_ENCODERS, "encoders", 2 * part + side, len(self.at.q))

    def tracker(self, part: int) -> Array:
        """Draw the errors of the tracker. Shape (3, b, n). [m]"""
        noise = self.at.noise
        level = (noise.tracker_mm + noise.tracker_mm_per_m * TRACKER_DISTANCE) * 1e-3
        return level * self.white(_TRACKER, "tracker", part, 3)
