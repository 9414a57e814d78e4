from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.job.loading import load_path
from compplan.job.operations import split_job
from compplan.job.tool_tables import read_tool_library
from compplan.process.engagement import Cutter
from compplan.process.engagement_search import find_engagement
from compplan.process.stock import Cut, StockColumns, build_block, take_away

EXAMPLES = Path(__file__).parents[2] / "examples"
FLAT = Cutter(5e-3, 0.03)
BLOCK = np.array([[-50.0, -50.0, -20.0], [50.0, 50.0, 0.0]])  # mm
UP = np.array([0.0, 0.0, 1.0])


def line(*knots: tuple[float, float, float], step: float = 1.0) -> np.ndarray:
    """Places along straight lines [m] from knots in mm."""
    rows = [np.array([knots[0]], float)]
    for a, b in itertools.pairwise(knots):
        count = max(int(np.ceil(np.linalg.norm(np.subtract(b, a)) / step)), 1)
        rows.append(np.array(a) + np.linspace(0, 1, count + 1)[1:, None] * np.subtract(b, a))
    return np.vstack(rows) * 1e-3


def cut(path: np.ndarray, axis: np.ndarray = UP, cutter: Cutter = FLAT) -> Cut:
    cutting = np.ones(len(path), bool)
    cutting[0] = False
    return Cut(cutter, path, np.tile(axis, (len(path), 1)), cutting)


def volume(stock: StockColumns) -> float:
    """Volume of its columns. [mm3]"""
    x = (np.arange(-50.0, 50.0, 0.25) + 0.125) * 1e-3
    low, high = stock.interval(np.stack(np.meshgrid(x, x), axis=-1))
    return float(1e9 * np.maximum(high - low, 0.0).sum() * 0.25e-3**2)


def test_a_slot_is_missing_in_what_is_left_and_the_next_tool_meets_only_the_rest() -> None:
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    left, _ = take_away(block, [cut(line((-60, 0, -3), (60, 0, -3)))])
    assert volume(left) == pytest.approx(100 * 100 * 20 - 100 * 10 * 3, rel=1e-3)
    wider = cut(line((-60, 0, -3), (60, 0, -3)), cutter=Cutter(8e-3, 0.03))
    found = find_engagement(wider.cutter, wider.position, wider.cutting, left)
    assert found.section[60] == pytest.approx(6 * 3e-6, rel=0.01)


def test_a_slot_that_was_cut_from_another_side_is_left_out_and_told() -> None:
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    left, told = take_away(block, [cut(line((-60, 47, 0), (60, 47, 0)), np.array([0.0, 1.0, 0.0]))])
    assert left is block and "1 earlier operations lie along another tool axis" in told[0]


def write_bracket(folder: Path, more: str = "") -> Path:
    """The bracket with one hole, in the pocket."""
    text = (EXAMPLES / "two_tools" / "bracket.nc").read_text(encoding="utf-8")
    text = text.replace("X5. Y5.", "X20. Y15.").replace("N230 X35.\n", "")
    (folder / "bracket.nc").write_text(text, encoding="utf-8")
    job = (EXAMPLES / "two_tools" / "bracket.toml").read_text(encoding="utf-8")
    (folder / "job.toml").write_text(job + more, encoding="utf-8")
    return folder / "job.toml"


def test_a_drill_finds_the_pocket_that_the_tool_before_it_cut(tmp_path: Path) -> None:
    pocket, hole = split_job(load_job(write_bracket(tmp_path)))
    assert hole.context.before == (pocket,)
    axial = {}
    for name, job in (("after", hole), ("alone", hole.with_context(before=()))):
        nominal, law = load_path(job)
        assert law.cutting is not None
        tip = nominal.position[law.cutting.engagement.touches & ~nominal.rapid, 2] * 1e3 - 700.0
        axial[name] = tip.max()
    assert [axial["alone"], axial["after"]] == pytest.approx([-1.0, -2.0])  # the pocket's floor is at -1


def test_a_tool_table_in_toml_is_read(tmp_path: Path) -> None:
    table = '[[tool]]\nnumber = 3\nname = "long"\nkind = "end mill"\nlength_mm = 90.0\ndiameter_mm = 8.0\nteeth = 2\n'
    (tmp_path / "tools.toml").write_text(table, encoding="utf-8")
    (tool,) = read_tool_library(tmp_path / "tools.toml")
    assert (tool.number, tool.name, tool.kind, tool.length_mm, tool.teeth) == (3, "long", "mill", 90.0, 2)
    (tmp_path / "tools.toml").write_text(table + "radius_mm = 1\n", encoding="utf-8")
    with pytest.raises(InputError, match="choose from"):
        read_tool_library(tmp_path / "tools.toml")
