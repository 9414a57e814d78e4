"""The part of a plan's page about posture: the map with the chosen line, what the posture costs, the clearance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.reporting import figure as go
from compplan.reporting.along_path import Stations, draw_lines
from compplan.reporting.page import Block, Chart, Column, PageTable, Row, Section
from compplan.reporting.style import AFTER, LIMIT, NEUTRAL, SEQUENTIAL, format_length, format_number
from compplan.robot import Array

if TYPE_CHECKING:
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


def show_posture(
    posture_choice: PostureSummary, stations: Stations, clearance: ClearanceProfile | None = None,
    both: tuple[dict[str, float], dict[str, float]] | None = None,
) -> Section:  # fmt: skip
    """Show how the posture was chosen.

    Args:
        posture_choice: The posture along the path.
        stations: Where the waypoints are.
        clearance: Clearance along the path, where it was asked for.
        both: Costs of the graph's way and of the plain one (one configuration, the tool's x as the job has it) or None.
    """
    blocks: list[Block] = [show_map(posture_choice.map), _list_costs(posture_choice, both)]
    if clearance is not None:
        blocks.append(draw_clearance(stations, clearance))
    lede = f"Rotation about the tool axis against path length, preset {posture_choice.settings.preset!r}."
    if len(posture_choice.map.spin) == 1:
        lede = f"The rotation about the tool axis is held, preset {posture_choice.settings.preset!r}."
    return Section("Posture", blocks, lede)


def show_map(picture: PostureMap) -> Chart:
    """Show the map, or a line where there is only one rotation."""
    expected = "the deviation expected to remain after compensation, under the assumed errors of wrench and compliance."
    if len(picture.spin) == 1:
        return Chart(draw_held(picture), f"Line: {expected}", 280)
    told = f"Colour: {expected} Line: the rotation chosen. Dots: near a singularity."
    level = np.where(picture.reason == 0, picture.sensitivity, np.nan)
    most, least = np.nanmax(level, axis=1, initial=0.0), np.nanmin(level, axis=1, initial=np.inf)
    if np.isfinite(level).any() and float((most - least).max()) < ALIKE * float(most.max()):
        told += " All rotations are alike here."
    return Chart(draw_posture_map(picture), told, 420)


def draw_held(picture: PostureMap) -> Any:
    """Draw the remaining deviation along the path where the rotation about the tool axis is held.

    Args:
        picture: The map, of one rotation.
    """
    line = go.Scatter(
        x=1e3 * picture.length, y=1e3 * picture.sensitivity[:, 0], mode="lines", line={"color": AFTER, "width": 1.6},
        hovertemplate="%{x:.1f} mm: %{y:.3g} mm<extra></extra>",
    )  # fmt: skip
    figure = go.Figure(line)
    figure.update_xaxes(title_text="along the path, mm")
    figure.update_yaxes(title_text="remaining, mm", rangemode="tozero")
    return figure


def draw_posture_map(picture: PostureMap) -> Any:
    """Draw sensitivity over path length and rotation about the tool axis, what forbids postures, and the chosen line.

    Args:
        picture: The map.
    """
    from compplan.planning.posture.lattice import REASONS

    length, spin = 1e3 * picture.length, np.degrees(picture.spin)
    figure = go.Figure()
    for reason, colour in FORBIDDEN.items():
        field = np.where(picture.reason == reason, 1.0, np.nan)
        if np.isfinite(field).any():
            figure.add_trace(_field(field, length, spin, [[0, colour], [1, colour]], REASONS[reason]))
            swatch = {"symbol": "square", "size": 10, "color": colour}
            figure.add_scatter(x=[None], y=[None], mode="markers", marker=swatch, name=REASONS[reason])
    usable = np.isin(picture.reason, [0, SINGULAR])
    level = np.where(usable, 1e3 * picture.sensitivity, np.nan)
    known = level[np.isfinite(level) & (level > 0)]
    low, high = np.percentile(known, (1, 98)) if len(known) else (0.0, 1.0)
    shown = _field(level, length, spin, [list(stop) for stop in SEQUENTIAL], "sensitivity")
    bar = {"title": {"text": "remaining, mm", "side": "top"}, "thickness": 12, "outlinewidth": 0}
    hover = "%{x:.1f} mm, %{y:.0f} deg: %{z:.3g} mm<extra></extra>"
    shown.update(zmin=float(low), zmax=float(high), showscale=True, colorbar=bar, hovertemplate=hover, hoverinfo=None)
    figure.add_trace(shown)
    rows, columns = np.nonzero(picture.reason == SINGULAR)
    if len(rows):
        dots = {"size": 2.5, "color": NEUTRAL}
        figure.add_scatter(
            x=length[rows], y=spin[columns], mode="markers", marker=dots, name=REASONS[SINGULAR], hoverinfo="skip"
        )
    chosen = np.degrees(picture.chosen)
    lifted = np.mod(chosen - spin.min(), 360.0) + spin.min()
    broken = np.insert(lifted, np.flatnonzero(np.abs(np.diff(lifted)) > 180) + 1, np.nan)
    along = np.insert(length, np.flatnonzero(np.abs(np.diff(lifted)) > 180) + 1, np.nan)
    for width, colour, legend in ((5.0, "#ffffff", False), (2.4, "#101418", True)):
        line = {"color": colour, "width": width}
        figure.add_scatter(
            x=along, y=broken, mode="lines", line=line, name="chosen", showlegend=legend, hoverinfo="skip"
        )
    figure.update_xaxes(title_text="along the path, mm", showgrid=False)
    figure.update_yaxes(title_text="rotation about the tool axis, deg", showgrid=False, dtick=45)
    return figure


def draw_clearance(stations: Stations, clearance: ClearanceProfile) -> Chart:
    """Draw how far arm and tool keep clear along the path.

    Args:
        stations: Where the waypoints are.
        clearance: The clearance at the waypoints.
    """
    waypoint, contact = clearance.least
    limit = (1e3 * clearance.wanted, f"wanted {1e3 * clearance.wanted:g} mm")
    series = {"clearance": 1e3 * clearance.distance}
    colours = (AFTER if contact.distance >= clearance.wanted else LIMIT,)
    figure = draw_lines(stations, series, "mm", title="clearance", colours=colours, limit=limit)
    least = format_length(contact.distance) if contact.distance > 0 else "none: they overlap"
    caption = (
        f"Distance of arm and tool from part and fixture. Least at waypoint {waypoint}: {least}, "
        f"between {contact.first} and {contact.second}."
    )
    return Chart(figure, caption, 280)


def _field(values: Array, length: Array, spin: Array, scale: list[list[Any]], name: str) -> Any:
    return go.Heatmap(
        z=values.T.astype(np.float32), x=length.astype(np.float32), y=spin.astype(np.float32), colorscale=scale,
        showscale=False, name=name, hoverinfo="name", hoverongaps=False,
    )  # fmt: skip


def _list_costs(posture_choice: PostureSummary, both: tuple[dict[str, float], dict[str, float]] | None) -> PageTable:
    rows: list[Row] = []
    chosen, plain = both or (posture_choice.costs, {})
    for key, value in chosen.items():
        words, unit = COSTS.get(key, (key.replace("_", " "), ""))
        beside = f"{format_number(plain[key])}\u00a0{unit}".rstrip() if key in plain else "\u2013"
        other = [beside] if plain else []
        rows.append([words, f"{format_number(value)}\u00a0{unit}".rstrip(), *other])
    spin = np.degrees(posture_choice.spin)
    reach = f"{format_number(float(spin.min()))} to {format_number(float(spin.max()))}\u00a0deg"
    rows.append(["rotation about the tool axis", reach, *(["none"] if plain else [])])
    if posture_choice.changes:
        told = "; ".join(
            f"waypoint {waypoint}: {before} to {after}" for waypoint, before, after in posture_choice.changes
        )
        rows.append(["configuration changes", told, *(["none"] if plain else [])])
    if not plain:
        return PageTable([Column("what the posture costs"), Column("")], rows)
    names = ["the graph's way", "tool's x as the job has it"]
    names[posture_choice.instead_of is not None] += ": chosen"
    columns = [Column("what the posture costs"), *map(Column, names)]
    return PageTable(columns, rows, _weigh(chosen, plain))


def _weigh(found: dict[str, float], plain: dict[str, float]) -> str:
    """Set what the graph's way gains in accuracy against what it travels."""
    gain = {key: plain[key] - found[key] for key in ("sensitivity_rms_mm", "travel_error_rms_mm", "inertia_rms_mm")}
    parts = [
        f"{format_length(1e-3 * abs(gain[key]))} {'less' if gain[key] > 0 else 'more'} {words}"
        for key, words in (
            ("sensitivity_rms_mm", "remains after compensation"),
            ("travel_error_rms_mm", "comes from gears and lost motion (figures of the job or assumed)"),
            ("inertia_rms_mm", "from the inertia of the joints (estimated)"),
        )
        if abs(gain[key]) > 1e-5
    ]
    travel = format_number(found["joint_travel_deg"]), format_number(plain["joint_travel_deg"])
    return (
        f"Accuracy against joint travel: the graph's way travels {travel[0]} deg where the plain posture travels "
        f"{travel[1]}; {', '.join(parts) or 'both are as accurate'}."
    )


def list_uncertainties(posture_choice: PostureSummary) -> str:
    """Say which errors the choice of the posture assumes."""
    if posture_choice.settings.errors is not None:
        return f"posture: chosen for the smallest 95 % band; {posture_choice.settings.errors.source}"
    uncertainty = posture_choice.settings.uncertainty
    return (
        f"posture: errors of {100 * uncertainty.wrench:g} % of the wrench, {100 * uncertainty.compliance:g} % of the "
        f"compliances and {np.degrees(uncertainty.joint_zero):.3g} deg of the joint zeros are assumed"
    )
