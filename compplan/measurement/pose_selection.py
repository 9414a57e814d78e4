"""Candidate poses of a campaign, and optimal selection: greedy, then exchange of single candidates [Fedorov1972].

Half of the postures are drawn around a path, half anywhere within the joint limits; each is approached from below or
above, without a load or with one.

The criterion of a selection is a function that returns the gain of each candidate in addition to those selected: the
variance of the tip along a path for a model update, the odds of two explanations for a diagnosis. Measurements with
derivatives H and noise R reduce a covariance S by S H^T (H S H^T + R)^-1 H S.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

#: Standard deviation of joint positions around the path [rad or m], and margin to the limits of revolute joints [rad].
AROUND, MARGIN = 0.35, np.radians(5.0)
#: Greatest angle of a revolute joint from zero, even if its limits are wider: cables. [rad]
TURN = np.radians(170.0)
#: Distance of the approach to a pose in every joint, longer than any backlash. [rad], [m]
RUN_UP = (np.radians(1.5), 0.01)
#: Least height of the tip over the base plane, unless the path is lower. [m]
FLOOR = 0.05
#: Gain of every candidate in addition to the selected ones. Shape (m,).
Gains = Callable[[list[int]], Array]
#: Least relative improvement of an exchange, against cycles by rounding.
BETTER = 1e-9
#: Greatest number of exchange rounds (assumed: most selections converge in two).
ROUNDS = 3


def run_up(robot: Robot) -> Array:
    """Return the joint distance of the approach to a pose, 0 for a held joint. Shape (nq,). [rad or m]."""
    return np.where(robot.upper <= robot.lower, 0.0, np.where(robot.prismatic, RUN_UP[1], RUN_UP[0]))


def draw_postures(robot: Robot, path_q: Array, lowest: float, seed: int, drawn: int) -> Array:
    """Draw postures; return those within the joint limits and above the base plane. Shape (<= drawn, nq). [rad or m]

    path_q: joint positions along the path, (n, nq); lowest: least height of the path over the base plane. [m]
    """
    random = np.random.default_rng(seed)
    span = np.where(robot.prismatic, np.inf, TURN)
    low, high = np.maximum(robot.lower, -span), np.minimum(robot.upper, span)
    free = high > low
    edge = np.where(robot.prismatic, 0.02 * (high - low), free * MARGIN) + run_up(robot)
    low, high = low + edge, high - edge
    near = path_q[random.integers(0, len(path_q), drawn // 2)]
    near = near + free * AROUND * random.standard_normal(near.shape)
    far = low + (high - low) * random.random((drawn - len(near), robot.nq))
    found = np.stack([near, far], axis=1).reshape(-1, robot.nq)
    found = found[((found >= low) & (found <= high)).all(axis=1)]
    tip = locate_frames(build_chain(robot), found).tcp_position
    return np.asarray(found[tip[:, 2] >= min(FLOOR, lowest)])


def pull_aside(pull: float) -> list[tuple[float, float, float]]:
    """Return the pulls along +-x and +-y of the base; none for 0. [N]"""
    return [(x * pull, y * pull, 0.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)) if pull > 0]


def approach_poses(robot: Robot, q: Array, sign: Array, force: Array) -> Campaign:
    """Return a campaign without measured values: two rows a pose, the start of its approach and the pose.

    q: (m, nq) [rad or m]; sign: direction of the approach, 1 or -1, (m,); force on the tool, base axes, (m, 3). [N]
    """
    wrench = np.zeros((2 * len(q), 6))
    wrench[:, :3] = np.repeat(force, 2, axis=0)
    way = np.stack([q - sign[:, None] * run_up(robot), q], axis=1).reshape(-1, robot.nq)
    return Campaign(np.array(["static_1"] * len(way)), way, wrench, np.full((len(way), 3), np.nan))


def grow_choice(worth: Gains, count: int) -> Iterator[tuple[int, float]]:
    """Select `count` candidates greedily; yield each candidate and its gain."""
    taken: list[int] = []
    for _ in range(count):
        gain = worth(taken)
        gain[taken] = -np.inf
        taken.append(int(gain.argmax()))
        yield taken[-1], float(gain[taken[-1]])


def take_greedily(worth: Gains, count: int) -> list[int]:
    """Select `count` candidates greedily."""
    return [number for number, _ in grow_choice(worth, count)]


def offer_once(worth: Gains, group: NDArray[np.int_]) -> Gains:
    """Restrict gains to one candidate per group, -inf for the others; group: of each candidate. Shape (m,)."""
    return lambda taken: np.where(np.isin(group, group[taken]), -np.inf, worth(taken))


def exchange_choice(worth: Gains, taken: Sequence[int]) -> list[tuple[int, float]]:
    """Improve a selection by exchanges, and order it greedily; return each candidate and its gain."""
    chosen = exchange_taken(worth, taken)
    grown = grow_choice(lambda order: worth([chosen[k] for k in order])[chosen], len(chosen))
    return [(chosen[k], gain) for k, gain in grown]


def exchange_taken(worth: Gains, taken: Sequence[int]) -> list[int]:
    """Replace selected candidates by better ones, one by one, until none is better or the rounds are over."""
    taken = list(taken)
    for _ in range(ROUNDS):
        changed = False
        for place, leaving in enumerate(taken):
            others = taken[:place] + taken[place + 1 :]
            gain = worth(others)
            gain[others] = -np.inf
            best = int(gain.argmax())
            if best != leaving and gain[best] > gain[leaving] + BETTER * abs(gain[leaving]):
                taken[place], changed = best, True
        if not changed:
            break
    return taken


def narrow_target(target: Array, covariance: Array, rows: Array, noise: float) -> Gains:
    """Return the reduction of the variance of a target by every measurement, as a function of those selected.

    target: derivatives by the state, (t, P); covariance: prior, (P, P); rows: derivatives of each measurement,
    (m, c, P); noise: variance of each component.
    """
    weight = target.T @ target
    return lambda taken: measure_gains(learn_rows(covariance, rows[taken], noise), rows, weight, noise)


def learn_rows(covariance: Array, rows: Array, noise: float) -> Array:
    """Return the covariance, (P, P), after measurements with derivatives (m, c, P) and a variance of each component."""
    return explain_rows(np.zeros(len(covariance)), covariance, rows, noise)[1]


def explain_rows(mean: Array, covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Update mean m and covariance of a difference by measurements of zero: the part H m that they observe is removed.

    mean: (P,); covariance: (P, P); rows: derivatives of each measurement, (m, c, P); noise: variance of a component.
    """
    for H in rows:
        along = covariance @ H.T
        gain = np.linalg.solve(H @ along + noise * np.eye(len(H)), along.T)
        mean, covariance = mean - gain.T @ (H @ mean), covariance - along @ gain
        covariance = 0.5 * (covariance + covariance.T)
    return mean, covariance


