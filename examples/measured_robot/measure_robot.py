"""Measure the example's robot again: a simulated TX200 with hidden errors, its forming force, and a part that it cuts.

The simulated shop is `benchmarks.shop` with seed 4: MuJoCo moves an arm that differs from robots/staubli_tx200 by a
joint zero, a soft link, lost motion and small errors of every axis. A tracker of 0.02 mm per axis gives 41 readings
at 11 postures, without load, with 60 kg at the tool and with pulls of 1200 N. A force sensor logs one part: gain
error 1 % and cross talk 0.3 deg (one standard deviation), noise 2 N. Nothing of this was measured on a real robot.

Run in the repository, two minutes: python -m examples.measured_robot.measure_robot
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from benchmarks.shop import VirtualShop, cut_part, draw_shop, measure_poses
from compplan.cli.application import group
from compplan.job.job import load_job

HERE = Path(__file__).parent
ROOT, SEED = HERE.parents[1], 4
#: The measured and the unmeasured job, the shipped robot.
JOB, BEFORE, ROBOT = HERE / "isf_cone.toml", ROOT / "paths" / "isf_cone.toml", ROOT / "robots" / "staubli_tx200"
CAMPAIGN = ("--poses", "40", "--weights-kg", "0,60", "--pull-N", "1200", "--sigma-mm", "0.02")
#: Gain [1], cross talk [rad] and noise [N] of the force sensor, one standard deviation; every so many rows are kept.
GAIN, TURN, NOISE, KEPT = 0.01, float(np.radians(0.3)), 2.0, 10
#: Step and number of the rows in the air before and after the cut. [mm, 1]
AIR, AIR_ROWS = 5.0, 8
#: Scatter of the force from part to part, one standard deviation, assumed: sheets of one coil.
SCATTER = 0.01


def run(*words: object) -> None:
    """Run a command of compplan and show what it prints."""
    print("$ compplan", *words)
    answer = CliRunner().invoke(group, [str(word) for word in words])
    print(answer.output)
    assert answer.exit_code == 0, answer.exception


def log_force(shop: VirtualShop, predicted: Path, log: Path) -> None:
    """Write what the force sensor reads along the cut of a part and in the air beside it: s_mm, force in part axes."""
    random = np.random.default_rng([SEED, 1])
    head = predicted.read_text(encoding="utf-8").splitlines()[0].split(",")
    table = np.loadtxt(predicted, delimiter=",", skiprows=1)
    table = table[table[:, head.index("rapid")] == 0.0]
    length, table = table[:, head.index("s_mm")] - table[0, head.index("s_mm")], table[::KEPT]
    force = table[:, [head.index(f"f{axis}_N") for axis in "xyz"]] * shop.force * (1.0 + SCATTER * random.normal())
    read = Rotation.from_rotvec(TURN * random.normal(size=3)).apply((1.0 + GAIN * random.normal()) * force)
    read += NOISE * random.normal(size=force.shape)
    length = length[::KEPT]
    air = AIR * np.arange(1, AIR_ROWS + 1)  # before and after the cut: it tells the force from an offset of the sensor
    length = np.concatenate([length[0] - air[::-1], length, length[-1] + air])
    before, after = (NOISE * random.normal(size=(AIR_ROWS, 3)) for _ in range(2))
    rows = np.column_stack([length, np.vstack([before, read, after])])
    np.savetxt(log, rows, "%.6g", ",", header="s_mm,fx_N,fy_N,fz_N", comments="")


def report_part(job: Path, folder: Path) -> None:
    """Print how far the tip of the simulated robot is off the path with the program that a job has in a folder."""
    predicted, assumed = (load_job(file).process.model_dump()["axial_N"] for file in (job, BEFORE))
    shop = draw_shop(ROBOT, SEED)
    cut = cut_part(replace(shop, force=shop.force * assumed / predicted), folder, SCATTER)
    off = 1e3 * np.linalg.norm(cut.tip - cut.wanted, axis=1)
    print(f"{folder.name}: tip {np.sqrt(np.mean(off**2)):.3f} mm rms, {off.max():.3f} mm at most off the path\n")


def main() -> None:
    """Measure, diagnose, plan, and cut a part without and with the correction."""
    with TemporaryDirectory() as name:
        out, shop = Path(name), draw_shop(ROBOT, SEED)
        run("campaign", BEFORE, *CAMPAIGN, "--out", out / "poses")
        measure_poses(shop, out / "poses" / "campaign.csv", HERE / "measurements.csv")
        run("diagnose", HERE / "measurements.csv", "--robot", ROBOT, "--register", "base,tool", "--out", out / "found")
        shutil.rmtree(HERE / "tx200_measured", ignore_errors=True)
        shutil.copytree(out / "found" / "robot", HERE / "tx200_measured")
        run("forces", BEFORE, "--out", out / "forces")
        log_force(shop, out / "forces" / "forces.csv", HERE / "force_log.csv")
        run("forces", BEFORE, "--log", HERE / "force_log.csv", "--out", out / "fitted")
        run("plan", BEFORE, "--out", out / "unmeasured")
        run("plan", JOB, "--out", out / "measured")
        text = JOB.read_text(encoding="utf-8").replace('robot = "tx200_measured"', f'robot = "{ROBOT}"')
        (out / "none.toml").write_text(text.replace('strategy = "nlp"', 'strategy = "none"'), encoding="utf-8")
        CliRunner().invoke(group, ["plan", str(out / "none.toml"), "--out", str(out / "uncorrected")])
        report_part(out / "none.toml", out / "uncorrected")
        report_part(BEFORE, out / "unmeasured")
        report_part(JOB, out / "measured")


if __name__ == "__main__":
    main()
