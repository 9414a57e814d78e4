"""The command line."""

from __future__ import annotations

from compplan.cli.application import COMMANDS, describe_command, group, main

__all__ = ["COMMANDS", "describe_command", "group", "main"]
