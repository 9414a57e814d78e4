"""Compare a plan with what independent readers make of its job: the path, its feed, and the wrench on the tool."""

from __future__ import annotations

import numpy as np

import compplan as cp
from tests.oracles.forces import DrivenRows, read_forces
from tests.oracles.wanted import check_required_path

#: Largest difference of a wrench from the independent one, as a share of the greatest.
WRENCH = 1e-3


def check_plan(plan: cp.Plan) -> tuple[str, ...]:
    """Say where path, feed or wrench of a plan differ from an independent reading of its job."""
    job, task = plan.job, plan.task
    assert job is not None
    tables = job.model_dump(by_alias=True, exclude_unset=True)
    rows = DrivenRows(task.programmed, task.nominal.axis, task.nominal.rapid, task.lead, plan.timing.time)
    found = list(check_required_path(tables, job.folder, rows, task.nominal.feed).breaches)
    wrench = read_forces(tables, job.folder, rows)
    if wrench is not None:
        off = np.abs(wrench - task.wrench)[task.cut]
        if off.max(initial=0.0) > WRENCH * max(1.0, float(np.abs(wrench).max())):
            found.append(f"the wrench differs by {off.max():.3g} N or N m")
    return tuple(found)
