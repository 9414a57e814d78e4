"""`compplan.plan` and `compplan.compare`: from a job, or a path and a robot, to a result."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison
    from compplan.planning.result import Plan
    from compplan.robot import Robot


def plan(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None, **tables: Any,
) -> Plan:  # fmt: skip
    """Plan a path: the posture, the corrected joint positions, their times, an independent check of them.

        plan = cp.plan("paths/isf_cone.toml")
        plan = cp.plan("part.nc", robot="kuka_kr240", part=(1800, 0, 700), process={"model": "milling", ...})
        plan = cp.plan({"position_mm": xyz, "feed_mm_s": 20.0}, robot="ur10", part=(600, 0, 200))
        print(plan); plan.plot(); plan.to_frame(); cp.write_plan(plan, "out")

    Args:
        job: A job: the TOML file, a `Job`, or its tables; or a path: a CAM file or CSV, a `Toolpath`, a DataFrame, or
            columns by name with units in the names.
        robot: Name of a shipped robot, a robot folder, or a `Robot`; it replaces the job's, a path needs one.
        out: Folder to write plan.json, joints.csv, programs and the page to; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.
        tables: Tables of the job, such as `plan={"tolerance_mm": 0.05}`; their keys replace those of the job.
            `part=(x, y, z)` or `(x, y, z, rx, ry, rz)` in mm and deg, `output="krl"` for a program.

    Returns:
        The plan. Its `status` is "infeasible" or "not_confirmed" where it is not what was asked for.

    Raises:
        InputError: If job, path or robot are not what they have to be, or the part is out of reach.
    """
    from compplan.api.given_job import make_job
    from compplan.job.operations import settle_job
    from compplan.planning.plan import plan_job
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    result = note_programs(plan_job(settle_job(make_job(job, robot, tables)), progress=progress))
    if out is not None:
        result, _ = deliver_plan(result, out)
    return result


def compare(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None, **tables: Any,
) -> Comparison:  # fmt: skip
    """Compare every strategy on a path: what each leaves on the robot as modelled, and on robots that may be yours.

        comparison = cp.compare("paths/circle_500mm.toml")
        print(comparison); comparison.plot(); comparison.to_frame()

    Args:
        job: As `compplan.plan` takes it.
        robot: As `compplan.plan` takes it.
        out: Folder to write compare.json and the page to; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.
        tables: Tables of the job; their keys replace those of the job.

    Returns:
        The comparison.

    Raises:
        InputError: If job, path or robot are not what they have to be, or the part is out of reach.
    """
    from compplan.api.given_job import make_job
    from compplan.job.operations import settle_job
    from compplan.reporting.compare import write_comparison
    from compplan.studies.job_study import compare_job

    result = compare_job(settle_job(make_job(job, robot, tables)), announce=progress)
    if out is not None:
        write_comparison(result, out)
    return result
