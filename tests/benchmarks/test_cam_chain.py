from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from program_moves import shift

from benchmarks.cam_chain import INPUTS, LANGUAGES, judge_form, read_joints, run_chain
from tests.controllers.test_golden_programs import read_form


def test_a_cam_file_becomes_a_program_that_another_reader_reads(tmp_path: Path) -> None:
    """... and one that is off by more than half a digit, or in anything else, is told."""
    assert [row.faults for row in run_chain("gcode", "krl", tmp_path) if row.faults] == []
    planned = read_joints(tmp_path / "out" / "joints.csv", rail=True)
    moves = read_form("krl linear", tmp_path / "out", "golden")
    row = next(k for k in range(len(moves) // 2, len(moves)) if moves[k].kind == "line")
    move = moves[row]
    wrong = {
        "errors": move._replace(pose=move.pose @ shift(0, 0, 2e-4)),
        "configuration": move._replace(configuration=(move.configuration[0] ^ 4, move.configuration[1])),
        "tool": move._replace(tool=move.tool @ shift(1e-3, 0, 0)), "base": move._replace(base=np.eye(4)),
    }  # fmt: skip
    for what, other in wrong.items():
        faults = judge_form("gcode", "krl linear", [*moves[:row], other, *moves[row + 1 :]], planned).faults
        assert any(what in fault for fault in faults), what
    still = [other for other in moves if other.action != ("on", 3.0)]
    assert "a cut with the spindle stopped" in judge_form("gcode", "krl linear", still, planned).faults
    joints = read_form("krl joint", tmp_path / "out", "golden")
    turned = np.array(joints[row].joints) + 1.1e-6
    joints[row] = joints[row]._replace(joints=tuple(turned.tolist()))
    assert judge_form("gcode", "krl joint", joints, planned).faults == ("errors",)


@pytest.mark.slow
@pytest.mark.parametrize("source", INPUTS)
@pytest.mark.parametrize("language", LANGUAGES)
def test_every_cam_language_becomes_every_program_language(source: str, language: str, tmp_path: Path) -> None:
    rows = run_chain(source, language, tmp_path)
    assert rows and [row.faults for row in rows if row.faults] == []
