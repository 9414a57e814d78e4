"""The command line."""

from __future__ import annotations

from compplan.cli.application import COMMANDS, group, load_command, main

__all__ = ["COMMANDS", "group", "load_command", "main"]
