"""Chunks of a study on disk: one numpy archive a chunk, so that an interrupted study goes on where it stopped.

A folder of chunks belongs to one study: `study.json` in it holds the fingerprint of everything that the numbers depend
on. A folder with another fingerprint is emptied of its chunks first.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.robot import Array
from compplan.study.judging import Judged
from compplan.study.study import Study
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
        InputError: If the folder cannot be written.

    """

    def __init__(self, folder: Path, fingerprint: str) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            mark = folder / "study.json"
            if not mark.is_file() or json.loads(mark.read_text()).get("fingerprint") != fingerprint:
                for old in folder.glob("chunk-*.npz"):
                    old.unlink()
                write_text(mark, json.dumps({"schema": 1, "fingerprint": fingerprint}) + "\n")
        except (OSError, json.JSONDecodeError) as error:
            raise InputError(f"cannot be used for the chunks of a study: {error}", file=folder) from None

    def path(self, chunk: int) -> Path:
        """Return the file of a chunk."""
        return self.folder / f"chunk-{chunk:06d}.npz"

    def write(self, chunk: int, first: int, judged: Judged, strategies: tuple[str, ...]) -> None:
        """Write a chunk: number of its first sample, names of the strategies, and the figures with their units."""
        figures = {column: getattr(judged, name) for name, column in _COLUMNS.items()}
        part = self.folder / f".chunk-{chunk:06d}.{os.getpid()}"
        with part.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, first=first, strategies=np.array(strategies), **figures)
        part.replace(self.path(chunk))

    def read(self, chunk: int, strategies: tuple[str, ...]) -> Judged | None:
        """Read a chunk back; None where there is none, or where it was cut off."""
        if not self.path(chunk).is_file():
            return None
        try:
            with np.load(self.path(chunk), allow_pickle=False) as table:
                if tuple(table["strategies"]) != strategies:
                    return None
                return Judged(**{name: table[column] for name, column in _COLUMNS.items()})
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None


def pack_study(study: Study) -> bytes:
    """Pack a study for a worker."""
    return pickle.dumps(study, protocol=pickle.HIGHEST_PROTOCOL)


def unpack_study(packed: bytes) -> Study:
    """Unpack a study that `pack_study` packed."""
    study: Study = pickle.loads(packed)
    return study
