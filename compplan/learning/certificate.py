"""A certificate: what is known of a robot today, joint by joint, against literature and against the last one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.answer.change import state_change
from compplan.diagnosis.campaign_diagnosis import FEWEST_ROWS
from compplan.effects.scene import own_springs
from compplan.errors import InputError
from compplan.job.job import Job
from compplan.learning.iso9283 import PoseAccuracy, measure_pose_accuracy
from compplan.learning.reference import Reference, plan_jobs, plan_references
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot, read_robot_folder
from compplan.robot.folder import robot_folders
from compplan.robot.uncertainty import Uncertainty, split_unknowns
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames
from compplan.uncertainty.assumed import known_uncertainty
from compplan.uncertainty.slopes import stage_path, tip_of

#: Two-sided 95 % of a normal value.
REACH = 1.959964
#: Changes beyond so many standard deviations are drift.
DRIFTED = 2.0
#: Two folders that put the tip farther apart than this are of two robots, or of one with two tools (assumed). [m]
FARTHEST_DRIFT = 0.1
#: Effects that are a change of a joint's stiffness.
STIFFNESS = ("joint_stiffness", "stiffness_nonlinearity")
#: Lost motion or gear error that makes this share of the tolerance's square is worth a repair (assumed).
WORTH_REPAIR = 0.1


@dataclass(frozen=True)
class Stiffness:
    """Stiffness about a joint's own axis. [N m/rad, N/m]; infinite where the model holds it rigid.

    Attributes:
        joint: The joint.
        value: Of the folder.
        low: Least of the 95 % interval.
        high: Greatest of it.
        literature: Of the shipped robot of this type, or None.
        older: Of the last certificate's folder, or None.
        change: Change of the compliance since then, in standard deviations, or None.
    """

    joint: str
    value: float
    low: float
    high: float
    literature: float | None
    older: float | None
    change: float | None


@dataclass(frozen=True)
class DriveError:
    """Lost motion and gear error of a joint. [rad or m]

    Attributes:
        joint: The joint.
        play: Full width of its lost motion.
        play_spread: Half of its 95 % interval; None where it is assumed to be absent and nobody looked.
        gear: Amplitude of its periodic error, all waves together.
        gear_spread: Half of its 95 % interval, or None.
        older_play: Lost motion of the last certificate's folder, or None.
        lever: Greatest distance of the tip from the joint's axis on the reference paths. [m]
    """

    joint: str
    play: float
    play_spread: float | None
    gear: float
    gear_spread: float | None
    older_play: float | None
    lever: float


@dataclass(frozen=True)
class Named:
    """An effect that the diagnosis of the log names.

    Attributes:
        effect: Its name.
        joint: Its joint, or None.
        axis: Its axis, or None.
        probability: Its probability.
        percent: Change of a joint's compliance with its 95 % interval, of the nominal one, or None. [%]
    """

    effect: str
    joint: str | None
    axis: str | None
    probability: float
    percent: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is known of a robot today.

    Attributes:
        robot: The robot.
        known: How surely it is known.
        stiffness: Joint by joint.
        drives: Joint by joint.
        references: Reference paths and what can be promised there.
        accuracy: Of the log, or None.
        log: Name of the log, or "".
        older: Folder that today's is held against, or None.
        drifts: Whether that one was measured too: only then is a difference a change of the robot.
        findings: What the diagnosis of the log names.
        moved: Change of the tip since then at the same commands on every reference path, rms and greatest. [m]
        literature: Shipped robot of this type, or None.
        next_steps: What to measure or repair next, one sentence each.
    """

    robot: Robot
    known: Uncertainty
    stiffness: tuple[Stiffness, ...]
    drives: tuple[DriveError, ...]
    references: tuple[Reference, ...]
    accuracy: PoseAccuracy | None
    log: str
    older: Robot | None
    moved: tuple[tuple[str, float, float], ...]
    literature: Robot | None
    next_steps: tuple[str, ...]
    drifts: bool = False
    findings: tuple[Named, ...] = ()

    @property
    def changed(self) -> tuple[str, ...]:
        """Joints whose stiffness differs beyond chance, by the folders or by the diagnosis of the log."""
        told = {f.joint for f in self.findings if f.effect in STIFFNESS and f.joint is not None}
        told |= {e.joint for e in self.stiffness if e.change is not None and abs(e.change) > DRIFTED}
        return tuple(e.joint for e in self.stiffness if e.joint in told)


