"""Terminal output: results on stdout, progress and log on stderr; stream errors do not end a run.

`compplan` logs to the logger "compplan": stages of the work at INFO, files read and solver figures at DEBUG. -v shows
INFO on stderr, -vv DEBUG too; -q prints only errors and the output of --json.
"""

from __future__ import annotations

import functools
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click

LOG = logging.getLogger(__name__)
#: Key of the click context's `meta` for -q.
QUIET = "compplan.quiet"


def show(summary: Mapping[str, Any], as_json: bool, lines: Iterable[str]) -> None:
    """Print a summary as JSON, or lines of text unless the run is quiet; a closed pipe ends the output."""
    from compplan.io.tables import dump_json

    quiet = click.get_current_context().meta.get(QUIET)
    with suppress(BrokenPipeError):
        for line in [dump_json(summary, indent=2)] if as_json else [] if quiet else lines:
            click.echo(line)


class Work:
    """Show the current step: next to a spinner on a terminal, otherwise in the log."""

    def __init__(self, bars: Any = None) -> None:
        self._bars, self._tasks = bars, dict[str, Any]()
        self._head = None if bars is None else bars.add_task("", total=None)

    def __call__(self, text: str) -> None:
        """Show the current step."""
        if self._bars is None:
            LOG.info(text)
        else:
            self._bars.update(self._head, description=text)

    def count(self, task: str, done: int, total: int) -> None:
        """Show the progress of a task."""
        if self._bars is not None:
            if task not in self._tasks:
                self._tasks[task] = self._bars.add_task(task, total=total)
            self._bars.update(self._tasks[task], completed=done)


@contextmanager
def show_progress() -> Iterator[Work]:
    """Yield the progress display; it only logs if stderr is not a terminal."""
    if not sys.stderr.isatty() or LOG.isEnabledFor(logging.INFO):
        yield Work()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=24), MofNCompleteColumn(), TimeElapsedColumn())
    text = TextColumn("{task.description}", markup=False)
    with Progress(*columns, text, console=Console(stderr=True), transient=True) as bars:
        yield Work(bars)


def add_verbosity(command: click.Command) -> click.Command:
    """Add the options -v and -q to a command, once."""
    if not any(parameter.name == "verbose" for parameter in command.params):
        command.params += [
            click.Option(["-v", "--verbose"], count=True, expose_value=False, callback=_set_verbose,
                         help="Log each step to stderr; -vv: also files read and solver runs."),
            click.Option(["-q", "--quiet"], is_flag=True, expose_value=False, callback=_set_quiet,
                         help="Print only errors (and the output of --json)."),
        ]  # fmt: skip
    return command


def _set_quiet(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        context.meta[QUIET] = True


def _set_verbose(context: click.Context, parameter: click.Parameter, value: int) -> None:
    if not value:
        return
    logger = logging.getLogger("compplan")
    level = logging.INFO if value == 1 else logging.DEBUG
    if logger.level:  # given before the command and after it
        level = min(level, logger.level)
    else:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(relativeCreated)7.0f ms  %(message)s"))
        logger.addHandler(handler)
        for end in (functools.partial(logger.removeHandler, handler), functools.partial(logger.setLevel, 0)):
            context.find_root().call_on_close(end)
    logger.setLevel(level)


def open_streams() -> None:
    """Replace closed standard streams by the null device; escape characters outside of their encoding."""
    sys.stdout, sys.stderr = (stream or Path(os.devnull).open("w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def close_streams() -> None:
    """Flush the standard streams; discard output without a reader."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_RDWR), stream.fileno())
