"""Page, terminal and diagnosis.json of one diagnosis never contradict each other.

Those of the campaigns of known truth are read in test_known_truth.py.
"""

from __future__ import annotations

import copy
import io
import json
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_contradictions import CHECKS, Told, list_contradictions, read_page
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.cli import main
from compplan.effects import Effect
from compplan.io.tables import write_table
from compplan.reporting.diagnosis_text import describe_which
from compplan.reporting.summaries import open_diagnosis

GEAR = Effect("transmission_error", "joint_1", None,
              {"cycles_per_turn": [1.0], "sine_rad": [6e-4], "cosine_rad": [4e-4]})  # fmt: skip
LENGTHS = [Effect("link_geometry", f"joint_{k}", axis, {f"{axis}_m": size})
           for k, axis, size in ((2, "tx", 2e-4), (3, "tz", -2.5e-4), (4, "ty", 1.5e-4), (5, "tx", -2e-4))]  # fmt: skip
#: What is wrong, poses, and a wave over the joints that no effect makes, without any load. [m]
CASES: dict[str, tuple[list[Effect], int, float]] = {
    "a gear beside a curve of another joint's angle": ([GEAR], 20, 2e-4),
    "small errors everywhere": (LENGTHS, 20, 0.0),
    "nothing but what no effect makes": ([], 20, 3e-4),
}


