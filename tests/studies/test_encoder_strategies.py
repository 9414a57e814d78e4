"""Monte Carlo of encoder strategies beside a program of its own: URDF read here, chain, springs and draws in numpy."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.job.job import check_job
from compplan.planning.plan import build_task, prepare_job
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.studies.runner import Settings, run_study
from compplan.studies.study import prepare_study
from compplan.studies.workers import Workers

ROBOTS = Path(__file__).parents[2] / "robots"
#: Middle of the circle, x and z. [mm]
PLACES = {
    "kuka_kr270": (1700.0, 900.0), "abb_irb6640_185_280": (1600.0, 800.0), "yaskawa_gp88": (1300.0, 700.0),
    "kawasaki_rs080n": (1200.0, 600.0), "kuka_kr16_2": (1000.0, 600.0), "fanuc_m20ia": (1100.0, 400.0),
    "abb_irb4600_60_205": (1200.0, 600.0), "fanuc_m710ic50": (1200.0, 500.0), "kuka_kr210_r2700_2": (1600.0, 900.0),
    "yaskawa_gp25": (1000.0, 400.0),
}  # fmt: skip
FORCE, LEVEL, SOFT, SHARE, DRAWS = np.array([200.0, 500.0, -300.0]), 0.15, 0.2, 0.15, 20000
JOB = {
    "schema": 1, "toolpath": {"generator": "circle", "radius_mm": 60.0, "feed_mm_s": 20.0, "waypoints": 12},
    "process": {"model": "constant", "force_N": FORCE.tolist(), "frame": "base"},
    "plan": {"rotate_about_tool_axis": False, "max_correction_mm": 50.0},
    "noise": {"link_share": SHARE, "part_frame_mm": 0.0, "part_frame_deg": 0.0, "wrench_level": LEVEL,
              "wrench_direction_deg": 0.0, "wrench_path": 0.0, "temperature_K": 0.0, "force_noise_N": 0.0},
}  # fmt: skip


def turn_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return a rotation by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def lever_columns(robot: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return motion of the tool per turn of each joint, (3, 6) [m/rad], and compliance and link share of its spring."""
    table = tomllib.loads((ROBOTS / robot / "elasticity.toml").read_text("utf-8"))
    joints = ElementTree.parse(ROBOTS / robot / "robot.urdf").getroot().findall("joint")
    above = {joint.find("child").get("link"): joint for joint in joints}  # type: ignore[union-attr]
    chain, link = [], table["tcp"]
    while link in above:
        chain.insert(0, above[link])
        link = above[link].find("parent").get("link")
    R, p, axes, names, moved = np.eye(3), np.zeros(3), [], [], list(q)
    for joint in chain:
        origin, place = joint.find("origin"), {"xyz": "0 0 0", "rpy": "0 0 0"}
        place |= {} if origin is None else origin.attrib
        p = p + R @ np.array(place["xyz"].split(), float)
        for axis, angle in zip(np.eye(3)[::-1], np.array(place["rpy"].split(), float)[::-1], strict=True):
            R = R @ turn_about(axis, angle)
        if joint.get("type") != "fixed":
            axis = np.array(joint.find("axis").get("xyz").split(), float)
            axes.append((R @ axis / np.linalg.norm(axis), p))
            names.append(joint.get("name"))
            R = R @ turn_about(axis, moved.pop(0))
    springs = {spring["joint"]: spring for spring in table["spring"]}
    own = [(springs[name]["compliance"], springs[name]["link_share"]) for name in names]
    return np.column_stack([np.cross(axis, p - at) for axis, at in axes]), *np.array(own).T


@pytest.mark.parametrize("robot", PLACES)
def test_encoder_strategies_leave_what_another_program_draws(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean rms error of mirror, secondary and both encoders: springs of 20 %, link shares of .15, a force of 15 %."""
    monkeypatch.setattr("compplan.studies.sampling.ENCODERS", (0.0, 0.0))
    x, z = PLACES[robot]
    job = check_job({**JOB, "robot": robot, "part": {"position_mm": [x, 0.0, z], "touched_off": False}})
    arm, nominal, options = prepare_job(job)
    unknowns = tuple(
        Unknown("joint_stiffness", s.joint, None, ("compliance_change_rad_per_Nm",), np.array([SOFT * s.compliance]))
        for s in arm.springs
    )
    unknowns += (Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.full(3, 1e-9)),)
    known = Uncertainty("measured", "test", unknowns, np.eye(len(arm.springs) + 3), repeatability=1e-9)
    task = build_task(replace(arm, uncertainty=known, gravity=None), nominal, options)
    names = ("mirror", "secondary_encoder", "both_encoders")
    ours = run_study(
        prepare_study(task, job.noise, names), Settings(512, 1), workforce=Workers(workers=1)
    ).evaluated.rms

    random, square = np.random.default_rng(1), np.zeros((3, DRAWS))
    soft = 1.0 + SOFT * random.standard_normal((DRAWS, 6))
    level = 1.0 + LEVEL * random.standard_normal((DRAWS, 1))
    spread = SHARE * random.standard_normal((DRAWS, 6))
    for q in task.q_start:
        lever, compliance, share = lever_columns(robot, q)
        bent = level * soft * compliance * (FORCE @ lever)
        beyond = np.clip(share + spread, 0.0, 1.0)
        beta = share / (1.0 - share)
        left = (bent - compliance * (FORCE @ lever), beyond * bent, (beyond - (1.0 - beyond) * beta) * bent)
        square += [np.sum((part @ lever.T) ** 2, axis=1) for part in left]
    theirs = np.sqrt(square / len(task)).mean(axis=1)
    assert ours.mean(axis=0) == pytest.approx(theirs, rel=0.02)
