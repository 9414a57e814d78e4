"""Command line: finds and runs the command, and turns exceptions into one line and an exit status."""

from __future__ import annotations

import errno
import gc
import importlib
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from compplan.cli.terminal import add_verbosity, close_streams, open_streams
from compplan.errors import CompplanError, InputError, find_near
from compplan.io.process_settings import THREADS, keep_freed_memory, put_off
from compplan.io.provenance import record_inputs
from compplan.version import VERSION

#: Environment variable that enables tracebacks of defects and all warnings.
DEBUG = "COMPPLAN_DEBUG"
#: Purpose of each command, in the order of the help.
COMMANDS = {
    "plan": "plan a job: corrected robot program, 95 % band, verdict",
    "compare": "compare all strategies, on the robot as modelled and on robots that differ from the model",
    "montecarlo": "how many of 100 parts keep the tolerance, by strategy, under uncertainty",
    "map": "map stiffness and dexterity over a horizontal and a vertical plane",
    "identify": "identify the compliances of a robot from a measurement log",
    "diagnose": "find the causes of a robot's errors in a measurement log, and update its model",
    "predict": "predict the readings of an instrument for the rows of a log",
    "campaign": "choose the poses to measure that narrow a path's 95 % band most",
    "learn": "correct the next program by the measured deviations of a cut part",
    "calibration": "read the calibration of a UR controller into a robot folder",
    "convert": "convert a CAM file to a toolpath table",
    "post": "plan a CAM file without a job file, in one command",
    "execute": "simulate how a robot controller executes a program",
    "trace": "identify lag and blends of a controller from logs of executed programs",
    "reproduce": "compare our figures with those of a paper",
    "place": "find the best place of the part",
    "forces": "predict engagement and force along the path, or fit them to a log",
    "view": "show a plan in the browser, on this machine only",
    "init": "write a commented job, a robot folder from a URDF, or an empty measurement log",
    "doctor": "check the installation, a robot folder or a log",
}
#: The commands of each module of `compplan.cli.commands`.
MODULES = {
    "plan": ("plan", "post", "place", "compare", "forces"), "study": ("montecarlo", "map", "reproduce"),
    "measure": ("identify", "diagnose", "predict", "campaign", "learn"),
    "program": ("convert", "execute", "trace", "calibration"), "setup": ("init", "doctor", "view"),
}  # fmt: skip


def load_command(name: str) -> click.Command:
    """Import and return a command."""
    put_off()  # imports numpy, as every command does, therefore as late as possible
    module = next(module for module, names in MODULES.items() if name in names)
    command: click.Command = getattr(importlib.import_module(f"compplan.cli.commands.{module}"), f"run_{name}")
    return add_verbosity(command)


class LazyGroup(click.Group):
    """Import the module of a command only when the command is used, so that the command line starts fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the command names."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        return load_command(cmd_name) if cmd_name in COMMANDS else None

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; a broken pipe to another process is an ordinary error, not a closed output."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise InputError("the process that reads this output has ended; run the command again") from None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of a line; refuse an option that is given twice but has a single value."""
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            near = find_near(args[0], list(COMMANDS))[:2]
            meant = f"did you mean {' or '.join(near)}" if near else f"choose from {list(COMMANDS)}"
            raise InputError(f"no command named {args[0]!r}, {meant}; compplan --help lists them")
        name, command, rest = super().resolve_command(ctx, args)
        given = [word.partition("=")[0] for word in rest]
        for option in () if command is None else command.params:
            single = isinstance(option, click.Option) and not option.multiple and not option.is_flag
            if single and any(given.count(word) > 1 for word in option.opts):
                raise InputError(f"{option.opts[0]} is given twice, choose one")
        return name, command, rest

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands with their purpose, without importing any module."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]}, invoke_without_command=True)
@click.version_option(VERSION, prog_name="compplan")
@click.pass_context
def group(context: click.Context) -> None:
    """Plan corrected robot paths under process forces, and diagnose the sim-to-real gap."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


add_verbosity(group)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, with the words after the program's name, and exit with its status."""
    if DEBUG not in os.environ:
        warnings.simplefilter("ignore")
        os.environ.setdefault("PYTHONWARNINGS", "ignore")  # for worker processes
    # One thread unless the environment states more: many small matrices do not benefit from more, and on a busy machine
    # threads that wait for one another take six times the processor time. numpy is imported after a command is found.
    for name in THREADS:
        os.environ.setdefault(name, "1")
    words = list(sys.argv[1:] if arguments is None else arguments)
    gc.set_threshold(200_000, 20, 50)  # a command allocates many lasting objects at its start, and is short
    keep_freed_memory()
    _received.clear()
    previous = signal.signal(signal.SIGTERM, _leave_on_term)
    open_streams()
    try:
        status = run_words(words)
    finally:
        close_streams()
        signal.signal(signal.SIGTERM, previous)
    sys.exit(status)


def run_words(words: list[str]) -> int:
    """Run a command line and return its exit status; an error is one line on stderr."""
    try:
        if "" in words:
            raise InputError("an argument is empty, expected a name or a path")
        with record_inputs():
            status = group.main(words, standalone_mode=False)
    except (KeyboardInterrupt, click.Abort):
        _print_error("interrupted")
        return 130
    except Exception as error:
        if DEBUG in os.environ:
            traceback.print_exc()
        if _received:  # an import interrupted by SIGTERM may raise another error instead of the exit
            return 128 + _received[0]
        _print_error(f"error: {describe_fault(error)}")
        return error.exit_status if isinstance(error, CompplanError) else 2
    return status if isinstance(status, int) else 0


def _print_error(text: str) -> None:
    with suppress(OSError):
        click.echo(text, err=True)


def describe_fault(error: Exception) -> str:
    """Return the error line of an exception."""
    if isinstance(error, click.MissingParameter) and isinstance(error.param, click.Argument) and error.ctx:
        return f"{error.param.human_readable_name} is missing; compplan {error.ctx.info_name} --help shows an example"
    text = error.format_message() if isinstance(error, click.ClickException) else str(error)
    line, length = " ".join(text.split()), 2000
    if isinstance(error, OSError) and error.filename and error.strerror:
        line = f"{error.filename}: {error.strerror}"
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        line = f"standard output cannot be written: {error.strerror}; the output files are complete"
    elif isinstance(error, MemoryError):
        line = "this needs more memory than there is; use fewer waypoints, samples or points"
    elif isinstance(error, RecursionError):
        line = "the input is nested too deeply"
    elif isinstance(error, RuntimeError) and "Symlink loop" in line:
        line = f"a symbolic link leads back to itself: {line.partition(' from ')[2]}"
    elif not isinstance(error, CompplanError | click.ClickException | OSError):
        place = traceback.extract_tb(error.__traceback__)[-1]
        where, length = f"{Path(place.filename).name}:{place.lineno}", 600
        line = f"internal fault {type(error).__name__}: {line} ({where}); {DEBUG}=1 shows where it comes from"
    return line if len(line) <= length else f"{line[: length // 2]} [...] {line[-length // 2 :]}"


#: Received signals to end this run.
_received: list[int] = []


def _leave_on_term(number: int, frame: object) -> None:
    _received.append(number)
    sys.exit(128 + number)
