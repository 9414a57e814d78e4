"""Page, terminal and diagnosis.json of one diagnosis never contradict each other.

Those of the campaigns of known truth are read in test_known_truth.py.
"""

from __future__ import annotations

import io
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from page_contradictions import Told, list_contradictions, read_page
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.cli import main
from compplan.effects import Effect
from compplan.io.tables import write_table

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