def certify_robot(
    robot: Robot, campaign: Campaign | None = None, older: Robot | None = None, jobs: Sequence[Job] = (),
    register: Sequence[str] = (),
) -> Certificate:  # fmt: skip
    """Certify a robot.

    With a log, the diagnosis of it is part of the certificate: against the older folder where one is given, else
    against today's. Where today's folder was never measured, the folder that the diagnosis delivers is certified.

    Args:
        robot: The robot of today's folder.
        campaign: A log to diagnose, and to take accuracy and repeatability from.
        older: The robot that today's is held against.
        jobs: Jobs whose paths are promised; reference paths of the robot's own size if left out.
        register: Frames that the diagnosis fits first.

    Raises:
        InputError: If the older folder is of another robot, or a file is not what it has to be.
    """
    findings: tuple[Named, ...] = ()
    today = robot
    if campaign is not None and campaign.usable.sum() >= FEWEST_ROWS:
        diagnosis = diagnose_campaign(robot if older is None else older, campaign, register=tuple(register))
        findings = name_findings(diagnosis)
        if older is None and known_uncertainty(robot).grade != "measured":
            today = replace(diagnosis.updated, name=robot.name, folder=robot.folder)
            older = robot
    known = known_uncertainty(today)
    references = tuple(plan_jobs(jobs) if jobs else plan_references(today))
    literature = find_literature(today)
    certificate = Certificate(
        robot=today,
        known=known,
        stiffness=tuple(measure_stiffness(today, known, literature, older)),
        drives=tuple(measure_drives(today, known, references, older)),
        references=references,
        accuracy=None if campaign is None else measure_pose_accuracy(today, campaign),
        log="" if campaign is None or campaign.file is None else campaign.file.name,
        older=older,
        moved=() if older is None else tuple(measure_drift(today, older, references)),
        literature=literature,
        next_steps=(),
        drifts=older is not None and is_measured(older) and known.grade == "measured",
        findings=findings,
    )
    return replace(certificate, next_steps=tuple(advise(certificate)))


def is_measured(robot: Robot) -> bool:
    """Tell whether the widths of a folder come from measurements of this robot."""
    return known_uncertainty(robot).grade == "measured"


def name_findings(diagnosis: Diagnosis) -> tuple[Named, ...]:
    """State what a diagnosis names, each as the diagnosis states it."""
    named = []
    for finding in diagnosis.verdict.findings:
        effect, joint, axis = finding.effect.place
        change = state_change(diagnosis.robot, finding.effect, diagnosis.deliveries[0].uncertainty)
        percent = change.get("change_percent")
        share = None if percent is None else (percent[0], percent[1], percent[2])
        named.append(Named(str(effect), joint, axis, finding.probability, share))
    return tuple(named)


def find_literature(robot: Robot) -> Robot | None:
    """Return the shipped robot of the same type, by the name in the URDF and its joints, or None."""
    folder = robot_folders().get(ElementTree.fromstring(robot.urdf).get("name", ""))
    shipped = None if folder is None else read_robot_folder(folder)
    return shipped if shipped is not None and shipped.joint_names == robot.joint_names else None


def width_of(known: Uncertainty, effect: str, joint: str) -> Array | None:
    """Return the widths of the parameters of an effect at a joint, or None where it is not among the unknowns."""
    parts = [own for u, own in split_unknowns(known.unknowns, known.width) if (u.effect, u.joint) == (effect, joint)]
    return np.concatenate(parts) if parts else None


def measure_stiffness(
    robot: Robot, known: Uncertainty, literature: Robot | None, older: Robot | None
) -> list[Stiffness]:
    """State the stiffness of every joint with its interval."""
    own, found = own_springs(robot), []
    known_then = None if older is None else known_uncertainty(older)
    for index, joint in enumerate(robot.actuated):
        compliance = own[index].compliance if index in own else 0.0
        told = width_of(known, "joint_stiffness", joint.name)
        spread = 0.0 if told is None else float(np.linalg.norm(told))
        before = _compliance(older, index)
        # an older folder that nobody measured is a number to hold today's against, its width says nothing of today
        past = None
        if known_then is not None and known_then.grade == "measured":
            past = width_of(known_then, "joint_stiffness", joint.name)
        then = 0.0 if past is None else float(np.linalg.norm(past))
        both = float(np.hypot(spread, then)) if known.grade == "measured" else 0.0
        found.append(
            Stiffness(
                joint=joint.name,
                value=_inverse(compliance),
                low=_inverse(compliance + REACH * spread),
                high=_inverse(compliance - REACH * spread),
                literature=None if literature is None else _inverse(_compliance(literature, index) or 0.0),
                older=None if before is None else _inverse(before),
                change=None if before is None or both <= 0 else (compliance - before) / both,
            )
        )
    return found


