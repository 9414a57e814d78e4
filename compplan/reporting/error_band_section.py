"""The 95 % band on a page: along the path against the tolerance, what makes it, and what would narrow it."""

from __future__ import annotations

import numpy as np

from compplan.io.quantities import format_length, format_percent, format_set_value
from compplan.reporting import page
from compplan.reporting.along_path import Stations, draw_lines
from compplan.uncertainty.band import PARTS, ErrorBand
from compplan.uncertainty.ladder import DO

#: What the parts are called.
WORDS = {
    "model": "parameters of the robot", "unexplained": "what no parameter explains", "repeatability": "repeatability",
    "force": "the force", "motion": "inertia and vibration", "placement": "place of the part",
}  # fmt: skip


def show_error_band(promise: ErrorBand, stations: Stations, tolerance: float) -> page.Section:
    """Show the band that holds the true tip with 95 %; tolerance: greatest deviation within tolerance. [m]"""
    evaluated = np.where(promise.cut, 1e3, np.nan)
    series = {"all together": promise.radius * evaluated}
    series |= {WORDS[name]: promise.parts[name] * evaluated for name in PARTS if promise.parts[name].any()}
    limit = (1e3 * tolerance, f"tolerance {format_set_value(1e3 * tolerance)} mm")
    chart = draw_lines(stations, series, "mm", title="95 % band", zero=True, limit=limit)
    caption = "95 % band: distance from the path that contains the true tip, in all and by each cause alone."
    blocks: list[page.Block] = [page.Chart(chart, caption, height=360, along=True), _list_parts(promise)]
    if promise.ladder:
        blocks.append(_list_steps(promise))
    if promise.leading:
        rows = [[name, format_percent(share)] for name, share in promise.leading]
        columns = ["if this were exact", "the variance of the tip would shrink by"]
        blocks.append(page.Table(columns, rows, "What would narrow the band most, mean over the path."))
    if promise.assumed:
        blocks.append(page.Fold("What is assumed", list(promise.assumed)))
    return page.Section("95 % band", blocks, describe_error_band(promise, tolerance))


def describe_error_band(promise: ErrorBand, tolerance: float) -> str:
    """Say in a sentence or two how far the tip may be from the path; tolerance: [m]"""
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


def _list_parts(promise: ErrorBand) -> page.Table:
    rows: list[page.Row] = []
    cut, widest = promise.cut, promise.widest
    total = promise.radius[widest] ** 2
    for name in PARTS:
        values = promise.parts[name]
        if values.any():
            share = float(values[widest] ** 2 / total) if total > 0 else 0.0
            mean, without = float(np.sqrt(np.mean(values[cut] ** 2))), promise.without.get(name)
            rest = None if without is None else 1e3 * without
            rows.append([WORDS[name], 1e3 * mean, 1e3 * float(values[widest]), format_percent(share), rest])
    together = [1e3 * float(np.sqrt(np.mean(promise.radius[cut] ** 2))), 1e3 * float(promise.radius[widest])]
    rows.append(["all together", *(page.Cell(value, "strong") for value in together), None, None])
    if promise.between > 0:
        rows.append(["between waypoints, on top", None, 1e3 * promise.between, None, None])
    rows.append(["the whole path at once", None, page.Cell(1e3 * promise.whole, "strong"), None, None])
    columns = ["95 % band by", "rms [mm]", "at its widest [mm]", "share of its square", "greatest without it [mm]"]
    return page.Table(columns, rows, f"The band is widest at waypoint {widest}.")


def _list_steps(promise: ErrorBand) -> page.Table:
    """List the measurements that narrow the band, cheapest first."""
    rows: list[page.Row] = [
        [DO.get(rung.step, "as it is now"), 1e3 * rung.band, 1e3 * rung.alone, "yes" if rung.keeps else "no",
         format_set_value(rung.minutes), rung.instrument or None]
        for rung in promise.ladder
    ]  # fmt: skip
    columns = ["measure, one after the other", "band of the whole cut then [mm]", "after this alone [mm]", "keeps",
               "work, assumed [min]", "with"]  # fmt: skip
    cheapest = " and ".join(DO[step] for step in promise.cheapest)
    return page.Table(columns, rows, f"Cheapest that keeps the tolerance: {cheapest}." if cheapest else "")
