"""Check that stated intervals hold: inject compliances, simulate a noisy campaign, identify, and look inside.

The campaign is simulated in exact equilibrium with tracker noise of 15 um + 6 um/m (see `simulate_observations`). What
the poses cannot tell is held at its nominal value, in the truth too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from compplan.errors import InputError, UnknownNameError
from compplan.identification.estimate import Estimate, estimate_parameters
from compplan.identification.forward import attain_fit
from compplan.identification.parameters import FreeRobot, build_structure
from compplan.measurement.campaign import Campaign, make_log
from compplan.measurement.fit.rows import KNOWN_FRAMES, Rows
from compplan.measurement.pose_selection import take_clear
from compplan.robot import Array, Body, Robot, Spring
from compplan.robot.springs import link_springs, missing_springs
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium

#: Models of a round trip: what is soft, how it is loaded, and what is unknown besides.
MODELS = ("joints", "extra springs", "base plate", "gravity", "double encoders", "frames", "differences")
#: Assumed where a robot has none: a mass on every moving link, and the 6x6 of a slender link.
ASSUMED_MASS = 60.0
GRAVITY = np.array([0.0, 0.0, -9.81])
#: Batches of poses that are drawn at most; poses whose TCP is lower above the base frame are left out. [m]
TRIES, LEAST_HEIGHT = 20, 0.1


def draw_candidates(
    robot: Robot,
    count: int,
    *,
    force: float = 1000.0,
    lever: float = 0.3,
    vertical: bool = False,
    seed: int = 0,
) -> Campaign:
    """Draw rows to choose from: poses inside the joint limits, each under a force in a random direction.

    The force acts on a lever beside the tool axis; nothing is measured yet.

    Args:
        robot: The robot.
        count: Number of candidates.
        force: Size of the force. [N]
        lever: Distance of its point of attack from the TCP, across the tool axis, on a random side. [m]
        vertical: Forces point down (weights) instead of anywhere.
        seed: Seed of the draw.

    Raises:
        InputError: If hardly any pose inside the limits is above the least height.
    """
    rng, chain = np.random.default_rng(seed), build_chain(robot)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    lower = np.where(robot.prismatic, np.maximum(robot.lower, -1e3), lower)
    upper = np.where(robot.prismatic, np.minimum(robot.upper, 1e3), upper)

    def high(q: Array) -> NDArray[np.bool_]:
        return np.asarray(locate_frames(chain, q).tcp_position[:, 2] >= LEAST_HEIGHT)

    q = take_clear((rng.uniform(lower, upper, (2 * count, robot.nq)) for _ in range(TRIES)), high, count)
    if len(q) < count:
        raise InputError(f"fewer than 1 pose in 40 lies {LEAST_HEIGHT} m above the base; check the joint limits")
    direction = rng.standard_normal((count, 3))
    if vertical:
        direction[:] = [0.0, 0.0, -1.0]
    pull = force * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    side = rng.uniform(0, 2 * np.pi, count)
    arm = lever * np.column_stack([np.cos(side), np.sin(side), np.zeros(count)])
    arm = np.einsum("nij,nj->ni", locate_frames(chain, q).tcp_rotation, arm)
    return make_log(q, np.hstack([pull, np.cross(arm, pull)]), np.zeros((count, 3)))


def simulate_observations(
    robot: Robot,
    q: Array,
    wrench: Array,
    *,
    seed: int | None = None,
    tracker: Array | None = None,
    orientation: bool = True,
    sigma_rotation: float = 5e-5,
    link_side: ArrayLike = False,
) -> Campaign:
    """Simulate a campaign: exact equilibrium, seen by a laser tracker.

    Noise of position is 15 um + 6 um/m of the distance from the tracker, per axis; without a seed there is none.

    Args:
        robot: The true robot.
        q: Commanded joint positions. Shape (n, nq). [rad, m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        seed: Seed of the noise.
        tracker: Place of the tracker, base frame; (4, 0, 1) if left out. Shape (3,). [m]
        orientation: Whether orientation is measured too.
        sigma_rotation: Standard deviation of orientation per axis, assumed. [rad]
        link_side: Rows whose q are link-side readings. Scalar or shape (n,).
    """
    q = np.atleast_2d(np.asarray(q, float))
    mask = np.broadcast_to(np.asarray(link_side, bool), (len(q),))
    chain = build_chain(robot)
    soft = solve_equilibrium(chain, q, wrench, tolerance=1e-12)
    position, rotation = soft.position.copy(), soft.rotation.copy()
    if mask.any():
        matrix = chain.compliance.copy()
        matrix[chain.actuator] = 0.0
        matrix[:, chain.actuator] = 0.0
        stiff = solve_equilibrium(replace(chain, compliance=matrix), q, wrench, tolerance=1e-12)
        position[mask], rotation[mask] = stiff.position[mask], stiff.rotation[mask]
    station = np.array([4.0, 0.0, 1.0]) if tracker is None else np.asarray(tracker, float)
    sigma = 15e-6 + 6e-6 * np.linalg.norm(position - station, axis=1)
    if seed is not None:
        rng = np.random.default_rng(seed)
        position = position + sigma[:, None] * rng.standard_normal(position.shape)
        rotation = Rotation.from_rotvec(sigma_rotation * rng.standard_normal(position.shape)).as_matrix() @ rotation
    return make_log(
        q,
        wrench,
        position,
        rotation if orientation else None,
        sigma=sigma,
        sigma_rotation=sigma_rotation,
        link_side=mask,
    )


@dataclass(frozen=True)
class RoundTrip:
    """One repeat."""

    estimate: Estimate  #: The fit.
    truth: Array  #: True values of its parameters, frames left out. Shape (p,).
    inside: NDArray[np.bool_]  #: Whether the stated 95 % interval holds, of the parameters that were free. Shape (k,).


@dataclass(frozen=True)
class Coverage:
    """Share of the stated intervals that hold."""

    inside: int  #: Intervals that held.
    count: int  #: Intervals in all.
    p_value: float  #: Of a two-sided binomial test against the stated level.

    @property
    def share(self) -> float:
        """Share that held."""
        return self.inside / self.count


def run_round_trip(robot: Robot, model: str, seed: int, *, poses: int = 30, loss: str = "least_squares") -> RoundTrip:
    """Inject, simulate and identify once.

    Args:
        robot: The robot.
        model: One of `MODELS`.
        seed: Seed of poses, loads, truth and noise.
        poses: Number of poses; two loads each for differences, four modes each for double encoders.
        loss: "least_squares", "huber" or "tukey".

    Raises:
        UnknownNameError: If there is no such model.
    """
    if model not in MODELS:
        raise UnknownNameError("model", model, list(MODELS))
    rng = np.random.default_rng(seed)
    structure = _build(robot, model)
    q, wrench, link_side = _load(structure.robot, model, poses, rng)
    frames = replace(KNOWN_FRAMES, parts=("base", "tool")) if model == "frames" else KNOWN_FRAMES
    reference = "difference" if model == "differences" else "absolute"
    blank = simulate_observations(structure.robot, q, wrench, link_side=link_side)
    first = estimate_parameters(structure, blank, registration=frames, reference=reference, sigma="stated")
    told = first.free[: len(structure.parameters)]
    truth = np.where(told, structure.nominal * rng.uniform(0.5, 1.8, len(told)), structure.nominal)
    rows = _simulate(structure, truth, blank, model, rng)
    estimate = estimate_parameters(structure, rows, registration=frames, loss=loss, reference=reference)
    low, high = estimate.intervals().T
    free = np.flatnonzero(estimate.free[: len(truth)])
    inside = (low[free] <= truth[free]) & (truth[free] <= high[free])
    return RoundTrip(estimate, truth, inside)


def measure_coverage(trips: Sequence[RoundTrip], level: float = 0.95) -> Coverage:
    """Count the intervals that hold, pooled over repeats and parameters."""
    held = np.concatenate([trip.inside for trip in trips])
    test = binomtest(int(held.sum()), len(held), level)
    return Coverage(int(held.sum()), len(held), float(test.pvalue))


def _build(robot: Robot, model: str) -> FreeRobot:
    """Give a robot the springs and masses of a model, with values that are not zero."""
    rigid = [replace(spring, compliance=spring.compliance or 1e-6) for spring in missing_springs(robot)]
    soft = replace(robot, springs=(*robot.springs, *rigid), effects=())
    first, moving = soft.joints[0], soft.actuated
    if model == "extra springs":
        extra = [Spring(moving[k].name, axis, 4e-7) for k, axis in ((1, "rx"), (2, "rx"), (3, "ry"))]
        taken = {(spring.joint, spring.axis) for spring in soft.springs}
        soft = replace(soft, springs=(*soft.springs, *(s for s in extra if (s.joint, s.axis) not in taken)))
    if model == "base plate":
        plate = [Spring(first.name, axis, 1e-7) for axis in ("rx", "ry", "rz")]
        taken = {(spring.joint, spring.axis) for spring in soft.springs}
        soft = replace(soft, springs=(*(s for s in plate if (s.joint, s.axis) not in taken), *soft.springs))
    if model == "gravity":
        bodies = soft.bodies or tuple(Body(joint.child, ASSUMED_MASS, np.array([0.1, 0.05, 0.2])) for joint in moving)
        soft = replace(soft, gravity=GRAVITY, bodies=bodies)
    if model == "double encoders":
        beyond = [replace(spring, compliance=2e-7) for spring in link_springs(soft)]
        soft = replace(soft, springs=(*soft.springs, *beyond))
    return build_structure(soft)


def _load(robot: Robot, model: str, poses: int, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.bool_]]:
    seed = int(rng.integers(2**31))
    count = max(poses, 60) if model == "frames" else poses
    force = 100.0 if robot.name in ("ur10", "fanuc_m10ia") else 1000.0
    drawn = draw_candidates(robot, count, force=force, seed=seed)
    q, wrench, nothing = drawn.q, drawn.wrench, np.zeros_like(drawn.wrench)
    if model in ("frames", "differences"):
        return np.vstack([q, q]), np.vstack([wrench, nothing]), np.zeros(2 * len(q), bool)
    if model == "double encoders":
        modes = np.repeat([False, False, True, True], len(q))
        return np.vstack([q] * 4), np.vstack([nothing, wrench, wrench, nothing]), modes
    return q, wrench, np.zeros(len(q), bool)


def _simulate(structure: FreeRobot, truth: Array, blank: Campaign, model: str, rng: np.random.Generator) -> Campaign:
    """Measure the true robot in exact equilibrium, with noise, and with small unknown frames where these are fitted."""
    frames = KNOWN_FRAMES
    if model == "frames":
        base, tool = np.eye(4), np.eye(4)
        for pose in (base, tool):
            pose[:3, :3] = Rotation.from_rotvec(rng.normal(0, 2e-3, 3)).as_matrix()
            pose[:3, 3] = rng.normal(0, 2e-3, 3)
        frames = replace(KNOWN_FRAMES, base=base, tool=tool[None])
    seen = attain_fit(structure, truth, Rows(blank, np.arange(len(blank)), frames), frames)
    assert blank.sigma is not None and blank.sigma_rotation is not None
    turn = Rotation.from_rotvec(blank.sigma_rotation[:, None] * rng.standard_normal(seen.position.shape)).as_matrix()
    noisy = seen.position + blank.sigma[:, None] * rng.standard_normal(seen.position.shape)
    return replace(blank, position=noisy, rotation=turn @ seen.rotation)
