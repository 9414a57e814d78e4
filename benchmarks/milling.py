"""Mean wrench and ripple of a milling cutter beside a simulation in time: `python -m benchmarks milling`.

The simulation goes tooth by tooth and knows neither arcs nor averages: at each instant every piece of every tooth
stands somewhere; how far outside of everything that was swept until one tooth ago it stands there is its chip
thickness. It shares the coefficients with the product and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from compplan.process.cutter import Cutter
from compplan.process.engagement_search import find_engagement
from compplan.process.materials import Coefficients
from compplan.process.milling import Spindle, ripple_amplitude, ripple_force, shape_milling
from compplan.process.stock import build_block

RADIUS, TEETH, HELIX, FEED = 5.0, 3, np.radians(30.0), 0.06  # mm, -, rad, mm a tooth
BLOCK = np.array([[-40.0, -40.0, -20.0], [40.0, 40.0, 0.0]])
MATERIAL = Coefficients((900.0, 350.0, 180.0), (15.0, 12.0, 3.0), (0.2, 0.2, 0.2))
#: Instants of a turn, pieces of the edge in the corner, along the side and on the bottom, poses of what was swept [mm].
INSTANTS, CORNER, SIDE, BOTTOM, POSES = 120, 60, 60, 24, 0.1
UPRIGHT = np.array([0.0, 0.0, 1.0])


def polyline(*knots: tuple[float, float, float]) -> np.ndarray:
    return np.array(knots, float)


def swing(lead_deg: float, tilt_deg: float, length: float = 60.0) -> Callable[[np.ndarray], np.ndarray]:
    """Return axes that lead (along x) and tilt (along y) to and fro over a length of path."""

    def axis(s: np.ndarray) -> np.ndarray:
        turn = np.sin(2 * np.pi * np.asarray(s)[..., None] / length)
        lean = np.tan(np.radians([lead_deg, tilt_deg])) * turn
        found = np.concatenate([lean, np.ones_like(turn)], axis=-1)
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    return axis


@dataclass(frozen=True)
class Case:
    """A path, the half space y < limit that holds material, where to look [mm], cutter, axes and run-out."""

    knots: np.ndarray
    limit: float
    places: tuple[float, ...]
    corner: float = 0.0
    axis: Callable[[np.ndarray], np.ndarray] | None = None
    runout: float = 0.0


SLOPE = 34 * np.tan(np.radians(15))
TWO = polyline((-50, 0, -0.7), (50, 0, -0.7), (50, 1, -0.7), (-10, 1, -0.7))
SLOT, SIDE_CUT = polyline((-50, 0, -3), (12, 0, -3)), polyline((-50, 40, -3), (12, 40, -3))
CASES: dict[str, Case] = {
    "slot": Case(polyline((-50, 0, -3), (2, 0, -3)), np.inf, (50.0,)),
    "half immersion, up": Case(polyline((-50, 40, -3), (2, 40, -3)), 40.0, (50.0,)),
    "half immersion, down": Case(polyline((-50, -40, -3), (2, -40, -3)), -40.0, (50.0,)),
    "ramp, 8 deg": Case(polyline((-30, 0, 1), (4, 0, 1 - 34 * np.tan(np.radians(8)))), np.inf, (33.0,)),
    "plunge": Case(polyline((0, 0, 2), (0, 0, -4)), np.inf, (5.0,)),
    "corner": Case(polyline((-50, 0, -3), (0, 0, -3), (0, 20, -3)), np.inf, (51.0, 52.5, 55.0, 58.0)),
    "slot, run-out": Case(polyline((-50, 0, -3), (2, 0, -3)), np.inf, (50.0,), runout=0.01),
    "half immersion, run-out": Case(polyline((-50, 40, -3), (2, 40, -3)), 40.0, (50.0,), runout=0.02),
    "ball, slot": Case(polyline((-50, 0, -1.5), (2, 0, -1.5)), np.inf, (50.0,), RADIUS),
    "ball, second pass": Case(TWO, np.inf, (140.0,), RADIUS),
    "ball, downhill": Case(polyline((-30, 0, 1), (4, 0, 1 - SLOPE)), np.inf, (30.0,), RADIUS),
    "ball, uphill": Case(polyline((-30, 0, 1 - SLOPE), (4, 0, 1)), np.inf, (15.0,), RADIUS),
    "ball, run-out": Case(polyline((-50, 0, -1.5), (2, 0, -1.5)), np.inf, (50.0,), RADIUS, runout=0.01),
    "corner radius, slot": Case(polyline((-50, 0, -3), (2, 0, -3)), np.inf, (50.0,), 1.5),
    "corner radius, side": Case(polyline((-50, 42, -3), (2, 42, -3)), 40.0, (50.0,), 1.5),
    "slot, lead +-3 deg": Case(SLOT, np.inf, (50.0, 55.0), axis=swing(3, 0)),
    "slot, lead +-20 deg": Case(SLOT, np.inf, (50.0, 55.0), axis=swing(20, 0)),
    "side, tilt +-3 deg": Case(SIDE_CUT, 40.0, (50.0, 55.0), axis=swing(0, 3)),
    "side, tilt +-20 deg": Case(SIDE_CUT, 40.0, (50.0, 55.0), axis=swing(0, 20)),
    "ball, lead and tilt +-20 deg": Case(polyline((-50, 0, -1.5), (12, 0, -1.5)), np.inf, (50.0, 55.0), RADIUS,
                                         swing(20, 20)),
    "ball, second pass, lead +-20 deg": Case(TWO, np.inf, (140.0, 145.0), RADIUS, swing(20, 0)),
    "corner radius, lead and tilt +-10 deg": Case(SLOT, np.inf, (50.0, 55.0), 1.5, swing(10, 10)),
}  # fmt: skip


def walk(knots: np.ndarray, s: np.ndarray) -> np.ndarray:
    arc = np.r_[0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))]
    return np.stack([np.interp(s, arc, knots[:, k]) for k in range(3)], axis=-1)


def stand(case: Case, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tips and axes at lengths of the path."""
    s = np.atleast_1d(s)
    return walk(case.knots, s), np.tile(UPRIGHT, (len(s), 1)) if case.axis is None else case.axis(s)


