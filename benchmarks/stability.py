"""Calls of chatter beside a simulation of the delay equation in time: `python -m benchmarks.stability [--tool]`.

200 drawn cuts (modes, directions, teeth, speed, arc, depth, coefficients). The simulation knows teeth, not matrices of
angles: every tooth that is in the cut meets its own chip, the tool moves by Runge-Kutta steps, a ring of past positions
is the delay. What grows is unstable. It shares the drawn numbers with the product and nothing else.
With --tool two modes of a tool, 200 to 900 Hz, stand beside those of the arm. The probabilities of chatter are held
against cuts whose masses, damping and coefficients are drawn about what the product is told (Brier score).
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from compplan.process.cutter import Cutter
from compplan.process.engagement import Engagement, middle_angles
from compplan.process.materials import Coefficients
from compplan.process.stability import (
    CutDynamics,
    Modes,
    Spread,
    count_turns,
    find_gains,
    find_multiplier,
    find_odds,
)

RADIUS, ANGLES, STEPS, PERIODS = 5e-3, 720, 96, 160
#: How far the true cut is from what the product is told: frequencies, damping (logarithm), coefficients (share); and
#: the same of measured modes of a tool.
SPREAD, MEASURED = Spread(0.1, 0.4, 0.1), (0.01, 0.15)


def draw_cases(count: int, seed: int) -> dict[str, np.ndarray]:
    """Draw cuts; angles from the travel to the left [rad], SI."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(-90.0, 60.0, count)
    arcs = np.radians(np.stack([first, np.minimum(first + rng.uniform(20.0, 180.0, count), 90.0)], axis=1))
    frequency = np.sort(rng.uniform(8.0, 60.0, (count, 3)), axis=1)
    compliance = 10.0 ** rng.uniform(-6.5, -5.0, (count, 3))  # of each mode along its direction
    ways = rng.normal(size=(count, 3, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    omega = 2 * np.pi * frequency
    return {
        "arc": arcs, "omega": omega, "shape": ways * (omega * np.sqrt(compliance))[:, :, None],
        "damping": np.repeat(rng.uniform(0.01, 0.08, (count, 1)), 3, axis=1), "teeth": rng.integers(1, 5, count),
        "speed": rng.uniform(1500.0, 15000.0, count) / 60.0, "depth": 10.0 ** rng.uniform(-4.0, -1.9, count),
        "kt": rng.uniform(300e6, 2000e6, count), "ratio": rng.uniform(0.15, 0.6, count),
    }  # fmt: skip


def add_tool(cases: dict[str, np.ndarray], seed: int) -> dict[str, np.ndarray]:
    """Return the cases with two modes of a tool, one along each axis; the spindle is fast."""
    rng, count = np.random.default_rng(seed + 1000), len(cases["depth"])
    omega = 2 * np.pi * np.sort(rng.uniform(200.0, 900.0, (count, 2)), axis=1)
    compliance = 10.0 ** rng.uniform(-7.5, -6.3, (count, 2))
    shape = np.eye(2, 3)[None] * (omega * np.sqrt(compliance))[:, :, None]
    return cases | {
        "omega": np.hstack([cases["omega"], omega]), "shape": np.concatenate([cases["shape"], shape], axis=1),
        "damping": np.hstack([cases["damping"], rng.uniform(0.01, 0.05, (count, 2))]),
        "speed": rng.uniform(8000.0, 18000.0, count) / 60.0,
        "depth": cases["depth"] / 3.0,
    }  # fmt: skip


def blur(cases: dict[str, np.ndarray], seed: int) -> dict[str, np.ndarray]:
    """Return cuts that lie about those that the product is told."""
    rng, count = np.random.default_rng(seed + 2000), len(cases["depth"])
    arm = np.arange(cases["omega"].shape[1]) < 3
    draw = rng.normal(size=(5, count, 1))
    faster = np.exp(np.where(arm, draw[0] * SPREAD.frequency, draw[1] * MEASURED[0]))
    damped = np.exp(np.where(arm, draw[2] * SPREAD.damping, draw[3] * MEASURED[1]))
    return cases | {
        "omega": cases["omega"] * faster, "shape": cases["shape"] * faster[:, :, None],
        "damping": cases["damping"] * damped, "kt": cases["kt"] * (1.0 + SPREAD.force * draw[4, :, 0]),
    }


def simulate(cases: dict[str, np.ndarray]) -> np.ndarray:
    """Return by how much each cut grows in a tooth period, all at once. Shape (count,)."""
    count = len(cases["depth"])
    omega, shape, teeth = cases["omega"], cases["shape"], cases["teeth"]
    step = 1.0 / (cases["speed"] * teeth) / STEPS
    rng = np.random.default_rng(0)
    q, rate = 1e-6 * rng.normal(size=(2, *omega.shape)) * np.stack([np.ones_like(omega), omega])
    ring = np.zeros((STEPS + 1, count, 2))
    levels = np.zeros((PERIODS, count))
    number = np.arange(4)

    def push(t: float, q: np.ndarray, rate: np.ndarray, before: np.ndarray) -> np.ndarray:
        turn = -2 * np.pi * t / teeth[:, None] + 2 * np.pi * number / teeth[:, None]  # t in tooth periods
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        on = (turn > cases["arc"][:, :1]) & (turn < cases["arc"][:, 1:]) & (number < teeth[:, None])
        motion = np.einsum("cm,cmi->ci", q, shape[:, :, :2]) - before
        chip = motion[:, :1] * np.cos(turn) + motion[:, 1:] * np.sin(turn)
        size = on * chip * (cases["kt"] * cases["depth"])[:, None]
        ratio = cases["ratio"][:, None]
        fx = (size * (-np.sin(turn) - ratio * np.cos(turn))).sum(axis=1)
        fy = (size * (np.cos(turn) - ratio * np.sin(turn))).sum(axis=1)
        drive = shape[:, :, 0] * fx[:, None] + shape[:, :, 1] * fy[:, None]
        return drive - 2 * cases["damping"] * omega * rate - omega**2 * q

    h = step[:, None]
    for i in range(PERIODS * STEPS):
        ring[i % (STEPS + 1)] = np.einsum("cm,cmi->ci", q, shape[:, :, :2])
        old, next_old = ring[(i + 1) % (STEPS + 1)], ring[(i + 2) % (STEPS + 1)]  # a period ago, and a step later
        t = i / STEPS
        a1 = push(t, q, rate, old)
        v2 = rate + 0.5 * h * a1
        a2 = push(t + 0.5 / STEPS, q + 0.5 * h * rate, v2, 0.5 * (old + next_old))
        v3 = rate + 0.5 * h * a2
        a3 = push(t + 0.5 / STEPS, q + 0.5 * h * v2, v3, 0.5 * (old + next_old))
        v4 = rate + h * a3
        a4 = push(t + 1.0 / STEPS, q + h * v3, v4, next_old)
        q, rate = q + h / 6 * (rate + 2 * v2 + 2 * v3 + v4), rate + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        period = i // STEPS
        levels[period] = np.maximum(levels[period], (np.abs(omega * q) + np.abs(rate)).max(axis=1))
        if i % STEPS == STEPS - 1:  # a linear equation may be scaled down; the log keeps the level
            shrink = 1.0 / np.maximum(levels[period], 1e-30)
            ring *= shrink[None, :, None]
            q, rate = q * shrink[:, None], rate * shrink[:, None]
    return np.exp(np.log(np.maximum(levels[PERIODS // 2 :], 1e-30)).mean(axis=0))


def build_cut(cases: dict[str, np.ndarray], i: int) -> CutDynamics:
    """Hand a case to the product."""
    cutter = Cutter(RADIUS, float(cases["depth"][i]))
    angle = (middle_angles(ANGLES) + np.pi) % (2 * np.pi) - np.pi
    on = (angle > cases["arc"][i, 0]) & (angle < cases["arc"][i, 1])
    depth = np.zeros((1, len(cutter.slices), ANGLES), np.float32)
    depth[0, cutter.slices.rise > 0.0] = on
    found = Engagement(cutter, depth, np.array([[1.0, 0.0]]), np.zeros(1))
    kt = 1e-6 * float(cases["kt"][i])
    gain = find_gains(found, Coefficients((kt, kt * float(cases["ratio"][i]), 0.0)), np.array([1e-4]))[0]
    measured = np.arange(cases["omega"].shape[1]) >= 3
    modes = Modes(cases["omega"][i], cases["shape"][i].T, cases["damping"][i], measured)
    teeth = int(cases["teeth"][i])
    return CutDynamics(gain, teeth, 1.0 / float(cases["speed"][i] * teeth), modes)


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cases", type=int, default=200)
    arguments.add_argument("--seed", type=int, default=16)
    arguments.add_argument("--tool", action="store_true", help="two modes of a tool beside those of the arm")
    chosen = arguments.parse_args()
    cases = draw_cases(chosen.cases, chosen.seed)
    cases = add_tool(cases, chosen.seed) if chosen.tool else cases
    clock = time.process_time()
    truth = simulate(cases) > 1.0
    simulated = time.process_time() - clock
    cuts = [build_cut(cases, i) for i in range(chosen.cases)]
    clock = time.process_time()
    semi = np.array([find_multiplier(cut) > 1.0 for cut in cuts])
    middle = time.process_time()
    zero = np.array([count_turns(cut, np.ones(1))[0] > 0 for cut in cuts])
    end = time.process_time()
    print(f"{chosen.cases} drawn cuts, {truth.sum()} grow in the simulation ({simulated:.0f} s of CPU)")
    for name, calls, spent in (("semi-discretisation", semi, middle - clock), ("zero-order", zero, end - middle)):
        agree = (calls == truth).mean()
        missed, false = (truth & ~calls).sum(), (calls & ~truth).sum()
        print(f"{name}: {100 * agree:.1f} % called alike, {missed} missed, {false} false ({spent:.1f} s of CPU)")
    clock = time.process_time()
    odds = np.array([find_odds(cut, SPREAD) for cut in cuts])
    spent = time.process_time() - clock
    blurred = simulate(blur(cases, chosen.seed)) > 1.0
    brier, plain = ((odds - blurred) ** 2).mean(), ((semi - 1.0 * blurred) ** 2).mean()
    print(f"cuts about them, {blurred.sum()} grow: Brier score of the probabilities {brier:.3f}, of yes and no "
          f"{plain:.3f} ({spent:.1f} s of CPU)")  # fmt: skip
    return int((semi == truth).mean() < 0.9)


if __name__ == "__main__":
    sys.exit(main())
