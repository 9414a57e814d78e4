"""Force and place: the force depends on where the loaded tool really is, in plan, judge and Monte Carlo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.job.job import check_job
from compplan.job.loading import load_path
from compplan.plan.evaluate import evaluate_model
from compplan.plan.plan import Plan, build_task, plan_job, prepare_job
from compplan.process.process_stiffness import follow_jumps
from compplan.simulation.cell import CellRun
from compplan.simulation.coupling import settle_coupled

#: Deviation per force of a bar that yields differently along each axis [m/N], and a process stiffer than it [N/m].
SOFT, SHEET = np.array([11.8e-6, 2.94e-6, 1.09e-6]), 2e5


def settle(stiffness: np.ndarray, force: np.ndarray, bend: float = 0.0, compliance: np.ndarray = SOFT):
    """Settle a tip that yields by d = C F (1 + bend |F|) in front of a process of given stiffness."""
    slope = np.diag(stiffness)[None]

    def attain(wrench: np.ndarray) -> CellRun:
        size = np.linalg.norm(wrench[:, :3], axis=1, keepdims=True)
        return CellRun(compliance * wrench[:, :3] * (1.0 + bend * size), np.eye(3)[None])

    def respond(away: np.ndarray) -> np.ndarray:
        return np.hstack([-np.einsum("nij,nj->ni", slope, away), np.zeros((1, 3))])

    wrench = np.r_[force, np.zeros(3)][None]
    return settle_coupled(attain, respond, position=np.zeros((1, 3)), wrench=wrench,
                          compliance=np.diag(compliance)[None], stiffness=slope)  # fmt: skip


def test_a_sheet_of_2e5_newtons_a_metre_leaves_thirty_sixty_three_and_eighty_two_per_cent() -> None:
    force = np.array([500.0, 500.0, 1200.0])
    found = settle(np.full(3, SHEET), force)
    left = found.run.position[0] / (SOFT * force)
    assert left == pytest.approx(1.0 / (1.0 + SOFT * SHEET), rel=1e-9)  # the same as 1/C beside K in a row
    assert np.round(100 * left) == pytest.approx([30, 63, 82])
    assert found.agrees and found.passes <= 3


def test_three_passes_are_enough_where_plain_repetition_would_grow() -> None:
    found = settle(np.full(3, SHEET), np.array([500.0, 500.0, 1200.0]), bend=1e-4)
    # d = C F (1 + b |F|), F = F0 - K d, by bisection along the one direction that a pure x force bends
    only = settle(np.array([SHEET, 0.0, 0.0]), np.array([500.0, 0.0, 0.0]), bend=1e-4)
    low, high = 0.0, 500.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        rest = 500.0 - SHEET * SOFT[0] * middle * (1.0 + 1e-4 * middle)
        low, high = (middle, high) if rest > middle else (low, middle)
    assert only.wrench[0, 0] == pytest.approx(low, rel=1e-4)
    assert found.agrees and SOFT[0] * SHEET > 2.0  # repetition would grow by this a pass


def test_a_process_that_pushes_the_tool_on_is_said_not_to_agree() -> None:
    found = settle(np.array([-1.2 / SOFT[0], 0.0, 0.0]), np.array([100.0, 0.0, 0.0]))
    assert not found.agrees and found.margin == pytest.approx(-0.2)
    assert "pushes it on faster than the arm holds it" in found.explain() and "\n" not in found.explain()


def test_passes_that_grow_are_said_not_to_agree() -> None:
    found = settle(np.full(3, SHEET), np.array([500.0, 0.0, 0.0]), bend=0.05)
    assert not found.agrees and "do not agree in 3 passes" in found.explain()
    assert "100 % of the waypoints in contact miss it, waypoint 0 by the most" in found.explain()


def write_job(**tables: dict) -> dict:
    job = {
        "schema": 1, "name": "sheet", "robot": "staubli_tx200",
        "toolpath": {"generator": "circle", "radius_mm": 15.0, "waypoints": 40, "feed_mm_s": 20.0, "approach_mm": 5.0},
        "part": {"position_mm": [1500.0, 0.0, 183.0]},
        "process": {"model": "constant", "force_N": [300.0, 200.0, 1000.0]},
        "plan": {"rotate_about_tool_axis": False, "configuration": {"elbow": "up"}, "inertia": False},
        "sampling": {"chord_mm": 0.02},
    }  # fmt: skip
    return {**job, **tables}


@pytest.fixture(scope="module")
def sheet() -> Plan:
    return plan_job(check_job(write_job(coupling={"stiffness_N_mm": [200.0, 200.0, 200.0]}), Path("job.toml")))


def test_a_plan_shows_the_uncorrected_tip_without_and_with_and_its_correction_is_the_same(sheet) -> None:
    plain = plan_job(check_job(write_job(), Path("job.toml")))
    assert plain.coupling is None and sheet.coupling is not None
    assert sheet.coupling.without_size[1] == pytest.approx(plain.before.max_deviation, rel=1e-6)
    assert sheet.before.max_deviation < 0.8 * plain.before.max_deviation
    assert np.abs(sheet.q - plain.q).max() < 1e-7  # on the path the force is that of the path
    assert sheet.status == "solved", sheet.breaches
    assert sheet.after.max_deviation < 1e-6
    assert sheet.mismatch.max_deviation < 0.8 * plain.mismatch.max_deviation


def test_the_coupled_tip_is_that_of_two_springs_in_a_row(sheet) -> None:
    plain = sheet.coupling.without
    deviation, wrench = sheet.before.deviation[sheet.after.cut], sheet.before.settled.wrench[sheet.after.cut]
    start = sheet.task.wrench[sheet.after.cut]
    loaded = np.abs(start[:, 0]) > 1.0
    sheet_force = start[loaded, :3] - wrench[loaded, :3]
    assert sheet_force == pytest.approx(2e5 * deviation[loaded], abs=0.02)
    assert (sheet.coupling.coupled < plain).all()


def test_the_page_and_the_summary_show_both(sheet, tmp_path) -> None:
    from compplan.reporting.writers.plan import write_plan

    write_plan(sheet, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))["coupling"]
    both = summary["error_before_mm"]
    assert both["coupled"]["rms"] < both["without"]["rms"] and len(summary["left"]) == 3 and summary["passes"] <= 3
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Force and place" in page and "by the force on the path" in page
    assert any("of the uncorrected deviation" in note for note in sheet.notes)


def test_monte_carlo_couples_force_and_place_as_the_plan_does(sheet) -> None:
    from compplan.job.noise import NoiseTable
    from compplan.studies.judging import judge_points
    from compplan.studies.study import prepare_study

    quiet = {}
    for name in NoiseTable.model_fields:
        if name not in ("effects", "correlation_mm", "gear_periods", "plant_lag_ms", "plant_delay_ms", "robot"):
            quiet[name] = 0.0
    noise = NoiseTable(**quiet)
    study = prepare_study(sheet.task, noise, ["none"])
    judged = judge_points(study, np.full((1, study.surroundings.factors.size), 0.5))
    assert judged.rms[0, 0] == pytest.approx(sheet.before.rms_deviation, rel=1e-3)


@pytest.mark.parametrize(
    ("table", "fault"),
    [
        ({}, "needs one of stiffness_N_mm and from_model"),
        ({"stiffness_N_mm": [2e6, 0.0, 0.0]}, "0 to 1e6 N/mm is allowed"),
        ({"from_model": True}, "only end_mill and drill do"),
        ({"stiffness_N_mm": [1.0, 1.0, 1.0], "frame": "tool"}, "coupling.frame"),
    ],
)
def test_a_coupling_that_is_none_is_refused(table, fault, tmp_path, monkeypatch, capsys) -> None:
    lines = ['schema = 1', 'robot = "staubli_tx200"', "[toolpath]", 'generator = "circle"', "radius_mm = 15.0",
             "waypoints = 24", "feed_mm_s = 20.0", "[part]", "position_mm = [1500.0, 0.0, 183.0]", "[process]",
             'model = "constant"', "force_N = [300.0, 200.0, 1000.0]", "[coupling]"]  # fmt: skip
    lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    (tmp_path / "job.toml").write_text("\n".join(lines), encoding="utf-8")
    answer = run_command(["plan", tmp_path / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2 and fault in answer.err and answer.err.count("\n") == 1, answer.err
    assert not (tmp_path / "out").exists()


def test_a_cutter_that_gives_way_sideways_out_of_the_stock_meets_less(tmp_path) -> None:
    path = tmp_path / "side.csv"
    rows = "-10,42,-5,50,1\n-10,42,-5,50,0\n60,42,-5,50,0\n"
    path.write_text(f"x_mm,y_mm,z_mm,feed_mm_s,rapid\n{rows}", encoding="utf-8")
    job = write_job(
        toolpath="side.csv",
        process={"model": "end_mill", "diameter_mm": 10.0, "teeth": 2, "spindle_rpm": 9000.0, "material": "al7075_t6",
                 "stock": {"block_mm": [[0.0, 0.0, -20.0], [50.0, 40.0, 0.0]]}},
        coupling={"from_model": True},
    )  # fmt: skip
    nominal, law = load_path(check_job(job, tmp_path / "job.toml"))
    middle = int(np.argmin(np.abs(nominal.position[:, 0] - 1.525)))
    stiffness = law.coupling.along(nominal, nominal.wrench)[middle]
    step = np.zeros((len(nominal), 3))
    step[:, 1] = 5e-5
    change = law.respond(nominal, nominal.wrench, stiffness, step)[middle, :3]
    wanted = -stiffness[:, 1] * 5e-5
    assert np.linalg.norm(change - wanted) < 0.03 * np.linalg.norm(wanted)
    # a part that is turned takes its forces and what they answer to along
    part = job["part"] | {"rotation_deg": [20.0, -10.0, 60.0]}
    turned = load_path(check_job(job | {"part": part}, tmp_path / "job.toml"))
    R = turned[1].T_base_part[:3, :3] @ law.T_base_part[:3, :3].T
    assert abs(R[0, 1]) > 0.5
    there = turned[1].coupling.along(turned[0], turned[0].wrench)[middle]
    assert there == pytest.approx(R @ stiffness @ R.T, abs=1e-6 * np.abs(stiffness).max())
    # stock, path and tool axis turned in the part by 90 deg about its x
    path.write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid\n" + "".join(
        f"{x},5,42,0,-1,0,50,{rapid}\n" for x, rapid in ((-10, 1), (-10, 0), (60, 0))
    ))  # fmt: skip
    process = job["process"] | {"stock": {"block_mm": [[0.0, 0.0, 0.0], [50.0, 20.0, 40.0]]}}
    lying, answer = load_path(check_job(job | {"process": process}, tmp_path / "job.toml"))
    R = law.T_base_part[:3, :3] @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ law.T_base_part[:3, :3].T
    own = answer.coupling.along(lying, lying.wrench)[middle]
    assert own == pytest.approx(R @ stiffness @ R.T, abs=0.02 * np.abs(stiffness).max())
    moved = answer.respond(lying, lying.wrench, own, step @ R.T)[middle, :3]
    assert moved == pytest.approx(R @ change, abs=0.02 * np.linalg.norm(change))
    # the arc from -90 deg to where the stock's edge stands: dF/dy by its end alone, at h = f cos u
    kt, kr, et, er, f, depth = 767.01, 168.8, 27.7, 26.6, 50.0 * 60.0 / 9000.0 / 2.0, 5.0
    u = -np.arcsin(2.0 / 5.0)
    t, r = kt * f * np.cos(u) + et, kr * f * np.cos(u) + er
    end = 2.0 / (2.0 * np.pi) * depth * np.array([-np.sin(u) * t - np.cos(u) * r, np.cos(u) * t - np.sin(u) * r])
    turn = -1.0 / (5.0 * np.cos(u))  # rad per mm that the tool goes away
    assert np.linalg.norm(-stiffness[:2, 1] * 1e-3 - end * turn) < 0.06 * np.linalg.norm(end * turn)


def write_side_passes(folder: Path, passes: list[float]) -> dict:
    """Return the job of side passes in a block, y of each [mm], with a cutter whose force says where it has to be."""
    lines = ["x_mm,y_mm,z_mm,feed_mm_s,rapid"]
    for y in passes:
        lines += [f"-5.5,{y},20,45,1", f"-5.5,{y},-2,45,1", f"30,{y},-2,45,0", f"30,{y},20,45,1"]
    (folder / "passes.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return write_job(
        toolpath="passes.csv",
        part={"position_mm": [1400.0, 0.0, 300.0]},
        process={"model": "end_mill", "diameter_mm": 10.0, "teeth": 2, "spindle_rpm": 9000.0,
                 "coefficients": {"cutting_N_mm2": [800.0, 300.0, 0.0], "edge_N_mm": [15.0, 12.0, 0.0]},
                 "stock": {"block_mm": [[0.0, -40.0, -30.0], [24.0, 0.0, 0.0]]}},
        coupling={"from_model": True}, plan={"rotate_about_tool_axis": False}, sampling={},
    )  # fmt: skip


@pytest.mark.parametrize("passes", [[0.0], [3.4, 1.9]])
def test_a_cutter_and_an_arm_that_yields_agree_where_an_earlier_pass_gave_way_too(passes, tmp_path) -> None:
    robot, nominal, options = prepare_job(check_job(write_side_passes(tmp_path, passes), tmp_path / "job.toml"))
    task = build_task(robot, nominal, options)
    settled = evaluate_model(task, task.q_start).settled
    assert settled.agrees and settled.passes <= 3, settled.explain()
    deviation = evaluate_model(task, task.q_start).deviation
    inside = np.abs(1e3 * task.position[:, 0] - 1412.0) < 4.0
    spread = [np.ptp(deviation[inside & (np.abs(1e3 * task.position[:, 1] - y) < 0.01) & ~task.nominal.rapid, 1])
              for y in passes]  # fmt: skip
    assert max(spread) < 0.05 * np.abs(deviation[inside, 1]).max()  # one straight cut: no sliver comes and goes


def test_a_tool_follows_a_jump_to_first_order_however_its_path_is_divided() -> None:
    arc = np.sort(np.r_[0.0, np.random.default_rng(3).uniform(0.0, 5e-3, 60)])
    away = np.tile([1e-4, -2e-4, 0.0], (len(arc), 1))
    wanted = (1.0 - np.exp(-arc / 1e-3))[:, None] * away
    assert follow_jumps(away, arc, 1e-3) == pytest.approx(wanted, abs=1e-15)
