"""The installation: interpreter, and whether the engines do what compplan needs of them."""

from __future__ import annotations

import importlib
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from compplan.robot.folder import robot_folders
from compplan.version import VERSION


@dataclass(frozen=True)
class Remark:
    """One thing that was looked at."""

    #: "fine": as it should be; "note": worth knowing; "odd": likely a mistake, or it will limit results.
    state: Literal["fine", "note", "odd"]
    about: str  #: What was looked at, in a word or two.
    sentence: str  #: What was seen, with its figure.
    advice: str = ""  #: What to do about it; "" where there is nothing to do.


def examine_installation() -> list[Remark]:
    """Look at interpreter and engines."""
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, compplan {VERSION}"
    robots = f"{len(list(robot_folders()))} ship with compplan"
    return [Remark("fine", "python", python), *_try_engines(), Remark("fine", "robots", robots)]


def _try_engines() -> Iterator[Remark]:
    """Let each engine solve something whose answer is known."""
    engines: dict[str, tuple[str, Callable[[], bool]]] = {
        "casadi": ("solver of the plans (IPOPT)", _try_ipopt),
        "pinocchio": ("independent check of the plans", _try_pinocchio),
        "eaik": ("inverse kinematics", lambda: importlib.import_module("eaik.IK_URDF") is not None),
    }
    for name, (purpose, attempt) in engines.items():
        try:
            works, why = attempt(), "a wrong answer"
        except Exception as error:  # whatever an engine ends with is the finding
            works, why = False, f"{type(error).__name__}: {error}"
        if works:
            yield Remark("fine", name, f"works ({purpose})")
        else:
            yield Remark("odd", name, f"does not work ({purpose}): {why}", f"pip install --force-reinstall {name}")


def _try_ipopt() -> bool:
    """Find the least (x - 2)^2: it is at 2."""
    casadi = importlib.import_module("casadi")
    x = casadi.SX.sym("x")
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    answer = casadi.nlpsol("trial", "ipopt", {"x": x, "f": (x - 2.0) ** 2}, quiet)(x0=0.0)
    return abs(float(answer["x"]) - 2.0) < 1e-6


def _try_pinocchio() -> bool:
    """Hold a pendulum of 1 kg at 1 m level: it needs 9.81 N m."""
    pin = importlib.import_module("pinocchio")
    model, zero = pin.Model(), np.zeros(1)
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "swing")
    bob = pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3)))
    model.appendBodyToJoint(joint, bob, pin.SE3.Identity())
    torque = pin.rnea(model, model.createData(), zero, zero, zero)
    return abs(abs(float(torque[0])) - 9.81) < 1e-6
