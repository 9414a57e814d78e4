"""The promise on a page: the band along the path against the tolerance, what makes it, and what would narrow it."""

from __future__ import annotations

import numpy as np

from compplan.reporting.along_path import Stations, draw_lines
from compplan.reporting.page import Block, Chart, Column, Fold, PageTable, Row, Section, TableCell
from compplan.reporting.style import CATEGORIES, format_length, format_percent, format_set_value
from compplan.uncertainty.band import PARTS, ErrorBand
from compplan.uncertainty.ladder import DO

#: What the parts are called.
WORDS = {
    "model": "parameters of the robot",
    "unexplained": "what no parameter explains",
    "repeatability": "repeatability",
    "force": "the force",
    "motion": "inertia and vibration",
    "placement": "place of the part",
}


def show_error_band(promise: ErrorBand, stations: Stations, tolerance: float) -> Section:
    """Show the band that holds the true tip with 95 %.

    Args:
        promise: The promise.
        stations: Where the waypoints are.
        tolerance: Greatest deviation that counts as within tolerance. [m]
    """
    evaluated = np.where(promise.cut, 1.0, np.nan)
    series = {"all together": 1e3 * promise.radius * evaluated}
    series |= {WORDS[name]: 1e3 * promise.parts[name] * evaluated for name in PARTS if promise.parts[name].any()}
    chart = draw_lines(
        stations,
        series,
        "mm",
        title="95 % band",
        colours=CATEGORIES,
        zero=True,
        limit=(1e3 * tolerance, f"tolerance {format_set_value(1e3 * tolerance)} mm"),
    )
    caption = "95 % band: distance from the path that contains the true tip, in all and by each cause alone."
    blocks: list[Block] = [Chart(chart, caption, height=360, along=True), _table(promise)]
    if promise.ladder:
        blocks.append(_ladder(promise))
    if promise.leading:
        blocks.append(_leading(promise))
    if promise.assumed:
        blocks.append(Fold("What is assumed", list(promise.assumed)))
    return Section("95 % band", blocks, describe_error_band(promise, tolerance))


def describe_error_band(promise: ErrorBand, tolerance: float) -> str:
    """Say in a sentence or two what can be promised."""
    text = (
        f"At any point the true tip is within {format_length(promise.greatest)} of the path with 95 %; along the whole"
        f" part within {format_length(promise.whole)}."
    )
    kept = "That keeps" if promise.whole <= tolerance else "That does not keep"
    text += f" {kept} the tolerance of {format_set_value(1e3 * tolerance)} mm."
    if promise.before is not None:
        text += f" The uncorrected program: within {format_length(promise.before[1])} along the whole part."
    known = promise.known
    if known.grade != "measured":
        return f"{text} The widths are {'assumed' if known.grade == 'assumed' else 'from literature'}: {known.source}."
    if known.groups:
        text += (
            f" Widths are measured ({known.source}) and widened by {known.calibration:.3g} from {known.groups}"
            " groups of poses left out of the fit."
        )
    return text


def _table(promise: ErrorBand) -> PageTable:
    rows: list[Row] = []
    cut, widest = promise.cut, promise.widest
    total = promise.radius[widest] ** 2
    for name in PARTS:
        values = promise.parts[name]
        if not values.any():
            continue
        share = float(values[widest] ** 2 / total) if total > 0 else 0.0
        mean = float(np.sqrt(np.mean(values[cut] ** 2)))
        without = promise.without.get(name)
        rest = None if without is None else 1e3 * without
        rows.append([WORDS[name], 1e3 * mean, 1e3 * float(values[widest]), format_percent(share), rest])
    together = [1e3 * float(np.sqrt(np.mean(promise.radius[cut] ** 2))), 1e3 * float(promise.radius[widest])]
    rows.append(["all together", *(TableCell(value, "strong") for value in together), None, None])
    if promise.between > 0:
        rows.append(["between waypoints, on top", None, 1e3 * promise.between, None, None])
    rows.append(["the whole path at once", None, TableCell(1e3 * promise.whole, "strong"), None, None])
    columns = [
        Column("95 % band by"), Column("rms", "mm"), Column("at its widest", "mm"), Column("share of its square"),
        Column("greatest without it", "mm"),
    ]  # fmt: skip
    return PageTable(columns, rows, f"The band is widest at waypoint {widest}.")


def _ladder(promise: ErrorBand) -> PageTable:
    rows: list[Row] = [
        [DO.get(rung.step, "as it is now"), 1e3 * rung.band, 1e3 * rung.alone, "yes" if rung.keeps else "no",
         format_set_value(rung.minutes), rung.instrument or None]
        for rung in promise.ladder
    ]  # fmt: skip
    columns = [
        Column("measure, one after the other"), Column("band of the whole cut then", "mm"),
        Column("after this alone", "mm"), Column("keeps"), Column("work, assumed", "min"), Column("with"),
    ]  # fmt: skip
    cheapest = " and ".join(DO[step] for step in promise.cheapest)
    return PageTable(columns, rows, f"Cheapest that keeps the tolerance: {cheapest}." if cheapest else "")


def _leading(promise: ErrorBand) -> PageTable:
    rows = [[name, format_percent(share)] for name, share in promise.leading]
    columns = [Column("if this were exact"), Column("the variance of the tip would shrink by")]
    return PageTable(columns, rows, "What would narrow the band most, mean over the path.")
