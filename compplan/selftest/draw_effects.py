"""Draw effects of the vocabulary for the virtual cell: place, form and shape; a gap that is wanted gives the size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compplan.effects import EFFECTS, Effect
from compplan.effects.frame_shift import shift_at as frame_shift_at
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature, pack_parameters
from compplan.effects.tool_shift import shift_at as tool_shift_at
from compplan.effects.transmission_error import waves_at
from compplan.robot import Array

VOCABULARY = tuple(EFFECTS)
#: Effects that show on paths alone, under loads alone; and those that have a size of their own.
NEEDS_PATH = ("tracking_lag", "time_skew")
NEEDS_LOAD = ("link_compliance", "base_compliance", "stiffness_nonlinearity", "wrench_bias", "wrench_scale")
UNSCALED = ("gravity_sag", "joint_coupling")
#: No parameter is larger than so many of its prior scales: a robot in service would not be run with it (assumed).
LARGEST = 8.0
#: A joint is at most so much stiffer or softer than its model, relative change of the compliance (assumed).
STIFFER, SOFTER = 0.6, 2.0
#: Joints that balancers sit at, counted among the turning ones (assumed).
BALANCED = (1, 2)


@dataclass(frozen=True)
class Drawn:
    """An effect of given shape whose size can be changed.

    Attributes:
        name: Name in the vocabulary.
        joint: Its joint, or None.
        axis: Its axis, or None.
        keys: Parameters that grow with the size.
        values: Their values at size one.
        fixed: Parameters that stay.
        most: Largest size.
    """

    name: str
    joint: str | None
    axis: str | None
    keys: tuple[str, ...]
    values: Array
    fixed: Mapping[str, Any]
    most: float

    def effect(self, size: float) -> Effect:
        """Return the effect at a size."""
        return Effect(self.name, self.joint, self.axis, pack_parameters(self.keys, size * self.values, self.fixed))


def draw_effect(random: np.random.Generator, name: str, at: Linearization, time_constant: float) -> Drawn:
    """Draw an effect that a campaign could show, at the scale of its prior.

    Args:
        random: Source of randomness.
        name: Name in the vocabulary.
        at: Linearization of the nominal robot at the campaign.
        time_constant: Time constant of the warm-up. [s]

    Raises:
        LookupError: If this campaign cannot show it.
    """
    if name == "joint_coupling":
        return _draw_coupling(random, at)
    offered = _MAKERS[name](random, at) if name in _MAKERS else list(EFFECTS[name].signatures(at))
    offered = [s for s in offered if _wanted(s)]
    if name == "gravity_compensator":
        turning = [joint.name for joint in at.robot.actuated if joint.kind == "revolute"]
        offered = [s for s in offered if s.joint in [turning[k] for k in BALANCED]]
    if not offered:
        raise LookupError(f"{name} does not show in this campaign")
    places = list(dict.fromkeys(s.place for s in offered))
    place = places[int(random.integers(len(places)))]
    forms = [s for s in offered if s.place == place]
    signature = forms[int(random.integers(len(forms)))]
    values = signature.scale * (np.ones(1) if len(signature.scale) == 1 else random.normal(size=len(signature.scale)))
    if not signature.positive and random.random() < 0.5:
        values = -values
    if name == "payload":
        values[1:] *= 0.2
    fixed = dict(signature.fixed)
    if "time_constant_s" in fixed:
        fixed["time_constant_s"] = time_constant
    most = LARGEST * float(np.min(signature.scale / np.maximum(np.abs(values), 1e-30)))
    if name == "joint_stiffness" and (index := at.robot.joint_names.index(str(signature.joint))) in at.own:
        nominal = at.own[index].compliance
        most = (SOFTER if values[0] > 0 else STIFFER) * nominal / abs(float(values[0])) if nominal > 0 else most
    return Drawn(name, signature.joint, signature.axis, signature.keys, values, fixed, most)


def draw_background(random: np.random.Generator, at: Linearization, time_constant: float) -> list[Drawn]:
    """Draw a robot that is slightly wrong everywhere; one common size is yet to be found."""
    found: list[Drawn] = []
    for name, spread in (
        ("joint_offset", 0.03), ("joint_stiffness", 0.3), ("link_geometry", 0.06), ("backlash", 0.08),
        ("transmission_error", 0.15), ("thermal_drift", 0.3),
    ):  # fmt: skip
        places: dict[Any, list[Signature]] = {}
        for signature in EFFECTS[name].signatures(at):
            if _wanted(signature) and not (name == "link_geometry" and str(signature.axis)[0] != "t"):
                places.setdefault(signature.place, []).append(signature)
        for forms in places.values():
            signature = forms[int(random.integers(len(forms)))]
            values = spread * signature.scale * random.normal(size=len(signature.scale))
            values = np.abs(values) if signature.positive else values
            fixed = dict(signature.fixed)
            if "time_constant_s" in fixed:
                fixed["time_constant_s"] = time_constant
            found.append(Drawn(name, signature.joint, signature.axis, signature.keys, values, fixed, np.inf))
    bending = list(EFFECTS["link_compliance"].signatures(at))
    for k in random.permutation(len(bending))[:3]:
        signature = bending[k]
        values = 0.05 * signature.scale * random.uniform(0.2, 1.0)
        found.append(Drawn(signature.name, signature.joint, signature.axis, signature.keys, values, {}, np.inf))
    return found


def _wanted(signature: Signature) -> bool:
    """Keep simple forms: one law of a spring, one axis of a link, growth of all links alike, a skew of positions."""
    if signature.name == "stiffness_nonlinearity":
        return not signature.form.startswith("linear")
    if signature.name == "link_geometry":
        return signature.axis is not None
    if signature.name == "gravity_compensator":
        return signature.form == "sine+constant"
    if signature.name == "thermal_drift":
        return signature.form.startswith("alike") and signature.form in ("alike", "alike 3000 s")
    if signature.name == "transmission_error":
        return signature.form in ("waves 1", "waves 2") or signature.tried > 1
    if signature.name == "time_skew":
        return signature.form == "skew"
    return True


def _draw_shift(random: np.random.Generator, at: Linearization, kind: Callable[..., Any]) -> list[Signature]:
    stays = np.flatnonzero(np.diff(at.campaign.stay, prepend=-1) > 0)
    static = stays[~at.campaign.on_path[stays]]
    inner = static[int(0.2 * len(static)) : max(int(0.8 * len(static)), 1)]
    return list(kind(at, int(random.choice(inner))))


def _draw_waves(random: np.random.Generator, at: Linearization) -> list[Signature]:
    """Offer one or two cycles a turn, and in one of four cases a gear's 8 to 30."""
    found = [s for s in EFFECTS["transmission_error"].signatures(at) if s.joint is not None]
    if random.random() < 0.25:
        revolute = [k for k, joint in enumerate(at.robot.actuated) if joint.kind == "revolute"]
        cycles = [float(random.integers(8, 31))]
        return [waves_at(at, int(random.choice(revolute)), cycles, tried=2)]
    return found


