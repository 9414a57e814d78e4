"""The installation: interpreter, libraries with their versions, and whether they do what compplan needs of them."""

from __future__ import annotations

import importlib
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from typing import Literal

import numpy as np
from packaging.requirements import Requirement

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
    """Look at interpreter, libraries and engines."""
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, compplan {VERSION}"
    robots = f"{len(list(robot_folders()))} ship with compplan"
    return [
        Remark("fine", "python", python), *_look_at_libraries(), *_try_engines(), Remark("fine", "robots", robots),
    ]  # fmt: skip


def _look_at_libraries() -> Iterator[Remark]:
    """Hold the versions that are installed against those that compplan asks for."""
    try:
        wanted = [Requirement(text) for text in metadata.requires("compplan") or ()]
    except metadata.PackageNotFoundError:
        yield Remark("note", "libraries", "compplan is not installed, it runs from its source tree", "pip install .")
        return
    required = [one for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})]
    known = {one.name: next(iter(metadata.Distribution.discover(name=one.name)), None) for one in required}
    faults = [
        f"{one.name} is missing" if found is None else f"{one.name} {found.version}, expected {one.specifier}"
        for one in required
        if (found := known[one.name]) is None or not one.specifier.contains(found.version, prereleases=True)
    ]
    if faults:
        yield Remark("odd", "libraries", "; ".join(faults), "pip install . in the checkout mends it")
    else:
        yield Remark("fine", "libraries", "all required packages are installed in supported versions")


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
