"""Standard streams that no run fails by: closed ones, readers that leave early, letters that a terminal cannot show.

Cron and graphical launchers start programs with standard streams closed. A file that is opened then gets the number of
a closed stream, and what a library prints lands in it; so the numbers 0, 1 and 2 are taken first.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

from compplan.errors import InputError

#: What a write ends with where nobody reads on: reader gone, terminal gone, stream not open for it.
GONE = (errno.EPIPE, errno.EIO, errno.EBADF)


class SteadyStream:
    """A text stream whose reader may leave: what nobody reads is dropped, the run goes on and keeps its exit status.

    Args:
        stream: The stream.
        name: Its name in messages; "" for one whose every fault is dropped.

    """

    def __init__(self, stream: Any, name: str) -> None:
        self._stream = stream
        self._name = name
        self._fault = ""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text; return its length."""
        try:
            return int(self._stream.write(text))
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
            raise InputError(f"{self._name} cannot be written: {fault}; what the command writes to files is whole")

    def _lose(self, error: OSError) -> None:
        """Let the rest go nowhere."""
        point_nowhere(self._stream.fileno())
        with suppress(OSError):
            self._stream.flush()  # what it still holds would be tried again at the end
        if self._name and error.errno not in GONE:
            self._fault = error.strerror or str(error)


@contextmanager
def steady_streams() -> Iterator[None]:
    """Run with standard streams that are open and that no write fails on.

    Letters that a stream's encoding lacks, and bytes of paths that are no UTF-8, are shown as escapes.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            point_nowhere(number)
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _steady(sys.stdout, 1, "standard output"), _steady(sys.stderr, 2, "")
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = before


def point_nowhere(number: int) -> None:
    """Let a file descriptor lead to the null device."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere == number:
        os.set_inheritable(nowhere, True)
    else:
        os.dup2(nowhere, number)
        os.close(nowhere)


def _steady(stream: Any, number: int, name: str) -> TextIO:
    if stream is None:  # Python found it closed
        stream = open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors="backslashreplace")
    return cast(TextIO, SteadyStream(stream, name))
