"""Parameter uncertainty of a robot: uncertainty.toml of its folder, or values assumed by the grade of the folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compplan.effects import EFFECTS
from compplan.effects.checks import check_effect
from compplan.effects.forward_model import own_springs
from compplan.effects.joint_stiffness import RIGID_SCALE, compliance_key
from compplan.effects.signature import pack_parameters
from compplan.errors import InputError, UnknownNameError
from compplan.robot import Joint, Robot
from compplan.robot.uncertainty import FILE, Uncertainty, Unknown, split_unknowns

#: Relative standard deviation of a compliance by the folder's grade (assumed: force models of identified robots explain
#: some 90 % of the deflection, machines of one type differ by some 20 %; scaled: three sourced arms scatter by .4 to .6
#: about the rule of docs/robots.md in joints 1 to 4; placeholder: more than that).
COMPLIANCE = {"identified": 0.10, "literature": 0.20, "scaled": 0.50, "placeholder": 0.80}
#: Standard deviations of zeros [deg], lengths [mm] and directions [deg] of a calibrated arm, and of one as delivered
#: (assumed: together some .15 and .6 mm at two metres, as robot calibration reports).
CALIBRATED, DELIVERED = (0.003, 0.03, 0.001), (0.010, 0.10, 0.003)
#: Lost motion (full width) and gear error (amplitude once per turn) [deg], as in [noise] (assumed).
PLAY, GEAR = 0.002, 0.002
#: Standard deviation of a touched-off tool tip per axis, as in [noise] (assumed). [m]
TOOL = 3e-5
#: Relative standard deviation of a joint stiffness that was not identified (assumed).
HELD = 0.3
#: Unmodelled error of a robot without measurements: rms distance and correlation length (assumed). [m]
UNEXPLAINED, SCALE = 5e-5, 0.3
#: Default repeatability per axis (assumed, as in [noise]: 30 to 120 um stated by makers are three standard deviations
#: of a distance). [m]
REPEATABILITY = 2e-5
#: Factor on the 6x6 elasticity of a link: an unknown that is not an effect of the vocabulary.
LINK_ELASTICITY, RATIO = "link_elasticity", "compliance_change_ratio"
#: Effects that are observable only under load.
COMPLIANCES = ("joint_stiffness", "link_compliance", "base_compliance", LINK_ELASTICITY)
TURNS = ("tx", "ty", "tz", "rx", "ry", "rz")


def robot_uncertainty(robot: Robot) -> Uncertainty:
    """Return the parameter uncertainty of a robot: that of the folder's file, otherwise assumed values.

    A tool frame that was not identified gets the assumed uncertainty of a touched-off tool tip.

    Raises:
        InputError: If the folder's file names no effect, joint or parameter of this robot.
    """
    known = robot.uncertainty
    if known is None:
        known = assume_uncertainty(robot)
    else:
        check_uncertainty(robot, known)
        if not any(unknown.effect == "tool_frame" for unknown in known.unknowns):
            known = _add(known, _tool())
        stated = (known.repeatability, robot.repeatability, REPEATABILITY)
        known = replace(known, repeatability=next(value for value in stated if value is not None))
    return known


def moves_base(robot: Robot, unknown: Unknown) -> bool:
    """Return whether an unknown moves the complete arm like its base: zero, place and direction of the first joint."""
    return unknown.effect in ("joint_offset", "link_geometry") and unknown.joint == robot.actuated[0].name


def restore_prior(before: Robot, known: Uncertainty, *, free_base: bool) -> Uncertainty:
    """Restore the prior uncertainty of parameters that a log does not determine.

    A log without loads on a joint has no information on its compliance. One whose base frame or contact positions are
    fitted (`free_base`) has none on the parameters that move the complete arm; they matter for a part at a stated
    place. before: robot folder before the log; known: its uncertainty after the log.
    """
    then, places = robot_uncertainty(before), {(u.effect, u.joint, u.axis) for u in known.unknowns}
    prior = split_unknowns(then.unknowns, then.width)
    base = [(u, width) for u, width in prior if free_base and moves_base(before, u)]
    soft = [(u, width) for u, width in prior if u.effect in COMPLIANCES and (u.effect, u.joint, u.axis) not in places]
    moving = [(u.effect, u.joint, u.axis) for u, _ in base]
    known = known.select((u.effect, u.joint, u.axis) not in moving for u in known.unknowns)
    for unknown, width in (*base, *soft):
        known = _add(known, replace(unknown, deviation=width / known.calibration))
    how = "assumed" if before.uncertainty is None else "as before"
    told = [f"zero and place of {before.actuated[0].name} {how}"] if base else []
    if soft:
        told.append(f"compliance of {', '.join(dict.fromkeys(str(u.joint) for u, _ in soft))} {how}")
    return replace(known, source=f"{known.source}; {', '.join(told)}: not determined by this log") if told else known


def check_uncertainty(robot: Robot, known: Uncertainty) -> None:
    """Check that the robot has every unknown.

    Raises:
        InputError: With file and key.
    """
    file = None if robot.folder is None else robot.folder / FILE
    links = [block.link for block in robot.link_elasticities]
    for number, unknown in enumerate(known.unknowns):
        where = f"unknown[{number}]"
        if unknown.effect == LINK_ELASTICITY:
            children = {joint.name: joint.child for joint in robot.joints}
            if children.get(str(unknown.joint)) not in links or unknown.keys != (RATIO,):
                message = f"joint must be one that carries an elastic link, and keys ['{RATIO}']"
                raise InputError(message, file=file, where=where)
            continue
        if unknown.effect not in EFFECTS:
            raise UnknownNameError("effect", unknown.effect, list(EFFECTS), file=file, where=f"{where}.effect")
        if unknown.joint is not None and unknown.joint not in (names := [joint.name for joint in robot.joints]):
            raise UnknownNameError("joint", unknown.joint, names, file=file, where=f"{where}.joint")
        try:
            parameters = pack_parameters(unknown.keys, unknown.deviation, unknown.fixed)
        except AttributeError:
            message = "a list in `fixed` cannot also be unknown"
            raise InputError(message, file=file, where=f"{where}.keys") from None
        table = {"effect": unknown.effect, "joint": unknown.joint, "axis": unknown.axis, "parameters": parameters}
        check_effect(table, robot, file, where)


def assume_uncertainty(robot: Robot) -> Uncertainty:
    """Return uncertainty assumed by the folder's grade: springs, zeros, lengths, directions, backlash, gears, tool."""
    unknowns = [*_springs(robot, COMPLIANCE[robot.grade]), *assume_geometry(robot), *_drives(robot), _tool()]
    return Uncertainty(
        grade="literature" if robot.grade == "literature" else "assumed",
        source=f"uncertainty of the robot model assumed ({robot.grade}; the robot folder has no {FILE})",
        unknowns=tuple(unknowns),
        factor=np.eye(sum(len(unknown.keys) for unknown in unknowns)),
        unexplained=UNEXPLAINED,
        scale=SCALE,
        repeatability=REPEATABILITY if robot.repeatability is None else robot.repeatability,
    )


