"""Programs read by readers that are not part of the package: where they lead is the plan's path within 1e-3 mm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from golden_cell import COUNTING, PART, TOOL, WAYPOINTS, forward, write_job

from compplan.controllers.writers import Program, write_program
from compplan.controllers.writers.program import Post
from tests.controllers.test_fit import circle, make_program
from tests.oracles.program_texts import READERS, Target

#: [mm]
WITHIN = 1e-3


def name_program(language: str, name: str) -> str:
    return name.upper() if language in ("fanuc_ls", "inform", "sinumerik") else name


def place_tip(language: str, target: Target) -> np.ndarray:
    """Where a target of the golden job puts the tip, base frame; joints are undone by hand."""
    counting = COUNTING[language]
    if target.tip is not None:
        tip = counting.world @ target.tip
        tip[:3, :3] = tip[:3, :3] @ (TOOL[:3, :3] if language == "sinumerik" else np.eye(3))
        return np.asarray(tip)
    slide, *angles = counting.undo(target.joints, target.outer if counting.rail else None)
    return np.asarray(forward(slide, tuple(angles)) @ (TOOL if target.tool is None else target.tool))


def measure_off(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance of places from a polyline. Shape (n, 3), (m, 3) -> (n,)."""
    leg = np.diff(corners, axis=0)
    arm = places[:, None] - corners[:-1]
    share = np.clip((arm * leg).sum(axis=2) / np.maximum((leg**2).sum(axis=1), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(arm - share[:, :, None] * leg, axis=2).min(axis=1))


@pytest.mark.parametrize("language", READERS)
def test_joints_and_positions_of_every_language_lead_along_the_path(
    language: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = run_command(["plan", write_job(tmp_path, language), "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    *patterns, read = READERS[language]
    wanted = (PART @ np.column_stack([WAYPOINTS[:, :3], np.ones(len(WAYPOINTS))]).T).T[:, :3]
    axes = WAYPOINTS[:, 3:6] @ PART[:3, :3].T
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for pattern in filter(None, patterns):
        targets = read(tmp_path / "out" / pattern.format(name_program(language, "golden")))
        tips = np.array([place_tip(language, target) for target in targets])
        places = tips[:, :3, 3]
        assert measure_off(places, wanted).max() < WITHIN
        at = -1
        for place, axis in zip(wanted, axes, strict=True):  # every waypoint is reached, in order
            at += 1 + int(np.argmax(np.linalg.norm(places[at + 1 :] - place, axis=1) < WITHIN))
            assert np.linalg.norm(places[at] - place) < WITHIN
            assert np.degrees(np.arccos(np.clip(-tips[at, :3, 2] @ axis, -1.0, 1.0))) < 2e-3
        feeds = {round(target.feed, 1) for target in targets if target.kind != "joint" and target.feed}
        assert not feeds or max(feeds) == pytest.approx(12.5, abs=0.05)


def make_slot(language: str) -> Program:
    """A line, an arc and a line, as fitted moves; the tool turns by a third of a rad."""
    line = np.linspace(0.0, 30.0, 151)[:-1]
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 316)
    arc = circle(angle, 20.0) + np.array([30.0, 20.0, 0.0])
    place = np.vstack(
        [np.column_stack([line, 0.0 * line, 0.0 * line + 5.0]), arc, arc[-1] - np.outer(line[1:], [1, 0, 0])]
    )
    time = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1) / 10.0)]
    program, n = make_program(place, time, turn=1.0 / 3.0), len(place)
    words = {"shoulder": np.full(n, "front"), "elbow": np.full(n, "up"), "wrist": np.full(n, "flip")}
    native = {"shoulder": np.full(n, "T"), "elbow": np.full(n, "U"), "wrist": np.full(n, "F")}
    part = np.eye(4)
    part[:3, :3], part[:3, 3] = PART[:3, :3], [0.8, -0.3, 0.2]
    return replace(
        program, joint_names=("A1", "A2", "A3", "A4", "A5", "A6"), status=np.zeros(n, int), words=words, native=native,
        part=part, form="linear", post=Post(overwrite=language in ("fanuc_ls", "inform", "sinumerik")),
    )  # fmt: skip


@pytest.mark.parametrize("language", [name for name in READERS if name != "csv"])
def test_lines_and_arcs_of_every_language_are_the_path(language: str, tmp_path: Path) -> None:
    program = make_slot(language)
    assert program.tcp is not None
    write_program(program, language, tmp_path, any_brand=True)
    _, pattern, read = READERS[language]
    targets = read(tmp_path / pattern.format(name_program(language, "path")))
    path = 1e3 * program.tcp[:, :3, 3]
    arcs = [target for target in targets if target.kind == "arc"]
    assert bool(arcs) == (language != "inform") and len(targets) < 0.4 * len(path)
    last: np.ndarray | None = None
    drawn = []
    for target in targets:
        if target.kind == "joint" and target.tip is None:
            last = path[0]
            continue
        assert target.tip is not None
        end = target.tip[:3, 3]
        assert np.linalg.norm(path - end, axis=1).min() < WITHIN
        if target.kind == "joint":
            last = end
            continue
        assert last is not None and target.feed == pytest.approx(10.0, abs=0.06)
        drawn.append(draw(last, target.via, end))
        last = end
    off = measure_off(path, np.vstack(drawn))
    assert off.max() < 2e-3 + WITHIN  # the tolerance of the moves, and what is read


def draw(start: np.ndarray, via: np.ndarray | None, end: np.ndarray) -> np.ndarray:
    """Draw a move as points: the circle through three places solved as three linear equations for its centre."""
    if via is None:
        return np.array([start, end])
    normal = np.cross(via - start, end - start)
    rows = np.array([via - start, end - start, normal])
    centre = np.linalg.solve(rows, [(via @ via - start @ start) / 2, (end @ end - start @ start) / 2, normal @ start])
    x, y = start - centre, np.cross(normal / np.linalg.norm(normal), start - centre)
    sweep = np.arctan2((end - centre) @ y, (end - centre) @ x) % (2.0 * np.pi)
    turn = np.linspace(0.0, sweep, 400)[:, None]
    return np.asarray(centre + np.cos(turn) * x + np.sin(turn) * y)
