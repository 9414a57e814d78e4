"""Candidate measurements: reachable postures, available loads, and approaches from below and above.

Half of the postures are drawn around the path, half anywhere within the joint limits. Postures that collide, or put the
tool below the base, are left out.

Sockets and dial gauges are placed as the campaign proposes, within centimetres: their positions are unknown, and each
is visited more than once. `compplan.measurement.observations` defines the observation equation of each kind.
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
from compplan.measurement.pose_selection import (
    FLOOR,
    approach_poses,
    draw_postures,
    pull_aside,
    run_up,
    take_clear,
)
from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot
from compplan.robot.model import STANDARD_GRAVITY
from compplan.robot.uncertainty import Unknown
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames
from compplan.uncertainty.sensitivities import build_varied_model, measure_slopes, select_model_rows

#: Number of postures kept, and greatest number drawn.
KEPT, DRAWN = 300, 3000
#: Kind of observation and default number of places of each instrument.
KINDS = {SOCKETS: CONTACT, GAUGE: READING}
PLACES = {SOCKETS: 3, GAUGE: 6}
#: Standard deviation of the distance of two sockets of a plate. [m] (assumed)
SOCKET_SIGMA = 2e-5
#: Inverse kinematics: iterations, position tolerance [m], greatest joint step per iteration [rad or m].
STEPS, TIP_TOLERANCE, STEP = 15, 1e-9, 0.2
#: Setup instruction of an instrument; {at} in the robot's base frame.
SETUP = {
    SOCKETS: "socket {label} at ({at}) mm in the base frame; fix it until its poses are measured",
    GAUGE: "dial gauge {label} where the tip touches it at ({at}) mm in the base frame, its axis along ({along}) within"
           " 0.2 deg, so that the reading grows in this direction; zero it once, before the first pose",
}  # fmt: skip
#: Directions of dial gauges and plates, in turn for successive places.
NORMALS = np.eye(3)[[2, 0, 1]]


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidate measurements; m measurements, p parameters."""

    log: Campaign  #: Two rows per measurement, without measured values: start of the approach, and the pose.
    tip: Array  #: Predicted tip. Shape (m, 3). [m]
    rotation: Array  #: Orientation of the TCP. Shape (m, 3, 3).
    slopes: Array  #: Derivative of the tip with respect to every parameter. Shape (m, 3, p).
    observations: Observations | None = None  #: Observations of sockets or dial gauges; None for a tracker.

    def __len__(self) -> int:
        return len(self.tip)

    @property
    def start(self) -> Array:
        """Return the joint positions at the start of each approach. Shape (m, nq). [rad or m]"""
        return self.log.q[::2]

    @property
    def q(self) -> Array:
        """Return the joint positions of the poses. Shape (m, nq). [rad or m]"""
        return self.log.q[1::2]

    @property
    def approach_positive(self) -> NDArray[np.bool_]:
        """Return whether all joints approach in positive direction. Shape (m,)."""
        return np.asarray((self.q >= self.start).all(axis=1))

    @property
    def wrench(self) -> Array:
        """Return the load at the TCP, base axes. Shape (m, 6). [N, N m]"""
        return self.log.wrench[1::2]

    @property
    def weight(self) -> Array:
        """Return the mass that hangs at the tool; pulls are horizontal and do not count. Shape (m,). [kg]"""
        return np.asarray(self.wrench[:, 2] / -STANDARD_GRAVITY)

    def take(self, rows: NDArray[np.int_]) -> Candidates:
        """Return the selected measurements."""
        log = self.log.take(np.stack([2 * rows, 2 * rows + 1], axis=1).ravel())
        observations = None if self.observations is None else self.observations.take(rows)
        return Candidates(log, self.tip[rows], self.rotation[rows], self.slopes[rows], observations)


def find_postures(
    robot: Robot, path_q: Array, lowest: float, scene: CollisionScene | None, seed: int, kept: int = KEPT
) -> Array:
    """Draw at most `kept` reachable postures without collision. Shape (k, nq). [rad or m]

    path_q: joint positions along the path, (n, nq); lowest: least height of the path over the base plane [m]; scene:
    collision scene, or None.
    """
    drawn = draw_postures(robot, path_q, lowest, seed, DRAWN)
    if scene is None or not len(drawn):
        return np.asarray(drawn[:kept])
    batches = (drawn[start : start + kept] for start in range(0, len(drawn), kept))
    return take_clear(batches, lambda part: measure_margin(scene, part, 0.0) >= 0.0, kept)


def list_candidates(
    robot: Robot, postures: Array, weights: Sequence[float], pull: float, unknowns: tuple[Unknown, ...]
) -> Candidates:
    """Combine postures, (k, nq), with approach directions, weights [kg] and pulls; differentiate the measured tip.

    pull: force with which the tool can be pulled along +-x and +-y of the base; 0 for none. [N]
    """
    k = len(postures)
    loads = [(0.0, 0.0, 0.0 - STANDARD_GRAVITY * weight) for weight in weights]
    loads += pull_aside(pull)
    q, sign = np.tile(postures, (2 * len(loads), 1)), np.tile(np.repeat([1, -1], k), len(loads))
    log = approach_poses(robot, q, sign, np.repeat(loads, 2 * k, axis=0))
    scene, rows = build_varied_model(robot, log), np.arange(1, len(log), 2)
    attained = solve_model_poses(select_model_rows(scene, rows))
    return Candidates(log, attained.position, attained.rotation, measure_slopes(scene, unknowns, rows))


