"""What the panel of the viewer draws: the deviation along the path with a mark where the arm is, and the colour bar."""

from __future__ import annotations

import html

import numpy as np

from compplan.io.palette import AFTER, TOLERANCE
from compplan.io.quantities import format_length, format_set_length
from compplan.reporting.style import SEQUENTIAL
from compplan.reporting.thinning import thin_rows
from compplan.robot import Array

#: Size of the curve in its own units, and points that it is drawn with at most.
WIDTH, HEIGHT, POINTS = 300, 92, 300
#: Room above the greatest deviation.
ROOM = 1.08


def draw_curve(place: Array, size: Array, tolerance: float, at: float) -> str:
    """Draw the deviation along the path as SVG, with the tolerance and a mark where the arm is.

    Args:
        place: Time or length of every row, rising. Shape (n,).
        size: Deviation; NaN where it is not known. Shape (n,). [m]
        tolerance: [m]
        at: Where the arm is, in the unit of `place`.
    """
    span = max(float(place[-1] - place[0]), 1e-12)
    most = ROOM * max(float(np.nanmax(size, initial=0.0)), tolerance)
    rows = thin_rows([size], POINTS)
    across, up = WIDTH * (place - place[0]) / span, HEIGHT * (1.0 - np.nan_to_num(size) / most)
    pieces, open_piece = [], False
    for row in rows.tolist():
        if not np.isfinite(size[row]):
            open_piece = False
            continue
        pieces.append(f"{'L' if open_piece else 'M'}{across[row]:.1f} {up[row]:.1f}")
        open_piece = True
    level, mark = HEIGHT * (1.0 - tolerance / most), WIDTH * (at - place[0]) / span
    title = html.escape(f"Deviation along the path, up to {format_length(most / ROOM)}")
    return (
        f'<div style="padding: 0 1em; font-size: 0.78em"><div>{title}</div>'
        f'<svg viewBox="-2 -2 {WIDTH + 4} {HEIGHT + 4}" style="width: 100%; display: block" role="img" '
        f'aria-label="{title}"><line x1="0" x2="{WIDTH}" y1="{HEIGHT}" y2="{HEIGHT}" stroke="#999" />'
        f'<line x1="0" x2="{WIDTH}" y1="{level:.1f}" y2="{level:.1f}" stroke="{TOLERANCE}" stroke-dasharray="5 3" />'
        f'<path class="curve" d="{" ".join(pieces)}" fill="none" stroke="{AFTER}" stroke-width="1.5" />'
        f'<line class="mark" x1="{mark:.1f}" x2="{mark:.1f}" y1="0" y2="{HEIGHT}" stroke="#c2382e" stroke-width="2" />'
        f"</svg></div>"
    )


def draw_colour_bar(top: float, tolerance: float) -> str:
    """Draw the colour bar: from no deviation to the one that has the last colour.

    Args:
        top: Deviation of the last colour. [m]
        tolerance: [m]
    """
    stops = ", ".join(f"{colour} {100 * stop:.0f}%" for stop, colour in SEQUENTIAL)
    at = min(100.0 * tolerance / top, 100.0)
    return (
        '<div style="padding: 0 1em; font-size: 0.78em"><div>Colour: deviation of the tip</div>'
        f'<div style="position: relative; height: 12px; background: linear-gradient(90deg, {stops})">'
        f'<div style="position: absolute; left: {at:.1f}%; top: -2px; width: 2px; height: 16px; background: #1d2329">'
        '</div></div><div style="display: flex; justify-content: space-between">'
        f"<span>0</span><span>| tolerance {html.escape(format_set_length(tolerance))}</span>"
        f"<span>{html.escape(format_length(top))}</span></div></div>"
    )
