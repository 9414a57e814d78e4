"""Drawn jobs whose posture has to stay: planned, planned again with a measured folder of the same robot, and learned.

    python -m benchmarks.posture_lock --jobs 100 --seed 1 [--log FILE]

About 3 s of processor time a job. With --log every job is a line of FILE, and a second call goes on where that ends.
A job is a robot, a path, a straight or an angled tool and a place. Its measured folder is the robot's with other
compliances, joints displaced by fractions of a millimetre, and lost motion in one joint. The joint positions of three
programs are compared along the path: the job's own; with `--robot` the measured folder; and what
`learn` writes with that folder where a part teaches nothing. A joint that differs by more than 5 degrees (a rail by
10 mm) is another branch, another rotation about the tool axis or another full turn; it counts as unasked unless a note
names it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w
from numpy.typing import NDArray
from rich.progress import Progress

from compplan.errors import CompplanError
from compplan.job.job import load_job
from compplan.learning.part import build_learned
from compplan.plan.plan import build_task, prepare_job
from compplan.plan.strategies import command_path
from compplan.plan.task import PlanTask
from compplan.robot import Robot, load_robot
from compplan.robot.folder import write_robot_folder
from compplan.robot.mounting import mounted_tool

ROBOTS = (
    "kuka_kr270", "staubli_tx200", "ur5e", "ur10e", "kuka_kr240_rail", "fanuc_m20ia", "abb_irb4600_60_205",
    "yaskawa_gp25", "kawasaki_rs020n", "kuka_kr16_2",
)  # fmt: skip
#: Angles of the tool to the flange, and presets. [deg]
ANGLES, PRESETS = (0.0, 45.0, 90.0), ("accurate", "smooth", "fast")
#: What a correction never moves: beyond it the posture is another one. [rad, m]
TURN, SLIDE = float(np.radians(5.0)), 0.01


@dataclass(frozen=True)
class Outcome:
    """What one job did: greatest differences of the two later programs, and whether notes name them."""

    name: str
    changed: tuple[bool, ...]
    named: tuple[bool, ...]
    most: tuple[float, ...]


def draw_job(folder: Path, rng: np.random.Generator) -> tuple[Path, str]:
    """Write a job that its robot may reach; return its file and the robot's name."""
    name = str(rng.choice(ROBOTS))
    robot = load_robot(name)
    reach = robot.longest_reach - sum(j.upper for j in robot.actuated if j.kind == "prismatic")
    size = float(rng.uniform(0.03, 0.10)) * reach * 1e3
    shapes = {
        "circle": {"generator": "circle", "radius_mm": size},
        "spiral": {"generator": "spiral", "outer_radius_mm": size, "turns": 2.0},
        "cone": {"generator": "isf_cone", "diameter_mm": 2 * size, "depth_mm": size / 4, "wall_angle_deg": 45.0,
                 "pitch_mm": size / 8},
    }  # fmt: skip
    shape = shapes[str(rng.choice(list(shapes)))] | {"waypoints": 48, "feed_mm_s": 40.0, "approach_mm": 20.0}
    place = reach * 1e3 * np.array([rng.uniform(0.40, 0.60), rng.uniform(-0.25, 0.25), rng.uniform(0.10, 0.35)])
    length, angle = 0.1 * reach * 1e3, np.radians(float(rng.choice(ANGLES)))
    side = mounted_tool(robot)[:3, :3]
    tip = side @ (length * np.array([np.sin(angle), 0.0, 1.0 + np.cos(angle)]))
    bend = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    table = {
        "schema": 1, "robot": name, "toolpath": shape, "part": {"position_mm": place.tolist()},
        "tool": {"position_mm": tip.tolist(), "rotation_deg": rotation_vector(side @ bend), "mass_kg": 2.0},
        "process": {"model": "constant", "force_N": [-20.0, 10.0, 30.0], "frame": "path"},
        "plan": {"tool_x": [*rng.permutation([1.0, 0.0, 0.0])[:2].tolist(), 0.0]},
        "posture": {"preset": str(rng.choice(PRESETS))},
    }  # fmt: skip
    if not any(table["plan"]["tool_x"]):
        table["plan"]["tool_x"] = [0.0, 1.0, 0.0]
    file = folder / "job.toml"
    file.write_text(tomli_w.dumps(table))
    return file, name


def rotation_vector(rotation: NDArray[np.float64]) -> list[float]:
    """Return a rotation as rotation vector in degrees."""
    from scipy.spatial.transform import Rotation

    return [float(value) for value in Rotation.from_matrix(rotation).as_rotvec(degrees=True)]


