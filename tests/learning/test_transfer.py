"""What a part tells other paths: the force of its process with a date, the robot whole or not at all."""

from __future__ import annotations

import datetime
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from compplan.controllers.writers.joint_convention import controller_robot
from compplan.effects import Effect
from compplan.errors import InputError
from compplan.job.job import Job, load_job
from compplan.job.noise import NoiseTable
from compplan.learning.gathered_points import Gathered
from compplan.learning.model_update import learn_part
from compplan.learning.representable import add_effect, apply_update
from compplan.learning.transfer import build_part_terms, choose_transfer, learn_force
from compplan.planning.plan import build_task, prepare_job
from compplan.process.force_models.constant import ConstantProcess
from compplan.process.learned_force import (
    FILE,
    SCATTER,
    LearnedForce,
    LearnedPartTable,
    add_part,
    read_learned_force,
    write_learned_force,
)
from compplan.reporting.writers.plan import deliver_plan
from compplan.robot import load_robot
from compplan.robot.folder import find_robot_folder
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.band import Slopes, split_covariance
from compplan.uncertainty.sensitivities import ForceSpread, read_force_spread, tie_force

PATHS = Path(__file__).parents[2] / "paths"
UNIT = Unknown("link_geometry", "joint_1", "ty", ("ty_m",), np.array([1e-4]))
PUSH = ConstantProcess(model="constant", force_N=(0.0, 1.0, 0.0), frame="base")
DAY = datetime.date(2026, 11, 23)


def part_of(level: float, sigma: float = 0.01) -> LearnedPartTable:
    return LearnedPartTable(date=DAY, job="circle", level=level, sigma=sigma)


def force_of(level: float, *parts: float, scatter: float = SCATTER) -> LearnedForce:
    return LearnedForce(level, 0.03, np.zeros(3), None, scatter, tuple(map(part_of, parts)), "base")


@pytest.fixture
def job(tmp_path: Path) -> Job:
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 40")
    (tmp_path / "circle.toml").write_text(text, encoding="utf-8")
    return load_job(tmp_path / "circle.toml")


def test_a_process_file_keeps_what_was_learned_and_other_processes_beside_it(job: Job, tmp_path: Path) -> None:
    known = LearnedForce(1.2, 0.04, np.array([0.01, 0.0, -0.02]), 0.015, 0.08, (part_of(1.23),), "base")
    write_learned_force(known, job.process, tmp_path, None)
    other = job.process.model_copy(update={"force_N": (1.0, 2.0, 3.0)})
    write_learned_force(replace(known, level=0.9), other, tmp_path, tmp_path)
    found = read_learned_force(tmp_path, job.process)
    assert found is not None and found.same
    assert (found.level, found.level_sigma, found.scatter) == pytest.approx((1.2, 0.04, 0.08))
    assert found.turn == pytest.approx(known.turn, abs=1e-6)
    assert found.parts[0].date == DAY
    assert read_learned_force(tmp_path, other).level == pytest.approx(0.9)
    third = read_learned_force(tmp_path, job.process.model_copy(update={"force_N": (0.0, 0.0, -50.0)}))
    assert third is not None and not third.same and not third.turn.any()
    assert third.spread > found.spread and "assumed" in third.source
    (tmp_path / FILE).write_text("schema = 1\n[[process]]\nmodel = 'constant'\nlevel = -1.0\n")
    with pytest.raises(InputError, match="process"):
        read_learned_force(tmp_path, job.process)


def test_a_force_that_goes_with_the_robot_does_so_with_that_uncertainty_alone(job: Job, tmp_path: Path) -> None:
    robot = np.array([[-2e-9, 1e-4, 0.0, 3e-4], [4e-6, 0.0, 0.0, 0.0]])
    (tmp_path / "uncertainty.toml").write_text("schema = 1\n", encoding="utf-8")
    write_learned_force(replace(force_of(1.2, 1.2), turn_sigma=0.02, robot=robot), job.process, tmp_path, None)
    assert read_learned_force(tmp_path, job.process).robot == pytest.approx(robot)
    other = job.process.model_copy(update={"force_N": (0.0, 0.0, -50.0)})
    assert not len(read_learned_force(tmp_path, other).robot)  # other numbers, other force
    (tmp_path / "uncertainty.toml").write_text("schema = 1 # anew\n", encoding="utf-8")
    assert not len(read_learned_force(tmp_path, job.process).robot)