def list_assumed(robot: Robot) -> list[str]:
    """Describe the assumed uncertainties, one sentence each; none if the folder states them and the repeatability."""
    said = []
    if robot.uncertainty is None:
        zero, length, turn = _widths(robot)
        said.append(
            f"the robot folder has no {FILE}; assumed standard deviations (robot model: {robot.grade}): compliances"
            f" {100 * COMPLIANCE[robot.grade]:g} %, joint zeros {zero:g} deg, lengths {length:g} mm, axis directions"
            f" {turn:g} deg, lost motion and gear error {PLAY:g} deg, tool tip {TOOL * 1e3:g} mm, unexplained"
            f" {UNEXPLAINED * 1e3:g} mm"
        )
    elif not any(unknown.effect == "tool_frame" for unknown in robot.uncertainty.unknowns):
        said.append(f"assumed standard deviation of the tool tip on the flange: {TOOL * 1e3:g} mm per axis")
    if robot.repeatability is None and (robot.uncertainty is None or robot.uncertainty.repeatability is None):
        said.append(f"assumed repeatability: {REPEATABILITY * 1e3:g} mm per axis (standard deviation)")
    return said


def _widths(robot: Robot) -> tuple[float, float, float]:
    folder = robot.folder
    calibrated = robot.grade == "identified" or (folder is not None and (folder / "controller.urdf").is_file())
    return CALIBRATED if calibrated else DELIVERED


