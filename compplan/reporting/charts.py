"""Charts of pages: figures as plain JSON for plotly.js, colours, thinned paths.

Traces and layouts have the keys of plotly.js. Arrays are written in base64, as plotly.js reads them.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.display import Curves, pick_style
from compplan.io.palette import CATEGORIES, NEUTRAL, TOLERANCE
from compplan.io.quantities import name_length
from compplan.robot import Array

#: Colour scale from small to large, for quantities that are best at zero.
SEQUENTIAL = ((0.0, "#2f7fb5"), (0.3, "#6fae8f"), (0.55, "#dfb441"), (0.8, "#d1603d"), (1.0, "#8f1d2c"))
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Noto Sans", sans-serif'
#: Colours of a page by theme.
PAPER = {"light": "#ffffff", "dark": "#16191d"}
INK = {"light": "#1d2329", "dark": "#dfe4ea"}
GRID = {"light": "#e4e7ea", "dark": "#2c3238"}
SPACE_GRID = {"light": "#ccd2d8", "dark": "#3b434b"}
LINE = {"light": "#aab1b9", "dark": "#59626c"}
#: Template of charts with placeholders for the colours of the theme.
TEMPLATE = Path(__file__).parent / "templates" / "plotly.json"
#: Greatest number of drawn points of a curve.
POINTS = 1500
#: Extent of a linear axis below zero as a share of the greatest value, which separates a curve at zero from the axis.
BELOW = 0.03


class Figure:
    """One chart, or small charts in a grid, the first at the top left.

    Args:
        titles: Title of each small chart, row by row.
        columns: Charts in a row.
        gaps: Gap between two charts, as a share of the width and of the height.
        shared: "x": charts of a column share the horizontal axis; "y": charts of a row share the vertical axis.
        scenes: Whether the charts are 3D scenes.
    """

    def __init__(
        self, titles: Sequence[str] = ("",), columns: int = 1, *, gaps: tuple[float, float] = (0.0, 0.0),
        shared: str = "", scenes: bool = False,
    ) -> None:  # fmt: skip
        self.data: list[dict[str, Any]] = []
        self.layout: dict[str, Any] = {"shapes": [], "annotations": []}
        self.count, self.columns = len(titles), min(columns, len(titles))
        rows = math.ceil(self.count / self.columns)
        wide = (1 - gaps[0] * (self.columns - 1)) / self.columns
        high = (1 - gaps[1] * (rows - 1)) / rows
        for panel, title in enumerate(titles):
            row, column = divmod(panel, self.columns)
            left, bottom = column * (wide + gaps[0]), (rows - 1 - row) * (high + gaps[1])
            x, y = [left, min(left + wide, 1.0)], [max(bottom, 0.0), min(bottom + high, 1.0)]
            number = name_panel(panel)
            if scenes:
                self.layout[f"scene{number}"] = {"domain": {"x": x, "y": y}}
            elif self.count > 1:
                self.layout[f"xaxis{number}"] = {"anchor": f"y{number}", "domain": x}
                self.layout[f"yaxis{number}"] = {"anchor": f"x{number}", "domain": y}
                last, first = panel + (rows - 1 - row) * self.columns, row * self.columns
                if shared == "x" and panel != last:
                    self.axis("x", panel, matches=f"x{name_panel(last)}", showticklabels=False)
                if shared == "y" and panel != first:
                    self.axis("y", panel, matches=f"y{name_panel(first)}", showticklabels=False)
            if title:
                self.note(title, x=sum(x) / 2, y=y[1], xref="paper", yref="paper", size=12.5)

    def add(self, kind: str, panel: int = 0, **keys: Any) -> dict[str, Any]:
        """Add a trace to a small chart and return it; keys that are None are left out."""
        number = name_panel(panel)
        if f"scene{number}" in self.layout:
            place = {"scene": f"scene{number}"}
        else:
            place = {"xaxis": f"x{number}", "yaxis": f"y{number}"} if self.count > 1 else {}
        trace = {"type": kind, **place, **{key: value for key, value in keys.items() if value is not None}}
        self.data.append(trace)
        return trace

    def line(self, x: Any, y: Any, name: str = "", panel: int = 0, **keys: Any) -> dict[str, Any]:
        """Add a line, or dots if `mode` is "markers"."""
        return self.add("scatter", panel, x=x, y=y, name=name, **{"mode": "lines", **keys})

    def heat(self, x: Any, y: Any, z: Any, title: str = "", panel: int = 0, **keys: Any) -> dict[str, Any]:
        """Add a heat map of values z, shape (len(y), len(x)), with a titled colour bar."""
        bar = {"title": {"text": title, "side": "top"}, "thickness": 12, "outlinewidth": 0}
        scale = {"colorscale": [list(stop) for stop in SEQUENTIAL], "colorbar": bar, "hoverongaps": False}
        return self.add("heatmap", panel, x=x, y=y, z=z, **{**scale, **keys})

    def axis(self, which: str, panel: int | None = None, title: str | None = None, **keys: Any) -> None:
        """Set keys of the "x" or "y" axis of one small chart, or of all."""
        for number in map(name_panel, range(self.count) if panel is None else (panel,)):
            axis = self.layout.setdefault(f"{which}axis{number}", {})
            axis.update(keys if title is None else {**keys, "title": {"text": title}})

    def level(self, value: float, side: str = "y", panel: int | None = None, **line: Any) -> None:
        """Draw a dashed line at a value of an axis, in one small chart or in all."""
        for each in range(self.count) if panel is None else (panel,):
            self.band(value, value, side, each, type="line", line={"color": TOLERANCE, "dash": "dash", **line})

    def band(self, start: float, end: float, side: str, panel: int = 0, **keys: Any) -> None:
        """Draw a band between two values of an axis over the full range of the other axis."""
        number, other = name_panel(panel), "y" if side == "x" else "x"
        ends = {f"{side}ref": f"{side}{number}", f"{side}0": start, f"{side}1": end}
        whole = {f"{other}ref": f"{other}{number} domain", f"{other}0": 0, f"{other}1": 1}
        self.layout["shapes"].append({"type": "rect", "line": {"width": 0}, **ends, **whole, **keys})

    def note(self, text: str, *, size: float = 11.5, xanchor: str = "center", **keys: Any) -> None:
        """Add a text above its position in the figure."""
        style = {"showarrow": False, "xanchor": xanchor, "yanchor": "bottom", "font": {"size": size}}
        self.layout["annotations"].append({"text": text, **style, **keys})

    def to_dict(self) -> dict[str, Any]:
        """Return data and layout as plotly.js reads them."""
        return {"data": _plain(self.data), "layout": _plain(self.layout)}


def name_panel(panel: int) -> str:
    """Return the suffix of a small chart in the names of its axes: "", "2", "3", ..."""
    return str(panel + 1) if panel else ""


def draw_curves(curves: Curves) -> Figure:
    """Draw the curves of a result, as its `plot()` does with matplotlib."""
    figure = Figure()
    for line in curves.lines:
        colour, dash = pick_style(line.role)
        x, y = np.asarray(line.x, float), np.asarray(line.y, float)
        rows = thin_rows([y], POINTS)
        if line.role == "band":
            add_area(figure, x[rows], y[rows], line.label, "rgba(108, 96, 192, 0.13)", showlegend=False)
        figure.line(
            x[rows], y[rows], line.label, mode=line.mode, line={"color": colour, "dash": dash, "width": 1.8},
            marker={"color": colour, "size": 4}, hovertemplate=f"%{{y:.3g}}<extra>{line.label}</extra>",
        )  # fmt: skip
    if curves.level is not None:
        level, label = curves.level
        x = np.concatenate([np.asarray(line.x, float) for line in curves.lines])
        colour, dash = pick_style("tolerance")
        figure.line(
            [float(np.nanmin(x)), float(np.nanmax(x))], [level, level], label, line={"color": colour, "dash": dash},
            hovertemplate=f"%{{y:.3g}}<extra>{label}</extra>",
        )  # fmt: skip
    x_title, y_title = (text.replace(" [", ", ").rstrip("]") for text in (curves.x, curves.y))
    figure.axis("x", title=x_title)
    figure.axis("y", title=y_title, type="log" if curves.logarithmic else "linear")
    if not curves.logarithmic:
        heights = [float(np.nanmax(line.y)) for line in curves.lines]
        top = max(heights if curves.level is None else [*heights, curves.level[0]])
        figure.axis("y", range=[-BELOW * top, 1.05 * top], zeroline=False)
    figure.layout["margin"] = {"t": 46, "r": 12, "l": 60, "b": 46}
    return figure


def add_area(figure: Figure, x: Array, y: Array, name: str, colour: str, **keys: Any) -> dict[str, Any]:
    """Fill the area below a line with gaps, as a separate trace: the fill of a line itself would bridge its gaps."""
    spans = find_spans(np.isfinite(y))
    order = np.argsort(np.r_[np.arange(len(x)), spans[:, 0] - 0.5, spans[:, 1] + 0.5], kind="stable")
    along, high = np.r_[x, x[spans[:, 0]], x[spans[:, 1]]], np.r_[np.nan_to_num(y), np.zeros(spans.size)]
    return figure.line(
        along[order], high[order], name, fill="tozeroy", fillcolor=colour, line={"width": 0}, hoverinfo="skip", **keys
    )


def find_spans(flags: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Find the runs of true values: first and last row of each. Shape (k, 2)."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1])


class Bars(NamedTuple):
    """Bars of one colour or one colour each, with an interval from `low` (None: the value) to `high`, and texts."""

    values: Sequence[float] | Array
    colour: str | Sequence[str]
    low: Sequence[float] | Array | None = None
    high: Sequence[float] | Array | None = None
    text: Sequence[str] | None = None


def draw_bars(
    names: Sequence[str], series: Mapping[str, Bars], title: str, *, level: float | None = None, dots: bool = False,
    hover: str = "%{x:.3g}",
) -> Figure:  # fmt: skip
    """Draw horizontal bars, or dots if `dots`, with the first name on top.

    `title`: of the horizontal axis; `level`: value marked by a dashed line; `hover`: template of the hover text.
    """
    figure = Figure()
    for name, bars in series.items():
        values, spread = np.asarray(bars.values, float), None
        if bars.high is not None:
            low = values if bars.low is None else np.asarray(bars.low)
            spread = {
                "type": "data", "array": np.asarray(bars.high) - values, "arrayminus": values - low, "width": 4,
                "thickness": 1.4, "color": bars.colour if len(series) > 1 else NEUTRAL,
            }  # fmt: skip
        kind, shape = "bar", dict[str, Any](orientation="h")
        marker: dict[str, Any] = {"color": bars.colour}
        if dots:
            kind, marker["size"] = "scatter", 9
            shape = {"mode": "markers+text", "textposition": "top center", "cliponaxis": False}
        figure.add(
            kind, x=values, y=list(names), name=name, marker=marker, error_x=spread, text=bars.text,
            hovertemplate=f"{hover}<extra>{name}</extra>", **shape,
        )  # fmt: skip
    figure.axis("x", title=title, rangemode="normal" if dots else "tozero")
    figure.axis("y", autorange="reversed")
    if level is not None:
        figure.level(level, "x", width=1.6)
    figure.layout |= {"barmode": "group", "bargap": 0.3, "showlegend": len(series) > 1,
                      "legend": {"traceorder": "normal"}}  # fmt: skip
    return figure


def use_decades(figure: Figure, side: str, low: float, high: float, **keys: Any) -> None:
    """Make an axis of lengths in mm logarithmic, with ticks in nm, um, mm. low, high: [mm]"""
    ticks, names = mark_decades(1e-3 * low, 1e-3 * high)
    figure.axis(side, type="log", tickvals=[1e3 * tick for tick in ticks], ticktext=names, **keys)


def _plain(value: Any) -> Any:
    """Convert a value to plain JSON: arrays in base64, non-finite numbers as null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        return _pack(value)
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _pack(values: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Encode an array for plotly.js: reals in single precision, integers in the smallest sufficient type."""
    if values.dtype.kind in "iu":
        most = max(abs(int(values.max(initial=0))), abs(int(values.min(initial=0))))
        values = values.astype(np.int8 if most < 2**7 else np.int16 if most < 2**15 else np.int32)
    elif values.dtype.itemsize > np.dtype(np.float32).itemsize:
        values = values.astype(np.float32)
    kind = f"{values.dtype.kind}{values.dtype.itemsize}"
    packed = {"dtype": kind, "bdata": base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()}
    return packed if values.ndim == 1 else packed | {"shape": ", ".join(map(str, values.shape))}


def mark_decades(low: float, high: float) -> tuple[list[float], list[str]]:
    """Choose ticks [m] of a logarithmic axis, and their names; steps 1, 2, 5 if it spans less than two decades."""
    steps = (1, 2, 5) if high < 100 * low else (1,)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    lengths = [step * 10.0**power for power in powers for step in steps]
    return lengths, [name_length(length) for length in lengths]


def build_template(theme: str) -> dict[str, Any]:
    """Build the plotly template of a theme, "light" or "dark", as plain data."""
    marks = {
        "paper": PAPER[theme], "ink": INK[theme], "grid": GRID[theme], "space": SPACE_GRID[theme], "line": LINE[theme],
        "font": FONT.replace('"', '\\"'),
    }  # fmt: skip
    template = json.loads(Template(TEMPLATE.read_text(encoding="utf-8")).substitute(marks))
    space = {f"{name}axis": template["space"] for name in "xyz"}
    axes = {"xaxis": template["axis"], "yaxis": template["axis"], "scene": space}
    return {"layout": {**template["layout"], "colorway": list(CATEGORIES), **axes}}


def thin_rows(signals: Array | Sequence[Array], limit: int) -> NDArray[np.int_]:
    """Choose rows that preserve the shape of signals: both ends, and minimum and maximum of each signal per bucket.

    signals: shape (n,) each, or (n, k), NaN is ignored; about `limit` rows are kept. Returns ascending rows.
    """
    columns = np.asarray(signals, float) if isinstance(signals, np.ndarray) else np.column_stack(list(signals))
    columns = columns.reshape(len(columns), -1)
    n, k = columns.shape
    if n <= limit:
        return np.arange(n)
    buckets = max(limit // (2 * k), 1)
    width = -(-n // buckets)
    padded = np.full((buckets * width, k), np.nan)
    padded[:n] = columns
    blocks = padded.reshape(buckets, width, k)
    start = (np.arange(buckets) * width)[:, None]
    low = np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1) + start
    high = np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1) + start
    rows = np.unique(np.concatenate([[0, n - 1], low.ravel(), high.ravel()]))
    return rows[rows < n]


def thin_path(position: Array, signals: Array | Sequence[Array], limit: int) -> NDArray[np.int_]:
    """Choose about `limit` rows to draw a path (n, 3) and its signals, a third of them at equal path lengths."""
    n = len(position)
    if n <= limit:
        return np.arange(n)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    even = np.searchsorted(length, np.linspace(0, length[-1], limit // 3))
    return np.unique(np.concatenate([np.clip(even, 0, n - 1), thin_rows(signals, limit - limit // 3)]))
