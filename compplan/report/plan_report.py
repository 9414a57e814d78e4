"""From a plan to its page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from compplan.plan.slow import describe_causes, mark_slow
from compplan.posture.alternatives import compare_postures
from compplan.report.coupling_section import show_coupling
from compplan.report.page import Section
from compplan.report.plan_opening import open_plan
from compplan.report.plan_page import write_view
from compplan.report.plan_view import PlanView
from compplan.report.posture_section import list_uncertainties, show_posture
from compplan.report.promise_section import show_promise
from compplan.report.robot_scene import place_meshes
from compplan.report.style import format_length

if TYPE_CHECKING:
    from compplan.job.job import Job
    from compplan.plan.plan import Plan


def write_plan_report(plan: Plan, out: str | Path, *, extra: Sequence[Section] = ()) -> Path:
    """Write the page of a plan: report.html in a folder.

    Args:
        plan: The plan.
        out: The folder.
        extra: Further sections, such as the map of postures; they stand last.

    Returns:
        The file written.

    Raises:
        InputError: If the folder cannot be written.
    """
    file = Path(out) / "report.html"
    write_view(view_plan(plan, extra), file, open_plan(plan, Path(out)))
    return file


def view_plan(plan: Plan, extra: Sequence[Section] = ()) -> PlanView:
    """Collect what the page of a plan shows."""
    task, timing = plan.task, plan.timing
    cutting = task.compensated & ~task.nominal.rapid
    stance = task.start.stance if task.start is not None else None
    assumptions = list_assumptions(plan.job)
    if stance is not None:
        assumptions.append(list_uncertainties(stance))
    view = PlanView(
        title=plan.name,
        robot=plan.robot,
        strategy=plan.strategy,
        status=plan.status,
        nominal=task.position,
        rapid=~task.compensated,
        q=plan.q,
        time=timing.time,
        before=plan.before.deviation,
        after=plan.after.deviation,
        mismatch=plan.mismatch,
        promise=plan.promise,
        verdict=plan.verdict.sentence,
        correction=plan.correction,
        wrench=task.wrench,
        velocity=timing.velocity,
        acceleration=timing.acceleration,
        feed_wanted=np.where(cutting, task.nominal.feed, np.nan),
        feed=timing.feed,
        tolerance=task.tolerance,
        max_correction=task.max_correction,
        velocity_limits=task.velocity_limits,
        acceleration_limits=task.acceleration_limits,
        slowed=mark_slow(task, timing),
        slow_causes=describe_causes(task, timing),
        tilt_before=plan.before.tilt,
        tilt_after=plan.after.tilt,
        failures=plan.command.failures,
        breaches=plan.breaches,
        bending=_list_bending(plan),
        inertia=0.0 if plan.bending.compensated else float(np.nan_to_num(plan.bending.inertia)),
        between={
            "joints linear": float(plan.between.joint.max(initial=0.0)),
            "tip linear": float(plan.between.cartesian.max(initial=0.0)),
            "spline": float(plan.between.spline.max(initial=0.0)),
        },
        judge=plan.judge,
        facts=_list_facts(plan),
        uncoupled=None if plan.coupling is None else plan.coupling.without_size,
        notes=plan.notes,
        assumptions=assumptions,
    )
    sections = [] if plan.promise is None else [show_promise(plan.promise, view.stations, task.tolerance)]
    if plan.coupling is not None:
        sections.insert(0, show_coupling(plan.coupling))
    sections += list(extra)
    if stance is not None:
        posture = show_posture(stance, view.stations, plan.clearance, _weigh_postures(plan))
        sections.insert(len(sections) - len(extra), posture)
    scene = task.start.request.scene if task.start is not None and task.start.request is not None else None
    around = [] if scene is None else place_meshes(plan.robot, plan.q[view.start], scene.meshes)
    return replace(view, extra=sections, around=around)


def _weigh_postures(plan: Plan) -> tuple[dict[str, float], dict[str, float]] | None:
    """Measure the posture beside the plain one."""
    if plan.job is None or plan.task.start is None or plan.robot.nq < 6:
        return None
    return compare_postures(plan.robot, plan.task.chain, plan.task.start, plan.job.tool_x_base)


def _list_bending(plan: Plan) -> dict[str, str]:
    """Return what bends the arm, cause by cause, and how it rings."""
    bending, assumed = plan.bending, " (assumed masses)" if "assumed" in plan.bending.masses else ""
    rows = {}
    if plan.promise is not None:
        rows["true tip within, with 95\u00a0%"] = format_length(plan.promise.whole)
    rows |= {"bent by the process": format_length(bending.process), "bent by weight": format_length(bending.weight)}
    if np.isfinite(bending.inertia):
        word = "compensated" if bending.compensated else "not compensated"
        rows[f"bent by inertia, {word}{assumed}"] = format_length(bending.inertia)
    if np.isfinite(bending.frequencies).all():
        rows[f"lowest natural frequencies{assumed}"] = f"{', '.join(f'{f:.3g}' for f in bending.frequencies)}\u00a0Hz"
    if plan.clearance is not None:
        near = min(plan.clearance.least[1], plan.clearance.own, key=lambda contact: contact.distance)
        if np.isfinite(near.distance) and near.first:
            rows["least clearance"] = f"{format_length(near.distance)} ({near.first} to {near.second})"
    return rows


def list_assumptions(job: Job | None) -> list[str]:
    """List what a job assumes rather than knows: comments in the job file that say so."""
    if job is None or not job.file.is_file():
        return []
    blocks, open_block = [""], False
    for line in job.file.read_text(encoding="utf-8").splitlines():
        code, mark, comment = line.partition("#")
        if mark and not code.strip() and open_block:
            blocks[-1] += f" {comment.strip()}"
        elif mark:
            key = code.partition("=")[0].strip()
            blocks.append(f"{key}: {comment.strip()}" if key else comment.strip())
        open_block = bool(mark) and not code.strip()
    sentences = (sentence.strip() for block in blocks for sentence in re.split(r"(?<=\.)\s+(?=[A-Z])", block))
    return [f"job: {sentence}" for sentence in sentences if "assumed" in sentence.lower()]


def _list_facts(plan: Plan) -> list[tuple[str, str]]:
    facts = []
    if plan.job is not None and plan.job.file.is_file():
        facts.append(("job", str(plan.job.file)))
    facts.append(("toolpath", plan.task.nominal.source or "given in memory"))
    words = ", ".join(f"{name} {word}" for name, word in plan.task.configuration.items())
    if words:
        facts.append(("configuration", words))
    facts.append(("rotation about the tool axis", "free" if plan.task.spin_free else "fixed by the job"))
    facts.append(("time in the solver", f"{plan.command.solve_time:.3g} s"))
    return facts