def draw_measured(name: str, folder: Path, rng: np.random.Generator) -> Robot:
    """Write the folder of the same robot as a diagnosis might have found it."""
    robot = load_robot(name)
    joints = []
    for joint in robot.joints:
        placement = np.array(joint.placement)
        placement[:3, 3] += rng.normal(0.0, 3e-4, 3)
        joints.append(replace(joint, placement=placement))
    springs = tuple(replace(s, compliance=s.compliance * float(rng.uniform(0.5, 2.0))) for s in robot.springs)
    joint = robot.actuated[int(rng.integers(robot.nq))]
    width = {"width_m": 1e-4} if joint.kind == "prismatic" else {"width_rad": float(rng.uniform(0.2, 2.0)) * 1e-4}
    lost = {"effect": "backlash", "joint": joint.name, "parameters": width}
    measured = replace(robot, joints=tuple(joints), springs=springs, effects=(lost,))
    write_robot_folder(measured, folder)
    return load_robot(folder)


class Way(NamedTuple):
    """A program: the task, its joint positions, waypoints that fail."""

    task: PlanTask
    q: NDArray[np.float64]
    failures: int


def command_task(task: PlanTask) -> Way:
    """Compensate a task."""
    command = command_path(task, "nlp")
    return Way(task, command.q, len(command.failures))


def compare(robot: Robot, first: Way, later: Way) -> tuple[bool, float, bool]:
    """Tell whether a joint stands elsewhere, by how much in shares of what counts, and whether a note says so."""
    q = np.stack([np.interp(later.task.origin, first.task.origin, column) for column in first.q.T], axis=1)
    away = np.abs(later.q - q) / np.where(robot.prismatic, SLIDE, TURN)
    most = float(away[~later.task.nominal.rapid].max())
    notes = later.task.start.notes if later.task.start is not None else ()
    return most > 1.0, most, any("cannot be kept" in note for note in notes)


def run_jobs(count: int, seed: int, before: list[Outcome | None]) -> Iterator[Outcome | None]:
    """Draw jobs until so many were planned; None for one that its robot does not reach. Those before are not drawn."""
    yield from before
    done, number = sum(outcome is not None for outcome in before), len(before)
    while done < count:
        number += 1
        rng = np.random.default_rng([seed, number])
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            file, name = draw_job(folder, rng)
            measured = draw_measured(name, folder / "measured", rng)
            try:
                first = command_task(build_task(*prepare_job(load_job(file)), file=file))
                if first.failures:
                    yield None
                    continue
                again = command_task(build_task(*prepare_job(load_job(file, str(folder / "measured"))), file=file))
                learned = command_task(build_learned(load_job(file), measured, None)[1])
            except CompplanError as error:
                print(number, name, str(error)[:100])
                yield None
                continue
        done += 1
        found = [compare(measured, first, later) for later in (again, learned)]
        yield Outcome(f"{number} {name}", *(tuple(column) for column in (
            [bool(f[0]) for f in found], [bool(f[2]) for f in found], [f[1] for f in found])))  # fmt: skip


def main() -> None:
    """Run the drawn jobs and print what changed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--log", type=Path)
    arguments = parser.parse_args()
    clock, unasked, told, passed, total = time.process_time(), [0, 0], [0, 0], 0, 0
    log, before = arguments.log, []
    if log is not None and log.is_file():
        lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
        before = [None if line is None else Outcome(line[0], *map(tuple, line[1:])) for line in lines]
    with Progress() as progress:
        bar = progress.add_task("jobs", total=arguments.jobs)
        for count, outcome in enumerate(run_jobs(arguments.jobs, arguments.seed, before)):
            if log is not None and count >= len(before):
                line = None if outcome is None else [outcome.name, outcome.changed, outcome.named, outcome.most]
                with log.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(line) + "\n")
            if outcome is None:
                passed += 1
                continue
            total += 1
            progress.advance(bar)
            for k in range(2):
                unasked[k] += outcome.changed[k] and not outcome.named[k]
                told[k] += outcome.changed[k] and outcome.named[k]
            if any(outcome.changed):
                progress.console.print(f"{outcome.name}: {outcome.most[0]:.3g} and {outcome.most[1]:.3g} times what"
                                       f" counts, named {outcome.named}", highlight=False)  # fmt: skip
    print(f"{total} jobs ({passed} more out of reach), {time.process_time() - clock:.0f} s of processor time")
    for k, what in enumerate(("--robot", "learn")):
        print(f"{what}: {unasked[k]} unasked changes of branch, rotation, turns or rail; {told[k]} named")


if __name__ == "__main__":
    main()
