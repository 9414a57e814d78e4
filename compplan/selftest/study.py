"""A study: draw cases, ask the diagnosis, keep every answer in a file of its own so that a study can be resumed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from compplan.cell.predict import predict_campaign
from compplan.diagnose import diagnose_campaign
from compplan.files.tables import write_text
from compplan.robot import Robot
from compplan.selftest.case import Case

#: Makes the case of a number; it must be a function of a module, so that other processes can call it.
Source = Callable[[int], Case]
#: Told how many cases are done, of how many.
Progress = Callable[[int, int], None]
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Settings:
    """Settings of a study.

    Attributes:
        campaigns: How many cases.
        seed: Number of the first case; the others count up.
        workers: Processes.
        withhold: Every so many of the cases with one effect are diagnosed again without it; 0 for none.
    """

    campaigns: int
    seed: int
    workers: int = 1
    withhold: int = 2

    @property
    def numbers(self) -> list[int]:
        """Numbers of the cases."""
        return list(range(self.seed, self.seed + self.campaigns))


def run_study(
    source: Source, settings: Settings, out: Path, progress: Progress = lambda done, total: None
) -> list[dict[str, Any]]:
    """Answer every case of a study; those that OUT/cases holds already are read.

    Args:
        source: Makes the case of a number.
        settings: Which cases, and how many processes.
        out: Folder of the study.
        progress: Told how far it is.

    Returns:
        One record a case, in the order of the numbers; cases that could not be drawn are left out.
    """
    folder = out / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    numbers = settings.numbers
    files = {number: folder / f"{number}.json" for number in numbers}
    missing = [number for number in numbers if not _holds(files[number])]
    done = len(numbers) - len(missing)
    progress(done, len(numbers))
    for number, record in _answer_all(source, missing, settings):
        write_text(files[number], json.dumps(record) + "\n")
        done += 1
        progress(done, len(numbers))
    records = [json.loads(files[number].read_text(encoding="utf-8")) for number in numbers]
    return [record for record in records if "truth" in record]


def _holds(file: Path) -> bool:
    """Tell whether a file holds a whole record."""
    try:
        return isinstance(json.loads(file.read_text(encoding="utf-8")), dict)
    except (OSError, json.JSONDecodeError):
        return False


def _answer_all(source: Source, numbers: Sequence[int], settings: Settings) -> Iterator[tuple[int, dict[str, Any]]]:
    if settings.workers <= 1 or len(numbers) <= 1:
        for number in numbers:
            yield number, answer_number(source, number, settings.withhold)
        return
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.update(dict.fromkeys(VARIABLES, "1"))
    try:
        with ProcessPoolExecutor(settings.workers, mp_context=get_context("spawn")) as pool:
            jobs = {pool.submit(answer_number, source, number, settings.withhold): number for number in numbers}
            for job in as_completed(jobs):
                yield jobs[job], job.result()
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value


def answer_number(source: Source, number: int, withhold: int) -> dict[str, Any]:
    """Draw a case and answer it.

    Args:
        source: Makes the case.
        number: Its number.
        withhold: Every so many single effects are withheld as well; 0 for none.
    """
    start = time.perf_counter()
    try:
        case = source(number)
    except LookupError as error:
        return {"number": number, "not_drawn": str(error)}
    drawing = time.perf_counter() - start
    return {"number": number, "drawing_seconds": drawing, **answer_case(case, withhold > 0 and number % withhold == 0)}


def answer_case(case: Case, withhold: bool = False) -> dict[str, Any]:
    """Diagnose a case without sight of its truth; with `withhold` once more without its effect among the candidates.

    Args:
        case: The case.
        withhold: Whether a single effect of the vocabulary is withheld in a second diagnosis.
    """
    record: dict[str, Any] = {"truth": case.truth, "answer": ask(case)}
    known = [effect["effect"] for effect in case.truth["effects"] if effect.get("in_vocabulary", True)]
    if withhold and len(known) == 1 and len(case.truth["effects"]) == 1:
        record["withheld"] = ask(case, without=known)
    return record


def ask(case: Case, without: Sequence[str] = ()) -> dict[str, Any]:
    """Return what the diagnosis says, and how far off a later campaign is with the nominal and the updated robot."""
    start = time.perf_counter()
    diagnosis = diagnose_campaign(case.robot, case.campaign, without=without)
    seconds = time.perf_counter() - start
    return {
        **diagnosis.to_table(),
        "seconds": seconds,
        "fresh_nominal": measure_distances(case.robot, case),
        "fresh_updated": measure_distances(diagnosis.updated, case),
    }


def measure_distances(robot: Robot, case: Case) -> list[float | None]:
    """Return the distance of every row of the later campaign from what a robot predicts. [mm]"""
    gap = np.linalg.norm(case.fresh.position - predict_campaign(robot, case.fresh).position, axis=1)
    return [round(1e3 * float(d), 5) if np.isfinite(d) else None for d in gap]
