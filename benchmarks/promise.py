"""Does the promise hold? Drawn robots against the band of a plan, diagnosed folders against logs that they never saw.

    python -m benchmarks.promise                         the shipped jobs: 1,000 draws each, cost beside the plan's
    python -m benchmarks.promise --unmodelled            the same, robots with errors that the folder does not list
    python -m benchmarks.promise --design                twelve designed poses beside random ones
    python -m benchmarks.promise --suite SUITE           diagnosed folders: share of a later log's rows in the band

"Over oracle" is the width of the band over that of an oracle which knows the distribution of all that is drawn: the
95 % quantile of the true tips' distances at every waypoint, rms and greatest.

A suite is what `python -m benchmarks.campaigns draw` writes: MuJoCo measures, the product diagnoses.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.drawn_robots import Sampled, sample_promise
from compplan.cell.predict import predict_campaign
from compplan.effects import Effect
from compplan.job.job import load_job
from compplan.known.slopes import measure_slopes, stage_path
from compplan.known.vary import stage_robot
from compplan.loop.campaign import Shop, design_campaign
from compplan.measure.distance import band_radius
from compplan.measure.reading import read_campaign
from compplan.plan.plan import Plan, plan_job
from compplan.promise.band import Promise
from compplan.robot import load_robot

ROOT = Path(__file__).parents[1]
JOBS = ("circle_10mm", "circle_500mm", "isf_cone", "spiral", "circle_spindle_90")
#: What robots hide in --unmodelled: a softening of every joint [share of its compliance at its greatest load], and a
#: field over the workspace of this rms distance [m].
SOFTENING, FIELD = 0.1, 1e-4


def time_plan(name: str) -> tuple[Plan, float, float]:
    """Plan a shipped job; return plan, and processor time of plan and of promise. [s]"""
    job = load_job(ROOT / "paths" / f"{name}.toml")
    start = time.process_time()
    plan = plan_job(job)
    middle = time.process_time()
    assert plan.promise is not None
    return plan, middle - start, time.process_time() - middle


def hold_tips(plan: Plan, promise: Promise, draws: int, seed: int, *, unmodelled: bool) -> Sampled:
    """Draw robots; unmodelled ones soften under load and carry a field, and their folder knows nothing of either."""
    scene = stage_path(plan.task.robot, plan.q, plan.task.wrench, plan.task.step_time)
    if not unmodelled:
        return sample_promise(scene, promise, draws, seed)
    wider = replace(promise.known, unexplained=FIELD)
    return sample_promise(scene, promise, draws, seed, true=wider, hide=lambda random: soften(plan, random))


def soften(plan: Plan, random: np.random.Generator) -> Iterator[Effect]:
    """Let every joint's own spring soften under load."""
    load = float(np.abs(plan.task.wrench[:, :3]).max(initial=1.0)) * plan.robot.longest_reach
    for spring in plan.robot.springs:
        if spring.axis == "own":
            ratio = SOFTENING * abs(float(random.standard_normal()))
            yield Effect(
                "stiffness_nonlinearity", spring.joint, None,
                {"quadratic_ratio": ratio, "compliance": spring.compliance, "reference_load": load, "zone_load": load},
            )  # fmt: skip


def print_jobs(names: Sequence[str], draws: int, seed: int, *, unmodelled: bool) -> None:
    """Print one line a job."""
    print("job                 waypoints   p95_max mm   held %   least row %   plan s   promise s   over oracle   most")
    for name in names:
        plan, planning, promising = time_plan(name)
        promise = plan.promise
        assert promise is not None
        sampled = hold_tips(plan, promise, draws, seed, unmodelled=unmodelled)
        wide = promise.radius[sampled.rows] / sampled.oracle
        print(f"{name:<20}{len(plan.task):>9}{promise.greatest * 1e3:>13.3f}{100 * sampled.held:>9.1f}"
              f"{100 * sampled.by_row.min():>14.1f}{planning:>9.2f}{promising:>12.2f}"
              f"{np.sqrt(np.mean(wide**2)):>14.3f}{wide.max():>7.3f}", flush=True)  # fmt: skip


