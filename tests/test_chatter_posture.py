"""A posture that keeps clear of chatter: priced by the zero-order solution, judged here by semi-discretisation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.force_prediction import predict_forces
from compplan.job.job import Job, check_job
from compplan.plan import stability
from compplan.plan.plan import prepare_job
from compplan.plan.stability import Stability, judge_stability

MILL = {"model": "end_mill", "diameter_mm": 10.0, "teeth": 3, "spindle_rpm": 6000.0, "material": "al7075_t6",
        "stock": {"block_mm": [[-12.0, -20.0, -30.0], [12.0, 20.0, 0.0]]}}  # fmt: skip


def write_slot(folder: Path, avoid: bool, process: dict) -> Job:
    """Return a slot 2 mm deep, by a spindle across the flange: how the arm yields turns with the spin."""
    rows = "-20,0,20,30,1\n-20,0,-2,30,1\n20,0,-2,30,0\n"
    (folder / "slot.csv").write_text(f"x_mm,y_mm,z_mm,feed_mm_s,rapid\n{rows}", encoding="utf-8")
    job = {
        "schema": 1, "name": "slot", "robot": "staubli_tx200", "toolpath": "slot.csv", "process": process,
        "part": {"position_mm": [1500.0, 0.0, 400.0]},
        "tool": {"position_mm": [180.0, 0.0, 120.0], "rotation_deg": [0.0, 90.0, 0.0], "mass_kg": 8.0,
                 "centre_of_mass_mm": [60.0, 0.0, 80.0]},
        "posture": {"spin_step_deg": 15.0}, "stability": {"avoid": avoid},
    }  # fmt: skip
    return check_job(job, folder / "job.toml")


def judge(folder: Path, avoid: bool) -> Stability:
    found, told = judge_stability(predict_forces(write_slot(folder, avoid, MILL)))
    assert found is not None, told
    return found


@pytest.fixture(scope="module")
def avoided(tmp_path_factory: pytest.TempPathFactory) -> Stability:
    """The slot in the posture that avoids chatter; the map over speeds is not asked for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stability, "_draw_map", draw_nothing)
        return judge(tmp_path_factory.mktemp("slot"), True)


def draw_nothing(_: object, waypoint: int, depth: float, __: float) -> stability.StabilityMap:
    return stability.StabilityMap(waypoint, depth, *(np.zeros(0) for _ in range(4)), np.inf)


def test_a_slot_that_chatters_is_cut_in_a_posture_in_which_it_does_not(avoided, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(stability, "_draw_map", draw_nothing)  # the map over speeds is not asked for
    plain = judge(tmp_path, False)
    cut = int((plain.multiplier > 0.0).sum())
    assert plain.unstable.sum() > 0.8 * cut and avoided.unstable.sum() == 0


def test_a_soft_tool_chatters_where_the_arm_alone_does_not_and_the_note_names_the_band(
    avoided, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(stability, "_draw_map", draw_nothing)
    (tmp_path / "modes.csv").write_text("frequency_Hz,damping,mass_kg,x,y,z\n700,0.02,0.02,1,0,0\n"
                                        "700,0.02,0.02,0,1,0\n", encoding="utf-8")  # fmt: skip
    plain = avoided
    job = write_slot(tmp_path, True, MILL)
    job = job.model_copy(update={"stability": job.stability.model_copy(update={"modes": "modes.csv"})})
    soft, told = judge_stability(predict_forces(job))
    assert soft is not None, told
    cut = soft.multiplier > 0.0
    assert not plain.unstable.any() and soft.unstable.sum() > 0.8 * cut.sum()
    assert soft.odds[cut].mean() > plain.odds[cut].mean() + 0.5
    assert "nothing was looked at above" in plain.note and "teeth pass at 300 Hz" in plain.note
    assert "to 700 Hz" in soft.note and "nothing was looked at" not in soft.note


def test_avoiding_chatter_of_what_is_not_milled_is_refused(tmp_path) -> None:
    job = write_slot(tmp_path, True, {"model": "constant", "force_N": [10.0, 0.0, 0.0]})
    with pytest.raises(InputError, match=r"stability\.avoid.*'end_mill' alone, not for 'constant'"):
        prepare_job(job)


def test_the_command_refuses_it_in_one_sentence_and_writes_nothing(tmp_path, monkeypatch, capsys) -> None:
    text = ('schema = 1\nrobot = "staubli_tx200"\n[toolpath]\ngenerator = "circle"\nradius_mm = 15.0\nwaypoints = 24\n'
            'feed_mm_s = 20.0\n[process]\nmodel = "constant"\n'
            'force_N = [10.0, 0.0, 0.0]\n[stability]\navoid = true\n')  # fmt: skip
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    answer = run_command(["plan", tmp_path / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2 and "stability.avoid" in answer.err and answer.err.count("\n") == 1, answer.err
    assert not (tmp_path / "out").exists()
