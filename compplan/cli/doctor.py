"""Checks of the installation, a robot folder or a measurement log."""

from __future__ import annotations

import importlib
import platform
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from compplan.controllers.writers.joint_convention import from_controller, load_controller, locate_links, locate_pendant
from compplan.diagnosis.data.plausibility import check_plausibility
from compplan.effects import robot_effects
from compplan.errors import InputError
from compplan.io.tables import read_table, read_text
from compplan.measurement.campaign import Campaign
from compplan.measurement.checks import list_notes
from compplan.measurement.reading import guess_name, log_columns, read_campaign, rename_title
from compplan.reporting.provenance import explain_grade
from compplan.robot import Array, Robot
from compplan.robot.folder import robot_folders
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis
from compplan.robot.rating import check_mass, read_rating, sum_arm_mass
from compplan.robot.shapes import describe_shapes, read_bodies
from compplan.statics.chain import build_chain
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import middle_of_limits
from compplan.uncertainty.assumed import REPEATABILITY
from compplan.version import VERSION

#: Plausible deflection of an arm in its softest direction under 1 kN (assumed; papers give 0.1 to 5 mm). [m]
STIFFEST, SOFTEST = 2e-5, 3e-2
#: Greatest velocity of industrial joints (assumed: the fastest small wrists turn 2,000 deg/s). [rad/s, m/s]
FASTEST, FASTEST_SLIDE = np.radians(2000.0), 10.0
#: Number of sampled poses.
POSES = 400
#: Angle between z of the TCP and the outward axis of the flange above which the TCP is reported. [deg]
ASIDE = 60.0
#: Poses below which a calibration of six joints has hardly more equations than unknowns (theory: about 30 parameters,
#: 3 coordinates a pose, half of them held out).
FEW_POSES = 20
#: Range of a joint below which its zero and stiffness are hardly observable (assumed). [rad]
NARROW = np.radians(15.0)
#: Optional columns of a log, and the information that is missing without them.
OPTIONAL = {
    "run": "run: all rows count as one run without a break",
    "fx": "a load: stiffness is found from weight alone",
    "rx": "an orientation: tool and wrist errors are harder to separate",
    "time": "a time: warm-up and lag cannot be found",
    "temperature": "a temperature: warm-up is taken as a function of time",
    "sigma_position": "sigma_mm: the instrument's noise is found from repeated poses",
}


@dataclass(frozen=True)
class Remark:
    """Result of one check."""

    #: "fine": as expected; "note": useful to know; "odd": probably a mistake or a limit; "do": for you to check.
    state: Literal["fine", "note", "odd", "do"]
    about: str  #: Subject of the check.
    sentence: str  #: Result, with its figure.
    advice: str = ""  #: Remedy, or "".


def examine_installation() -> list[Remark]:
    """Check that the solver solves a small problem and the other engines can be imported."""
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}, compplan {VERSION}"
    engines: dict[str, tuple[str, Callable[[], bool]]] = {
        "casadi": ("solver of the plans (IPOPT)", _try_ipopt),
        "pinocchio": ("independent check of the plans", lambda: bool(importlib.import_module("pinocchio"))),
        "eaik": ("inverse kinematics", lambda: bool(importlib.import_module("eaik.IK_URDF"))),
    }
    remarks = [Remark("fine", "python", python)]
    for name, (purpose, attempt) in engines.items():
        try:
            fault = "" if attempt() else "a wrong answer"
        except Exception as error:  # a broken engine may raise anything
            fault = f"{type(error).__name__}: {error}"
        advice = f"pip install --force-reinstall {name}"
        remarks.append(
            Remark("odd", name, f"does not work ({purpose}): {fault}", advice)
            if fault
            else Remark("fine", name, f"works ({purpose})")
        )
    return [*remarks, Remark("fine", "robots", f"{len(robot_folders())} ship with compplan")]


def _try_ipopt() -> bool:
    """Minimise (x - 2)^2."""
    casadi = importlib.import_module("casadi")
    x = casadi.SX.sym("x")
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    answer = casadi.nlpsol("trial", "ipopt", {"x": x, "f": (x - 2.0) ** 2}, quiet)(x0=0.0)
    return abs(float(answer["x"]) - 2.0) < 1e-6


