"""Online elastic correction with force feedback in a control loop at 100 Hz [Johra2022].

As `force_sensor`, but the correction reaches the tool through a PI or PID law and a robot with lag and delay. The law
of the paper taken literally (PID, error from the correction sent one period before) has a pole of 2.29 and runs away;
`LITERAL` keeps it for showing. Without its derivative part it is stable (0.91); the PID is stable where its error comes
from where the robot stands, on the plant that its gains fit.
"""

from __future__ import annotations

from dataclasses import replace

from compplan.plan.correction_loop import Loop, Plant
from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.force_sensor import correct_by_wrench
from compplan.plan.strategies.path_map import PathMaps
from compplan.plan.task import PlanTask

#: The law as printed, on a robot that follows at once: unstable.
LITERAL = Loop(plant=Plant(0.0, 0.0), error="sent")
#: The same without its derivative part; the robot follows with lag and delay outside the loop.
PI = Loop(derivative=0.0, error="sent")
#: The PID with the error from where the robot stands.
PID = Loop(error="attained")
#: The three by name, for comparisons.
LOOPS = {"as printed": LITERAL, "PI": PI, "PID": PID}


def prepare_pi(task: PlanTask, maps: PathMaps) -> Answer:
    """Correct online by a PI law."""
    answer = correct_by_wrench("online_pi", "the full stiffness model", task, maps.full)
    return replace(answer, commands="the same through a PI law at 100 Hz, lag and delay", loop=PI)


def prepare_pid(task: PlanTask, maps: PathMaps) -> Answer:
    """Correct online by a PID law."""
    answer = correct_by_wrench("online_pid", "the full stiffness model", task, maps.full)
    return replace(answer, commands="the same through a PID law at 100 Hz, lag and delay", loop=PID)
