"""Diagnosis: ties, events inside a run, and folders as they are read back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import known_campaigns
import numpy as np
import pytest
from commandline import run_command
from simulated_campaigns import measure, plan_rows, write_small_robot

import compplan as cp
from compplan.io.tables import write_table
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot


@pytest.mark.parametrize(
    "name",
    [
        "a zero near the noise",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("errors of no effect", "two zeros that are one length", "late on a path")
        ),
    ],
)
def test_rounding_changes_no_line_of_a_diagnosis(name: str) -> None:
    known = known_campaigns.CAMPAIGNS[name]
    robot = known_campaigns.make_robot(known.joints)
    campaign = known_campaigns.draw(known, robot)
    answers = []
    for seed in (0, 2):
        random = np.random.default_rng(seed)
        shaken = replace(
            campaign,
            position=campaign.position + random.normal(0.0, 1e-12, campaign.position.shape),
            q=campaign.q + random.normal(0.0, 1e-13, campaign.q.shape),
        )
        known_campaigns_draw = known_campaigns.draw
        known_campaigns.draw = lambda _, __, rows=shaken: rows
        try:
            answers.append(known_campaigns.diagnose_known(name))
        finally:
            known_campaigns.draw = known_campaigns_draw
    assert list(known_campaigns.differences(*answers)) == []


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("robot") / "small")


def write_log(campaign: Campaign, file: Path) -> Path:
    columns: dict[str, Any] = {"run": campaign.run, "time_s": campaign.time, "sigma_mm": campaign.sigma * 1e3}
    columns |= {f"q{k + 1}_deg": np.degrees(campaign.q[:, k]) for k in range(campaign.q.shape[1])}
    names = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
    columns |= {name: campaign.wrench[:, k] for k, name in enumerate(names)}
    columns |= {f"{axis}_mm": campaign.position[:, k] * 1e3 for k, axis in enumerate("xyz")}
    write_table(file, columns, decimals=6)
    return file


def shift(name: str, row: int, values: Sequence[float]) -> cp.Effect:
    keys = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")
    return cp.Effect(name, None, None, {"row": row, **dict(zip(keys, values, strict=True))})


FRAME, FLANGE = (1.2e-3, -8e-4, 1e-3, 3e-4, -2e-4, 5e-4), (8e-4, 0.0, -1e-3, 2e-3, 0.0, 3e-3)


@pytest.mark.parametrize(
    ("row", "effect", "values"),
    [(30, "frame_shift", FRAME), (30, "tool_shift", FLANGE), (20, "tool_shift", FLANGE)],
    ids=["a frame shift in a run", "a flange that slips in a run", "a flange that slips between runs"],
)
def test_a_shift_is_named(
    row: int, effect: str, values: Sequence[float], robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    rows = plan_rows(robot, 1, poses=40, loads=0)
    log = write_log(measure(robot, rows, [shift(effect, row, values)], 1, orientation=False), tmp_path / "log.csv")
    words = ["diagnose", log, "--robot", robot.folder, "--out", tmp_path / "out"]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 0, answer.err
    assert f"{effect}: probability 0.9" in answer.out


def wear(robot: Robot, campaign: Campaign, most: float) -> Campaign:
    """Shorten the tool steadily through the second run."""
    worn = np.zeros(len(campaign))
    inside = campaign.run == "static_2"
    worn[inside] = np.linspace(0.0, most, int(inside.sum()))
    axis = cp.predict_campaign(robot, campaign).rotation[:, :, 2]
    return replace(campaign, position=campaign.position + axis * worn[:, None])


def test_a_tool_that_wears_in_a_run_is_said_to_follow_time(robot: Robot) -> None:
    rows = plan_rows(robot, 1, poses=40, loads=0)
    worn = wear(robot, measure(robot, rows, [], 1, orientation=False), 1.5e-3)
    found = cp.diagnose(worn, robot)
    assert found.verdict.status == "unknown"
    assert found.gap.held_out_after < 0.5 * found.gap.held_out_before
    assert [cause.effect.axis for cause in found.verdict.structure.dependences] == ["time"]


def test_folders_stay_within_what_is_read_and_hold_the_reported_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    soft = tmp_path / "soft"
    write_small_robot(soft)
    file = soft / "elasticity.toml"
    # joint 6 is nearly as soft as the reader takes for true, and in fact softer
    file.write_text(file.read_text().replace("4e-06", "9.8e-3"))
    nominal = cp.load_robot(soft)
    softer = cp.Effect("joint_stiffness", "joint_6", None, {"compliance_change_rad_per_Nm": 1.5e-3})
    rows = plan_rows(nominal, 3, poses=20, loads=1, force=10.0)
    log = write_log(measure(nominal, rows, [softer], 3, orientation=False), tmp_path / "log.csv")
    others = [word for name in ("wrench_scale", "wrench_bias", "payload") for word in ("--without", name)]
    out = tmp_path / "out"
    answer = run_command(["diagnose", log, "--robot", soft, "--out", out, *others], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    said = json.loads((out / "diagnosis.json").read_text())
    read, campaign = cp.load_robot(out / "robot"), cp.read_campaign(log, nominal)
    assert all(spring.compliance <= 1e-2 for spring in read.springs)
    gap = cp.predict_campaign(read, campaign, later=False).gap
    rms = 1e3 * float(np.sqrt(np.mean(np.sum(np.delete(gap, said["outliers"], axis=0) ** 2, axis=1))))
    assert said["gap"]["after_rms_mm"] == pytest.approx(rms, abs=1e-5)


def test_a_campaign_of_touched_contacts_is_delivered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The places of contacts are fitted anew when a folder is read back: that is not a difference of the robot."""
    monkeypatch.chdir(Path(__file__).parents[1] / "bad_inputs" / "good")
    words = (
        "diagnose",
        "touched.csv",
        "--instrument",
        "instrument.toml",
        "--robot",
        "robot",
        "--out",
        tmp_path / "out",
    )
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0, done
    assert (tmp_path / "out" / "robot" / "robot.urdf").is_file()
