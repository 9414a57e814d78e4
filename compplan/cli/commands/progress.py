"""Progress on stderr, and only where a person looks on."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

LOG = logging.getLogger(__name__)


@contextmanager
def show_progress(stages: Sequence[str] = ()) -> Iterator[Callable[[str], None]]:
    """Give a function that tells what is done now; silent where stderr is no terminal.

    Args:
        stages: Beginnings of what will be told, in order; a bar then shows how many are behind. Left out: no bar.

    """
    if not sys.stderr.isatty() or LOG.isEnabledFor(logging.INFO):
        yield LOG.info
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    bar = (BarColumn(bar_width=24), MofNCompleteColumn()) if stages else ()
    columns = (SpinnerColumn(), *bar, TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        work = progress.add_task("", total=len(stages) or None)
        done = 0

        def announce(text: str) -> None:
            nonlocal done
            done = max(done, find_stage(text, stages))
            progress.update(work, description=text, completed=done)

        yield announce


def find_stage(text: str, stages: Sequence[str]) -> int:
    """Return how many stages are behind when a text is told; 0 for a text that begins as none of them."""
    return next((number for number, stage in enumerate(stages) if text.startswith(stage)), 0)
