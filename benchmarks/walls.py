"""Finished walls beside a simulation in time: `python -m benchmarks.walls [--seed 34]`, ten walls drawn by the seed.

A finishing cut along a wall, tooth by tooth and slice by slice of a helical edge. The work is a field of heights; a
tooth takes what its edge meets, the area it takes is its chip. Its force drives an arm (mass, damping), three modes of
a cantilever in closed form [Euler, Bernoulli] both ways, and a wall (a spring, or a tall strip in closed form) that
follows at once. Where they stand is where the next tooth cuts, and what stands in the end is the wall. It knows neither
engagement nor averages nor finite elements; it shares coefficients, stiffness and damping with the product alone.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from compplan.process.cutting import CuttingForce, prepare_cutting
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.process.thin_wall import ThinWallTable
from compplan.process.tool_beam import ToolBeamTable
from compplan.process.walls import judge_walls
from compplan.toolpath.toolpath import Toolpath

CUTTING, EDGE = (800.0, 300.0), (15.0, 12.0)  # tangential, radial [N/mm2, N/mm]
LENGTH, CELL, SLICES = 7.0, 0.0025, 10  # of the block, of the field along the path [mm], slices of the edge
LOOKED = (1.5, 2.3)  # the part of the wall that is looked at: all of the arc cuts there [mm]
STEP = np.radians(0.125)  # of the spindle, in time
BITES, SOFT = 5e-4, 5e-6  # chip from which on the edge force stands in full [mm]; time in which a wall follows [s]
RINGING, ARM_DAMPING = 40.0, 0.7  # of the arm [Hz], []
DAMPING, YOUNG, DENSITY = 0.06, 600e9, 14.5e3  # of the tool: share of critical, carbide [N/m^2, kg/m^3]
ROOTS = (1.8751041, 4.6940911, 7.8547574)  # of a clamped and free beam


class Case(NamedTuple):
    """A wall: cutter [mm], teeth, 1/min, helix [deg], mm a tooth, depth and width of cut [mm], side, and what gives."""

    name: str
    radius: float
    teeth: int
    rpm: float
    helix: float
    per_tooth: float
    deep: float
    wide: float
    side: int
    stickout: float = 0.0  # of the beam [mm], 0 for a rigid tool
    arm: float = 0.0  # compliance [um/N]
    wall: float = 0.0  # stiffness [N/mm], 0 for a rigid one
    tall: float = 0.0  # height of a strip in place of it [mm]


def draw_cases(seed: int, count: int = 10) -> list[Case]:
    """Draw walls: any cutter, cut and side in the ranges of finishing, and any of tool, arm and wall that gives."""
    draw, cases = np.random.default_rng(seed), []
    while len(cases) < count:
        radius = float(draw.choice([3.0, 4.0, 5.0, 6.0, 8.0]))
        size = {
            "radius": radius, "teeth": int(draw.integers(2, 5)), "rpm": float(draw.integers(40, 141) * 100),
            "helix": float(draw.choice([0, 30, 35, 40, 45])), "per_tooth": round(float(draw.uniform(0.03, 0.08)), 3),
            "deep": round(float(draw.uniform(0.4, 1.2) * radius), 1),
            "wide": round(float(draw.uniform(0.04, 0.1) * radius), 2), "side": int(draw.choice([-1, 1])),
        }  # fmt: skip
        tool, arm, wall, strip = draw.random(4) < (0.7, 0.4, 0.3, 0.2)
        gives = {
            "stickout": round(float(draw.uniform(3.5, 5.0) * 2 * radius), 1) * tool,
            "arm": round(float(draw.uniform(0.1, 0.6)), 2) * arm,
            "wall": round(float(draw.uniform(3000, 10000)), -2) * wall * (1 - strip),
            "tall": round(float(draw.uniform(120, 200)), 0) * strip,
        }  # fmt: skip
        if any(gives.values()):
            names = [f"{key} {gives[key]:g}" for key in gives if gives[key]]
            kind = f"D{2 * radius:g} z{size['teeth']} {size['helix']:g} deg {'up' if size['side'] > 0 else 'down'}"
            cases.append(Case(f"{kind}, {', '.join(names)}", **size, **gives))
    return cases


#: A strip: length along the path, thickness [mm], Young's modulus [N/mm^2]; it reaches 1 mm above the cut.
STRIP, THICK, STRIP_YOUNG = 40.0, 25.0, 70e3


def step_mode(omega: np.ndarray, damping: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how modes of 1 kg go on by themselves, and under a force of 1 over a step. Shapes (m, 2, 2), (m, 2)."""
    ring, fade = omega * np.sqrt(1.0 - damping**2), np.exp(-damping * omega * dt)
    c, s = np.cos(ring * dt), np.sin(ring * dt)
    own = np.stack([np.stack([c + damping * omega / ring * s, s / ring], -1),
                    np.stack([-(omega**2) / ring * s, c - damping * omega / ring * s], -1)], -2)  # fmt: skip
    own = own * fade[:, None, None]
    rest = np.stack([1.0 / omega**2, np.zeros_like(omega)], -1)
    return own, rest - np.einsum("mij,mj->mi", own, rest)


