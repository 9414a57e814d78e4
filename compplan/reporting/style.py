"""How pages look: colours, number formats, a plotly template for light and one for dark paper."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

from compplan.io.palette import CATEGORIES, DASHES
from compplan.io.quantities import name_length

#: Small to large, for quantities that are best at zero.
SEQUENTIAL = ((0.0, "#2f7fb5"), (0.3, "#6fae8f"), (0.55, "#dfb441"), (0.8, "#d1603d"), (1.0, "#8f1d2c"))

FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Noto Sans", sans-serif'
PAPER = {"light": "#ffffff", "dark": "#16191d"}
INK = {"light": "#1d2329", "dark": "#dfe4ea"}
GRID = {"light": "#e4e7ea", "dark": "#2c3238"}
SPACE_GRID = {"light": "#ccd2d8", "dark": "#3b434b"}
LINE = {"light": "#aab1b9", "dark": "#59626c"}


#: The template of charts; colours of the theme stand in it as marks.
TEMPLATE = Path(__file__).parent / "templates" / "plotly.json"


def style_line(number: int, colours: Sequence[str] = CATEGORIES) -> dict[str, str]:
    """Return colour and dash of a line by its number: all colours solid, then all of them dashed, then dotted."""
    return {"color": colours[number % len(colours)], "dash": DASHES[number // len(colours) % len(DASHES)]}


def mark_decades(low: float, high: float) -> tuple[list[float], list[str]]:
    """Choose round lengths [m] for a logarithmic axis, and their names; 1, 2, 5 where it spans under two decades."""
    steps = (1, 2, 5) if high < 100 * low else (1,)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    lengths = [step * 10.0**power for power in powers for step in steps]
    return lengths, [name_length(length) for length in lengths]


def build_template(theme: str) -> dict[str, Any]:
    """Build the plotly template of a theme, as plain data.

    Args:
        theme: "light" or "dark".
    """
    marks = {
        "paper": PAPER[theme], "ink": INK[theme], "grid": GRID[theme], "space": SPACE_GRID[theme], "line": LINE[theme],
        "font": FONT.replace('"', '\\"'),
    }  # fmt: skip
    told = json.loads(Template(TEMPLATE.read_text(encoding="utf-8")).substitute(marks))
    axes = {"xaxis": told["axis"], "yaxis": told["axis"], "scene": {f"{name}axis": told["space"] for name in "xyz"}}
    return {"layout": {**told["layout"], "colorway": list(CATEGORIES), **axes}}
