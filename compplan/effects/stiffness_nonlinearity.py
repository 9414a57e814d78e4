"""stiffness_nonlinearity: a joint's deflection is not proportional to its torque (hardening, softening, soft zone)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel, Law
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array

name = "stiffness_nonlinearity"
words = "the deflection of {at} is not proportional to its torque"
follows = "load"
#: Assumed: the deflection at a large load changes by a third.
SCALE = 0.3
#: Widths of soft zones, as shares of a large load.
ZONES = (0.05, 0.12, 0.25, 0.5)
LINEAR, QUADRATIC, CUBIC, SOFT, BENT = (
    "linear_ratio", "quadratic_ratio", "cubic_ratio", "soft_zone_ratio", "saturating_ratio",
)  # fmt: skip
#: Lower bounds that keep the deflection monotonic, from the steepest slopes 1, 2, 3, 1 and 9/8 of the shapes, with a
#: tenth of the modelled compliance kept (assumed).
LEAST = {LINEAR: -0.9, QUADRATIC: -0.45, CUBIC: -0.3, SOFT: -0.9, BENT: -0.8}
FORMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("quadratic", (QUADRATIC,)),
    ("cubic", (CUBIC,)),
    ("linear+quadratic", (LINEAR, QUADRATIC)),
    ("linear+cubic", (LINEAR, CUBIC)),
)


def shapes(load: Array, reference: float, zone: float) -> dict[str, Array]:
    """Return the odd shapes of the deflection, in units of load.

    linear t, quadratic t |t|/t_ref, cubic t^3/t_ref^2, soft zone clip(t, -z, z), saturating t u/(1 + u) with u =
    (t/z)^2.
    """
    u = (load / zone) ** 2 if zone > 0 else np.zeros_like(load)
    return {
        LINEAR: load,
        QUADRATIC: load * np.abs(load) / reference,
        CUBIC: load**3 / reference**2,
        SOFT: np.clip(load, -zone, zone),
        BENT: load * u / (1.0 + u),
    }


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every sprung joint in several shapes, with and without a change of the linear part."""
    motor_side = ~at.campaign.link_controlled
    for index, spring in at.own.items():
        load = at.own_load[:, index]
        # two digits, so that it is constant during a fit
        reference = float(f"{np.percentile(np.abs(load), 98):.1e}")
        if spring.compliance <= 0 or reference <= 1e-6:
            continue
        joint = at.robot.actuated[index].name
        forms: list[tuple[str, tuple[str, ...], float]] = [(form, keys, 0.0) for form, keys in FORMS]
        for share in ZONES:
            for key in (SOFT, BENT):
                forms += [
                    (f"{key} {share}", (key,), share * reference),
                    (f"linear+{key} {share}", (LINEAR, key), share * reference),
                ]
        for form, keys, zone in forms:
            parts = shapes(load, reference, zone)
            bent = spring.compliance * np.stack([parts[key] * motor_side for key in keys], axis=-1)
            twist, encoder = at.joint_response(index, bent, spring=True)
            fixed = {"compliance": spring.compliance, "reference_load": reference, "zone_load": zone}
            scale = np.array([SCALE * (reference / zone if key == SOFT else 1.0) for key in keys])
            columns = tuple(f"{key} {zone if key in (SOFT, BENT) else 0.0:.6g}" for key in keys)
            least = tuple(LEAST[key] for key in keys)
            yield Signature(name, joint, None, form, keys, scale, twist, encoder, fixed, least=least, columns=columns)


def linear_in_disguise(keys: Iterable[str]) -> bool:
    """Return whether a form contains a straight line, or tends to one for a small zone."""
    return LINEAR in keys or BENT in keys


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the deflection beyond the linear one."""
    values = effect.parameters
    ratios = {key: float(values[key]) for key in (LINEAR, QUADRATIC, CUBIC, SOFT, BENT) if key in values}
    compliance, reference, zone = (float(values[key]) for key in ("compliance", "reference_load", "zone_load"))

    def law(load: Array) -> Array:
        parts = shapes(load, reference, zone)
        return np.asarray(compliance * sum((ratio * parts[key] for key, ratio in ratios.items()), np.zeros_like(load)))

    laws: tuple[tuple[int, Law], ...] = (*model.laws, (model.joint_index(effect.joint), law))
    return replace(model, laws=laws)
