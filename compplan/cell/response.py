"""How an arm with its modes answers to the load of its own motion: it lags, overshoots and rings out.

At a posture the elastic coordinates move in modes v_k, w^2 M v = K v with v^T M v = 1. Under the load b(t) of a
motion [Craig2006]

    eta_k'' + 2 z w_k eta_k' + w_k^2 eta_k = v_k^T b(t),    tip = J C b + sum_k J v_k (eta_k - v_k^T b / w_k^2),

what is stiffer than the modes counted follows at once. The load goes over linearly between rows, for which the answer
is exact; modes are those of a few postures, each begun early enough that its start has rung out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import ztbtrs

from compplan.cell.vibration import ModeShapes
from compplan.robot import Array

#: Modes that are counted, and postures along a path whose modes are taken.
MODES, POSTURES = 6, 16
#: Time that a posture's modes are begun early, as multiples of the slowest decay 1 / (z w).
EARLY = 4.0


def ring(
    modes: list[ModeShapes], places: NDArray[np.int_], time: Array, load: Array, scale: float, damping: float
) -> Array:
    """Return by how much more the tip moves than if the springs gave at once. Shape (n, 3). [m]

    Args:
        modes: Modes at some rows.
        places: Those rows, ascending. Shape (k,).
        time: Time at each row. Shape (n,). [s]
        load: Load of the motion on each elastic coordinate. Shape (n, s). [N m or N]
        scale: Factor on all frequencies.
        damping: Share of critical damping.
    """
    found, n = np.zeros((len(time), 3)), len(time)
    edges = np.r_[0, (places[1:] + places[:-1]) // 2 + 1, n]
    for own, first, last in zip(modes, edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if not len(own.omega) or last <= first:
            continue
        omega = scale * own.omega
        early = int(np.searchsorted(time, time[first] - EARLY / (damping * omega.min())))
        push = load[early:last] @ own.shape
        if not push.any():
            continue
        answer = _answer(time[early:last], push, omega, damping) - push / omega**2
        # frequencies that differ by a factor come from compliances that do: modes keep their static share
        found[first:last] = (answer[first - early :] * scale**2) @ own.tip.T
    return found


def _answer(time: Array, push: Array, omega: Array, damping: float) -> Array:
    """Solve eta'' + 2 z w eta' + w^2 eta = push from rest at the static place, push linear between rows.

    Shape (n, m), one column a mode; the modes stand one after another in one band of equations.
    """
    rate = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
    x = np.maximum(np.diff(time), 1e-12)[:, None] * rate
    decay = np.exp(x)
    whole = (decay - 1.0) / x
    late = (whole - 1.0) / x
    if (small := np.abs(x) < 1e-3).any():
        near = x[small]
        whole[small], late[small] = 1.0 + near / 2 + near**2 / 6, 0.5 + near / 6
    gain = (x / rate) * ((whole - late) * push[:-1] + late * push[1:])
    start = push[:1] * -1.0 / rate  # at rest under the first load
    bands = np.ones((2, push.size), complex, order="F")
    bands[1] = np.vstack([-decay, np.zeros((1, len(omega)))]).T.ravel()
    state = ztbtrs(bands, np.vstack([start, gain]).T.reshape(-1, 1), uplo="L", diag="U", overwrite_b=True)[0]
    return np.asarray(state.reshape(len(omega), -1).T.imag / (omega * np.sqrt(1.0 - damping**2)))
