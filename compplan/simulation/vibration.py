"""Lowest natural frequencies of a robot on its springs, and modal response of the arm to the load of its motion.

Masses are included with or without gravity in the folder. With M the mass matrix and C the compliance of the elastic
coordinates at a posture, frequencies f solve det(1 / (2 pi f)^2 - C M) = 0 with locked drives. A motion loads the
springs by the inverse dynamics of the rigid arm, without weight [Featherstone2008].

The coordinates move in modes v_k, w^2 M v = K v with v^T M v = 1. Under the load b(t) of a motion [Craig2006]

    eta_k'' + 2 z w_k eta_k' + w_k^2 eta_k = v_k^T b(t),    tip = J C b + sum_k J v_k (eta_k - v_k^T b / w_k^2),

the higher modes respond quasi-statically. The load is linear between rows, for which the response is exact; modes are
those of a few postures, each started early enough that its transient has decayed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg.lapack import ztbtrs

from compplan.robot import Array, Robot
from compplan.simulation.exact import ExactRobot, build_exact_robot

#: Number of modes, and postures along a path at which modes are computed.
MODES, POSTURES = 6, 16
#: Lead time of the modes of a posture, as a multiple of the slowest decay time 1 / (z w).
EARLY = 4.0
#: Rows times modes per block: many for a low overhead of numpy calls, few for the cache.
AT_ONCE = 20_000


@dataclass(frozen=True)
class Dynamics:
    """Robot with all masses as a Pinocchio model, springs as joints."""

    exact_robot: ExactRobot  #: Model without gravity.
    #: The same in the frame of the ground (inertial); different only if a positioner carries the part.
    inertial: ExactRobot

    @property
    def known(self) -> bool:
        """Return whether there are masses on springs."""
        return (
            bool(len(self.exact_robot.elastic)) and sum(inertia.mass for inertia in self.exact_robot.model.inertias) > 0
        )


@dataclass(frozen=True)
class ModeShapes:
    """Lowest modes at one posture, v^T M v = 1; m modes, s elastic coordinates."""

    omega: Array  #: Angular frequencies, ascending. Shape (m,). [rad/s]
    shape: Array  #: Elastic coordinates of each mode. Shape (s, m). [1/sqrt(kg) or 1/(m sqrt(kg))]
    tip: Array  #: Tip motion of each mode, base axes. Shape (3, m). [1/sqrt(kg)]


def build_dynamics(robot: Robot) -> Dynamics:
    """Build the dynamics of a robot with all bodies of its URDF and the tool."""
    weightless = replace(robot, gravity=np.zeros(3), weights=())
    exact_robot = build_exact_robot(weightless)
    return Dynamics(exact_robot, build_exact_robot(weightless, inertial=True) if robot.ground else exact_robot)


def natural_frequencies(dynamics: Dynamics, q: Array, count: int = 2) -> Array:
    """Compute the `count` lowest natural frequencies at postures (k, nq), NaN if fewer. Shape (k, count). [Hz]"""
    found = np.full((len(q), count), np.nan)
    if dynamics.known:
        for row, modes in zip(found, find_modes(dynamics, q, count), strict=True):
            row[: len(modes.omega)] = modes.omega / (2.0 * np.pi)
    return found


def find_modes(dynamics: Dynamics, q: Array, count: int) -> list[ModeShapes]:
    """Compute at most `count` lowest modes at postures (k, nq), from M v = C^-1 v / w^2."""
    exact_robot, found = dynamics.exact_robot, []
    data, world = exact_robot.model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for configuration in q @ exact_robot.commanded.T + exact_robot.shift:
        mass = pin.crba(exact_robot.model, data, configuration)
        mass = (np.triu(mass) + np.triu(mass, 1).T)[np.ix_(exact_robot.elastic, exact_robot.elastic)]
        tip = pin.computeFrameJacobian(exact_robot.model, data, configuration, exact_robot.tcp, world)[
            :3, exact_robot.elastic
        ]
        square, shapes = np.linalg.eig(exact_robot.compliance @ mass)
        order = np.argsort(square.real)[::-1][:count]
        order = order[square.real[order] > 1e-12]
        way = shapes.real[:, order]
        way = way / np.sqrt(np.maximum(np.einsum("sm,st,tm->m", way, mass, way), 1e-300))
        found.append(ModeShapes(1.0 / np.sqrt(square.real[order]), way, tip @ way))
    return found


def modal_response(
    modes: list[ModeShapes], places: NDArray[np.int_], time: Array, loads: Sequence[Array], mix: Array, scale: Array,
    damping: Array,
) -> Array:  # fmt: skip
    """Compute the dynamic minus quasi-static tip displacement of each arm. Shape (d, n, 3). [m]

    Args:
        modes: Modes at some rows.
        places: Rows of these modes, ascending. Shape (k,).
        time: Time at each row. Shape (n,). [s]
        loads: b loads of the motion on each elastic coordinate. Shapes (n, s). [N m or N]
        mix: Share of each load on each of d arms. Shape (d, b).
        scale: Factor on all frequencies of each arm. Shape (d,).
        damping: Damping ratio of each arm. Shape (d,).
    """
    found, n = np.zeros((len(mix), len(time), 3)), len(time)
    edges = np.r_[0, (places[1:] + places[:-1]) // 2 + 1, n]
    for own, first, last in zip(modes, edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if not len(own.omega) or last <= first:
            continue
        begin = np.searchsorted(time, time[first] - EARLY / (damping * scale * own.omega.min()))
        size = max(AT_ONCE // ((last - int(begin.min())) * len(own.omega)), 1)
        order = np.argsort(begin)  # arms with a common start form a block
        for some in (order[k : k + size] for k in range(0, len(mix), size)):
            start = int(begin[some].min())
            parts = np.stack([load[start:last] @ own.shape for load in loads])
            force = np.einsum("db,bnm->ndm", mix[some], parts)
            if not force.any():
                continue
            omega = scale[some, None] * own.omega
            eta = _integrate_modes(time[start:last], force, omega, damping[some, None], begin[some] - start)
            # a factor on frequencies is one on compliances: modes keep their static share
            moved = ((eta - force / omega**2)[first - start :] * scale[some, None] ** 2) @ own.tip.T
            found[some, first:last] = np.swapaxes(moved, 0, 1)
    return found


def _integrate_modes(time: Array, force: Array, omega: Array, damping: Array, begin: NDArray[np.int_]) -> Array:
    """Solve eta'' + 2 z w eta' + w^2 eta = force from static equilibrium, force linear between rows.

    Shape (n, d, m), one column per mode of an arm; all modes form one banded system of equations. Arm d is at rest
    under the load until row begin[d].
    """
    rate = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
    x = np.maximum(np.diff(time), 1e-12)[:, None, None] * rate
    decay = np.exp(x)
    whole = (decay - 1.0) / x
    late = (whole - 1.0) / x
    if (small := np.abs(x) < 1e-3).any():
        near = x[small]
        whole[small], late[small] = 1.0 + near / 2 + near**2 / 6, 0.5 + near / 6
    gain = (x / rate) * ((whole - late) * force[:-1] + late * force[1:])
    static = np.arange(1, len(time))[:, None] <= begin
    right = np.concatenate([force[:1] * -1.0 / rate, np.where(static[..., None], force[1:] * -1.0 / rate, gain)])
    bands = np.ones((2, force.size), complex, order="F")
    kept = np.where(static[..., None], 0.0, -decay)
    bands[1] = np.concatenate([kept, np.zeros((1, *omega.shape))]).reshape(len(time), -1).T.ravel()
    right = right.reshape(len(time), -1).T.reshape(-1, 1)
    state = ztbtrs(bands, right, uplo="L", diag="U", overwrite_b=True)[0].reshape(omega.size, -1).T
    return np.asarray(state.imag.reshape(force.shape) / (omega * np.sqrt(1.0 - damping**2)))
