"""Options of commands that read a CAM file: what it does not say by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from compplan.errors import InputError
from compplan.toolpath.readers.machines import list_machines

Command = TypeVar("Command", bound=Callable[..., Any])

FEED = click.option(
    "--feed", "feed_mm_s", type=float, metavar="MM_S", help="Feed of cutting moves for which the file states none."
)
ROTARY = click.option(
    "--rotary", type=click.Choice(["head", "table", "head_table", "ignore"]), help="What A B C words turn."
)
MACHINE = click.option(
    "--machine", metavar="NAME",
    help=f"The machine that the file is made for: NAME.toml beside it, or {', '.join(list_machines())}.",
)  # fmt: skip
WCS = click.option("--wcs", metavar="G54", help="The work offset that is the part frame, if a file cuts in several.")
COMPENSATION = click.option(
    "--compensation", type=click.Choice(["centre_line"]), help="What a file holds where the control compensates (G41)."
)
UNIT = click.option("--unit", type=click.Choice(["mm", "inch"]), help="Unit of a file that does not state one.")


def read_place(context: click.Context, option: click.Parameter, text: str | None) -> list[float] | None:
    """Read X,Y,Z in mm.

    Raises:
        InputError: If the text is no three numbers.

    """
    if text is None:
        return None
    try:
        place = [float(word) for word in text.split(",")]
    except ValueError:
        place = []
    if len(place) != 3:
        raise InputError(f"{option.opts[0]} is {text!r}, expected X,Y,Z in mm")
    return place


FROM = click.option(
    "--from", "from_mm", metavar="X,Y,Z", callback=read_place,
    help="Where cuts begin whose start a file leaves open: mm, part frame.",
)  # fmt: skip


def take_cam_options(command: Command) -> Command:
    """Give a command the options --unit, --from, --feed, --machine, --rotary, --wcs and --compensation."""
    return UNIT(FROM(FEED(MACHINE(ROTARY(WCS(COMPENSATION(command)))))))


def keep_stated(**options: Any) -> dict[str, Any]:
    """Return the options that were given, by their keys in [cam]."""
    return {key: value for key, value in options.items() if value is not None}
