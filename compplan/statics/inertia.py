"""Inertial loads on the springs of a moving arm.

Every body is replaced by four points of equal mass, centre and inertia. With p_b their positions in a timed motion,
joint positions a parabola through each row and its neighbours, and f_b = -m_b p_b'' [d'Alembert], an elastic coordinate
k with axis a_k through o_k carries

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
from compplan.statics.chain import Chain, Frames, build_chain, chunks, locate_frames
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
    step = np.diff(time)[:, None]
    rows = 1 + np.flatnonzero(inside[1:-1] & (np.minimum(step[:-1], step[1:])[:, 0] > STANDS))
    loads = np.zeros((len(q), chain.n_springs))
    if not len(rows) or not len(chain.mass):
        return loads
    q = q[:, q.shape[1] - chain.nq :]
    speed, whole = np.diff(q, axis=0) / np.maximum(step, STANDS), step[:-1] + step[1:]
    rate = (step[1:] * speed[:-1] + step[:-1] * speed[1:]) / np.maximum(whole, STANDS)
    change = 2.0 * np.diff(speed, axis=0) / np.maximum(whole, STANDS)
    for part in chunks(len(rows)):
        here = rows[part]
        loads[here] = _load_springs(chain, locate_frames(chain, q[here]), rate[here - 1], change[here - 1])
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


def _load_springs(chain: Chain, frames: Frames, rate: Array, change: Array) -> Array:
    """Return the loads of the masses on the elastic coordinates. Shape (k, s).

    rate, change: velocity and acceleration of the joints. Shapes (k, nq). [rad/s or m/s, per s]
    """
    springs, driven = chain.spring_elements, np.flatnonzero(chain.q_index >= 0)
    axis, origin, place = (np.transpose(part, (2, 1, 0)) for part in (frames.axis, frames.origin, frames.centre))
    rate, change = (chain.multiplier[driven, None] * motion.T[chain.q_index[driven]] for motion in (rate, change))
    # unit twists of the elements: rotation, and velocity at the origin of the base [Featherstone2008]
    slides, turn, about = chain.translates[driven, None], axis[:, driven], origin[:, driven]
    turn, shift = np.where(slides, 0.0, turn), np.where(slides, turn, cross(about, turn))
    omega, velocity = np.cumsum(turn * rate, axis=1), np.cumsum(shift * rate, axis=1)
    turned, shifted = np.array(cross(omega, turn)), np.add(cross(omega, shift), cross(velocity, turn))
    alpha, linear = (
        np.cumsum(part * change + by_turning * rate, axis=1) for part, by_turning in ((turn, turned), (shift, shifted))
    )
    carrier = np.searchsorted(driven, chain.body_element, "right") - 1  # masses of the base load no spring
    omega, velocity, alpha, linear = (part[:, carrier] for part in (omega, velocity, alpha, linear))
    acceleration = linear + cross(alpha, place) + cross(omega, velocity + cross(omega, place))
    force = -chain.mass[:, None] * acceleration
    beyond = (chain.body_element >= springs[:, None]).astype(float)
    total, moment = beyond @ force, beyond @ np.array(cross(place, force))
    turning = dot(axis[:, springs], moment - cross(origin[:, springs], total))
    return np.where(chain.translates[springs, None], dot(axis[:, springs], total), turning).T
