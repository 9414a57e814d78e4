"""Secondary-encoder feedback: the axes are held by their link-side encoders, which takes the gears' deflection out.

What bends beside the encoders stays: links, bearings, and springs beside the axis [Klimchik2018].
"""

from __future__ import annotations

from compplan.planning.strategies.online import Answer
from compplan.planning.task import PlanTask

words = "encoders behind the gears"


def prepare(task: PlanTask) -> Answer:
    """Command the nominal path, held by the link-side encoders."""
    return Answer("secondary_encoder", task.q_start, "link")
