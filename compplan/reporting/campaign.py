"""Outputs of `compplan campaign`: campaign.csv to fill in, programs to the poses, campaign.json, report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.writers import build_program, write_program
from compplan.io.display import Curve, Curves
from compplan.io.palette import CATEGORIES
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_mm, format_mm_change, format_percent
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.learning.campaign import PoseCampaign
from compplan.learning.design import WORTH
from compplan.measurement.observations import READING, Observations
from compplan.reporting.charts import draw_curves
from compplan.reporting.page import Cell, Chart, DataTable, Section, Summary, render_page
from compplan.reporting.plan_page import list_leading
from compplan.reporting.provenance import describe_robot
from compplan.reporting.scenes import draw_cell
from compplan.robot import Array
from compplan.toolpath.toolpath import WRENCH_HEADERS

#: Task at a pose, for instruments other than a tracker.
TASKS = {
    "sockets": "set the ball into the socket of the row and enter the joint positions of the controller",
    "gauge": "enter the reading of the row's gauge in reading_mm; it grows along dir",
}


def write_campaign(campaign: PoseCampaign, folder: Path) -> dict[str, Any]:
    """Write a designed campaign and return the content of campaign.json."""
    with replace_folder(folder, "campaign") as part:
        _write_log(campaign, part / "campaign.csv")
        if campaign.poses.observations is not None:
            text = _describe_instrument(campaign.poses.observations, campaign.equipment.sigma)
            write_text(part / "instrument.toml", "".join(f"# {one.instruction}\n" for one in campaign.fixtures) + text)
        _write_moves(campaign, part)
        write_text(part / "report.html", _render(campaign))
        summary = {**summarise_campaign(campaign), "files": [*map(str, list_files(part)), "campaign.json"]}
        write_json(part / "campaign.json", summary, indent=2)
    return summary


def _write_log(campaign: PoseCampaign, file: Path) -> None:
    """Write the empty log, two rows per pose: start of the approach, which stays empty, and the pose to measure.

    The first row records the approach direction of the joints.
    """
    poses, n = campaign.poses, len(campaign.poses)
    columns: dict[str, object] = {"run": np.array(["static1"] * 2 * n)}
    columns |= campaign.plan.robot.joint_columns(poses.log.q)
    columns |= {header: poses.log.wrench[:, k] for k, header in enumerate(WRENCH_HEADERS)}
    columns |= _list_observations(poses.observations, n)
    columns["sigma_mm"] = np.full(2 * n, campaign.equipment.sigma * 1e3)
    write_table(file, columns, decimals=7)
    task = TASKS.get(campaign.equipment.instrument, "measure")
    todo = f"the next row is the start of the approach (enter nothing there); at the row after it {task}"
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    lines = [head]
    for k in range(n):
        load = f"{poses.weight[k]:g} kg" if poses.weight[k] else "no weight"
        x, y = poses.wrench[k, :2]
        pull = f", pull {x:g}, {y:g}, 0 N" if x or y else ""
        worth = f"rank {campaign.rank[k]}" if k < n - 1 else "pose 1 again"
        lines += [f"# pose {k + 1} ({worth}): {load}{pull}; {todo}"]
        lines += rows[2 * k : 2 * k + 2]
    write_text(file, "\n".join(lines) + "\n")


def _list_observations(observations: Observations | None, poses: int) -> dict[str, object]:
    """Return the columns to fill in: positions or readings of another instrument, in the second row of each pose."""
    empty = np.full(2 * poses, np.nan)
    if observations is None:
        return {f"{axis}_mm": empty for axis in "xyz"}

    def second(values: Array) -> Array:
        return np.stack([np.full((poses, 3), np.nan), values], axis=1).reshape(-1, 3)

    columns: dict[str, object] = {}
    if observations.names:
        columns["contact"] = np.array([["", observations.names[one]] for one in observations.contact]).reshape(-1)
    else:
        columns |= {f"{axis}_mm": 1e3 * second(observations.origin)[:, k] for k, axis in enumerate("xyz")}
    if (observations.kind == READING).any():
        columns |= {f"dir_{axis}": second(observations.direction)[:, k] for k, axis in enumerate("ijk")}
        columns["reading_mm"] = empty
    return columns


def _describe_instrument(observations: Observations, sigma: float) -> str:
    """Return the text of instrument.toml of a campaign. sigma: standard deviation of the instrument [m]"""
    lines = ["schema = 1", "[instrument]", f"sigma_mm = {1e3 * sigma:g}"]
    known = observations.known
    for pair, length, own in zip(known.between.tolist(), known.length, known.sigma, strict=True):
        between = ", ".join(f'"{observations.names[one]}"' for one in pair)
        lines += ["[[distance]]  # replace mm by the measured distance of the two sockets",
                  f"between = [{between}]", f"mm = {1e3 * length:g}", f"sigma_mm = {1e3 * own:g}"]  # fmt: skip
    return "\n".join(lines) + "\n"


def _write_moves(campaign: PoseCampaign, folder: Path) -> None:
    """Write programs of joint moves to the start of each approach, then to the pose, with a stop at every point."""
    plan = campaign.plan
    if plan.job is None or not plan.job.output.programs:
        return
    n = len(campaign.poses)
    comments = [
        f"compplan: {n} poses to measure for {plan.name}",
        "every second point is a pose: stop there, let it settle, measure",
        "loads change between poses as campaign.csv says",
    ]
    moves = np.ones(2 * n, bool)
    program = build_program(
        plan.robot, campaign.poses.log.q, np.zeros(2 * n), moves,
        name=f"{plan.job.file.stem}_poses", comments=comments, exact=moves,
    )  # fmt: skip
    for language in plan.job.output.programs:
        write_program(program, language, folder, any_brand=plan.job.output.any_brand)


def summarise_campaign(campaign: PoseCampaign) -> dict[str, Any]:
    """Return the content of campaign.json."""
    choice, design, equipment = campaign.choice, campaign.design, campaign.equipment
    return {
        "schema": 1, "name": campaign.plan.name, "purpose": "path", "robot": campaign.plan.robot.name,
        "poses": len(choice.rows), "rows_of_log": campaign.log,
        "error_band_mm": {
            "p95_max_now": choice.greatest[0] * 1e3, "p95_max_after": choice.greatest[-1] * 1e3,
            "p95_max_after_each": (choice.greatest * 1e3).tolist(),
            "p95_rms_after_each": (choice.rms * 1e3).tolist(), "p95_max_floor": float(design.floor.max()) * 1e3,
        },
        "parameters_alone_p95_rms_mm": {
            "now": campaign.design.model_band(campaign.start) * 1e3,
            "designed": campaign.design.model_band(choice.covariance) * 1e3,
        },
        "stop_after": choice.enough, "says": describe_campaign(campaign).replace("\u00a0", " "),
        "remaining": [{"unknown": name, "share_of_variance": share} for name, share in campaign.rest],
        "ways_that_touch": [int(k) + 1 for k in campaign.touching], "instrument": equipment.instrument,
        "stands": [
            {"label": one.label, "position_mm": (1e3 * one.place).round(1).tolist(), "says": one.instruction}
            for one in campaign.fixtures
        ],
        "instrument_sigma_mm": equipment.sigma * 1e3, "weights_kg": list(equipment.weights),
        "pull_N": equipment.pull, "register": list(equipment.frames), "notes": list(campaign.notes),
        "made_by": describe_origin(),
    }  # fmt: skip


def describe_campaign(campaign: PoseCampaign) -> str:
    """Describe the number of useful poses and the expected reduction of the 95 % band."""
    choice, every = campaign.choice, len(campaign.choice.rows)
    useful = every if choice.enough is None else choice.enough
    change = format_mm_change(float(choice.greatest[0]), float(choice.greatest[useful]))
    head = f"{useful} of {every} poses give nearly all the gain" if useful < every else f"All {every} poses are needed"
    if campaign.lacks_load:
        head = f"Without load the {every} poses do not determine the compliances, the largest cause"
    text = f"{head}: at the worst point of the path the 95 % band narrows {change}."
    if useful == 0:
        loads = " without load" if campaign.lacks_load else ""
        text = f"No further pose{loads} is worth measuring: none narrows the 95 % band of this path."
    return f"{text} The {campaign.log} measured rows of --log are included." if campaign.log else text


def _render(campaign: PoseCampaign) -> str:
    """Return the page: poses, expected 95 % band, remaining uncertainty."""
    plan = campaign.plan
    figure = draw_cell(plan.robot, plan.q, plan.task.position, beside=campaign.poses.tip)
    tip, at = np.unique(campaign.poses.tip[:-1].round(2), axis=0, return_inverse=True)
    labels = [", ".join(str(k + 1) for k in np.flatnonzero(at == place)) for place in range(len(tip))]
    dots = "the tip at the poses, numbered"
    if campaign.fixtures:
        tip, labels = np.array([one.place for one in campaign.fixtures]), [one.label for one in campaign.fixtures]
        dots = "where sockets or gauges are put up"
    figure.add(
        "scatter3d", x=1e3 * tip[:, 0], y=1e3 * tip[:, 1], z=1e3 * tip[:, 2], mode="markers+text", name="poses",
        text=labels, marker={"size": 5, "color": CATEGORIES[1]},
    )  # fmt: skip
    scene = Chart(figure, f"Dots: {dots}. Line: the path.", 460)
    sections = [
        Section("Poses", [scene, _list_poses(campaign)],
                "In the order of measuring. Approach each from the stated side, let it settle, then measure."),
        Section("What remains", [list_leading(campaign.rest)], "What would narrow the band most afterwards."),
    ]  # fmt: skip
    if campaign.fixtures:
        rows = [[one.label, *(float(v) for v in 1e3 * one.place), one.instruction] for one in campaign.fixtures]
        table = DataTable(["label", *(f"{name} [mm, 4]" for name in "xyz"), "put up"], rows)
        about = "In the robot's base frame. A few centimetres off is close enough unless the line states less."
        sections.insert(2, Section("Where it stands", [table], about))
    return render_page(
        f"{plan.name}: {len(campaign.poses) - 1} poses to measure", open_campaign(campaign), sections,
        kind=f"Campaign, {plan.robot.name}", notes=campaign.notes,
        provenance=describe_robot(plan.robot, [("known from", campaign.design.known.source)]),
    )  # fmt: skip


def open_campaign(campaign: PoseCampaign) -> Summary:
    """Return the first screen: expected 95 % band after the poses."""
    choice = campaign.choice
    now, then = float(choice.greatest[0]), float(choice.greatest[-1])
    useful = len(choice.rows) if choice.enough is None else choice.enough
    tone = "good" if then < 0.8 * now or (campaign.log and useful == 0) else "unsure"
    figures = [
        (format_mm(now), "95 % band now, at the worst point of the path (of the whole cut it is wider, see plan)"),
        (format_mm(then), f"expected there after all {len(choice.rows)} poses", tone),
        (str(useful), f"poses to measure; each further one narrows the rms band by less than {format_percent(WORTH)}"),
    ][: 2 if choice.enough is None else 3]
    count, floor = np.arange(float(len(choice.rms))), float(campaign.design.floor.max())
    lines = (Curve("at the worst point", count, 1e3 * choice.greatest, "after", "lines+markers"),
             Curve("rms", count, 1e3 * choice.rms, 3, "lines+markers"))  # fmt: skip
    level = (1e3 * floor, "limit at the worst point")
    chart = draw_curves(Curves("", "poses measured", "95 % band [mm]", lines, level))
    caption = (
        f"Dashed: {format_length(floor)} remain at the worst point, from force, repeatability and unmodelled errors."
        " A measured part narrows those (compplan learn)."
    )
    frames = f" --register {','.join(campaign.equipment.frames)}" if campaign.equipment.frames else ""
    if campaign.equipment.instrument != "tracker":
        frames = f" --instrument OUT/instrument.toml{frames}"
    robot = "ROBOT" if campaign.plan.job is None else campaign.plan.job.robot
    some = f"the poses of rank 1 to {useful} (or all)" if 0 < useful < len(choice.rows) else "the poses"
    todo = f"Measure {some} in the order of campaign.csv and fill in their readings there, then run: compplan"
    todo += f" diagnose OUT/campaign.csv --robot {robot}{frames} --out updated"
    if campaign.lacks_load:
        todo = f"Run it again with --weights-kg 0,60 or --pull-N 400. Or {todo[:1].lower()}{todo[1:]}"
    elif useful == 0:
        todo = "Load the tool at the poses (--weights-kg, --pull-N), or cut and measure a part, then run: compplan"
        todo += f" learn JOB MEASURED.csv --robot {robot}"
    poses = ", ".join(str(k + 1) for k in campaign.touching)
    stops = [f"On the straight joint move to pose {poses} the arm collides: move it around by hand."] if poses else []
    return Summary(describe_campaign(campaign), tone, figures, Chart(chart, caption, 340), todo, stops)


def _list_poses(campaign: PoseCampaign) -> DataTable:
    robot, poses = campaign.plan.robot, campaign.poses
    scale, rows = np.where(robot.prismatic, 1e3, 180 / np.pi), list[list[Any]]()
    for k in range(len(poses)):
        again, pull = k == len(poses) - 1, poses.wrench[k, :2]
        axis = int(np.abs(pull).argmax())
        force = f"{abs(pull[axis]):.0f} N along {'-' if pull[axis] < 0 else '+'}{'xyz'[axis]}".replace(" ", "\u00a0")
        rows.append(
            [Cell("1 again", "muted") if again else k + 1, None if again else int(campaign.rank[k]),
             *(float(v) for v in poses.q[k] * scale), "rising" if poses.approach_positive[k] else "falling",
             f"{poses.weight[k]:g} kg" if poses.weight[k] else "none", force if pull.any() else "none",
             *(float(v) for v in 1e3 * poses.tip[k])]
        )  # fmt: skip
    joints = [f"q{k + 1} [{'mm' if slides else 'deg'}, 5]" for k, slides in enumerate(robot.prismatic)]
    columns = ["pose", "rank", *joints, "approach", "weight", "pull [base axes]", *(f"{a} [mm, 5]" for a in "xyz")]
    caption = "Rank 1 narrows the band most. x, y, z: loaded tool tip, base frame."
    return DataTable(columns, rows, caption, scroll=24)
