"""The plain rival: its robot against Pinocchio, and what it says about campaigns made by MuJoCo-free closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from benchmarks.rival.answer import diagnose
from benchmarks.rival.chain import Chain, load_chain, read_chain
from benchmarks.rival.greedy import fit_frames
from benchmarks.rival.log import read_log

ROBOT = Path(__file__).parents[2] / "robots" / "staubli_tx200"


def poses(chain: Chain, count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (count, len(chain.joints)))


def write_log(file: Path, chain: Chain, q: np.ndarray, turned: np.ndarray, seed: int = 0, frame: bool = False) -> None:
    """Write a log without loads whose links stand at `turned` while the encoders read `q`; 0.02 mm of noise."""
    posed = load_chain(chain, turned, np.zeros((len(q), 6)), chain.gravity if chain.has_gravity else np.zeros(3))
    seen = 1e3 * posed.tip + np.random.default_rng(seed).normal(0.0, 0.02, (len(q), 3))
    if frame:
        target = 1e3 * (posed.tip + posed.attitude @ np.array([0.03, -0.01, 0.02]))
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        seen = target @ turn.T + np.array([2500.0, -700.0, 300.0]) + seen - 1e3 * posed.tip
    names = [f"q{k + 1}_deg" for k in range(q.shape[1])]
    lines = [",".join(["run", *names, "x_mm", "y_mm", "z_mm"])]
    lines += [
        ",".join(["static_1", *(f"{v:.7f}" for v in np.rad2deg(a)), *(f"{v:.5f}" for v in p)])
        for a, p in zip(q, seen, strict=True)
    ]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_the_unloaded_chain_stands_where_pinocchio_puts_it() -> None:
    chain = read_chain(ROBOT)
    q = poses(chain, 5, 1)
    tip = load_chain(chain, q, np.zeros((5, 6)), np.zeros(3)).tip
    model = pinocchio.buildModelFromUrdf(str(ROBOT / "robot.urdf"))
    data = model.createData()
    frame = model.getFrameId("tool0")
    for k in range(5):
        pinocchio.framesForwardKinematics(model, data, q[k])
        assert tip[k] == pytest.approx(data.oMf[frame].translation, abs=1e-12)


def test_a_load_bends_the_chain_by_its_jacobian_and_compliance() -> None:
    """dx = J C J^T w as the load goes to zero [Salisbury1980]."""
    chain = read_chain(ROBOT)
    q = poses(chain, 1, 2)
    wrench = np.array([[0.2, -0.1, 0.3, 0.0, 0.0, 0.0]])
    still = load_chain(chain, q, np.zeros((1, 6)), np.zeros(3))
    bent = load_chain(chain, q, wrench, np.zeros(3))
    moves = [
        (np.cross(axis, still.tip - place), spring.compliance)
        for segment, here in zip(chain.segments, still.springs, strict=True)
        for spring, (axis, place) in zip(segment.springs, here, strict=True)
    ]  # fmt: skip
    expected = sum(c * (move @ wrench[0, :3]) * move for move, c in moves)
    assert bent.tip - still.tip == pytest.approx(expected, rel=1e-4, abs=1e-12)


def test_a_joint_offset_is_named_and_a_later_campaign_predicted(tmp_path: Path) -> None:
    chain = read_chain(ROBOT)
    shift = np.array([0, 0, 4e-4, 0, 0, 0])
    for name, seed in (("given", 3), ("later", 4)):
        q = poses(chain, 40, seed)
        write_log(tmp_path / f"{name}.csv", chain, q, q + shift, seed)
    answer = diagnose(ROBOT, tmp_path / "given.csv")
    said = [(e["effect"], e["joint"]) for e in answer.table["verdict"]["effects"]]
    assert said == [("joint_offset", "joint_3")] and answer.table["verdict"]["status"] == "explained"
    log = read_log(tmp_path / "later.csv", chain)
    miss = np.linalg.norm(log.position - answer.predict(log), axis=1)
    assert np.sqrt(np.mean(miss**2)) == pytest.approx(np.sqrt(3) * 2e-5, rel=0.2)


def test_unknown_frames_are_found_and_nothing_is_named(tmp_path: Path) -> None:
    chain = read_chain(ROBOT)
    q = poses(chain, 40, 5)
    write_log(tmp_path / "log.csv", chain, q, q, 5, frame=True)
    log = read_log(tmp_path / "log.csv", chain)
    posed = load_chain(chain, q, np.zeros((40, 6)), chain.gravity if chain.has_gravity else np.zeros(3))
    frames = fit_frames(log, posed.tip, posed.attitude, ("base", "tool"))
    assert frames.points[""] == pytest.approx([0.03, -0.01, 0.02], abs=5e-5)
    answer = diagnose(ROBOT, tmp_path / "log.csv", ("base", "tool"))
    assert answer.table["verdict"]["effects"] == []


def test_two_per_cent_of_gross_outliers_change_no_name(tmp_path: Path) -> None:
    chain = read_chain(ROBOT)
    q = poses(chain, 100, 6)
    write_log(tmp_path / "log.csv", chain, q, q + np.array([0, 5e-4, 0, 0, 0, 0]), 6)
    lines = (tmp_path / "log.csv").read_text(encoding="utf-8").splitlines()
    for k in (20, 70):
        cells = lines[k].split(",")
        lines[k] = ",".join([*cells[:-3], "0.0", *cells[-2:]])
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    said = diagnose(ROBOT, tmp_path / "log.csv").table["verdict"]["effects"]
    assert [(e["effect"], e["joint"]) for e in said] == [("joint_offset", "joint_2")]
