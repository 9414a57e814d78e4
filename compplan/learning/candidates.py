"""Candidates for measurements: postures that an arm can take and hold, loads that a shop has, both ways to approach.

Half of the postures lie around the path, half anywhere within the joint limits; those that touch something, or put the
tool below the base, are left out.

Sockets and dial gauges stand where the campaign says, within centimetres: their places are unknown, and every place is
met more than once. What each kind tells stands in `compplan.measurement.observations`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.effects import solve_model_poses
from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.equipment import GAUGE, SOCKETS
from compplan.measurement.observations import CONTACT, READING, KnownDistances, Observations, along
from compplan.measurement.pose_selection import take_clear
from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot
from compplan.robot.model import STANDARD_GRAVITY
from compplan.robot.uncertainty import Unknown
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames
from compplan.uncertainty.sensitivities import build_varied_model, measure_slopes, select_model_rows

#: Postures that are kept, and drawn for it at most.
KEPT, DRAWN = 300, 3000
#: Spread around the path, and distance from the joint limits that is kept [rad, share of the range of slides].
AROUND, MARGIN = 0.35, np.radians(5.0)
#: Revolute joints are taken within this of zero, whatever their limits: cables. [rad]
TURN = np.radians(170.0)
#: A pose is approached over this distance of every joint: [rad], [m]. Longer than any play.
RUN_UP = (np.radians(1.5), 0.01)
#: Lowest place of the tip over the base plane, where the path is not lower itself. [m]
FLOOR = 0.05
#: Kind of a row, and places that are put up where nobody says how many.
KINDS = {SOCKETS: CONTACT, GAUGE: READING}
PLACES = {SOCKETS: 3, GAUGE: 6}
#: Standard deviation of the distance of two sockets of a plate. [m] (assumed)
SURE = 2e-5
#: Steps to bring the tip to a place, how near it has to come [m], and the greatest turn of a joint in one. [rad]
STEPS, MET, STEP = 15, 1e-9, 0.2
#: How an instrument is put up, {at} in the robot's base frame.
SETUP = {
    SOCKETS: "socket {label} at ({at}) mm, fixed so that it does not move while its poses are measured",
    GAUGE: "dial gauge {label} at ({at}) mm, its axis along ({along}) within a few mrad: it reads more where the tip is"
           " farther that way; zero it anywhere and leave it",
}  # fmt: skip
#: Directions of dials and plates, place by place.
NORMALS = np.eye(3)[[2, 0, 1]]


@dataclass(frozen=True, eq=False)
class Candidates:
    """Measurements that could be taken; m of them, p parameters."""

    log: Campaign  #: Two rows a measurement, nothing measured yet: where its approach begins, and the pose.
    tip: Array  #: Where the tip goes. Shape (m, 3). [m]
    rotation: Array  #: Orientation of the TCP. Shape (m, 3, 3).
    slopes: Array  #: Motion of the tip per unit of every parameter. Shape (m, 3, p).
    sights: Observations | None = None  #: What another instrument than a tracker sees, or None.

    def __len__(self) -> int:
        return len(self.tip)

    @property
    def start(self) -> Array:
        """Where the approach of each begins. Shape (m, nq). [rad or m]"""
        return self.log.q[::2]

    @property
    def q(self) -> Array:
        """Joint positions. Shape (m, nq). [rad or m]"""
        return self.log.q[1::2]

    @property
    def rising(self) -> NDArray[np.bool_]:
        """Whether all joints come from below. Shape (m,)."""
        return np.asarray((self.q > self.start).all(axis=1))

    @property
    def wrench(self) -> Array:
        """Load at the TCP, base axes. Shape (m, 6). [N, N m]"""
        return self.log.wrench[1::2]

    @property
    def weight(self) -> Array:
        """Weight that hangs at the tool; pulls are horizontal. Shape (m,). [kg]"""
        return np.asarray(self.wrench[:, 2] / -STANDARD_GRAVITY)

    def take(self, rows: NDArray[np.int_]) -> Candidates:
        """Take some of them."""
        log = self.log.take(np.stack([2 * rows, 2 * rows + 1], axis=1).ravel())
        sights = None if self.sights is None else self.sights.take(rows)
        return Candidates(log, self.tip[rows], self.rotation[rows], self.slopes[rows], sights)


def run_up(robot: Robot) -> Array:
    """Return how far before a pose its approach begins, joint by joint. Shape (nq,). [rad or m]."""
    return np.where(robot.prismatic, RUN_UP[1], RUN_UP[0])


def find_postures(
    robot: Robot, path_q: Array, lowest: float, scene: CollisionScene | None, seed: int, kept: int = KEPT
) -> Array:
    """Draw at most `kept` postures that the arm can take. Shape (k, nq). [rad or m]

    path_q: joint positions along the path, (n, nq); lowest: its lowest place over the base plane [m]; scene: what may
    touch what, or None.
    """
    random = np.random.default_rng(seed)
    span = np.where(robot.prismatic, np.inf, TURN)
    low, high = np.maximum(robot.lower, -span), np.minimum(robot.upper, span)
    edge = np.where(robot.prismatic, 0.02 * (high - low), MARGIN) + run_up(robot)
    low, high = low + edge, high - edge
    near = path_q[random.integers(0, len(path_q), DRAWN // 2)] + AROUND * random.standard_normal((DRAWN // 2, robot.nq))
    far = low + (high - low) * random.random((DRAWN - len(near), robot.nq))
    drawn = np.stack([near, far], axis=1).reshape(-1, robot.nq)
    drawn = drawn[((drawn >= low) & (drawn <= high)).all(axis=1)]
    tip = locate_frames(build_chain(robot), drawn).tcp_position
    drawn = drawn[tip[:, 2] >= min(FLOOR, lowest)]
    if scene is None or not len(drawn):
        return np.asarray(drawn[:kept])
    batches = (drawn[start : start + kept] for start in range(0, len(drawn), kept))
    return take_clear(batches, lambda part: measure_margin(scene, part, 0.0) >= 0.0, kept)


def list_candidates(
    robot: Robot, postures: Array, weights: Sequence[float], pull: float, unknowns: tuple[Unknown, ...]
) -> Candidates:
    """Combine postures, (k, nq), with ways to approach, weights [kg] and pulls; differentiate what is measured.

    pull: force with which the tool can be pulled along x and y of the base, either way; 0 for none. [N]
    """
    k = len(postures)
    loads = [(0.0, 0.0, 0.0 - STANDARD_GRAVITY * weight) for weight in weights]
    loads += [(x * pull, y * pull, 0.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)) if pull > 0]
    q, sign = np.tile(postures, (2 * len(loads), 1)), np.tile(np.repeat([1, -1], k), len(loads))
    wrench = np.zeros((2 * len(q), 6))
    wrench[:, :3] = np.repeat(loads, 4 * k, axis=0)
    way = np.stack([q - sign[:, None] * run_up(robot), q], axis=1).reshape(-1, robot.nq)
    log = Campaign(np.array(["static_1"] * len(way)), way, wrench, np.full((len(way), 3), np.nan))
    scene, rows = build_varied_model(robot, log), np.arange(1, len(way), 2)
    attained = solve_model_poses(select_model_rows(scene, rows))
    return Candidates(log, attained.position, attained.rotation, measure_slopes(scene, unknowns, rows))


def find_touching(
    robot: Robot, postures: Array, middle: Array, lowest: float, instrument: str, places: int, length: float,
    scene: CollisionScene | None,
) -> tuple[Array, Observations]:  # fmt: skip
    """Find postures in which the tip is where an instrument sees it. Shape (k, nq) [rad or m], and what it sees.

    postures: that the arm can take, (m, nq); middle: of the path, (3,) [m]; lowest: its lowest place over the base
    plane [m]; instrument: "sockets" or "gauge"; places: how many; length: distance of two sockets of a plate, 0 for
    single ones [m]; scene: what may touch what, or None.

    Raises:
        InputError: If the arm meets some place fewer than three times.
    """
    tip = locate_frames(build_chain(robot), postures).tcp_position
    q, label, names = [], [], list[str]()
    plates = instrument == SOCKETS and length > 0.0

    def meet(centre: Array, number: int) -> list[Array]:
        """Return postures in which the arm meets a place, the `number`-th, or each socket of its plate."""
        nearest = np.argsort(np.linalg.norm(tip - centre, axis=1))[: max(len(postures) // 3, 12)]
        half, met = 0.5 * length * NORMALS[(number + 1) % 3], []
        for shift in (-half, half) if plates else (np.zeros(3),):
            found = bring_tips(robot, postures[nearest], np.tile(centre + shift, (len(nearest), 1)))
            high = locate_frames(build_chain(robot), found).tcp_position[:, 2] >= min(FLOOR, lowest)
            met.append(found[high if scene is None else high & (measure_margin(scene, found, 0.0) >= 0.0)])
        return met

    offered, chosen = _near(tip, middle), np.empty((0, 3))
    for number in range(places):
        most = 0
        while True:  # what the arm does not meet, or a wall bars, is no place to put anything up
            if not len(offered):
                raise InputError(
                    f"the arm reaches place {number + 1} in {most} postures, expected at least 3, wherever it lies"
                    " near the path; ask for fewer --places, or check joint limits and collisions"
                )
            at = _choose_place(offered, chosen, middle)
            centre, offered = offered[at], np.delete(offered, at, axis=0)
            met = meet(centre, number)
            most = max(most, fewest := min(map(len, met)))
            if fewest >= 3:
                break
        chosen = np.vstack([chosen, centre])
        for found in met:
            side = f"/{len(names) % 2}" if plates else ""
            names.append(f"{number + 1}{side}")
            q.append(found)
            label.append(np.full(len(found), len(names) - 1))
    contact, n = np.concatenate(label), sum(map(len, q))
    of = np.array([int(name.split("/")[0]) - 1 for name in names])[contact]
    direction = NORMALS[of % 3] if KINDS[instrument] == READING else np.full((n, 3), np.nan)
    known = KnownDistances()
    if plates:
        pairs = np.arange(2 * places).reshape(-1, 2)
        known = KnownDistances(pairs, np.full(places, length), np.full(places, SURE))
    kind = np.full(n, KINDS[instrument])
    sights = Observations(kind, contact, tuple(names), np.zeros((n, 3)), direction, np.zeros(n), known)
    return np.concatenate(q), sights


def bring_tips(robot: Robot, q: Array, wanted: Array) -> Array:
    """Bring the tip to places with least joint motion; only postures within the limits come back. Shape (k, nq)."""
    chain, q = build_chain(robot), q.copy()
    for _ in range(STEPS):
        frames = locate_frames(chain, q)
        away = wanted - frames.tcp_position
        step = np.einsum("nij,nj->ni", np.linalg.pinv(joint_jacobian(chain, frames)[:, :3], rcond=1e-3), away)
        q = q + np.clip(step, -STEP, STEP)
    good = np.linalg.norm(wanted - locate_frames(chain, q).tcp_position, axis=1) < MET
    edge = run_up(robot)
    return np.asarray(q[good & ((q > robot.lower + edge) & (q < robot.upper - edge)).all(axis=1)])


@dataclass(frozen=True, eq=False)
class Fixture:
    """Where an instrument is put up: its label, its place in the robot's base frame (3,) [m], and how, in words."""

    label: str
    place: Array
    says: str


