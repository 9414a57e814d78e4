"""Strategies beside one another as the share of the links in each joint's compliance grows."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from benchmarks.loop import FORCE, ROBOTS
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table, time_command
from compplan.job.job import check_job
from compplan.planning.plan import build_task, prepare_job
from compplan.robot import Array, load_robot
from compplan.studies.runner import Settings as Sampling
from compplan.studies.runner import run_study
from compplan.studies.study import prepare_study
from compplan.studies.summary import estimate_quantile
from compplan.studies.workers import Workers

TITLE = "Comparison: which strategy leaves least?"
QUESTION = "How much deviation do a plan, encoders behind the gears and a force sensor leave, as links get softer?"
METHOD = (
    "A circle of 120 mm radius under a constant force, as in [the loop](loop.md); 256 robots of a Monte Carlo study,"
    " drawn from the shipped folder's assumed uncertainty, the same for all strategies. *Link share*: part of each"
    " joint's compliance beyond its link-side encoder, exact here. Cells: median rms deviation, mm, with half its 95 %"
    " interval. `tests/studies/test_encoder_strategies.py` holds mirror and both encoder strategies within 5 % of a"
    " Monte Carlo of its own, on ten robots."
)
LIMITS = ("Simulated robots, compliances from papers, scaled or assumed; one path, one force; sensors without delay.",)
STRATEGIES = ("mirror", "iterated_mirror", "nlp", "secondary_encoder", "both_encoders", "force_sensor")
CHART = Chart("median rms deviation, mm", {
    name: (name, 0) for name in ("mirror", "secondary_encoder", "both_encoders", "force_sensor")
})  # fmt: skip
SHARES = {"0": 0.0, "1/3": 1 / 3, "1/2": 0.5}
COMPARED, DRAWS, SEED = ("kuka_kr270", "abb_irb6640_185_280", "staubli_tx200", "yaskawa_gp88"), 256, 1


def measure(settings: Settings) -> Findings:
    """Run a study for every robot and link share, and the paper's table."""
    rows, medians = [], {}
    for robot in COMPARED:
        for words, share in SHARES.items():
            rms = 1e3 * draw_rms(robot, share)
            found = [estimate_quantile(column, 0.5) for column in rms.T]
            medians[robot, share] = dict(zip(STRATEGIES, (one.value for one in found), strict=True))
            rows.append((f"{robot}, {words}", *(f"{one.value:.2f}±{one.half_width:.2f}" for one in found)))
            print(*rows[-1], flush=True)
    wins = {share: sum(medians[r, share]["secondary_encoder"] < medians[r, share]["mirror"] for r in COMPARED)
            for share in SHARES.values()}  # fmt: skip
    both, nlp = ([one[name] / one["mirror"] for one in medians.values()] for name in ("both_encoders", "nlp"))
    paper, mean = list_paper(settings)
    asked = ", ".join(f"{wins[share]} of {len(COMPARED)} at {words}" for words, share in SHARES.items())
    return Findings(
        (
            f"Robots on which secondary encoders leave less than mirror compensation, by link share: {asked}.",
            f"Both encoders leave {min(both):.2f} to {max(both):.2f} times as much as mirror, the NLP {min(nlp):.2f} to"
            f" {max(nlp):.2f} times.",
            f"Klimchik 2018, the link share its only free number: both encoders leave {mean['ours']:.1f} % of the mean,"
            f" {mean['paper']:g} % in the paper.",
        ),
        (draw_table(("robot, link share", *STRATEGIES), rows), paper),
        tuple(f"{robot}, link share {share:.2g}: both encoders leave more than mirror."
              for (robot, share), one in medians.items() if one["both_encoders"] > one["mirror"]),
    )  # fmt: skip


def draw_rms(robot: str, share: float) -> Array:
    """Return the rms deviation of every drawn robot by strategy. Shape (DRAWS, strategies). [m]"""
    middle, push, _ = ROBOTS[robot]
    table = {
        "schema": 1, "robot": robot, "toolpath": {"generator": "circle", "radius_mm": 120.0, "feed_mm_s": 10.0,
        "waypoints": 120},
        "part": {"touched_off": False, "position_mm": list(middle)},
        "process": {"model": "constant", "force_N": (push * FORCE).tolist(), "frame": "base"},
        "plan": {"rotate_about_tool_axis": False, "max_correction_mm": 20.0}, "noise": {"link_share": 0.0},
    }  # fmt: skip
    job = check_job(table)
    _, nominal, options = prepare_job(job)
    springs = tuple(replace(s, link_share=share if s.actuator else 0.0) for s in load_robot(robot).springs)
    task = build_task(replace(load_robot(robot), springs=springs), nominal, options)
    study = prepare_study(task, job.noise, STRATEGIES)
    return run_study(study, Sampling(DRAWS, SEED), workforce=Workers(workers=1)).evaluated.rms


def list_paper(settings: Settings) -> tuple[str, dict[str, Any]]:
    """Return the table of Klimchik and Pashkevich 2018 beside its reproduction, and its row of both encoders."""
    time_command("reproduce", "klimchik2018", "--out", settings.work / "paper")
    rows = json.loads((settings.work / "paper" / "reproduction.json").read_text("utf-8"))["rows"]
    left = [row for row in rows if "mean left" in row["quantity"]]
    cells = [(r["quantity"], f"{r['paper']:g} %", f"{r['ours']:.1f} %", r["verdict"]) for r in left]
    table = draw_table(("Klimchik 2018, KUKA KR 120", "paper", "here", "verdict"), cells)
    return table, next(row for row in left if row["quantity"].startswith("Both encoders"))
