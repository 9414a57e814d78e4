"""Which way a tool points that a machine with rotary axes holds, seen from the part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tests.oracles.cam.machine import UNIT, Matrix, carry, multiply, transpose, turn_about
from tests.oracles.cam.moves import CannotTellError


def point_tool(kind: str, axes: Sequence[str] | None, angles: Mapping[str, float]) -> tuple[float, ...]:
    """Return the tool axis, tip to spindle, part frame.

    A head turns the tool by the right hand, C carrying the tilt; a table turns the part so, the tilt carrying C. With
    both, the head's axis is named first.

    Args:
        kind: "head", "table" or "head_table".
        axes: Names of the axes, that which carries the other first; "-" where one turns against the right hand.
        angles: Angles by letter. [deg]

    Raises:
        CannotTellError: If it is not said which axes there are.

    """
    turned = [letter for letter in "CBA" if letter in angles]
    if axes is None:
        tilts = [letter for letter in turned if letter != "C"]
        if len(tilts) > 1 or kind == "head_table":
            raise CannotTellError("rotary words without the order of their axes")
        axes = [*tilts, "C"] if kind == "table" else ["C", *tilts]
    if {name[-1] for name in axes} < {letter for letter in turned if angles[letter]}:
        raise CannotTellError("rotary words of an axis that is not named")
    heads = {"head": list(axes), "table": [], "head_table": list(axes[:1])}[kind]
    tables = list(axes[len(heads) :])
    return tuple(carry(transpose(_chain(tables, angles)), carry(_chain(heads, angles), (0.0, 0.0, 1.0))))


def _chain(names: Sequence[str], angles: Mapping[str, float]) -> Matrix:
    """Return the rotation of axes of which each carries the next."""
    matrix = UNIT
    for name in names:
        angle = angles.get(name[-1], 0.0) * (-1.0 if name[0] == "-" else 1.0)
        matrix = multiply(matrix, turn_about("ABC".index(name[-1]), angle))
    return matrix