def _innovate(covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return H S and the innovation covariance H S H^T + R of each measurement. Shapes (m, c, P), (m, c, c)."""
    m, c, p = rows.shape
    along = (rows.reshape(m * c, p) @ covariance).reshape(m, c, p)
    return along, np.einsum("mip,mjp->mij", along, rows) + noise * np.eye(c)


def measure_gains(covariance: Array, rows: Array, weight: Array, noise: float) -> Array:
    """Return the reduction of the trace of S W, both (P, P), by each measurement, rows (m, c, P). Shape (m,)."""
    along, inner = _innovate(covariance, rows, noise)
    outer = np.einsum("mip,mjp->mij", (along.reshape(-1, len(weight)) @ weight).reshape(along.shape), along)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=1, axis2=2))


def odds_gains(mean: Array, covariance: Array, rows: Array, noise: float = 1.0) -> Array:
    """Return d^T (H S H^T + R)^-1 d / 2, d = H m: the expected log likelihood ratio of each measurement. Shape (m,).

    mean m: difference of two explanations, (P,); covariance S: mean of theirs, (P, P); rows H: (m, c, P).
    """
    d, inner = rows @ mean, _innovate(covariance, rows, noise)[1]
    return np.asarray(0.5 * np.einsum("mc,mc->m", d, np.linalg.solve(inner, d[..., None])[..., 0]))


def take_clear(batches: Iterable[Array], clear: Callable[[Array], NDArray[np.bool_]], count: int) -> Array:
    """Collect the clear postures of batches, (k, nq) each, up to `count`. Shape (<= count, nq). [rad or m]"""
    found: list[Array] = []
    for batch in batches:
        found.append(batch[clear(batch)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
