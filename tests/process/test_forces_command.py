"""`compplan forces`: what it writes, and what it makes of a measured log."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.job.loading import load_path
from compplan.process.fit import fit_forces, read_force_log
from compplan.toolpath.contact import cutting_progress

POCKET = Path(__file__).parents[2] / "examples" / "forces" / "pocket.toml"


def write_job(folder: Path, coefficients: str) -> Path:
    text = POCKET.read_text(encoding="utf-8").replace('material = "al7075_t6"', coefficients)
    rows = (POCKET.parent / "pocket.csv").read_text(encoding="utf-8").splitlines()[:17]  # half of its upper level
    (folder / "pocket.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "job.toml").write_text(text, encoding="utf-8")
    return folder / "job.toml"


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A log of another material than the job's, with noise."""
    folder = tmp_path_factory.mktemp("truth")
    truth = "coefficients = { cutting_N_mm2 = [900.0, 300.0, 120.0], edge_N_mm = [20.0, 18.0, 1.0] }"
    nominal, _ = load_path(load_job(write_job(folder, truth)))
    force = nominal.wrench[:, :3] + np.random.default_rng(5).normal(0.0, 3.0, (len(nominal), 3))
    rows = np.column_stack([1e3 * cutting_progress(nominal), force])[~nominal.rapid]
    np.savetxt(folder / "log.csv", rows, delimiter=",", header="s_mm,fx_N,fy_N,fz_N", comments="")
    return folder / "log.csv"


