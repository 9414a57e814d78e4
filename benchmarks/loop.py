"""The loop in virtual shops, to a second, different part: the product sees programs in and measurements out only.

    python -m benchmarks loop --shops 40 --seed 0 --out DIR     files of every shop and rounds.json in DIR

A shop (`benchmarks.shop`) hides three effects and everyday errors. Its robot touches three corners of each part. It
plans path A with the nominal folder and measures twelve poses that `compplan campaign` designs for it, in a frame of
the tracker's own; the log is diagnosed; it plans path A and path B, which lies elsewhere; it cuts A, measures that
part, learns from it, and plans B again with the taught folder. No command may end with another status than 0
(`diagnose` may ask: it is told that the log is meant so). Every program is then run again and again, clamping and
repeatability drawn anew for every part: the table gives the median of the true rms across the path under the shop's own
force. Bands are held against parts whose force is drawn anew by 7 %: the true 95 % point, and the share of tips within.

Steps whose files are in DIR are not done again. A noise floor is sqrt(3) times the standard deviations of the
instrument, the robot and the clamping per axis, and with them, in squares, what one standard deviation of a part's own
force moves the tip across the path: the part that teaches has a force of its own, too, and nobody can tell it from that
of the shop.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.coverage.__main__ import read_band
from benchmarks.shop import (
    CLAMPED,
    REPEATABILITY,
    ROOT,
    SCATTER,
    TRACKER,
    VirtualShop,
    cut_part,
    draw_shop,
    fill_log,
    probe_part,
    touch_part,
)
from compplan.io.quantities import format_length, format_percent

FLOOR = float(np.sqrt(3.0) * np.sqrt(TRACKER**2 + REPEATABILITY**2 + CLAMPED[0] ** 2))
#: Poses; parts that a band is held against, their force drawn anew, and parts of the shop's own force.
POSES, DRAWS, STEADY = 12, 20, 5
WEIGHTS, PULL = "0,60", 400.0
#: Robots: middle of path A [mm], the force as a share of that on the KUKA KR 270, and the language of programs.
ROBOTS = {
    "kuka_kr270": ((1700.0, 0.0, 900.0), 1.0, "krl"), "abb_irb6640_185_280": ((1600.0, 0.0, 800.0), 0.7, "rapid"),
    "staubli_tx200": ((1300.0, 0.0, 500.0), 0.12, "val3"), "yaskawa_gp88": ((1300.0, 0.0, 700.0), 0.3, "inform"),
    "kawasaki_rs080n": ((1200.0, 0.0, 600.0), 0.25, "kawasaki_as"),
}  # fmt: skip
FORCE = np.array([440.0, 1370.0, -635.0])
#: Path B beside A [mm], and the radii of both. [mm]
ELSEWHERE, RADII = (-150.0, 350.0, -200.0), (120.0, 70.0)
#: Programs of a shop, by folder, and what people call them.
ROUNDS = {
    "nominal_A": "A nominal", "nominal_B": "B nominal", "poses_A": "A, 12 poses", "poses_B": "B, 12 poses",
    "taught_A": "A, one part", "taught_B": "B, one part of A",
}  # fmt: skip
#: What is asked: noise floors of A, ratio of B to poses alone, its worst, held tips, width of a band.
FLOORS, BETTER, WORSE, HELD, WIDE = 1.2, 0.55, 1.05, (0.93, 0.97), 1.6
JOB = """schema = 1
name = "path {name}"
robot = "{robot}"
[toolpath]
generator = "circle"
radius_mm = {radius}
feed_mm_s = 10.0
waypoints = {waypoints}
[part]
position_mm = {place}
[process]
model = "constant"
force_N = {force}
frame = "base"
[plan]
rotate_about_tool_axis = false
max_correction_mm = 20.0
[noise]
part_frame_mm = {shift}
part_frame_deg = {turn}
[output]
programs = ["{language}"]
"""


@dataclass(frozen=True)
class Program:
    """A program on the true robot."""

    true: float  #: Median over parts of the shop's own force of the true rms deviation across the path. [m]
    whole: float  #: The same in 3D, along the path too. [m]
    band: float  #: The 95 % band at its widest. [m]
    point: float  #: What 95 % of the parts keep within where they stray most, 3D. [m]
    held: float  #: Share of tips within the band, all parts and places.
    floor: float  #: Noise floor, what a part's own force moves in it. [m]
    predicted: float  #: True rms deviation across the path under the predicted force. [m]


@dataclass(frozen=True)
class ShopResult:
    """What happened in one virtual shop: its seed, robot and hidden causes, and its programs by folder."""

    seed: int
    robot: str
    hidden: tuple[str, ...]
    programs: Mapping[str, Program]


def describe_shops(shops: Sequence[ShopResult], floor: float) -> list[str]:
    """Say how the shops stand beside what is asked; `floor` is the noise floor without a part's own force. [m]"""
    true = {name: np.array([shop.programs[name].true for shop in shops]) for name in ROUNDS}
    own = np.array([shop.programs["taught_A"].floor for shop in shops])
    a = true["taught_A"] / own
    solid = np.mean([s.programs["taught_A"].whole <= FLOORS * s.programs["taught_A"].floor for s in shops])
    ratio = true["taught_B"] / true["poses_B"]
    worse = [int((true[f"taught_{path}"] > 1.001 * true[f"nominal_{path}"]).sum()) for path in "AB"]
    return [
        f"Path A after one part: at most {FLOORS} noise floors off across the path in"
        f" {format_percent(float(np.mean(a <= FLOORS)))} (asked: 95 %), median {np.median(a):.2f}; in 3D in"
        f" {format_percent(float(solid))} (asked: 90 %), {worse[0]} worse than nominal. Noise floor:"
        f" {format_length(floor)}, with force scatter {format_length(float(np.median(own)))}.",
        f"Path B after one part of A: {np.median(ratio):.2f} of after poses alone in the median (asked: at most"
        f" {BETTER}), {ratio.max():.2f} in the worst (asked: {WORSE}), {int((ratio > WORSE).sum())} above that;"
        f" {worse[1]} worse than nominal.",
    ]


