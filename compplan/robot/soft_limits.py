"""Soft limits of a URDF: limits of the joint controllers within the mechanical ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from compplan.errors import InputError
from compplan.io.parsing import GREATEST
from compplan.io.tables import is_plain
from compplan.robot.model import Robot

#: Attributes of <safety_controller> by limit.
SOFT = {"lower": "soft_lower_limit", "upper": "soft_upper_limit"}


def read_soft_limits(element: ElementTree.Element, file: Path) -> dict[str, float]:
    """Read the soft limits of a joint; equal ones (left out, both are zero) are ignored.

    Args:
        element: The <joint>.
        file: Its file, for messages.

    Raises:
        InputError: If one is not finite, or the lower one is above the upper one.

    """
    controller = element.find("safety_controller")
    if controller is None or not set(SOFT.values()) <= set(controller.keys()):
        return {}
    soft, where = {}, f"joint {element.get('name')!r}"
    for end, key in SOFT.items():
        text = controller.get(key, "")
        try:
            soft[end] = float(text) if is_plain(text) else np.nan
        except ValueError:
            soft[end] = np.nan
        if not abs(soft[end]) <= GREATEST:
            message = f"{key} is {text!r}, expected a finite number up to {GREATEST:g}"
            raise InputError(message, file=file, where=where)
    if soft["lower"] > soft["upper"]:
        message = f"soft_lower_limit {soft['lower']:g} is above soft_upper_limit {soft['upper']:g}"
        raise InputError(message, file=file, where=where)
    return soft if soft["lower"] < soft["upper"] else {}


def narrow_limits(limits: Mapping[str, float], element: ElementTree.Element, file: Path) -> dict[str, float]:
    """Narrow the limits of a joint by its soft limits; a joint without limits keeps none.

    Args:
        limits: Its limits by name: lower, upper [rad or m], and others.
        element: The <joint>.
        file: Its file, for messages.

    Raises:
        InputError: If the soft limits are invalid, or leave no range.

    """
    soft = read_soft_limits(element, file)
    if not soft or "lower" not in limits:
        return dict(limits)
    lower, upper = max(limits["lower"], soft["lower"]), min(limits["upper"], soft["upper"])
    if lower >= upper:
        message = (
            f"soft limits {soft['lower']:g} to {soft['upper']:g} leave no room within the limits "
            f"{limits['lower']:g} to {limits['upper']:g}"
        )
        raise InputError(message, file=file, where=f"joint {element.get('name')!r}")
    return {**limits, "lower": lower, "upper": upper}


def describe_soft_limits(robot: Robot) -> str:
    """Describe the limits that soft limits narrow; "" without any."""
    by_name = {joint.name: joint for joint in robot.actuated}
    narrowed = []
    for element in ElementTree.fromstring(robot.urdf).findall("joint"):
        joint, limit = by_name.get(element.get("name", "")), element.find("limit")
        if joint is None or limit is None or limit.get("lower") is None or joint.lower == joint.upper:
            continue  # a joint without range is held by the job
        if float(limit.get("lower", "0")) < joint.lower or float(limit.get("upper", "0")) > joint.upper:
            factor, unit = (1e3, "mm") if joint.kind == "prismatic" else (180.0 / np.pi, "deg")
            narrowed.append(f"{joint.name} to {factor * joint.lower:.4g} .. {factor * joint.upper:.4g} {unit}")
    return f"soft limits of the URDF (<safety_controller>) narrow {', '.join(narrowed)}" if narrowed else ""