def measure_drives(
    robot: Robot, known: Uncertainty, references: tuple[Reference, ...], older: Robot | None
) -> list[DriveError]:
    """State lost motion and gear error of every joint."""
    levers = _levers(robot, references)
    found = []
    for index, joint in enumerate(robot.actuated):
        play, gear = (width_of(known, effect, joint.name) for effect in ("backlash", "transmission_error"))
        found.append(
            DriveError(
                joint=joint.name,
                play=_play(robot, joint.name),
                play_spread=None if play is None else REACH * float(np.linalg.norm(play)),
                gear=_gear(robot, joint.name),
                gear_spread=None if gear is None else REACH * float(np.linalg.norm(gear)),
                older_play=None if older is None else _play(older, joint.name),
                lever=float(levers[index]),
            )
        )
    return found


def measure_drift(robot: Robot, older: Robot, references: tuple[Reference, ...]) -> list[tuple[str, float, float]]:
    """Compare where both robots put the tip at the same commands: name, rms and greatest distance. [m]

    Raises:
        InputError: If they are so far apart that the older folder cannot be of this robot.
    """
    found = []
    for reference in references:
        if reference.plan is None or older.nq != robot.nq:
            continue
        plan, task = reference.plan, reference.plan.task
        rows = np.flatnonzero(task.cut)
        tips = [tip_of(stage_path(r, plan.q, task.wrench, task.step_time), rows) for r in (robot, older)]
        distance = np.linalg.norm(tips[0] - tips[1], axis=1)
        if distance.max() > FARTHEST_DRIFT:
            message = f"robot {older.name!r} puts the tip {distance.max() * 1e3:.0f} mm from where {robot.name!r} does"
            raise InputError(f"{message}: another robot or another tool, no drift")
        found.append((reference.name, float(np.sqrt(np.mean(distance**2))), float(distance.max())))
    return found


def advise(certificate: Certificate) -> list[str]:
    """Say what to repair or to measure next, one sentence each; the most useful first."""
    said = []
    tolerance = min((r.promise.whole for r in certificate.references if r.promise is not None), default=np.inf)
    for drive in certificate.drives:
        play, gear = drive.play_spread or 0.0, drive.gear_spread or 0.0
        for what, size, spread in (("lost motion", 0.5 * drive.play, 0.5 * play), ("gear error", drive.gear, gear)):
            moved = size * drive.lever
            if size > spread and np.isfinite(tolerance) and moved**2 > WORTH_REPAIR * tolerance**2:
                said.append(f"Repair or adjust {drive.joint}: its {what} moves the tip by {moved * 1e3:.3f} mm.")
    for entry in certificate.stiffness:
        if entry.change is not None and abs(entry.change) > DRIFTED:
            word = "softer" if entry.change > 0 else "stiffer"
            than = "at the last certificate" if certificate.drifts or certificate.older is None else "its folder said"
            said.append(
                f"Look at {entry.joint}: it is {word} than {than} by"
                f" {abs(entry.change):.1f} standard deviations."
            )
    for reference in certificate.references:
        if reference.promise is not None and reference.promise.leading:
            name, share = reference.promise.leading[0]
            said.append(
                f"Measure the robot: compplan campaign JOB --poses 12 --out poses."
                f" {name.replace('_', ' ').capitalize()} makes {share:.0%} of the variance on the {reference.name}."
            )
    if certificate.known.grade != "measured":
        said.append("Measure this robot (compplan identify or diagnose): how surely it is known is assumed so far.")
    accuracy = certificate.accuracy
    if accuracy is not None and not accuracy.again:
        said.append("Measure some poses twice in the next log: so far its repeatability is not known.")
    return list(dict.fromkeys(said))


def _compliance(robot: Robot | None, index: int) -> float | None:
    if robot is None:
        return None
    own = own_springs(robot)
    return own[index].compliance if index in own else 0.0


def _inverse(compliance: float) -> float:
    return float("inf") if compliance <= 0.0 else 1.0 / compliance


def _play(robot: Robot, joint: str) -> float:
    tables = [e["parameters"] for e in robot.effects if (e.get("effect"), e.get("joint")) == ("backlash", joint)]
    return float(sum(float(t.get("width_rad", t.get("width_m", 0.0))) for t in tables))


def _gear(robot: Robot, joint: str) -> float:
    square = 0.0
    for table in robot.effects:
        if (table.get("effect"), table.get("joint")) != ("transmission_error", joint):
            continue
        for key, value in table["parameters"].items():
            if key.startswith(("sine", "cosine", "height", "spline")):
                square += float(np.sum(np.asarray(value, float) ** 2))
    return float(np.sqrt(square))


def _levers(robot: Robot, references: tuple[Reference, ...]) -> Array:
    """Return the greatest motion of the tip per unit of each joint on the reference paths. Shape (nq,). [m or 1]"""
    chain, levers = build_chain(robot), np.zeros(robot.nq)
    for reference in references:
        if reference.plan is not None:
            columns = joint_jacobian(chain, locate_frames(chain, reference.plan.q))
            levers = np.maximum(levers, np.linalg.norm(columns[:, :3], axis=1).max(axis=0))
    return levers
