from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.process.force_law import ForceLaw
from compplan.process.force_models.columns import ColumnsProcess
from compplan.process.force_models.constant import ConstantProcess
from compplan.process.force_models.file import FileProcess
from compplan.process.force_models.isf import IsfProcess
from compplan.process.force_models.milling import MillingProcess, milling_wrench
from compplan.robot.pose import build_pose
from compplan.toolpath.contact import path_axes
from compplan.toolpath.generators import CircleTable, ConeTable
from compplan.toolpath.toolpath import Toolpath, place_toolpath


def predict_wrench(process, nominal: Toolpath, turn: np.ndarray = np.eye(3), folder: Path = Path()) -> np.ndarray:  # noqa: B008
    return ForceLaw(process, build_pose(np.zeros(3), turn), folder=folder).predict(nominal)


def circle(approach: float = 0.0) -> Toolpath:
    return CircleTable(radius_mm=100, feed_mm_s=50, waypoints=400, approach_mm=1e3 * approach).generate()


def milling(**changes: object) -> MillingProcess:
    keys: dict[str, object] = {
        "model": "milling",
        "depth_mm": 2.0,
        "width_mm": 10.0,
        "diameter_mm": 10.0,
        "spindle_rpm": 6000.0,
        "kc_N_mm2": 800.0,
    }
    return MillingProcess.model_validate(keys | changes)


def test_a_constant_wrench_is_turned_from_each_frame_into_the_base() -> None:
    turn = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    nominal = circle()
    for frame, expected in {"base": [1, 2, 3], "part": [-2, 1, 3], "tool": [1, -2, -3]}.items():
        process = ConstantProcess(model="constant", force_N=(1.0, 2.0, 3.0), frame=frame)
        wrench = predict_wrench(process, nominal, turn=turn)
        assert wrench[5, :3] == pytest.approx(expected), frame


def test_the_path_frame_has_x_along_the_travel_and_z_along_the_tool_axis() -> None:
    nominal = circle()
    axes = path_axes(nominal)
    travel = np.gradient(nominal.position, axis=0)
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", axes[:, :, 0], travel).min() > 0.999
    assert axes[:, :, 2] == pytest.approx(nominal.axis)
    assert np.einsum("nji,njk->nik", axes, axes) == pytest.approx(np.tile(np.eye(3), (len(nominal), 1, 1)))


def test_a_force_beside_the_travel_is_refused_where_all_cuts_plunge() -> None:
    position = np.array([[0, 0, 0.1], [0, 0, 0], [0.1, 0, 0.1], [0.1, 0, 0]])
    rapid = np.array([True, False, True, False])
    holes = Toolpath(position, np.tile([0.0, 0, 1], (4, 1)), np.ones(4), rapid)
    push = {"model": "constant", "frame": "path", "moment_Nm": [0.0, 0.0, 2.0]}
    thrust = predict_wrench(ConstantProcess.model_validate(push | {"force_N": [0.0, 0.0, 90.0]}), holes)
    assert thrust[:, 2] == pytest.approx([0.0, 90.0, 0.0, 90.0])
    with pytest.raises(InputError, match="no cutting move goes across the tool axis"):
        predict_wrench(ConstantProcess.model_validate(push | {"force_N": [-10.0, 0.0, 90.0]}), holes)


def test_the_wrench_grows_from_zero_after_contact_and_vanishes_in_rapid_moves() -> None:
    nominal = circle(approach=0.02)
    process = ConstantProcess(model="constant", force_N=(0.0, 0.0, 100.0), ramp_mm=50.0)
    force = predict_wrench(process, nominal)[:, 2]
    length = nominal.arc_length - nominal.arc_length[1]
    assert force[[0, 1, -1]] == pytest.approx(0)
    middle = np.argmin(np.abs(length - 0.025))
    assert force[middle] == pytest.approx(100 * length[middle] / 0.05)
    assert force.max() == pytest.approx(100)


def test_a_dead_weight_also_hangs_on_the_tool_in_rapid_moves() -> None:
    process = ConstantProcess(model="constant", force_N=(0.0, 0.0, -600.0), frame="base", during_rapid=True)
    assert predict_wrench(process, circle(approach=0.02))[:, 2] == pytest.approx(-600)


