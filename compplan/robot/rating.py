"""Estimates from payload, reach and mass of an arm: initial springs, plausibility of masses."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compplan.robot.model import Array, Body, Joint, Robot

#: Twist of each joint under the moment of the payload at full reach: geometric means of three measured arms
#: (docs/robots.md, checked by tests/robot/test_robot_library.py); wrist below LIGHT: Fanuc M-10iA (Singh 2021). [rad]
TWIST = np.array([2.0, 1.5, 1.9, 19.0, 31.0, 14.0]) * 1e-3
TWIST_LIGHT = np.array([2.0, 1.5, 1.9, 7.7, 3.6, 4.6]) * 1e-3
#: Payload below which the light wrist is used, and the class of the measured arms. [kg, m]
LIGHT, CLASS_PAYLOAD, CLASS_REACH = 50.0, 80.0, (2.0, 3.6)
#: Mass of the heaviest shipped arm, rounded up. [kg]
HEAVIEST = 2550.0
#: Greatest relative difference of the URDF masses from a stated mass of the arm (assumed).
DIFFERENCE = 0.3
#: Pattern of the line of SOURCE.md.
STATED = re.compile(r"Payload ([\d.]+) kg and reach ([\d.]+) mm(?:, own weight ([\d.]+) kg)?")


@dataclass(frozen=True)
class Rating:
    """Ratings of an arm by its maker."""

    payload: float  #: Rated payload. [kg]
    reach: float  #: Reach. [m]
    mass: float | None = None  #: Mass of the arm, or None. [kg]

    @property
    def text(self) -> str:
        """The line of SOURCE.md."""
        own = "" if self.mass is None else f", own weight {self.mass:g} kg"
        return f"Payload {self.payload:g} kg and reach {round(1e3 * self.reach, 3):g} mm{own}"

    @property
    def grade(self) -> str:
        """Grade of springs by the rule: "scaled" in the class of the measured arms, otherwise "placeholder"."""
        low, high = CLASS_REACH
        return "scaled" if self.payload >= CLASS_PAYLOAD and low <= self.reach <= high else "placeholder"

    def estimate_compliances(self) -> Array:
        """Return the compliance of six joints by the rule of docs/robots.md. Shape (6,). [rad/(N m)]"""
        twist = TWIST_LIGHT if self.payload < LIGHT else TWIST
        return np.asarray(twist / (self.payload * 9.81 * self.reach))


def read_rating(robot: Robot) -> Rating | None:
    """Return the ratings in SOURCE.md of the robot's folder, or None."""
    source = None if robot.folder is None else robot.folder / "SOURCE.md"
    if source is None or not source.is_file():
        return None
    found = STATED.search(source.read_text(encoding="utf-8"))
    if found is None:
        return None
    own = None if found[3] is None else float(found[3])
    return Rating(float(found[1]), 1e-3 * float(found[2]), own)


def sum_arm_mass(joints: Sequence[Joint], bodies: Sequence[Body]) -> float:
    """Return the mass of an arm without the base of its rail. [kg]

    Args:
        joints: The chain from the base.
        bodies: The bodies of its links.
    """
    first = next((k for k, joint in enumerate(joints) if joint.kind == "revolute"), 0)
    slides = [k for k in range(first) if joints[k].kind == "prismatic"]
    below = {joints[0].parent, *(joint.child for joint in joints[: slides[-1]])} if slides else set()
    return float(sum(body.mass for body in bodies if body.link not in below))


def check_mass(mass: float, rating: Rating | None) -> str:
    """Return why the mass of an arm is implausible, or "".

    A stated mass is the reference; without it, the limit is the mass of the heaviest shipped arm.

    Args:
        mass: Mass of the arm, see `sum_arm_mass`. [kg]
        rating: Ratings of the maker, or None.
    """
    if rating is not None and rating.mass is not None:
        if abs(mass - rating.mass) <= DIFFERENCE * rating.mass:
            return ""
        return f"{mass:.0f} kg in all, {rating.mass:g} kg is stated as own weight"
    return "" if mass <= HEAVIEST else f"{mass:.0f} kg in all, more than any shipped arm weighs ({HEAVIEST:.0f} kg)"