def _joint_spring(joint: Joint, width: float) -> Unknown:
    return Unknown("joint_stiffness", joint.name, None, (compliance_key(joint.kind),), np.array([width]))


def _springs(robot: Robot, share: float) -> list[Unknown]:
    own, found = own_springs(robot), list[Unknown]()
    taken = {spring.spring for spring in own.values()}
    for index, joint in enumerate(robot.actuated):
        size = own[index].compliance if index in own else RIGID_SCALE[joint.kind]
        found.append(_joint_spring(joint, share * size))
    for number, spring in enumerate(robot.springs):
        if number not in taken and spring.axis != "own":
            key = "compliance_m_per_N" if spring.axis[0] == "t" else "compliance_rad_per_Nm"
            width = np.array([share * spring.compliance])
            found.append(Unknown("link_compliance", spring.joint, spring.axis, (key,), width))
    carriers = {joint.child: joint.name for joint in robot.joints}
    for link in dict.fromkeys(block.link for block in robot.link_elasticities):
        if link in carriers:
            found.append(Unknown(LINK_ELASTICITY, carriers[link], None, (RATIO,), np.array([share])))
    return found


def assume_geometry(robot: Robot, widths: tuple[float, float, float] | None = None) -> list[Unknown]:
    """Return unknown zeros, lengths and directions with standard deviations [deg, mm, deg], by default assumed ones."""
    zero, length, turn = _widths(robot) if widths is None else widths
    found = []
    for joint in robot.actuated:
        slides = joint.kind == "prismatic"
        size = length * 1e-3 if slides else np.radians(zero)
        found.append(
            Unknown("joint_offset", joint.name, None, ("offset_m" if slides else "offset_rad",), np.array([size]))
        )
        for k, axis in enumerate(TURNS):
            along = abs(float((joint.placement[:3, :3] @ joint.axis)[k % 3])) > 0.9
            if along and slides == (axis[0] == "t"):
                continue
            key, width = (f"{axis}_m", length * 1e-3) if axis[0] == "t" else (f"{axis}_rad", np.radians(turn))
            found.append(Unknown("link_geometry", joint.name, axis, (key,), np.array([width])))
    return found


def assume_held(robot: Robot, named: Sequence[Unknown]) -> list[Unknown]:
    """List the joint springs that the campaign did not identify, with an assumed standard deviation."""
    told = {unknown.joint for unknown in named if unknown.effect == "joint_stiffness"}
    found = []
    for index, spring in own_springs(robot).items():
        joint = robot.actuated[index]
        if joint.name not in told and spring.compliance > 0:
            found.append(_joint_spring(joint, HELD * spring.compliance))
    return found


def _drives(robot: Robot) -> list[Unknown]:
    found = []
    for joint in robot.actuated:
        if joint.kind == "prismatic":
            continue
        found.append(Unknown("backlash", joint.name, None, ("width_rad",), np.radians([PLAY])))
        waves = np.radians([GEAR, GEAR]) / np.sqrt(2.0)
        fixed = {"cycles_per_turn": [1.0]}
        found.append(Unknown("transmission_error", joint.name, None, ("sine_rad#0", "cosine_rad#0"), waves, fixed))
    return found


def _tool(width: float = TOOL) -> Unknown:
    return Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.full(3, width))


def _add(known: Uncertainty, unknown: Unknown) -> Uncertainty:
    """Add an unknown that is independent of the others."""
    (p, r), k = known.factor.shape, len(unknown.keys)
    factor = np.block([[known.factor, np.zeros((p, k))], [np.zeros((k, r)), np.eye(k)]])
    return replace(known, unknowns=(*known.unknowns, unknown), factor=factor)
