"""A robot that is known to lose motion: what its effects add at the waypoints is no reason to divide the path."""

from pathlib import Path

import numpy as np
import pytest

from compplan.job.job import load_job
from compplan.plan.between import measure_between
from compplan.plan.plan import plan_job
from compplan.plan.task import attain_rows

#: Ten waypoints; joint 1 of its robot has a backlash of 0.4 mrad, which is 0.3 mm at the tip.
JOB = Path(__file__).parent / "bad_inputs" / "good" / "job.toml"


@pytest.fixture(scope="module")
def plan():
    return plan_job(load_job(JOB))


def test_a_path_is_not_divided_for_what_no_division_mends(plan):
    assert plan.status == "solved" and len(plan.task) < 100


def test_between_waypoints_the_tip_is_as_far_off_as_at_them(plan):
    task, q = plan.task, plan.task.q_start
    cut = ~task.nominal.rapid & ~task.lead
    off = attain_rows(task, q, np.arange(len(task)), slope=False).position - task.position
    at = np.linalg.norm(off, axis=1)[cut].max()
    assert at > 2e-4  # the lost motion stands uncorrected in the start
    assert measure_between(task, q).joint.max() == pytest.approx(at, rel=0.05)
    assert measure_between(task, plan.command.q).joint.max() < 0.01 * at
