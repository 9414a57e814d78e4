"""Calls of chatter beside a simulation of the delay equation in time: `python -m benchmarks.stability`.

200 drawn cuts (modes, directions, teeth, speed, arc, depth, coefficients). The simulation knows teeth, not matrices of
angles: every tooth that is in the cut meets its own chip, the tool moves by Runge-Kutta steps, a ring of past positions
is the delay. What grows is unstable. It shares the drawn numbers with the product and nothing else.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from compplan.path.forces.cutter import Cutter
from compplan.path.forces.engagement import Engagement, middle_angles
from compplan.path.forces.materials import Coefficients
from compplan.path.forces.stability import CutDynamics, Modes, count_turns, find_gains, find_multiplier

RADIUS, ANGLES, STEPS, PERIODS = 5e-3, 720, 96, 160


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
        "damping": rng.uniform(0.01, 0.08, count), "teeth": rng.integers(1, 5, count),
        "speed": rng.uniform(1500.0, 15000.0, count) / 60.0, "depth": 10.0 ** rng.uniform(-4.0, -1.9, count),
        "kt": rng.uniform(300e6, 2000e6, count), "ratio": rng.uniform(0.15, 0.6, count),
    }  # fmt: skip


def simulate(cases: dict[str, np.ndarray]) -> np.ndarray:
    """Return by how much each cut grows in a tooth period, all at once. Shape (count,)."""
    count = len(cases["depth"])
    omega, shape, teeth = cases["omega"], cases["shape"], cases["teeth"]
    step = 1.0 / (cases["speed"] * teeth) / STEPS
    rng = np.random.default_rng(0)
    q, rate = 1e-6 * rng.normal(size=(2, count, 3)) * np.stack([np.ones_like(omega), omega])
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
        return drive - 2 * cases["damping"][:, None] * omega * rate - omega**2 * q

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
    modes = Modes(cases["omega"][i], cases["shape"][i].T, float(cases["damping"][i]))
    teeth = int(cases["teeth"][i])
    return CutDynamics(gain, teeth, 1.0 / float(cases["speed"][i] * teeth), modes)


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cases", type=int, default=200)
    arguments.add_argument("--seed", type=int, default=16)
    chosen = arguments.parse_args()
    cases = draw_cases(chosen.cases, chosen.seed)
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
    return int((semi == truth).mean() < 0.9)


if __name__ == "__main__":
    sys.exit(main())
