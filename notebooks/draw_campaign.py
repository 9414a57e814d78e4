"""Draw the campaign of diagnose.ipynb: a KUKA KR 270 measured around a part, two things wrong with it, tracker noise.

    python notebooks/draw_campaign.py

writes diagnose_campaign/measurements.csv, later.csv and truth.toml. The notebook reads truth.toml at its end only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w

from compplan.effects import Effect, apply_effects, build_model, solve_model_poses
from compplan.io.tables import write_table, write_text
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot, load_robot

HERE = Path(__file__).parent / "diagnose_campaign"
ROBOT = "kuka_kr270"
SEED = 7
SIGMA = 25e-6
#: Posture over the part, and how far poses go from it. [rad]
CENTRE = np.deg2rad([0.0, 21.0, -97.0, 0.0, 62.0, -180.0])
REACH = np.deg2rad([40.0, 20.0, 22.0, 60.0, 40.0, 90.0])
POSES, LATER_POSES, FORCE = 45, 30, 1500.0
#: What is wrong: the third joint is 70 % softer than its model, and the zero of the second is 0.4 mrad off.
SOFTER, OFFSET = 0.7, 4e-4


def true_effects(robot: Robot) -> list[Effect]:
    """Return what is wrong with the real robot."""
    own = next(spring for spring in robot.springs if spring.joint == "joint_3")
    change = {"compliance_change_rad_per_Nm": SOFTER * own.compliance}
    return [
        Effect("joint_stiffness", "joint_3", None, change),
        Effect("joint_offset", "joint_2", None, {"offset_rad": OFFSET}),
    ]


def plan_rows(random: np.random.Generator, poses: int) -> Campaign:
    """Plan poses around the part, each unloaded and under two loads."""
    q = np.repeat(CENTRE + REACH * random.uniform(-1.0, 1.0, (poses, 6)), 3, axis=0)
    wrench = np.zeros((len(q), 6))
    wrench[:, :3] = random.uniform(-FORCE, FORCE, (len(q), 3)) / np.sqrt(3.0)
    wrench[::3] = 0.0
    half = len(q) // 6 * 3
    run = np.array(["static_1"] * half + ["static_2"] * (len(q) - half), dtype=np.str_)
    return Campaign(run, q, wrench, np.zeros((len(q), 3)), time=20.0 * np.arange(len(q)))


def write_log(file: Path, rows: Campaign, position: Array) -> None:
    """Write a measurement log."""
    columns: dict[str, Array] = {"run": rows.run, "time_s": rows.time}  # type: ignore[dict-item]
    columns |= {f"q{k + 1}_deg": np.round(np.rad2deg(rows.q[:, k]), 5) for k in range(6)}
    names = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
    columns |= {name: np.round(rows.wrench[:, k], 1) for k, name in enumerate(names)}
    columns |= {f"{axis}_mm": np.round(1e3 * position[:, k], 4) for k, axis in enumerate("xyz")}
    columns["sigma_mm"] = np.full(len(rows), 1e3 * SIGMA)
    write_table(file, columns)


def main() -> None:
    """Draw and write."""
    robot = load_robot(ROBOT)
    random = np.random.default_rng(SEED)
    effects = true_effects(robot)
    HERE.mkdir(exist_ok=True)
    for name, poses in (("measurements.csv", POSES), ("later.csv", LATER_POSES)):
        rows = plan_rows(random, poses)
        attained = solve_model_poses(apply_effects(build_model(robot, rows), effects))
        write_log(HERE / name, rows, attained.position + random.normal(0.0, SIGMA, (len(rows), 3)))
    write_text(HERE / "truth.toml", tomli_w.dumps({"effect": [effect.to_table() for effect in effects]}))


if __name__ == "__main__":
    main()
