"""Compare path, feed and wrench of a plan with what its job means, worked out without the package's readers."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import compplan as cp
from tests.oracles.forces import DrivenRows, read_forces

#: Largest difference of a wrench from the independent one, as a share of the greatest.
WRENCH = 1e-3


def check_plan(plan: cp.Plan, vertices_mm: list[list[float]], feed_mm_s: float) -> tuple[str, ...]:
    """Say where a plan differs from its job: points that the cut passes, from first to last, and its feed."""
    job, task = plan.job, plan.task
    assert job is not None
    tables, found = job.model_dump(by_alias=True, exclude_unset=True), list[str]()
    part = tables["part"]
    turn = Rotation.from_rotvec(part.get("rotation_deg", [0.0, 0.0, 0.0]), degrees=True)
    wanted = 1e-3 * (turn.apply(vertices_mm) + np.array(part["position_mm"]))
    way = task.programmed[task.cut]
    away = np.linalg.norm(way[:, None] - wanted, axis=2).min(axis=0)
    if away.max() > 1e-6 or np.linalg.norm(way[-1] - wanted[-1]) > 1e-6:
        found.append(f"the path passes a point of the part at {1e3 * away.max():.3g} mm")
    if abs(1e3 * float(np.median(task.nominal.feed[task.cut])) - feed_mm_s) > 1e-6:
        found.append("the feed is another")
    rows = DrivenRows(task.programmed, task.nominal.axis, task.nominal.rapid, task.lead, plan.timing.time)
    wrench = read_forces(tables, job.folder, rows)
    if wrench is not None:
        off = np.abs(wrench - task.wrench)[task.cut]
        if off.max(initial=0.0) > WRENCH * max(1.0, float(np.abs(wrench).max())):
            found.append(f"the wrench differs by {off.max():.3g} N or N m")
    return tuple(found)
