"""Every exception that compplan raises on purpose.

A message is one sentence: what is wrong, what is allowed, where, and what to do next. The command line prints it
as one line and leaves with the exit status of the class; nothing else decides an exit status.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

#: Names that an error lists at most, where some of them are near to the one that was asked for.
MANY = 12


class CompplanError(Exception):
    """Base class of all exceptions of this package."""

    exit_status = 2


class InputError(CompplanError):
    """Error: an input file, a section, a key or an argument is not valid.

    Args:
        message: What is wrong and what is expected.
        file: The file at fault; its path leads the line.
        where: A line number (counted from 1), or the dotted key of a TOML file.
    """

    exit_status = 2

    def __init__(self, message: str, *, file: str | Path | None = None, where: int | str | None = None) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.where = where
        line = self.file is not None and isinstance(where, int)
        parts = [f"{self.file}:{where}"] if line else [self.file, where]
        super().__init__(": ".join(str(part) for part in (*parts, message) if part not in (None, "")))


class ShapeError(CompplanError):
    """An array does not have the shape that a function states."""


class UnknownNameError(InputError):
    """A name does not exist; the message lists the existing names.

    Args:
        kind: What is named, such as "frame" or "joint".
        name: The name that was asked for.
        choices: The names there are.
        file: The file that holds the name.
        where: Line or key in that file.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        choices: list[str],
        *,
        file: str | Path | None = None,
        where: int | str | None = None,
    ) -> None:
        self.name = name
        self.choices = choices
        near = find_near(name, choices) if len(choices) > MANY else []
        listed = f"{near} ({len(choices)} {kind}s in all)" if near else f"{choices}"
        super().__init__(f"no {kind} named {name!r}, choose from {listed}", file=file, where=where)


def find_near(name: str, choices: Sequence[str]) -> list[str]:
    """List the names that hold this one, else those that are spelt like it; none where no name is near."""
    inside = [choice for choice in choices if name and name.lower() in choice.lower()]
    return (inside or get_close_matches(name.lower(), choices, MANY // 2))[:MANY]


class InfeasibleError(CompplanError):
    """Error: a valid request has no solution; it names the waypoints and limits that prevent one.

    Args:
        message: What has no solution and what to do next.
        waypoints: Indices of the waypoints that fail, counted from 0.
        limits: Names of the limits that stop them.
    """

    exit_status = 3

    def __init__(self, message: str, *, waypoints: list[int] | None = None, limits: list[str] | None = None) -> None:
        self.waypoints = waypoints or []
        self.limits = limits or []
        super().__init__(message)


class ConvergenceError(CompplanError):
    """An iteration did not reach its tolerance; carries the last residual for inspection."""

    exit_status = 3

    def __init__(self, message: str, *, residual: float) -> None:
        self.residual = residual
        super().__init__(message)