def test_the_formed_sheet_pushes_the_tool_up_and_towards_the_axis_of_the_cone() -> None:
    keys = {"diameter_mm": 40, "depth_mm": 15, "wall_angle_deg": 45, "pitch_mm": 1, "feed_mm_s": 20, "step_mm": 0.5}
    cone = ConeTable(approach_mm=10, **keys).generate()
    process = IsfProcess(model="isf", axial_N=1200.0, lateral_N=400.0, start_share=0.4, ramp_mm=5.0)
    wrench = predict_wrench(process, cone)
    outward = cone.position[:, :2] / np.linalg.norm(cone.position[:, :2], axis=1, keepdims=True)
    radial = np.einsum("ni,ni->n", wrench[:, :2], outward)
    cutting = ~cone.rapid
    assert wrench[cutting, 2].max() == pytest.approx(1200)
    assert np.all(wrench[cutting, 2] >= 0)
    assert radial[-2] == pytest.approx(-400, rel=0.01)
    assert np.linalg.norm(wrench[cutting, :2], axis=1).max() == pytest.approx(400)
    later = wrench[20:-1, 2]
    assert np.all(np.diff(later) > 0)


def test_milling_forces_agree_with_a_sum_over_teeth_positions() -> None:
    process = milling(width_mm=3.0, radial_ratio=0.5, material_side="left")
    angles = np.linspace(-np.pi / 2, np.pi / 2, 200_001)
    engaged = np.sin(angles) >= 1 - 3.0 / 5.0
    thickness = np.where(engaged, 0.02e3 * 60 / 6000 * np.cos(angles), 0)
    tangential, radial = 800 * 2.0 * thickness, 0.5 * 800 * 2.0 * thickness
    x = np.trapezoid(-tangential * np.sin(angles) - radial * np.cos(angles), angles) / (2 * np.pi)
    y = np.trapezoid(tangential * np.cos(angles) - radial * np.sin(angles), angles) / (2 * np.pi)
    assert milling_wrench(process, np.array([0.02]))[0, :3] == pytest.approx([x, y, 0.0], rel=1e-4)


def test_wrench_columns_are_used_as_they_are_or_missed(tmp_path: Path) -> None:
    nominal = replace(circle(), wrench=np.ones((400, 6)))
    assert predict_wrench(ColumnsProcess(), nominal) == pytest.approx(1)
    faults = (("p.csv", "p.csv:1: missing column fx_N"), ("p.nc", "p.nc: no force is given along this path"))
    for source, said in faults:
        step = rf"{said}, .*fx_N fy_N fz_N.*\[process\].*init NEW.toml --toolpath {source}"
        with pytest.raises(InputError, match=step):
            predict_wrench(ColumnsProcess(), replace(circle(), source=source))
    assert predict_wrench(ColumnsProcess(required=False), circle()) == pytest.approx(0)


def test_a_wrench_file_is_read_by_row_or_by_length(tmp_path: Path) -> None:
    nominal = circle()
    (tmp_path / "s.csv").write_text("s_mm,fx_N,fy_N,fz_N\n0,0,0,0\n1000,1000,0,0\n")
    force = predict_wrench(FileProcess(model="file", file="s.csv"), nominal, folder=tmp_path)[:, 0]
    assert force == pytest.approx(nominal.arc_length * 1e3)
    (tmp_path / "rows.csv").write_text("fx_N,fy_N,fz_N\n1,2,3\n")
    with pytest.raises(InputError, match="1 rows, expected 400, one per waypoint"):
        predict_wrench(FileProcess(model="file", file="rows.csv"), nominal, folder=tmp_path)
    (tmp_path / "short.csv").write_text("s_mm,fx_N,fy_N,fz_N\n0,0,0,0\n10,1,0,0\n")
    with pytest.raises(InputError, match="s_mm covers 0 to 10 mm"):
        predict_wrench(FileProcess(model="file", file="short.csv"), nominal, folder=tmp_path)


