"""Secondary-encoder feedback: the axes are controlled by their link-side encoders, which removes gear deflection.

Deflection that the encoders do not measure remains: links, bearings, springs off the joint axis [Klimchik2018].
"""

from __future__ import annotations

from compplan.planning.task import Command, PlanTask

words = "secondary encoders"


def command_path(task: PlanTask) -> Command:
    """Command the nominal path, controlled by the link-side encoders."""
    return Command(task.q_start, feedback="link")