def test_a_band_counts_that_a_harder_push_and_a_softer_arm_bend_alike() -> None:
    """For parameters p and shares f of the force the band is J C J^T, C = cov(p, f); its parts add up, none below 0."""
    rng = np.random.default_rng(4)
    root, tied = rng.standard_normal((3, 3)), 0.3 * rng.standard_normal((4, 3))
    size = np.array([0.2, 0.05, 0.05, 0.05])  # level and turns
    whole = np.block([[root @ root.T, root @ tied.T], [tied @ root.T, np.eye(4)]])
    unknown = Unknown("link_geometry", "joint_1", "tx", tuple(f"t{axis}_m" for axis in "xyz"), np.zeros(3))
    known = Uncertainty("measured", "test", (unknown,), np.eye(3)).with_covariance(whole[:3, :3])
    tie = tie_force(known, ForceSpread(size[0], size[1], 0.0, "test", 0.0, whole[:3, 3:] * size))
    slopes = replace(line(5), model=rng.standard_normal((5, 3, 3)), shared=rng.standard_normal((5, 3, 4)), tie=tie)
    every = np.concatenate([slopes.model, slopes.shared], axis=2)
    parts = split_covariance(slopes, known)
    assert sum(parts.values()) == pytest.approx(every @ whole @ np.swapaxes(every, 1, 2), rel=1e-4, abs=1e-4)
    assert min(np.linalg.eigvalsh(part).min() for part in parts.values()) > -1e-9
    # what rounding or a shared direction says too much is at most all of the force
    sure = ForceSpread(0.01, 0.05, 0.0, "test", 0.0, whole[:3, 3:] * size)
    assert np.linalg.norm(tie_force(known, sure)[0], 2) <= 1.0 + 1e-12


def test_a_lesson_says_how_force_and_robot_go_together() -> None:
    """A parameter and the force push alike: each stays wide, their sum is known, on any path where they push alike."""
    k = 30
    slopes = line(k)
    slopes.model[:, :, 0] = slopes.shared[:, :, 0] / 1e-4  # 1 m a unit
    known = Uncertainty("measured", "test", (UNIT,), np.eye(1), unexplained=2e-5, repeatability=0.0)
    seen = np.tile([0.0, 3e-4, 0.0], (k, 1)) + 1e-6 * np.random.default_rng(2).standard_normal((k, 3))
    gathered = Gathered(np.arange(k), seen, np.tile(np.eye(3), (k, 1, 1)), np.full(k, 1e-12), np.ones(k, int))
    spread = ForceSpread(0.15, 0.05, 0.0, "assumed", 0.0)
    own = build_part_terms(NoiseTable(), slopes.tip[0], slopes, spread, fitted=False)

    def exact(values: np.ndarray, force: np.ndarray) -> np.ndarray:
        return slopes.model @ values + slopes.shared @ force

    model_update = learn_part(slopes, known, gathered, exact, own)
    force, _ = learn_force(model_update, spread, None, PUSH, np.eye(3), "circle", np.ones(1, bool))
    told = known.with_covariance(model_update.covariance)
    share = force.robot / [force.level, 1.0, 1.0, 1.0]
    again = ForceSpread(force.common, force.turn_sigma, 0.0, "told", 0.0, share)
    apart = replace(slopes, shared=slopes.shared * [force.common / spread.level, 1.0, 1.0, 1.0])
    with_tie = split_covariance(replace(apart, tie=tie_force(told, again)), told)
    sizes = [float(np.sqrt(sum(parts.values())[0, 1, 1])) for parts in (with_tie, split_covariance(apart, told))]
    assert sizes[1] > 9e-5 > 4 * sizes[0]


def test_three_parts_tell_their_scatter() -> None:
    """s^2 = (4 a^2 + sum (l - mean)^2 / mean^2) / (4 + n - 1)."""
    three = add_part(force_of(1.0, 0.9, 1.1), part_of(1.0))
    assert three.scatter == pytest.approx(np.sqrt((4 * SCATTER**2 + 0.02) / 6))
    assert three.level == 1.0