def examine_robot(robot: Robot) -> list[Remark]:
    """Check a robot folder: sources, limits, masses, springs, controller, pendant and collision shapes."""
    rating, slides = read_rating(robot), int(robot.prismatic.sum())
    kinds = f"{robot.nq} joints" + (f", {slides} of them slide" if slides else "")
    size = f"reach not stated (links stretched: {robot.longest_reach:.2f} m)"
    if rating is not None:
        size = f"payload {rating.payload:g} kg, reach {rating.reach:.2f} m by the maker (SOURCE.md)"
    tool = f"tools leave along {name_axis(outward_axis(robot))} of {robot.flange!r}"
    remarks = [Remark("fine", "folder", f"{robot.name}: {kinds}; {size}; {tool}")]
    if robot.grade == "placeholder":
        remarks += [Remark("odd", "robot model", "placeholder: assumed stiffness", "measure it before you rely on it")]
    elif (known := explain_grade(robot)).endswith("not measured on your robot"):
        remarks += [Remark("note", "robot model", known, "measure it: compplan campaign JOB, then compplan diagnose")]
    for joint in robot.actuated:
        slide = joint.kind == "prismatic"
        if (FASTEST_SLIDE if slide else FASTEST) < joint.velocity < np.inf:
            text = f"{joint.name} moves at {joint.velocity:.3g} {'m/s' if slide else 'rad/s'}"
            remarks.append(Remark("odd", "limits", text, "is it in degrees or mm?"))
    example = "Payload 16 kg and reach 1611 mm, own weight 235 kg"
    sprung, effects = {spring.joint for spring in robot.springs}, robot_effects(robot)
    rigid, elastic = [joint.name for joint in robot.actuated if joint.name not in sprung], bool(sprung)
    counting = load_controller(robot)
    notes = {
        ("repeatability", f"repeatability_mm is missing in elasticity.toml: {1e3 * REPEATABILITY:g} mm is assumed",
         "enter the data sheet's value divided by 3.6"):
            robot.repeatability is None,
        ("limits", "some joints have no effort limit: their overload is not detected", ""):
            not np.isfinite(robot.effort_limits).all(),
        ("limits", "no acceleration_limits", "the planned feed in corners is too high"):
            not np.isfinite(robot.acceleration_limits).all(),
        ("rating", "payload, reach and own weight are not stated, so the masses cannot be checked",
         f"add to SOURCE.md a line such as {example!r}"): rating is None,
        ("gravity", "not in the model: deflections are relative to the arm under its own weight", ""):
            robot.gravity is None,
        ("springs", f"no spring at {', '.join(rigid)}: taken as rigid", ""): elastic and bool(rigid),
        ("tcp", "the TCP is the flange: no tool is mounted", "give [tool] in the job, or --tool"):
            robot.tcp == robot.flange,
        ("controller", f"{counting.unchecked}: signs and zeros of native programs are unknown",
         "compare two postures with the controller's display"): bool(counting.unchecked),
        ("effects", f"effects.toml adds {', '.join(effect.name for effect in effects)}", ""): bool(effects),
    }  # fmt: skip
    remarks += [Remark("note", *text) for text, applies in notes.items() if applies]
    return [*remarks, _check_masses(robot), _check_springs(robot), *check_pendant(robot), *_check_shapes(robot)]


def _check_masses(robot: Robot) -> Remark:
    mass = sum(body.mass for body in robot.bodies)
    if mass == 0.0:
        why = f" ({source})" if (source := robot.sources.get("masses", "")).startswith("left out") else ""
        return Remark("note", "masses", f"no link has a mass{why}: weight and inertia are left out")
    if fault := check_mass(sum_arm_mass(robot.joints[robot.carrying :], robot.bodies), read_rating(robot)):
        return Remark("odd", "masses", fault, "weight and inertia use them: correct robot.urdf")
    text = f"{mass:.0f} kg in {len(robot.bodies)} links"
    return Remark("fine", "masses", text) if read_rating(robot) else Remark("note", "masses", f"{text}, not checked")


