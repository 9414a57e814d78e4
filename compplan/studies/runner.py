"""Run a study in chunks, on the cores of one machine or on the workers of a Dask cluster.

A chunk is a fixed range of samples: results are identical to the last digit for any number of workers. Finished chunks
are written to disk; chunks that the folder already contains are not computed again.

A folder of chunks belongs to one study: every chunk stores a fingerprint of all inputs of the results. A folder with
finished chunks of another study is rejected.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from compplan.errors import InputError
from compplan.io.transaction import PART, replace_file
from compplan.robot import Array
from compplan.studies.sampling import draw_points
from compplan.studies.study import ChunkResult, Study
from compplan.studies.workers import Workers, compute_chunks
from compplan.version import VERSION

#: Samples of a chunk: they leave at least four chunks to each of 100 workers from 8,000 samples on; on one machine
#: small chunks cost about a quarter of the time.
CHUNK = 20
#: Number of samples whose distances along the path are kept.
MOST_ALONG = 2000
_COLUMNS = {"rms": "rms_m", "mean": "mean_m", "max": "max_m", "within": "within_tolerance", "along": "along_m"}


@dataclass(frozen=True)
class Settings:
    """Sampling of a study."""

    samples: int  #: Number of samples.
    seed: int  #: Seed of all random numbers.
    replicates: int = 8  #: Independent replicates of the Sobol sequence; their scatter gives the intervals.


@dataclass(frozen=True)
class Run:
    """Results of a study."""

    study: Study  #: The study.
    settings: Settings  #: Sampling.
    evaluated: ChunkResult  #: Figures of every sample, in order; `along` of the first MOST_ALONG.
    reused: int = 0  #: Number of chunks read from disk.


def run_study(
    study: Study,
    settings: Settings,
    *,
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Run a study; without a folder no chunk is kept, without a workforce all cores of this machine are used.

    `progress` is called with finished samples and total samples.

    Raises:
        InputError: If there are too few samples, the scheduler does not answer, or the folder cannot be written.
        ConvergenceError: If a sampled robot buckles under its load.
    """
    least = 2 * settings.replicates
    if settings.samples < least:
        message = f"{settings.samples} samples, expected at least {least}, two for each of the replicates"
        raise InputError(message)
    about: dict[str, object] = {"seed": settings.seed, "replicates": settings.replicates}
    evaluated, reused = evaluate_chunks(
        study, settings.samples, partial(draw_points, study.context.factors, settings.seed, settings.replicates),
        about=about, folder=folder, workforce=workforce, progress=progress,
    )  # fmt: skip
    return Run(study, settings, evaluated, reused)