@pytest.mark.parametrize("name", CASES)
def test_page_terminal_and_file_of_a_campaign_never_contradict_each_other(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effects, poses, wave = CASES[name]
    robot = write_small_robot(tmp_path)
    log = measure(robot, plan_rows(robot, 20, poses=poses, loads=0), effects, 20, orientation=False)
    q = log.q
    seen = log.position + wave * np.sin(3.0 * q[:, [0, 1, 2]] + 2.0 * q[:, [2, 3, 4]] * q[:, [1, 0, 1]])
    columns = {f"q{k + 1}_deg": np.degrees(q[:, k]) for k in range(6)}
    columns |= {f"{axis}_mm": seen[:, k] * 1e3 for k, axis in enumerate("xyz")}
    write_table(tmp_path / "log.csv", {"run": log.run, **columns}, decimals=6)
    out = tmp_path / "d"
    words = ["diagnose", tmp_path / "log.csv", "--robot", robot.folder, "--out", out, "--assume-ok"]
    monkeypatch.setattr(sys, "argv", ["compplan", *map(str, words)])
    said = io.StringIO()
    with redirect_stdout(said), pytest.raises(SystemExit) as leaving:
        main()
    assert not leaving.value.code
    table = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    told = Told(table, read_page(out / "report.html"), said.getvalue(), loaded=False)
    assert list_contradictions(told) == []


TURNING = {"effect": "transmission_error", "joint": "joint_2", "axis": None}
#: What is said of a gear error, without a contradiction.
SOUND = Told(
    {
        "verdict": {"status": "partly_explained", "doubtful": [], "minor": [],
                    "effects": [{**TURNING, "probability": 0.91, "explained_rms_mm": 0.4}]},
        "gap": {"before_rms_mm": 0.5, "held_out_before_rms_mm": 0.5, "held_out_after_rms_mm": 0.125,
                "noise_floor_mm": 0.05},
        "structure_left": {"present": True, "depends_on": [{"driver": "its own angle", "joint": "joint_1"}]},
        "delivered": [{"kind": "calibrated", "held_out_rms_mm": 0.125}],
        "where": {"by_joint": {"joint_2": {"share": 0.7}, "not explained": {"share": 0.29}}, "noise_share": 0.01,
                  "by_factor": {"load": {"share": 0.7}, "not explained": {"share": 0.29}}},
        "candidates": [{**TURNING, "probability": 0.91}], "next_measurement": [{"poses": [[0.0]]}],
    },
    "Found in part: gear. Something is left that nothing explains. Measure more poses, as listed below. Plan with the "
    "updated robot. Where: 0.500 mm; joint_2 carries 70 % by transmission error; no model explains 29 %. Which: gear "
    "(probability 0.91). No named effect makes an error of joint_1 that follows its own angle, against 0.400 mm that "
    "the named effects explain. How far: to 0.125 mm, noise floor of 50.0 µm.",
    "verdict: partly explained, probability 0.91, 0.125 mm, 0.050 mm; next: plan with it",
    True,
)  # fmt: skip


def say(told: Told, old: str, new: str) -> Told:
    return replace(told, page=told.page.replace(old, new), terminal=told.terminal.replace(old, new))


def turn(told: Told, path: str, value: object) -> Told:
    """Change one value of what diagnosis.json holds; `path` is a path of keys and places in lists."""
    table = copy.deepcopy(told.table)
    at: Any = table
    *way, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in way:
        at = at[key]
    at[last] = value
    return replace(told, table=table)


PLANTED: dict[str, list[Callable[[Told], Told]]] = {
    "nameless_beside_its_effect": [
        lambda s: turn(s, "structure_left/depends_on/0", {"driver": "its own angle", "joint": "joint_2"}),
        lambda s: turn(s, "verdict/status", "explained"),
    ],
    "load_without_load": [lambda s: replace(s, loaded=False)],
    "plan_with_nominal": [lambda s: turn(s, "delivered/0/kind", "nominal"), lambda s: say(s, "plan with it", "wait")],
    "more_than_the_gap": [
        lambda s: turn(s, "where/by_joint/joint_2/share", 0.75), lambda s: say(s, "carries 70", "carries 72"),
        lambda s: say(s, "against 0.400 mm", "against 0.550 mm"),
    ],
    "other_status": [
        lambda s: say(s, "verdict: partly", "verdict: well"), lambda s: say(s, "Found", "Nothing is wrong"),
        lambda s: turn(s, "structure_left/present", False),
    ],
    "other_probability": [
        lambda s: turn(s, "candidates/0/probability", 0.0), lambda s: turn(s, "candidates/0/joint", "joint_4"),
        lambda s: say(s, "(probability 0.91)", "(probability 0.19)"),
        lambda s: turn(s, "verdict/doubtful", [{**TURNING, "probability": 0.2}]),
    ],
    "named_beyond_a_bound": [lambda s: turn(s, "verdict/effects/0/beyond", "more than the motors hold")],
    "unexplained_beside_calibration": [
        lambda s: turn(s, "delivered/0/held_out_rms_mm", 0.07),
        lambda s: say(s, "Something is left that nothing explains", "calibration takes it up to the noise"),
    ],
    "noise_that_no_model_explains": [lambda s: turn(s, "verdict/status", "none")],
    "poses_that_are_not_listed": [lambda s: turn(s, "next_measurement", [])],
    "other_figures": [
        lambda s: turn(s, "gap/held_out_after_rms_mm", 0.12), lambda s: say(s, "50.0 µm", "60.0 µm"),
        lambda s: turn(s, "gap/held_out_before_rms_mm", 0.1),
    ],
}  # fmt: skip


def test_every_check_sees_what_it_is_there_for_and_nothing_else() -> None:
    assert list_contradictions(SOUND) == []
    assert set(PLANTED) == {check.__name__ for check in CHECKS}
    for name, spoilings in PLANTED.items():
        for spoil in spoilings:
            assert any(said.startswith(f"{name}:") for said in list_contradictions(spoil(SOUND))), name


def test_an_unknown_cause_that_calibration_takes_up_is_not_said_to_be_beyond_explanation() -> None:
    verdict: dict[str, Any] = {"status": "unknown", "effects": []}
    for after, words in ((0.07, "calibration takes it up to the noise"), (0.2, "known effects explains.")):
        gap: dict[str, float | None] = {"held_out_after_rms_mm": after, "noise_floor_mm": 0.05}
        assert words in open_diagnosis(verdict, gap, "calibrated", "").verdict
    assert "no effect explains it" not in describe_which(verdict, [], None, taken_up=True)  # type: ignore[arg-type]
