"""The loop in virtual shops: MuJoCo robots with hidden errors; the product sees programs in and measurements out only.

    python -m benchmarks.loop --shops 50 --seed 0 --out DIR     files of every shop, rounds.json and report.html in DIR

A shop hides three effects, every third shop one that is in no vocabulary. It cuts the nominal plan; measures twelve
poses that `compplan campaign` designs; has them diagnosed; cuts the new plan; learns from that part; cuts again;
learns; cuts. Its process is not the predicted one: the force is stronger or weaker by what the product states for its
models of it, one draw for all parts. The table gives the true rms deviation across the path of every round beside the
promise made for it. A noise floor is sqrt(3) times the instrument's and the robot's standard deviation per axis.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.campaigns.description import Array, read_description
from benchmarks.campaigns.effects import Effect, apply_effect
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario, simulate_rows
from benchmarks.loop_page import Shop as Judged
from benchmarks.loop_page import say_shops, write_loop_page

ROOT = Path(__file__).parents[1]
#: Instrument and robot per axis, and of a point measured on a part. [m]
TRACKER, REPEATABILITY, PROBE = 2e-5, 1.5e-5, 1e-5
FLOOR = float(np.sqrt(3.0) * np.hypot(TRACKER, REPEATABILITY))
POSES, RADIUS = 12, 0.12
WEIGHTS, PULL = "0,60", 400.0
#: Standard deviation of the force's level, as the product assumes it where nothing is stated.
LEVEL = 0.15
LOAD = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


@dataclass(frozen=True)
class Shop:
    """A virtual shop: what its robot hides, its force over the predicted one, and the randomness of its instruments."""

    scenario: Scenario
    hidden: tuple[str, ...]
    force: float
    random: np.random.Generator


def draw_shop(robot: Path, seed: int) -> Shop:
    """Draw a shop: three hidden effects of different kinds; every third shop has one outside the vocabulary."""
    random = np.random.default_rng([20261122, seed])
    scenario = nominal_scenario(read_description(robot))
    joints = scenario.description.joint_names
    makers: dict[str, Callable[[str], Effect]] = {
        "joint_stiffness": lambda j: Effect("joint_stiffness", j, size=float(random.uniform(0.2, 0.6))),
        "joint_offset": lambda j: Effect("joint_offset", j, size=float(random.uniform(-4, 4)) * 1e-4),
        "backlash": lambda j: Effect("backlash", j, size=float(random.uniform(1, 3)) * 1e-4),
        "transmission_error": lambda j: Effect(
            "transmission_error", j, size=float(random.uniform(0.7, 2)) * 1e-4,
            params={"shape": "waves", "waves": [(1.0, float(random.integers(1, 4)), float(random.uniform(0, 6)))]},
        ),
        "link_compliance": lambda j: Effect("link_compliance", j, "rx", size=float(random.uniform(1, 4)) * 1e-7),
    }  # fmt: skip
    outside = seed % 3 == 2
    names = random.choice(list(makers), size=2 if outside else 3, replace=False)
    hidden = []
    for name in names:
        joint = str(random.choice(joints[:3] if name == "link_compliance" else joints[:5]))
        scenario = apply_effect(makers[str(name)](joint), scenario)
        hidden.append(f"{name} {joint}")
    if outside:
        scenario = add_hose(scenario, random)
        hidden.append("hose (in no vocabulary)")
    force = 1.0 + LEVEL * float(np.random.default_rng([20261122, seed, 1]).standard_normal())
    hidden.append(f"force x {force:.2f}")
    return Shop(scenario, tuple(hidden), force, random)


def add_hose(scenario: Scenario, random: np.random.Generator) -> Scenario:
    """Hang a hose on the tool: it pulls towards a point over the robot, harder the farther the tool is away."""
    anchor = np.array([0.3, 0.0, 2.5]) + 0.3 * random.standard_normal(3)
    stiffness = float(random.uniform(40, 120))

    def pull(rows: Rows, position: Array, rotation: Array) -> Array:
        return np.concatenate([stiffness * (anchor - position), np.zeros((len(position), 3))], axis=1)

    return replace(scenario, loads=(*scenario.loads, pull))


def run_product(*words: object) -> None:
    """Run a command of the product; status 3 still writes its best."""
    line = [sys.executable, "-m", "compplan", *map(str, words)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"compplan {words[0]}: {done.stderr.strip()}")


def move(shop: Shop, q: Array, wrench: Array, *, path: bool, measured: np.ndarray | None = None) -> Array:
    """Let the shop's robot go through rows; return where the tip really is. Shape (n, 3). [m]"""
    n = len(q)
    run = np.array(["path1" if path else "static1"] * n)
    rows = Rows(run, np.full(n, path), np.arange(n) * 0.05, q, wrench, np.zeros(n))
    tip = simulate_rows(shop.scenario, rows, measured).position
    return tip + REPEATABILITY * shop.random.standard_normal((1 if path else len(tip), 3))