def list_fixtures(instrument: str, sights: Observations | None, tip: Array) -> tuple[Fixture, ...]:
    """Tell where the instrument of a campaign stands, label by label.

    sights: what it sees in every pose, None for a tracker; tip: base frame, (m, 3). [m]
    """
    stands, names = [], () if sights is None else sights.names
    for number, label in enumerate(names):
        assert sights is not None
        rows = np.flatnonzero(sights.contact == number)
        place = tip[rows].mean(axis=0)
        says = SETUP[instrument].format(
            at=", ".join(f"{1e3 * v:.0f}" for v in place + 0.0), label=label,
            along=", ".join(f"{v:g}" for v in sights.direction[rows[0]]),
        )  # fmt: skip
        stands.append(Fixture(label, place, says))
    return tuple(stands)


def _near(tip: Array, middle: Array) -> Array:
    """Return the half of the tips that is nearer to the path. Shape (k, 3) [m]."""
    away = np.linalg.norm(tip - middle, axis=1)
    return tip[away <= np.median(away)]


def _choose_place(offered: Array, chosen: Array, middle: Array) -> int:
    """Choose a place: the first the one nearest to the path, then each as far from the others as can be."""
    if not len(chosen):
        return int(np.linalg.norm(offered - middle, axis=1).argmin())
    return int(np.linalg.norm(offered[:, None] - chosen, axis=2).min(axis=1).argmax())


def observe_rows(rows: Array, sights: Observations, point: Array) -> Array:
    """Return what sights of c contacts see of parameters, frames and places. Shape (m, 3, P + 3 c).

    rows: derivatives of the measured point, (m, 3, P); point: base frame, (m, 3). [m]
    """
    places = -sights.place_slopes().reshape(len(rows), 3, -1)
    return along(sights.directions(point, sights.start_places(point)), np.concatenate([rows, places], axis=2))
