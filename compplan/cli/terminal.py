"""The terminal: results on stdout, progress and log on stderr, streams that no run fails by.

`compplan` logs to the logger "compplan": stages of the work at INFO, files read and solver figures at DEBUG. -v shows
INFO on stderr, -vv DEBUG too; -q prints nothing but errors, and what --json prints.
"""

from __future__ import annotations

import errno
import functools
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

import click

from compplan.errors import InputError

LOG = logging.getLogger(__name__)
#: Keys of the context's table that hold what was asked for.
VERBOSE, QUIET = "compplan.verbose", "compplan.quiet"
#: What a write ends with where nobody reads on: reader gone, terminal gone, stream not open for it.
GONE = (errno.EPIPE, errno.EIO, errno.EBADF)


def show(summary: Mapping[str, Any], as_json: bool, lines: Iterable[str]) -> None:
    """Print a summary as JSON, or lines for people unless the run is quiet."""
    from compplan.io.tables import dump_json

    if as_json:
        click.echo(dump_json(summary, indent=2))
    elif not click.get_current_context().meta.get(QUIET):
        for line in lines:
            click.echo(line)


def format_table(
    rows: Iterable[Sequence[str]], columns: Sequence[str] = (), title: str | None = None, width: int | None = None
) -> list[str]:
    """Format a table; the first column is aligned left, the others right; without heads all are aligned left."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title) if columns else Table(box=None, show_header=False, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    console = Console(width=width, highlight=False)
    with console.capture() as captured:
        console.print(table)
    return captured.get().splitlines()


class Work:
    """Say what is being done: in a line with bars on a terminal, else in the log."""

    def __init__(self, bars: Any = None, stages: Sequence[str] = ()) -> None:
        self._bars, self._stages, self._done = bars, stages, 0
        self._head = None if bars is None else bars.add_task("", total=len(stages) or None)
        self._tasks: dict[str, Any] = {}

    def __call__(self, text: str) -> None:
        """Say what is done now."""
        self._done = max(self._done, find_stage(text, self._stages))
        if self._bars is None:
            LOG.info(text)
        else:
            self._bars.update(self._head, description=text, completed=self._done)

    def count(self, task: str, done: int, total: int) -> None:
        """Say how much of a task is done."""
        if self._bars is not None:
            if task not in self._tasks:
                self._tasks[task] = self._bars.add_task(task, total=total)
            self._bars.update(self._tasks[task], completed=done)


@contextmanager
def show_progress(stages: Sequence[str] = ()) -> Iterator[Work]:
    """Give what says how far the work is; silent where stderr is no terminal.

    stages: beginnings of what will be said, in order; a bar then shows how many are behind.
    """
    if not sys.stderr.isatty() or LOG.isEnabledFor(logging.INFO):
        yield Work()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=24), MofNCompleteColumn(), TimeElapsedColumn())
    text = TextColumn("{task.description}", markup=False)
    with Progress(*columns, text, console=Console(stderr=True), transient=True) as bars:
        yield Work(bars, stages)


def find_stage(text: str, stages: Sequence[str]) -> int:
    """Return how many stages are behind when a text is said; 0 for a text that begins as none of them."""
    return next((number for number, stage in enumerate(stages) if text.startswith(stage)), 0)


def add_verbosity(command: click.Command) -> click.Command:
    """Give a command the options -v and -q, once."""
    if not any(parameter.name == "verbose" for parameter in command.params):
        command.params += [
            click.Option(["-v", "--verbose"], count=True, expose_value=False, callback=_set_verbose,
                         help="Say on stderr what is being done; -vv: every file read, every solver, too."),
            click.Option(["-q", "--quiet"], is_flag=True, expose_value=False, callback=_set_quiet,
                         help="Print errors alone (and what --json prints)."),
        ]  # fmt: skip
    return command


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
        for end in (functools.partial(logger.removeHandler, handler), functools.partial(logger.setLevel, 0)):
            context.find_root().call_on_close(end)
    logger.setLevel(level)


class SteadyStream:
    """A text stream whose reader may leave: what nobody reads is dropped, the run keeps its exit status.

    `name` is that of the stream in messages; "" for one whose every fault is dropped.
    """

    def __init__(self, stream: Any, name: str) -> None:
        self._stream, self._name, self._fault = stream, name, ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text; return its length."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Hand over what is written.

        Raises:
            InputError: Once, if the file that the stream leads to could not hold it, such as on a full disk.
        """
        try:
            self._stream.flush()
        except OSError as error:
            self._lose(error)
        fault, self._fault = self._fault, ""
        if fault:
            raise InputError(f"{self._name} cannot be written: {fault}; the output files are complete")

    def _lose(self, error: OSError) -> None:
        """Let the rest go nowhere, what the stream still holds too."""
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
        with suppress(OSError):
            self._stream.flush()
        if self._name and error.errno not in GONE:
            self._fault = error.strerror or str(error)


@contextmanager
def steady_streams() -> Iterator[None]:
    """Run with standard streams that are open and that no write fails on.

    Cron and graphical launchers start programs with closed streams; a file that is opened then gets the number of one,
    so the numbers 0, 1 and 2 are taken first. Letters that an encoding lacks are shown as escapes.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _steady(sys.stdout, 1, "standard output"), _steady(sys.stderr, 2, "")
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = before


def _steady(stream: Any, number: int, name: str) -> TextIO:
    if stream is None:  # Python found it closed
        stream = open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors="backslashreplace")
    return cast(TextIO, SteadyStream(stream, name))
