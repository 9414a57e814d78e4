"""Measure the example campaign anew: a KR 270 whose joints are softer and stiffer than its folder says. Seed 7.

Poses and loads are those that stand in measurements.csv: every pose unloaded, then loaded.

Run in the repository: python -m examples.identify.make_campaign
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from benchmarks.round_trip import simulate_observations
from compplan.measurement.reading import read_campaign
from compplan.robot import load_robot
from tests.support.observation_log import write_campaign_log

SEED = 7
FACTORS = (1.4, 0.7, 1.2, 0.8, 1.3, 0.9)


def main(folder: Path = Path(__file__).parent) -> None:
    """Write measurements.csv into a folder."""
    robot = load_robot("kuka_kr270")
    springs = [replace(s, compliance=s.compliance * f) for s, f in zip(robot.springs, FACTORS, strict=True)]
    truth = replace(robot, springs=tuple(springs))
    planned = read_campaign(Path(__file__).with_name("measurements.csv"), robot)
    measured = simulate_observations(truth, planned.q, planned.wrench, seed=SEED)
    write_campaign_log(measured, robot, folder / "measurements.csv")


if __name__ == "__main__":
    main()
