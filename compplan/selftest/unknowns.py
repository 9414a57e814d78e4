"""Effects outside the vocabulary, for the virtual cell: what a diagnosis has to call unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from compplan.effects.linearization import Linearization
from compplan.effects.scene import Scene
from compplan.robot import Array

#: An unknown effect puts motion into a scene, given its size and a seed.
Unknown = Callable[[Scene, Linearization, int, float, int], Scene]

MEANING = {
    "stick_scatter": "friction leaves a joint short of its target by an amount that differs from stay to stay",
    "load_dependent_wave": "the periodic error of a joint grows with the load on it",
    "posture_coupling": "a joint errs with the product of two other joints' angles",
    "swaying_floor": "the floor tilts to and fro with the time of day",
}


def apply_unknown(name: str, scene: Scene, at: Linearization, joint: int, size: float, seed: int) -> Scene:
    """Put an unknown effect into a scene.

    Args:
        name: One of `MEANING`.
        scene: The scene.
        at: Linearization of the nominal robot at the same rows: loads.
        joint: Joint that it sits at, counted from 0.
        size: Its size. [rad]
        seed: Seed of what is random in it; the same in a later campaign.
    """
    return _MAKERS[name](scene, at, joint, size, seed)


def _stick_scatter(scene: Scene, at: Linearization, joint: int, size: float, seed: int) -> Scene:
    random = np.random.default_rng([seed, int(scene.later)])
    stay = scene.campaign.stay
    return _turn(scene, joint, size * random.normal(size=int(stay.max()) + 1)[stay])


def _load_dependent_wave(scene: Scene, at: Linearization, joint: int, size: float, seed: int) -> Scene:
    load = at.own_load[:, joint]
    angle = scene.campaign.q[:, joint]
    return _turn(scene, joint, size * load / max(float(np.abs(load).max()), 1e-9) * np.sin(7.0 * angle + seed % 6))


def _posture_coupling(scene: Scene, at: Linearization, joint: int, size: float, seed: int) -> Scene:
    q = scene.campaign.q
    others = np.random.default_rng(seed).permutation([k for k in range(q.shape[1]) if k != joint])[:2]
    return _turn(scene, joint, size * np.sin(2.0 * q[:, others[0]]) * np.sin(2.0 * q[:, others[1]] + 0.7))


def _swaying_floor(scene: Scene, at: Linearization, joint: int, size: float, seed: int) -> Scene:
    time = np.arange(len(scene.campaign)) * 20.0 if scene.campaign.time is None else scene.campaign.time
    period = 900.0 + seed % 600
    base = scene.base_twist.copy()
    base[:, 3] += size * np.sin(2.0 * np.pi * time / period + seed % 6)
    base[:, 4] += 0.6 * size * np.sin(2.0 * np.pi * time / period + seed % 5)
    return replace(scene, base_twist=base)


def _turn(scene: Scene, joint: int, error: Array) -> Scene:
    zero = scene.zero.copy()
    zero[:, joint] += error
    return replace(scene, zero=zero)


_MAKERS: dict[str, Unknown] = {
    "stick_scatter": _stick_scatter,
    "load_dependent_wave": _load_dependent_wave,
    "posture_coupling": _posture_coupling,
    "swaying_floor": _swaying_floor,
}