def find_touching(
    robot: Robot, postures: Array, middle: Array, lowest: float, instrument: str, places: int, length: float,
    scene: CollisionScene | None,
) -> tuple[Array, Observations]:  # fmt: skip
    """Find postures with the tip at an instrument, (k, nq) [rad or m]; also return their observations.

    postures: reachable ones, (m, nq); middle: centre of the path, (3,) [m]; lowest: least height of the path over the
    base plane [m]; instrument: "sockets" or "gauge"; places: their number; length: distance of two sockets of a plate,
    0 for single ones [m]; scene: collision scene, or None.

    Raises:
        InputError: If a place is reached in fewer than three postures.
    """
    tip = locate_frames(build_chain(robot), postures).tcp_position
    q, label, names = [], [], list[str]()
    plates = instrument == SOCKETS and length > 0.0

    def reach_place(centre: Array, number: int) -> list[Array]:
        """Return the postures that reach the `number`-th place, or each socket of its plate."""
        nearest = np.argsort(np.linalg.norm(tip - centre, axis=1))[: max(len(postures) // 3, 12)]
        half, met = 0.5 * length * NORMALS[(number + 1) % 3], []
        for shift in (-half, half) if plates else (np.zeros(3),):
            found = solve_tips(robot, postures[nearest], np.tile(centre + shift, (len(nearest), 1)))
            high = locate_frames(build_chain(robot), found).tcp_position[:, 2] >= min(FLOOR, lowest)
            met.append(found[high if scene is None else high & (measure_margin(scene, found, 0.0) >= 0.0)])
        return met

    away = np.linalg.norm(tip - middle, axis=1)
    offered, chosen = tip[away <= np.median(away)], np.empty((0, 3))
    for number in range(places):
        most = 0
        while True:  # places that are unreachable or blocked are skipped
            if not len(offered):
                raise InputError(
                    f"the arm reaches place {number + 1} in {most} postures, expected at least 3, wherever it lies"
                    " near the path; ask for fewer --places, or check joint limits and collisions"
                )
            at = _choose_place(offered, chosen, middle)
            centre, offered = offered[at], np.delete(offered, at, axis=0)
            met = reach_place(centre, number)
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
        known = KnownDistances(pairs, np.full(places, length), np.full(places, SOCKET_SIGMA))
    kind = np.full(n, KINDS[instrument])
    observations = Observations(kind, contact, tuple(names), np.zeros((n, 3)), direction, np.zeros(n), known)
    return np.concatenate(q), observations


def solve_tips(robot: Robot, q: Array, target: Array) -> Array:
    """Move the tip to positions with least joint motion; return the postures within the limits. Shape (k, nq)."""
    chain, q = build_chain(robot), q.copy()
    for _ in range(STEPS):
        frames = locate_frames(chain, q)
        away = target - frames.tcp_position
        step = np.einsum("nij,nj->ni", np.linalg.pinv(joint_jacobian(chain, frames)[:, :3], rcond=1e-3), away)
        q = q + np.clip(step, -STEP, STEP)
    good = np.linalg.norm(target - locate_frames(chain, q).tcp_position, axis=1) < TIP_TOLERANCE
    edge = run_up(robot)
    return np.asarray(q[good & ((q > robot.lower + edge) & (q < robot.upper - edge)).all(axis=1)])


@dataclass(frozen=True, eq=False)
class Fixture:
    """Location of an instrument: label, position in the robot's base frame (3,) [m], and setup instruction."""

    label: str
    place: Array
    instruction: str


def list_fixtures(instrument: str, observations: Observations | None, tip: Array) -> tuple[Fixture, ...]:
    """Return the location of the instrument of a campaign for each label.

    observations: its observation in every pose, None for a tracker; tip: base frame, (m, 3). [m]
    """
    fixtures, names = [], () if observations is None else observations.names
    for number, label in enumerate(names):
        assert observations is not None
        rows = np.flatnonzero(observations.contact == number)
        place = tip[rows].mean(axis=0)
        instruction = SETUP[instrument].format(
            at=", ".join(f"{1e3 * v:.0f}" for v in place + 0.0), label=label,
            along=", ".join(f"{v:g}" for v in observations.direction[rows[0]]),
        )  # fmt: skip
        fixtures.append(Fixture(label, place, instruction))
    return tuple(fixtures)


def _choose_place(offered: Array, chosen: Array, middle: Array) -> int:
    """Choose a place: first the nearest to the centre of the path, then the farthest from those chosen."""
    if not len(chosen):
        return int(np.linalg.norm(offered - middle, axis=1).argmin())
    return int(np.linalg.norm(offered[:, None] - chosen, axis=2).min(axis=1).argmax())


def observe_rows(rows: Array, observations: Observations, point: Array) -> Array:
    """Return the derivatives of observations by parameters, frames and c contact positions. Shape (m, 3, P + 3 c).

    rows: derivatives of the measured point, (m, 3, P); point: base frame, (m, 3). [m]
    """
    slopes, places = -observations.place_slopes().reshape(len(rows), 3, -1), observations.start_places(point)
    return along(observations.directions(point, places), np.concatenate([rows, slopes], axis=2))