def evaluate_chunks(
    study: Study,
    samples: int,
    points: Callable[[range], Array],
    *,
    about: dict[str, object],
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[ChunkResult, int]:
    """Evaluate samples in chunks, reusing those stored in a folder; return the results, and the number reused.

    points: returns the points of a range of samples; about: settings that identify the study; progress: called with
    finished and total samples.
    """
    chunks = [range(a, min(a + CHUNK, samples)) for a in range(0, samples, CHUNK)]
    store = None if folder is None else ChunkFolder(folder, fingerprint_study(study, {**about, "chunk": CHUNK}))
    done: dict[int, ChunkResult] = {}
    for number, rows in enumerate(chunks if store else []):
        found = store.read(number) if store else None
        if found is not None and len(found.rms) == len(rows):
            done[number] = _lighten(found, rows.start)
    reused, count = len(done), sum(len(chunks[n]) for n in done)
    tell = progress or (lambda done, total: None)
    tell(count, samples)
    missing = [number for number in range(len(chunks)) if number not in done]
    results = compute_chunks(study, missing, lambda number: points(chunks[number]), workforce or Workers())
    try:
        for number, evaluated in results if missing else ():
            done[number] = _lighten(evaluated, chunks[number].start)
            if store is not None:
                store.write(number, chunks[number].start, done[number], study.strategies)
            count += len(chunks[number])
            tell(count, samples)
    finally:
        results.close()
    return ChunkResult(*map(np.concatenate, zip(*(done[n] for n in range(len(chunks))), strict=True))), reused


def _lighten(evaluated: ChunkResult, start: int) -> ChunkResult:
    """Drop the distances along the path of late samples."""
    return evaluated._replace(along=evaluated.along[: max(0, MOST_ALONG - start)])


def fingerprint_study(study: Study, settings: dict[str, Any]) -> str:
    """Return a fingerprint of all inputs on which the results of a study depend."""
    digest = hashlib.sha256()
    about = {"version": VERSION, "numpy": np.__version__, **settings}
    digest.update(json.dumps(about, sort_keys=True).encode())
    digest.update(study.noise.model_dump_json().encode())
    at = study.context
    arrays: list[Array] = [study.nominal, at.wrench, at.shift, study.task.chain.compliance]
    arrays += [at.link_share, 1e9 * at.posterior.root, np.array([at.force.level, at.force.direction, at.force.path])]
    arrays += at.posterior.tie or ()
    for name, command in study.commands.items():
        digest.update(name.encode())
        arrays += [command.q, command.spring_factor]
        arrays += [part for part in (command.gain, command.expected) if part is not None]
    for array in arrays:
        digest.update(np.round(array, 12).tobytes())
    digest.update(f"{study.task.tolerance:.9g}".encode())
    return digest.hexdigest()


class ChunkFolder:
    """Chunks of one study, identified by its fingerprint, in a folder that is created if needed.

    Raises:
        InputError: If the folder cannot be written, or contains finished chunks of another study.
    """

    def __init__(self, folder: Path, fingerprint: str) -> None:
        self.folder, self.fingerprint = folder, fingerprint
        others = sum(not self._is_ours(file) for file in folder.glob("chunk-*.npz"))
        if others:
            message = (
                f"holds {others} finished chunks of another study (another job, robot, seed, number of waypoints or "
                "version); name another folder, or delete them with --discard"
            )
            raise InputError(message, file=folder)
        for part in folder.glob(f".*{PART}"):  # of a run that was killed
            part.unlink()

    def _is_ours(self, file: Path) -> bool:
        """Return whether a chunk belongs to this study; a truncated chunk counts as one of this study."""
        try:
            with np.load(file, allow_pickle=False) as table:
                return str(table["fingerprint"]) == self.fingerprint
        except KeyError:
            return False
        except (OSError, ValueError, EOFError, BadZipFile):
            return True

    def path(self, chunk: int) -> Path:
        """Return the file of a chunk."""
        return self.folder / f"chunk-{chunk:06d}.npz"

    def write(self, chunk: int, first: int, evaluated: ChunkResult, strategies: tuple[str, ...]) -> None:
        """Write a chunk: number of its first sample, names of the strategies, and the figures with their units."""
        figures = {column: getattr(evaluated, name) for name, column in _COLUMNS.items()}
        about: dict[str, Any] = {"first": first, "strategies": np.array(strategies), "fingerprint": self.fingerprint}
        with replace_file(self.path(chunk)) as part, part.open("wb") as file:
            np.savez(file, allow_pickle=False, **about, **figures)

    def read(self, chunk: int) -> ChunkResult | None:
        """Read a chunk; None if it is missing or truncated."""
        try:
            with np.load(self.path(chunk), allow_pickle=False) as table:
                return ChunkResult(**{name: table[column] for name, column in _COLUMNS.items()})
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None


def discard_chunks(folder: Path) -> None:
    """Delete all chunks in a folder and its subfolders, of any study.

    Raises:
        InputError: If they cannot be deleted.
    """
    try:
        for file in folder.rglob("chunk-*.npz"):
            file.unlink()
    except OSError as error:
        raise InputError(f"cannot be deleted: {error.strerror}", file=folder) from None
