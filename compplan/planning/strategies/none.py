"""No compensation: joint positions at which the controller's kinematics has the tool on the path."""

from __future__ import annotations

from compplan.planning.task import Command, PlanTask, check_limits

words = "no correction"


def command_path(task: PlanTask) -> Command:
    """Command the nominal path as if the robot were rigid."""
    return check_limits(task, task.q_uncorrected)
