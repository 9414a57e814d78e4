"""Clearance: distance of arm and tool from the part, the fixture and the arm itself.

The required clearance applies to part and fixture; arm and tool must only not touch the arm.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.collision_scene import (
    FAR,
    TOUCH,
    CollisionScene,
    Contact,
    Near,
    find_contacts,
    find_near,
)
from compplan.robot import Array
from compplan.toolpath.toolpath import interpolate, select_even

#: Evenly spaced waypoints whose distance is computed, most rounds of refinement where a smaller distance is possible,
#: and waypoints in each.
SAMPLES, ROUNDS, FURTHER = 120, 40, 10
#: Accuracy of the least distance along a path. [m]
EXACT = 5e-4
#: Margin beyond which none is computed; motion of the arm between two postures that is not subdivided: between them
#: the margin may be less by half of it. [m]
BEYOND, HIDDEN = 0.05, 4e-3


@dataclass(frozen=True)
class ClearanceProfile:
    """Clearance along a path."""

    #: Distance of arm and tool from part and fixture at each waypoint, linear between computed ones. Shape (n,). [m]
    distance: Array
    computed: NDArray[np.int_]  #: Waypoints where it was computed. Shape (c,).
    contacts: tuple[Contact, ...]  #: The nearest pair at each of these. Length c.
    own: Contact  #: Nearest pair of arm or tool with the arm, at its least distance along the path.
    own_waypoint: int  #: Waypoint of that pair.
    wanted: float  #: Required clearance. [m]

    @property
    def least(self) -> tuple[int, Contact]:
        """Return the waypoint with the least distance, and its nearest pair."""
        k = int(np.argmin([contact.distance for contact in self.contacts]))
        return int(self.computed[k]), self.contacts[k]


def measure_margin(scene: CollisionScene, q: Array, wanted: float) -> Array:
    """Compute the margin of postures (n, nq): distance from part and fixture less `wanted`, from the arm less `TOUCH`.

    Negative where a posture violates the clearance. Shape (n,). [m]
    """
    outside = find_contacts(scene.robot, scene.solids, q, scene.outside, far=wanted + BEYOND)
    own = find_contacts(scene.robot, scene.solids, q, scene.own, far=BEYOND)
    return np.minimum(_distances(outside) - wanted, _distances(own) - TOUCH)


def linearise_margin(scene: CollisionScene, q: Array, wanted: float) -> Near:
    """Compute margins of the nearest pairs of postures (n, nq), with their derivatives with respect to the joints."""
    kinds = ((scene.outside, wanted), (scene.own, TOUCH))
    found = [find_near(scene.robot, scene.solids, q, pairs, far=limit + BEYOND) for pairs, limit in kinds]
    margin = [near.distance - limit for near, (_, limit) in zip(found, kinds, strict=True)]
    return Near(np.concatenate([near.posture for near in found]), np.concatenate(margin),
                np.concatenate([near.rate for near in found]))  # fmt: skip


def sweep_margin(scene: CollisionScene, q: Array, wanted: float, first: Array) -> tuple[Array, Array]:
    """Compute margins along a piecewise linear joint motion (n, nq), also between its postures.

    Between two postures with margins m_i and m_j and a motion of the arm by s, no margin is below (m_i + m_j - s) / 2.
    Where that is negative and s above HIDDEN, the middle posture is computed, until one has a negative margin. The
    search begins at the places `first` (j,) and both ends of the motion.

    Returns:
        Places along the motion in posture numbers from 0, and the margins there. Shapes (p,). [1, m]
    """
    rows, last = np.arange(len(q)), len(q) - 1
    travel = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)) @ scene.reach)]
    places = np.union1d(first, [0.0, last])
    margin = measure_margin(scene, interpolate(places, rows, q), wanted)
    while margin.min() >= 0.0:
        moved = np.diff(np.interp(places, rows, travel))
        (gaps,) = np.nonzero((margin[1:] + margin[:-1] < moved) & (moved > HIDDEN))
        if not len(gaps):
            break
        middle = 0.5 * (places[gaps] + places[gaps + 1])
        middle = np.where(places[gaps + 1] - places[gaps] > 1.5, np.rint(middle), middle)
        margin = np.insert(margin, gaps + 1, measure_margin(scene, interpolate(middle, rows, q), wanted))
        places = np.insert(places, gaps + 1, middle)
    return places, margin


def measure_clearance(scene: CollisionScene, q: Array, wanted: float) -> ClearanceProfile:
    """Compute the clearance at the waypoints of a path (n, nq), with few distance computations.

    A point moves between two postures by at most `reach` times the joint motion. A computed distance therefore bounds
    those around it; waypoints are computed until no other can have the least distance.
    """
    contacts = _least_along(scene, q, scene.outside, FAR)
    own = _least_along(scene, q, scene.own, 0.1)
    known = np.array(sorted(contacts))
    distance = _distances(contacts[w] for w in known.tolist())
    worst = min(own, key=lambda w: own[w].distance)
    profile = np.interp(np.arange(len(q)), known, distance)
    return ClearanceProfile(profile, known, tuple(contacts[w] for w in known.tolist()), own[worst], worst, wanted)


def _least_along(scene: CollisionScene, q: Array, pairs: NDArray[np.int_], far: float) -> dict[int, Contact]:
    """Compute contacts at even samples, and where the least distance is possible."""

    def find(rows: NDArray[np.int_]) -> dict[int, Contact]:
        found = find_contacts(scene.robot, scene.solids, q[rows], pairs, far=far)
        return dict(zip(rows.tolist(), found, strict=True))

    contacts = find(select_even(np.arange(len(q)), SAMPLES))
    travel = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)) @ scene.reach)]
    for _ in range(ROUNDS):
        known = np.array(sorted(contacts))
        distance = _distances(contacts[w] for w in known.tolist())
        lowest = 0.5 * (distance[1:] + distance[:-1] - np.diff(travel[known]))  # lower bound between two waypoints
        gaps = np.flatnonzero((lowest < distance.min() - EXACT) & (np.diff(known) > 1))
        if not len(gaps):
            break
        gaps = gaps[np.argsort(lowest[gaps])][:FURTHER]
        contacts.update(find((known[gaps] + known[gaps + 1]) // 2))
    return contacts


def summarise_clearance(profile: ClearanceProfile, scene: CollisionScene | None = None) -> dict[str, Any]:
    """Describe the clearance along a path and the number of shapes of each body of the arm for plan.json."""
    waypoint, contact = profile.least
    own = profile.own
    return {
        "wanted_mm": 1e3 * profile.wanted,
        "least_mm": 1e3 * contact.distance,
        "waypoint": waypoint,
        "between": [contact.first, contact.second] if contact.first else [],
        "own_least_mm": 1e3 * own.distance,
        "own_waypoint": profile.own_waypoint,
        "own_between": [own.first, own.second] if own.first else [],
        "shapes": {} if scene is None else {body.link: body.count for body in scene.bodies},
    }


def _distances(contacts: Iterable[Contact]) -> Array:
    return np.array([contact.distance for contact in contacts])