def shape_beam(height: np.ndarray, length: float, diameter: float) -> tuple[np.ndarray, np.ndarray]:
    """Return angular frequencies and shapes (m, k) at heights above the tip, scaled to 1 kg; SI."""
    area, inertia, root = 0.25 * np.pi * diameter**2, np.pi * diameter**4 / 64.0, np.array(ROOTS)[:, None]
    z = root * (1.0 - height / length)
    ratio = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    shape = np.cosh(z) - np.cos(z) - ratio * (np.sinh(z) - np.sin(z))
    omega = root[:, 0] ** 2 * np.sqrt(YOUNG * inertia / (DENSITY * area * length**4))
    return omega, shape / np.sqrt(DENSITY * area * length)


def simulate(case: Case) -> np.ndarray:
    """Return by how much too much was taken at each slice of the wall, where it is looked at. Shape (SLICES,). [mm]"""
    turn, dt = case.rpm / 60.0, STEP / (2 * np.pi * case.rpm / 60.0)
    height = (np.arange(SLICES) + 0.5) / SLICES * case.deep
    width = case.deep / SLICES
    lag = height * np.tan(np.radians(case.helix)) / case.radius
    cells = int((LENGTH + 2.0) / CELL)
    field = np.full((SLICES, cells), case.radius - case.wide)
    field[:, int(LENGTH / CELL) :] = 1e3  # no block there
    along = (np.arange(cells) + 0.5) * CELL
    omega, shape = shape_beam(1e-3 * height, 1e-3 * max(case.stickout, 1.0), 1.6e-3 * case.radius)
    own, pushed = step_mode(omega, DAMPING, dt)
    modes = np.zeros((2, len(omega), 2))
    arm_own, arm_pushed = step_mode(np.array([2 * np.pi * RINGING]), ARM_DAMPING, dt)
    arm, soft = np.zeros((1, 2)), 1e-6 * case.arm * (2 * np.pi * RINGING) ** 2
    gives = find_wall_compliance(case, height)
    wall, arm_at, beam_at = np.zeros(SLICES), 0.0, np.zeros((2, SLICES))
    feed, reach = case.per_tooth * case.teeth * turn, np.arccos(1.0 - case.wide / case.radius) + np.radians(4.0)
    before = np.full((case.teeth, SLICES), np.nan)
    for i in range(int((LOOKED[1] + 0.2) / feed / dt)):
        force = np.zeros((2, SLICES))  # along the path, into the wall; on the tool
        for tooth in range(case.teeth):
            # clockwise, seen from above; the angle counts from the travel towards the wall
            angle = -case.side * i * STEP + case.side * lag + 2 * np.pi * tooth / case.teeth
            angle = (angle + np.pi) % (2 * np.pi) - np.pi
            near = np.abs(angle - 0.5 * np.pi) < reach
            if not near.any():
                continue
            x = feed * i * dt + case.radius * np.cos(angle) + 1e3 * beam_at[0]
            last, before[tooth] = before[tooth].copy(), x
            for k in np.flatnonzero(near & np.isfinite(last)):
                low, high = sorted((last[k], x[k]))
                if high <= 0.0 or low >= LENGTH or high - low > 1.0:
                    continue
                cut = slice(int(max(low, 0.0) / CELL), int(min(high, LENGTH) / CELL))
                centre = feed * i * dt + 1e3 * beam_at[0, k]
                edge = np.sqrt(np.maximum(case.radius**2 - (along[cut] - centre) ** 2, 0.0))
                edge += 1e3 * (arm_at + beam_at[1, k] - wall[k])
                old = field[k, cut]
                taken = np.maximum(edge - old, 0.0).sum() * CELL
                if taken <= 0.0:
                    continue
                np.maximum(old, edge, out=old)
                chip = taken / (case.radius * STEP)
                rubs = min(chip / BITES, 1.0)
                size = [width * (K * chip + E * rubs) for K, E in zip(CUTTING, EDGE, strict=True)]
                u = angle[k] + 0.5 * case.side * STEP
                force[0, k] += -case.side * np.sin(u) * size[0] - np.cos(u) * size[1]
                force[1, k] += case.side * np.cos(u) * size[0] - np.sin(u) * size[1]
        if case.stickout > 0.0:
            load = force @ shape.T
            modes = np.einsum("mij,dmj->dmi", own, modes) + pushed * load[:, :, None]
            beam_at = modes[:, :, 0] @ shape
        if case.arm > 0.0:
            arm = np.einsum("mij,mj->mi", arm_own, arm) + arm_pushed * (soft * force[1].sum())
            arm_at = float(arm[0, 0])
        wall += (gives @ -force[1] - wall) * min(dt / SOFT, 1.0)
    middle = slice(int(LOOKED[0] / CELL), int(LOOKED[1] / CELL))
    return field[:, middle].mean(axis=1) - case.radius


