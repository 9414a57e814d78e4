"""Chunks of a study on disk: one numpy archive a chunk, so that an interrupted study goes on where it stopped.

A folder of chunks belongs to one study: `study.json` and every chunk hold the fingerprint of everything that the
numbers depend on. A folder with finished chunks of another study is refused.
"""

from __future__ import annotations

import hashlib
import json
import pickle
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from compplan.errors import InputError
from compplan.io.tables import write_text
from compplan.io.transaction import clear_parts, replace_file
from compplan.robot import Array
from compplan.studies.evaluation import ChunkResult
from compplan.studies.study import Study
from compplan.version import VERSION

_COLUMNS = {"rms": "rms_m", "mean": "mean_m", "max": "max_m", "within": "within_tolerance", "along": "along_m"}


def fingerprint_study(study: Study, settings: dict[str, Any]) -> str:
    """Return a fingerprint of everything that the numbers of a study depend on."""
    digest = hashlib.sha256()
    about = {"version": VERSION, "numpy": np.__version__, **settings}
    digest.update(json.dumps(about, sort_keys=True).encode())
    digest.update(study.noise.model_dump_json().encode())
    at = study.surroundings
    arrays: list[Array] = [study.nominal, at.wrench, at.shift, at.scale, study.task.chain.compliance]
    arrays += [at.link_share, 1e9 * at.posterior.root]
    for name, worker in study.workers.items():
        digest.update(name.encode())
        arrays += [worker.q, worker.spring_factor]
        arrays += [part for part in (worker.gain, worker.expected) if part is not None]
    for array in arrays:
        digest.update(np.round(array, 12).tobytes())
    digest.update(f"{study.task.tolerance:.9g}".encode())
    return digest.hexdigest()


class ChunkFolder:
    """Chunks of one study in a folder.

    Args:
        folder: The folder; made if needed.
        fingerprint: Fingerprint of the study.

    Raises:
        InputError: If the folder cannot be written, or holds finished chunks of another study.
    """

    def __init__(self, folder: Path, fingerprint: str) -> None:
        self.folder, self.fingerprint = folder, fingerprint
        others = sum(not self._is_ours(file) for file in folder.glob("chunk-*.npz"))
        if others:
            message = (
                f"holds {others} finished chunks of another study (another job, robot, seed, number of waypoints or "
                "version); name another folder, or take them away with --discard"
            )
            raise InputError(message, file=folder)
        clear_parts(folder)

    def _is_ours(self, file: Path) -> bool:
        """Tell whether a chunk is of this study; one that was cut off is nobody's."""
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
            np.savez_compressed(file, allow_pickle=False, **about, **figures)
        if _read_mark(self.folder / "study.json") != self.fingerprint:
            write_text(self.folder / "study.json", json.dumps({"schema": 1, "fingerprint": self.fingerprint}) + "\n")

    def read(self, chunk: int, strategies: tuple[str, ...]) -> ChunkResult | None:
        """Read a chunk back; None where there is none, or where it was cut off."""
        if not self.path(chunk).is_file():
            return None
        try:
            with np.load(self.path(chunk), allow_pickle=False) as table:
                if tuple(table["strategies"]) != strategies or str(table["fingerprint"]) != self.fingerprint:
                    return None
                return ChunkResult(**{name: table[column] for name, column in _COLUMNS.items()})
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None


def discard_chunks(folder: Path) -> None:
    """Take away the chunks in a folder and in those below it, whatever study they are of.

    Raises:
        InputError: If they cannot be taken away.
    """
    try:
        for file in (*folder.rglob("chunk-*.npz"), *folder.rglob("study.json")):
            file.unlink()
    except OSError as error:
        raise InputError(f"cannot be deleted: {error.strerror}", file=folder) from None


def _read_mark(file: Path) -> str | None:
    """Return the fingerprint in study.json; None where it is no mark."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["fingerprint"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def pack_study(study: Study) -> bytes:
    """Pack a study for a worker."""
    return pickle.dumps(study, protocol=pickle.HIGHEST_PROTOCOL)


def unpack_study(packed: bytes) -> Study:
    """Unpack a study that `pack_study` packed."""
    study: Study = pickle.loads(packed)
    return study
