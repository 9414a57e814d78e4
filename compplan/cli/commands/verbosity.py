"""How much a command says: -v and -q, before the command or after it.

`compplan` logs to the logger "compplan" of Python's logging, silent unless it is asked: stages of the work at INFO,
files read and solver figures at DEBUG. -v shows INFO on stderr, -vv DEBUG too. -q prints nothing but errors, and what
--json prints.
"""

from __future__ import annotations

import functools
import logging
import os
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import click

#: Key of the context's table that holds what was asked for.
VERBOSE, QUIET = "compplan.verbose", "compplan.quiet"


def add_verbosity(command: click.Command) -> click.Command:
    """Give a command the options -v and -q, once."""
    if any(parameter.name == "verbose" for parameter in command.params):
        return command
    command.params += [
        click.Option(["-v", "--verbose"], count=True, expose_value=False, callback=_set_verbose,
                     help="Say on stderr what is being done; -vv: every file read, every solver, too."),
        click.Option(["-q", "--quiet"], is_flag=True, expose_value=False, callback=_set_quiet,
                     help="Print errors alone (and what --json prints)."),
    ]  # fmt: skip
    if command.callback is not None and not isinstance(command, click.Group):
        command.callback = _hush(command.callback)
    return command


def _hush(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a command so that it prints nothing to stdout where it was asked to be quiet."""

    @functools.wraps(callback)
    def run(*arguments: Any, **options: Any) -> Any:
        if not click.get_current_context().meta.get(QUIET) or options.get("as_json"):
            return callback(*arguments, **options)
        with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
            return callback(*arguments, **options)

    return run


def _set_quiet(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        context.meta[QUIET] = True


def _set_verbose(context: click.Context, parameter: click.Parameter, value: int) -> None:
    if not value:
        return
    context.meta[VERBOSE] = max(value, context.meta.get(VERBOSE, 0))
    logger = logging.getLogger("compplan")
    level = logging.INFO if context.meta[VERBOSE] == 1 else logging.DEBUG
    if logger.level:  # said before the command and after it
        level = min(level, logger.level)
    else:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(relativeCreated)7.0f ms  %(message)s"))
        logger.addHandler(handler)
        context.find_root().call_on_close(functools.partial(_end_log, logger, handler))
    logger.setLevel(level)


def _end_log(logger: logging.Logger, handler: logging.Handler) -> None:
    logger.removeHandler(handler)
    logger.setLevel(logging.NOTSET)
