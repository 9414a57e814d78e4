"""Motion along a path without jolts: the fastest speed profile, smoothed over a time, from rest to rest.

A profile s(t) of piecewise constant acceleration, averaged over a window of T, is

    s_T(t) = (S(t) - S(t - T)) / T,    S the integral of s,

which starts and ends at rest later by T, has no more speed and acceleration than s has nearby, and changes its
acceleration by no more than 2 max|s''| / T a second. A window of one period of a natural frequency leaves that
frequency unexcited.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

#: Halvings that bring the time of a waypoint near enough for Newton's steps, and those steps.
HALVINGS, NEWTON_STEPS = 18, 3


@dataclass(frozen=True)
class Profile:
    """How a run goes along its path; k waypoints.

    Attributes:
        time: Time at each waypoint, from 0. Shape (k,). [s]
        speed: Speed along the path, as a share of the programmed feed. Shape (k,).
        push: Its rate. Shape (k,). [1/s]

    """

    time: Array
    speed: Array
    push: Array


def smooth_profile(along: Array, speed: Array, window: float) -> Profile:
    """Smooth the speed along a path over a window of time.

    Args:
        along: Programmed time at each waypoint, from 0. Shape (k,). [s]
        speed: Speed at each waypoint as a share of the programmed feed, its square linear between them, 0 at both ends.
            Shape (k,).
        window: Length of the window, 0 for none. [s]

    """
    step = 2 * np.diff(along) / np.maximum(speed[1:] + speed[:-1], 1e-12)
    time = np.r_[0.0, np.cumsum(step)]
    rate = np.diff(speed) / step
    if window <= 0:
        return Profile(time, speed, np.r_[rate, rate[-1]])
    area = np.r_[0.0, np.cumsum(step * (along[:-1] + step * (speed[:-1] / 2 + step * rate / 6)))]
    law = _Law(time, along, speed, rate, area)
    low, high = time, time + window  # the average runs behind by up to the window
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        place = (law.area_at(middle) - law.area_at(middle - window)) / window
        low, high = np.where(place < along, middle, low), np.where(place < along, high, middle)
    when = 0.5 * (low + high)
    for _ in range(NEWTON_STEPS):
        place = (law.area_at(when) - law.area_at(when - window)) / window
        slope = (law.at(when)[0] - law.at(when - window)[0]) / window
        when = np.clip(when - (place - along) / np.maximum(slope, 1e-12), low, high)
    when[0], when[-1] = 0.0, time[-1] + window
    there, before = law.at(when), law.at(when - window)
    share, push = (there[0] - before[0]) / window, (there[1] - before[1]) / window
    share[[0, -1]] = push[[0, -1]] = 0.0
    return Profile(np.maximum.accumulate(when), np.maximum(share, 0.0), push)


def ease(u: Array) -> Array:
    """Return how far a move has come that starts and ends gently, at shares of its time: 10 u^3 - 15 u^4 + 6 u^5."""
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


def ease_times(places: Array, duration: float) -> Array:
    """Return when a move that starts and ends gently passes places: s = 10 u^3 - 15 u^4 + 6 u^5, u = t / duration.

    Args:
        places: Shares of the way, 0 to 1. Shape (k,).
        duration: Time of the whole move. [s]

    """
    u = np.linspace(0.0, 1.0, 4001)
    return np.asarray(duration * np.interp(places, ease(u), u))


def ease_duration(distance: Array, velocity_limits: Array, acceleration_limits: Array) -> float:
    """Return the time that a gentle move needs: greatest speed 1.875 d / T, greatest acceleration 5.774 d / T^2 [s]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        by_speed = np.nan_to_num(1.875 * distance / velocity_limits).max(initial=0.0)
        by_push = np.sqrt(np.nan_to_num(5.774 * distance / acceleration_limits).max(initial=0.0))
    return float(max(by_speed, by_push))


@dataclass(frozen=True)
class _Law:
    """A profile of piecewise constant acceleration; at rest before and after."""

    time: Array
    along: Array
    speed: Array
    rate: Array
    area: Array

    def at(self, when: Array) -> tuple[Array, Array]:
        """Return place and speed."""
        piece, past = self._find(when)
        place = self.along[piece] + past * (self.speed[piece] + 0.5 * past * self.rate[piece])
        speed = self.speed[piece] + past * self.rate[piece]
        over, under = when >= self.time[-1], when <= 0
        place = np.where(over, self.along[-1], np.where(under, self.along[0], place))
        return place, np.where(over | under, 0.0, speed)

    def area_at(self, when: Array) -> Array:
        """Return the integral of the place from time 0 on."""
        piece, past = self._find(when)
        grown = self.along[piece] + past * (0.5 * self.speed[piece] + past * self.rate[piece] / 6)
        area = self.area[piece] + past * grown
        beyond = self.area[-1] + self.along[-1] * (when - self.time[-1])
        return np.asarray(np.where(when >= self.time[-1], beyond, np.where(when <= 0, self.along[0] * when, area)))

    def _find(self, when: Array) -> tuple[NDArray[np.int_], Array]:
        piece = np.clip(np.searchsorted(self.time, when, side="right") - 1, 0, len(self.rate) - 1).astype(int)
        return piece, when - self.time[piece]
