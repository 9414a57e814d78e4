"""What a page says about where its numbers come from."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from compplan.reporting.page import Provenance
from compplan.robot import Robot

if TYPE_CHECKING:
    from compplan.job.job import Job

GRADE_MEANING = {
    "identified": "measured on this robot",
    "literature": "from published data, not measured on your robot",
    "scaled": "estimated from similar robots, not measured",
    "placeholder": "springs and masses are invented or absent, do not rely on them",
}
#: Words in a source that mean that nobody measured the number.
DOUBTFUL = ("assumed", "unverified", "placeholder", "estimated", "scaled", "from memory")


def explain_grade(robot: Robot) -> str:
    """Return where the numbers of a robot come from: its measurements, else the grade of its folder."""
    known = robot.uncertainty
    if known is not None and known.grade == "measured":
        return f"measured: {known.source}"
    return GRADE_MEANING[robot.grade]


def describe_grade(robot: Robot) -> str:
    """Say in a sentence how far the numbers of a robot can be trusted."""
    return f"Robot model: {explain_grade(robot)}."


def describe_robot(
    robot: Robot, facts: list[tuple[str, str]] | None = None, assumptions: list[str] | None = None
) -> Provenance:
    """Describe a robot for the foot of a page: grade, sources, which of them are assumed; further facts first."""
    rows = [*(facts or []), ("robot", robot.name), ("robot model", explain_grade(robot))]
    rows += [(f"source of {name}", text) for name, text in robot.sources.items()]
    rows.append(("elastic model", _elastic_model(robot)))
    if robot.gravity is None:
        rows.append(("gravity", "not in the model: deflection counts from the arm that hangs under its own weight"))
    if robot.effects:
        rows.append(("effects", ", ".join(sorted({str(effect.get("effect", "?")) for effect in robot.effects}))))
    return Provenance(rows, [*list_doubts(robot), *(assumptions or [])])


def list_doubts(robot: Robot) -> list[str]:
    """List the sources of a robot that say that a number was not measured."""
    return [f"{name}: {text}" for name, text in robot.sources.items() if any(word in text.lower() for word in DOUBTFUL)]


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


def _elastic_model(robot: Robot) -> str:
    if not robot.springs and not robot.link_elasticities:
        return "rigid"
    parts = []
    if robot.springs:
        parts.append(f"{len(robot.springs)} springs ({', '.join(spring.name for spring in robot.springs)})")
    if robot.link_elasticities:
        parts.append(f"6x6 elasticity of {', '.join(block.link for block in robot.link_elasticities)}")
    return "; ".join(parts)
