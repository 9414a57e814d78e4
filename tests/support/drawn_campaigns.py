"""Logs without noise that MuJoCo draws of robots with one thing wrong; the product sees folder and log alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from template_robots import TEMPLATES, draw_robot

from benchmarks.campaigns.description import Array, RobotDescription, Spring, write_robot_folder
from benchmarks.campaigns.logbook import Log, tabulate
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, nominal_scenario, simulate_rows
from benchmarks.campaigns.visits import Visits
from compplan.effects import Effect, fold_effects
from compplan.measurement.campaign import Campaign
from compplan.measurement.reading import read_campaign
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder
from compplan.robot.folder import write_robot_folder as write_updated_folder
from compplan.simulation.predict import Prediction, predict_campaign

REFERENCE_C = 21.0
SETTLED, LOADS, PATH_ROWS = 16, 2, 40
#: Columns of a log that holds everything; nothing else of it counts.
COLUMNS = Visits(
    "rich", (), None, (0.0, 0.0, 0.0), 0, 0.0, 1.0, (0.0,) * 6, 1.0, 0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0), 0.0,
    orientation=True, link_encoders=True, temperature=True, time=True,
)  # fmt: skip


def turned_arm() -> RobotDescription:
    """Return an arm that counts about -z and -x, its frames turned against each other, with springs of every kind."""
    robot, _ = draw_robot(np.random.default_rng(1), "kr120_like")
    robot = _turn(robot, "joint_3", (0.4, 0.0, -0.3))
    robot = _turn(robot, "joint_5", (0.0, 0.5, 0.2))
    aside = (Spring("joint_2", "rx", 1e-7), Spring("joint_3", "rz", 2e-7, offset=(0.2, 0.1, 0.0)))
    return replace(_with_askew_tool(robot), springs=(*robot.springs, *aside))


def rail_arm() -> RobotDescription:
    """Return an arm on an elastic rail that counts about -y, where the folder writes the springs about +y."""
    robot, _ = draw_robot(np.random.default_rng(2), "kr240_like", rail=True)
    springs = [s for s in robot.springs if s.joint not in ("rail", "joint_2", "joint_3")]
    springs += [Spring(joint, "ry", 2.5e-7, actuator=True) for joint in ("joint_2", "joint_3")]
    springs.append(Spring("rail", "own", 2e-8, actuator=True))
    return replace(_with_askew_tool(robot), springs=tuple(springs))


def _turn(robot: RobotDescription, joint: str, rpy: tuple[float, float, float]) -> RobotDescription:
    return robot.with_segment(robot.index_of(joint), rpy=rpy)


def _with_askew_tool(robot: RobotDescription) -> RobotDescription:
    """Mount a tool whose flange and TCP axes agree with nothing else."""
    last = len(robot.segments) - 1
    robot = robot.with_segment(last - 1, rpy=(0.2, -0.4, 0.7), mass=25.0, com=(0.06, -0.03, 0.1))
    return robot.with_segment(last, xyz=(0.21, -0.12, 0.16), rpy=(0.3, 1.1, -0.4))


def lay_out_rows(robot: RobotDescription, seed: int, *, later: bool = False, first_rise: float = 0.0) -> Rows:
    """Lay out two static runs, every pose unloaded and loaded, and a loaded path; it warms by 8 K from a rise [K]."""
    random = np.random.default_rng(seed)
    template = next(t for t in TEMPLATES if t.name == robot.name)
    home, half = np.deg2rad(template.home_deg), np.array([0.9, 0.35, 0.5, 1.3, 0.8, 1.3])
    if robot.joint_names[0] == "rail":
        home, half = np.r_[0.3, home], np.r_[1.2, half]
    poses = home + half * random.uniform(-1, 1, (SETTLED, len(home)))
    static = np.repeat(poses, 1 + LOADS, axis=0)
    phase = np.linspace(0.0, 1.7 * np.pi, PATH_ROWS)[:, None]
    path = home + 0.15 * half * np.sin(phase + np.arange(len(home)))
    q = np.vstack([static, path])
    share = template.max_force / 1500.0
    wrench = np.hstack([random.normal(0, 700 * share, (len(q), 3)), random.normal(0, 90 * share, (len(q), 3))])
    wrench[: len(static) : 1 + LOADS] = 0.0
    wrench[len(static) :] = np.array([200.0, -150.0, 400.0, 20.0, -10.0, 15.0]) * share
    middle = len(static) // 2
    run = np.array(["static_1"] * middle + ["static_2"] * (len(static) - middle) + ["path_1"] * PATH_ROWS)
    time = np.cumsum(np.r_[np.full(len(static), 30.0), random.uniform(0.03, 0.07, PATH_ROWS)])
    time = np.round(time - time[0], 4)
    rise = first_rise + 20.0 * (1.0 - np.exp(-time / 3000.0))
    degrees = np.round(np.rad2deg(q), 5)
    return Rows(run, np.char.startswith(run, "path"), time, np.deg2rad(degrees), np.round(wrench, 2), rise, later)


@dataclass(frozen=True, eq=False)
class Drawn:
    """One robot: as MuJoCo knows it, as the product reads it, and rows to be measured."""

    description: RobotDescription  #: The nominal robot, for MuJoCo.
    robot: Robot  #: The same folder, read by the product.
    rows: Rows  #: The plan.
    folder: Path  #: Where the files are.

    @property
    def nominal(self) -> Scenario:
        """The robot of MuJoCo with nothing wrong."""
        return nominal_scenario(self.description)

    def measure(self, real: Scenario, *, rows: Rows | None = None, noise: float = 0.0) -> tuple[Campaign, Reading]:
        """Measure a real robot with noise per axis [m]: the log as the product reads it, and MuJoCo's own reading."""
        rows = self.rows if rows is None else rows
        truth, random = simulate_rows(real, rows), np.random.default_rng(5)
        n = len(rows.q)
        tilt = Rotation.from_rotvec(random.normal(0, noise / 0.3, (n, 3))) * Rotation.from_matrix(truth.rotation)
        measured = {
            "position": truth.position + random.normal(0, noise, (n, 3)), "turn": tilt.as_rotvec(),
            "wrench": truth.wrench, "link": truth.link + random.normal(0, noise / 10, truth.link.shape),
            "temperature": REFERENCE_C + rows.rise, "sigma": np.full(n, max(noise, 1e-5)),
        }  # fmt: skip
        log = self.folder / "log.csv"
        visits, empty = replace(COLUMNS, sigma_column=noise > 0), np.zeros((n, 7), bool)
        table = tabulate(rows, visits, self.description, measured, empty)
        Log(table, np.zeros((0, 3)), np.zeros(0, int)).write(log)
        return read_campaign(log, self.robot), truth

    def predict(self, campaign: Campaign, effects: Iterable[Effect], *, later: bool = False) -> Prediction:
        """Predict a log from the folder with effects written into it and read back."""
        write_updated_folder(fold_effects(self.robot, effects), self.folder / "updated")
        return predict_campaign(read_robot_folder(self.folder / "updated"), campaign, later=later)


def draw_robot_files(description: RobotDescription, folder: Path, *, seed: int = 7) -> Drawn:
    """Write a robot's folder and lay out the rows of its campaign."""
    write_robot_folder(description, folder / "robot", {"compliance": "assumed", "geometry": "assumed"})
    return Drawn(description, read_robot_folder(folder / "robot"), lay_out_rows(description, seed), folder)


def turn_between(a: Array, b: Array) -> Array:
    """Return the rotation vectors that lead from rotations b to rotations a. Shape (n, 3). [rad]"""
    return Rotation.from_matrix(a @ np.swapaxes(b, 1, 2)).as_rotvec()
