from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.job.job import check_job, load_job
from compplan.job.loading import load_path
from compplan.job.noise import describe_noise
from compplan.process.force_models import FORCE_MODELS
from compplan.process.force_models.friction_stir import FrictionStirProcess
from compplan.process.force_models.isf_regression import (
    IsfRegressionProcess,
    find_step_down,
    find_wall_angle,
    radial_ratio,
    scallop_height,
    steady_axial_force,
)
from compplan.toolpath.generators import ConeTable
from compplan.toolpath.toolpath import divide_toolpath
from tests.oracles.forces import DrivenRows, read_forces

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "forces").glob("*.toml"))
SLOT = "x_mm,y_mm,z_mm,feed_mm_s,rapid\n-20,20,10,0,1\n-20,20,-2,0,1\n60,20,-2,20,0\n60,20,10,20,0\n"
MILL = {
    "model": "end_mill", "diameter_mm": 10.0, "teeth": 2, "spindle_rpm": 6000.0, "material": "al7075_t6",
    "stock": {"block_mm": [[0.0, 0.0, -20.0], [40.0, 40.0, 0.0]]},
}  # fmt: skip


def make_job(folder: Path, process: dict, toolpath: str = SLOT):
    (folder / "path.csv").write_text(toolpath)
    data = {"schema": 1, "robot": "staubli_tx200", "toolpath": "path.csv", "process": process,
            "part": {"position_mm": [1500.0, 0.0, 300.0]}}  # fmt: skip
    return check_job(data, folder / "job.toml")


SLIDE = "x_mm,y_mm,z_mm,feed_mm_s\n0,20,-1,20\n40,20,-1,20\n"
#: Of every model numbers, and the force on the tool in the middle of a move along x of the part, by hand. [N]
GOLDEN = {
    "columns": ({}, (1.0, 2.0, 3.0)),
    "constant": ({"force_N": [1.0, 2.0, 3.0]}, (1.0, 2.0, 3.0)),
    "file": ({"file": "wrench.csv"}, (4.0, 2.0, 3.0)),
    # a slot: kt ap f / 4 across the travel, kr ap f / 4 against it; .2 mm a turn, 1 mm deep
    "milling": ({"depth_mm": 1.0, "width_mm": 10.0, "diameter_mm": 10.0, "spindle_rpm": 6000.0, "kc_N_mm2": 800.0},
                (-16.0, 40.0, 0.0)),
    "end_mill": ({"diameter_mm": 10.0, "spindle_rpm": 6000.0, "coefficients": {"cutting_N_mm2": [800.0, 320.0, 0.0]},
                  "stock": MILL["stock"]}, (-16.0, 40.0, 0.0)),
    # a downward move: 570 K D f^.85 with K = 1.01, f = .2 mm a turn, less .8 of half of it at a thinned web
    "drill": ({"diameter_mm": 10.0, "spindle_rpm": 6000.0, "material": "al6082_t6",
               "stock": MILL["stock"]}, (0.0, 0.0, 0.6 * 5700.0 * 1.01 * 0.2**0.85)),
    "isf": ({"axial_N": 100.0, "lateral_N": 50.0, "start_share": 1.0}, (0.0, 50.0, 100.0)),
    # .0716 R t^1.57 d^.41 h^.09 a cos a with h = 5 - (25 - .5)^.5: 1 mm down in a wall of 45 deg
    "isf_regression": ({"thickness_mm": 1.0, "tool_diameter_mm": 10.0, "tensile_N_mm2": 300.0}, (None, None, 1342.0)),
    "friction_stir": ({"shoulder_diameter_mm": 20.0, "probe_diameter_mm": 8.0, "probe_length_mm": 4.0,
                       "shear_N_mm2": 30.0, "axial_N": 5000.0}, (-600.0, 250.0, 5000.0)),
    "grinding": ({"normal_N": 40.0}, (-18.0, 0.0, 40.0)),
}  # fmt: skip


