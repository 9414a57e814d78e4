"""transmission_error: an error periodic in a joint's angle, or a bump at one angle.

A gear error is a wave or a wave with overtones; several waves of different periods fit any error that follows the
joint's angle. A bell curve around one angle and a cubic B-spline, zero beyond its knots, are read from a folder and
never fitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline

from compplan.effects.backlash import list_plays
from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames
from compplan.toolpath.toolpath import select_even

name = "transmission_error"
words = "{at} has an error periodic in its angle"
follows = "joint angle"
#: Assumed: a tenth of a milliradian at the link.
SCALE = {"revolute": 1e-4, "prismatic": 1e-4}
HARMONICS = 4
#: Amplitudes of overtones over the fundamental (assumed), and the periods of waves with overtones that every joint
#: has, in cycles per turn (assumed).
OVERTONES = (1.0, 0.5, 1.0 / 3.0)
SERIES = (1.0, 2.0)
#: Number of postures for the mean levers of joints; least and greatest weight of a joint relative to the mean.
LOOKED_AT, LEAST, MOST = 100, 0.1, 10.0
#: Amplitude of the gear error of a joint, and lost motion if none is stated (assumed) [rad]; gear periods per turn.
GEAR_ERROR, GEAR_PERIODS = float(np.radians(0.002)), 60.0


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return the first harmonics of every joint: each, the first two, all of them, and two with overtones.

    See `waves_at` and `series_at` for others.
    """
    for index, joint in enumerate(at.robot.actuated):
        spread = float(np.ptp(at.campaign.q[:, index]))
        if spread < 0.1:
            continue
        unit = 1.0 if joint.kind == "revolute" else 1.0 / (2.0 * max(spread, 0.1))
        cycles = [unit * harmonic for harmonic in range(1, HARMONICS + 1)]
        for some in (*([cycle] for cycle in cycles), cycles[:2], cycles):
            yield waves_at(at, index, some)
        for harmonic in SERIES:
            if periods_seen(unit * harmonic, spread, joint.kind == "prismatic") >= 1.0:
                yield series_at(at, index, unit * harmonic)


def waves(angle: Array, cycles: Sequence[float], slides: bool) -> Array:
    """Return sine and cosine of every wave, side by side. Shape (n, 2 k)."""
    phase = angle[:, None] * np.asarray(cycles) * (2 * np.pi if slides else 1.0)
    return np.stack([np.sin(phase), np.cos(phase)], axis=-1).reshape(len(angle), -1)


def waves_at(at: Linearization, index: int, cycles: Sequence[float], tried: int = 1) -> Signature:
    """Return waves of given cycles per turn (per metre of a slide), chosen from `tried` alternatives."""
    joint = at.robot.actuated[index]
    slides = joint.kind == "prismatic"
    unit = "m" if slides else "rad"
    keys = tuple(f"{part}_{unit}#{k}" for k in range(len(cycles)) for part in ("sine", "cosine"))
    shape = waves(np.nan_to_num(at.campaign.q[:, index]), cycles, slides)
    fixed = {"cycles_per_m" if slides else "cycles_per_turn": [float(c) for c in cycles]}
    label = "waves " + " ".join(f"{c:.4g}" for c in cycles)
    columns = tuple(f"{cycle:.6g} {part}" for cycle in cycles for part in ("sine", "cosine"))
    twist, encoder = at.joint_response(index, shape * ~at.campaign.link_controlled[:, None])
    scale = np.full(len(keys), SCALE[joint.kind])
    return Signature(
        name, joint.name, None, label, keys, scale, twist, encoder, fixed, tried=tried, columns=columns
    )  # fmt: skip


def periods_seen(cycles: float | Array, spread: float, slides: bool) -> Array:
    """Return the number of periods of a wave in the visited range."""
    return np.asarray(cycles) * spread * (1.0 if slides else 0.5 / np.pi)


def series_at(at: Linearization, index: int, cycle: float, tried: int = 1) -> Signature:
    """Return a wave with its first three harmonics, chosen from `tried` periods."""
    plain = waves_at(at, index, [cycle * (k + 1) for k in range(len(OVERTONES))], tried)
    columns = tuple(f"series {cycle:.6g} {k} {part}" for k in range(len(OVERTONES)) for part in ("sine", "cosine"))
    scale = plain.scale * np.repeat(OVERTONES, 2)
    return replace(plain, form=f"series {cycle:.4g}", scale=scale, columns=columns)


def spline_basis(angle: Array, knots: Array) -> Array:
    """Return cubic B-splines on the knots, zero beyond them. Shape (n, knots - 4)."""
    basis = BSpline.design_matrix(np.clip(angle, knots[3], np.nextafter(knots[-4], -np.inf)), knots, 3).toarray()
    return np.asarray(np.where((angle[:, None] >= knots[3]) & (angle[:, None] <= knots[-4]), basis, 0.0))


def error_at(effect: Effect, angle: Array) -> Array:
    """Return the transmission error at given positions of the joint. Shape (n,). [rad or m]."""
    values, total = effect.parameters, np.zeros(len(angle))
    for unit, cycles in (("rad", "cycles_per_turn"), ("m", "cycles_per_m")):
        if cycles in values:
            shape = waves(angle, values[cycles], unit == "m")
            weights = np.column_stack([values[f"sine_{unit}"], values[f"cosine_{unit}"]]).reshape(-1)
            total = total + shape @ weights
        for k, height in enumerate(values.get(f"height_{unit}", [])):
            away = (angle - values[f"centre_{unit}"][k]) / values[f"width_{unit}"][k]
            total = total + float(height) * np.exp(-0.5 * away**2)
        if f"spline_{unit}" in values:
            shape = spline_basis(angle, np.array(values[f"knots_{unit}"], float))
            total = total + shape @ np.array(values[f"spline_{unit}"], float)
    return total


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the error between motor and link."""
    index = model.joint_index(effect.joint)
    return model.add_to_joint("drive", index, error_at(effect, np.nan_to_num(model.campaign.q[:, index])))


def weigh_joints(chain: Chain, q: Array, robot: Robot) -> Array:
    """Compute weights of joints from the error of their motion at the tip.

    A joint of lever r turns with a gear error of amplitude a and n periods per turn, and with lost motion b. Over a
    period of the gear the tip is off by r a / sqrt(2) and r b / 2, so that a radian costs

        w = r^2 [ (a n)^2 / 2 + (b n / (4 pi))^2 ]

    with the lost motion of the folder if stated, otherwise an assumed one; relative to the mean. Shape (nq,).
    """
    some = select_even(q, LOOKED_AT)
    columns = joint_jacobian(chain, locate_frames(chain, some))[:, :3]
    lever = np.einsum("nij,nij->j", columns, columns) / len(some)
    stated = list_plays(robot)
    width = np.where(stated > 0.0, stated, GEAR_ERROR)
    cost = lever * (0.5 * (GEAR_ERROR * GEAR_PERIODS) ** 2 + (width * GEAR_PERIODS / (4.0 * np.pi)) ** 2)
    return np.clip(cost / max(float(cost.mean()), 1e-300), LEAST, MOST)
