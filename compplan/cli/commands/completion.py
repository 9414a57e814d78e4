"""`compplan completion`: a script that lets the shell complete commands, options, files and robots."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem, get_completion_class

#: Shells that scripts are written for.
SHELLS = ("bash", "zsh", "fish")


@click.command("completion")
@click.argument("shell", type=click.Choice(SHELLS))
def command(shell: str) -> None:
    """Print a script for SHELL; after it is loaded, the tab key completes commands, options, files and robots.

    Example: compplan completion bash >> ~/.bashrc
    """
    group = click.get_current_context().find_root().command
    scripts = get_completion_class(shell)
    assert scripts is not None
    click.echo(scripts(group, {}, "compplan", "_COMPPLAN_COMPLETE").source())


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
