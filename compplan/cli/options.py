"""Shared parts of commands: decorators, job argument, paths of results, robots, CAM options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import click

from compplan.cli.terminal import show
from compplan.errors import CompplanError, InputError
from compplan.io.transaction import check_file, check_folder

Command = TypeVar("Command", bound=Callable[..., Any])


class ResultPath(click.Path):
    """Path of a result, checked while parsing: a folder, or a file; an existing file must have the suffix."""

    def __init__(self, suffix: str | None = None) -> None:
        super().__init__(path_type=Path)
        self.suffix = suffix

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path."""
        path = Path(str(super().convert(value, param, ctx)))  # type: ignore[arg-type]
        if self.suffix is None:
            check_folder(path)
        else:
            check_file(path)
            if path.exists() and path.suffix != self.suffix:
                raise InputError(f"exists and is not a {self.suffix} file; name another file to write", file=path)
        return path


class Number(click.FloatRange):
    """A finite number within a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; the range lets nan pass."""
        number = float(super().convert(value, param, ctx))
        return number if isfinite(number) else self.fail(f"{number:g} is not a finite number.", param, ctx)


class CommandResult(NamedTuple):
    """Result of a command: summary for --json, lines of text, and an error if the result is not as required."""

    summary: Mapping[str, Any]
    lines: Sequence[str]
    fault: CompplanError | None = None


FOLDER, TABLE, INPUT = ResultPath(), ResultPath(".csv"), click.Path(path_type=Path)
out_folder = click.option("--out", "folder", type=FOLDER, default="out", show_default=True, help="Folder to write to.")
out_table = click.option("--out", required=True, type=TABLE, help="CSV file to write.")
assume_ok = click.option("--assume-ok", is_flag=True, help="Continue although a value looks implausible.")


def make_command(*options: Callable[[Any], Any], epilog: str | None = None) -> Callable[[Any], click.Command]:
    """Make the command `command` from a function that returns a `CommandResult`, with these options and --json."""

    def make(function: Callable[..., CommandResult]) -> click.Command:
        @wraps(function)
        def run(as_json: bool, **values: Any) -> None:
            answer = function(**values)
            show(answer.summary, as_json, answer.lines)
            if answer.fault is not None:
                raise answer.fault

        json_summary = click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
        return click.command("command", epilog=epilog)(add_options(*options, json_summary)(run))

    return make


def make_job_command(
    *options: Callable[[Any], Any], several: bool = False, epilog: str | None = None
) -> Callable[[Any], click.Command]:
    """Make a command as `make_command` does, from a function with a parameter `job` for the argument JOB.

    The command has --set, too; `several`: whether the job may have several operations.
    """
    argument = click.argument("job", type=INPUT)
    changes = click.option(
        "--set", "changes", multiple=True, metavar="KEY=VALUE",
        help="A key of the job in place of the file's, as TOML: --set plan.tolerance_mm=0.05; may be repeated.",
    )  # fmt: skip

    def make(function: Callable[..., CommandResult]) -> click.Command:
        @wraps(function)
        def run(
            job: Path,
            changes: tuple[str, ...],
            robot_instead: str | None = None,
            **values: Any,
        ) -> CommandResult:
            from compplan.job.job import load_job
            from compplan.job.operations import require_single_operation

            checked = load_job(job, robot_instead, changes)
            return function(job=checked if several else require_single_operation(checked), **values)

        return make_command(argument, *options, changes, epilog=epilog)(run)

    return make


def add_options(*options: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Return a decorator that adds options to a command in the order of its help."""

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def robot_option(
    help: str = "Robot folder, or name of a shipped robot.", *, required: bool = True, name: str = "robot_name"
) -> Any:
    """Return the option --robot."""
    return click.option("--robot", name, required=required, help=help)


#: Plan with another robot than the job's.
robot_instead = robot_option(
    "Robot folder in place of the job's, as diagnose, identify or learn wrote it.", required=False, name="robot_instead"
)


def split_names(text: str | None) -> tuple[str, ...]:
    """Read names separated by commas."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _read_place(context: click.Context, option: click.Parameter, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise InputError(f"{option.opts[0]} is {text!r}, expected X,Y,Z in mm") from None
    return [x, y, z]


measured_options = add_options(
    click.option("--tool", type=INPUT,
                 help="TOML file with position_mm, rotation_deg, mass_kg, centre_of_mass_mm, as [tool] of a job; "
                 "without a mass its weight is not known and bends nothing."),
    click.option("--target-offset", "target_offset_mm", metavar="X,Y,Z", callback=_read_place,
                 help="Measured point in the TCP frame, mm; left out: the TCP. With --register tool it is where "
                 "the fit begins."),
    click.option("--instrument", type=INPUT,
                 help="TOML file of an instrument that measures no positions: contacts (ball in a socket, tip on a "
                 "cone), readings along a direction (dial gauge, probe), distances (ball bar). The tool is fitted "
                 "unless --target-offset is given."),
)  # fmt: skip


def take_cam_options(command: Command) -> Command:
    """Add options for information that a CAM file may lack."""
    from compplan.toolpath.readers.options import list_machines

    machines = ", ".join(list_machines())
    return add_options(
        click.option("--unit", type=click.Choice(["mm", "inch"]), help="Unit of a file that does not state one."),
        click.option("--from", "from_mm", metavar="X,Y,Z", callback=_read_place,
                     help="Tool tip before the first cut, if the file does not state it: mm, part frame."),
        click.option("--feed", "feed_mm_s", type=float, metavar="MM_S",
                     help="Feed of cutting moves for which the file states none."),
        click.option("--machine", metavar="NAME",
                     help=f"The machine that the file is made for: NAME.toml beside it, or {machines}."),
        click.option("--rotary", type=click.Choice(["head", "table", "head_table", "ignore"]),
                     help="What A B C words turn: the tool (head), the part (table), both."),
        click.option("--wcs", metavar="G54", help="The work offset that is the part frame, if a file cuts in several."),
        click.option("--compensation", type=click.Choice(["centre_line"]),
                     help="State that a file with G41 or G42 holds the path of the tool centre."),
    )(command)  # fmt: skip


def keep_stated(**options: Any) -> dict[str, Any]:
    """Return the options with a value, by their keys in [cam]."""
    return {key: value for key, value in options.items() if value is not None}
