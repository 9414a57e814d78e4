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
from compplan.studies.factors import draw_points
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
    """How a study is sampled."""

    samples: int  #: Number of samples.
    seed: int  #: Seed of everything.
    replicates: int = 8  #: Independent replicates of the Sobol sequence; their scatter gives the intervals.


@dataclass(frozen=True)
class Run:
    """A study that was run."""

    study: Study  #: The study.
    settings: Settings  #: How it was sampled.
    evaluated: ChunkResult  #: Figures of every sample, in their order; `along` of the first MOST_ALONG.
    reused: int = 0  #: Chunks that were found on disk.


def run_study(
    study: Study,
    settings: Settings,
    *,
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a study; without a folder no chunk is kept, without a workforce all cores of this machine compute.

    `progress` is called with samples done and samples wanted.

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
    about: dict[str, object] = {"seed": settings.seed, "replicates": settings.replicates, "chunk": size}

    def points(number: int) -> Array:
        return draw_points(study.surroundings.factors, settings.seed, settings.replicates, chunks[number])

    done, reused = evaluate_chunks(
        study, chunks, points, folder=folder, about=about, workforce=workforce, progress=progress
    )
    evaluated = (done[number] for number in range(len(chunks)))
    return Run(study, settings, ChunkResult(*map(np.concatenate, zip(*evaluated, strict=True))), reused)


def evaluate_chunks(
    study: Study,
    chunks: list[range],
    points: Callable[[int], Array],
    *,
    about: dict[str, object],
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[dict[int, ChunkResult], int]:
    """Evaluate chunks of points, using those that a folder holds; return them by number, and how many were found.

    Args:
        study: The study.
        chunks: Samples of each chunk.
        points: Makes the points of a chunk.
        about: What the points depend on, for telling studies apart.
        folder: Folder of the chunks, or None.
        workforce: Who computes.
        progress: Called with samples done and wanted.
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
    missing = [number for number in range(len(chunks)) if number not in done]
    if not missing:
        return done, reused
    results = compute_chunks(study, missing, points, workforce or Workers())
    try:
        for number, evaluated in results:
            if store is not None:
                store.write(number, chunks[number].start, evaluated, study.strategies)
            done[number] = _lighten(evaluated, chunks[number].start)
            tell()
    finally:
        results.close()
    return done, reused


def chunk_size(study: Study) -> int:
    """Return the number of samples of a chunk: by the size of the study alone."""
    poses = len(study.task) * max(len(study.strategies), 1)
    return int(np.clip(CHUNK_POSES // poses, LEAST_SAMPLES, MOST_SAMPLES))


def _lighten(evaluated: ChunkResult, start: int) -> ChunkResult:
    """Drop the distances along the path of late samples."""
    return evaluated._replace(along=evaluated.along[: max(0, MOST_ALONG - start)])
