"""How pages look: colours, number formats, a plotly template for light and one for dark paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from compplan.files.palette import AFTER, BEFORE, CATEGORIES, DASHES, LIMIT, NEUTRAL, TOLERANCE
from compplan.files.quantities import (
    format_angle,
    format_bound,
    format_length,
    format_mm,
    format_mm_change,
    format_number,
    format_percent,
    format_set_length,
    format_set_value,
    name_length,
)

__all__ = [
    "AFTER", "BEFORE", "CATEGORIES", "DASHES", "DIVERGING", "FONT", "GRID", "INK", "LIMIT", "LINE", "NEUTRAL", "PAPER",
    "SEQUENTIAL", "SPACE_GRID", "TOLERANCE", "build_template", "format_angle", "format_bound", "format_length",
    "format_mm", "format_mm_change", "format_number", "format_percent", "format_set_length", "format_set_value",
    "mark_decades",
    "name_length", "style_line",
]  # fmt: skip

#: Small to large, for quantities that are best at zero.
SEQUENTIAL = ((0.0, "#2f7fb5"), (0.3, "#6fae8f"), (0.55, "#dfb441"), (0.8, "#d1603d"), (1.0, "#8f1d2c"))
#: Minus to plus, for quantities with a sign.
DIVERGING = ((0.0, "#2b6ca8"), (0.25, "#7fb0cf"), (0.5, "#d8d8d2"), (0.75, "#e39a72"), (1.0, "#b03a24"))

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Noto Sans", sans-serif'
PAPER = {"light": "#ffffff", "dark": "#16191d"}
INK = {"light": "#1d2329", "dark": "#dfe4ea"}
GRID = {"light": "#e4e7ea", "dark": "#2c3238"}
SPACE_GRID = {"light": "#ccd2d8", "dark": "#3b434b"}
LINE = {"light": "#aab1b9", "dark": "#59626c"}


def style_line(number: int, colours: Sequence[str] = CATEGORIES) -> dict[str, str]:
    """Return colour and dash of a line by its number: all colours solid, then all of them dashed, then dotted."""
    return {"color": colours[number % len(colours)], "dash": DASHES[number // len(colours) % len(DASHES)]}


def mark_decades(low: float, high: float) -> tuple[list[float], list[str]]:
    """Choose round lengths for a logarithmic axis, and their names; 1, 2, 5 where it spans less than two decades.

    Args:
        low: Smallest length. [m]
        high: Largest length. [m]
    """
    steps = (1, 2, 5) if high < 100 * low else (1,)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    lengths = [step * 10.0**power for power in powers for step in steps]
    return lengths, [name_length(length) for length in lengths]


def build_template(theme: str) -> dict[str, Any]:
    """Build the plotly template of a theme, as plain data.

    Args:
        theme: "light" or "dark".
    """
    axis = {
        "gridcolor": GRID[theme],
        "linecolor": LINE[theme],
        "zerolinecolor": GRID[theme],
        "tickcolor": LINE[theme],
        "ticks": "outside",
        "ticklen": 4,
        "showline": True,
        "zeroline": False,
        "title": {"font": {"size": 13}, "standoff": 8},
        "automargin": True,
    }
    space = {
        "backgroundcolor": "rgba(0,0,0,0)",
        "gridcolor": SPACE_GRID[theme],
        "linecolor": LINE[theme],
        "zerolinecolor": GRID[theme],
        "showbackground": False,
        "title": {"font": {"size": 12}},
        "tickfont": {"size": 10},
    }
    layout = {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": FONT, "size": 12.5, "color": INK[theme]},
        "colorway": list(CATEGORIES),
        "margin": {"l": 64, "r": 24, "t": 36, "b": 48},
        "hoverlabel": {
            "bgcolor": PAPER[theme],
            "bordercolor": LINE[theme],
            "font": {"family": FONT, "color": INK[theme]},
        },
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1.02,
            "yanchor": "bottom",
            "bgcolor": "rgba(0,0,0,0)",
        },
        "xaxis": axis,
        "yaxis": axis,
        "scene": {"xaxis": space, "yaxis": space, "zaxis": space},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": LINE[theme], "activecolor": INK[theme]},
        "coloraxis": {"colorbar": {"outlinewidth": 0, "thickness": 12}},
        "updatemenudefaults": {"bgcolor": PAPER[theme], "bordercolor": LINE[theme]},
        "annotationdefaults": {"font": {"color": INK[theme]}, "arrowcolor": LINE[theme]},
    }
    return {"layout": layout}
