"""Candidates for instruments that see no positions: sockets, dial gauges, probes, planes, spheres, a ball bar.

A shop puts them up where the campaign says, by hand: places are unknown within centimetres, and every place is met
more than once. What each kind tells stands in `compplan.measure.sights`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.errors import InputError
from compplan.loop.candidates import FLOOR, Candidates, run_up
from compplan.measure.sights import CONTACT, DISTANCE, READING, KnownDistances, Sights, along
from compplan.posture.clearance import measure_margin
from compplan.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames

TRACKER, SOCKETS, GAUGE, PROBE, PLANE, SPHERE, BALL_BAR = INSTRUMENTS = (
    "tracker", "sockets", "gauge", "probe", "plane", "sphere", "ball_bar",
)  # fmt: skip
#: Kind of a row, and places that are put up where nobody says how many.
KINDS = {SOCKETS: CONTACT, GAUGE: READING, PLANE: READING, SPHERE: DISTANCE, BALL_BAR: DISTANCE}
PLACES = {SOCKETS: 3, GAUGE: 6, PROBE: 0, PLANE: 3, SPHERE: 3, BALL_BAR: 3}
#: Length of a ball bar, radii of a sphere and the ball that touches it together, and distance of the sockets of a plate
#: from each other, where nobody says. [m] (assumed)
LENGTHS = {BALL_BAR: 0.3, SPHERE: 0.03}
#: Half of the side of a plane that the probe may touch [m] (assumed), and how surely a plate's distance is known. [m]
SIDE, SURE = 0.15, 2e-5
#: Steps to bring the tip to a place, how near it has to come [m], and the greatest turn of a joint in one. [rad]
STEPS, NEAR, TURN = 15, 1e-9, 0.2


def find_touching(
    robot: Robot, postures: Array, middle: Array, lowest: float, instrument: str, places: int, length: float,
    scene: CollisionScene | None, seed: int,
) -> tuple[Array, Sights]:  # fmt: skip
    """Find postures in which the tip is where an instrument sees it. Shape (k, nq) [rad or m], and what it sees.

    Args:
        robot: The robot with its tool.
        postures: Postures that the arm can take. Shape (m, nq). [rad or m]
        middle: Middle of the path. Shape (3,). [m]
        lowest: Lowest place of the path over the base plane. [m]
        instrument: One of `INSTRUMENTS`, no tracker.
        places: How many places.
        length: Length of the ball bar, radii of the sphere and the ball of the tool together, or distance of two
            sockets of a plate, 0 for single ones. [m]
        scene: What may touch what, or None.
        seed: Seed.

    Raises:
        InputError: If the arm meets some place fewer than three times.
    """
    random, chain = np.random.default_rng(seed), build_chain(robot)
    tip = locate_frames(chain, postures).tcp_position
    q, label, names, normals = [], [], list[str](), np.eye(3)[[2, 0, 1]]
    if instrument == PROBE:
        return _probe_anywhere(postures, tip, normals)
    for number, centre in enumerate(_spread(tip, middle, places)):
        nearest = postures[np.argsort(np.linalg.norm(tip - centre, axis=1))[: max(len(postures) // 3, 12)]]
        start = locate_frames(chain, nearest).tcp_position
        wanted = np.tile(centre, (len(nearest), 1))
        if instrument in LENGTHS:
            away = start - centre
            away[:, 2] = np.abs(away[:, 2]) + 1e-3  # the stand is below
            wanted = centre + length * away / np.linalg.norm(away, axis=1)[:, None]
        elif instrument == PLANE:
            beside = random.uniform(-SIDE, SIDE, wanted.shape)
            wanted = wanted + beside - np.outer(beside @ normals[number % 3], normals[number % 3])
        sides = [0.5 * length * normals[(number + 1) % 3] * side for side in (-1, 1)]
        for shift in sides if instrument == SOCKETS and length > 0.0 else (np.zeros(3),):
            found = bring_tips(robot, nearest, wanted + shift)
            high = locate_frames(chain, found).tcp_position[:, 2] >= min(FLOOR, lowest)
            found = found[high] if scene is None else found[high & (measure_margin(scene, found, 0.0) >= 0.0)]
            if len(found) < 3:
                raise InputError(
                    f"the arm meets place {number + 1} near {(1e3 * centre).round().tolist()} mm in {len(found)}"
                    " postures, expected at least 3; ask for fewer --places, or check limits and collisions"
                )
            side = f"/{len(names) % 2}" if instrument == SOCKETS and length > 0.0 else ""
            names.append(f"{number + 1}{side}")
            q.append(found)
            label.append(np.full(len(found), len(names) - 1))
    contact, n = np.concatenate(label), sum(map(len, q))
    of = np.array([int(name.split("/")[0]) - 1 for name in names])[contact]
    direction = normals[of % 3] if KINDS[instrument] == READING else np.full((n, 3), np.nan)
    known = KnownDistances()
    if instrument == SOCKETS and length > 0.0:
        pairs = np.arange(2 * places).reshape(-1, 2)
        known = KnownDistances(pairs, np.full(places, length), np.full(places, SURE))
    kind, value = np.full(n, KINDS[instrument]), np.full(n, length if instrument in LENGTHS else 0.0)
    return np.concatenate(q), Sights(kind, contact, tuple(names), np.zeros((n, 3)), direction, value, known)


def _probe_anywhere(postures: Array, tip: Array, normals: Array) -> tuple[Array, Sights]:
    """Return postures, once for each normal, and what a probe sees: it reads zero at a place that is known."""
    m = 3 * len(postures)
    direction = np.tile(normals, (len(postures), 1))
    read = Sights(np.full(m, READING), np.full(m, -1), (), np.repeat(tip, 3, axis=0), direction, np.zeros(m))
    return np.repeat(postures, 3, axis=0), read


def bring_tips(robot: Robot, q: Array, wanted: Array) -> Array:
    """Bring the tip to places with least joint motion; only postures within the limits come back. Shape (k, nq)."""
    chain, q = build_chain(robot), q.copy()
    for _ in range(STEPS):
        frames = locate_frames(chain, q)
        away = wanted - frames.tcp_position
        step = np.einsum("nij,nj->ni", np.linalg.pinv(joint_jacobian(chain, frames)[:, :3], rcond=1e-3), away)
        q = q + np.clip(step, -TURN, TURN)
    good = np.linalg.norm(wanted - locate_frames(chain, q).tcp_position, axis=1) < NEAR
    edge = run_up(robot)
    return np.asarray(q[good & ((q > robot.lower + edge) & (q < robot.upper - edge)).all(axis=1)])


def _spread(tip: Array, middle: Array, count: int) -> Array:
    """Choose places among tips: the one nearest to the path, then each as far from the others as the near half lets."""
    away = np.linalg.norm(tip - middle, axis=1)
    near = tip[away <= np.median(away)]
    chosen = [near[np.linalg.norm(near - middle, axis=1).argmin()]]
    while len(chosen) < count:
        apart = np.linalg.norm(near[:, None] - np.array(chosen), axis=2).min(axis=1)
        chosen.append(near[apart.argmax()])
    return np.array(chosen)


def sight_candidates(candidates: Candidates, sights: Sights) -> Candidates:
    """Give candidates what is seen of them: as many times as they stand under different loads, from different sides."""
    times = len(candidates) // len(sights.kind)
    return replace(candidates, sights=sights.take(np.tile(np.arange(len(sights.kind)), times)))


def see_rows(rows: Array, sights: Sights, point: Array) -> Array:
    """Return what sights see of parameters, frames and places, from what positions would. Shape (m, 3, P + 3 c).

    Args:
        rows: Derivatives of the measured point. Shape (m, 3, P).
        sights: The sights, c contacts.
        point: The measured point, base frame. Shape (m, 3). [m]
    """
    places = -sights.place_slopes().reshape(len(rows), 3, -1)
    return along(sights.directions(point, sights.start_places(point)), np.concatenate([rows, places], axis=2))


def see_distances(known: KnownDistances, places: Array, size: int) -> tuple[Array, Array]:
    """Return what known distances say of a state of `size` numbers that ends with the places, and their variances."""
    slopes = known.slopes(places).reshape(len(known), 3 * len(places))
    rows = np.hstack([np.zeros((len(known), size - 3 * len(places))), slopes])
    return rows[:, None, :], known.sigma**2