def run_product(out: Path, *words: object) -> None:
    """Run a command of the product that writes to `out`, unless it has been run.

    Raises:
        RuntimeError: If it ends with any other status than 0.
    """
    if out.exists():
        return
    line = [sys.executable, "-m", "compplan", *map(str, words), "--out", str(out)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"compplan {words[0]}: status {done.returncode}: {done.stderr.strip()[:200]}")


def write_jobs(work: Path, robot: str, waypoints: int) -> tuple[Path, Path]:
    """Write the jobs of path A and path B."""
    middle, share, language = ROBOTS[robot]
    files = []
    for name, radius, place in zip("AB", RADII, (middle, np.add(middle, ELSEWHERE).tolist()), strict=True):
        text = JOB.format(
            name=name, robot=robot, radius=radius, waypoints=waypoints, place=list(place),
            force=(share * FORCE).round(1).tolist(), shift=1e3 * CLAMPED[0], turn=float(np.degrees(CLAMPED[1])),
            language=language,
        )  # fmt: skip
        files.append(work / f"{name}.toml")
        files[-1].write_text(text, encoding="utf-8")
    return files[0], files[1]


def judge_program(shop: VirtualShop, out: Path) -> Program:
    """Run a program on the true robot as often as `DRAWS` says, every part of its own force and clamping."""
    band = read_band(out / "deviation.csv")
    band = band[np.isfinite(band)]
    chance = [20261122, shop.seed, 5]
    same = replace(shop, random=np.random.default_rng(chance))
    steady = [cut_part(same, out, scatter=0.0) for _ in range(STEADY)]
    cuts = [cut_part(same, out) for _ in range(DRAWS)]
    away = np.array([np.linalg.norm(cut.tip - cut.wanted, axis=1) for cut in cuts])
    band = np.interp(np.linspace(0, 1, away.shape[1]), np.linspace(0, 1, len(band)), band)
    still, pushed, predicted = (
        cut_part(replace(shop, force=force, random=np.random.default_rng(0)), out, scatter=0.0)
        for force in (shop.force, (1.0 + SCATTER) * shop.force, 1.0)
    )
    own = pushed._replace(tip=pushed.wanted + pushed.tip - still.tip).across
    return Program(
        float(np.median([cut.across for cut in steady])), float(np.median([cut.whole for cut in steady])),
        float(band.max()), float(np.quantile(away, 0.95, axis=0).max()), float((away <= band).mean()),
        float(np.hypot(FLOOR, own)), predicted.across,
    )  # fmt: skip