def test_it_writes_table_page_and_summary(tmp_path, monkeypatch, capsys) -> None:
    text = POCKET.read_text(encoding="utf-8")
    (tmp_path / "pocket.csv").write_text((POCKET.parent / "pocket.csv").read_text(encoding="utf-8"), encoding="utf-8")
    # corners as programmed: one that is rounded leaves a sliver, which the end of the last pass takes in full depth
    more = "[feed]\ncorner_tolerance_mm = 0.0\n"
    (tmp_path / "job.toml").write_text(f"{text}\n{more}", encoding="utf-8")
    answer = run_command(["forces", tmp_path / "job.toml", "--out", tmp_path / "out", "--json"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    summary = json.loads(answer.out)
    assert {"forces.csv", "forces.json", "report.html"} <= {p.name for p in (tmp_path / "out").iterdir()}
    # two levels of 3 mm: the rectangle that the tool's side reaches, corners of its radius
    swept = (60.0 * 40.0 - (4.0 - np.pi) * 25.0) * 6.0
    assert summary["engagement"]["removed_mm3"] == pytest.approx(swept, rel=0.03)
    assert summary["engagement"]["axial_depth_mm"]["max"] == pytest.approx(3.0, abs=0.01)
    assert summary["waypoints_in_contact"] < summary["waypoints"]
    rows = (tmp_path / "out" / "forces.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == summary["waypoints"] + 1 and rows[0].startswith("s_mm,rapid,feed_mm_s,axial_depth_mm")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Duan et al. 2021" in page and "The path coloured by the size of the force" in page


def test_a_log_gives_back_the_coefficients_that_made_it_within_their_intervals(log, tmp_path, monkeypatch, capsys):
    job = write_job(tmp_path, 'material = "al7075_t6"')
    answer = run_command(["forces", job, "--out", tmp_path / "out", "--log", log, "--json"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    found = json.loads(answer.out)["log"]
    truth = dict(zip([number["name"] for number in found["fitted"]], [900, 300, 120, 20, 18, 1] + 7 * [0], strict=True))
    for number in found["fitted"]:
        half = 0.5 * (number["high"] - number["low"])
        assert abs(number["value"] - truth[number["name"]]) < 1.5 * half, number
    assert found["fitted"][0]["value"] == pytest.approx(900, rel=0.03)
    assert found["rms_after_N"] == pytest.approx(3.0 * 3**0.5, rel=0.05)
    assert found["rms_before_N"] > 1.5 * found["rms_after_N"]


def test_a_force_that_the_prediction_does_not_have_is_not_fitted(tmp_path) -> None:
    folder = POCKET.parents[1] / "measured_robot"
    nominal, law = load_path(load_job(folder / "isf_cone.toml"))
    fit = fit_forces(read_force_log(folder / "force_log.csv"), law, nominal, folder / "force_log.csv")
    assert all(number.determined for number in fit.numbers)
    air = "rows in the air tell the force along the tool axis from the offset of the sensor"
    rows = (folder / "force_log.csv").read_text(encoding="utf-8").splitlines()
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join([rows[0], *rows[9:-8]]) + "\n", encoding="utf-8")
    unknown = [number.name for number in fit_forces(read_force_log(bare), law, nominal, bare).numbers
               if not number.determined]  # fmt: skip
    assert unknown == ["factor along the tool axis"], air
    assert fit.notes == ("No fit of the factor along the travel: no such force is predicted.",)
    assert [number.name for number in fit.numbers[:2]] == ["factor to the left", "factor along the tool axis"]
    assert not fit.level_warning


def test_a_log_of_another_cut_is_doubted_and_no_further_log_is_asked_for(tmp_path, monkeypatch, capsys) -> None:
    rows = np.loadtxt(POCKET.parents[1] / "measured_robot" / "force_log.csv", delimiter=",", skiprows=1)
    log, cut = tmp_path / "cut.csv", rows[(rows[:, 0] >= 0.0) & (rows[:, 0] < 2355.0)]  # without the rows in the air
    np.savetxt(log, cut, "%.6g", ",", header="s_mm,fx_N,fy_N,fz_N", comments="")
    words = ["forces", POCKET.with_name("isf_cone.toml"), "--out", tmp_path / "out", "--log", log]
    answer = run_command(words, monkeypatch, capsys)
    assert "next: the log fits 0." in answer.out and "check that it is of this cut" in answer.out


def test_a_log_that_misses_the_cut_is_refused_and_nothing_is_written(log, tmp_path, monkeypatch, capsys) -> None:
    far = tmp_path / "far.csv"
    far.write_text("s_mm,fx_N,fy_N,fz_N\n1e6,0,0,0\n2e6,0,0,0\n", encoding="utf-8")
    job = write_job(tmp_path, 'material = "al7075_t6"')
    answer = run_command(["forces", job, "--out", tmp_path / "out", "--log", far], monkeypatch, capsys)
    assert answer.status == 2 and "0 rows lie in the cut" in answer.err
    assert not (tmp_path / "out").exists()


def test_a_log_of_newtons_in_columns_of_kilonewtons_is_refused(log, tmp_path, monkeypatch, capsys) -> None:
    wrong = tmp_path / "wrong.csv"
    wrong.write_text(log.read_text(encoding="utf-8").replace("_N", "_kN"), encoding="utf-8")
    job = write_job(tmp_path, 'material = "al7075_t6"')
    answer = run_command(["forces", job, "--out", tmp_path / "out", "--log", wrong], monkeypatch, capsys)
    assert answer.status == 2 and "is predicted: check units" in answer.err
    wrong.write_text("s_mm,fx_N,fy_N,fz_N\n1,5,5,5\n2,5,-2e6,5\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"wrong.csv:3: a force of 2e\+06 N, at most 1e\+06 N is allowed"):
        read_force_log(wrong)


def test_a_job_without_a_cutter_has_forces_too(tmp_path, monkeypatch, capsys) -> None:
    answer = run_command(["forces", POCKET.with_name("weld.toml"), "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0 and "along its axis" in answer.out
    assert "engagement" not in json.loads((tmp_path / "out" / "forces.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("lag_mm", [-3.0, 5.0])
def test_offset_drift_and_lag_of_a_log_are_told_from_the_force(lag_mm, log, tmp_path, monkeypatch, capsys) -> None:
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    rows[:, 0] += lag_mm
    rows[:, 1:] += [8.0, -5.0, 20.0] + np.linspace(-0.5, 0.5, len(rows))[:, None] * [6.0, 0.0, -10.0]
    shifted = tmp_path / "shifted.csv"
    np.savetxt(shifted, rows, delimiter=",", header="s_mm,fx_N,fy_N,fz_N", comments="")
    job = write_job(tmp_path, 'material = "al7075_t6"')
    words = ["forces", job, "--out", tmp_path / "out", "--log", shifted, "--write", tmp_path / "fitted.toml", "--json"]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 0, answer.err
    found = {number["name"]: number for number in json.loads(answer.out)["log"]["fitted"]}
    truth = {"tangential cutting coefficient": 900.0, "radial cutting coefficient": 300.0, "lag of the log": lag_mm,
             "offset of fx": 8.0, "offset of fz": 20.0, "drift of fz over the log": -10.0}  # fmt: skip
    for name, value in truth.items():
        half = 0.5 * (found[name]["high"] - found[name]["low"])
        assert abs(found[name]["value"] - value) < max(1.5 * half, 0.02), found[name]
    assert found["tangential cutting coefficient"]["value"] == pytest.approx(900.0, rel=0.05)
    table = tomllib.loads((tmp_path / "fitted.toml").read_text(encoding="utf-8"))["process"]["coefficients"]
    assert table["cutting_N_mm2"][0] == pytest.approx(900.0, rel=0.05) and min(table["edge_N_mm"]) >= 0.0
    (tmp_path / "later").mkdir()
    words = ", ".join(f"{key} = {value}" for key, value in table.items())
    later = load_job(write_job(tmp_path / "later", f"coefficients = {{ {words} }}"))
    assert later.process.coefficients.cutting_N_mm2 == tuple(table["cutting_N_mm2"])


def test_time_and_moments_are_channels_of_a_log_too(tmp_path) -> None:
    job = load_job(write_job(tmp_path, 'material = "al7075_t6"'))
    nominal, law = load_path(job)
    cut = ~nominal.rapid
    step = np.diff(cutting_progress(nominal), prepend=0.0) / np.maximum(nominal.feed, 1e-9)
    columns = np.column_stack([np.cumsum(step), nominal.wrench])[cut]
    noise = np.random.default_rng(2).normal(0.0, [0.0, 9.0, 9.0, 9.0, 0.02, 0.02, 0.02], columns.shape)
    file = tmp_path / "timed.csv"
    header = "t_s,fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm"
    np.savetxt(file, columns + noise, delimiter=",", header=header, comments="")
    widths = {}
    for name, keep in (("all", 7), ("forces", 4)):
        np.savetxt(file, (columns + noise)[:, :keep], delimiter=",", comments="",
                   header=",".join(header.split(",")[:keep]))  # fmt: skip
        found = fit_forces(read_force_log(file), law, nominal, file).numbers[0]
        assert abs(found.value - 767.01) < 0.75 * (found.high - found.low)
        widths[name] = found.high - found.low
    assert widths["all"] < 0.9 * widths["forces"]


def test_a_log_of_another_frame_is_refused_in_words(log, tmp_path, monkeypatch, capsys) -> None:
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    rows[:, 1:] = np.random.default_rng(3).normal(0.0, np.abs(rows[:, 1:]).mean(axis=0), rows[:, 1:].shape)
    other = tmp_path / "other.csv"
    np.savetxt(other, rows, delimiter=",", header="s_mm,fx_N,fy_N,fz_N", comments="")
    job = write_job(tmp_path, 'material = "al7075_t6"')
    answer = run_command(["forces", job, "--out", tmp_path / "out", "--log", other], monkeypatch, capsys)
    assert answer.status == 2 and "needed (tried lags: 20 mm); check that job and log" in answer.err
    assert not (tmp_path / "out").exists()


def test_a_coefficient_below_zero_is_never_silent(log, tmp_path) -> None:
    job = load_job(write_job(tmp_path, 'material = "al7075_t6"'))
    nominal, law = load_path(job)
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    rows[:, 1:] *= -1.0  # force of the tool on the part
    file = tmp_path / "negated.csv"
    np.savetxt(file, rows, delimiter=",", header="s_mm,fx_N,fy_N,fz_N", comments="")
    fit = fit_forces(read_force_log(file), law, nominal, file)
    assert fit.numbers[0].high < 0.0
    assert any("tangential cutting coefficient is fitted below 0 for sure" in note for note in fit.notes)


def test_the_level_of_a_log_becomes_the_process_entry_that_later_plans_read(log, tmp_path, monkeypatch, capsys) -> None:
    job = write_job(tmp_path, 'material = "al7075_t6"')
    robot = tmp_path / "staubli_tx200"
    shutil.copytree(POCKET.parents[2] / "robots" / "staubli_tx200", robot)
    text = job.read_text(encoding="utf-8").replace('robot = "staubli_tx200"', 'robot = "./staubli_tx200"')
    job.write_text(text, encoding="utf-8")
    told = ["forces", job, "--out", tmp_path / "out", "--log", log, "--write"]
    answer = run_command([*told, tmp_path / "process.toml"], monkeypatch, capsys)
    assert answer.status == 2 and "the folder of a robot" in answer.err
    answer = run_command([*told, robot / "process.toml"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    fit = json.loads((tmp_path / "out" / "forces.json").read_text(encoding="utf-8"))["log"]
    nominal, law = load_path(load_job(job))
    rows = np.genfromtxt(log, delimiter=",", names=True)
    force = np.column_stack([rows[name] for name in ("fx_N", "fy_N", "fz_N")])
    predicted = nominal.wrench[~nominal.rapid, :3]
    true = float((force * predicted).sum() / (predicted**2).sum())
    assert fit["level"] == pytest.approx(true, abs=3 * fit["level_sigma"] + 0.01)
    assert law.learned is not None and fit["level"] < law.learned.level < 1.0
    assert law.learned.parts[0].level == pytest.approx(fit["level"])
    share = 0.15**2 / (0.15**2 + fit["level_sigma"] ** 2 + (0.07 * fit["level"]) ** 2)
    assert law.learned.level == pytest.approx(1.0 + share * (fit["level"] - 1.0), rel=1e-4)
