"""The speeds that a program of few moves asks for, so that the controller takes the time of the plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array

#: Greatest ratio of two speeds within a move.
RATIO = 1.05
#: Share by which the feed of a move has to differ from the one before, so that another feed is written.
HELD = 0.01
#: Cycles below which a move may join rows of any speed.
SHORT = 2.0
#: Least feed that is written, the least that every language states: 1 cm/min in FANUC programs. [mm/s]
LEAST_FEED = 1.0 / 6.0
#: Time beside a rest in which the controller changes the speed by itself [s], and the ratio of speeds that ends it.
RAMP, REACHED = 0.5, 1.01


def send_speeds(
    step: Array, lasts: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], asked: Array | None
) -> Array:
    """Return the speed that is sent for the move to each row, starts from rest and stops left to the controller.

    Args:
        step: Way to each row. Shape (n,). [mm]
        lasts: Time of it. Shape (n,). [s]
        stops: Rows where the tool stands. Shape (n,).
        corners: Rows that are corners, which a zone leads around. Shape (n,).
        asked: Feed that the CAM file asks for; without it no leg has a speed of its own. Shape (n,). [mm/s]

    Returns:
        Shape (n,). [mm/s]
    """
    speed = step / np.maximum(lasts, 1e-9)
    if asked is not None:
        speed = _level_legs(speed, lasts, stops, corners, asked)
    return _leave_ramps(speed, lasts, stops | corners)


def _level_legs(
    speed: Array, lasts: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], asked: Array
) -> Array:
    """Return speeds that do not change along short legs from rest or corner to rest or corner.

    There the controller changes the speed by itself. A leg between two corners takes the time that the plan takes; one
    from rest, or to it, has the greatest speed of the plan, as the controller still has to come to it.

    A leg ends where the feed changes that is asked for.
    """
    level, cuts = speed.copy(), asked > 0.0  # rapid moves ask for no feed
    changes = np.append(cuts[1:] & cuts[:-1] & (np.abs(np.diff(asked)) > 1e-9 * asked[:-1]), False)
    at = np.flatnonzero(stops | corners | changes)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        leg = slice(a + 1, b + 1)
        if lasts[leg].sum() <= 2.0 * RAMP and not (changes[a] or changes[b]):
            rests = stops[a] or stops[b]
            level[leg] = speed[leg].max() if rests else speed[leg] @ lasts[leg] / max(lasts[leg].sum(), 1e-9)
    return level


def _leave_ramps(speed: Array, lasts: Array, stops: NDArray[np.bool_]) -> Array:
    """Return speeds as they are sent: beside a rest the one that the plan has reached, or comes from, within `RAMP`.

    The speed has to rise from row to row up to there, and not to fall at once again.
    """
    sent, at = speed.copy(), np.flatnonzero(stops)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if b - a < 2:
            continue
        for way in (slice(a + 1, b + 1), slice(b, a, -1)):
            v, time = speed[way], np.cumsum(lasts[way])
            near = v[: max(int(np.searchsorted(time, RAMP)), 1)]
            reached = int(np.argmax(near * REACHED >= near.max()))
            stays = reached == 0 or reached + 1 == len(v) or v[reached + 1] > REACHED * v[reached - 1]
            if stays and (np.diff(v[: reached + 1]) > 0.0).all():
                sent[way][:reached] = v[reached]
    return sent