@pytest.mark.parametrize("model", FORCE_MODELS)
def test_every_model_has_the_golden_force(model, tmp_path) -> None:
    assert get_args(FORCE_MODELS[model].table.model_fields["model"].annotation) == (model,)
    stated, expected = GOLDEN[model]
    (tmp_path / "wrench.csv").write_text("s_mm,fx_N,fy_N,fz_N\n0,0,2,3\n40,8,2,3\n")
    path = SLIDE if model != "drill" else "x_mm,y_mm,z_mm,feed_mm_s\n20,20,-5,20\n20,20,-15,20\n"
    if model == "columns":
        path = "x_mm,y_mm,z_mm,feed_mm_s,fx_N,fy_N,fz_N\n0,20,-1,20,1,2,3\n40,20,-1,20,1,2,3\n"
    if model == "isf_regression":
        keys = {"diameter_mm": 80, "depth_mm": 20, "wall_angle_deg": 45, "pitch_mm": 1, "feed_mm_s": 20, "step_mm": 1}
        cone = 1e3 * ConeTable(**keys).generate().position
        path = "\n".join(["x_mm,y_mm,z_mm,feed_mm_s", *(f"{x:.6f},{y:.6f},{z:.6f},20" for x, y, z in cone), ""])
    nominal, _ = load_path(make_job(tmp_path, {"model": model, **stated}, path))
    force = nominal.wrench[len(nominal) // 2, :3]
    known = [k for k, value in enumerate(expected) if value is not None]
    assert force[known] == pytest.approx([expected[k] for k in known], rel=0.02, abs=0.1)


def test_a_wall_on_the_left_pushes_the_forming_tool_to_the_other_side(tmp_path) -> None:
    stated = {"model": "isf", **GOLDEN["isf"][0], "wall_side": "left"}
    nominal, _ = load_path(make_job(tmp_path, stated, SLIDE))
    assert nominal.wrench[len(nominal) // 2, :3] == pytest.approx([0.0, -50.0, 100.0])
    sheet = {"model": "isf_regression", **GOLDEN["isf_regression"][0]}
    cone = ConeTable(diameter_mm=80, depth_mm=20, wall_angle_deg=45, pitch_mm=1, feed_mm_s=20, step_mm=5).generate()
    right, left = (IsfRegressionProcess(**sheet, wall_side=side).wrench_along(cone) for side in ("right", "left"))
    assert np.abs(right[:, 1]).max() > 1.0
    assert left == pytest.approx(right * [1.0, -1.0, 1.0, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("file", [f for f in EXAMPLES if f.stem != "finishing"], ids=lambda f: f.stem)
def test_every_example_has_force_in_material_and_none_in_rapid_moves(file) -> None:
    nominal, law = load_path(load_job(file))
    force = np.linalg.norm(nominal.wrench[:, :3], axis=1)
    assert force.max() > 1.0 and not force[nominal.rapid].any()
    assert "assumed" in law.note.lower()


def test_in_the_air_there_is_no_force_and_a_lift_carries_none(tmp_path) -> None:
    nominal, _ = load_path(make_job(tmp_path, MILL))
    local = nominal.position - [1.5, 0.0, 0.3]
    force = np.linalg.norm(nominal.wrench[:, :3], axis=1)
    outside = (local[:, 0] < -5e-3) | (local[:, 0] > 45e-3)
    assert not force[outside].any()
    assert force[np.abs(local[:, 0] - 20e-3) < 5e-3].min() > 50.0


def test_the_force_at_any_division_and_feed_is_that_of_the_path_there(tmp_path) -> None:
    nominal, law = load_path(make_job(tmp_path, MILL))
    finer = divide_toolpath(nominal, np.arange(0, len(nominal) - 0.75, 0.25))
    at = np.flatnonzero(np.isclose(finer.position[:, 0], 1.52) & ~finer.rapid)
    wrench = law.predict(finer)[at[0]]
    there = np.flatnonzero(np.isclose(nominal.position[:, 0], 1.52) & ~nominal.rapid)
    assert wrench == pytest.approx(nominal.wrench[there[0]], rel=1e-6)
    assert law.follows_feed
    slow, fast = (law.predict(nominal, np.full(len(nominal), f))[there[0], 5] for f in (0.01, 0.02))
    edge = 2 * slow - fast  # linear in the feed, with the edge force left at none
    assert edge == pytest.approx(0.5 * 2 * 27.7 * 2 * 5e-3, rel=5e-3)


def test_a_turned_part_turns_the_force(tmp_path) -> None:
    straight = load_path(make_job(tmp_path, MILL))[0].wrench
    job = make_job(tmp_path, MILL)
    turned = load_path(job.model_copy(update={"part": job.part.model_copy(update={"rotation_deg": (0.0, 0.0, 90.0)})}))
    assert turned[0].wrench[:, 0] == pytest.approx(-straight[:, 1], abs=1e-9)
    assert turned[0].wrench[:, 2] == pytest.approx(straight[:, 2], abs=1e-9)


def test_without_stock_a_block_below_the_top_is_assumed_and_said(tmp_path) -> None:
    bare = {key: value for key, value in MILL.items() if key != "stock"}
    nominal, law = load_path(make_job(tmp_path, {**bare, "stock_top_mm": 0.0}))
    assert "No stock is given: a block below z = 0 mm" in law.note
    assert np.linalg.norm(nominal.wrench[:, :3], axis=1).max() > 50.0
    with pytest.raises(InputError, match=r"stock_top_mm: missing key: the force follows from the stock"):
        load_path(make_job(tmp_path, bare))


@pytest.mark.parametrize(("top", "told"), [(0.0, False), (0.3, False), (30.0, True), (-1.0, True)])
def test_a_stock_that_does_not_end_where_the_cam_program_has_zero_is_told(top: float, told: bool, tmp_path) -> None:
    (tmp_path / "slot.nc").write_text("G21 G90 G17\nG0 X-10 Y20 Z10\nG1 Z-2 F600\nG1 X60\nG1 Z10\nM30\n")
    stock = {"block_mm": [[0.0, 0.0, -20.0], [50.0, 40.0, top]]}
    job = make_job(tmp_path, {**MILL, "stock": stock})
    note = load_path(job.model_copy(update={"toolpath": "slot.nc"}))[1].note
    assert ("the top of the stock: compare the zeros" in note) == told
    assert (f"The stock's top lies at z = {top:g} mm" in note) == told


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"stock": {"block_mm": [[200, 0, -20], [240, 40, 0]]}}, "no cutting move meets the stock"),
        ({"diameter_mm": 90.0}, "is 90, larger than the stock"),
        ({"spindle_rpm": 1.0}, "feed a tooth is"),
        ({"material": "cheese"}, "is 'cheese', choose from"),
        ({"material": None, "coefficients": {"cutting_N_mm2": [0.8, 0.3, 0.1]}}, "check the unit"),
        ({"material": None, "coefficients": {"cutting_N_mm2": [800, 300, 100], "edge_N_mm": [2e4, 0, 0]}}, "check the"),
        ({"material": None}, "needs one of coefficients and material"),
        ({"corner_radius_mm": 6.0}, "at most half of diameter_mm"),
        ({"stock": {"block_mm": [[0, 0, 0], [0, 1, 1]]}}, "lowest corner first"),
        ({"stock": {"mesh": "none.stl"}}, "no file"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_sentence(change, sentence, tmp_path) -> None:
    process = {key: value for key, value in {**MILL, **change}.items() if value is not None}
    with pytest.raises(InputError, match=sentence):
        load_path(make_job(tmp_path, process))


def test_the_model_brings_its_uncertainty_to_monte_carlo_unless_the_job_says_its_own(tmp_path) -> None:
    noise = make_job(tmp_path, {**MILL, "material": "c45"}).noise
    assert noise.wrench_level == 0.25
    assert any("wrench_level = 0.25: what the force model states" in sentence for sentence in describe_noise(noise))
    job = make_job(tmp_path, MILL)
    own = check_job({**job.model_dump(by_alias=True, exclude_unset=True), "noise": {"wrench_level": 0.05}}, job.file)
    assert own.noise.wrench_level == 0.05


def test_the_regression_has_its_printed_exponents() -> None:
    base = float(steady_axial_force(100.0, 1.0, 10.0, np.array(0.5), np.radians(50.0)))
    assert base == pytest.approx(0.0716 * 100 * 10**0.41 * 0.5**0.09 * 50 * np.cos(np.radians(50)), rel=1e-12)
    assert float(steady_axial_force(100.0, 2.0, 10.0, np.array(0.5), np.radians(50.0))) / base == pytest.approx(2**1.57)


def test_without_a_scallop_a_sheet_pushes_aside_as_a_strip_of_even_tension_bent_over_the_ball() -> None:
    angle = np.radians(50.0)
    wrap = (np.arange(2000) + 0.5) / 2000 * angle  # T / R of pressure along the arc from the flat to the wall
    aside, axial = np.sin(wrap).mean(), np.cos(wrap).mean()
    assert float(radial_ratio(0.0, 10.0, angle)) == pytest.approx(aside / axial, rel=1e-6)
    assert float(radial_ratio(0.02, 10.0, angle)) > aside / axial


def test_two_grooves_of_a_ball_meet_at_the_crest_of_the_scallop() -> None:
    radius, step, angle = 5.0, 0.5, np.radians(45.0)
    half = 0.5 * step / np.sin(angle)  # between the grooves, along the wall
    assert float(scallop_height(step, 2 * radius, angle)) == pytest.approx(radius - np.sqrt(radius**2 - half**2))
    assert float(scallop_height(50.0, 2 * radius, angle)) == pytest.approx(radius)


def test_both_readings_of_the_regression_are_said_and_lie_inside_its_spread() -> None:
    nominal, law = load_path(load_job(EXAMPLES[0].parent / "isf_cone.toml"))
    found = re.search(r": (\d+) N along the tool .*; (\d+) N if its scallop height means the step-down", law.note)
    assert found is not None
    read, other = (float(number) for number in found.groups())
    assert nominal.wrench[:, 2].max() == pytest.approx(read, rel=0.03)
    assert read < other < read * (1 + 1.96 * IsfRegressionProcess.uncertainty)


@pytest.mark.parametrize("angle", [30.0, 45.0, 60.0])
@pytest.mark.parametrize("levels", [False, True])
def test_wall_angle_and_step_down_are_found_from_the_path(angle, levels) -> None:
    keys = {"diameter_mm": 80, "depth_mm": 12, "wall_angle_deg": angle, "pitch_mm": 1, "feed_mm_s": 20, "step_mm": 0.5}
    cone = ConeTable(path="z_level" if levels else "helical", **keys).generate()
    assert find_step_down(cone) == pytest.approx(1e-3, rel=0.05)
    assert np.degrees(np.median(find_wall_angle(cone, 1e-3))) == pytest.approx(angle, abs=1.0)


def test_forming_builds_up_and_then_stays() -> None:
    keys = {"diameter_mm": 80, "depth_mm": 20, "wall_angle_deg": 45, "pitch_mm": 1, "feed_mm_s": 20, "step_mm": 0.5}
    cone = ConeTable(**keys).generate()
    process = IsfRegressionProcess(model="isf_regression", thickness_mm=1.0, tool_diameter_mm=10.0, tensile_N_mm2=300.0)
    axial = process.wrench_along(cone)[:, 2]
    deep = np.arange(len(cone)) > 0.6 * len(cone)
    assert axial[5] < 0.35 * axial[deep].mean()
    assert np.ptp(axial[deep]) < 0.03 * axial[deep].mean()


def test_a_weld_has_the_torque_of_its_faces() -> None:
    process = FrictionStirProcess(
        model="friction_stir", shoulder_diameter_mm=20.0, probe_diameter_mm=8.0, probe_length_mm=4.0, shear_N_mm2=30.0,
        axial_N=6000.0,
    )  # fmt: skip
    ring = 2 / 3 * np.pi * 30 * (10**3 - 4**3)
    side, tip = 2 * np.pi * 4**2 * 4 * 30, 2 / 3 * np.pi * 30 * 4**3
    assert process.torque == pytest.approx((ring + side + tip) * 1e-3)


def test_a_weld_carries_nothing_once_the_tool_is_lifted_off(tmp_path) -> None:
    path = "x_mm,y_mm,z_mm,feed_mm_s,rapid\n0,0,9,0,1\n0,0,0,1,0\n50,0,0,5,0\n50,0,9,5,0\n"
    weld = {"model": "friction_stir", "shoulder_diameter_mm": 20.0, "probe_diameter_mm": 8.0, "probe_length_mm": 4.0,
            "shear_N_mm2": 30.0, "axial_N": 5000.0}  # fmt: skip
    nominal, _ = load_path(make_job(tmp_path, weld, path))
    height = nominal.position[:, 2] - 0.3
    left = (nominal.arc_length > 0.0595) & (height > 1e-6)
    assert left.any() and not nominal.wrench[left].any()
    assert nominal.wrench[np.flatnonzero(height < 1e-9)[10], 2] == pytest.approx(5000.0)


@pytest.mark.parametrize(
    "process",
    [
        {"model": "friction_stir", "shoulder_diameter_mm": 20.0, "probe_diameter_mm": 8.0, "probe_length_mm": 4.0,
         "shear_N_mm2": 30.0, "axial_N": 5000.0, "clockwise": False, "ramp_mm": 5.0},
        {"model": "grinding", "normal_N": 30.0},
        {"model": "grinding", "normal_N": 40.0, "direction": "along"},
    ],
)  # fmt: skip
def test_the_judge_reads_the_same_wrench_by_itself(process, tmp_path) -> None:
    job = make_job(tmp_path, process)
    nominal, law = load_path(job)
    cut = ~nominal.rapid
    step = np.r_[0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9)]
    time = np.cumsum(np.where(nominal.rapid, 1.0, step))
    rows = DrivenRows(nominal.position, nominal.axis, nominal.rapid, np.zeros(len(nominal), bool), time)
    tables = job.model_dump(by_alias=True, exclude_unset=True)
    read = read_forces(tables, tmp_path, rows)
    assert read is not None
    assert read[cut] == pytest.approx(law.predict(nominal)[cut], rel=1e-9, abs=1e-9)


def test_a_cutter_at_half_its_depth_below_the_top_of_the_stock_is_read_with_half_its_force(tmp_path: Path) -> None:
    """The second reading: 1 and 2 of 2 mm below a top at 5 mm, and above it, along a straight cut."""
    process = {"model": "milling", "depth_mm": 2.0, "width_mm": 5.0, "diameter_mm": 10.0, "spindle_rpm": 6000.0,
               "kc_N_mm2": 800.0, "stock_top_mm": 5.0}  # fmt: skip
    height = np.repeat([4.0, 3.0, 6.0], 7)
    position = 1e-3 * np.column_stack([10.0 * np.arange(21), np.zeros(21), height])
    none, time = np.zeros(21, bool), np.arange(21.0)
    rows = DrivenRows(position, np.tile([0.0, 0, 1], (21, 1)), none, none, time, 5e-3)
    wrench = read_forces({"process": process, "part": {}}, tmp_path, rows)
    assert wrench is not None
    half, whole, above = (np.linalg.norm(wrench[row, :3]) for row in (3, 10, 17))
    assert whole > 10.0
    assert (half / whole, above) == pytest.approx((0.5, 0.0), abs=1e-9)