def cut(shop: Shop, folder: Path) -> tuple[Array, Array, float]:
    """Cut a planned program; return true tips and wanted tips of the cut, and the promise that was made [m]."""
    with (folder / "joints.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [f"q{k}_deg" for k in range(1, 7)]
    q = np.radians(np.array([[float(row[name]) for name in names] for row in rows]))
    wrench = np.array([[float(row[name]) for name in LOAD] for row in rows])
    cutting = np.flatnonzero([row["move"] == "cut" for row in rows])
    wanted = np.array([[float(rows[k][f"{axis}_mm"]) for axis in "xyz"] for k in cutting]) * 1e-3
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    tip = move(shop, q, shop.force * wrench, path=True, measured=cutting)
    return tip, wanted, plan.get("promise_mm", {}).get("p95_max", np.nan) * 1e-3


def measure_poses(shop: Shop, empty: Path, log: Path) -> None:
    """Fill in an empty log: approach every pose from the side that the program approaches it, and measure."""
    with empty.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    q = np.radians(np.array([[float(row[f"q{k}_deg"]) for k in range(1, 7)] for row in rows]))
    wrench = np.array([[float(row[name]) for name in LOAD] for row in rows])
    tip = move(shop, q, wrench, path=False)
    tip = tip + TRACKER * shop.random.standard_normal(tip.shape)
    for row, point in list(zip(rows, tip, strict=True))[1::2]:
        row.update({f"{axis}_mm": f"{1e3 * point[k]:.5f}" for k, axis in enumerate("xyz")})
        row["sigma_mm"] = f"{1e3 * TRACKER:g}"
    with log.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def probe_part(shop: Shop, tip: Array, place: Array, length: Array, file: Path) -> None:
    """Measure a cut part: points in the part frame with their path length."""
    points = (tip - place) * 1e3 + 1e3 * PROBE * shop.random.standard_normal(tip.shape)
    lines = [",".join(f"{v:.5f}" for v in (*p, 1e3 * s, 1e3 * PROBE)) for p, s in zip(points, length, strict=True)]
    file.write_text("x_mm,y_mm,z_mm,s_mm,sigma_mm\n" + "\n".join(lines) + "\n", encoding="utf-8")


def run_shop(seed: int, robot: str, waypoints: int, work: Path) -> Judged:
    """Run one shop; return the true rms of every round and the promises."""
    shop = draw_shop(ROOT / "robots" / robot, seed)
    text = (ROOT / "paths" / "circle_10mm.toml").read_text(encoding="utf-8")
    text = text.replace("waypoints = 500", f"waypoints = {waypoints}")
    text = text.replace("radius_mm = 10.0", f"radius_mm = {1e3 * RADIUS:g}")
    text = text.replace('programs = ["krl"]', 'programs = ["csv"]')
    place = np.array([1.7, 0.0, 0.9])
    folder: object = robot
    true, promised = [], []

    def write_job() -> Path:
        job = work / "circle.toml"
        job.write_text(text.replace('robot = "kuka_kr270"', f'robot = "{folder}"'), encoding="utf-8")
        return job

    def judge(out: Path) -> tuple[Array, Array]:
        """Return true tips and their lengths along the circle; what is off across it counts."""
        tip, _, promise = cut(shop, out)
        arm = tip - place
        true.append(float(np.sqrt(np.mean((np.hypot(arm[:, 0], arm[:, 1]) - RADIUS) ** 2 + arm[:, 2] ** 2))))
        promised.append(promise)
        return tip, RADIUS * np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))

    run_product("plan", write_job(), "--out", work / "nominal")
    judge(work / "nominal")
    run_product("campaign", write_job(), "--poses", POSES, "--weights-kg", WEIGHTS, "--pull-N", PULL,
                "--sigma-mm", 1e3 * TRACKER, "--out", work / "poses")  # fmt: skip
    measure_poses(shop, work / "poses" / "campaign.csv", work / "log.csv")
    run_product("diagnose", work / "log.csv", "--robot", robot, "--out", work / "diagnosed", "--assume-ok")
    folder = work / "diagnosed" / "robot"
    run_product("plan", write_job(), "--out", work / "replanned")
    tip, length = judge(work / "replanned")
    for part in (1, 2):
        probe_part(shop, tip, place, np.maximum(length, 0.0), work / f"part{part}.csv")
        out = work / f"learned{part}"
        run_product("learn", write_job(), work / f"part{part}.csv", "--robot", folder, "--out", out)
        folder = out / "robot"
        tip, length = judge(out)
    return Judged(seed, shop.hidden, tuple(true), tuple(promised))


def main() -> None:
    """Print one line a shop, and the shares that the issue asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shops", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="kuka_kr270")
    parser.add_argument("--waypoints", type=int, default=120)
    parser.add_argument("--out", type=Path, help="Folder to keep the shops' files in.")
    words = parser.parse_args()
    print(f"noise floor {1e3 * FLOOR:.4f} mm; rms mm / promised p95 mm: nominal, 12 poses, 1 part, 2 parts")
    shops: list[Judged] = []
    for seed in range(words.seed, words.seed + words.shops):
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder) if words.out is None else words.out / f"shop_{seed:03d}"
            work.mkdir(parents=True, exist_ok=True)
            start = time.monotonic()
            try:
                shop = run_shop(seed, words.robot, words.waypoints, work)
            except RuntimeError as error:
                print(f"{seed:3d} failed: {error}", flush=True)
                continue
        rounds = "  ".join(f"{1e3 * a:.3f}/{1e3 * b:.3f}" for a, b in zip(shop.true, shop.promised, strict=True))
        shops.append(shop)
        print(f"{seed:3d} {rounds}   {time.monotonic() - start:.0f} s  {', '.join(shop.hidden)}", flush=True)
        if words.out is not None:
            (words.out / "rounds.json").write_text(json.dumps([asdict(shop) for shop in shops], indent=1), "utf-8")
            write_loop_page(shops, FLOOR, words.out / "report.html")
    if shops:
        print("\n".join(say_shops(shops, FLOOR)))


if __name__ == "__main__":
    main()