def _check_springs(robot: Robot) -> Remark:
    """Check the deflection under 1 kN in the softest direction, at poses drawn within the limits."""
    if not robot.springs and not robot.link_elasticities:
        return Remark("odd", "springs", "none: the model is rigid and a plan corrects nothing", "identify or diagnose")
    half = np.minimum(np.nan_to_num((robot.upper - robot.lower) / 2.0, posinf=np.pi), np.pi)
    q = middle_of_limits(robot) + np.random.default_rng(0).uniform(-0.9, 0.9, (POSES, robot.nq)) * half
    worst = 1e3 * np.linalg.norm(cartesian_compliance(build_chain(robot), q)[:, :3, :3], ord=2, axis=(1, 2))
    low, high = float(np.min(worst)), float(np.median(worst))
    figures = f"{low * 1e3:.2g} mm at best, {high * 1e3:.2g} mm typically (median of {POSES} poses)"
    advice = "forgot e-6, or stiffness in place of compliance?" if high > SOFTEST else ""
    advice = "compliance in another unit (rad/(N m), m/N)?" if high < STIFFEST else advice
    return Remark("odd" if advice else "fine", "springs", f"1 kN at the TCP bends the arm by {figures}", advice)


def _check_shapes(robot: Robot) -> list[Remark]:
    bodies = read_bodies(robot)
    advice = "a job with [collision] refuses this robot: correct robot.urdf, or put its meshes into its folder meshes/"
    gaps = [Remark("odd", "collision", f"{body.link}: {body.gap}", advice) for body in bodies if body.gap]
    still = any(body.dropped and not body.moves for body in bodies)
    text = f"shapes of each link: {describe_shapes(bodies)}"
    return [*gaps, Remark("note" if gaps or still else "fine", "collision", text)]


def check_pendant(robot: Robot) -> Iterator[Remark]:
    """Yield remarks on the tool frame of the teach pendant, and on its check by jogging."""
    found, flange = locate_pendant(robot), robot.flange
    if found is None:
        advice = "write [pendant] with x and z in controller.toml, or give tools in the URDF's flange frame"
        yield Remark("note", "pendant", "the tool frame of the teach pendant is unknown", advice)
        return
    x, z = (name_axis(found.pose[:3, k]) for k in (0, 2))
    text = f"tool data of the teach pendant: x points along {x} and z along {z} of {flange!r} ({found.source})"
    if found.confirmed:
        yield Remark("fine", "pendant", text)
    else:
        why = "taken from the URDF" if not found.stated else "where x points is not confirmed"
        yield Remark("note", "pendant", f"{text}; {why}", "jog along +x of tool 0 before the first cut")
    yield Remark("do", "jog check", _describe_jog(robot, found.pose), "if it does not, correct the tool data")
    cosine = float(np.clip(mounted_tool(robot)[:3, 2] @ found.pose[:3, 2], -1.0, 1.0))
    if (angle := float(np.degrees(np.arccos(cosine)))) > ASIDE:
        text = f"z of {robot.tcp!r} points {angle:.3g} deg away from the flange's outward axis"
        yield Remark("odd", "tcp", text, "z of the TCP frame has to point out of the tool")


def _describe_jog(robot: Robot, pendant: Array) -> str:
    """Describe the motion of the flange when jogged along the axes of tool 0, with every axis at 0."""
    counting = load_controller(robot)
    zero = from_controller(counting, np.zeros((1, robot.nq)))[0]
    q = np.clip(zero, robot.lower, robot.upper)
    seen = counting.world[:3, :3].T @ (locate_links(robot, q[None])[robot.flange][0] @ pendant)[:3, :3]
    x, z = (name_axis(np.where(np.abs(seen[:, k]) < 1e-6, 0.0, seen[:, k])) for k in (0, 2))
    pose = "with every axis at 0" if np.allclose(q, zero) else "with every axis as near to 0 as its limits allow"
    return f"{pose}, tool 0 must jog along +x towards {x} and along +z towards {z} of the base frame"


