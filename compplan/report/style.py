"""How pages look: one palette, one number format, one plotly template for light and one for dark paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

#: Colours that read on light and on dark paper.
BEFORE = "#d1603d"
AFTER = "#2b86a8"
TOLERANCE = "#6c60c0"
LIMIT = "#c2382e"
NEUTRAL = "#8b929b"
#: One colour per category: strategies, runs, joints. As many as whoever sees two primaries can tell apart at the
#: contrast that lines need on light and on dark paper (tests/test_palette.py); further ones take the next dash.
CATEGORIES = ("#2b86a8", "#d1603d", "#6c60c0", "#78606c", "#c08478")
DASHES = ("solid", "dash", "dot")
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


def format_number(value: float, digits: int = 3) -> str:
    """Write a number with so many significant digits, thousands apart.

    Args:
        value: The number; NaN becomes a dash.
        digits: Significant digits; integers keep all of theirs.
    """
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    magnitude = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if magnitude < -5 or magnitude > 8:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    text = f"{value:,.{max(digits - 1 - magnitude, 0)}f}".replace(",", "\u202f")
    return text.replace("-", "−")


def format_set_value(value: float) -> str:
    """Write a number that someone has set, such as a tolerance: as short as it was given."""
    return f"{value:.6g}".replace("-", "−")


def format_set_length(metres: float) -> str:
    """Write a length that someone has set in mm, as short as it was given."""
    return f"{format_set_value(1e3 * metres)}\u00a0mm"


def format_length(metres: float, digits: int = 3) -> str:
    """Write a measured or computed length in the unit that suits it: um below 0.1 mm, mm otherwise.

    Args:
        metres: The length. [m]
        digits: Significant digits.
    """
    if math.isnan(metres):
        return "–"
    if 0 < abs(metres) < 1e-8:
        return "below 0.01\u00a0µm"
    if abs(metres) < 1e-4:
        return f"{format_number(metres * 1e6, digits)}\u00a0µm"
    return f"{format_number(metres * 1e3, digits)}\u00a0mm"


def format_bound(metres: float) -> str:
    """Write a length that something stays within: `format_length`, or 0.01 um where it is smaller."""
    return "0.01\u00a0µm" if metres < 1e-8 else format_length(metres)


def format_angle(radians: float, digits: int = 3) -> str:
    """Write an angle in the unit that suits it: urad below 0.01 deg, deg otherwise.

    Args:
        radians: The angle. [rad]
        digits: Significant digits.
    """
    if 0 < abs(radians) < 1e-8:
        return "below 0.01\u00a0µrad"
    if abs(radians) < math.radians(0.01):
        return f"{format_number(radians * 1e6, digits)}\u00a0µrad"
    return f"{format_number(math.degrees(radians), digits)}\u00a0deg"


def format_percent(share: float) -> str:
    """Write a share as percent; what is neither none nor all never reads as 0 or 100."""
    if math.isnan(share):
        return "–"
    if 0 < share < 1e-4:
        return "below 0.01\u00a0%"
    if 0.999 < share < 1:
        return "above 99.9\u00a0%"
    return f"{format_set_value(float(f'{100 * share:.3g}'))}\u00a0%"


def name_length(metres: float) -> str:
    """Name a round length as axes do: 1e-6 is "1 µm", 0.2 is "200 mm"."""
    for unit, size in (("nm", 1e-9), ("µm", 1e-6)):
        if metres < 999 * size:
            return f"{metres / size:.6g}\u00a0{unit}"
    return f"{metres * 1e3:.6g}\u00a0mm"


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
