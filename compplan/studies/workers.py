"""Who computes the chunks of a study: this process, processes on this machine, or a Dask cluster."""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from multiprocessing import active_children, get_context
from threading import Thread
from time import sleep

from compplan.errors import InputError
from compplan.robot import Array
from compplan.studies.cluster import compute_on_cluster
from compplan.studies.evaluation import ChunkResult, Chunks, evaluate_points
from compplan.studies.storage import pack_study, unpack_study
from compplan.studies.study import Study

#: Greatest number of worker processes on one machine.
MOST_WORKERS = 1024
#: Threads of numeric libraries in a worker process.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """Who computes."""

    workers: int | None = None  #: Processes on this machine; None: one a core, 1: in this process.
    scheduler: str | None = None  #: Address of a Dask scheduler, in place of processes on this machine.

    def check(self) -> None:
        """Ask the scheduler whether it is there, before anything is computed or written.

        Raises:
            InputError: If there are more workers than a machine has, or the scheduler does not answer.
        """
        if self.workers is not None and self.workers > MOST_WORKERS:
            raise InputError(f"--workers is {self.workers}, at most {MOST_WORKERS}")
        if self.scheduler is not None:
            from compplan.studies.cluster import ask_scheduler

            ask_scheduler(self.scheduler)


def compute_chunks(study: Study, numbers: list[int], points: Callable[[int], Array], workforce: Workers) -> Chunks:
    """Compute chunks by number; give number and figures of each as it is done. `points` makes those of a chunk.

    Raises:
        InputError: If a scheduler does not answer, or a worker process dies.
        ConvergenceError: If a cell buckles under its load.
    """
    if workforce.scheduler is not None:
        return compute_on_cluster(study, numbers, points, workforce.scheduler)
    count = min(workforce.workers or os.cpu_count() or 1, len(numbers))
    if count <= 1:
        return _compute_here(study, numbers, points)
    return _compute_in_processes(study, numbers, points, count)


def _compute_here(study: Study, numbers: list[int], points: Callable[[int], Array]) -> Chunks:
    for number in numbers:
        yield number, evaluate_points(study, points(number))


def _compute_in_processes(study: Study, numbers: list[int], points: Callable[[int], Array], count: int) -> Chunks:
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    others = set(active_children())
    pool = ProcessPoolExecutor(count, get_context("spawn"), _start_worker, (pack_study(study), os.getpid()))
    try:
        todo = iter(numbers)
        running: dict[Future[ChunkResult], int] = {pool.submit(_work, points(n)): n for n in islice(todo, 2 * count)}
        while running:
            ready, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in ready:
                for number in islice(todo, 1):
                    running[pool.submit(_work, points(number))] = number
                yield running.pop(future), future.result()
    except BrokenProcessPool:
        message = "a worker process died; run again to go on with what is left, with fewer --workers if memory ran out"
        raise InputError(message) from None
    finally:
        for worker in set(active_children()) - others:
            worker.kill()  # finished, or working for nobody
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


_HELD: list[Study] = []


def _start_worker(packed: bytes, parent: int) -> None:
    die_with_parent(parent)
    _HELD[:] = [unpack_study(packed)]


def die_with_parent(parent: int) -> None:
    """Let this worker process end with the process of number `parent` that started it, whatever that one dies of.

    Linux sends SIGKILL when the parent is gone; elsewhere the worker looks for its parent every second.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted and ends its workers
    set_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
    try:
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
    except (AttributeError, OSError):
        Thread(target=_watch_parent, args=(parent,), daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def _watch_parent(parent: int) -> None:
    while os.getppid() == parent:
        sleep(1.0)
    os._exit(1)


def _work(points: Array) -> ChunkResult:
    return evaluate_points(_HELD[0], points)
