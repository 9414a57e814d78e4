"""What `compplan campaign` writes: campaign.csv to fill in, programs to the poses, campaign.json, report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.writers import build_program, write_program
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.learning.campaign import PoseCampaign
from compplan.measurement.observations import DISTANCE, READING, Observations
from compplan.reporting.campaign_page import describe_campaign, write_campaign_page
from compplan.robot import Array
from compplan.toolpath.toolpath import WRENCH_HEADERS


def write_campaign(campaign: PoseCampaign, folder: Path) -> dict[str, Any]:
    """Write a designed campaign and return what campaign.json holds.

    Args:
        campaign: The campaign.
        folder: The folder.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    with replace_folder(folder, "campaign") as part:
        write_log(campaign, part / "campaign.csv")
        if campaign.poses.sights is not None:
            text = describe_instrument(campaign.poses.sights, campaign.equipment.sigma)
            write_text(part / "instrument.toml", "".join(f"# {stand.says}\n" for stand in campaign.stands) + text)
        write_moves(campaign, part)
        write_campaign_page(campaign, part / "report.html")
        summary = {**summarise_campaign(campaign), "files": [*map(str, list_files(part)), "campaign.json"]}
        write_json(part / "campaign.json", summary, indent=2)
    return summary


def write_log(campaign: PoseCampaign, file: Path) -> None:
    """Write the empty log, two rows a pose: where its approach begins, which stays empty, and the pose to measure.

    The first of them tells later readers from which side the joints came.
    """
    poses, n = campaign.poses, len(campaign.poses)
    columns: dict[str, object] = {"run": np.array(["static1"] * 2 * n)}
    columns |= campaign.plan.robot.joint_columns(poses.log.q)
    columns |= {header: poses.log.wrench[:, k] for k, header in enumerate(WRENCH_HEADERS)}
    columns |= sight_columns(poses.sights, n)
    columns["sigma_mm"] = np.full(2 * n, campaign.equipment.sigma * 1e3)
    write_table(file, columns, decimals=7)
    task = describe_task(campaign.equipment.instrument)
    todo = f"approach from the next row (it stays without a measurement), then {task}"
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    lines = [head]
    for k in range(n):
        load = f"{poses.weight[k]:g} kg" if poses.weight[k] else "no weight"
        x, y = poses.wrench[k, :2]
        pull = f", pull {x:g}, {y:g}, 0 N" if x or y else ""
        worth = f"{campaign.worth[k]} in worth" if k < n - 1 else "the first once more"
        lines += [f"# pose {k + 1} ({worth}): {load}{pull}; {todo}"]
        lines += rows[2 * k : 2 * k + 2]
    write_text(file, "\n".join(lines) + "\n")


def sight_columns(sights: Observations | None, poses: int) -> dict[str, object]:
    """Return the columns to fill in: positions, or what another instrument sees, in the second of two rows a pose.

    Args:
        sights: What the instrument sees; None: positions.
        poses: How many poses.
    """
    empty = np.full(2 * poses, np.nan)
    if sights is None:
        return {f"{axis}_mm": empty for axis in "xyz"}

    def second(values: Array) -> Array:
        return np.stack([np.full((poses, 3), np.nan), values], axis=1).reshape(-1, 3)

    columns: dict[str, object] = {}
    if sights.names:
        columns["contact"] = np.array([["", sights.names[one]] for one in sights.contact]).reshape(-1)
    else:
        columns |= {f"{axis}_mm": 1e3 * second(sights.origin)[:, k] for k, axis in enumerate("xyz")}
    if (sights.kind == READING).any():
        columns |= {f"dir_{axis}": second(sights.direction)[:, k] for k, axis in enumerate("ijk")}
        columns["reading_mm"] = empty
    if (sights.kind == DISTANCE).any():
        columns["distance_mm"] = empty
    return columns


#: What is to be done at a pose with another instrument than a tracker.
TASKS = {
    "sockets": "let the ball sit in the socket of the row and write the joints down as they are",
    "gauge": "write the reading of the row's gauge down, which grows along dir",
    "ball_bar": "hang the bar on the row's ball and write the distance of both balls' centres down",
}


def describe_task(instrument: str) -> str:
    """Say what is to be done at a pose."""
    return TASKS.get(instrument, "measure")


def describe_instrument(sights: Observations, sigma: float) -> str:
    """Return the text of instrument.toml for a campaign that is filled in. sigma: [m]"""
    lines = ["schema = 1", "[instrument]", f"sigma_mm = {1e3 * sigma:g}"]
    known = sights.known
    for pair, length, own in zip(known.between.tolist(), known.length, known.sigma, strict=True):
        between = ", ".join(f'"{sights.names[one]}"' for one in pair)
        lines += ["[[distance]]  # measure it: the plate's own, not the asked one", f"between = [{between}]",
                  f"mm = {1e3 * length:g}", f"sigma_mm = {1e3 * own:g}"]  # fmt: skip
    return "\n".join(lines) + "\n"


def write_moves(campaign: PoseCampaign, folder: Path) -> list[Path]:
    """Write programs of joint moves: to where each approach begins, then to the pose, stopping at every point."""
    plan = campaign.plan
    if plan.job is None or not plan.job.output.programs:
        return []
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
    files: list[Path] = []
    for language in plan.job.output.programs:
        files += write_program(program, language, folder, any_brand=plan.job.output.any_brand)
    return files


def summarise_campaign(campaign: PoseCampaign) -> dict[str, Any]:
    """Return the content of campaign.json."""
    choice, design, equipment = campaign.choice, campaign.design, campaign.equipment
    return {
        "schema": 1,
        "name": campaign.plan.name,
        "purpose": equipment.purpose,
        "robot": campaign.plan.robot.name,
        "poses": len(choice.rows),
        "rows_of_log": campaign.log,
        "error_band_mm": {
            "p95_max_now": choice.greatest[0] * 1e3,
            "p95_max_after": choice.greatest[-1] * 1e3,
            "p95_max_after_each": (choice.greatest * 1e3).tolist(),
            "p95_rms_after_each": (choice.rms * 1e3).tolist(),
            "p95_max_floor": float(design.floor.max()) * 1e3,
        },
        "parameters_alone_p95_rms_mm": {
            "now": campaign.model_part(campaign.start) * 1e3,
            "designed": campaign.model_part(choice.covariance) * 1e3,
        },
        "stop_after": choice.enough,
        "says": describe_campaign(campaign).replace("\u00a0", " "),
        "remaining": [{"unknown": name, "share_of_variance": share} for name, share in campaign.rest],
        "ways_that_touch": [int(k) + 1 for k in campaign.touching],
        "instrument": equipment.instrument,
        "stands": [
            {"label": stand.label, "position_mm": (1e3 * stand.place).round(1).tolist(), "says": stand.says}
            for stand in campaign.stands
        ],
        "instrument_sigma_mm": equipment.sigma * 1e3,
        "weights_kg": list(equipment.weights),
        "pull_N": equipment.pull,
        "register": list(equipment.frames),
        "notes": list(campaign.notes),
        "made_by": describe_origin(),
    }
