"""The installation: interpreter, libraries with their versions, and whether they do what compplan needs of them."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from typing import Literal

import numpy as np
from packaging.requirements import Requirement

from compplan.robot.folder import robot_folders
from compplan.version import VERSION

#: Oldest Python, as pyproject.toml states it.
OLDEST_PYTHON = (3, 11)


@dataclass(frozen=True)
class Remark:
    """One thing that was looked at.

    Attributes:
        state: "fine": as it should be; "note": worth knowing; "odd": likely a mistake, or it will limit results.
        about: What was looked at, in a word or two.
        sentence: What was seen, with its figure.
        advice: What to do about it; "" where there is nothing to do.
    """

    state: Literal["fine", "note", "odd"]
    about: str
    sentence: str
    advice: str = ""


def examine_installation() -> list[Remark]:
    """Look at interpreter, libraries and what ships with compplan."""
    return [*_look_at_platform(), *_look_at_libraries(), *_try_engines(), *_look_at_data()]


def _look_at_platform() -> Iterator[Remark]:
    version = platform.python_version()
    if sys.version_info < OLDEST_PYTHON:
        yield Remark("odd", "python", f"Python {version}, expected 3.11 or newer", "make a new environment")
    else:
        yield Remark("fine", "python", f"Python {version}, compplan {VERSION}")
    machine = f"{platform.system()} {platform.machine()}"
    if machine != "Linux x86_64":
        yield Remark("note", "platform", f"{machine}; compplan is tested on Linux x86_64 alone")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Remark("fine", "processor", f"{cores} cores for --workers of montecarlo")


def _look_at_libraries() -> Iterator[Remark]:
    """Hold the versions that are installed against those that compplan asks for."""
    try:
        wanted = [Requirement(text) for text in metadata.requires("compplan") or ()]
    except metadata.PackageNotFoundError:
        yield Remark("note", "libraries", "compplan is not installed, it runs from its source tree", "pip install .")
        return
    faults = []
    for requirement in wanted:
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            version = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            faults.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            faults.append(f"{requirement.name} {version}, expected {requirement.specifier}")
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


def _look_at_data() -> Iterator[Remark]:
    """Name the robots that ship, and the machines whose rotary words are read by name."""
    from compplan.toolpath.readers.options import list_machines

    if names := list(robot_folders()):
        yield Remark("fine", "robots", f"{len(names)} ship with compplan: {', '.join(names)}")
    else:
        yield Remark("odd", "robots", "no robot folders ship with this installation", "pip install . in the checkout")
    machines = ", ".join(list_machines())
    yield Remark("fine", "machines", f"[cam] machine takes {machines}, or NAME.toml beside the file")
