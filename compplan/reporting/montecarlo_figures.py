"""Figures of a Monte Carlo study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from compplan.reporting import figure as go
from compplan.reporting.along_path import FLOOR, Stations
from compplan.reporting.panels import draw_panels, draw_small_multiples
from compplan.reporting.strategy_text import colour_strategies, name_strategy
from compplan.reporting.style import CATEGORIES, TOLERANCE, mark_decades
from compplan.robot import Array
from compplan.studies.runner import Run
from compplan.studies.sensitivity import Sensitivity
from compplan.studies.statistics import trace_convergence


def draw_distributions(run: Run) -> Any:
    """Draw the rms deviation of every strategy over the cells as boxes from 5 to 95 %."""
    figure = go.Figure()
    rms = np.maximum(run.evaluated.rms, FLOOR)
    names = list(run.study.strategies)
    colours = colour_strategies(names, names[int(np.argmin(rms.mean(axis=0)))])
    for k, name in enumerate(names):
        low, q1, median, q3, high = (1e3 * np.quantile(rms[:, k], share) for share in (0.05, 0.25, 0.5, 0.75, 0.95))
        figure.add_trace(
            go.Box(
                y=[name_strategy(name)], lowerfence=[low], q1=[q1], median=[median], q3=[q3], upperfence=[high],
                orientation="h", marker_color=colours[k], showlegend=False, name=name_strategy(name),
            )
        )  # fmt: skip
    _decades(figure, rms, "xaxis")
    figure.update_xaxes(title_text="rms deviation")
    figure.update_yaxes(autorange="reversed")
    tolerance = 1e3 * run.study.task.tolerance
    figure.add_vline(x=tolerance, line={"color": TOLERANCE, "width": 1.4, "dash": "dash"})
    return figure


def draw_along(run: Run) -> Any:
    """Draw the distance along the path, one small chart a strategy: median over the cells, and 95 of 100 of them."""
    study = run.study
    steps = np.linalg.norm(np.diff(study.task.position, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])[study.stations]
    time = np.concatenate([[0.0], np.cumsum(study.task.step_time)])[study.stations]
    median, most = (1e3 * np.maximum(np.quantile(run.evaluated.along, share, axis=0), FLOOR) for share in (0.5, 0.95))
    panels = {
        name_strategy(name): {"median": median[k], "95 of 100 cells": most[k]}
        for k, name in enumerate(study.strategies)
    }
    stations = Stations(length, time, np.zeros(0, int), np.zeros((0, 2)))
    return draw_panels(stations, panels, tolerance=1e3 * study.task.tolerance, log=True)


def draw_differences(summary: Mapping[str, Any], main: str) -> Any:
    """Draw the paired differences of all strategies from one."""
    names, means, low, high = [], [], [], []
    for pair in summary["paired_differences"]:
        first, second = pair["strategies"]
        if main not in (first, second):
            continue
        sign = 1.0 if first == main else -1.0
        ends = sorted(sign * end for end in pair["rms_mm"]["ci95"])
        names.append(name_strategy(second if first == main else first))
        means.append(sign * pair["rms_mm"]["mean"])
        low.append(means[-1] - ends[0])
        high.append(ends[1] - means[-1])
    figure = go.Figure(
        go.Scatter(
            x=means, y=names, mode="markers", marker={"size": 9, "color": CATEGORIES[0]},
            error_x={"type": "data", "array": high, "arrayminus": low, "color": CATEGORIES[0]},
            hovertemplate="%{x:.4g} mm<extra>%{y}</extra>",
        )
    )  # fmt: skip
    figure.add_vline(x=0.0, line={"color": TOLERANCE, "width": 1.2, "dash": "dash"})
    figure.update_xaxes(title_text=f"rms deviation less that of {name_strategy(main)}, mm")
    figure.update_yaxes(autorange="reversed")
    return figure


def draw_sensitivity(found: Sensitivity, strategy: str) -> Any:
    """Draw the total indices of one strategy as bars, largest first."""
    order = np.argsort(-found.total[strategy])
    figure = go.Figure(
        go.Bar(
            y=[found.groups[k].replace("_", " ") for k in order],
            x=found.total[strategy][order],
            orientation="h",
            marker_color=CATEGORIES[0],
            error_x={"type": "data", "array": found.half_width[strategy][order], "thickness": 1.2},
        )
    )
    figure.update_xaxes(title_text=f"total index, strategy {name_strategy(strategy)}", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    return figure


def draw_convergence(run: Run) -> Any:
    """Draw how the mean rms of every strategy and its interval settle, one small chart a strategy."""
    panels, samples = {}, np.zeros(0)
    for k, name in enumerate(run.study.strategies):
        trace = trace_convergence(1e3 * run.evaluated.rms[:, k], run.settings.replicates)
        samples = np.array([float(n) for n, _ in trace])
        value, half = (np.array([getattr(each, part) for _, each in trace]) for part in ("value", "half_width"))
        panels[name_strategy(name)] = {"mean": np.stack([value, value - half, value + half])}
    return draw_small_multiples(samples, panels, ("samples", "mean rms, mm"), spread=True, log=True)


def _decades(figure: Any, values: Array, axis: str) -> None:
    low, high = float(np.quantile(values, 0.02)), float(np.quantile(values, 0.99))
    ticks, names = mark_decades(low, max(high, 2 * low))
    figure.update_layout({axis: {"type": "log", "tickvals": [1e3 * tick for tick in ticks], "ticktext": names}})
