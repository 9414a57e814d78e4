"""Where a cut begins: never where the tool is not known to be.

A program leaves the tool's place open at its beginning, after moves to the machine's home (G28, G53, SUPA, M91), after
joint moves of a robot and after probing. A cut from there is refused, or begins at the place that `from_mm` states. A
rapid move to a place that the program states in full makes it known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point

AXES = "XYZ"


def find_start(place: Point, unknown: Iterable[int], stated: Sequence[float] | None, reason: str = "") -> Point:
    """Return where a cut begins.

    Args:
        place: Where the tool is, as far as it is known. [mm]
        unknown: Axes whose coordinate is not known.
        stated: Coordinates that take the place of unknown ones (`from_mm`), or None. [mm]
        reason: Why the place is not known, for the message.

    """
    axes = sorted(set(unknown))
    if axes and stated is None:
        names = " ".join(AXES[axis] for axis in axes)
        why = f" ({reason})" if reason else ""
        raise InputError(
            f"a cut begins where {names} of the tool is not known{why}; let a rapid move to a place in the part come "
            "first, or state where such cuts begin with --from X,Y,Z ([cam] from_mm)"
        )
    found = list(place)
    for axis in axes:
        found[axis] = float((stated or place)[axis])
    return found[0], found[1], found[2]


def refuse_unit(words: str) -> InputError:
    """Return the error that a file states no unit of length.

    Args:
        words: The words that would state it.

    """
    return InputError(f"no unit of length is stated before this line ({words}): state it with --unit mm or --unit inch "
                      "([cam] unit)")  # fmt: skip
