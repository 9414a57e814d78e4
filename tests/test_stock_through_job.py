from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commandline import run_command

from compplan.errors import InputError
from compplan.io.notes import Crash
from compplan.job.job import check_job, load_job
from compplan.job.loading import load_path
from compplan.job.operations import split_job
from compplan.job.tool_tables import read_tool_library
from compplan.plan.plan import plan_job
from compplan.process.blank import Cut, take_away, triangulate_stock
from compplan.process.cutter import Cutter
from compplan.process.finished import PartMeshTable, check_part, measure_distance
from compplan.process.look import Above
from compplan.process.materials import MATERIALS
from compplan.process.meeting import find_engagement
from compplan.process.stock import StockColumns, build_block, read_mesh
from compplan.toolpath.toolpath import Toolpath

EXAMPLES = Path(__file__).parent.parent / "examples"
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
    """Volume of its closed mesh [mm3]."""
    mesh = triangulate_stock(stock)
    assert mesh.is_watertight
    return float(mesh.volume * 1e9)


def test_a_slot_is_missing_in_what_is_left_and_the_next_tool_meets_only_the_rest() -> None:
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    left = take_away(block, [cut(line((-60, 0, -3), (60, 0, -3)))])
    assert volume(left) == pytest.approx(100 * 100 * 20 - 100 * 10 * 3, rel=1e-3)  # a grid of 0.5 mm
    wider = cut(line((-60, 0, -3), (60, 0, -3)), cutter=Cutter(8e-3, 0.03))
    found = find_engagement(wider.cutter, wider.position, wider.cutting, left)[0]
    assert found.section[60] == pytest.approx(6 * 3e-6, rel=0.01)


@pytest.mark.parametrize("turn", [np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.3, 0.95]) / np.hypot(0.3, 0.95)])
def test_a_slot_that_was_cut_from_another_side_is_missing_too(turn: np.ndarray) -> None:
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    path = line((-60, 47, 0), (60, 47, 0)) if turn[1] == 1.0 else line((-60, 0, -3), (60, 0, -3))
    left = take_away(block, [cut(path, turn)])
    y, z = np.meshgrid(np.arange(-50, 50, 0.05) + 0.025, np.arange(-20, 0, 0.05) + 0.025, indexing="ij")
    height = (np.stack([0 * y, y, z], axis=-1) - 1e3 * path[0] * [0, 1, 1]) @ turn
    aside = np.abs((y - 1e3 * path[0, 1]) * turn[2] - (z - 1e3 * path[0, 2]) * turn[1])
    gone = float(((height > 0) & (aside < 5)).sum() * 0.05**2 * 100)
    assert volume(left) == pytest.approx(200_000 - gone, rel=2e-3)
    assert gone > 1000


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
    assert hole.before == (pocket,)
    axial = {}
    for name, job in (("after", hole), ("alone", hole.model_copy())):
        if name == "alone":
            job._before = ()
        nominal, law = load_path(job)
        assert law.cutting is not None
        tip = nominal.position[law.cutting.engagement.touches & ~nominal.rapid, 2] * 1e3 - 700.0
        axial[name] = tip.max()
    assert [axial["alone"], axial["after"]] == pytest.approx([-1.0, -2.0])  # the pocket's floor is at -1


