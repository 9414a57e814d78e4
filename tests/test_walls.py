"""Finished walls: what arm, tool and thin walls leave, in closed form and through the commands."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import run_command

from compplan.process.cutting import CuttingForce, prepare_cutting
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.process.thin_wall import ThinWallTable, bend_plate
from compplan.process.tool_beam import ToolBeam, ToolBeamTable
from compplan.process.walls import amplify, find_load, judge_walls
from compplan.toolpath.toolpath import Toolpath

RADIUS, DEEP = 5.0, 4.0
FEED = 0.02


def bend(size: tuple[float, float], x: float, at: float = 1.0, load: float = 1.0, held: bool = False) -> float:
    """Return what a plate of stiffness 1 gives."""
    return float(bend_plate(size, 1.0, 0.3, (held, held), x, np.array([at]), np.array([load]))[0, 0])


def cut(
    points: list[tuple[float, float]], block: tuple[tuple[float, ...], tuple[float, ...]], helix: float = 30.0
) -> CuttingForce:
    """Cut along straight lines between points at one depth [mm], the first move rapid."""
    rows = [np.array(points[:1])]
    for a, b in pairwise(points):
        rows.append(np.linspace(a, b, 41)[1:])
    flat = np.vstack(rows)
    position = 1e-3 * np.column_stack([flat, np.full(len(flat), -DEEP)])
    count = len(flat)
    path = Toolpath(position, np.tile([0.0, 0.0, 1.0], (count, 1)), np.full(count, FEED), np.arange(count) == 0)
    table = {"model": "end_mill", "diameter_mm": 2 * RADIUS, "teeth": 2, "spindle_rpm": 9000.0, "helix_deg": helix,
             "coefficients": {"cutting_N_mm2": (800.0, 300.0, 0.0), "edge_N_mm": (15.0, 12.0, 0.0)},
             "stock": {"block_mm": block}}  # fmt: skip
    return prepare_cutting(EndMillProcess.model_validate(table), path, None, Path("job.toml"))


def finish(beam: ToolBeam | None = None, thin: tuple[ThinWallTable, ...] = (), into: float = 0.0, wide: float = 0.5):
    """Finish a wall to the left, the arm off by a length [m] to the left."""
    made = cut([(-8.0, 0.0), (48.0, 0.0)], ((0.0, RADIUS - wide, -30.0), (40.0, 40.0, 0.0)))
    rows = len(made.arc)
    return judge_walls(made, np.full(rows, FEED), np.tile([0.0, into, 0.0], (rows, 1)), beam, thin)


def test_a_wall_that_only_the_arm_moves_is_off_by_that_to_its_side() -> None:
    (wall,) = finish(into=3e-5)
    assert wall.side == "left" and wall.mean == pytest.approx(3e-5) and wall.greatest == pytest.approx(3e-5)
    assert wall.describe()["parts_mm"] == {"arm": pytest.approx(0.03), "tool": 0.0, "thin wall": 0.0}
    (rigid,) = finish()
    assert rigid.mean == 0.0


def test_a_spring_of_the_wall_gives_as_much_as_the_same_spring_of_the_tool() -> None:
    place = {"from_mm": (-5.0, RADIUS + 1.0, -20.0), "to_mm": (45.0, RADIUS + 1.0, -20.0), "height_mm": 20.0}
    soft = ThinWallTable(**place, thickness_mm=2.0, stiffness_N_mm=2000.0)
    (wall,) = finish(thin=(soft,), wide=0.2)
    (twice,) = finish(thin=(soft.model_copy(update={"stiffness_N_mm": 1000.0}),), wide=0.2)
    assert wall.parts[2].mean() == pytest.approx(wall.mean) and wall.mean < 0.0
    assert 1.3 < twice.mean / wall.mean < 2.0  # less than twice: a tool that is pushed off cuts less
    away = ThinWallTable(**{**place, "from_mm": (-5.0, 30.0, -20.0), "to_mm": (45.0, 30.0, -20.0)},
                         thickness_mm=2.0, stiffness_N_mm=2000.0)  # fmt: skip
    assert finish(thin=(away,))[0].mean == 0.0


def test_a_wall_that_is_cut_again_is_not_the_finished_one() -> None:
    block = ((0.0, -40.0, -30.0), (40.0, 40.0, 0.0))
    first = cut([(-8.0, 0.0), (48.0, 0.0)], block)
    still = np.zeros((len(first.arc), 3))
    assert [wall.side for wall in judge_walls(first, np.full(len(still), FEED), still, None, ())] == ["left", "right"]
    again = cut([(-8.0, 0.0), (48.0, 0.0), (48.0, 2.0), (-8.0, 2.0)], block)
    still = np.zeros((len(again.arc), 3))
    found = judge_walls(again, np.full(len(still), FEED), still, None, ())
    assert [(wall.side, wall.first < 45) for wall in found] == [("right", True), ("right", False)]


@pytest.mark.parametrize(("size", "at", "wanted"), [
    ((4.0, 1.0), 2.0, 0.168),  # a long plate under a force at the middle of its free edge [Jaramillo 1950]
    ((0.05, 1.0), 0.025, 1.0 / (3.0 * 0.05 * (1.0 - 0.3**2))),  # a strip: h^3 / (3 E I)
])  # fmt: skip
def test_a_plate_gives_as_closed_forms_say(size, at: float, wanted: float) -> None:
    assert bend(size, at) == pytest.approx(wanted, rel=0.02)


def test_a_plate_is_stiffer_held_at_its_ends_and_softer_at_a_free_one() -> None:
    assert bend((2.0, 1.0), 1.0, held=True) < 0.7 * bend((2.0, 1.0), 1.0)
    assert bend((4.0, 1.0), 0.05) > 2.0 * bend((4.0, 1.0), 2.0)
    assert bend((3.0, 1.0), 1.0, 0.4, 0.9) == pytest.approx(bend((3.0, 1.0), 1.0, 0.9, 0.4))


def test_straight_teeth_that_leave_a_soft_wall_are_held_off_it_by_their_edge_force() -> None:
    made = cut([(48.0, 0.0), (-8.0, 0.0)], ((0.0, RADIUS - 0.5, -30.0), (40.0, 40.0, 0.0)), helix=0.0)  # down
    rows = len(made.arc)
    soft = ThinWallTable(from_mm=(0.0, RADIUS + 12.5, -20.0), to_mm=(40.0, RADIUS + 12.5, -20.0), thickness_mm=25.0,
                         height_mm=20.0, stiffness_N_mm=5000.0)  # fmt: skip
    (wall,) = judge_walls(made, np.full(rows, FEED), np.zeros((rows, 3)), None, [soft])
    held = 12.0 * DEEP / 5000.0 * 1e-3  # it springs back into the wall, a bite at each pass
    assert -1.1 * held < wall.mean < -0.7 * held


def test_a_cut_damps_a_tool_that_swings_into_the_wall() -> None:
    beam = ToolBeamTable(stickout_mm=60.0, damping=0.05).build(0.01, 0.06)
    omega = beam.modes.omega[0]
    turn = np.cos(6 * 2 * np.pi * np.arange(360) / 360)[None]
    damped = amplify(turn, omega / (12 * np.pi), beam, np.full((1, 360), 0.1 / omega))
    assert np.abs(damped).max() == pytest.approx(1.0 / (2 * 0.05 + 0.1), rel=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_edge_that_makes_a_wall_is_loaded_where_it_stands_in_the_cut(side: float) -> None:
    """Oracle: a right-hand helix, its edge swept: what stands higher lags, and a clockwise spindle turns to less."""
    arc, low, axial, lead = np.array([0.4, 0.5 * np.pi])[:: int(side)] * side, 1e-3, 6e-3, 120.0
    found = SimpleNamespace(arc=np.array([arc]), axial=np.array([axial]))
    places = np.linspace(low, low + axial, 200_001)
    for height in (1.5e-3, 4e-3, 6.5e-3):
        load = find_load(np.array([[height]]), np.array([low]), found, np.array([0]), side, lead)
        angle = side * 0.5 * np.pi + lead * (places - height)
        wanted = places[(angle >= arc[0] - 1e-9) & (angle <= arc[1] + 1e-9)].mean()
        assert load[0, 0] == pytest.approx(wanted, abs=1e-7)


def test_a_harmonic_near_the_tools_own_frequency_is_amplified() -> None:
    beam = ToolBeamTable(stickout_mm=60.0, damping=0.05).build(0.01, 0.06)
    rings = beam.modes.omega[0] / (2 * np.pi)
    turn = np.cos(6 * 2 * np.pi * np.arange(360) / 360)[None]
    assert np.abs(amplify(turn, rings / 6, beam)).max() == pytest.approx(10.0, rel=0.01)
    assert np.abs(amplify(turn, rings / 600, beam) - turn).max() < 0.005
    late = amplify(turn, rings / 12, beam)[0]  # half the frequency: 4/3, and late, so at smaller angles
    assert np.abs(late).max() == pytest.approx(4 / 3, rel=0.01) and late[1:8].mean() < late[-7:].mean()


def test_a_wall_beside_a_simulation_in_time(monkeypatch) -> None:
    from benchmarks import walls as bench

    monkeypatch.setattr(bench, "LOOKED", (0.6, 1.2))
    monkeypatch.setattr(bench, "STEP", np.radians(0.5))
    case = bench.draw_cases(34)[1]
    wanted, (mean, _) = bench.simulate(case), bench.predict(case)
    assert mean == pytest.approx(wanted.mean(), rel=0.1)


JOB = """schema = 1
name = "wall"
robot = "staubli_tx200"
toolpath = "path.csv"
[part]
position_mm = [1400.0, 0.0, 300.0]
[process]
model = "end_mill"
diameter_mm = 10.0
teeth = 2
spindle_rpm = 9000.0
coefficients = { cutting_N_mm2 = [800.0, 300.0, 0.0], edge_N_mm = [15.0, 12.0, 0.0] }
[process.stock]
block_mm = [[0.0, 4.5, -30.0], [30.0, 40.0, 0.0]]
[plan]
rotate_about_tool_axis = false
[tool_beam]
stickout_mm = 50.0
[surface]
"""


def test_forces_and_plan_state_a_figure_for_the_wall_and_the_plan_takes_the_arms_part_away(
    tmp_path, monkeypatch, capsys
) -> None:
    path = "x_mm,y_mm,z_mm,feed_mm_s,rapid\n-8,0,20,20,1\n-8,0,-3,20,1\n38,0,-3,20,0\n38,0,20,20,1\n"
    (tmp_path / "path.csv").write_text(path, encoding="utf-8")
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    told = {}
    for name in ("forces", "plan"):
        answer = run_command([name, tmp_path / "job.toml", "--out", tmp_path / name, "--json"], monkeypatch, capsys)
        assert answer.status == 0, answer.err
        told[name] = json.loads(answer.out)["surface"]
        page = (tmp_path / name / "report.html").read_text(encoding="utf-8")
        assert "Finished walls" in page and "by the thin wall" in page
    assert "end_mill 10 mm, 2 teeth, 9000 rpm, in coefficients of the job" in page
    removed, rubbed = 800.0 * 0.5 * 3.0 * 20.0, 15.0 * 3.0 * 5.0 * np.arccos(0.9) * 2 * 150.0  # N mm/s, both
    kilowatts = float(re.findall(r"N m, ([0-9.]+) kW", page)[0])
    assert kilowatts == pytest.approx(1e-6 * (removed + rubbed), rel=0.02)
    before, after = (told[name]["walls"] for name in ("forces", "plan"))
    assert len(before) == len(after) == 1 and before[0]["side"] == "left"
    assert abs(after[0]["parts_mm"]["arm"]) < 0.1 * abs(before[0]["parts_mm"]["arm"])
    assert after[0]["parts_mm"]["tool"] == pytest.approx(before[0]["parts_mm"]["tool"], rel=0.25) != 0.0
    assert told["plan"]["arm"] == "corrected" and any("assumed" in each for each in told["plan"]["assumed"])
