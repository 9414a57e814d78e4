"""Mean wrench and ripple of a milling cutter beside a simulation in time: `python -m benchmarks.milling`.

The simulation goes tooth by tooth and knows neither arcs nor averages: at each instant every piece of every tooth
stands somewhere; how far outside of everything that was swept until one tooth ago it stands there is its chip
thickness. It shares the coefficients with the product and nothing else.
"""

from __future__ import annotations

import numpy as np

from compplan.path.forces.cutter import Cutter
from compplan.path.forces.engagement import find_engagement
from compplan.path.forces.materials import Coefficients
from compplan.path.forces.milling import Spindle, ripple_amplitude, ripple_force, shape_milling
from compplan.path.forces.stock import build_block

RADIUS, TEETH, HELIX, FEED = 5.0, 3, np.radians(30.0), 0.06  # mm, -, rad, mm a tooth
BLOCK = np.array([[-40.0, -40.0, -20.0], [40.0, 40.0, 0.0]])
MATERIAL = Coefficients((900.0, 350.0, 180.0), (15.0, 12.0, 3.0), (0.2, 0.2, 0.2))
INSTANTS, DISCS, RINGS = 240, 40, 40


def polyline(*knots: tuple[float, float, float]) -> np.ndarray:
    return np.array(knots, float)


#: Knots of the path, the half space y < limit that holds material, and the lengths along the path to look at [mm].
CASES: dict[str, tuple[np.ndarray, float, list[float]]] = {
    "slot": (polyline((-50, 0, -3), (2, 0, -3)), np.inf, [50.0]),
    "half immersion, up": (polyline((-50, 40, -3), (2, 40, -3)), 40.0, [50.0]),
    "half immersion, down": (polyline((-50, -40, -3), (2, -40, -3)), -40.0, [50.0]),
    "ramp, 8 deg": (polyline((-30, 0, 1), (4, 0, 1 - 34 * np.tan(np.radians(8)))), np.inf, [33.0]),
    "plunge": (polyline((0, 0, 2), (0, 0, -4)), np.inf, [5.0]),
    "corner": (polyline((-50, 0, -3), (0, 0, -3), (0, 20, -3)), np.inf, [51.0, 52.5, 55.0, 58.0]),
}


def walk(knots: np.ndarray, s: np.ndarray) -> np.ndarray:
    arc = np.r_[0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))]
    return np.stack([np.interp(s, arc, knots[:, k]) for k in range(3)], axis=-1)


def swept_distance(knots: np.ndarray, until: float, q: np.ndarray, height: float) -> np.ndarray:
    """Distance of points q (m, 2) from the part of the path so far where the tip was below a height."""
    arc = np.r_[0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))]
    nearest = np.full(len(q), np.inf)
    for a in range(len(knots) - 1):
        low, high = arc[a], min(arc[a + 1], until)
        if high <= low:
            continue
        z0, z1 = walk(knots, np.array([low, high]))[:, 2]
        if min(z0, z1) > height:
            continue
        if z1 < z0 and z0 > height:
            low += (z0 - height) / (z0 - z1) * (high - low)
        p, r = walk(knots, np.array([low, high]))[:, :2]
        way = r - p
        size = way @ way
        t = np.clip((q - p) @ way / size, 0, 1) if size > 1e-18 else np.zeros(len(q))
        nearest = np.minimum(nearest, np.linalg.norm(q - p - t[:, None] * way, axis=1))
    return nearest


