"""Signatures selected by name: geometry, or any effect at a place."""

from __future__ import annotations

from collections.abc import Sequence

from compplan.effects import EFFECTS
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.errors import InputError, UnknownNameError

GEOMETRY = ("none", "offsets", "all")
#: Effects that are springs, selected by the names of the springs.
SPRINGS = ("joint_stiffness", "link_compliance")


def geometry_forms(at: Linearization, geometry: str) -> list[Signature]:
    """List the signatures of joint zeros ("offsets"), and of the origins of every joint but the first ("all").

    Raises:
        UnknownNameError: If the choice is unknown.
    """
    if geometry not in GEOMETRY:
        raise UnknownNameError("choice of geometry", geometry, list(GEOMETRY))
    found = [] if geometry == "none" else list(EFFECTS["joint_offset"].signatures(at))
    if geometry == "all":
        first = at.robot.joint_names[0]
        found += [s for s in EFFECTS["link_geometry"].signatures(at) if s.axis is not None and s.joint != first]
    return found


def effect_forms(at: Linearization, wanted: Sequence[str]) -> list[Signature]:
    """List the signatures of selected effects: "backlash", "backlash@joint_2", "joint_coupling@joint_5:FORM".

    Without a form the first one at a place is taken.

    Raises:
        UnknownNameError: If the effect is unknown, or the log cannot show it there.
        InputError: If it is a spring, which is selected by its name.
    """
    found: list[Signature] = []
    for text in wanted:
        name, _, rest = text.partition("@")
        joint, _, form = rest.partition(":")
        if name not in EFFECTS:
            raise UnknownNameError("effect", name, list(EFFECTS))
        if name in SPRINGS:
            raise InputError(f"effect {name!r} is a spring; select it by its name, such as --add joint_3.rx")
        offered = {(s.joint, s.axis, s.form): s for s in reversed(list(EFFECTS[name].signatures(at)))}
        matching = [s for s in offered.values() if joint in ("", s.joint) and form in ("", s.form)][::-1]
        if not matching:
            known = [f"{name}@{s.joint}:{s.form}".rstrip(":") if s.joint else name for s in offered.values()][::-1]
            raise UnknownNameError("effect that this log can show", text, known or ["none of its places"])
        taken = {column for form in found for column in form.column_names}
        for signature in matching:
            alike = any(signature.place == other.place for other in found)
            if not alike and not taken & set(signature.column_names):
                found.append(signature)
                taken |= set(signature.column_names)
    return found