def measure_robot(shop: VirtualShop, robot: str, job: Path, work: Path) -> Path:
    """Measure poses of the shop's robot and diagnose them; return the folder."""
    poses, log = work / "poses", work / "log.csv"
    run_product(poses, "campaign", job, "--poses", POSES, "--weights-kg", WEIGHTS, "--pull-N", PULL,
                "--sigma-mm", 1e3 * TRACKER)  # fmt: skip
    if not log.exists():
        fill_log(replace(shop, random=np.random.default_rng([20261122, shop.seed, 2])), poses / "campaign.csv", log)
    run_product(work / "diagnosed", "diagnose", log, "--robot", robot, "--register", "base,tool", "--assume-ok")
    return work / "diagnosed" / "robot"


def draw_part(seed: int) -> np.random.Generator:
    """Return the randomness of the measured part of a shop; its first draw is the part's own force, in `SCATTER`."""
    return np.random.default_rng([20261122, seed, 6])


def run_shop(seed: int, robot: str, waypoints: int, work: Path) -> ShopResult:
    """Run one shop; return what every program of it left and had promised."""
    shop = draw_shop(ROOT / "robots" / robot, seed)
    a, b = write_jobs(work, robot, waypoints)
    run_product(work / "nominal_A", "plan", a)
    run_product(work / "nominal_B", "plan", b)
    folder = measure_robot(shop, robot, a, work)
    for name, job in (("A", a), ("B", b)):
        run_product(work / f"poses_{name}", "plan", job, "--robot", folder)
    part = work / "part.csv"
    touched = {
        name: touch_part(replace(shop, random=np.random.default_rng([20261122, seed, 7, place])), job,
                         work / f"nominal_{name}")
        for place, (name, job) in enumerate({"A": a, "B": b}.items())
    }  # fmt: skip
    if not part.exists():
        one = replace(touched["A"], random=draw_part(seed))
        probe_part(one, cut_part(one, work / "poses_A"), part)
    run_product(work / "taught_A", "learn", a, part, "--robot", folder, "--frame", "base")
    run_product(work / "taught_B", "plan", b, "--robot", work / "taught_A" / "robot")
    return ShopResult(
        seed, robot, shop.hidden, {name: judge_program(touched[name[-1]], work / name) for name in ROUNDS}
    )


def main() -> None:
    """Print one line a shop, and the shares that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shops", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", choices=ROBOTS, help="One robot for all; else they take turns.")
    parser.add_argument("--waypoints", type=int, default=90)
    parser.add_argument("--out", type=Path, help="Folder to keep the shops' files in.")
    words = parser.parse_args()
    print(f"noise floor {1e3 * FLOOR:.4f} mm; true rms across / widest band, mm, share held: {', '.join(ROUNDS)}")
    shops: list[ShopResult] = []
    failed = 0
    for seed in range(words.seed, words.seed + words.shops):
        robot = words.robot or list(ROBOTS)[seed % len(ROBOTS)]
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder) if words.out is None else words.out / f"shop_{seed:03d}"
            work.mkdir(parents=True, exist_ok=True)
            start = time.monotonic()
            try:
                shop = run_shop(seed, robot, words.waypoints, work)
            except (RuntimeError, ValueError) as error:
                failed += 1
                print(f"{seed:3d} {robot} failed: {error}", flush=True)
                continue
        shops.append(shop)
        rounds = "  ".join(f"{1e3 * p.true:.3f}/{1e3 * p.band:.3f} {p.held:.0%}" for p in shop.programs.values())
        print(f"{seed:3d} {robot} {rounds}   {time.monotonic() - start:.0f} s  {', '.join(shop.hidden)}", flush=True)
        if words.out is not None:
            (words.out / "rounds.json").write_text(json.dumps([asdict(shop) for shop in shops], indent=1), "utf-8")
    if shops:
        print("\n".join(describe_shops(shops, FLOOR)))
    if failed:
        print(f"{failed} shops failed: a command ended with another status than 0")


if __name__ == "__main__":
    main()
