"""Which effects a campaign cannot tell from a true one: what else could have left the same trace, frames aside."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.effects import EFFECTS
from compplan.effects.base_frame import base_twists
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.effects.tool_frame import tool_twists
from compplan.measure.campaign import Campaign
from compplan.robot import Array

#: An effect is alike if it explains this share of the trace, frames fitted to both, or leaves less than so many noise
#: variances.
ALIKE, BELOW_NOISE = 0.98, 12.0
#: Where frames explain all but this share, the whole trace counts.
LEFT_BY_FRAMES = 0.02
#: Every so many samples of a path are compared: neighbours say the same.
PATH_STRIDE = 8
SIGMA_ROTATION, SIGMA_ENCODER = np.deg2rad(0.005), np.deg2rad(0.0003)


@dataclass(frozen=True, eq=False)
class Observer:
    """What a campaign sees, in units of its noise: position, orientation and encoders where it has them."""

    campaign: Campaign
    sigma: float

    def rows(self) -> NDArray[np.int_]:
        """Return the rows that are compared."""
        index = np.arange(len(self.campaign))
        return np.flatnonzero(~self.campaign.on_path | (index % PATH_STRIDE == 0))

    def whiten(self, twist: Array, encoder: Array | None) -> Array:
        """Stack motions and readings into columns. Shapes (n, 6, k), (n, nq, k) -> (m, k)."""
        rows, k = self.rows(), twist.shape[-1]
        parts = [twist[rows, :3] / self.sigma]
        if self.campaign.rotation is not None:
            parts.append(twist[rows, 3:] / SIGMA_ROTATION)
        if self.campaign.link is not None:
            nq = self.campaign.nq
            parts.append(np.zeros((len(rows), nq, k)) if encoder is None else encoder[rows] / SIGMA_ENCODER)
        return np.concatenate([part.reshape(-1, k) for part in parts])


def list_rivals(at: Linearization) -> list[Signature]:
    """List the signatures that count as rivals: forms that contain others trivially are left out."""
    found: list[Signature] = []
    for effect in EFFECTS.values():
        found += [s for s in effect.signatures(at) if _plain(s)]
    return found


def _plain(signature: Signature) -> bool:
    if signature.name == "stiffness_nonlinearity":
        return not signature.form.startswith("linear")
    if signature.name == "gravity_compensator":
        return signature.form == "sine"
    return True


def find_alike(trace: Array, place: tuple[str, str | None, str | None], rivals: Iterable[Signature],
               watch: Observer, at: Linearization) -> list[dict[str, Any]]:  # fmt: skip
    """Find the effects that explain a trace.

    Args:
        trace: What the true effect leaves, whitened. Shape (m,).
        place: Its name, joint and axis.
        rivals: Signatures that could explain it.
        watch: How the campaign sees.
        at: Linearization of the nominal robot.

    Returns:
        Effect, joint, axis and share of each, largest share first.
    """
    frames = watch.whiten(np.concatenate([base_twists(at), tool_twists(at)], axis=-1), None)
    basis = _basis(frames)
    free = trace - basis @ (basis.T @ trace)
    aside = float(free @ free) >= LEFT_BY_FRAMES * float(trace @ trace)
    target = free if aside else trace
    energy = float(target @ target)
    best: dict[tuple[str, str | None, str | None], float] = {}
    for signature in rivals:
        if signature.place == place:
            continue
        columns = watch.whiten(signature.twist * signature.scale, _scaled(signature))
        if aside:
            columns = columns - basis @ (basis.T @ columns)
        own = _basis(columns)
        share = float(np.sum((own.T @ target) ** 2)) / energy
        if share >= ALIKE or (1.0 - share) * energy < BELOW_NOISE:
            best[signature.place] = max(share, best.get(signature.place, 0.0))
    ranked = sorted(best.items(), key=lambda item: -item[1])
    return [{"effect": p[0], "joint": p[1], "axis": p[2], "r2": round(share, 5)} for p, share in ranked]


def _scaled(signature: Signature) -> Array | None:
    return None if signature.encoder is None else signature.encoder * signature.scale


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of the columns. Shape (m, r)."""
    length = np.linalg.norm(columns, axis=0)
    used = columns[:, length > 1e-9 * max(float(length.max(initial=0.0)), 1e-30)]
    if not used.shape[1]:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)
    return np.asarray(u[:, s > 1e-7 * s[0]])
