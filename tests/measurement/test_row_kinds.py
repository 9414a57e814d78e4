"""Every kind of row in every command: it is taken, or refused with a reason that says where it belongs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commandline import Answer, run_command
from simulated_campaigns import write_small_robot

from compplan.errors import InputError
from compplan.learning.measured_path import match_points, read_measured_points
from compplan.robot import Array, Robot
from compplan.toolpath.toolpath import Toolpath
from tests.measurement.test_instruments import (
    JOINTS,
    SIGMA,
    bar_log,
    degrees,
    draw_poses,
    gauge_log,
    see,
    socket_log,
    touch,
    write_log,
)  # fmt: skip

Run = Callable[..., Answer]
Logs = tuple[Path, Path | None]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return lambda *words: run_command(words, monkeypatch, capsys)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small") / "small", gravity=False)


def numbers(*values: float) -> str:
    return ",".join(f"{value:.9g}" for value in values)


def stated(folder: Path) -> Path:
    (folder / "own.toml").write_text("schema = 1\n[instrument]\nsigma_mm = 0.02\n")
    return folder / "own.toml"


def position_log(robot: Robot, folder: Path) -> Logs:
    q = draw_poses(robot, 60, 9)
    seen = see(robot, q) + np.random.default_rng(1).normal(0.0, SIGMA, (60, 3))
    rows = [f"static,{degrees(a)},{numbers(*b * 1e3)}" for a, b in zip(q, seen, strict=True)]
    return write_log(folder / "positions.csv", f"run,{JOINTS},x_mm,y_mm,z_mm", rows), None


def export_log(robot: Robot, folder: Path) -> Logs:
    """The same as a tracker program exports it: its own titles, semicolons, decimal commas, nominal values beside."""
    log, _ = position_log(robot, folder)
    head = ["Point", *(f"Joint {k} [deg]" for k in range(1, 7)), "Actual X [mm]", "Actual Y [mm]", "Actual Z [mm]"]
    rows = [f"P{k};{row[7:].replace(',', ';').replace('.', ',')};0,0;"
            for k, row in enumerate(log.read_text().splitlines()[1:])]  # fmt: skip
    return write_log(folder / "export.csv", ";".join([*head, "Nominal X [mm]"]) + ";", rows), None


def probe_log(robot: Robot, folder: Path) -> Logs:
    """Readings along normals, zero where the robot as modelled would stand."""
    q, rng = draw_poses(robot, 120, 9), np.random.default_rng(2)
    place, unit = see(robot, q, ()), rng.normal(size=(120, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    off = np.einsum("ni,ni->n", unit, see(robot, q) - place) + rng.normal(0.0, SIGMA, 120)
    rows = [f"static,{degrees(q[k])},{numbers(*place[k] * 1e3, *unit[k], off[k] * 1e3)}" for k in range(120)]
    return write_log(folder / "probe.csv", f"run,{JOINTS},x_mm,y_mm,z_mm,dir_i,dir_j,dir_k,reading_mm", rows), stated(
        folder
    )


def plane_log(robot: Robot, folder: Path) -> Logs:
    """Contacts with three faces: the point lies in the plane, whose height nobody knows."""
    rng, rows = np.random.default_rng(4), []
    for face, place in enumerate(([1.0, 0.2, 0.7], [0.3, 1.0, 0.9], [0.8, -0.8, 1.1])):
        unit, middle = np.eye(3)[face], np.array(place)
        q = touch(robot, middle, 40, rng, onto=lambda p, u=unit, m=middle: p - np.outer((p - m) @ u, u))  # type: ignore[misc]
        rows += [f"static{face},f{face},{degrees(row)},{numbers(*unit)},0" for row in q]
    return write_log(folder / "plane.csv", f"run,contact,{JOINTS},dir_i,dir_j,dir_k,reading_mm", rows), stated(folder)


def sphere_log(robot: Robot, folder: Path) -> Logs:
    """Contacts with three spheres: the point is both radii, 30 mm, from a centre that nobody knows."""
    rng, rows = np.random.default_rng(4), []
    for number, place in enumerate(([1.0, 0.2, 0.7], [0.3, 1.0, 0.9], [0.8, -0.8, 1.1])):
        middle = np.array(place)

        def onto(p: Array, middle: Array = middle) -> Array:
            return middle + 0.03 * (p - middle) / np.linalg.norm(p - middle, axis=1)[:, None]

        q = touch(robot, middle, 40, rng, onto=onto)
        rows += [f"static{number},s{number},{degrees(row)},30" for row in q]
    return write_log(folder / "sphere.csv", f"run,contact,{JOINTS},distance_mm", rows), stated(folder)


KINDS: dict[str, Callable[[Robot, Path], Logs]] = {
    "positions": position_log, "export": export_log, "sockets": socket_log, "gauge": gauge_log, "ball bar": bar_log,
    "probe": probe_log, "plane": plane_log, "sphere": sphere_log,
}  # fmt: skip


def away(robot: Robot, folder: Path, run: Run, tmp_path: Path) -> tuple[float, float]:
    """Return how far a folder is from the truth at poses that nothing saw, and the robot as modelled. [m]"""
    q = draw_poses(robot, 60, 11)
    asked = write_log(tmp_path / "later.csv", f"run,contact,{JOINTS}", [f"static,later,{degrees(row)}" for row in q])
    answer = run("predict", asked, "--robot", folder, "--out", tmp_path / "p.csv")
    assert answer.status == 0, answer.err
    found = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2)) * 1e-3
    true, modelled = see(robot, q), see(robot, q, ())
    return (float(np.sqrt(np.mean(np.sum((other - true) ** 2, axis=1)))) for other in (found, modelled))  # type: ignore[return-value]


@pytest.mark.parametrize("kind", KINDS)
def test_identify_and_predict_take_every_kind_of_row(kind: str, robot: Robot, tmp_path: Path, run: Run) -> None:
    log, instrument = KINDS[kind](robot, tmp_path)
    given = [log, "--robot", robot.folder, "--register", "tool", *(["--instrument", instrument] if instrument else [])]
    answer = run("identify", *given, "--geometry", "offsets", "--out", tmp_path / "out")
    assert answer.status == 0, answer.err
    left, before = away(robot, tmp_path / "out" / "robot", run, tmp_path)
    assert before > 1e-3 and left < 0.08 * before
    answer = run("predict", *given, "--out", tmp_path / "seen.csv")
    assert answer.status == 0, answer.err


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_diagnosis_takes_every_kind_of_row(kind: str, robot: Robot, tmp_path: Path, run: Run) -> None:
    log, instrument = KINDS[kind](robot, tmp_path)
    given = ["--register", "tool", *(["--instrument", instrument] if instrument else [])]
    answer = run("diagnose", log, "--robot", robot.folder, *given, "--out", tmp_path / "out")
    assert answer.status == 0, answer.err
    left, before = away(robot, tmp_path / "out" / "robot", run, tmp_path)
    assert left < 0.15 * before


@pytest.mark.parametrize("name", ["s.ply", "s.stl", "s.xyz", "s.csv"])
@pytest.mark.parametrize("command", ["identify", "diagnose", "predict"])
def test_a_scan_is_no_log_of_poses_and_is_sent_to_learn(
    command: str, name: str, robot: Robot, tmp_path: Path, run: Run
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    if name in ("s.ply", "s.stl"):
        ball.export(tmp_path / name)
    else:
        np.savetxt(tmp_path / name, ball.vertices, delimiter=" " if name == "s.xyz" else ",")
    answer = run(command, tmp_path / name, "--robot", robot.folder, "--out", tmp_path / "out")
    assert answer.status == 2 and "is a scan" in answer.err and "compplan learn" in answer.err
    assert answer.err.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_of_poses_is_no_measurement_of_a_part_and_is_sent_to_diagnose(
    kind: str, robot: Robot, tmp_path: Path
) -> None:
    log, _ = KINDS[kind](robot, tmp_path)
    with pytest.raises(InputError, match="compplan diagnose takes a log of poses"):
        read_measured_points(log)


def test_a_gauge_whose_zero_nobody_knows_is_no_deviation(tmp_path: Path) -> None:
    head, row = "contact,x_mm,y_mm,z_mm,dir_i,dir_j,dir_k,reading_mm", "g,1,2,3,0,0,1,0.1"
    with pytest.raises(InputError, match="an unknown zero"):
        read_measured_points(write_log(tmp_path / "gauge.csv", head, [row] * 9))


def circle(radius: float = 0.15) -> Toolpath:
    turn = np.linspace(0.0, 2 * np.pi, 361)
    place = np.column_stack([1.0 + radius * np.cos(turn), radius * np.sin(turn), np.full(361, 0.5)])
    return Toolpath(place, np.tile([0.0, 0.0, 1.0], (361, 1)), np.full(361, 0.01), np.zeros(361, bool))


def test_lengths_of_a_ball_bar_along_a_circle_are_its_radial_deviation(tmp_path: Path) -> None:
    """A centre that is 1.2 mm from where it was meant shows as a shift, which a best fit takes off."""
    path, rng = circle(), np.random.default_rng(5)
    nominal = path.position[5:355:3]
    radial = 4e-5 * np.cos(3 * np.linspace(0.0, 2 * np.pi, 361)[5:355:3]) + 2e-5
    centre = np.array([1.0012, -3e-4, 0.5])
    out = (nominal - [1.0, 0.0, 0.5]) / 0.15
    length = np.linalg.norm(nominal + radial[:, None] * out - centre, axis=1) + rng.normal(0.0, 1e-6, len(out))
    rows = [numbers(*place * 1e3, r * 1e3) for place, r in zip(nominal, length, strict=True)]
    table = read_measured_points(write_log(tmp_path / "bar.csv", "x_mm,y_mm,z_mm,distance_mm", rows))
    with pytest.raises(InputError, match="needs --align best_fit"):
        match_points(table, path, np.eye(4), in_base=True)
    found = match_points(table, path, np.eye(4), in_base=True, align="best_fit")
    assert len(found) == len(out)
    np.testing.assert_allclose(np.einsum("mi,mi->m", found.seen, out), radial, atol=1e-5)
    wrong = write_log(
        tmp_path / "far.csv", "x_mm,y_mm,z_mm,distance_mm", [*rows[:-1], numbers(*nominal[-1] * 1e3, 400)]
    )
    with pytest.raises(InputError, match=r"distance_mm is .* expected the length of the ball bar"):
        read_measured_points(wrong)


def test_an_export_of_a_cmm_program_is_read_as_measured_points(tmp_path: Path) -> None:
    path = circle()
    rows = [";".join(f"{v * 1e3:.5f}".replace(".", ",") for v in (*place, *place[:2], place[2] + 3e-5))
            for place in path.position[5:355:3]]  # fmt: skip
    head = "Nominal X [mm];Nominal Y [mm];Nominal Z [mm];Actual X [mm];Actual Y [mm];Actual Z [mm]"
    found = match_points(
        read_measured_points(write_log(tmp_path / "cmm.txt", head, rows)), path, np.eye(4), in_base=True
    )
    np.testing.assert_allclose(found.deviation, np.tile([0, 0, 3e-5], (len(rows), 1)), atol=1e-7)