@pytest.mark.parametrize(
    ("frame", "force", "moment"),
    [
        ("base", [1, 2, 3], [4, 5, 6]),
        ("part", [-2, 1, 3], [-5, 4, 6]),  # x of the part is y of the base
        ("tool", [1, -2, -3], [4, -5, -6]),  # z out of the tool, which points down
        ("path", [2, -1, 3], [5, -4, 6]),  # x along the travel, which is -y; y to its left, which is x
    ],
)
def test_a_wrench_file_is_read_in_its_units_and_turned_from_each_frame_into_the_base(
    frame: str, force: list[float], moment: list[float], tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text(
        "fx_kN,fy_N,fz_N,mx_Nmm,my_Nm,mz_kNm\n" + "0.001,2,3,4000,5,0.006\n" * 3, encoding="utf-8"
    )
    position = np.array([[0, 0, 0], [0, -0.1, 0], [0, -0.2, 0]])
    nominal = Toolpath(position, np.tile([0.0, 0, 1], (3, 1)), np.ones(3), np.zeros(3, bool))
    process = FileProcess.model_validate({"model": "file", "file": "log.csv", "frame": frame})
    turn = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    wrench = predict_wrench(process, nominal, turn=turn, folder=tmp_path)
    assert wrench[1] == pytest.approx([*force, *moment])


@pytest.mark.parametrize(
    "process",
    [
        IsfProcess(model="isf", axial_N=1200.0, lateral_N=400.0, ramp_mm=3.0),
        milling(width_mm=4.0),
        ConstantProcess(model="constant", force_N=(1.0, 2.0, 3.0), frame="path"),
    ],
)
def test_turning_the_path_turns_its_wrench(process) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 0.7]).as_matrix()
    still = predict_wrench(process, circle(approach=0.01))
    turned = predict_wrench(process, place_toolpath(circle(approach=0.01), pose), turn=pose[:3, :3])
    assert turned[:, :3] == pytest.approx(still[:, :3] @ pose[:3, :3].T, abs=1e-9)
    assert turned[:, 3:] == pytest.approx(still[:, 3:] @ pose[:3, :3].T, abs=1e-9)


def test_a_wrench_file_counts_the_length_that_is_cut_and_no_rapid_move(tmp_path: Path) -> None:
    """Two cuts of 100 mm and a rapid move of 300 mm between them: the second cut goes on at 100 mm."""
    x = np.array([0.0, 50, 100, 400, 450, 500]) * 1e-3
    rapid = np.array([False, False, False, True, False, False])
    position = np.column_stack([x, 0.0 * x, 0.0 * x])
    nominal = Toolpath(position, np.tile([0.0, 0, 1], (6, 1)), np.full(6, 0.05), rapid)
    (tmp_path / "s.csv").write_text("s_mm,fx_N,fy_N,fz_N\n0,0,0,0\n1000,1000,0,0\n")
    force = predict_wrench(FileProcess(model="file", file="s.csv", frame="part"), nominal, folder=tmp_path)[:, 0]
    assert force[[0, 1, 2, 4, 5]] == pytest.approx([0.0, 50.0, 100.0, 150.0, 200.0])


def test_a_plunge_keeps_the_path_frame_of_the_cut_after_it() -> None:
    position = np.array([[0, 0, 0.1], [0, 0, 0], [0.1, 0, 0]])
    nominal = Toolpath(position, np.tile([0.0, 0, 1], (3, 1)), np.ones(3), np.zeros(3, bool))
    assert path_axes(nominal)[1] == pytest.approx(np.eye(3))


def test_slot_milling_needs_the_power_of_the_specific_cutting_force() -> None:
    process, feed = milling(radial_ratio=0.0), np.array([0.02])
    wrench = milling_wrench(process, feed)[0]
    removal = 2.0 * 10.0 * 0.02e3  # mm^3/s
    assert wrench[5] * 2 * np.pi * 6000 / 60 == pytest.approx(800.0 * removal * 1e-3, rel=1e-12)


def test_the_side_of_the_material_mirrors_the_cut() -> None:
    sides = (milling(width_mm=3.0, material_side=side) for side in ("left", "right"))
    left, right = (milling_wrench(process, np.array([0.02]))[0] for process in sides)
    assert left[1] > 0 and right[1] > 0  # a clockwise tool is pushed to its left either way
    assert left[0] < 0 < right[0]  # up milling is held back, climb milling is drawn on
