"""Forces of rounded cutters beside a tooth-by-tooth computation that shares nothing with the package.

A chip is the distance along the inward normal to the body that the tooth before turned in, one feed back.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import compplan as cp

#: Tangential, radial and axial coefficients of cutting [N/mm^2] and of the edge [N/mm].
CUTTING, EDGE = np.array([800.0, 320.0, 150.0]), np.array([20.0, 15.0, 4.0])
#: Pieces of each part of the profile, steps of a turn.
PIECES, STEPS = 150, 720
#: Length of a path [mm] and its waypoints.
LENGTH, ROWS = 24.0, 25

JOB = """schema = 1
name = "One cut"
robot = "staubli_tx200"
toolpath = "path.csv"
[part]
position_mm = [1400.0, 0.0, 300.0]
[process]
model = "end_mill"
diameter_mm = {diameter}
corner_radius_mm = {corner}
teeth = {teeth}
spindle_rpm = 6000.0
coefficients = {{ cutting_N_mm2 = {cutting}, edge_N_mm = {edge} }}
stock = {{ block_mm = [[-100.0, -100.0, -60.0], [100.0, {side}, 0.0]] }}
"""


class Cut(NamedTuple):
    """A straight cut through a block whose top is z = 0 and that ends at y = side; mm and degrees."""

    diameter: float
    corner: float
    depth: float  # of the tip at the last waypoint
    lead: float = 0.0  # of the tool axis, along the travel
    ramp: float = 0.0  # of the path, uphill
    side: float = 100.0
    feed: float = 0.08  # a tooth
    teeth: int = 2

    @property
    def axis(self) -> np.ndarray:
        return np.array([np.sin(np.radians(self.lead)), 0.0, np.cos(np.radians(self.lead))])

    @property
    def travel(self) -> np.ndarray:
        return np.array([np.cos(np.radians(self.ramp)), 0.0, np.sin(np.radians(self.ramp))])


def profile(cut: Cut) -> tuple[np.ndarray, ...]:
    """Distance from the axis, height above the tip, outward normal (away from the axis, along it), length of pieces."""
    radius, corner = 0.5 * cut.diameter, cut.corner
    parts = []
    if radius > corner:
        knots = np.linspace(0.0, radius - corner, PIECES + 1)
        rho, zero = 0.5 * (knots[1:] + knots[:-1]), np.zeros(PIECES)
        parts.append([rho, zero, zero, zero - 1.0, np.diff(knots)])
    knots = np.linspace(0.0, 0.5 * np.pi, PIECES + 1)
    turn = 0.5 * (knots[1:] + knots[:-1])
    parts.append([radius - corner + corner * np.sin(turn), corner * (1 - np.cos(turn)), np.sin(turn), -np.cos(turn),
                  corner * np.diff(knots)])  # fmt: skip
    top = min((cut.depth + radius * abs(cut.axis[0])) / cut.axis[2], 3.0 * cut.diameter)
    if top > corner:
        knots = np.linspace(corner, top, PIECES + 1)
        one = np.ones(PIECES)
        parts.append([radius * one, 0.5 * (knots[1:] + knots[:-1]), one, 0.0 * one, np.diff(knots)])
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def inside(point: np.ndarray, cut: Cut) -> np.ndarray:
    """Tell which points stand in the body that the tooth turns in, tool axes."""
    rho = np.hypot(point[:, 0], point[:, 1])
    ring = np.clip(rho - (0.5 * cut.diameter - cut.corner), 0.0, cut.corner)
    return (rho <= 0.5 * cut.diameter) & (point[:, 2] >= cut.corner - np.sqrt(np.maximum(cut.corner**2 - ring**2, 0.0)))


def compute_mean_force(cut: Cut) -> np.ndarray:
    """Mean force on the tool over a turn, part axes [N]."""
    across = cut.travel - (cut.travel @ cut.axis) * cut.axis
    x = across / np.linalg.norm(across)
    frame = np.stack([x, np.cross(cut.axis, x), cut.axis], axis=1)
    rho, height, out, up, length = profile(cut)
    angle = (np.arange(STEPS) + 0.5) * 2.0 * np.pi / STEPS
    cos, sin = np.cos(angle), np.sin(angle)
    point = np.stack([np.outer(rho, cos), np.outer(rho, sin), np.outer(height, np.ones(STEPS))], axis=-1)
    normal = np.stack([np.outer(out, cos), np.outer(out, sin), np.outer(up, np.ones(STEPS))], axis=-1)
    place = point @ frame.T - [0.0, 0.0, cut.depth]
    step = cut.feed * frame.T @ cut.travel
    in_stock = (place[..., 2] < 0.0) & (place[..., 1] < cut.side)
    piece, turn = np.nonzero(in_stock & (normal @ step > -0.5 * cut.feed))
    # seen from the tooth before, which stood a feed back
    point, normal = point[piece, turn] + step, normal[piece, turn]
    cuts = ~inside(point, cut) & inside(point - 1.5 * cut.feed * normal, cut)
    point, normal, piece, turn = point[cuts], normal[cuts], piece[cuts], turn[cuts]
    low, high = np.zeros(len(point)), np.full(len(point), 1.5 * cut.feed)
    for _ in range(20):
        middle = 0.5 * (low + high)
        hit = inside(point - middle[:, None] * normal, cut)
        low, high = np.where(hit, low, middle), np.where(hit, middle, high)
    size = (CUTTING * (0.5 * (low + high))[:, None] + EDGE) * (length[piece] * cut.teeth / STEPS)[:, None]
    # a clockwise spindle: the material holds a tooth back along z x r, pushes it inwards and draws it down its edge
    back = np.stack([-sin[turn], cos[turn], 0.0 * turn], axis=1)
    edge = np.stack([-up[piece] * cos[turn], -up[piece] * sin[turn], out[piece]], axis=1)
    return frame @ (size[:, :1] * back - size[:, 1:2] * normal - size[:, 2:] * edge).sum(axis=0)


def predict(cut: Cut, folder: Path) -> np.ndarray:
    """Return the force at the last waypoint of a job that makes the cut, part axes [N]."""
    place = np.linspace(-LENGTH, 0.0, ROWS)[:, None] * cut.travel - [0.0, 0.0, cut.depth]
    feed = cut.feed * cut.teeth * 100.0
    rows = [",".join(f"{v:.9f}" for v in (*p, *cut.axis, feed)) + f",{int(k == 0)}" for k, p in enumerate(place)]
    (folder / "path.csv").write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid", *rows]), encoding="utf-8")
    text = JOB.format(**cut._asdict(), cutting=CUTTING.tolist(), edge=EDGE.tolist())
    (folder / "job.toml").write_text(text, encoding="utf-8")
    return cp.predict_forces(cp.load_job(folder / "job.toml")).wrench[-1, :3]


def draw_cut(draw: np.random.Generator) -> Cut:
    """Draw a bull-nose or ball cutter, slot or side cut, from shallow to deeper than the corner."""
    diameter = float(draw.choice([6.0, 8.0, 10.0, 12.0, 16.0]))
    corner = round(0.5 * diameter if draw.random() < 0.3 else diameter * draw.uniform(0.08, 0.45), 3)
    side = 100.0 if draw.random() < 0.5 else round(0.5 * diameter * draw.uniform(-0.6, 0.9), 3)
    return Cut(diameter, corner, depth=corner * draw.uniform(0.3, 2.0), lead=draw.uniform(-15.0, 15.0),
               ramp=draw.uniform(-30.0, 30.0), side=side, feed=draw.uniform(0.04, 0.12),
               teeth=int(draw.integers(2, 5)))  # fmt: skip


#: Forces below this are left out of the drawn cuts: a cutter that leaves the stock uphill touches it with a hair. [N]
TOUCHES = 3.0


def test_fifteen_drawn_cuts_have_the_force_of_a_tooth_by_tooth_computation(tmp_path: Path) -> None:
    draw, errors = np.random.default_rng(44), {}
    while len(errors) < 15:
        cut = draw_cut(draw)
        expected = compute_mean_force(cut)
        if np.linalg.norm(expected) > TOUCHES:
            errors[cut] = float(np.linalg.norm(predict(cut, tmp_path) - expected) / np.linalg.norm(expected))
    assert {cut: error for cut, error in errors.items() if error > 0.03} == {}


@pytest.mark.parametrize(
    "cut",
    [
        Cut(12.0, 2.0, 2.5, lead=-10.0),
        Cut(12.0, 2.0, 2.5, lead=-5.0),
        *(Cut(12.0, corner, 3.0) for corner in (2.0, 2.2, 2.38, 2.6)),
        *(Cut(8.0, 4.0, depth, ramp=30.0) for depth in (1.0, 2.0, 6.0, 12.0)),
        Cut(8.0, 4.0, 3.0, ramp=-30.0),
    ],
    ids=str,
)
def test_cuts_that_were_off_have_it_too(cut: Cut, tmp_path: Path) -> None:
    expected = compute_mean_force(cut)
    assert predict(cut, tmp_path) == pytest.approx(expected, abs=0.03 * np.linalg.norm(expected))
