"""Execution of the chunks of a study: in this process, in processes on this machine, or on a Dask cluster.

On a cluster the pickled study is a separate task, so that the scheduler can repeat it if the worker that holds it is
lost; a chunk lost with its worker is computed again by another one.
"""

from __future__ import annotations

import os
import pickle
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from multiprocessing import active_children, forkserver, get_all_start_methods, get_context, parent_process
from multiprocessing.context import BaseContext
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING, Any

from compplan.errors import CompplanError, InputError
from compplan.io.process_settings import THREADS, keep_freed_memory

if TYPE_CHECKING:
    from compplan.robot import Array
    from compplan.studies.study import ChunkResult, Chunks, Study

#: Greatest number of worker processes on one machine.
MOST_WORKERS = 1024
#: Modules preloaded by the server from which workers are forked.
LOADED = [f"{__package__}.study"]
#: Address of a scheduler.
ADDRESS = re.compile(r"(tcp|tls|ws|wss)://(\[[0-9a-fA-F:]+\]|[\w.-]+):(?P<port>\d{1,5})/?")
#: Timeout of the connection to the scheduler. [s]
PATIENCE = 15
#: Submitted chunks per worker, and retries of a failed chunk.
AHEAD, RETRIES = 4, 3


@dataclass(frozen=True)
class Workers:
    """Processes or cluster that compute a study."""

    workers: int | None = None  #: Processes on this machine; None: one per core, 1: in this process.
    scheduler: str | None = None  #: Address of a Dask scheduler, in place of processes on this machine.
    pool: ProcessPoolExecutor | None = None  #: Started processes (`start_workers`), or None.

    def check(self) -> None:
        """Check number of workers and connection to the scheduler, before anything is computed or written.

        Raises:
            InputError: If there are more than `MOST_WORKERS` workers, or the scheduler does not answer.
        """
        if self.workers is not None and self.workers > MOST_WORKERS:
            raise InputError(f"--workers is {self.workers}, at most {MOST_WORKERS}")
        if self.scheduler is not None:
            check_scheduler(self.scheduler)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit numeric libraries of processes started in this context to one thread each."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def start_server() -> BaseContext:
    """Start the server from which workers are forked, once; it imports modules in the background."""
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(LOADED)
    with _one_thread():
        forkserver.ensure_running()
    return context


@contextmanager
def start_workers(workforce: Workers, chunks: int) -> Iterator[Workers]:
    """Start at most `chunks` processes on this machine; every study within the context uses them."""
    count = min(workforce.workers or os.cpu_count() or 1, chunks)
    if workforce.scheduler is not None or workforce.pool is not None or count <= 1:
        yield workforce
        return
    others = set(active_children())
    pool = ProcessPoolExecutor(count, start_server(), start_worker)
    try:
        with _one_thread():
            for _ in range(count):  # one process each
                pool.submit(os.getpid)
        yield replace(workforce, workers=count, pool=pool)
    finally:
        for worker in set(active_children()) - others:
            worker.kill()  # finished, or no longer needed
        pool.shutdown(wait=True, cancel_futures=True)


def compute_chunks(study: Study, numbers: list[int], points: Callable[[int], Array], workforce: Workers) -> Chunks:
    """Compute chunks by number; yield number and results of each finished chunk. points: returns those of a chunk.

    Raises:
        InputError: If a scheduler does not answer, or a worker process dies.
        ConvergenceError: If a sampled robot buckles under its load.
    """
    if workforce.scheduler is not None:
        yield from compute_on_cluster(study, numbers, points, workforce.scheduler)
        return
    from compplan.studies.study import evaluate_points

    with start_workers(workforce, len(numbers)) as started:
        if started.pool is None:
            yield from ((number, evaluate_points(study, points(number))) for number in numbers)
        else:
            yield from _compute_in_processes(study, numbers, points, started.pool, 2 * (started.workers or 1))


def _compute_in_processes(
    study: Study, numbers: list[int], points: Callable[[int], Array], pool: ProcessPoolExecutor, ahead: int
) -> Chunks:
    try:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "study"
            file.write_bytes(pickle.dumps(study))
            todo = iter(numbers)
            running = {pool.submit(_evaluate_packed, file, points(n)): n for n in islice(todo, ahead)}
            while running:
                ready, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in ready:
                    for number in islice(todo, 1):
                        running[pool.submit(_evaluate_packed, file, points(number))] = number
                    yield running.pop(future), future.result()
    except BrokenProcessPool:
        message = "a worker process died; run again to go on with what is left, with fewer --workers if memory ran out"
        raise InputError(message) from None


@lru_cache(maxsize=2)
def _unpack(packed: bytes | Path) -> Study:
    return pickle.loads(packed if isinstance(packed, bytes) else packed.read_bytes())


def _evaluate_packed(packed: bytes | Path, points: Array) -> ChunkResult:
    """Evaluate points of a pickled study, or of one in a file."""
    from compplan.studies.study import evaluate_points

    return evaluate_points(_unpack(packed), points)


def start_worker() -> None:
    """Prepare a worker process: it keeps freed memory, and ends when the process that started it ends."""
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted and ends its workers
    Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
    os._exit(1)


def compute_on_cluster(study: Study, numbers: list[int], points: Callable[[int], Array], scheduler: str) -> Chunks:
    """Compute chunks on the cluster of a scheduler ("tcp://127.0.0.1:8786"); yield each finished chunk.

    Raises:
        InputError: If the scheduler does not answer, Dask is not installed, or a worker has other versions.
    """
    client = _connect(scheduler)
    try:
        _check_versions(client)
        yield from _collect(client, study, numbers, points)
    finally:
        client.close()


def check_scheduler(scheduler: str) -> None:
    """Check the connection to a scheduler.

    Raises:
        InputError: If the address is invalid, or the scheduler does not answer.
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

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are reported in one line below
    try:
        return Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        message = f"no Dask scheduler answers at {scheduler}: {reason}; start one with `dask scheduler`"
        raise InputError(message) from None


def _check_versions(client: Any) -> None:
    """Compare the versions on which results depend with those of every connected worker."""
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
        # the study is sent once, as a separate task that another worker can repeat
        warnings.filterwarnings("ignore", message="Sending large graph")
        packed = client.submit(_hand_over, pickle.dumps(study), pure=False, retries=RETRIES)
    chunk_of: dict[str, int] = {}

    def submit(number: int) -> Any:
        future = client.submit(_evaluate_packed, packed, points(number), pure=False, retries=RETRIES)
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
            said = f"the cluster failed on a chunk of samples: {type(error).__name__}: {error}"
            raise InputError(f"{said}; see the logs of the workers, or compute here without --scheduler") from error
        yield chunk_of.pop(future.key), evaluated


def _hand_over(packed: bytes) -> bytes:
    return packed
