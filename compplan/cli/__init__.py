"""The command line."""

from __future__ import annotations

from compplan.cli.application import COMMANDS, group, main

__all__ = ["COMMANDS", "group", "main"]