def simulate(knots: np.ndarray, limit: float, at: float) -> np.ndarray:
    """Return force and torque about the axis through a turn around a place. Shape (INSTANTS, 4): part axes."""
    down = limit < 0
    history = np.zeros((INSTANTS, 4))
    depth = max(-walk(knots, np.array([at]))[0, 2], 0.0)
    dz = depth / DISCS
    discs = (np.arange(DISCS) + 0.5) * dz
    kt, kr, ka = MATERIAL.cutting
    et, er, ea = MATERIAL.edge
    m = MATERIAL.exponent[0]
    for i in range(INSTANTS):
        s = at + FEED * TEETH * (i / INSTANTS - 0.5)
        tip = walk(knots, np.array([s]))[0]
        before = walk(knots, np.array([s - FEED]))[0]
        for tooth in range(TEETH):
            foot = -2 * np.pi * i / INSTANTS + 2 * np.pi * tooth / TEETH  # clockwise
            # flank
            angle = foot + discs * np.tan(HELIX) / RADIUS
            out = np.column_stack([np.cos(angle), np.sin(angle)])
            q = tip[:2] + RADIUS * out
            level = tip[2] + discs
            if np.linalg.norm(tip[:2] - before[:2]) > 1e-9:
                chip = np.array([swept_distance(knots, s - FEED, q[j : j + 1], level[j])[0] for j in range(DISCS)])
                chip = np.minimum(chip - RADIUS, FEED)
            else:
                chip = np.zeros(DISCS)
            solid = (level < 0) & (q[:, 1] > limit if down else q[:, 1] < limit)
            on = (chip > 1e-9) & solid
            h = np.where(on, chip, 1.0)
            ft = (kt * h ** (1 - m) + et) * dz * on
            fr = (kr * h ** (1 - m) + er) * dz * on
            fa = (ka * h ** (1 - m) + ea) * dz * on
            history[i, 0] += (-ft * out[:, 1] - fr * out[:, 0]).sum()
            history[i, 1] += (ft * out[:, 0] - fr * out[:, 1]).sum()
            history[i, 2] -= fa.sum()
            history[i, 3] += (ft * RADIUS).sum() * 1e-3
            # floor
            drop = before[2] - tip[2]
            if drop > 1e-9 and tip[2] < 0:
                ring = (np.arange(RINGS) + 0.5) * RADIUS / RINGS
                width = RADIUS / RINGS
                ft = (kt * drop ** (1 - m) + et) * width * np.ones(RINGS)
                fa = (ka * drop ** (1 - m) + ea) * width * np.ones(RINGS)
                history[i, 0] += (-ft * np.sin(foot) - fa * np.cos(foot)).sum()
                history[i, 1] += (ft * np.cos(foot) - fa * np.sin(foot)).sum()
                history[i, 2] += (kr * drop ** (1 - m) + er) * RADIUS
                history[i, 3] += (ft * ring).sum() * 1e-3
    return history


def predict(knots: np.ndarray, at: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the product's mean force and torque, and the range of each force component, part axes."""
    total = np.linalg.norm(np.diff(knots, axis=0), axis=1).sum()
    s = np.unique(np.r_[np.arange(0, total, 0.25), at, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    path = walk(knots, s)
    row = int(np.argmin(np.abs(s - at)))
    block = build_block(BLOCK[0] * 1e-3, BLOCK[1] * 1e-3, np.eye(3))
    found = find_engagement(Cutter(RADIUS * 1e-3, 0.03), path * 1e-3, np.ones(len(path), bool), block)[0]
    feed = np.full(len(path), FEED * 1e-3)
    mean = shape_milling(found, TEETH, MATERIAL.exponent).wrench(MATERIAL, feed)[row]
    turn = ripple_force(found, np.array([row]), MATERIAL, Spindle(TEETH, 100.0, HELIX), feed[[row]])
    way = path[row] - path[row - 1]
    cos, sin = way[:2] / np.linalg.norm(way[:2]) if np.linalg.norm(way[:2]) > 1e-9 else (1.0, 0.0)
    R = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return np.r_[R @ mean[:3], mean[5]], 2 * ripple_amplitude(turn @ R.T)[0]


def compare() -> list[tuple[str, float, float, float]]:
    """Return case, difference of the mean force, of the torque, and of the ripple, as shares."""
    rows = []
    for name, (knots, limit, places) in CASES.items():
        for at in places:
            history = simulate(knots, limit, at)
            truth, span = history.mean(axis=0), history[:, :3].max(axis=0) - history[:, :3].min(axis=0)
            mean, mine = predict(knots, at)
            size = max(np.linalg.norm(truth[:3]), 1e-9)
            label = name if len(places) == 1 else f"{name}, {at - 50:g} mm on"
            ripple = np.abs(mine - span).max() / max(span.max(), 1e-9) if span.max() > 0.02 * size else np.nan
            rows.append((label, np.linalg.norm(mean[:3] - truth[:3]) / size, abs(mean[3] / truth[3] - 1), ripple))
    return rows


def main() -> None:
    print(f"{'case':28s} {'mean force':>11s} {'torque':>8s} {'ripple':>8s}   difference from the simulation in time")
    for name, *shares in compare():
        print(f"{name:28s}    " + " ".join("       -" if np.isnan(s) else f"{100 * s:7.2f}%" for s in shares))


if __name__ == "__main__":
    main()
