"""Options that several commands share, and the completion of robot names by the shell."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem


def complete_robots(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete the name of a shipped robot, or a folder."""
    from compplan.robot.folder import robot_folders

    names = [CompletionItem(name) for name in sorted(robot_folders()) if name.startswith(begun)]
    return [*names, CompletionItem(begun, type="dir")]


#: Option of a command on a job: plan with another robot than the job's.
robot_instead = click.option(
    "--robot", "robot", shell_complete=complete_robots,
    help="Robot folder in place of the job's, as diagnose, identify or learn wrote it.",
)  # fmt: skip

#: Option of a command on a job: whose posture is kept.
posture_kept = click.option(
    "--keep", "keep", metavar="WHAT",
    help="Posture to keep: robot (with --robot that which the job's own robot chooses), nothing, or joints.csv of an "
    "earlier plan.  [default: as the job says]",
)  # fmt: skip
