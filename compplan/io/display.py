"""Base class of results: text for a terminal, HTML for a notebook, a plot and a DataFrame.

A result defines `summary`, `columns` and `curves`; text, HTML, plot and DataFrame are made from them. matplotlib is
imported only for a plot, pandas only for a DataFrame.
"""

from __future__ import annotations

import base64
import html
import io
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from compplan.errors import InputError
from compplan.io.palette import AFTER, BAND, BEFORE, CATEGORIES, DASHES, LIMIT, NEUTRAL, TOLERANCE
from compplan.io.tables import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

#: Greatest number of lines, and of characters per line, of a printed result.
MOST_LINES, MOST_LETTERS = 15, 130
#: Colour and dash of a line by its role.
ROLES = {
    "before": (BEFORE, "solid"), "after": (AFTER, "solid"), "band": (BAND, "solid"), "limit": (LIMIT, "dash"),
    "tolerance": (TOLERANCE, "dash"), "neutral": (NEUTRAL, "solid"), "seen": (AFTER, "dot"),
}  # fmt: skip
MATPLOTLIB_DASHES = {"solid": "-", "dash": "--", "dot": ":"}

#: Greatest number of printed entries of a list.
MOST_LISTED = 7


class Curve(NamedTuple):
    """One line of a plot."""

    label: str  #: Text of the legend.
    x: Array  #: Shape (n,), in the unit of the axis.
    y: Array  #: Shape (n,), in the unit of the axis.
    role: str | int  #: One of `ROLES`, or the number of a category.
    mode: str = "lines"  #: "lines", "markers" or "lines+markers".


class Curves(NamedTuple):
    """The data of a plot."""

    title: str  #: Title of the plot.
    x: str  #: Label of the horizontal axis, with its unit.
    y: str  #: Label of the vertical axis, with its unit.
    lines: tuple[Curve, ...]  #: The lines.
    #: Value of a horizontal line, such as the tolerance, with its label; or None.
    level: tuple[float, str] | None = None
    logarithmic: bool = False  #: Whether the vertical axis is logarithmic.
    square: bool = False  #: Whether both axes have the same scale.


class Shown:
    """Base class of results; a subclass defines `summary` and optionally `columns`, `curves`, `to_dict`."""

    def summary(self) -> list[tuple[str, str]]:
        """Return the main results as pairs of name and text with units; the first is the headline."""
        raise NotImplementedError

    def __str__(self) -> str:
        (what, headline), *rest = self.summary()
        return "\n".join([cut_line(f"{what}: {headline}"), *format_figures(rest)][:MOST_LINES])

    def __repr__(self) -> str:
        what, headline = self.summary()[0]
        return f"<{type(self).__name__} {cut_line(headline)}>" if what else f"<{type(self).__name__}>"

    def _repr_html_(self) -> str:
        (what, headline), *rest = self.summary()
        rows = "".join(
            f'<tr><th style="text-align:left;font-weight:500">{html.escape(name)}</th>'
            f'<td style="text-align:left">{html.escape(words)}</td></tr>'
            for name, words in rest
        )
        curves = self.curves()
        image = "" if curves is None else (
            f'<img alt="{html.escape(f"{what}: {headline}")}" style="max-width:100%" '
            f'src="data:image/png;base64,{base64.b64encode(draw_png(curves)).decode()}">'
        )  # fmt: skip
        return f"<div><p><b>{html.escape(what)}</b>: {html.escape(headline)}</p><table>{rows}</table>{image}</div>"

    def curves(self) -> Curves | None:
        """Return the data of the plot, or None."""
        return None

    def columns(self) -> dict[str, Any]:
        """Return the result as the columns of a table, units in their names. Shape (n,) each."""
        raise InputError(f"a {type(self).__name__} has no rows; to_dict() has its figures")

    def to_dict(self) -> Mapping[str, Any]:
        """Return the result as dictionaries, lists, text and numbers, units in the keys."""
        return {name: np.asarray(values).tolist() for name, values in self.columns().items()}

    def to_frame(self) -> DataFrame:
        """Return the rows of the result as a pandas DataFrame, units in the names of its columns.

        Raises:
            InputError: If pandas is not installed, or the result has no rows.
        """
        try:
            from pandas import DataFrame
        except ImportError:
            raise InputError('to_frame() needs pandas, an extra of compplan: pip install "compplan[frames]"') from None
        return DataFrame(self.columns())

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the result with matplotlib.

        Args:
            axes: Axes to draw into; new ones if left out.

        Returns:
            The axes, to change or to save (`axes.figure.savefig("plan.png")`).

        Raises:
            InputError: If the result cannot be plotted.
        """
        curves = self.curves()
        if curves is None:
            raise InputError(f"a {type(self).__name__} cannot be plotted; print it, or use to_dict()")
        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")[1]
        return draw_curves(curves, axes)


def format_figures(figures: Sequence[tuple[str, str]]) -> list[str]:
    """Format figures, pairs of name and text, as lines with aligned texts, two a figure at most."""
    width = max((len(name) for name, _ in figures), default=0)
    lines: list[str] = []
    for name, words in figures:
        head = f"  {name:<{width}}  "
        wrapped = textwrap.wrap(words, MOST_LETTERS, initial_indent=head, subsequent_indent=" " * len(head))
        long = len(wrapped) > 2
        lines += [wrapped[0], cut_line(f"{wrapped[1]} {wrapped[2].strip()}")] if long else wrapped
    return lines


def cut_line(line: str) -> str:
    """Shorten a long line at a word."""
    return line if len(line) <= MOST_LETTERS else line[: MOST_LETTERS - 4].rpartition(" ")[0] + " ..."


def draw_curves(curves: Curves, axes: Axes) -> Axes:
    """Draw curves into matplotlib axes and return them."""
    for curve in curves.lines:
        colour, dash = pick_style(curve.role)
        style = MATPLOTLIB_DASHES[dash] if "lines" in curve.mode else ""
        marker = "." if "markers" in curve.mode else ""
        axes.plot(curve.x, curve.y, color=colour, linestyle=style, marker=marker, linewidth=1.4, label=curve.label)
    if curves.level is not None:
        colour, dash = pick_style("tolerance")
        axes.axhline(curves.level[0], color=colour, linestyle=MATPLOTLIB_DASHES[dash], label=curves.level[1])
    if curves.logarithmic:
        axes.set_yscale("log")
    elif not curves.square and all(np.nanmin(curve.y) >= 0.0 for curve in curves.lines):
        axes.set_ylim(bottom=-0.03 * axes.get_ylim()[1])  # separates a curve at zero from the axis
    if curves.square:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set(title=curves.title, xlabel=curves.x, ylabel=curves.y)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(frameon=False, fontsize="small")
    return axes


def pick_style(role: str | int) -> tuple[str, str]:
    """Return colour and dash of a line."""
    if isinstance(role, str):
        return ROLES[role]
    return CATEGORIES[role % len(CATEGORIES)], DASHES[role // len(CATEGORIES) % len(DASHES)]


def draw_png(curves: Curves) -> bytes:
    """Draw curves as a PNG without changing open figures."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.2), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    draw_curves(curves, figure.subplots())
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()
