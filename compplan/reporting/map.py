"""Outputs of `compplan map`: map.json, the pictures and report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.reporting.maps.pictures import Panel, deflection_panels, draw_deflection
from compplan.reporting.maps.survey import DeflectionMap, RobotMaps
from compplan.reporting.page import DataTable, Picture, Section, Summary, render_page
from compplan.reporting.provenance import describe_robot
from compplan.robot import Array

#: Quantities of a plane, by their keys in map.json.
ROWS = {
    "worst_unit_force_um_per_N": "deflection under the worst unit force [µm/N]",
    "under_wrench_mm": "deflection under the given wrench [mm]",
    "inverse_condition": "dexterity 1/κ",
}
#: Legend of the lines of a map.
LINES = (
    "White lines: contours. Black line: limit of reach inside the joint limits. Cross: maximum. The arm is drawn where "
    "the worst unit force has its maximum."
)
POSTURE_WORDS = {"straight": "wrist straight", "down": "tool down", "outward": "tool outward"}


def write_map(result: RobotMaps, folder: Path) -> Summary:
    """Write map.json, the pictures and report.html into a folder; return the first screen."""
    table = result.summary()
    for name, plane in result.planes.items():
        table["planes"][name] |= _list_values(plane, result.quality[name])
    table["made_by"] = describe_origin()
    pictures, opening = _draw_maps(result), open_map(result)
    with replace_folder(folder, "map") as part:
        for file, picture in pictures.items():
            (part / file).write_bytes(picture.png)
        write_json(part / "map.json", table, indent=None)
        write_text(part / "report.html", _render(result, pictures, opening))
    return opening


def _draw_maps(result: RobotMaps) -> dict[str, Picture]:
    """Draw the pictures, by file name."""
    settings, pictures = result.settings, dict[str, Picture]()
    where = {"horizontal": f"z = {settings.height * 1e3:.0f} mm",
             "vertical": f"azimuth {np.degrees(settings.azimuth):.0f} deg"}  # fmt: skip
    for name, plane in result.planes.items():
        title = f"{result.robot.name}: {name} plane, {where[name]}, {POSTURE_WORDS[settings.posture]}"
        panels = deflection_panels(plane, result.quality[name])
        pictures[f"map_{name}.png"] = Picture(draw_deflection(result.robot, plane, panels, title), LINES, title)
    return pictures


def _list_values(plane: DeflectionMap, quality: Array) -> dict[str, Any]:
    flat, level = plane.plane.name == "horizontal", plane.plane.level
    return {
        "u_mm": _round(plane.plane.u * 1e3), "v_mm": _round(plane.plane.v * 1e3),
        "level_mm" if flat else "level_deg": level * 1e3 if flat else float(np.degrees(level)),
        "worst_unit_force_map_um_per_N": _round(plane.worst * 1e6),
        "under_wrench_map_mm": _round(plane.under_wrench * 1e3),
        "inverse_condition_map": _round(quality),
    }  # fmt: skip


def _round(values: Array) -> Any:
    """Convert an array to nested lists of five significant digits, NaN to null."""
    if values.ndim > 1:
        return [_round(row) for row in values]
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def _render(result: RobotMaps, pictures: dict[str, Picture], opening: Summary) -> str:
    """Return the page: figures of deflection and dexterity by plane, and the maps."""
    summary, robot = result.summary(), result.robot
    rows = [
        [name, title, *(plane[key][k] for k in ("min", "mean", "max"))]
        for name, plane in summary["planes"].items() for key, title in ROWS.items() if key in plane
    ]  # fmt: skip
    caption = "Over the reached points, in the stiffest posture."
    sections = [
        Section("Figures", [DataTable(["plane", "quantity", "least", "mean", "greatest"], rows, caption)]),
        *(Section(f"{name.capitalize()} plane", [pictures[f"map_{name}.png"]]) for name in result.planes),
    ]
    assumptions = ["tool axis and roll of the tool on the grid are those of the chosen posture, not of a job"]
    facts = [("poses", str(summary["poses"])), ("time for the maps", f"{result.seconds:.2f} s")]
    return render_page(
        f"Deflection maps of {robot.name}", opening, sections, kind="Map",
        provenance=describe_robot(robot, facts, assumptions),
    )  # fmt: skip


def open_map(result: RobotMaps) -> Summary:
    """Return the first screen: deflection over the horizontal plane under the worst force."""
    flat, plane = result.summary()["planes"]["horizontal"]["worst_unit_force_um_per_N"], result.planes["horizontal"]
    verdict = (
        f"Under 1000 N the tool of {result.robot.name} deflects by {flat['mean']:.2f} mm on average, by "
        f"{flat['min']:.2f} mm where the arm is stiffest."
    )
    figures = [
        (f"{flat['min']:.2f} mm", "under 1000 N in the worst direction, where the arm is stiffest"),
        (f"{flat['mean']:.2f} mm", "mean over the horizontal plane"),
        (f"{flat['max']:.2f} mm", "where it is softest"),
    ]
    panel = Panel("Under 1000 N in the worst direction", plane.worst * 1e6, "mm")
    caption = f"Deflection of the tool over the plane z = {result.settings.height * 1e3:.0f} mm, seen from above."
    picture = Picture(draw_deflection(result.robot, plane, [panel], result.robot.name), caption)
    todo = "Put the part where the map is low: compplan place JOB finds it."
    return Summary(verdict, "", figures, picture, todo)
