"""Ask a diagnosis about a labelled campaign, the truth kept from it: the product as a black box, or the plain rival.

A case is a folder with robot/, measurements.csv, fresh.csv and truth.json. An answer holds what diagnosis.json holds,
and the distance of every row of the later campaign from what the nominal and the updated robot predict (mm).
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: A diagnosis that takes longer is stopped, and counts as no answer. [s]
PATIENCE = 1800
#: FIGAROH gets rows at rest alone, and every so manieth where there are more than twice as many (it loops over them).
FIGAROH_ROWS = 200
#: Runs the product's own command line several times in one process; the arguments are a JSON list of lists.
DRIVER = """
import json, sys, time
from compplan.cli import main
for words in json.loads(sys.argv[1]):
    start = time.process_time()
    sys.argv = ["compplan", *words]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    print(json.dumps({"words": words[0], "seconds": time.process_time() - start}))
"""

Table = dict[str, Any]


def read_truth(case: Path) -> Table:
    """Read truth.json; NaN becomes None."""
    return json.loads((case / "truth.json").read_text(encoding="utf-8"), parse_constant=lambda _: None)  # type: ignore[no-any-return]


def frames_of(truth: Table) -> list[str]:
    """Return what has to be registered: base and tool where the truth says that the frames are unknown."""
    return ["base", "tool"] if truth.get("register") else []


def ask_product(case: Path, tree: Path, register: list[str]) -> Table:
    """Run diagnose and predict of a source tree on a case.

    Args:
        case: Folder of the case.
        tree: Folder that holds the package compplan.
        register: Frames to register.

    Returns:
        The answer; one that gave up holds an empty verdict "refused" and what was said in `error`.
    """
    flags = ["--register", ",".join(register)] if register else []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        log, fresh = str(case / "measurements.csv"), str(case / "fresh.csv")
        words = [
            ["diagnose", log, "--robot", str(case / "robot"), "--out", str(out / "d"), *flags],
            ["predict", fresh, "--robot", str(out / "d" / "robot"), "--out", str(out / "updated.csv"), *flags],
            ["predict", fresh, "--robot", str(case / "robot"), "--out", str(out / "nominal.csv"), *flags],
        ]
        environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                [sys.executable, "-c", DRIVER, json.dumps(words)],
                capture_output=True, text=True, env=environment, timeout=PATIENCE, cwd=folder, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return refused(f"stopped after {PATIENCE} s")
        if done.returncode:
            return refused(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"status {done.returncode}")
        answer = json.loads((out / "d" / "diagnosis.json").read_text(encoding="utf-8"))
        seconds = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"words"')]
        measured = read_points(case / "fresh.csv")
        return {
            **{key: answer[key] for key in ("verdict", "gap")},
            "candidates": answer.get("candidates", [])[:10],
            "seconds": next((s["seconds"] for s in seconds if s["words"] == "diagnose"), None),
            "fresh_updated": distances(measured, read_points(out / "updated.csv")),
            "fresh_nominal": distances(measured, read_points(out / "nominal.csv")),
        }


def refused(why: str) -> Table:
    """Return the answer of a diagnosis that gave none."""
    return {"verdict": {"status": "refused", "effects": []}, "gap": {}, "candidates": [], "error": why}


def ask_rival(case: Path, register: list[str]) -> Table:
    """Ask the plain rival."""
    from benchmarks.rival.answer import diagnose

    start = time.process_time()
    answer = diagnose(case / "robot", case / "measurements.csv", register)
    told = {key: answer.table[key] for key in ("verdict", "gap", "candidates")}
    return _predict_fresh(case, answer, {**told, "seconds": time.process_time() - start})


def ask_calibration(case: Path, register: list[str]) -> Table:
    """Ask a plain calibration of geometry and compliances, which names nothing: how far a plain fit predicts."""
    from benchmarks.rival.calibration import calibrate

    start = time.process_time()
    done = calibrate(case / "robot", case / "measurements.csv", register)
    return _predict_fresh(case, done, {**done.table, "seconds": time.process_time() - start})


def _predict_fresh(case: Path, done: Any, told: Table) -> Table:
    """Add how far the later campaign is from what a plain model predicts."""
    from benchmarks.rival.log import read_log

    log = read_log(case / "fresh.csv", done.chain)
    return {
        **told,
        "fresh_updated": distances(1e3 * log.position, 1e3 * done.predict(log)),
        "fresh_nominal": distances(1e3 * log.position, 1e3 * done.predict(log, nominal=True)),
    }


def miss_figaroh(python: Path | None) -> str:
    """Say why FIGAROH cannot be asked under an interpreter; "" where it can.

    Args:
        python: The interpreter, or None where none was given.
    """
    if python is None:
        return 'no --figaroh-python was given: an interpreter with pip install "compplan[peers]"'
    done = subprocess.run([str(python), "-c", "import figaroh"], capture_output=True, text=True, check=False)
    return f"{python}: {(done.stderr.strip().splitlines() or ['no answer'])[-1]}" if done.returncode else ""


def ask_figaroh(case: Path, python: Path, register: list[str]) -> Table:
    """Ask FIGAROH's geometric calibration, which runs under an interpreter that has it.

    Args:
        case: Folder of the case.
        python: The interpreter.
        register: Frames to register.
    """
    from benchmarks.rival.chain import read_chain

    chain = read_chain(case / "robot")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "robot.urdf").write_text(
            (case / "robot" / "robot.urdf").read_text(encoding="utf-8"), encoding="utf-8"
        )
        rows = {part: _unbent(case / f"{part}.csv", chain, register) for part in ("measurements", "fresh")}
        for part, file in (("measurements", "given"), ("fresh", "fresh")):
            header, table, known, few, _ = rows[part]
            known = known if part == "fresh" else few
            lines = [",".join(header), *(",".join(map(repr, row)) for row in table[known].tolist())]
            (folder / f"{file}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        words = [str(python), str(Path(__file__).parent / "figaroh_peer.py"), name, chain.tcp]
        words += ["--register"] if register else []
        done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE, check=False, cwd=name)
        if done.returncode:
            return refused((done.stderr.strip().splitlines() or ["no answer"])[-1])
        answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    known = rows["fresh"][2]
    fresh: list[float | None] = [None] * len(known)
    for k, distance in zip(np.flatnonzero(known), answer["fresh"], strict=True):
        fresh[int(k)] = distance
    return {
        "verdict": {"status": "calibrated", "effects": []},
        "gap": {"after_rms_mm": answer["after_rms_mm"]},
        "candidates": [],
        "seconds": answer["seconds"],
        "fresh_updated": fresh,
        "fresh_nominal": rows["fresh"][4],
    }


def _unbent(file: Path, chain: Any, register: list[str]) -> tuple[list[str], Any, Any, Any, list[float | None]]:
    """Return joints and unbent positions of a log (header, rows), which are known, which it is given, nominal gaps."""
    from benchmarks.rival.chain import load_chain
    from benchmarks.rival.greedy import fit_frames
    from benchmarks.rival.log import read_log

    log = read_log(file, chain)
    gravity = chain.gravity if chain.has_gravity else np.zeros(3)
    bent, rigid = (load_chain(chain, log.q, w, g) for w, g in ((log.wrench, gravity), (0 * log.wrench, 0 * gravity)))
    frames = fit_frames(log, bent.tip, bent.attitude, tuple(register))
    position = log.position - (bent.tip - rigid.tip) @ frames.turn.T
    moving = [s for s in chain.segments if s.kind != "fixed"]
    joints = np.stack([s.gain * log.q[:, s.reading] + s.zero for s in moving], axis=1)
    still = np.flatnonzero(log.known & ~log.moving)
    few = np.zeros(len(position), bool)
    few[still[:: max(1, len(still) // FIGAROH_ROWS)]] = True
    target = bent.tip + np.einsum("nij,nj->ni", bent.attitude, frames.of_targets(log))
    gap = distances(1e3 * log.position, 1e3 * (target @ frames.turn.T + frames.shift))
    return [*(s.name for s in moving), "x1", "y1", "z1"], np.hstack([joints, position]), log.known, few, gap


def read_points(file: Path) -> NDArray[np.float64]:
    """Read the positions of a log or of a prediction. Shape (n, 3). [mm]"""
    with file.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    unit, factor = ("mm", 1.0) if "x_mm" in rows[0] else ("m", 1e3)
    cells = [[row[f"{axis}_{unit}"] for axis in "xyz"] for row in rows]
    return factor * np.array([[float(c) if c else np.nan for c in row] for row in cells])


def distances(measured: NDArray[np.float64], predicted: NDArray[np.float64]) -> list[float | None]:
    """Return the distance of every row, None where one of the two is missing. [mm]"""
    gap = np.linalg.norm(measured - predicted, axis=1)
    return [round(float(d), 5) if np.isfinite(d) else None for d in gap]


def write_whole(file: Path, text: str) -> None:
    """Write a file all or nothing."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(f".{os.getpid()}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(file)