def find_distance(case: Case, q: np.ndarray, tips: np.ndarray, axes: np.ndarray, longer: np.ndarray) -> np.ndarray:
    """Return how far points are from the nearest of some cutters, each larger by a length. Shape (p,)."""
    nearest = np.full(len(q), np.inf)
    flat = RADIUS - case.corner
    for tip, axis, more in zip(tips, axes, longer, strict=True):
        off = q - tip
        height = off @ axis
        aside = np.sqrt(np.maximum(np.einsum("pi,pi->p", off, off) - height**2, 0.0))
        outside = np.hypot(np.maximum(aside - flat - more, 0.0), np.maximum(case.corner - height, 0.0)) - case.corner
        nearest = np.minimum(nearest, outside)
    return nearest


def draw_edge(case: Case, top: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of a tooth's edge (aside, up), its normals and lengths, up to a height."""
    flat, parts = RADIUS - case.corner, []
    if flat > 0:
        rho = (np.arange(BOTTOM) + 0.5) * flat / BOTTOM
        parts.append((np.column_stack([rho, 0 * rho]), np.tile([0.0, -1.0], (BOTTOM, 1)), flat / BOTTOM))
    if case.corner > 0:
        last = np.arccos(1 - min(top / case.corner, 1.0))
        turn = (np.arange(CORNER) + 0.5) * last / CORNER
        normal = np.column_stack([np.sin(turn), -np.cos(turn)])
        parts.append(([flat, case.corner] + case.corner * normal, normal, last * case.corner / CORNER))
    if top > case.corner:
        up = case.corner + (np.arange(SIDE) + 0.5) * (top - case.corner) / SIDE
        side = np.column_stack([0 * up + RADIUS, up])
        parts.append((side, np.tile([1.0, 0.0], (SIDE, 1)), (top - case.corner) / SIDE))
    points, normals = np.vstack([p[0] for p in parts]), np.vstack([p[1] for p in parts])
    return points, normals, np.concatenate([np.full(len(p[0]), p[2]) for p in parts])


def simulate(case: Case, at: float) -> np.ndarray:
    """Return force and moment at the tip through a turn around a place. Shape (INSTANTS, 6): part axes."""
    down = case.limit < 0
    tip, axis = (v[0] for v in stand(case, np.array([at])))
    slope = np.hypot(*axis[:2]) / axis[2]
    top = -tip[2] / axis[2] + slope * RADIUS
    if np.ptp(case.knots[:, 2]) > 0:
        top += RADIUS
    point, normal, width = draw_edge(case, top)
    history = np.zeros((INSTANTS, 6))
    phase = 2 * np.pi * np.arange(TEETH) / TEETH
    longer = case.runout * np.cos(phase)
    past = np.arange(0.0, at - FEED * TEETH * 2.5, POSES)
    past = past[np.linalg.norm(walk(case.knots, past) - tip, axis=1) < 3 * RADIUS + 6 * slope]
    for i in range(INSTANTS):
        s = at + FEED * TEETH * (i / INSTANTS - 0.5)
        tip, axis = (v[0] for v in stand(case, np.array([s])))
        before = s - FEED * np.arange(1, 2 * TEETH + 1)
        tips, axes = stand(case, np.r_[before, past])
        x = np.cross([0.0, 1.0, 0.0], axis)
        x /= np.linalg.norm(x)
        y = np.cross(axis, x)
        for tooth in range(TEETH):
            # clockwise; higher parts of the helix lag, with one lead
            angle = -2 * np.pi * i / INSTANTS + phase[tooth] + point[:, 1] * np.tan(HELIX) / RADIUS
            radial = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
            out = normal[:, :1] * radial + normal[:, 1:] * axis
            q = tip + (point[:, :1] + longer[tooth]) * radial + point[:, 1:] * axis
            solid = (q[:, 2] < 0) & (q[:, 1] > case.limit if down else q[:, 1] < case.limit)
            # teeth turn to smaller angles: the one before this in the cut stands a tooth back
            sizes = np.r_[longer[(tooth - np.arange(1, 2 * TEETH + 1)) % TEETH], np.full(len(past), longer.max())]
            chip = np.zeros(len(q))
            chip[solid] = find_distance(case, q[solid], tips, axes, sizes)
            on = chip > 1e-9
            h = np.where(on, chip, 1.0)
            tangent = np.cross(axis, radial)
            along = np.cross(tangent, out)  # towards the spindle on the side, towards the axis on the floor
            along *= np.sign(along @ axis + 1e-9 * np.einsum("pi,pi->p", along, radial))[:, None]
            along[normal[:, 0] < 1e-9] = radial[normal[:, 0] < 1e-9]
            ways = (tangent, -out, -along)
            force = np.zeros_like(q)
            for way, k, edge, m in zip(ways, MATERIAL.cutting, MATERIAL.edge, MATERIAL.exponent, strict=True):
                force += ((k * h ** (1 - m) + edge) * width * on)[:, None] * way
            history[i, :3] += force.sum(axis=0)
            history[i, 3:] += np.cross(q - tip, force).sum(axis=0) * 1e-3
    return history


def predict(case: Case, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the product's mean wrench at the tip, and the range of each force component, part axes."""
    total = np.linalg.norm(np.diff(case.knots, axis=0), axis=1).sum()
    arc = np.cumsum(np.linalg.norm(np.diff(case.knots, axis=0), axis=1))
    s = np.unique(np.r_[np.arange(0, total, 0.25), at, arc])
    path, axis = stand(case, s)
    row = int(np.argmin(np.abs(s - at)))
    block = build_block(BLOCK[0] * 1e-3, BLOCK[1] * 1e-3, np.eye(3))
    cutter = Cutter(RADIUS * 1e-3, 0.03, case.corner * 1e-3)
    found = find_engagement(cutter, path * 1e-3, np.ones(len(path), bool), block, axis=axis)
    feed = np.full(len(path), FEED * 1e-3)
    mean = shape_milling(found, TEETH, MATERIAL.exponent).wrench(MATERIAL, feed)[row]
    spindle = Spindle(TEETH, 100.0, HELIX, case.runout * 1e-3)
    turn = ripple_force(found, np.array([row]), MATERIAL, spindle, feed[[row]])
    way = path[row] - path[row - 1]
    x = way - (way @ axis[row]) * axis[row]
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-9 else np.array([1.0, 0.0, 0.0])
    R = np.column_stack([x, np.cross(axis[row], x), axis[row]])
    if case.runout:
        mean = np.r_[turn[0].mean(axis=0), mean[3:]]
    return np.r_[R @ mean[:3], R @ mean[3:]], 2 * ripple_amplitude(turn @ R.T)[0]


def compare(names: list[str] | None = None) -> list[tuple[str, float, float, float]]:
    """Return case, difference of the mean force, of the moment, and of the ripple, as shares."""
    rows = []
    for name in names or list(CASES):
        case = CASES[name]
        for at in case.places:
            history = simulate(case, at)
            truth, span = history.mean(axis=0), history[:, :3].max(axis=0) - history[:, :3].min(axis=0)
            mean, mine = predict(case, at)
            size, lever = (max(np.linalg.norm(part), 1e-9) for part in (truth[:3], truth[3:]))
            label = name if len(case.places) == 1 else f"{name}, at {at:g} mm"
            ripple = np.abs(mine - span).max() / max(span.max(), 1e-9) if span.max() > 0.02 * size else np.nan
            off = [np.linalg.norm(mean[k] - truth[k]) / d for k, d in ((slice(0, 3), size), (slice(3, 6), lever))]
            rows.append((label, float(off[0]), float(off[1]), float(ripple)))
    return rows


def main() -> None:
    print(f"{'case':38s} {'force':>8s} {'moment':>8s} {'ripple':>8s}   difference from the simulation in time")
    for name, *shares in compare():
        print(f"{name:38s} " + " ".join("       -" if np.isnan(s) else f"{100 * s:7.2f}%" for s in shares))


if __name__ == "__main__":
    main()
