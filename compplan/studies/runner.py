"""Run a study: chunk after chunk, on the cores of one machine or on the workers of a Dask cluster.

A chunk is a fixed range of samples, whatever computes it: the numbers are the same to the last digit with any number of
workers. Chunks are written as they come; those that a folder holds already are not computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.robot import Array
from compplan.studies.evaluation import ChunkResult
from compplan.studies.factors import Sequence, draw_points
from compplan.studies.statistics import estimate_mean
from compplan.studies.storage import ChunkFolder, fingerprint_study
from compplan.studies.study import Study
from compplan.studies.workers import Workers, compute_chunks

#: Poses a chunk comes to, about; and the bounds of its number of samples. At most 20 leave four chunks and more to each
#: of 100 workers from 8,000 samples on; on one machine small chunks cost about a quarter of the time.
CHUNK_POSES, LEAST_SAMPLES, MOST_SAMPLES = 600_000, 8, 20
#: Samples whose distances along the path are kept.
MOST_ALONG = 2000


@dataclass(frozen=True)
class Settings:
    """How a study is sampled.

    Attributes:
        samples: Greatest number of samples.
        seed: Seed of everything.
        replicates: Independent replicates of the sequence; their scatter gives the intervals.
        sequence: "sobol" or "latin_hypercube".
        stop_below: Stop when the interval of every strategy's mean rms is narrower than this on either side. [m]

    """

    samples: int
    seed: int
    replicates: int = 8
    sequence: Sequence = "sobol"
    stop_below: float | None = None


@dataclass(frozen=True)
class Run:
    """A study that was run.

    Attributes:
        study: The study.
        settings: How it was sampled.
        evaluated: Figures of every sample, in their order; `along` of the first MOST_ALONG.
        reused: Chunks that were found on disk.
        stopped: Whether it stopped because its intervals were narrow enough.

    """

    study: Study
    settings: Settings
    evaluated: ChunkResult
    reused: int = 0
    stopped: bool = False


def run_study(
    study: Study,
    settings: Settings,
    *,
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a study.

    Args:
        study: The study.
        settings: How it is sampled.
        folder: Folder for the chunks; nothing is kept if left out.
        workforce: Who computes; all cores of this machine if left out.
        progress: Called with samples done and samples wanted.

    Raises:
        InputError: If there are too few samples, the scheduler does not answer, or the folder cannot be written.
        ConvergenceError: If a cell buckles under its load.

    """
    least = 2 * settings.replicates
    if settings.samples < least:
        message = f"{settings.samples} samples, expected at least {least}, two for each of the replicates"
        raise InputError(message)
    size = chunk_size(study)
    chunks = [range(a, min(a + size, settings.samples)) for a in range(0, settings.samples, size)]
    # A Sobol study may be prolonged; a Latin hypercube is made for its number of samples.
    about: dict[str, object] = {
        "seed": settings.seed, "replicates": settings.replicates, "sequence": settings.sequence, "chunk": size,
    }  # fmt: skip
    if settings.sequence != "sobol":
        about["samples"] = settings.samples

    def points(number: int) -> Array:
        return draw_points(
            study.surroundings.factors, settings.seed, settings.replicates, chunks[number],
            sequence=settings.sequence, total=settings.samples,
        )  # fmt: skip

    def enough(done: dict[int, ChunkResult]) -> int | None:
        return _find_end(study, settings, done)

    done, reused, end = evaluate_chunks(
        study, chunks, points, folder=folder, about=about, workforce=workforce, progress=progress, enough=enough
    )
    return Run(study, settings, _join(done, end or len(chunks)), reused, end is not None)


def evaluate_chunks(
    study: Study,
    chunks: list[range],
    points: Callable[[int], Array],
    *,
    about: dict[str, object],
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
    enough: Callable[[dict[int, ChunkResult]], int | None] | None = None,
) -> tuple[dict[int, ChunkResult], int, int | None]:
    """Judge chunks of points, using those that a folder holds.

    Args:
        study: The study.
        chunks: Samples of each chunk.
        points: Makes the points of a chunk.
        about: What the points depend on, for telling studies apart.
        folder: Folder of the chunks, or None.
        workforce: Who computes.
        progress: Called with samples done and wanted.
        enough: Tells after how many chunks the study may end, or None.

    Returns:
        The chunks by number, how many of them were found on disk, and after how many the study ends (None: all).

    """
    store = None if folder is None else ChunkFolder(folder, fingerprint_study(study, about))
    done: dict[int, ChunkResult] = {}
    for number, rows in enumerate(chunks if store else []):
        found = store.read(number, study.strategies) if store else None
        if found is not None and len(found.rms) == len(rows):
            done[number] = _lighten(found, rows.start)
    reused, total = len(done), chunks[-1].stop

    def tell() -> None:
        if progress:
            progress(sum(len(chunks[n]) for n in done), total)

    tell()
    end = enough(done) if enough else None
    missing = [number for number in range(len(chunks)) if number not in done]
    if end is not None or not missing:
        return done, reused, end
    results = compute_chunks(study, missing, points, workforce or Workers())
    try:
        for number, evaluated in results:
            if store is not None:
                store.write(number, chunks[number].start, evaluated, study.strategies)
            done[number] = _lighten(evaluated, chunks[number].start)
            tell()
            end = enough(done) if enough else None
            if end is not None:
                break
    finally:
        results.close()
    return done, reused, end


def chunk_size(study: Study) -> int:
    """Return the number of samples of a chunk: by the size of the study alone."""
    poses = len(study.task) * max(len(study.strategies), 1)
    return int(np.clip(CHUNK_POSES // poses, LEAST_SAMPLES, MOST_SAMPLES))


def _join(done: dict[int, ChunkResult], count: int) -> ChunkResult:
    return ChunkResult(*(np.concatenate(parts) for parts in zip(*(done[n] for n in range(count)), strict=True)))


def _lighten(evaluated: ChunkResult, start: int) -> ChunkResult:
    """Drop the distances along the path of late samples."""
    return evaluated._replace(along=evaluated.along[: max(0, MOST_ALONG - start)])


def _find_end(study: Study, settings: Settings, done: dict[int, ChunkResult]) -> int | None:
    """Find the first chunk, in their order, after which all intervals are narrow enough."""
    if settings.stop_below is None:
        return None
    known = next(n for n in range(len(done) + 1) if n not in done)
    for count in range(1, known + 1):
        rms = np.concatenate([done[n].rms for n in range(count)])
        if len(rms) < 4 * settings.replicates:
            continue
        widths = [estimate_mean(rms[:, k], settings.replicates).half_width for k in range(len(study.strategies))]
        if max(widths) < settings.stop_below:
            return count
    return None