def print_designs(names: Sequence[str], seed: int) -> None:
    """Print what twelve designed poses leave of the parameters' band beside random ones."""
    print("job                 frames       before   12 designed   12 random   50 random   ratio to 50   design s")
    for name in names:
        plan = plan_job(load_job(ROOT / "paths" / f"{name}.toml"))
        for register in ((), ("base", "tool")):
            shop = Shop((0.0, 50.0), 300.0, 3e-5, register, seed)
            start = time.process_time()
            design = design_campaign(plan, shop, 12)
            spent = time.process_time() - start
            before, after = design.model_part(design.start), design.model_part(design.choice.covariance)
            said, (few, many) = "+".join(register) or "known", design.random
            print(f"{name:<20}{said:<12}{before * 1e3:>7.3f}{after * 1e3:>14.3f}{few * 1e3:>12.3f}"
                  f"{many * 1e3:>12.3f}{after / many:>14.2f}{spent:>11.1f}", flush=True)  # fmt: skip


def cover_case(case: Path, out: Path) -> tuple[float, float, float, float, float] | None:
    """Diagnose a case; return share held, rms band, rms left and rms nominal [m] on the later log, calibration."""
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    register = ("base", "tool") if truth.get("register") else ()
    words = [sys.executable, "-m", "compplan", "diagnose", str(case / "measurements.csv"), "--robot",
             str(case / "robot"), "--out", str(out), "--assume-ok"]  # fmt: skip
    if register:
        words += ["--register", ",".join(register)]
    if subprocess.run(words, capture_output=True, check=False).returncode != 0:
        return None
    robot = load_robot(out / "robot")
    known, log = robot.uncertainty, read_campaign(case / "fresh.csv", robot)
    assert known is not None
    rows = np.flatnonzero(log.usable)
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, 300).astype(int))]
    left = (log.position - predict_campaign(robot, log, register=register).position)[rows]
    nominal = (log.position - predict_campaign(load_robot(case / "robot"), log, register=register).position)[rows]
    moved = measure_slopes(stage_robot(robot, log), known.unknowns, rows) @ known.spread
    noise = float(truth["sigma_mm"]) ** 2 * 1e-6 + known.smooth**2
    band = band_radius(moved @ np.swapaxes(moved, 1, 2) + noise * np.eye(3))
    size = np.linalg.norm(left, axis=1)
    far = float(np.sqrt(np.mean(np.sum(nominal**2, axis=1))))
    return (float(np.mean(size <= band)), float(np.sqrt(np.mean(band**2))), float(np.sqrt(np.mean(size**2))), far,
            known.calibration)  # fmt: skip


def print_suite(suite: Path) -> None:
    """Print the share of later rows in the band, case by case, and over all of them."""
    print("case                 held %   band mm   left mm   nominal mm   calibration")
    shares = []
    for case in sorted(path for path in suite.iterdir() if (path / "fresh.csv").is_file()):
        with tempfile.TemporaryDirectory() as folder:
            found = cover_case(case, Path(folder) / "out")
        if found is None:
            print(f"{case.name:<20} not diagnosed", flush=True)
            continue
        held, band, left, nominal, factor = found
        shares.append(held)
        print(f"{case.name:<20}{100 * held:>7.1f}{band * 1e3:>10.3f}{left * 1e3:>10.3f}{nominal * 1e3:>13.3f}"
              f"{factor:>14.2f}", flush=True)  # fmt: skip
    if shares:
        print(f"mean {100 * np.mean(shares):.1f} %, median {100 * np.median(shares):.1f} %,"
              f" at least 90 % in {sum(share >= 0.9 for share in shares)} of {len(shares)}")  # fmt: skip


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", nargs="+", default=list(JOBS))
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--unmodelled", action="store_true")
    parser.add_argument("--design", action="store_true")
    parser.add_argument("--suite", type=Path)
    words = parser.parse_args()
    if words.suite is not None:
        print_suite(words.suite)
    elif words.design:
        print_designs(words.jobs, words.seed)
    else:
        print_jobs(words.jobs, words.draws, words.seed, unmodelled=words.unmodelled)


if __name__ == "__main__":
    main()
