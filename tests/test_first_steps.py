"""What somebody meets who starts: commands that are fast, names that are nearly right, files of another kind."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compplan.job.job import Job, check_job
from compplan.plan.slow import list_causes, tell_causes

JOB = {"schema": 1, "robot": "ur10", "toolpath": "part.nc"}


def test_the_command_line_chooses_the_threads_before_numpy_is_imported() -> None:
    words = "import sys, compplan.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def test_chatter_is_judged_where_the_job_has_its_table_alone() -> None:
    assert not check_job(JOB).stability.judge
    assert check_job({**JOB, "stability": {}}).stability.judge
    assert not check_job({**JOB, "stability": {"judge": False}}).stability.judge
    assert Job.model_fields["stability"].default.damping == 0.03


class Rows(SimpleNamespace):
    """Stands for a task of 100 waypoints."""

    def __len__(self) -> int:
        return 100


def slow_run(follows: bool) -> tuple[Any, Any]:
    """A run of 100 waypoints in 10 s that rests at 30, is held by joint_2 at 60 and slow from 50 to 94."""
    rests = np.zeros(100, bool)
    rests[30] = True
    share = np.r_[np.ones(28), [0.5, 0.4, 0.1, 0.4, 0.5], np.ones(17), np.full(45, 0.9), np.ones(5)]
    limiting, rate = np.full(100, -1), np.full((100, 2), 0.3)
    limiting[60], share[60], rate[60, 1] = 1, 0.7, 1.0
    task = Rows(
        nominal=SimpleNamespace(rapid=np.zeros(100, bool)), lead=np.zeros(100, bool), rests=rests, smoothing=0.105,
        follows_feed=follows, inertia=False, robot=SimpleNamespace(joint_names=("joint_1", "joint_2")),
        velocity_limits=np.ones(2), acceleration_limits=np.ones(2),
    )  # fmt: skip
    timing = SimpleNamespace(
        time=np.linspace(0.0, 9.9, 100), share=share, lowered=share < 0.995, limiting=limiting,
        by_velocity=np.ones(100, bool), velocity=rate, acceleration=0.2 * rate,
    )  # fmt: skip
    return task, timing


@pytest.mark.parametrize(
    ("follows", "words"),
    [
        (True, "so that the joints can follow the corrections (velocity of"),
        (False, "to keep the run smooth around joint limits (velocity of"),
    ],
)
def test_a_slow_run_names_corners_the_limit_and_what_is_left(follows: bool, words: str) -> None:
    causes = {text: rows.tolist() for text, rows in list_causes(*slow_run(follows))}
    assert causes.pop("at corners, where the tool comes to rest") == [28, 29, 30, 31, 32]
    assert causes.pop("by the velocity limit of joint_2") == [59, 60, 61]
    (text, left), = causes.items()
    assert text.startswith(words) and "up to 30 % of its limit" in text and left == [*range(50, 59), *range(62, 95)]
    said = tell_causes(*slow_run(follows))
    assert said.startswith("The feed is lowered at 50 waypoints (28-32, 50-94): at corners")
    assert "down to 10 % at waypoint 30; by the velocity limit of joint_2, down to 70 % at waypoint 60; " in said
