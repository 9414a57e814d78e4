"""The ladder of a plan beside what its measurements then give, in the virtual shops of a loop.

    python -m benchmarks loop --shops 20 --out DIR
    python -m benchmarks ladder DIR

Each rung alone: the band that the plan before predicts, over that of the plan after. Touch-off and force log need three
more plans a shop, beside its own in DIR; poses and the first part are those of the loop.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

from benchmarks.loop import run_product
from benchmarks.shop import SCATTER

#: By rung: the plan that predicts, and the plan after.
RUNGS = {
    "touch_off": ("absolute_A", "touched_A"), "force_log": ("nominal_A", "logged_A"), "poses": ("nominal_A", "poses_A"),
    "first_part": ("poses_A", "taught_A"),
}  # fmt: skip
#: A force sensor: level, direction [deg] and what is left from place to place, one standard deviation.
GAIN, TURN, PLACES = 0.02, 0.57, 0.02
#: How far a prediction may be off.
AIM = 0.25


class Step(NamedTuple):
    """A rung of a shop: 95 % bands of the whole path before, as predicted, and after. [mm]"""

    shop: str
    rung: str
    before: float
    predicted: float
    after: float

    @property
    def ratio(self) -> float:
        """Predicted over later band."""
        return self.predicted / self.after


def plan_rungs(shop: Path) -> None:
    """Plan path A in an absolute frame and touched off, both placed as assumed, and with the force logged."""
    job = tomllib.loads((shop / "A.toml").read_text(encoding="utf-8"))
    stated = {"wrench_level": float(np.hypot(GAIN, SCATTER)), "wrench_direction_deg": TURN, "wrench_path": PLACES}
    touched, part = {**job, "noise": {}}, {**job["part"], "touched_off": False}
    jobs = {"absolute_A": {**touched, "part": part}, "touched_A": touched,
            "logged_A": {**job, "noise": {**job["noise"], **stated}}}  # fmt: skip
    for name, table in jobs.items():
        file = shop / f"{name}.toml"
        file.write_text(tomli_w.dumps(table), encoding="utf-8")
        run_product(shop / name, "plan", file)


def read_steps(shop: Path) -> list[Step]:
    """Return the rungs of a shop."""
    plans = {name: json.loads((shop / name / "plan.json").read_text(encoding="utf-8"))
             for pair in RUNGS.values() for name in pair}  # fmt: skip
    band = {name: plan["error_band_mm"]["whole_path_p95"] for name, plan in plans.items()}
    alone = {name: {rung["step"]: rung["alone_p95_max"] for rung in plan["ladder"]} for name, plan in plans.items()}
    return [Step(shop.name, rung, band[before], alone[before][rung], band[after])
            for rung, (before, after) in RUNGS.items()]  # fmt: skip


def list_rungs(steps: list[Step]) -> list[tuple[str, str, str, str, str]]:
    """Return a row a rung: name, median band before and after [mm], predicted over after, shops within AIM."""
    rows = []
    for rung in RUNGS:
        own = [step for step in steps if step.rung == rung]
        ratio = np.array([step.ratio for step in own])
        before, after = (f"{np.median([getattr(step, name) for step in own]):.3f}" for name in ("before", "after"))
        spread = f"{np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f})"
        rows.append((rung, before, after, spread, f"{np.sum(np.abs(ratio - 1.0) <= AIM)} of {len(own)}"))
    return rows


def find_steps(loop: Path) -> list[Step]:
    """Return the rungs of every shop that a loop went through."""
    shops = [shop for shop in sorted(loop.glob("shop_*")) if (shop / "taught_A" / "plan.json").is_file()]
    for shop in shops:
        plan_rungs(shop)
    return [step for shop in shops for step in read_steps(shop)]


def main() -> None:
    """Print a line a rung of a shop, and the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks ladder", description=__doc__.splitlines()[0])
    parser.add_argument("loop", type=Path, help="What `python -m benchmarks loop --out` left.")
    steps = find_steps(parser.parse_args().loop)
    for step in steps:
        print(f"{step.shop} {step.rung:<11}{step.before:7.3f} -> {step.predicted:6.3f} predicted, {step.after:6.3f} mm")
    for row in list_rungs(steps):
        print("  ".join(row))


if __name__ == "__main__":
    main()
