"""`compplan view`: a plan or a diagnosis in the browser, on this machine alone."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click

from compplan.cli.options import INPUT
from compplan.cli.terminal import show, show_progress
from compplan.io.tables import read_text


@click.command()
@click.argument("out", type=INPUT)
@click.option("--port", type=click.IntRange(1, 65535), default=8080, show_default=True, help="Port on 127.0.0.1.")
@click.option("--open/--no-open", "opened", default=True, help="Open the page in the browser.")
def command(out: Path, port: int, opened: bool) -> None:
    """Show OUT, a folder of compplan plan or diagnose: the arm along the path, or measured poses.

    A plan of several tools has a view for each, at ports one after the other. Ctrl-C ends them.

    Example: compplan view out
    """
    from compplan.reporting.view.server import HOST, start_server

    viewers = []
    for place, folder in enumerate(list_shown(out)):
        with show_progress() as progress:
            progress("the viewer starts")
            viewers.append(start_server(folder, port + place))
        address = f"http://{HOST}:{port + place}"
        show({}, False, [f"{folder} at {address}, Ctrl-C ends it"])
        if opened:
            click.launch(address)
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt:
        for viewer in viewers:
            viewer.stop()


def list_shown(out: Path) -> list[Path]:
    """Return the folders that are shown: that of each tool where a plan has several, each at a port of its own."""
    file = out / "plan.json"
    try:
        data = json.loads(read_text(file)) if file.is_file() else {}
    except ValueError:  # the viewer says what is wrong with the folder
        data = {}
    tools = data.get("tools", []) if isinstance(data, dict) else []
    folders = [out / tool["folder"] for tool in tools if isinstance(tool, dict) and isinstance(tool.get("folder"), str)]
    return folders or [out]
