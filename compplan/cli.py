"""The command line: it finds the command, runs it, and turns exceptions into one line and an exit status."""

from __future__ import annotations

import importlib
import sys

import click

from compplan.errors import CompplanError
from compplan.version import VERSION

COMMANDS = {
    "plan": "compplan.commands.plan",
    "compare": "compplan.commands.compare",
    "montecarlo": "compplan.commands.montecarlo",
    "map": "compplan.commands.map",
    "identify": "compplan.commands.identify",
    "diagnose": "compplan.commands.diagnose",
    "predict": "compplan.commands.predict",
    "convert": "compplan.commands.convert",
    "reproduce": "compplan.commands.reproduce",
    "place": "compplan.commands.place",
    "init": "compplan.commands.init",
    "selftest-diagnosis": "compplan.commands.selftest_diagnosis",
}


class LazyGroup(click.Group):
    """Import a command's module only when it is asked for, so that the command line starts fast.

    Each module in `compplan.commands` offers a click command named `command`.
    """

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the command names."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(COMMANDS[cmd_name]).command
        return command


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="compplan")
def group() -> None:
    """Plan corrected robot paths under process forces, and diagnose the sim-to-real gap."""


def main() -> None:
    """Run the command line and leave with its exit status."""
    try:
        status = group.main(standalone_mode=False)
    except CompplanError as error:
        click.echo(f"error: {' '.join(str(error).split())}", err=True)
        sys.exit(error.exit_status)
    except click.ClickException as error:
        click.echo(f"error: {error.format_message()}", err=True)
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted", err=True)
        sys.exit(130)
    sys.exit(status if isinstance(status, int) else 0)
