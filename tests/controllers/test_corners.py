"""Rounded corners of a path in programs: one move each, with a zone of the rounding's size."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.controllers.readback.languages import read_fanuc, read_krl, read_rapid, read_val3
from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript
from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.robot import Array, load_robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, refine_ik
from compplan.toolpath.corners import KEPT, SLOWED, find_corner_shifts, round_corners
from compplan.toolpath.toolpath import Toolpath, resample_toolpath

#: An arm a language, and a posture that bends its wrist. [deg]
ARMS = {
    "krl": ("kuka_kr16_2", [0, -80, 100, 10, 60, 5], read_krl),
    "rapid": ("abb_irb4600_60_205", [5, 10, 10, 10, 60, 5], read_rapid),
    "urscript": ("ur10e", [5, -100, -110, -60, 90, 5], read_urscript),
    "fanuc_ls": ("fanuc_m20ia", [5, 10, 10, 10, 60, 5], read_fanuc),
    "kawasaki_as": ("kawasaki_rs020n", [5, 10, 80, 10, 60, 5], read_kawasaki),
    "val3": ("staubli_tx200", [5, 10, 80, 10, 60, 5], read_val3),
    "sinumerik": ("kuka_kr16_2", [5, -80, 100, 10, 60, 5], read_sinumerik),
    "inform": ("yaskawa_gp25", [5, 10, 10, 10, 60, 5], read_inform),
}
#: A contour with right and blunt corners. [mm]
CONTOUR = np.array([[0.0, 0], [8, 0], [8, 6], [14, 9], [20, 6], [20, -4], [0, -4]])
ROUNDED = 25e-6


def round_contour(power: int) -> tuple[Toolpath, Array]:
    """Return the contour with its corners rounded, and a time that goes slowly through them."""
    n = len(CONTOUR)
    place = np.column_stack([1e-3 * CONTOUR, np.zeros(n)])
    path = Toolpath(place, np.tile([0.0, 0.0, 1.0], (n, 1)), np.full(n, 0.02), np.arange(n) == 0)
    path = round_corners(resample_toolpath(path, 1e-3), ROUNDED, power)
    assert path.rounded is not None
    speed = np.where(path.rounded[1:] > 0.0, 0.002, 0.02)
    return path, np.r_[0.0, np.cumsum(path.steps / speed)]


def write_contour(language: str, power: int = SLOWED) -> tuple[Program, Array]:
    """Return the program of the contour, and where its moves have to end, part frame. [mm]"""
    name, posture, _ = ARMS[language]
    path, time = round_contour(power)
    arm, n = build_arm(load_robot(name)), len(path)
    q = np.repeat(np.radians([posture]), n, axis=0)
    frames = locate_frames(arm.chain, q)
    place = frames.tcp_position + path.position
    q = refine_ik(arm, q, place, frames.tcp_rotation)
    program = build_program(arm.robot, q, path.feed, path.rapid, name="turns", time=time, exact=np.arange(n) == 0)
    assert program.tcp is not None
    beside = np.full(n, ROUNDED)
    program = replace(
        program, tolerance=2e-6, form="linear", cycle=0.004, corner=beside, asked=1e3 * path.feed,
        corner_shift=find_corner_shifts(path, program.tcp[:, :3, 3] - frames.tcp_position[0], beside),
    )  # fmt: skip
    corners = np.column_stack([CONTOUR, np.zeros(len(CONTOUR))])
    return program, corners + 1e3 * frames.tcp_position[0]


@pytest.mark.parametrize("language", list(ARMS))
def test_a_rounded_corner_is_one_move_to_the_corner_in_every_language(language: str, tmp_path: Path) -> None:
    program, wanted = write_contour(language)
    write_program(program, language, tmp_path, any_brand=True)
    main = next(file for file in sorted(tmp_path.iterdir()) if not file.stem[-1].isdigit())
    moves = [move for move in ARMS[language][2](main) if move.kind != "act"]
    assert len(program) > 100 and len(moves) == len(CONTOUR)
    world = program.world.copy()
    world[:3, 3] *= 1e3
    for move, place in zip(moves[1:], wanted[1:], strict=True):
        assert move.pose is not None
        end = move.pose if move.base is None else world @ np.asarray(move.base) @ move.pose  # None: the cell's frame
        assert np.linalg.norm(end[:3, 3] - place) < 1e-3
        assert move.feed is not None and move.feed > 10.0  # not that of the corner


@pytest.mark.parametrize("power", [SLOWED, KEPT])
def test_the_zone_of_a_corner_passes_it_at_the_distance_of_its_rounding(power: int) -> None:
    program, _ = write_contour("krl", power)
    fitted = fit_moves(program).program
    zones, stated, _ = find_zones(fitted, ZONES["krl"])
    at = 1e3 * fitted.positions[:, :3, 3]
    for k in range(1, len(at) - 1):
        before, after = (step / np.linalg.norm(step) for step in (at[k] - at[k - 1], at[k + 1] - at[k]))
        passed = 1e-3 * np.linalg.norm(after - before) * 1e3 * zones[k] / 4.0
        assert stated[k] == zones[k] and 0.8 * ROUNDED < passed <= ROUNDED * (1.0 + 1e-9)


def test_legs_between_corners_take_the_time_that_the_plan_takes() -> None:
    program, _ = write_contour("krl")
    fitted = fit_moves(program)
    few = fitted.program
    assert few.time is not None
    step = 1e3 * np.linalg.norm(np.diff(few.positions[:, :3, 3], axis=0), axis=1)
    lasts = np.diff(few.time)[1:-1]
    assert step[1:-1] / few.feed[2:-1] == pytest.approx(lasts, rel=0.012)  # one feed holds within 1 %


def test_an_arc_beside_a_corner_keeps_its_rounding() -> None:
    """A rounding that spans chords of a small arc has no corner on two lines."""
    angle = np.linspace(0.5 * np.pi, 0.0, 41)
    arc = 1e-3 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    place = np.vstack([[-5e-3, 1e-3, 0.0], arc + np.array([0.0, 2e-3, 0.0]), arc[-1:] + np.array([0.0, -4e-3, 0.0])])
    path = Toolpath(
        place, np.tile([0.0, 0.0, 1.0], (len(place), 1)), np.full(len(place), 0.02), np.zeros(len(place), bool)
    )
    path = round_corners(path, 0.2e-3)
    shift = find_corner_shifts(path, path.position, np.full(len(path), 0.2e-3))
    assert path.rounded is not None
    if shift is not None:
        kept = (path.rounded > 0.0) & (shift == 0.0).all(axis=1)
        assert kept.any()


def test_ur_programs_call_their_function_and_krl_halts_say_why(tmp_path: Path) -> None:
    program, _ = write_contour("urscript")
    (file,) = write_program(program, "urscript", tmp_path)
    assert file.read_text().endswith(f"\nend\n{file.stem}()\n")


def test_val3_programs_declare_the_locals_that_they_use(tmp_path: Path) -> None:
    program, _ = write_contour("val3")
    for file in write_program(program, "val3", tmp_path):
        text = file.read_text()
        declared = set(re.findall(r'<Local name="(\w+)"', text))
        code = text[text.find("begin") :]
        assert declared == {word for word in ("l_nKey",) if word in code}
