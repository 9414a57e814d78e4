from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from compplan.cli import load_command
from compplan.errors import UnknownNameError
from compplan.reproduce import PAPERS, reproduce_paper
from compplan.reproduce.paper import Reproduction, compare, count_verdicts, recompute, unavailable, write_reproduction
from compplan.robot import Robot, load_robot

WORDS = ("matches", "close", "order of magnitude", "trend only", "fitted", "arithmetic", "not seen",
         "inconsistent in the paper")  # fmt: skip
KEYS = {"quantity", "paper", "ours", "unit", "tolerance", "verdict", "assumption"}


def soften(factor: float) -> Callable[[str], Robot]:
    def load(name: str) -> Robot:
        return load_robot(name).scale_compliance(factor)

    return load


def soften_wrist(name: str) -> Robot:
    """Soften joints four to six alone: a factor on everything leaves ratios as they were."""
    robot = load_robot(name)
    springs = tuple(replace(s, compliance=s.compliance * (1.5 if s.joint[-1] in "456" else 1.0)) for s in robot.springs)
    return replace(robot, springs=springs)


def check_words(result: Reproduction) -> None:
    for row in result.rows:
        assert row.verdict in WORDS or row.verdict.startswith("cannot be reproduced because "), row
        assert row.verdict != "matches" or row.tolerance in (None, 0.05)
        assert row.ours is not None or row.verdict.startswith("cannot"), row


def test_verdicts_go_by_one_rule() -> None:
    found = [compare("x", 100.0, ours, "mm", missing="the load").verdict for ours in (104, 96, 118, 250, 34, 900, -5)]
    gap = "cannot be reproduced because the load is missing"
    assert found == ["matches", "matches", "close", "order of magnitude", "order of magnitude", gap, gap]
    assert compare("x", 1.0, 1.0, "", fitted=True).verdict == "fitted"


def test_a_number_computed_from_the_papers_own_is_arithmetic() -> None:
    assert recompute("x", 70.0, 70.57, "%", "both the paper's").verdict == "arithmetic"


def test_what_is_missing_is_named() -> None:
    assert unavailable("x", "1 mm", "the load and the pose").verdict.endswith("the load and the pose are missing")


def test_the_command_writes_rows_and_a_page(tmp_path: Path) -> None:
    paper = "johra2022"
    result = CliRunner().invoke(
        load_command("reproduce"), [paper, "--out", str(tmp_path), "--json"], catch_exceptions=False
    )
    assert result.exit_code == 0
    table = json.loads((tmp_path / "reproduction.json").read_text())
    assert table == json.loads(result.stdout)
    assert table["schema"] == 1 and table["paper"] == paper
    assert all(set(row) == KEYS for row in table["rows"])
    page = (tmp_path / "report.html").read_text()
    assert all(row["quantity"].split(":")[0].replace("'", "&#39;") in page for row in table["rows"])
    assert (tmp_path / "figure_1.png").stat().st_size > 5000


def test_changing_a_robot_changes_what_is_ours() -> None:
    before, after = reproduce_paper("johra2022"), reproduce_paper("johra2022", soften(1.3))
    check_words(before)
    title = "Figs. 10 to 13: one spring a joint against the enhanced model, 600 N, largest dz"
    assert after.row(title).ours == pytest.approx(1.3 * float(before.row(title).ours or 0), rel=0.02)
    changed = sum(a.ours != b.ours for a, b in zip(before.rows, after.rows, strict=True))
    assert changed >= 5
    assert [a.paper for a in before.rows] == [b.paper for b in after.rows]


def test_an_unknown_paper_is_answered_with_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="mamedov2018"):
        reproduce_paper("einstein1905")


@pytest.mark.slow
@pytest.mark.parametrize("paper", list(PAPERS))
def test_every_paper_is_reproduced_in_known_words_and_with_pictures(paper: str, tmp_path: Path) -> None:
    result = reproduce_paper(paper)
    check_words(result)
    write_reproduction(result, tmp_path)
    assert sum(count_verdicts(result.rows).values()) == len(result.rows)
    assert len(list(tmp_path.glob("figure_*.png"))) == len(result.figures) >= 1
    softer = reproduce_paper(paper, soften_wrist)
    assert any(a.ours != b.ours for a, b in zip(result.rows, softer.rows, strict=True))
