"""Round trip on every robot and every model: share of the stated 95 % intervals that hold, pooled over repeats.

Run: python benchmarks/interval_coverage.py [REPEATS] (500 by default)
"""

from __future__ import annotations

import sys
import time

from benchmarks.round_trip import MODELS, Coverage, measure_coverage, run_round_trip
from compplan.robot import load_robot, robot_folders


def main(repeats: int) -> None:
    print(f"{'robot':<20}{'model':<18}{'intervals':>10}{'share':>8}{'p value':>9}{'s':>7}", flush=True)
    inside = count = 0
    for name in robot_folders():
        robot = load_robot(name)
        for model in MODELS:
            started = time.perf_counter()
            found: Coverage = measure_coverage([run_round_trip(robot, model, seed) for seed in range(repeats)])
            inside, count = inside + found.inside, count + found.count
            spent = time.perf_counter() - started
            row = f"{found.count:>10}{found.share:>8.4f}{found.p_value:>9.3f}{spent:>7.1f}"
            print(f"{name:<20}{model:<18}{row}", flush=True)
    print(f"{'all':<38}{count:>10}{inside / count:>8.4f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
