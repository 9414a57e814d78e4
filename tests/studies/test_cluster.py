"""A Dask cluster of separate processes on this machine; one of its workers is killed on the way."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from montecarlo_cases import small_study

from compplan.errors import InputError
from compplan.studies.runner import Settings, run_study
from compplan.studies.workers import Workers, check_scheduler, compute_on_cluster

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}


class Cluster:
    """A scheduler and workers as processes of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.log = folder / "scheduler.log"
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", log=self.log)
        self.address = self._wait_for(r"(tcp://127\.0\.0\.1:\d+)")

    def start(self, kind: str, *arguments: str, log: Path) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", kind, *arguments]
        with log.open("wb") as out:
            process = subprocess.Popen(command, stdout=out, stderr=out, env=ENVIRONMENT, cwd=self.folder)
        self.processes.append(process)
        return process

    def add_worker(self, name: str) -> subprocess.Popen[bytes]:
        options = [self.address, "--nworkers", "1", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", name,
                   "--local-directory", str(self.folder), "--memory-limit", "0"]  # fmt: skip
        return self.start("worker", *options, log=self.folder / f"{name}.log")

    def _wait_for(self, pattern: str) -> str:
        for _ in range(300):
            found = re.search(pattern, self.log.read_text()) if self.log.is_file() else None
            if found:
                return found.group(1)
            time.sleep(0.1)
        raise TimeoutError(self.log.read_text())

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.fixture()
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    try:
        yield cluster
    finally:
        cluster.stop()


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_gives_the_same_numbers(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from compplan.studies import runner

    monkeypatch.setattr(runner, "CHUNK", 40)
    settings = Settings(samples=800, seed=5)
    victim = cluster.add_worker("victim")
    killed: list[int] = []

    def watch(done: int, wanted: int) -> None:
        if done >= 80 and not killed:
            killed.append(done)
            cluster.add_worker("heir")
            victim.send_signal(signal.SIGKILL)

    there = Workers(scheduler=cluster.address)
    run = run_study(small_study(), settings, folder=tmp_path / "samples", workforce=there, progress=watch)
    here = run_study(small_study(), settings, workforce=Workers(workers=1))
    assert killed and victim.wait(10) == -signal.SIGKILL
    for a, b in zip(run.evaluated, here.evaluated, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(list((tmp_path / "samples").glob("chunk-*.npz"))) == 20


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("compplan.studies.workers.PATIENCE", 1)
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run_study(small_study(), Settings(samples=16, seed=1), workforce=Workers(scheduler="tcp://127.0.0.1:9"))


def test_a_scheduler_without_dask_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "compplan\[cluster\]"'):
        check_scheduler("tcp://127.0.0.1:8786")


def test_a_worker_with_other_versions_is_named_before_anything_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    class OldWorker:
        def run(self, ask: Callable[[], dict[str, str]]) -> dict[str, dict[str, str]]:
            return {"tcp://10.0.0.7:4000": {**ask(), "numpy": "1.0"}}

        def close(self) -> None:
            pass

    monkeypatch.setattr("compplan.studies.workers._connect", lambda scheduler: OldWorker())
    with pytest.raises(InputError, match=r"worker tcp://10.0.0.7:4000 has numpy 1.0 \(here .*same environment"):
        next(compute_on_cluster(small_study(), [0], lambda number: np.zeros((1, 1)), "tcp://127.0.0.1:1"))
