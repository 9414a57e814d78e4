"""Provenance on pages: sources of a robot model, and assumptions of a job."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from compplan.reporting.page import Provenance
from compplan.robot import Robot

if TYPE_CHECKING:
    from compplan.job.job import Job

GRADE_MEANING = {
    "identified": "measured on this robot",
    "literature": "from published data, not measured on your robot",
    "scaled": "estimated from similar robots, not measured on your robot",
    "placeholder": "springs and masses are invented or absent, do not rely on them",
}
#: Words that mark a source as not measured.
DOUBTFUL = ("assumed", "unverified", "placeholder", "estimated", "scaled", "from memory")


def explain_grade(robot: Robot) -> str:
    """Describe the source of a robot model: its measurements, otherwise the grade of its folder."""
    known = robot.uncertainty
    measured = known is not None and known.grade == "measured"
    return f"measured: {known.source}" if known is not None and measured else GRADE_MEANING[robot.grade]


def describe_robot(robot: Robot, facts: Sequence[tuple[str, str]] = (), assumptions: Sequence[str] = ()) -> Provenance:
    """Describe a robot for the foot of a page: further facts, grade, sources, and the assumed ones among them."""
    springs, blocks = robot.springs, robot.link_elasticities
    elastic = [f"{len(springs)} springs ({', '.join(spring.name for spring in springs)})"] if springs else []
    elastic += [f"6x6 elasticity of {', '.join(block.link for block in blocks)}"] if blocks else []
    rows = [*facts, ("robot", robot.name), ("robot model", explain_grade(robot))]
    rows += [(f"source of {name}", text) for name, text in robot.sources.items()]
    rows.append(("elastic model", "; ".join(elastic) or "rigid"))
    if robot.gravity is None:
        rows.append(("gravity", "not in the model: deflections are relative to the arm under its own weight"))
    if robot.effects:
        rows.append(("effects", ", ".join(sorted({str(effect.get("effect", "?")) for effect in robot.effects}))))
    doubts = [f"{name}: {text}" for name, text in robot.sources.items() if any(w in text.lower() for w in DOUBTFUL)]
    return Provenance(rows, [*doubts, *assumptions])


def list_assumptions(job: Job | None) -> list[str]:
    """List the assumptions of a job: sentences with "assumed" in the comments of the job file."""
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
