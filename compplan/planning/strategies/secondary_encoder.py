"""Secondary-encoder feedback: the axes are controlled by their link-side encoders, which removes gear deflection.

Deflection that the encoders do not measure remains: links, bearings, springs off the joint axis [Klimchik2018].
"""

from __future__ import annotations

from compplan.planning.strategies.online import OnlineCommand
from compplan.planning.task import PlanTask

words = "encoders behind the gears"


def prepare(task: PlanTask) -> OnlineCommand:
    """Command the nominal path, controlled by the link-side encoders."""
    return OnlineCommand("secondary_encoder", task.q_start, "link")