@pytest.mark.parametrize("frame", ["part", "base"])
def test_a_direction_that_a_turned_part_taught_stands_in_the_axes_that_its_force_keeps(frame: str) -> None:
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    own = SimpleNamespace(own=SimpleNamespace(ratio=0.0))
    model_update = SimpleNamespace(force=np.array([0.2, 1.0, 0.5, -0.3]), force_covariance=1e-4 * np.eye(4), model=own,
                             own=np.zeros(1), part_spread=0.1, cross=np.array([[0.0, 3e-6, 0.0, 0.0]]))  # fmt: skip
    push = PUSH.model_copy(update={"frame": frame})
    force, _ = learn_force(model_update, ForceSpread(0.15, 0.05, 0.0, "assumed"), None, push, turned, "circle",
                           np.ones(1, bool))  # fmt: skip
    in_base = turned if frame == "part" else np.eye(3)
    assert in_base @ force.turn == pytest.approx(0.05 * model_update.force[1:])
    assert in_base @ force.robot[0, 1:] == pytest.approx([1.5e-7, 0.0, 0.0])


def test_a_force_in_part_axes_turns_with_the_part() -> None:
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    known = LearnedForce(2.0, 0.0, np.array([np.pi / 2, 0.0, 0.0]), 0.0, 0.0, (part_of(2.0),), "part")
    wrench = np.array([[0.0, 0.0, 5.0, 1.0, 0.0, 0.0]])
    wrench.flags.writeable = False  # as a constant force that is spread over waypoints
    assert known.correct(wrench, np.eye(3)) == pytest.approx(np.array([[0.0, -10, 0, 2, 0, 0]]))
    assert known.correct(wrench, turned) == pytest.approx(np.array([[10.0, 0, 0, 0, 0, -2]]))


def test_a_plan_and_its_band_read_the_process_file_of_the_robot_folder(job: Job, tmp_path: Path) -> None:
    """1.2 times the force: the correction grows by that, the independent check agrees, the force's band shrinks."""
    from compplan.planning.plan import plan_job

    folder = tmp_path / "robot"
    shutil.copytree(find_robot_folder("kuka_kr270"), folder)
    write_learned_force(force_of(1.2, 1.2), job.process, folder, None)
    before, after = (plan_job(load_job(job.file, robot)) for robot in ("kuka_kr270", str(folder)))
    assert after.status == "solved"
    assert deliver_plan(after, tmp_path / "out")[0].status == "solved"  # joints.csv, read back
    predicted = np.genfromtxt(tmp_path / "out" / "joints.csv", delimiter=",", names=True, encoding="utf-8")["fy_N"]
    assert np.abs(predicted).max() == pytest.approx(1370.0)  # as [process] predicts it
    assert after.task.wrench == pytest.approx(1.2 * before.task.wrench)
    assert any("1.2 times the predicted" in note for note in after.notes)
    assert not any("times the predicted" in note for note in before.notes)
    assert after.q == pytest.approx(before.q, abs=2e-3)  # the posture is kept
    share = np.hypot(0.03 / 1.2, SCATTER)
    spread = read_force_spread(after.job)
    assert spread.level == pytest.approx(share) and spread.scatter == SCATTER
    assert after.error_band.parts["force"].max() < 0.75 * before.error_band.parts["force"].max()
    assert "1 measured part" in after.error_band.force.source


def line(k: int) -> Slopes:
    """Return a line whose parameter lifts it by its square and whose force pushes it sideways, .1 mm a unit."""
    x = np.linspace(-1.0, 1.0, k)
    model, shared = np.zeros((k, 3, 1)), np.zeros((k, 3, 4))
    model[:, 2, 0], shared[:, 1, 0] = x**2, 1e-4
    return Slopes(np.arange(k), np.column_stack([x, 0 * x, 0 * x]), model, shared, np.zeros((k, 3, 1)))


