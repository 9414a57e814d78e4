"""Chunks of a study on the workers of a Dask cluster.

The packed study travels as a task of its own, so that the scheduler can make it anew where a worker that held it is
lost; a chunk that was lost with its worker is computed again elsewhere.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import lru_cache
from itertools import islice
from typing import Any

from compplan.errors import CompplanError, InputError
from compplan.robot import Array
from compplan.studies.evaluation import ChunkResult, Chunks, evaluate_points
from compplan.studies.storage import pack_study, unpack_study
from compplan.studies.study import Study

#: An address of a scheduler.
ADDRESS = re.compile(r"(tcp|tls|ws|wss)://(\[[0-9a-fA-F:]+\]|[\w.-]+):(?P<port>\d{1,5})/?")
#: Time to wait for the scheduler. [s]
PATIENCE = 15
#: Chunks on their way per worker, and how often a failed chunk is tried again.
AHEAD, RETRIES = 4, 3


def compute_on_cluster(study: Study, numbers: list[int], points: Callable[[int], Array], scheduler: str) -> Chunks:
    """Compute chunks by number on the cluster of a scheduler ("tcp://127.0.0.1:8786"), as they come.

    Raises:
        InputError: If the scheduler does not answer, Dask is not installed, or a worker has other versions.
    """
    client = _connect(scheduler)
    try:
        _check_versions(client)
        yield from _collect(client, study, numbers, points)
    finally:
        client.close()


def ask_scheduler(scheduler: str) -> None:
    """Ask a scheduler whether it is there.

    Raises:
        InputError: If the address is none, or nobody answers.
    """
    match = ADDRESS.fullmatch(scheduler)
    if match is None or int(match["port"]) > 65535:
        raise InputError(f"--scheduler is {scheduler!r}, expected an address such as tcp://127.0.0.1:8786")
    _connect(scheduler).close()


def _connect(scheduler: str) -> Any:
    import logging

    try:
        from distributed import Client
    except ImportError:
        raise InputError('--scheduler needs Dask; install it with pip install "compplan[cluster]"') from None

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is said in one line below
    try:
        return Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        message = f"no Dask scheduler answers at {scheduler}: {reason}; start one with `dask scheduler`"
        raise InputError(message) from None


def _check_versions(client: Any) -> None:
    """Compare the versions that results depend on with those of every worker that is there."""
    here = _list_versions()
    for worker, there in client.run(_list_versions).items():
        other = [
            f"{name} {there.get(name)} (here {version})" for name, version in here.items() if there.get(name) != version
        ]
        if other:
            raise InputError(
                f"worker {worker} has {', '.join(other)}: results would depend on who computes them; "
                "give all workers the same environment"
            )


def _list_versions() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version
    from platform import python_version

    from compplan.version import VERSION

    found = {"compplan": VERSION, "Python": python_version()}
    for name in ("numpy", "pin", "casadi"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _collect(client: Any, study: Study, numbers: list[int], points: Callable[[int], Array]) -> Chunks:
    from distributed import as_completed

    with warnings.catch_warnings():
        # the study goes over once, as a task of its own that another worker can repeat
        warnings.filterwarnings("ignore", message="Sending large graph")
        packed = client.submit(_hand_over, pack_study(study), pure=False, retries=RETRIES)
    chunk_of: dict[str, int] = {}

    def submit(number: int) -> Any:
        future = client.submit(_work, packed, points(number), pure=False, retries=RETRIES)
        chunk_of[future.key] = number
        return future

    todo = iter(numbers)
    ahead = AHEAD * max(2, len(client.nthreads()))
    pending = as_completed([submit(number) for number in islice(todo, ahead)], loop=client.loop)
    for future in pending:
        for number in islice(todo, 1):
            pending.add(submit(number))
        try:
            evaluated = future.result()
        except CompplanError:
            raise
        except Exception as error:
            raise InputError(f"the cluster gave up a chunk: {type(error).__name__}: {error}") from error
        yield chunk_of.pop(future.key), evaluated


def _hand_over(packed: bytes) -> bytes:
    return packed


@lru_cache(maxsize=2)
def _unpack(packed: bytes) -> Study:
    return unpack_study(packed)


def _work(packed: bytes, points: Array) -> ChunkResult:
    return evaluate_points(_unpack(packed), points)
