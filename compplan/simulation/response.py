"""How an arm with its modes answers to the load of its own motion: it lags, overshoots and rings out.

At a posture the elastic coordinates move in modes v_k, w^2 M v = K v with v^T M v = 1. Under the load b(t) of a
motion [Craig2006]

    eta_k'' + 2 z w_k eta_k' + w_k^2 eta_k = v_k^T b(t),    tip = J C b + sum_k J v_k (eta_k - v_k^T b / w_k^2),

what is stiffer than the modes counted follows at once. The load goes over linearly between rows, for which the answer
is exact; modes are those of a few postures, each begun early enough that its start has rung out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import ztbtrs

from compplan.robot import Array
from compplan.simulation.vibration import ModeShapes

#: Modes that are counted, and postures along a path whose modes are taken.
MODES, POSTURES = 6, 16
#: Time that a posture's modes are begun early, as multiples of the slowest decay 1 / (z w).
EARLY = 4.0
#: Rows times modes that are answered at once: enough that numpy's calls cost little, few enough for the cache.
AT_ONCE = 20_000


def ring(
    modes: list[ModeShapes], places: NDArray[np.int_], time: Array, loads: Sequence[Array], mix: Array, scale: Array,
    damping: Array,
) -> Array:  # fmt: skip
    """Return by how much more the tip of each arm moves than if the springs gave at once. Shape (d, n, 3). [m]

    Args:
        modes: Modes at some rows.
        places: Those rows, ascending. Shape (k,).
        time: Time at each row. Shape (n,). [s]
        loads: b loads of the motion on each elastic coordinate. Shapes (n, s). [N m or N]
        mix: Share of each load that acts on each of d arms. Shape (d, b).
        scale: Factor on all frequencies of each arm. Shape (d,).
        damping: Share of critical damping of each. Shape (d,).
    """
    found, n = np.zeros((len(mix), len(time), 3)), len(time)
    edges = np.r_[0, (places[1:] + places[:-1]) // 2 + 1, n]
    for own, first, last in zip(modes, edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if not len(own.omega) or last <= first:
            continue
        begin = np.searchsorted(time, time[first] - EARLY / (damping * scale * own.omega.min()))
        size = max(AT_ONCE // ((last - int(begin.min())) * len(own.omega)), 1)
        order = np.argsort(begin)  # arms that begin together go together
        for some in (order[k : k + size] for k in range(0, len(mix), size)):
            start = int(begin[some].min())
            parts = np.stack([load[start:last] @ own.shape for load in loads])
            push = np.einsum("db,bnm->ndm", mix[some], parts)
            if not push.any():
                continue
            omega = scale[some, None] * own.omega
            answer = _answer(time[start:last], push, omega, damping[some, None], begin[some] - start) - push / omega**2
            # frequencies that differ by a factor come from compliances that do: modes keep their static share
            moved = (answer[first - start :] * scale[some, None] ** 2) @ own.tip.T
            found[some, first:last] = np.swapaxes(moved, 0, 1)
    return found


def _answer(time: Array, push: Array, omega: Array, damping: Array, begin: NDArray[np.int_]) -> Array:
    """Solve eta'' + 2 z w eta' + w^2 eta = push from rest at the static place, push linear between rows.

    Shape (n, d, m), one column a mode of an arm; the modes stand one after another in one band of equations. Arm d is
    at rest under the load until row begin[d].
    """
    rate = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
    x = np.maximum(np.diff(time), 1e-12)[:, None, None] * rate
    decay = np.exp(x)
    whole = (decay - 1.0) / x
    late = (whole - 1.0) / x
    if (small := np.abs(x) < 1e-3).any():
        near = x[small]
        whole[small], late[small] = 1.0 + near / 2 + near**2 / 6, 0.5 + near / 6
    gain = (x / rate) * ((whole - late) * push[:-1] + late * push[1:])
    still = np.arange(1, len(time))[:, None] <= begin
    right = np.concatenate([push[:1] * -1.0 / rate, np.where(still[..., None], push[1:] * -1.0 / rate, gain)])
    bands = np.ones((2, push.size), complex, order="F")
    kept = np.where(still[..., None], 0.0, -decay)
    bands[1] = np.concatenate([kept, np.zeros((1, *omega.shape))]).reshape(len(time), -1).T.ravel()
    right = right.reshape(len(time), -1).T.reshape(-1, 1)
    state = ztbtrs(bands, right, uplo="L", diag="U", overwrite_b=True)[0].reshape(omega.size, -1).T
    return np.asarray(state.imag.reshape(push.shape) / (omega * np.sqrt(1.0 - damping**2)))
