"""`compplan view`: a plan or a diagnosis in the browser, on this machine alone."""

from __future__ import annotations

import time
from pathlib import Path

import click


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="Port on 127.0.0.1.")
@click.option("--open/--no-open", "opened", default=True, help="Open the page in the browser.")
def command(out: Path, port: int, opened: bool) -> None:
    """Show OUT, a folder of compplan plan or diagnose: the arm along the path, or measured poses. Ctrl-C ends it.

    Example: compplan view out
    """
    from compplan.commands.progress import show_progress
    from compplan.report.view.server import HOST, start_server

    with show_progress() as progress:
        progress("the viewer starts")
        viewer = start_server(out, port)
    address = f"http://{HOST}:{port}"
    click.echo(f"{out} at {address}, Ctrl-C ends it")
    if opened:
        click.launch(address)
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt:
        viewer.stop()
