"""Figures as the plain JSON that the plotly.js of a page draws: traces, axes, small charts in a grid.

A key with an underscore after the name of a table reaches into it: `title_text="x"` is `title={"text": "x"}`. What the
tables hold is the reference of plotly.js. Arrays are written in base64, as plotly.js reads them.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

#: Tables that a key may reach into.
TABLES = ("title", "line", "marker", "font", "xaxis", "yaxis")


class Node(dict[str, Any]):
    """A table of a figure; its keys are read and written as attributes, too; a key that is not there reads as None."""

    def __init__(self, content: Mapping[str, Any] | None = None, **keys: Any) -> None:
        super().__init__()
        self.update(content, **keys)

    def __getattr__(self, name: str) -> Any:
        return self.get(name)

    def __setattr__(self, name: str, value: Any) -> None:
        self[name] = value

    def update(self, content: Mapping[str, Any] | None = None, **keys: Any) -> Node:  # type: ignore[override]
        """Write keys, table by table, and return the node; what is None is left out."""
        for key, value in {**(content or {}), **keys}.items():
            head, _, rest = key.partition("_")
            if rest and head in TABLES:
                key, value = head, {rest: value}
            if key == "title" and isinstance(value, str):
                value = {"text": value}
            if isinstance(value, Mapping):
                old = self.get(key)
                value = (old if isinstance(old, Node) else Node()).update(value)
            elif isinstance(value, list):
                value = [Node(item) if type(item) is dict else item for item in value]
            if value is not None:
                self[key] = value
        return self


def Scatter(**keys: Any) -> Node:
    """Return lines or dots."""
    return _trace("scatter", keys)


def Scatter3d(**keys: Any) -> Node:
    """Return lines or dots in space."""
    return _trace("scatter3d", keys)


def Bar(**keys: Any) -> Node:
    """Return bars."""
    return _trace("bar", keys)


def Box(**keys: Any) -> Node:
    """Return boxes with whiskers."""
    return _trace("box", keys)


def Heatmap(**keys: Any) -> Node:
    """Return a map of colours."""
    return _trace("heatmap", keys)


def Mesh3d(**keys: Any) -> Node:
    """Return triangles in space."""
    return _trace("mesh3d", keys)


def _trace(kind: str, keys: dict[str, Any]) -> Node:
    arrays = {key: np.asarray(value) if _is_numbers(value) else value for key, value in keys.items()}
    return Node(arrays, type=kind)


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(v, int | float) for v in value)


class Figure:
    """Traces and a layout.

    Attributes:
        data: The traces, in the order they are drawn.
        layout: The layout.
        grid: By (row, column), counted from 1: the number of the axes there, "" for the first; empty for one chart.
    """

    def __init__(self, data: Node | Sequence[Node] = ()) -> None:
        self.data: Sequence[Node] = (data,) if isinstance(data, Node) else tuple(data)
        self.layout = Node()
        self.grid: dict[tuple[int, int], str] = {}
        self.layout["shapes"], self.layout["annotations"] = [], []
        self.layout["xaxis"], self.layout["yaxis"] = Node(), Node()

    def add_trace(self, trace: Node, row: int | None = None, col: int | None = None) -> Figure:
        """Add a trace, to one of the small charts where row and column are given."""
        if row is not None and col is not None:
            number = self.grid[row, col]
            if f"scene{number}" in self.layout:
                trace["scene"] = f"scene{number}"
            else:
                trace["xaxis"], trace["yaxis"] = f"x{number}", f"y{number}"
        self.data = (*self.data, trace)
        return self

    def add_scatter(self, *, row: int | None = None, col: int | None = None, **keys: Any) -> Figure:
        """Add lines or dots, to one of the small charts where row and column are given."""
        return self.add_trace(Scatter(**keys), row, col)

    def add_bar(self, **keys: Any) -> Figure:
        """Add bars."""
        return self.add_trace(Bar(**keys))

    def add_heatmap(self, **keys: Any) -> Figure:
        """Add a map of colours."""
        return self.add_trace(Heatmap(**keys))

    def update_layout(self, content: Mapping[str, Any] | None = None, **keys: Any) -> Figure:
        """Write keys of the layout."""
        self.layout.update(content, **keys)
        return self

    def update_xaxes(self, *, row: int | None = None, col: int | None = None, **keys: Any) -> Figure:
        """Write keys of the horizontal axes: of all, or of a row, a column, one chart."""
        return self._update_axes("xaxis", row, col, keys)

    def update_yaxes(self, *, row: int | None = None, col: int | None = None, **keys: Any) -> Figure:
        """Write keys of the vertical axes: of all, or of a row, a column, one chart."""
        return self._update_axes("yaxis", row, col, keys)

    def _update_axes(self, kind: str, row: int | None, col: int | None, keys: dict[str, Any]) -> Figure:
        for number in self._numbers(row, col):
            if f"{kind}{number}" in self.layout:
                self.layout[f"{kind}{number}"].update(keys)
        return self

    def _numbers(self, row: int | None, col: int | None) -> Iterator[str]:
        for (r, c), number in (self.grid or {(1, 1): ""}).items():
            if row in (None, r) and col in (None, c):
                yield number

    def update_traces(self, selector: Mapping[str, Any], **keys: Any) -> Figure:
        """Write keys of the traces that have what the selector says."""
        for trace in self.data:
            if all(trace.get(key) == value for key, value in selector.items()):
                trace.update(keys)
        return self

    def update_annotations(self, **keys: Any) -> Figure:
        """Write keys of all annotations."""
        for annotation in self.layout.annotations:
            annotation.update(keys)
        return self

    def add_annotation(self, **keys: Any) -> Figure:
        """Write words into the figure."""
        self.layout.annotations.append(Node(keys))
        return self

    def add_hline(self, *, y: float, line: Mapping[str, Any], row: int | None = None, col: int | None = None) -> Figure:
        """Draw a line across one chart, or each."""
        for number in self._numbers(row, col):
            ends = {"xref": f"x{number} domain", "x0": 0, "x1": 1, "yref": f"y{number}", "y0": y, "y1": y}
            self.layout.shapes.append(Node({"type": "line", **ends, "line": dict(line)}))
        return self

    def add_vline(self, *, x: float, line: Mapping[str, Any]) -> Figure:
        """Draw a line up the chart."""
        ends = {"xref": "x", "x0": x, "x1": x, "yref": "y domain", "y0": 0, "y1": 1}
        self.layout.shapes.append(Node({"type": "line", **ends, "line": dict(line)}))
        return self

    def to_json(self) -> str:
        """Return the figure as plotly.js reads it."""
        return json.dumps({"data": [_plain(trace) for trace in self.data], "layout": _plain(self.layout)})


def make_subplots(
    *, rows: int, cols: int, specs: Sequence[Sequence[Mapping[str, Any]]] | None = None,
    subplot_titles: Sequence[str] = (), horizontal_spacing: float = 0.0, vertical_spacing: float = 0.0,
    shared_xaxes: bool = False, shared_yaxes: bool = False,
) -> Figure:  # fmt: skip
    """Return a figure of small charts in a grid, the first at the top left.

    Args:
        rows: How many under each other.
        cols: How many beside each other.
        specs: By row and column: {"type": "scene"} for a chart in space; left out: all flat.
        subplot_titles: Titles, row by row.
        horizontal_spacing: Share of the width between two.
        vertical_spacing: Share of the height between two.
        shared_xaxes: Whether the charts of a column share their horizontal axis, named under the last.
        shared_yaxes: Whether the charts of a row share their vertical axis, named beside the first.
    """
    figure = Figure()
    del figure.layout["xaxis"], figure.layout["yaxis"]
    wide, high = (1 - horizontal_spacing * (cols - 1)) / cols, (1 - vertical_spacing * (rows - 1)) / rows
    for k in range(rows * cols):
        row, col, number = k // cols, k % cols, str(k + 1) if k else ""
        figure.grid[row + 1, col + 1] = number
        left, bottom = col * (wide + horizontal_spacing), (rows - 1 - row) * (high + vertical_spacing)
        x, y = [left, min(left + wide, 1.0)], [max(bottom, 0.0), min(bottom + high, 1.0)]
        if specs is not None and specs[row][col].get("type") == "scene":
            figure.layout[f"scene{number}"] = Node(domain={"x": x, "y": y})
        else:
            below, first = k + 1 + (rows - 1 - row) * cols, row * cols + 1
            across, up = Node(anchor=f"y{number}", domain=x), Node(anchor=f"x{number}", domain=y)
            if shared_xaxes and row < rows - 1:
                across.update(matches=f"x{below}", showticklabels=False)
            if shared_yaxes and col:
                up.update(matches=f"y{first if first > 1 else ''}", showticklabels=False)
            figure.layout[f"xaxis{number}"], figure.layout[f"yaxis{number}"] = across, up
        if k < len(subplot_titles):
            figure.add_annotation(
                text=subplot_titles[k], x=sum(x) / 2, y=y[1], xref="paper", yref="paper", xanchor="center",
                yanchor="bottom", showarrow=False, font={"size": 16},
            )  # fmt: skip
    return figure


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: arrays in base64, numbers that are none as null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        return _pack(value)
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _pack(values: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return an array as plotly.js reads it: reals in single precision, whole numbers in as few bytes as hold them."""
    if values.dtype.kind in "iu":
        most = max(abs(int(values.max(initial=0))), abs(int(values.min(initial=0))))
        values = values.astype(np.int8 if most < 2**7 else np.int16 if most < 2**15 else np.int32)
    elif values.dtype.itemsize > np.dtype(np.float32).itemsize:
        values = values.astype(np.float32)
    kind = f"{values.dtype.kind}{values.dtype.itemsize}"
    packed = {"dtype": kind, "bdata": base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()}
    return packed if values.ndim == 1 else packed | {"shape": ", ".join(map(str, values.shape))}
