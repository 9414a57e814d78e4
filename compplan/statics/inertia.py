"""Inertial loads on the springs of a moving arm.

Every body is replaced by four points of equal mass, centre and inertia. With p_b their positions at the rows of a timed
motion, p_b'' by divided differences, and f_b = -m_b p_b'' [d'Alembert], an elastic coordinate k with
axis a_k through o_k carries

    b_k = a_k . sum_b (p_b - o_k) x f_b     (a_k . sum_b f_b where it translates),   b the points beyond it.

The motion is that of the links, whose tool follows the path; the drives lead by the deflection of the springs. So the
corrections of the command cause no load (the link side is the flat output of an elastic joint, without damping
[Spong1987]).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from compplan.robot import Array, Robot
from compplan.robot.model import Body
from compplan.statics.chain import Chain, build_chain, chunks, locate_frames
from compplan.statics.sweep import cross, dot

#: Directions of the four points from the centre: zero sum, second moment four times the unit matrix.
CORNERS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])

#: A step that takes less does not move the arm. [s]
STANDS = 1e-6


def build_moving_chain(robot: Robot) -> Chain:
    """Build the elastic chain of a robot with point masses, without gravity.

    Its base is the ground; a positioner does not move it.
    """
    points = tuple(point for body in robot.bodies for point in divide_body(body))
    return build_chain(replace(robot.alone, gravity=np.zeros(3), weights=(), bodies=points))


def divide_body(body: Body) -> list[Body]:
    """Return four point masses with the mass, the centre and the inertia of a body.

    The second moment S = 1/2 tr(I) 1 - I is that of the points c + m^-1/2 S^1/2 e of mass m / 4; negative
    eigenvalues of S are set to zero.
    """
    if body.mass <= 0.0:
        return [body]
    moment = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    value, vector = np.linalg.eigh(0.5 * (moment + moment.T))
    arms = CORNERS @ (vector * np.sqrt(np.maximum(value, 0.0) / body.mass)).T
    return [Body(body.link, 0.25 * body.mass, body.centre + arm) for arm in arms]


def load_motion(chain: Chain, q: Array, time: Array, inside: NDArray[np.bool_]) -> Array:
    """Return the inertial load on each elastic coordinate; zero outside the runs. Shape (n, s). [N m or N]

    Args:
        chain: The chain with its masses (`build_moving_chain`).
        q: Joint positions of the links' motion, those of the chain last. Shape (n, nq). [rad or m]
        time: Time at each row. Shape (n,). [s]
        inside: Rows within a run from rest to rest, without its ends. Shape (n,). Rows next to a step of zero time are
            ends of a run.
    """
    step = np.diff(time)
    on_the_way = np.zeros(len(q), bool)
    on_the_way[1:-1] = inside[1:-1] & (step[:-1] > STANDS) & (step[1:] > STANDS)
    loads, rows = np.zeros((len(q), chain.n_springs)), np.flatnonzero(on_the_way)
    q = q[:, q.shape[1] - chain.nq :]
    if not len(rows) or not len(chain.mass):
        return loads
    for part in chunks(len(rows)):
        here = rows[part]
        first, last = here[0] - 1, here[-1] + 1
        frames = locate_frames(chain, q[first : last + 1])
        middle = here - first
        place, times = frames.centre, time[first : last + 1]
        before, after = (
            np.maximum(times[middle + side] - times[middle + side - 1], 1e-12)[:, None, None] for side in (0, 1)
        )
        change = (place[middle + 1] - place[middle]) / after - (place[middle] - place[middle - 1]) / before
        force = -chain.mass[:, None] * (2.0 * change / (before + after))  # divided differences
        loads[here] = _gather(chain, frames.axis[middle], frames.origin[middle], frames.centre[middle], force)
    return loads


def smooth_loads(load: Array, time: Array, runs: list[tuple[int, int]], window: float) -> Array:
    """Return the triangular moving average of loads in time; zero outside the runs. Shape (n, s).

    Loads that change faster than the arm can follow (at a kink or a stop) would make the drives jump. At the ends of a
    run the load is continued with odd symmetry, so that drives start at rest. With B'' = b, b linear between rows,

        b_w(t) = (B(t + h) - 2 B(t) + B(t - h)) / h^2,   h half the window,   |db_w/dt| <= 2 max|b| / h.

    Args:
        load: Load on each elastic coordinate. Shape (n, s). [N m or N]
        time: Time at each row. Shape (n,). [s]
        runs: First and last row of every run that begins and ends at rest.
        window: Length of the window, 0 for none. [s]
    """
    found, half = np.zeros(load.shape), 0.5 * window
    for first, last in runs:
        here, own = time[first : last + 1] - time[first], load[first : last + 1]
        keep = np.r_[True, np.diff(here) > 1e-9]
        if half <= 0.0 or keep.sum() < 3:
            found[first : last + 1] = own
            continue
        at, value = here[keep], own[keep].copy()
        value[[0, -1]] = 0.0
        at = np.r_[-at[:0:-1], at, 2.0 * at[-1] - at[-2::-1]]
        value = np.vstack([-value[:0:-1], value, -value[-2::-1]])
        twice = make_interp_spline(at, value, k=1).antiderivative(2)
        reach = min(half, here[-1])
        middle = twice(here + reach) - 2.0 * twice(here) + twice(here - reach)
        found[first : last + 1] = middle / reach**2
    return found


def _gather(chain: Chain, axis: Array, origin: Array, place: Array, force: Array) -> Array:
    """Return the loads of forces at the masses on the elastic coordinates. Shape (k, s)."""
    elements = chain.spring_elements
    axes, origins, places, forces = (
        [np.ascontiguousarray(part[:, :, i].T) for i in range(3)]
        for part in (axis[:, elements], origin[:, elements], place, force)
    )
    beyond = (chain.body_element >= elements[:, None]).astype(float)
    total, moment = ([beyond @ part for part in parts] for parts in (forces, cross(places, forces)))
    turned = dot(axes, [a - b for a, b in zip(moment, cross(origins, total), strict=True)])
    return np.where(chain.translates[elements, None], dot(axes, total), turned).T