def find_wall_compliance(case: Case, height: np.ndarray) -> np.ndarray:
    """Return how the wall gives at heights above the tip to forces at heights. Shape (k, k). [m/N]"""
    if case.tall > 0.0:
        above = 1e-3 * (case.tall - 1.0 - case.deep + height)
        stiff = 1e6 * STRIP_YOUNG * 1e-3 * STRIP * (1e-3 * THICK) ** 3 / 12.0
        low, high = np.minimum.outer(above, above), np.maximum.outer(above, above)
        return low**2 * (3.0 * high - low) / (6.0 * stiff)
    return np.full((len(height), len(height)), 1e-3 / case.wall if case.wall > 0.0 else 0.0)


def predict(case: Case) -> tuple[float, np.ndarray]:
    """Return the product's error of the wall: mean and over its height. [mm]"""
    length = max(LENGTH, 2.0 * case.radius)  # shorter stretches are no wall to the product
    table = {
        "model": "end_mill", "diameter_mm": 2 * case.radius, "teeth": case.teeth, "spindle_rpm": float(case.rpm),
        "helix_deg": float(case.helix), "flute_mm": max(case.stickout, 30.0),
        "coefficients": {"cutting_N_mm2": (*CUTTING, 0.0), "edge_N_mm": (*EDGE, 0.0)},
        "stock": {"block_mm": ((0.0, -40.0, -60.0), (length, -case.radius + case.wide, 0.0)) if case.side < 0 else
                  ((0.0, case.radius - case.wide, -60.0), (length, 40.0, 0.0))},
    }  # fmt: skip
    count = 81
    position = np.zeros((count, 3))
    position[:, 0], position[:, 2] = np.linspace(-1.2 * case.radius, length + 1.2 * case.radius, count), -case.deep
    feed = np.full(count, 1e-3 * case.per_tooth * case.teeth * case.rpm / 60.0)
    path = Toolpath(1e-3 * position, np.tile([0.0, 0.0, 1.0], (count, 1)), feed, np.arange(count) == 0)
    cutting = prepare_cutting(EndMillProcess.model_validate(table), path, None, Path("job.toml"))
    beam = None
    if case.stickout > 0.0:
        beam = ToolBeamTable(stickout_mm=case.stickout, damping=DAMPING).build(2e-3 * case.radius, 1e-3 * case.stickout)
    away = lean_arm(case, cutting, path)
    found = judge_walls(cutting, feed, away, beam, list_thin(case))
    assert len(found) == 1, f"{case.name}: {len(found)} walls"
    return 1e3 * found[0].mean, 1e3 * found[0].error.mean(axis=0)


def list_thin(case: Case) -> list[ThinWallTable]:
    """Return the wall as a job says it."""
    y = case.side * (case.radius + 0.5 * THICK)
    places = {"from_mm": (-8.0, y), "to_mm": (-8.0 + STRIP, y), "thickness_mm": THICK}
    if case.tall > 0.0:
        z = 1.0 - case.tall
        return [ThinWallTable(from_mm=(-8.0, y, z), to_mm=(-8.0 + STRIP, y, z), thickness_mm=THICK,
                              height_mm=case.tall, young_N_mm2=STRIP_YOUNG, poisson=0.0)]  # fmt: skip
    if case.wall > 0.0:
        return [ThinWallTable(from_mm=(*places["from_mm"], -20.0), to_mm=(*places["to_mm"], -20.0), thickness_mm=THICK,
                              height_mm=20.0, stiffness_N_mm=case.wall)]  # fmt: skip
    return []


def lean_arm(case: Case, cutting: CuttingForce, path: Toolpath) -> np.ndarray:
    """Return where the arm stands under the mean force of where it stands. Shape (r, 3). [m]"""
    away = np.zeros((len(path), 3))
    for _ in range(4 if case.arm > 0.0 else 0):
        away[:, 1] = 1e-6 * case.arm * cutting.shift(away).wrench(path)[:, 1]
    return away


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--seed", type=int, default=34)
    worst = 0.0
    print("wall: simulation mean, low to high | product mean, low to high | off by, mean | most over the height")
    for case in draw_cases(parser.parse_args().seed):
        wanted, (mean, over) = simulate(case), predict(case)
        levels = np.interp((np.arange(len(over)) + 0.5) / len(over), (np.arange(SLICES) + 0.5) / SLICES, wanted)
        off = abs(mean - wanted.mean()) / abs(wanted.mean())
        most = float(np.abs(over - levels).max() / np.abs(levels).max())
        worst = max(worst, off)
        sides = [f"{1e3 * a:.1f} um, {1e3 * b:.1f} to {1e3 * c:.1f}" for a, b, c in
                 ((wanted.mean(), wanted[0], wanted[-1]), (mean, over[0], over[-1]))]  # fmt: skip
        print(f"{case.name}: {sides[0]} | {sides[1]} | {100 * off:.1f} % | {100 * most:.1f} %", flush=True)
    print(f"worst: {100 * worst:.1f} % of the mean error of a wall, 10 % allowed")
    return int(worst > 0.10)


if __name__ == "__main__":
    sys.exit(main())
