"""A measurement log: what it holds, what cannot be seen with it, and what looks like a mistake."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from compplan.cli.doctor.installation import Remark
from compplan.diagnosis.data.plausibility import check_plausibility
from compplan.errors import InputError
from compplan.io.tables import Table, read_table, read_text
from compplan.measurement.campaign import Campaign
from compplan.measurement.checks import list_notes
from compplan.measurement.reading import guess_name, log_columns, read_campaign, rename_title
from compplan.robot import Robot

#: Poses below which a calibration of six joints has hardly more equations than unknowns (theory: about 30 parameters,
#: 3 coordinates a pose, half of them held out).
FEW_POSES = 20
#: A joint that moves less shows neither its zero nor its stiffness well (assumed). [rad]
NARROW = np.radians(15.0)


def examine_log(file: Path, robot: Robot | None = None) -> list[Remark]:
    """Look at a measurement log, and at how it goes with the robot that it was taken on where that is given."""
    try:
        table = read_table(file, log_columns(), unknown="note", rename=rename_title)
    except InputError as error:
        text = name_columns(file)
        raise InputError(f"{error.message}{text}", file=error.file, where=error.where) if text else error from None
    if not len(table):
        raise table.error("the log has no rows, expected one row a measured pose")
    findings = [_describe(table), *_look_at_columns(table)]
    if robot is None:
        return [*findings, Remark("note", "robot", "not given: signs, units and frames were not looked at", "--robot")]
    campaign = read_campaign(file, robot)
    return [*findings, *_look_at_rows(campaign, robot), *_look_at_poses(campaign, robot), *_question(campaign, robot)]


def name_columns(file: Path) -> str:
    """Name the columns of another program's export that lack their unit as a log has them, "" where there is none."""
    head = read_text(file).splitlines()[:1]
    titles = [] if not head else [title.strip().strip('"') for title in re.split("[,;\t]", head[0])]
    found = [f"{title!r} {name}" for title in titles if (name := guess_name(title)) is not None]
    return f"; rename columns: {', '.join(found)} (add the unit)" if found else ""


def _describe(table: Table) -> Remark:
    joints = len(table.numbered("q#"))
    runs = len(set(table.text["run"].tolist())) if "run" in table else 1
    return Remark("fine", "log", f"{len(table)} rows, {joints} joints, {runs} run{'s' if runs > 1 else ''}")


def _look_at_columns(table: Table) -> Iterator[Remark]:
    """Say what is not in the log, and what cannot be told without it."""
    for note in table.notes:
        yield Remark("odd", "column", note, "units belong in the name: x_mm, q1_deg, fx_N")
    absent = {
        "run": "run: all rows count as one run without a break",
        "fx": "a load: stiffness is found from weight alone",
        "rx": "an orientation: tool and wrist errors are harder to separate",
        "time": "a time: warm-up and lag cannot be found",
        "temperature": "a temperature: warm-up is taken as a function of time",
        "sigma_position": "sigma_mm: the instrument's noise is found from poses met again",
    }
    for key, without in absent.items():
        if key not in table:
            yield Remark("note", "column", f"no column with {without}")
    if "contact" in table.text or "reading" in table or "distance" in table:
        yield Remark("fine", "instrument", "contacts, readings or distances: give the instrument by --instrument")
    lost = sum(np.isnan(table.values[name]) for name in ("x", "y", "z") if name in table)
    if np.any(lost):
        yield Remark(
            "note", "rows", f"{np.count_nonzero(lost)} rows have no full position (approach rows may be empty)"
        )


def _look_at_rows(campaign: Campaign, robot: Robot) -> Iterator[Remark]:
    for note in list_notes(campaign.notes):
        yield Remark("odd", "rows", note)
    beyond = ((campaign.q < robot.lower - 1e-9) | (campaign.q > robot.upper + 1e-9)).any(axis=1)
    if beyond.any():
        text = f"{int(beyond.sum())} rows are beyond the joint limits of the folder"
        yield Remark("odd", "rows", text, "is it this robot, and are signs and zeros the folder's?")
    loaded = int((~campaign.unloaded).sum())
    if not loaded:
        yield Remark("note", "load", "no row is loaded: compliances show by weight alone")
    elif not campaign.load_varies:
        yield Remark("note", "load", f"{loaded} rows carry one and the same load")


def _look_at_poses(campaign: Campaign, robot: Robot) -> Iterator[Remark]:
    still = ~campaign.on_path
    poses = len(np.unique(campaign.pose[still]))
    again = _met_again(campaign)
    if still.any() and poses < FEW_POSES:
        yield Remark("odd", "poses", f"{poses} different poses", f"{FEW_POSES} and more separate causes")
    elif still.any():
        yield Remark("fine", "poses", f"{poses} different poses")
    if still.any() and not again:
        yield Remark("note", "repeats", "no pose is met again after another one", "repeat five: they show the noise")
    elif again:
        yield Remark("fine", "repeats", f"{again} poses are met again")
    moved = np.ptp(np.nan_to_num(campaign.q), axis=0)
    for joint, span in zip(robot.actuated, moved, strict=True):
        if joint.kind != "prismatic" and span < NARROW:
            text = f"{joint.name} moves over {np.degrees(span):.1f} deg only: its zero and stiffness hardly show"
            yield Remark("odd", "poses", text)


def _met_again(campaign: Campaign) -> int:
    """Count the poses that more than one stay returns to."""
    stays = {(int(pose), int(stay)) for pose, stay in zip(campaign.pose, campaign.stay, strict=True)}
    poses = [pose for pose, _ in stays]
    return sum(poses.count(pose) > 1 for pose in set(poses))


def _question(campaign: Campaign, robot: Robot) -> Iterator[Remark]:
    questions = check_plausibility(robot, campaign)
    for question in questions:
        yield Remark("odd", question.about, question.sentence)
    if not questions:
        yield Remark("fine", "conventions", "units, frames, signs, point of the wrench and clock agree with the robot")