def _draw_coupling(random: np.random.Generator, at: Linearization) -> Drawn:
    """Draw a share of another joint, a reversed joint or a shifted zero; whole conventions at the wrist alone."""
    joints = [joint.name for joint in at.robot.actuated if joint.kind == "revolute"]
    kind = random.random()
    if kind < 0.6:
        pairs = [(2, 1), (4, 3), (5, 4), (5, 3)]
        first, second = pairs[int(random.integers(len(pairs)))]
        ratio = float(random.choice([1.0, -1.0, 0.5, 0.0125, -0.02, 0.04]))
        fixed: dict[str, Any] = {"other": joints[second], "ratio": ratio}
        return Drawn("joint_coupling", joints[first], None, (), np.zeros(0), fixed, 1.0)
    joint = str(random.choice(joints[3:]))
    fixed = {"reversed": True} if kind < 0.8 else {"zero_rad": float(random.choice([0.5, -0.5, 1.0]) * np.pi)}
    return Drawn("joint_coupling", joint, None, (), np.zeros(0), fixed, 1.0)


_MAKERS: dict[str, Callable[[np.random.Generator, Linearization], list[Signature]]] = {
    "frame_shift": lambda random, at: _draw_shift(random, at, frame_shift_at),
    "tool_shift": lambda random, at: _draw_shift(random, at, tool_shift_at),
    "transmission_error": _draw_waves,
}


def whole(drawn: Drawn) -> Drawn:
    """Return a drawn effect of gravity that is there as a whole, not in part."""
    return replace(drawn, values=np.array([9.81]), most=1.0)