@pytest.mark.parametrize(("lift", "push", "told"), [(3e-4, 3e-4, (True, True)), (0.0, 3e-4, (True, False))])
def test_stretches_that_were_left_out_say_what_travels(lift: float, push: float, told: tuple[bool, bool]) -> None:
    k, rng = 60, np.random.default_rng(2)
    slopes = line(k)
    unknown = Unknown("link_geometry", "joint_1", "tz", ("tz_m",), np.array([2e-4]))
    known = Uncertainty("measured", "test", (unknown,), np.eye(1), unexplained=2e-5, repeatability=2e-6)
    seen = slopes.model[:, :, 0] * lift + np.array([0.0, push, 0.0]) + 3e-6 * rng.standard_normal((k, 3))
    gathered = Gathered(np.arange(k), seen, np.tile(np.eye(3), (k, 1, 1)), np.full(k, 9e-12), np.ones(k, int))
    spread = ForceSpread(np.hypot(0.15, 0.07), 0.05, 0.0, "assumed", 0.07)
    own = build_part_terms(NoiseTable(), slopes.tip[0], slopes, spread, fitted=False)

    def exact(values: np.ndarray, force: np.ndarray) -> np.ndarray:
        return slopes.model @ values + slopes.shared @ force

    model_update = learn_part(slopes, known, gathered, exact, own)
    travel = choose_transfer(model_update.model, gathered)
    assert (travel.force, travel.robot) == told
    # one part: the level that all parts share is told apart from this part's own by their variances alone
    assert model_update.force[0] * 1e-4 == pytest.approx(push * 0.15**2 / (0.15**2 + 0.07**2), rel=0.05)
    assert model_update.own[0] * own.ratio * 1e-4 == pytest.approx(push * 0.07**2 / (0.15**2 + 0.07**2), rel=0.2)
    # and the band of the next part holds its own force beside what is left of the level
    next_one = 1e-4 * own.ratio * np.sqrt(1.0 + 0.15**2 / (0.15**2 + 0.07**2))
    assert model_update.band_after[0] == pytest.approx(1.96 * next_one, rel=0.05)


def test_a_folder_holds_lost_motion_and_gear_error_with_what_they_belong_to() -> None:
    robot = load_robot("kuka_kr270")
    play = Unknown("backlash", "joint_1", None, ("width_rad",), np.array([3e-5]))
    gear = Unknown("transmission_error", "joint_2", None, ("sine_rad#0", "cosine_rad#0"), np.full(2, 3e-5),
                   {"cycles_per_turn": [1.0]})  # fmt: skip
    known = Uncertainty("measured", "test", (play, gear), np.eye(3))
    values = np.array([2e-5, 1e-5, -4e-5])
    taught, held = apply_update(robot, known, values, np.diag([1e-10] * 3))
    assert held == pytest.approx(values)
    again, more = apply_update(taught, known, np.array([-5e-5, 1e-5, 0.0]), np.diag([1e-10] * 3))
    assert more == pytest.approx([-2e-5, 1e-5, 0.0])  # no play below zero
    assert again.uncertainty is not None
    width = again.uncertainty.spread[0]
    assert width @ width == pytest.approx(1e-10 + 3e-5**2)  # what the folder cannot hold is not known
    assert [table["effect"] for table in again.effects] == ["backlash", "transmission_error"]
    assert again.effects[1]["parameters"]["sine_rad"] == pytest.approx([2e-5])
    assert again.effects[0]["parameters"]["width_rad"] == pytest.approx(0.0, abs=1e-15)
    sizes = {"cycles_per_turn": [1.0], "sine_rad": [1e3], "cosine_rad": [0.0]}
    far = Effect("transmission_error", "joint_2", None, sizes)
    assert add_effect(robot, far, np.array([1e3]))[1] == pytest.approx([0.0])


def test_geometry_that_a_part_taught_is_not_taken_for_that_of_the_controller(job: Job) -> None:
    """The controller shows its own zero: a part that was touched off moves with the true one, which was learned."""
    robot, turn = load_robot("kuka_kr270"), np.array([2e-4])
    zero = Unknown("joint_offset", "joint_1", None, ("offset_rad",), turn)
    updated = apply_update(robot, Uncertainty("measured", "test", (zero,), np.eye(1)), turn, np.zeros((1, 1)))[0]
    believed = controller_robot(updated)
    for shown, old, new in zip(believed.joints, robot.joints, updated.joints, strict=True):
        assert np.array_equal(shown.placement, old.placement)
        assert np.allclose(shown.placement, new.placement, atol=1e-9) == (old.name != "joint_1")
    _, nominal, options = prepare_job(job)
    part = build_task(updated, nominal, options).touched
    assert part is not None and part.displacement is not None
    assert part.displacement[1, 0] == pytest.approx(2e-4, rel=1e-3)