def examine_log(file: Path, robot: Robot | None = None) -> list[Remark]:
    """Check a measurement log, and with the robot also its rows, poses and conventions.

    Raises:
        InputError: If it is not a log; for an export of another program the message lists titles without a unit.
    """
    try:
        table = read_table(file, log_columns(), unknown="note", rename=rename_title)
    except InputError as error:
        raise InputError(f"{error.message}{name_columns(file)}", file=error.file, where=error.where) from None
    if not len(table):
        raise table.error("the log has no rows, expected one row a measured pose")
    runs = len(set(table.text["run"].tolist())) if "run" in table else 1
    size = f"{len(table)} rows, {len(table.numbered('q#'))} joints, {runs} run{'s' if runs > 1 else ''}"
    remarks = [Remark("fine", "log", size)]
    remarks += [Remark("odd", "column", note, "units belong in the name: x_mm, q1_deg, fx_N") for note in table.notes]
    remarks += [
        Remark("note", "column", f"no column with {lost}") for key, lost in OPTIONAL.items() if key not in table
    ]
    readings = [key for key in ("x", "y", "z", "reading", "distance") if key in table]
    if readings and not any(np.isfinite(table.values[key]).any() for key in readings):
        titles = " ".join(table.headers[key] for key in readings)
        text = f"{titles} {'are' if len(readings) > 1 else 'is'} empty in all {len(table)} rows"
        remarks.append(Remark("odd", "readings", text, "enter what was measured"))
    if {"contact", "reading", "distance"} & {*table.text, *table.values}:
        text = "contacts, readings or distances: give the instrument by --instrument"
        remarks.append(Remark("fine", "instrument", text))
    if robot is None:
        return [*remarks, Remark("note", "robot", "not given: signs, units and frames were not checked", "--robot")]
    campaign = read_campaign(file, robot)
    remarks += [Remark("odd", "rows", note) for note in list_notes(campaign.notes)]
    beyond = ((campaign.q < robot.lower - 1e-9) | (campaign.q > robot.upper + 1e-9)).any(axis=1)
    if beyond.any():
        text = f"{int(beyond.sum())} rows are beyond the joint limits of the folder"
        remarks.append(Remark("odd", "rows", text, "is it this robot, and are signs and zeros the folder's?"))
    questions = [Remark("odd", question.about, question.sentence) for question in check_plausibility(robot, campaign)]
    agree = Remark("fine", "conventions", "units, frames, signs, point of the wrench and clock agree with the robot")
    return [*remarks, *_check_poses(campaign, robot), *(questions or [agree])]


def name_columns(file: Path) -> str:
    """Return suggested log column names for the columns of an export that lack a unit; "" if there are none."""
    head = read_text(file).splitlines()[:1]
    titles = [] if not head else [title.strip().strip('"') for title in re.split("[,;\t]", head[0])]
    found = [f"{title!r} {name}" for title in titles if (name := guess_name(title)) is not None]
    return f"; rename columns: {', '.join(found)} (add the unit)" if found else ""


def _check_poses(campaign: Campaign, robot: Robot) -> Iterator[Remark]:
    still = ~campaign.on_path
    if still.any():
        poses = len(np.unique(campaign.pose[still]))
        few = poses < FEW_POSES
        advice = f"{FEW_POSES} and more separate causes" if few else ""
        yield Remark("odd" if few else "fine", "poses", f"{poses} different poses", advice)
        visits = np.unique(np.column_stack([campaign.pose, campaign.stay]), axis=0)[:, 0]
        repeated = int((np.unique(visits, return_counts=True)[1] > 1).sum())
        if repeated:
            yield Remark("fine", "repeats", f"{repeated} poses are repeated")
        else:
            yield Remark("note", "repeats", "no pose is repeated after another one", "repeat five: they show the noise")
    for joint, span in zip(robot.actuated, np.ptp(np.nan_to_num(campaign.q), axis=0), strict=True):
        if joint.kind != "prismatic" and span < NARROW:
            text = (
                f"{joint.name} moves over {np.degrees(span):.1f} deg only: its zero and stiffness are hardly observable"
            )
            yield Remark("odd", "poses", text)
