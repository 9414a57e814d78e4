"""What a verb takes for a robot: a name, a folder, or a robot in memory, with the tool that is mounted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compplan.io.tomlfile import check_table
from compplan.job.job import ToolTable
from compplan.robot import Robot, load_robot


def take_robot(robot: str | Path | Robot, tool: Mapping[str, Any] | None = None) -> Robot:
    """Return a robot with the tool that is mounted.

    Args:
        robot: Name of a shipped robot, a robot folder, or the robot.
        tool: The tool as [tool] of a job; left out: the robot's own.

    Raises:
        InputError: If there is no such robot, or the tool is not what it has to be.
    """
    known = robot if isinstance(robot, Robot) else load_robot(robot)
    return known if tool is None else check_table(ToolTable, tool, key="tool").mount(known)
