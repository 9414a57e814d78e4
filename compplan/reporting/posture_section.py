"""The part of a plan's page about posture: the map with the chosen line, what the posture costs, the clearance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.io.display import Curve, Curves
from compplan.io.palette import AFTER, BEFORE, LIMIT, NEUTRAL
from compplan.io.quantities import format_length, format_number
from compplan.reporting import page
from compplan.reporting.along_path import Stations, draw_lines
from compplan.reporting.charts import Figure, draw_curves
from compplan.reporting.style import SEQUENTIAL
from compplan.robot import Robot

if TYPE_CHECKING:
    from compplan.planning.plan import Plan
    from compplan.planning.posture.clearance import ClearanceProfile
    from compplan.planning.posture.summary import PostureMap, PostureSummary

#: Why a posture cannot be used, and the colour it gets: out of reach, joint limit, collision, not wanted.
FORBIDDEN = {1: "#b9c0c7", 2: "#8e979f", 4: "#5c4a57", 5: "#d9dde1"}
SINGULAR = 3
#: Rotations whose remaining deviations differ by less than this share are alike.
ALIKE = 0.02
#: What each cost of a posture is, by its key.
COSTS = {
    "sensitivity_rms_mm": ("expected deviation that remains after compensation, rms", "mm"),
    "sensitivity_p95_mm": ("deviation that remains after compensation, 95 %", "mm"),
    "deviation_rms_mm": ("deviation before compensation, rms", "mm"),
    "limit_distance_deg": ("least distance from a joint limit", "deg"),
    "dexterity_min": ("least dexterity (inverse condition number)", ""),
    "joint_travel_deg": ("joint travel in all", "deg"),
    "travel_error_rms_mm": ("gear error and lost motion of the joints that travel, rms", "mm"),
    "inertia_rms_mm": ("bending by the inertia of the joints at the programmed feed, estimated, rms", "mm"),
    "time_s": ("time at the programmed feed", "s"),
    "driven_s": ("time of the run within the limits of the joints", "s"),
}
BAR = {"title": {"text": "remaining, mm", "side": "top"}, "thickness": 12, "outlinewidth": 0}
COLOURS = [list(stop) for stop in SEQUENTIAL]


def show_posture(plan: Plan, choice: PostureSummary, stations: Stations) -> page.Section:
    """Show how the posture along the path was chosen, and how far it keeps clear where that was asked for."""
    blocks: list[page.Block] = [show_map(choice.map), _list_costs(choice)]
    if plan.clearance is not None:
        blocks.append(_draw_clearance(stations, plan.clearance))
    lede = f"Rotation about the tool axis against path length, preset {choice.settings.preset!r}."
    if len(choice.map.spin) == 1:
        lede = f"The rotation about the tool axis is held, preset {choice.settings.preset!r}."
    return page.Section("Posture", blocks, lede)


def show_map(picture: PostureMap) -> page.Chart:
    """Show the remaining deviation over path length and rotation, or as a line where the rotation is held."""
    expected = "the deviation expected to remain after compensation, under the assumed errors of wrench and compliance."
    if len(picture.spin) == 1:
        line = Curve("remaining", 1e3 * picture.length, 1e3 * picture.sensitivity[:, 0], "after")
        figure = draw_curves(Curves("", "along the path [mm]", "remaining [mm]", (line,)))
        return page.Chart(figure, f"Line: {expected}", 280)
    told = f"Colour: {expected} Line: the rotation chosen. Dots: near a singularity."
    level = np.where(picture.reason == 0, picture.sensitivity, np.nan)
    most, least = np.nanmax(level, axis=1, initial=0.0), np.nanmin(level, axis=1, initial=np.inf)
    if np.isfinite(level).any() and float((most - least).max()) < ALIKE * float(most.max()):
        told += " All rotations are alike here."
    return page.Chart(_draw_map(picture), told, 420)


def _draw_map(picture: PostureMap) -> Figure:
    """Draw sensitivity over path length and rotation about the tool axis, what forbids postures, the chosen line."""
    from compplan.planning.posture.lattice import REASONS

    figure, length, spin = Figure(), 1e3 * picture.length, np.degrees(picture.spin)
    field: dict[str, Any] = {"x": length, "y": spin, "hoverongaps": False}
    for reason, colour in FORBIDDEN.items():
        here = picture.reason == reason
        if here.any():
            flat = [[0, colour], [1, colour]]
            figure.add("heatmap", z=np.where(here, 1.0, np.nan).T, colorscale=flat, showscale=False,
                       name=REASONS[reason], hoverinfo="name", **field)  # fmt: skip
            swatch = {"symbol": "square", "size": 10, "color": colour}
            figure.line([None], [None], REASONS[reason], mode="markers", marker=swatch)
    level = np.where(np.isin(picture.reason, [0, SINGULAR]), 1e3 * picture.sensitivity, np.nan)
    known = level[np.isfinite(level) & (level > 0)]
    low, high = np.percentile(known, (1, 98)) if len(known) else (0.0, 1.0)
    figure.add("heatmap", z=level.T, colorscale=COLOURS, zmin=float(low), zmax=float(high), colorbar=BAR,
               hovertemplate="%{x:.1f} mm, %{y:.0f} deg: %{z:.3g} mm<extra></extra>", **field)  # fmt: skip
    rows, columns = np.nonzero(picture.reason == SINGULAR)
    if len(rows):
        dots = {"size": 2.5, "color": NEUTRAL}
        figure.line(length[rows], spin[columns], REASONS[SINGULAR], mode="markers", marker=dots, hoverinfo="skip")
    lifted = np.mod(np.degrees(picture.chosen) - spin.min(), 360.0) + spin.min()
    jumps = np.flatnonzero(np.abs(np.diff(lifted)) > 180) + 1
    along, broken = np.insert(length, jumps, np.nan), np.insert(lifted, jumps, np.nan)
    for width, colour in ((5.0, "#ffffff"), (2.4, "#101418")):
        line = {"color": colour, "width": width}
        figure.line(along, broken, "chosen", line=line, showlegend=width < 5.0, hoverinfo="skip")
    figure.axis("x", title="along the path, mm", showgrid=False)
    figure.axis("y", title="rotation about the tool axis, deg", showgrid=False, dtick=45)
    return figure


def show_extra_axis(robot: Robot, choice: PostureSummary) -> list[page.Section]:
    """Show the remaining deviation by position of an extra axis along the path; nothing where the robot has none."""
    picture = choice.map
    if not picture.held_grid.size:
        return []
    scale, unit = (1e3, "mm") if robot.prismatic[0] else (180.0 / np.pi, "deg")
    figure, length = Figure(), 1e3 * picture.length
    figure.add("heatmap", x=length, y=scale * picture.held_grid, z=1e3 * picture.held_sensitivity.T, colorscale=COLOURS,
               colorbar=BAR)  # fmt: skip
    figure.line(length, scale * picture.held[:, 0], "chosen", line={"color": BEFORE, "width": 3})
    figure.axis("x", title="along the path, mm", showgrid=False)
    figure.axis("y", title=f"{robot.joint_names[0]}, {unit}", showgrid=False)
    caption = "Colour: least deviation that would remain over all rotations. Line: positions chosen."
    about = "Position of the extra axis against path length."
    return [page.Section("Extra axis", [page.Chart(figure, caption, height=340)], about)]


def _draw_clearance(stations: Stations, clearance: ClearanceProfile) -> page.Chart:
    """Draw how far arm and tool keep clear along the path."""
    waypoint, contact = clearance.least
    limit = (1e3 * clearance.wanted, f"wanted {1e3 * clearance.wanted:g} mm")
    colours = (AFTER if contact.distance >= clearance.wanted else LIMIT,)
    series = {"clearance": 1e3 * clearance.distance}
    figure = draw_lines(stations, series, "mm", title="clearance", colours=colours, limit=limit)
    least = format_length(contact.distance) if contact.distance > 0 else "none: they overlap"
    between = f"between {contact.first} and {contact.second}"
    caption = f"Distance of arm and tool from part and fixture. Least at waypoint {waypoint}: {least}, {between}."
    return page.Chart(figure, caption, 280)


def _list_costs(choice: PostureSummary) -> page.DataTable:
    """List what the posture costs, beside the plain one where that is known."""
    chosen, plain = choice.instead_of or choice.costs, choice.plain or {}
    rows: list[page.Row] = []
    for key in chosen:
        words, unit = COSTS.get(key, (key.replace("_", " "), ""))
        shown = [
            f"{format_number(side[key])}\u00a0{unit}".rstrip() if key in side else "\u2013" for side in (chosen, plain)
        ]
        rows.append([words, *shown[: 2 if plain else 1]])
    none, spin = ["none"] if plain else [], np.degrees(choice.spin)
    reach = f"{format_number(float(spin.min()))} to {format_number(float(spin.max()))}\u00a0deg"
    rows.append(["rotation about the tool axis", reach, *none])
    if choice.changes:
        told = "; ".join(f"waypoint {waypoint}: {before} to {after}" for waypoint, before, after in choice.changes)
        rows.append(["configuration changes", told, *none])
    if not plain:
        return page.DataTable(["what the posture costs", ""], rows)
    names = ["the graph's way", "tool's x as the job has it"]
    names[choice.instead_of is not None] += ": chosen"
    return page.DataTable(["what the posture costs", *names], rows)


def list_uncertainties(choice: PostureSummary) -> str:
    """Say which errors the choice of the posture assumes."""
    if choice.settings.errors is not None:
        return f"posture: chosen for the smallest 95 % band; {choice.settings.errors.source}"
    uncertainty = choice.settings.uncertainty
    return (
        f"posture: errors of {100 * uncertainty.wrench:g} % of the wrench and {100 * uncertainty.compliance:g} % of "
        "the compliances are assumed"
    )
