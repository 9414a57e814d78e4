"""What a picture of the viewer costs: bytes of each message to one browser, as viser packs them, and calls made."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def record_traffic() -> Iterator[list[int]]:
    """Give the sizes of the messages that are sent meanwhile. [byte]"""
    import msgspec.msgpack
    from viser.infra import WebsockServer

    sizes: list[int] = []
    send = WebsockServer.queue_message

    def note(self: Any, message: Any) -> None:
        arrays: list[memoryview] = []
        packed = msgspec.msgpack.encode(message.as_serializable_dict(arrays))
        sizes.append(len(packed) + sum(array.nbytes for array in arrays))
        send(self, message)

    WebsockServer.queue_message = note  # type: ignore[method-assign]
    try:
        yield sizes
    finally:
        WebsockServer.queue_message = send  # type: ignore[method-assign]


def count_calls(work: Callable[[], object]) -> int:
    """Count the calls of Python functions that a piece of work makes in its thread."""
    count = 0

    def note(frame: Any, event: str, argument: Any) -> None:
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count
