"""The picture of `compplan place`: how much of the deviation would remain, by the place of the part."""

from __future__ import annotations

import io

import numpy as np

from compplan.posture.place import PlaceResult, Ratings
from compplan.report.style import LIMIT, SEQUENTIAL


def draw_place_map(result: PlaceResult) -> bytes:
    """Draw horizontal and vertical sections of the grid through the chosen place as a PNG."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

    rating = next((r for r in result.ratings if r.turn == result.turn), result.ratings[0])
    shades = LinearSegmentedColormap.from_list("sensitivity", list(SEQUENTIAL)).with_extremes(bad="#e3e5e8")
    figure = Figure(figsize=(11.0, 4.6), dpi=130, layout="constrained")  # none of the user's own
    panels = figure.subplots(1, 2)
    low, high = np.nanpercentile(1e3 * rating.bound, (1, 97))
    chosen, marked = result.position, {"markeredgecolor": "#111418", "linestyle": "none"}
    for panel, (across, up, through) in zip(panels, ((0, 1, 2), (0, 2, 1)), strict=True):
        values = _section(rating, through, float(chosen[through]))
        x, y = 1e3 * rating.axes[across], 1e3 * rating.axes[up]
        shown = np.ma.masked_invalid(1e3 * values).T
        mesh = panel.pcolormesh(_borders(x), _borders(y), shown, cmap=shades, vmin=low, vmax=max(high, low + 1e-9))
        panel.plot(*(1e3 * result.here[[across, up]]), marker="o", color="white", label="job's place", **marked)
        panel.plot(*(1e3 * chosen[[across, up]]), marker="*", color=LIMIT, markersize=14, label="chosen", **marked)
        panel.set(xlabel=f"{'xyz'[across]} of the part, mm", ylabel=f"{'xyz'[up]} of the part, mm")
        panel.set_title(f"{'xyz'[through]} = {1e3 * chosen[through]:.0f} mm", fontsize=10)
        panel.set_aspect("equal")
    panels[0].legend(loc="upper left", fontsize=8)
    figure.colorbar(mesh, ax=panels, label="remaining deviation (lower bound), mm")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _section(rating: Ratings, axis: int, value: float) -> np.ndarray:
    """Cut the grid at the value nearest to the given one."""
    nearest = int(np.abs(rating.axes[axis] - value).argmin())
    return np.take(rating.bound, nearest, axis=axis)


def _borders(centres: np.ndarray) -> np.ndarray:
    if len(centres) == 1:
        return np.array([centres[0] - 25.0, centres[0] + 25.0])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.r_[2 * centres[0] - middle[0], middle, 2 * centres[-1] - middle[-1]]
