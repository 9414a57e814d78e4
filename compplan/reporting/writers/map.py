"""What `compplan map` writes: map.json, the pictures and report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json
from compplan.io.transaction import replace_folder
from compplan.reporting import Column, Columns, PageTable, Picture, Section, describe_robot, write_page
from compplan.reporting.maps.maps import DeflectionMap
from compplan.reporting.maps.pictures import Panel, deflection_panels, draw_deflection, draw_joint_map
from compplan.reporting.maps.reach import ELBOWS
from compplan.reporting.maps.survey import ROWS, WRIST_FOR_QUALITY_DEG, RobotMaps
from compplan.reporting.page import Block, KeyFigure, Summary
from compplan.robot import Array

#: What the lines of a map mean.
LINES = (
    "White lines: contours. Black line: limit of reach inside the joint limits. Dotted line: the stiffer posture "
    "changes from elbow up to elbow down. Cross: maximum. The arm is drawn where the worst unit force has its maximum."
)


def write_map(result: RobotMaps, folder: Path) -> None:
    """Write map.json, the pictures and report.html into a folder."""
    table = result.summary()
    for name, plane in result.planes.items():
        table["planes"][name] |= _arrays(plane, result.quality[name])
    table["dexterity_over_joints"] = {
        "joints": [result.robot.joint_names[j] for j in result.dexterity.joints],
        "first_deg": _rounded(np.degrees(result.dexterity.first)),
        "second_deg": _rounded(np.degrees(result.dexterity.second)),
        "inverse_condition": _rounded(result.dexterity.inverse_condition),
    }
    table["made_by"] = describe_origin()
    pictures = draw_maps(result)
    with replace_folder(folder, "map") as part:
        for file, (png, _) in pictures.items():
            (part / file).write_bytes(png)
        write_json(part / "map.json", table, indent=None)
        _write_report(result, pictures, part / "report.html")


def draw_maps(result: RobotMaps) -> dict[str, tuple[bytes, str]]:
    """Draw the pictures: file name, and the PNG with its caption."""
    posture = {"straight": "wrist straight", "down": "tool down", "outward": "tool outward"}[result.settings.posture]
    where = {
        "horizontal": f"z = {result.settings.height * 1e3:.0f} mm",
        "vertical": f"azimuth {np.degrees(result.settings.azimuth):.0f} deg",
    }
    pictures = {}
    for name, plane in result.planes.items():
        title = f"{result.robot.name}: {name} plane, {where[name]}, {posture}"
        panels = deflection_panels(plane, result.quality[name])
        pictures[f"map_{name}.png"] = (draw_deflection(result.robot, plane, panels, title), LINES)
    names = tuple(result.robot.joint_names[j] for j in result.dexterity.joints)
    caption = (
        "Inverse condition number of the Jacobian over the characteristic length of "
        f"{result.dexterity.length * 1e3:.0f} mm. Wrist joints stand at {WRIST_FOR_QUALITY_DEG:.0f} deg, the first "
        "joint in the middle of its limits."
    )
    png = draw_joint_map(result.dexterity, [], (names[0], names[1]), "Dexterity 1/κ (1 is best)")
    pictures["dexterity.png"] = (png, caption)
    return pictures


def _arrays(plane: DeflectionMap, quality: Array) -> dict[str, Any]:
    table = {
        "u_mm": _rounded(plane.plane.u * 1e3),
        "v_mm": _rounded(plane.plane.v * 1e3),
        "level_mm" if plane.plane.name == "horizontal" else "level_deg": (
            plane.plane.level * 1e3 if plane.plane.name == "horizontal" else float(np.degrees(plane.plane.level))
        ),
        "worst_unit_force_map_um_per_N": _rounded(plane.best.worst * 1e6),
        "under_wrench_map_mm": _rounded(plane.best.under_wrench * 1e3),
        "full_minus_reduced_map_um_per_N": _rounded(plane.best.reduced_gap * 1e6),
        "inverse_condition_map": _rounded(quality),
        "elbow_map": [[None if k < 0 else ELBOWS[k] for k in row] for row in plane.chosen],
    }
    if not np.isfinite(plane.best.reduced_gap).any():
        del table["full_minus_reduced_map_um_per_N"]
    return table


def _rounded(values: Array) -> Any:
    """Turn an array into nested lists of five significant digits, NaN into null."""
    if values.ndim > 1:
        return [_rounded(row) for row in values]
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def _write_report(result: RobotMaps, pictures: dict[str, tuple[bytes, str]], file: Path) -> None:
    summary = result.summary()
    worst = {name: plane["worst_unit_force_um_per_N"] for name, plane in summary["planes"].items()}
    lede = (
        f"Under the worst unit force the tool of {result.robot.name} yields {worst['horizontal']['mean']:.2f} µm/N on "
        f"average over the horizontal plane and at most {worst['horizontal']['max']:.2f} µm/N; over the vertical plane "
        f"{worst['vertical']['mean']:.2f} and {worst['vertical']['max']:.2f} µm/N."
    )
    rows = []
    for name, plane in summary["planes"].items():
        for key, title in ROWS.items():
            if key in plane:
                rows.append([name, title, *(plane[key][k] for k in ("min", "mean", "max"))])
    columns = [Column("plane"), Column("quantity"), Column("least"), Column("mean"), Column("greatest")]
    sections = [
        Section("Figures", [PageTable(columns, rows, "Over the reached points, in the stiffer elbow configuration.")]),
        *(Section(f"{name.capitalize()} plane", _show_plane(result, name)) for name in result.planes),
        Section("Dexterity over the second and third joint", [Columns([[Picture(*pictures["dexterity.png"])], []])]),
    ]
    assumptions = ["tool axis and roll of the tool on the grid are those of the chosen posture, not of a job"]
    if result.reduced_note:
        assumptions.append(f"reduced model: {result.reduced_note}")
    facts = [("poses", str(summary["poses"])), ("time for the maps", f"{result.seconds:.2f} s")]
    write_page(
        file,
        f"Deflection maps of {result.robot.name}",
        lede,
        sections,
        kind="Map",
        opening=_open(result, worst),
        provenance=describe_robot(result.robot, facts, assumptions),
    )


def _show_plane(result: RobotMaps, name: str) -> list[Block]:
    """Return a picture a quantity, side by side where there is room, and what their lines mean."""
    plane = result.planes[name]
    panels = deflection_panels(plane, result.quality[name])
    pictures = [Picture(draw_deflection(result.robot, plane, [panel], ""), "", panel.title) for panel in panels]
    return [Columns([[picture] for picture in pictures]), LINES]


def _open(result: RobotMaps, worst: dict[str, Any]) -> Summary:
    """Say how soft the arm is where it works, and where it is stiffest."""
    flat = worst["horizontal"]
    verdict = (
        f"Under 1000 N the tool of {result.robot.name} gives way by {flat['mean']:.2f} mm on average, by "
        f"{flat['min']:.2f} mm where the arm is stiffest."
    )
    figures = [
        KeyFigure(f"{flat['min']:.2f} mm", "under 1000 N in the worst direction, where the arm is stiffest"),
        KeyFigure(f"{flat['mean']:.2f} mm", "mean over the horizontal plane"),
        KeyFigure(f"{flat['max']:.2f} mm", "where it is softest"),
    ]
    plane = result.planes["horizontal"]
    panel = Panel("Under 1000 N in the worst direction", plane.best.worst * 1e6, "mm")
    caption = f"Deflection of the tool over the plane z = {result.settings.height * 1e3:.0f} mm, seen from above."
    picture = Picture(draw_deflection(result.robot, plane, [panel], result.robot.name), caption)
    todo = "Put the part where the map is low: compplan place JOB looks for the place."
    return Summary(verdict, "", figures, picture, todo)
