"""Corners that a block asks to be rounded or cut off, between two straight moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.oracles.cam.machine import DrivenMachine
from tests.oracles.cam.moves import ARC, LINE, CannotTellError


def cut_corner(
    machine: DrivenMachine, start: Sequence[float], target: Sequence[float], size: float, *, form: str, feed: float
) -> None:
    """Take back the end of the last line and lead over the corner towards the next one's end.

    Args:
        machine: The machine, which stands at the corner.
        start: Where the line to the corner began, frame of the program. [mm]
        target: Where the line after it leads. [mm]
        size: As `form` says: "round", its radius; "side", what a chamfer takes from either line; "across", how long
            the chamfer is. [mm]
        form: Which of them.
        feed: Feed on it. [mm/s]

    Raises:
        CannotTellError: If the moves leave no room for it, or turn back.

    """
    record, corner = machine.record, list(machine.at)
    back = [a - b for a, b in zip(start, corner, strict=True)]
    ahead = [a - b for a, b in zip(target, corner, strict=True)]
    lengths = math.hypot(*back), math.hypot(*ahead)
    if not record.rows or int(record.rows[-1][0]) != LINE or not min(lengths) > 0.0:
        raise CannotTellError("a corner without lines beside it", record.line)
    u, v = ([value / length for value in way] for way, length in zip((back, ahead), lengths, strict=True))
    cosine = sum(a * b for a, b in zip(u, v, strict=True))
    if cosine > 1.0 - 1e-9:
        raise CannotTellError("a corner that turns back", record.line)
    if cosine < -1.0 + 1e-12:
        return  # straight on
    half = 0.5 * math.acos(cosine)
    taken = {"round": size / math.tan(half), "side": size, "across": 0.5 * size / math.sin(half)}[form]
    if taken > min(lengths) + 1e-9:
        raise CannotTellError("a corner larger than its moves", record.line)
    first, last = ([c + taken * value for c, value in zip(corner, way, strict=True)] for way in (u, v))
    row = record.rows[-1]
    record.rows[-1] = (row[0], *machine.place(first), *row[4:])
    machine.at = first
    if form == "round":
        reach = size / math.sin(half)
        middle = [a + b for a, b in zip(u, v, strict=True)]
        centre = [c + reach * m / math.hypot(*middle) for c, m in zip(corner, middle, strict=True)]
        across = [v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]]
        zero = machine.place([0.0, 0.0, 0.0])
        normal = tuple(a - b for a, b in zip(machine.place(across), zero, strict=True))
        record.move(
            ARC, machine.place(last), feed, machine.axis, centre=tuple(machine.place(centre)), normal=normal,
            sweep=math.pi - 2.0 * half,
        )  # fmt: skip
    else:
        record.move(LINE, machine.place(last), feed, machine.axis)
    machine.at = last