def test_what_is_left_is_written_and_can_be_the_stock_of_the_next_job(tmp_path, monkeypatch, capsys) -> None:
    job = write_bracket(tmp_path, "")
    text = job.read_text(encoding="utf-8").replace('cycles = "expand"', 'cycles = "expand"\noperation = 2')
    job.write_text(text, encoding="utf-8")
    answer = run_command(["forces", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    assert "stock.stl" in answer.out
    left = read_mesh(tmp_path / "out" / "stock.stl", "mm", "", job)
    hole = np.pi * 2.5**2 * 4.0  # below the floor of the pocket, nearly
    assert left.volume * 1e9 == pytest.approx(50 * 40 * 10 - 507.0 - hole, rel=1.5e-3)


def finish(depth: float, part: float, table: dict) -> tuple[list[str], dict]:
    """Notes and the part's check of a floor that is milled at a depth; its finished surface stands at another [mm]."""
    path = np.vstack([[-10e-3, 5e-3, 20e-3], line((-10, 5, -depth), (50, 5, -depth), (50, 12, -depth),
                                                  (-10, 12, -depth)), [-10e-3, 12e-3, 20e-3]])  # fmt: skip
    rapid = np.zeros(len(path), bool)
    rapid[[0, 1, -1]] = True
    toolpath = Toolpath(path, np.tile(UP, (len(path), 1)), np.where(rapid, 0.0, 0.02), rapid)
    box = trimesh.creation.box(bounds=[[0, 0, -20], [40, 17, -part]])
    box.export(table["folder"] / "part.stl")
    process = {"model": "end_mill", "diameter_mm": 10.0, "teeth": 2, "spindle_rpm": 9000.0, "material": "al6082_t6",
               "stock": {"block_mm": [[0.0, 0.0, -20.0], [40.0, 17.0, 0.0]]}, "part": {"mesh": "part.stl"}}  # fmt: skip
    data = {"schema": 1, "robot": "kuka_kr16_2", "toolpath": "x.csv", "process": process}
    nominal, law = load_path(check_job(data, table["folder"] / "job.toml", toolpath=toolpath))
    assert law.cutting is not None and law.cutting.part is not None
    return [note for note in nominal.notes if isinstance(note, Crash)], law.cutting.part


@pytest.mark.parametrize(("depth", "part"), [(2.0, 2.0), (1.6, 2.0), (2.3, 2.0)])
def test_gouge_and_what_is_left_on_a_floor_are_its_depth_beside_the_parts(depth, part, tmp_path) -> None:
    crashes, found = finish(depth, part, {"folder": tmp_path})
    flat = found.clearance[np.isfinite(found.clearance)]
    assert np.median(flat) == pytest.approx(1e-3 * (part - depth), abs=1e-9)
    assert bool(crashes) == (depth > 2.2)
    if depth < 2.0:
        assert np.median(found.left) == pytest.approx(0.4e-3, abs=1e-9)
    if crashes:
        assert "0.3 mm into the finished part" in crashes[0]


@pytest.mark.parametrize("triangles", [0, 6], ids=["coarse mesh", "fine mesh"])
def test_a_ball_whose_axis_swings_keeps_its_distance_from_a_floor(triangles: int, tmp_path) -> None:
    box = trimesh.creation.box(bounds=[[0, 0, -20], [40, 20, 0]])
    for _ in range(triangles):
        box = box.subdivide()
    box.export(tmp_path / "part.stl")
    turn = np.radians(20.0) * np.sin(np.arange(17))
    axis = np.column_stack([np.sin(turn), np.zeros(17), np.cos(turn)])
    centre = np.column_stack([np.linspace(4e-3, 36e-3, 17), np.full(17, 10e-3), np.full(17, 4.2e-3)])
    found = check_part(
        PartMeshTable(mesh="part.stl"), Cutter(4e-3, 0.03, 4e-3), centre - 4e-3 * axis, axis, np.arange(17) > 0,
        np.eye(3), tmp_path / "job.toml",
    )  # fmt: skip
    assert np.isnan(found.clearance[0])
    nearest = np.hypot(4.2e-3, 0.1 * np.sqrt(2.0) * 4e-3) - 4e-3  # points stand 0.2 radii apart
    assert found.clearance[1:].min() >= 0.2e-3 - 1e-9
    assert found.clearance[1:].max() <= nearest


@pytest.mark.parametrize("cutter", [FLAT, Cutter(5e-3, 0.03, 1.5e-3), Cutter(5e-3, 0.03, 5e-3),
                                    Cutter(5e-3, 0.03, point=2.0)], ids=["flat", "round", "ball", "drill"])  # fmt: skip
def test_the_distance_from_a_cutter_is_that_to_its_drawn_outline(cutter: Cutter) -> None:
    rho = np.linspace(0.0, cutter.radius, 4000)
    side = np.column_stack([np.full(4000, cutter.radius), np.linspace(cutter.end, 0.03, 4000)])
    outline = np.vstack([np.column_stack([rho, cutter.height(rho)]), side])
    draw = np.random.default_rng(3)
    point = np.column_stack([draw.uniform(0, 8e-3, 300), draw.uniform(-3e-3, 12e-3, 300)])
    away, way = measure_distance(cutter, *point.T)
    inside = (point[:, 0] < cutter.radius) & (point[:, 1] > cutter.height(np.minimum(point[:, 0], cutter.radius)))
    near = np.linalg.norm(point[:, None] - outline, axis=2).min(axis=1)
    sharp = (away > 0) & ((cutter.corner == 0) | (cutter.point < np.pi))  # beyond a sharp edge it is a lower bound
    assert away[~sharp] == pytest.approx(np.where(inside, -near, near)[~sharp], abs=5e-6)
    assert (away[sharp] <= near[sharp] + 5e-6).all() and (away[sharp] > 0).all()
    assert np.linalg.norm(way, axis=1) == pytest.approx(np.ones(300))


@pytest.mark.parametrize(("nose", "width", "depth", "crashes"), [
    (12.0, 30.0, 15.0, True),  # the nose goes 3 mm below the top
    (16.0, 30.0, 15.0, False),
    (12.0, 9.0, 15.0, False),  # it goes down in its own slot
])  # fmt: skip
def test_a_holder_crashes_where_it_is_wider_than_the_slot_and_lower_than_the_stock(nose, width, depth, crashes) -> None:
    path = line((-80, 0, -depth), (0, 0, -depth))
    holder = 1e-3 * np.array([[nose, width / 2], [nose + 40, width / 2]])
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    cutting = np.ones(len(path), bool)
    found = find_engagement(FLAT, path, cutting, block, above=Above(None, holder))[1].holder
    assert found.any() == crashes
    if crashes:
        assert np.flatnonzero(found)[0] == pytest.approx(80 - 50 - width / 2, abs=2)


def test_a_plan_whose_tool_goes_rapid_through_its_stock_is_not_solved(tmp_path: Path) -> None:
    path = line((0, 0, 5), (0, 0, -2), (30, 0, -2), (30, 20, -2), (30, 20, 5), step=2.0)
    rapid = np.zeros(len(path), bool)
    rapid[:4] = rapid[-4:] = True
    rapid[20:28] = True
    toolpath = Toolpath(path, np.tile(UP, (len(path), 1)), np.where(rapid, 0.0, 0.02), rapid)
    data = {"schema": 1, "robot": "kuka_kr16_2", "toolpath": "x.csv",
            "part": {"position_mm": [1000.0, 0.0, 600.0]}, "tool": {"position_mm": [0.0, 0.0, 150.0], "mass_kg": 4.0},
            "process": {"model": "end_mill", "diameter_mm": 8.0, "spindle_rpm": 9000.0, "material": "al6082_t6",
                        "stock": {"block_mm": [[-20.0, -20.0, -10.0], [60.0, 40.0, 0.0]]}}}  # fmt: skip
    plan = plan_job(check_job(data, tmp_path / "job.toml", toolpath=toolpath))
    assert plan.status == "not_confirmed"
    assert "Rapid moves go through the stock" in plan.explain_failures()


def test_the_holder_of_a_tool_table_stands_on_the_tool_from_its_nose_up(tmp_path: Path) -> None:
    entry = {"type": "flat end mill", "unit": "millimeters", "description": "x", "post-process": {"number": 3},
             "geometry": {"DC": 10, "LB": 30, "LCF": 22, "NOF": 2},
             "holder": {"unit": "inches", "gaugeLength": 2.0, "segments": [
                 {"height": 1.0, "lower-diameter": 1.0, "upper-diameter": 1.5},
                 {"height": 1.0, "lower-diameter": 1.5, "upper-diameter": 1.5}]}}  # fmt: skip
    (tmp_path / "tools.json").write_text(json.dumps({"data": [entry], "version": 1}), encoding="utf-8")
    (tool,) = read_tool_library(tmp_path / "tools.json")
    assert tool.holder_mm == pytest.approx(np.array([(30, 25.4), (55.4, 38.1), (55.4, 38.1), (80.8, 38.1)]))
    (tmp_path / "tools.csv").write_text("number,length_mm,holder_from_mm,holder_diameter_mm\n3,90,35,32\n")
    assert read_tool_library(tmp_path / "tools.csv")[0].holder_mm == ((35.0, 32.0), (90.0, 32.0))


def test_tools_and_materials_of_ones_own_stand_beside_those_that_ship(tmp_path: Path) -> None:
    table = '[[tool]]\nnumber = 3\nname = "long"\nkind = "end mill"\nlength_mm = 90.0\ndiameter_mm = 8.0\nteeth = 2\n'
    (tmp_path / "tools.toml").write_text(table, encoding="utf-8")
    (tool,) = read_tool_library(tmp_path / "tools.toml")
    assert (tool.number, tool.name, tool.kind, tool.length_mm, tool.teeth) == (3, "long", "mill", 90.0, 2)
    (tmp_path / "tools.toml").write_text(table + "radius_mm = 1\n", encoding="utf-8")
    with pytest.raises(InputError, match="choose from"):
        read_tool_library(tmp_path / "tools.toml")
    (tmp_path / "mine.toml").write_text("[mine]\ncutting_N_mm2 = [500.0, 200.0, 100.0]\n", encoding="utf-8")
    process = {"model": "end_mill", "diameter_mm": 8.0, "spindle_rpm": 9000.0, "materials": "mine.toml"}
    found = {}
    for name in ("mine", "beech"):
        data = {"schema": 1, "robot": "kuka_kr16_2", "toolpath": "x.csv", "process": {**process, "material": name}}
        found[name] = check_job(data, tmp_path / "job.toml").process.resistance.cutting[0]
    assert found == {"mine": 500.0, "beech": MATERIALS["beech"].cutting[0]}
