"""The page of a designed campaign: which poses, what they will bring, when to stop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.learning.campaign import PoseCampaign
from compplan.reporting import figure as go
from compplan.reporting.page import Block, Chart, Column, Columns, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.path_scene import draw_cell
from compplan.reporting.provenance import describe_robot
from compplan.reporting.style import AFTER, CATEGORIES, TOLERANCE, format_length, format_percent
from compplan.reporting.summaries import open_campaign
from compplan.robot import Array


def write_campaign_page(campaign: PoseCampaign, file: Path) -> None:
    """Write the page of a designed campaign.

    Args:
        campaign: The campaign.
        file: The HTML file.
    """
    plan = campaign.plan
    poses = Chart(_draw_poses(campaign), "Dots: the tip at the poses, numbered. Line: the path.", 460)
    sections = [
        Section(
            "What it brings",
            [Columns([[Chart(_draw_curve(campaign), _caption(campaign), 380)], [_compare(campaign)]], [3, 2])],
            f"The 95 % band of the true tip {campaign.equipment.place}, pose by pose in the order of their worth.",
        ),
        Section(
            "Poses",
            [poses, _table(campaign)],
            "In the order of measuring. Approach each from the stated side, let it settle, then measure.",
        ),
        *_stands(campaign),
        Section("What remains", [_rest(campaign)], "What would narrow the band most afterwards."),
    ]
    warning = ""
    if len(campaign.touching):
        numbers = ", ".join(str(k + 1) for k in campaign.touching)
        warning = f"On the straight joint move to pose {numbers} the arm touches something: go around by hand."
    write_page(
        file, f"{plan.name}: {len(campaign.poses) - 1} poses to measure", describe_campaign(campaign), sections,
        kind=f"Campaign, {plan.robot.name}", opening=open_campaign(
            campaign, Chart(_draw_curve(campaign), _caption(campaign), 340)), warning=warning, notes=campaign.notes,
        provenance=describe_robot(plan.robot, [("known from", campaign.design.known.source)]),
    )  # fmt: skip


def describe_campaign(campaign: PoseCampaign) -> str:
    """Say in a few sentences what the campaign brings and when to stop."""
    choice = campaign.choice
    text = (
        f"{len(choice.rows)} poses narrow the 95 % band {campaign.equipment.place} from "
        f"{format_length(choice.greatest[0])} to {format_length(choice.greatest[-1])} at its widest point, "
        "if the robot is as uncertain as stated."
    )
    if campaign.log:
        text += f" {campaign.log} rows of the log count already."
    enough = choice.enough
    if enough == 0:
        return f"{text} No further pose is worth measuring: stop here."
    if enough is not None:
        return f"{text} Stop after the {enough} most useful ones: the others narrow it by less than 0.5 % each."
    return f"{text} The last one is still worth it: more poses would narrow it further."


def _caption(campaign: PoseCampaign) -> str:
    floor = float(campaign.design.floor.max())
    return (
        f"Dashed: {format_length(floor)} are left by the force, repeatability and what no parameter explains. Cut and"
        " measure a part for those (compplan learn)."
    )


def _draw_curve(campaign: PoseCampaign) -> Any:

    choice, figure = campaign.choice, go.Figure()
    count = np.arange(len(choice.rms))
    widest, mean = ("at its widest point", choice.greatest, AFTER), ("rms", choice.rms, CATEGORIES[3])
    for name, values, colour in (widest, mean):
        figure.add_scatter(x=count, y=1e3 * values, mode="lines+markers", name=name, line={"color": colour, "width": 2})
    floor = 1e3 * float(campaign.design.floor.max())
    figure.add_scatter(
        x=count[[0, -1]], y=[floor, floor], mode="lines", name="no pose lowers it below",
        line={"color": TOLERANCE, "dash": "dash"},
    )  # fmt: skip
    figure.update_xaxes(title_text="poses measured")
    figure.update_yaxes(title_text="95 % band, mm", rangemode="tozero")
    return figure


def _compare(campaign: PoseCampaign) -> PageTable:
    design, choice = campaign.design, campaign.choice
    count = len(choice.rows)
    rows: list[Row] = [
        ["now", 1e3 * campaign.model_part(campaign.start)],
        [f"{count} designed poses", TableCell(1e3 * campaign.model_part(choice.covariance), "strong")],
    ]
    columns = [Column("after"), Column("band of the parameters alone, rms", "mm")]
    caption = f"Instrument {1e3 * design.sigma:g} mm per axis."
    return PageTable(columns, rows, caption)


def _draw_poses(campaign: PoseCampaign) -> Any:

    plan, tip = campaign.plan, 1e3 * campaign.poses.tip[:-1]
    figure = draw_cell(plan.robot, plan.q, plan.task.position)
    numbers = [str(k + 1) for k in range(len(tip))]
    figure.add_trace(
        go.Scatter3d(x=tip[:, 0], y=tip[:, 1], z=tip[:, 2], mode="markers+text", text=numbers, name="poses",
                     marker={"size": 5, "color": CATEGORIES[1]})
    )  # fmt: skip
    return figure


def _table(campaign: PoseCampaign) -> PageTable:
    robot, poses = campaign.plan.robot, campaign.poses
    scale = np.where(robot.prismatic, 1e3, 180 / np.pi)
    rows: list[Row] = []
    for k in range(len(poses)):
        label: TableCell | str | int = TableCell("1 again", "muted") if k == len(poses) - 1 else k + 1
        worth = None if k == len(poses) - 1 else int(campaign.worth[k])
        side = "rising" if poses.rising[k] else "falling"
        load = f"{poses.weight[k]:g} kg" if poses.weight[k] else "none"
        rows.append(
            [label, worth, *(float(v) for v in poses.q[k] * scale), side, load, _describe_pull(poses.wrench[k, :2]),
             *(float(v) for v in 1e3 * poses.tip[k])]
        )  # fmt: skip
    units = ["mm" if slides else "deg" for slides in robot.prismatic]
    columns: list[Column] = [Column("pose"), Column("worth")]
    columns += [Column(f"q{k + 1}", unit, 5) for k, unit in enumerate(units)]
    columns += [Column("joints come"), Column("weight"), Column("pull", "base axes")]
    columns += [Column(name, "mm", 5) for name in "xyz"]
    return PageTable(columns, rows, "Worth: 1 brings the most. The tip's place is that of the loaded tip.", scroll=24)


def _stands(campaign: PoseCampaign) -> list[Section]:
    rows: list[Row] = [[stand.label, *(float(v) for v in 1e3 * stand.place), stand.says] for stand in campaign.stands]
    if not rows:
        return []
    columns = [Column("label"), *(Column(name, "mm", 4) for name in "xyz"), Column("put up")]
    lead = "In the robot's base frame; within centimetres is enough where nothing else is said, the rows tell the rest."
    return [Section("Where it stands", [PageTable(columns, rows)], lead)]


def _describe_pull(pull: Array) -> str:
    """Say a pull along one axis, such as 400 N along -y."""
    axis = int(np.abs(pull).argmax())
    if not pull.any():
        return "none"
    return f"{abs(pull[axis]):.0f}\u00a0N\u00a0along\u00a0{'-' if pull[axis] < 0 else '+'}{'xyz'[axis]}"


def _rest(campaign: PoseCampaign) -> Block:
    rows: list[Row] = [[name, format_percent(share)] for name, share in campaign.rest]
    columns = [Column("if this were known exactly"), Column("the variance of the tip would shrink by")]
    return PageTable(columns, rows or [["nothing stands out", None]])
