"""A robot folder: what it does not say, what its numbers come to, and how the teach pendant counts tools on it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from compplan.cli.doctor.installation import Remark
from compplan.controllers.writers.joint_convention import from_controller, load_controller, locate_link, locate_pendant
from compplan.effects import robot_effects
from compplan.robot import Array, Robot
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis
from compplan.robot.rating import check_mass, read_rating, sum_arm_mass
from compplan.robot.shapes import describe_shapes, read_bodies
from compplan.statics.chain import build_chain
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import middle_of_limits

#: Softest-direction deflection under 1 kN that industrial arms of 3 kg to 1000 kg payload show, with room (assumed;
#: papers give .1 to 5 mm). [m]
STIFFEST, SOFTEST = 2e-5, 3e-2
#: Joints that turn less are tools or grippers (assumed). [rad]
LITTLE = np.radians(20.0)
#: Greatest velocities of industrial joints (assumed: the fastest small wrists turn 2,000 deg/s). [rad/s, m/s]
FASTEST, FASTEST_SLIDE = np.radians(2000.0), 10.0
#: Poses that are sampled.
POSES = 400
#: Angle between the TCP's z and the flange's outward axis from which on the folder's own tool is asked about. [deg]
ASIDE = 60.0


def examine_robot(robot: Robot) -> list[Remark]:
    """Look at a robot folder that could be read."""
    findings = [_describe(robot), *_look_at_sources(robot), *_look_at_limits(robot), *_look_at_weights(robot)]
    findings += [*_look_at_springs(robot), *_look_at_geometry(robot), *_look_at_controller(robot)]
    return [*findings, *check_pendant(robot), *_look_at_shapes(robot)]


def _describe(robot: Robot) -> Remark:
    slides = int(robot.prismatic.sum())
    kinds = f"{robot.nq} joints" + (f", {slides} of them slide" if slides else "")
    rating = read_rating(robot)
    if rating is None:
        size = f"reach not stated; the links add up to {robot.longest_reach:.2f} m, more than it reaches"
    else:
        size = f"payload {rating.payload:g} kg, reach {rating.reach:.2f} m by the maker (SOURCE.md)"
    tool = f"tools leave along {name_axis(outward_axis(robot))} of {robot.flange!r}"
    return Remark("fine", "folder", f"{robot.name}: {kinds}; {size}; {tool}")


def _look_at_sources(robot: Robot) -> Iterator[Remark]:
    if robot.grade == "placeholder":
        yield Remark("odd", "robot model", "placeholder: do not rely on how it bends", "identify your robot")
    elif robot.grade != "identified":
        yield Remark("note", "robot model", f"{robot.grade}: not measured on your robot", "identify it first")
    if robot.repeatability is None:
        yield Remark("note", "repeatability", "repeatability_mm is not stated", "the data sheet's value / 3.6 will do")


def _look_at_limits(robot: Robot) -> Iterator[Remark]:
    for joint in robot.actuated:
        slide = joint.kind == "prismatic"
        turn, fastest = joint.upper - joint.lower, FASTEST_SLIDE if slide else FASTEST
        if not np.isfinite(turn):
            yield Remark("note", "limits", f"{joint.name} turns without limits")
        elif not slide and turn < LITTLE:
            yield Remark("odd", "limits", f"{joint.name} turns {np.degrees(turn):.1f} deg only", "is it in degrees?")
        if not np.isfinite(joint.velocity):
            yield Remark("odd", "limits", f"{joint.name} has no velocity limit", "timing needs one")
        elif joint.velocity > fastest:
            text = f"{joint.velocity:.3g} {'m/s' if slide else 'rad/s'}"
            yield Remark("odd", "limits", f"{joint.name} moves at {text}", "is it in degrees or mm?")
    if not np.isfinite(robot.effort_limits).all():
        yield Remark("note", "limits", "some joints have no effort limit: overload is not seen")
    if not np.isfinite(robot.acceleration_limits).all():
        yield Remark("note", "limits", "no acceleration_limits", "feed in corners will be too high")


def _look_at_weights(robot: Robot) -> Iterator[Remark]:
    rating = read_rating(robot)
    if rating is None:
        line = "Payload 16 kg and reach 1611 mm, own weight 235 kg"
        yield Remark("note", "rating", "payload, reach and own weight are not stated: masses cannot be checked by them",
                     f"write a line such as {line!r} into SOURCE.md of the folder")  # fmt: skip
    mass = sum(body.mass for body in robot.bodies)
    if mass == 0.0:
        why = f" ({source})" if (source := robot.sources.get("masses", "")).startswith("left out") else ""
        yield Remark("note", "masses", f"no link has a mass{why}: weight and inertia are left out")
        return
    if fault := check_mass(sum_arm_mass(robot.joints[robot.carrying :], robot.bodies), rating):
        yield Remark("odd", "masses", fault, "weight and inertia use them: correct robot.urdf")
    else:
        yield Remark("fine", "masses", f"{mass:.0f} kg in {len(robot.bodies)} links")
    if robot.gravity is None:
        yield Remark("note", "gravity", "not in the model: deflections count from the arm that hangs under its weight")


def _look_at_springs(robot: Robot) -> Iterator[Remark]:
    if not robot.springs and not robot.link_elasticities:
        yield Remark("odd", "springs", "none: the model is rigid and a plan corrects nothing", "identify or diagnose")
        return
    sprung = {spring.joint for spring in robot.springs}
    stiff = [joint.name for joint in robot.actuated if joint.name not in sprung]
    if stiff:
        yield Remark("note", "springs", f"no spring at {', '.join(stiff)}: held to be rigid")
    compliance = cartesian_compliance(build_chain(robot), _sample(robot))[:, :3, :3]
    worst = 1e3 * np.linalg.norm(compliance, ord=2, axis=(1, 2))  # under 1 kN in the softest direction, m
    low, high = float(np.min(worst)), float(np.median(worst))
    text = (
        f"1 kN bends the arm by {low * 1e3:.2g} mm at the stiffest pose, {high * 1e3:.2g} mm in the median of {POSES}"
    )
    if high > SOFTEST:
        yield Remark("odd", "springs", text, "forgot e-6, or stiffness in place of compliance?")
    elif high < STIFFEST:
        yield Remark("odd", "springs", text, "compliance in another unit (rad/(N m), m/N)?")
    else:
        yield Remark("fine", "springs", text)


def _look_at_geometry(robot: Robot) -> Iterator[Remark]:
    if robot.tcp == robot.flange:
        yield Remark("note", "tcp", "the TCP is the flange: no tool is mounted", "give [tool] in the job, or --tool")
    if robot.nq < 6:
        yield Remark("note", "geometry", f"{robot.nq} joints: orientation of the tool is not free")


def _look_at_controller(robot: Robot) -> Iterator[Remark]:
    counting = load_controller(robot)
    if not counting.unchecked:
        yield Remark("fine", "controller", "controller.toml states the joint convention")
    else:
        yield Remark("note", "controller", f"{counting.unchecked}: signs and zeros of native programs are unknown",
                     "compare two postures with the controller's display")  # fmt: skip
    names = [effect.name for effect in robot_effects(robot)]
    if names:
        yield Remark("note", "effects", f"effects.toml adds {', '.join(names)}")


def _look_at_shapes(robot: Robot) -> Iterator[Remark]:
    bodies = read_bodies(robot)
    advice = (
        "a job with [collision] refuses this robot: correct robot.urdf, or put its meshes into meshes/ of the folder"
    )
    gaps = [body for body in bodies if body.gap]
    for body in gaps:
        yield Remark("odd", "collision", f"{body.link}: {body.gap}", advice if body is gaps[-1] else "")
    still = any(body.dropped and not body.moves for body in bodies)
    yield Remark("note" if gaps or still else "fine", "collision", f"shapes of each link: {describe_shapes(bodies)}")


def _sample(robot: Robot) -> Array:
    """Draw poses within the limits, a half turn at most either way of their middle. Shape (POSES, nq). [rad or m]."""
    middle = middle_of_limits(robot)
    half = np.minimum(np.nan_to_num((robot.upper - robot.lower) / 2.0, posinf=np.pi), np.pi)
    return np.asarray(middle + np.random.default_rng(0).uniform(-0.9, 0.9, (POSES, robot.nq)) * half)


def zero_posture(robot: Robot) -> Array:
    """Return the posture in which the pendant shows 0 for every axis, or the nearest within limits. Shape (nq,)."""
    q = from_controller(load_controller(robot), np.zeros((1, robot.nq)))[0]
    return np.asarray(np.clip(q, robot.lower, robot.upper))


def check_pendant(robot: Robot) -> Iterator[Remark]:
    """Say how tool data of the pendant are counted, and how to check it."""
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
    yield Remark("fine", "jog check", _describe_jog(robot, found.pose))
    yield from _look_at_mounted(robot, found.pose)


def _describe_jog(robot: Robot, pendant: Array) -> str:
    """Say where the flange goes when one jogs along the tool's axes with every axis at 0."""
    q = zero_posture(robot)
    counting = load_controller(robot)
    at_zero = np.allclose(q, from_controller(counting, np.zeros((1, robot.nq)))[0])
    flange = locate_link(robot, q[None], robot.flange)[0] @ pendant
    seen = counting.world[:3, :3].T @ flange[:3, :3]
    x, z = (name_axis(np.where(np.abs(seen[:, k]) < 1e-6, 0.0, seen[:, k])) for k in (0, 2))
    pose = "with every axis at 0" if at_zero else "with every axis as near to 0 as its limits allow"
    return f"{pose}, tool 0 jogs along +x towards {x} and along +z towards {z} of the base frame"


def _look_at_mounted(robot: Robot, pendant: Array) -> Iterator[Remark]:
    """Ask about the folder's own TCP where it leaves the flange sideways."""
    tool = mounted_tool(robot)
    cosine = float(np.clip(tool[:3, 2] @ pendant[:3, 2], -1.0, 1.0))
    angle = float(np.degrees(np.arccos(cosine)))
    if angle > ASIDE:
        yield Remark("odd", "tcp", f"z of {robot.tcp!r} points {angle:.3g} deg away from the flange's outward axis",
                     "z of the TCP frame has to point out of the tool")  # fmt: skip
