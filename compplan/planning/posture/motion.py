"""What the motion of joints costs in accuracy: gear error, lost motion, and the inertia of joints that change rates.

A joint j with lever r_j (the tip's motion per joint motion) that travels dq over an edge of the path, which is the
share s of the cut and takes T, is priced at, as a mean square over the cut,

    s r_j^2 [ (a^2 / 2 + b^2 / 4) min(dq / (s P), 1)^2 + (dq / (T t w^2))^2 ],

a the gear error with the period P, b the lost motion (a joint that travels may turn back), w the lowest natural
frequency, and t the time in which the feed goes 100 mm: within it a joint takes up or gives up its rate dq / T. The
finished posture is measured as it is, turns and accelerations included.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames
from compplan.toolpath.toolpath import Toolpath, interpolate, pick_even

#: Motion against the last one of less than this is no reversal. [rad or m]
STILL = 1e-6
#: Waypoints that are looked at, and instants of a motion at most.
LOOKED_AT, INSTANTS = 400, 20_000


class MotionFigures(NamedTuple):
    """What gears and inertia are assumed to do, or what the robot folder says of them."""

    gear: float = float(np.radians(0.002))  #: Amplitude of the gear error of turning joints. [rad]
    periods: float = 60.0  #: Its periods a turn.
    lost: float = float(np.radians(0.002))  #: Lost motion of turning joints, full width. [rad]
    frequency: float = 10.0  #: Lowest natural frequency of the arm. [Hz]
    source: str = "assumed"  #: Where they come from.
    #: Whether job or robot folder state them; the preset "accurate" prices motion by no assumed figure.
    stated: bool = False


@dataclass(frozen=True)
class MotionPrice:
    """What edges of the graph pay for the motion of joints."""

    #: Mean square motion of the tip per joint motion over the usable nodes. Shape (nq,). [mm^2/rad^2 or mm^2/m^2]
    lever: Array
    slides: NDArray[np.bool_]  #: Which joints slide; gears are those of turning joints. Shape (nq,).
    figures: MotionFigures  #: What gears and inertia do.

    def cost(self, square: Array, j: int, share: float, duration: float, settle: float) -> Array:
        """Price squared motions of joint j [rad^2 or m^2] over an edge of the path. [mm^2]

        The edge is a share of the cut and takes a duration at the programmed feed [s]; a joint takes up a rate within
        `settle`. [s]
        """
        figures = self.figures
        bend = duration * settle * (2 * np.pi * figures.frequency) ** 2
        whole = share * float(self.lever[j])
        moved = whole / max(bend, 1e-12) ** 2
        if self.slides[j]:
            return np.asarray(square * moved)
        price = np.minimum(square * (figures.periods / (2 * np.pi * share)) ** 2, 1.0)
        price *= whole * (0.5 * figures.gear**2 + 0.25 * figures.lost**2)
        price += square * moved
        return np.asarray(price)


def price_motion(chain: Chain, q: Array, slides: NDArray[np.bool_], figures: MotionFigures) -> MotionPrice:
    """Find what motion costs around postures q (n, nq)."""
    some = pick_even(q, LOOKED_AT)
    columns = joint_jacobian(chain, locate_frames(chain, some))[:, :3]
    return MotionPrice(1e6 * np.einsum("nij,nij->j", columns, columns) / len(some), slides, figures)


def measure_travel_error(
    chain: Chain, q: Array, shares: Array, slides: NDArray[np.bool_], *, gear: float, periods: float, lost: float
) -> float:
    """Measure what gears do to the tip while joints travel along a path (n, nq): rms over the cut. [m]

    A gear error of amplitude a [rad] and n periods a turn varies by a / sqrt(2) where the joint travels a period and
    more, by less in proportion below; lost motion b, full width [rad], is off by b / 2 in a joint that turns back on
    the path. What a joint that stands still is off by is a constant that touching off takes away. `shares` (n,) of the
    cut as of `cut_shares`; joints that slide (nq,) are left out.
    """
    steps = np.diff(q, axis=0)
    period = 2 * np.pi / periods
    span = np.abs(steps).sum(axis=0)
    back = (steps > STILL).any(axis=0) & (steps < -STILL).any(axis=0)
    error = np.hypot(gear / np.sqrt(2.0) * np.minimum(span / period, 1.0), 0.5 * lost * back)
    error[slides] = 0.0
    rows = np.flatnonzero(shares > 0)
    if not len(rows):
        return 0.0
    rows = pick_even(rows, LOOKED_AT)
    columns = joint_jacobian(chain, locate_frames(chain, q[rows]))[:, :3]
    square = np.einsum("nij,j->n", columns**2, error**2)
    weight = shares[rows] / shares[rows].sum()
    return float(np.sqrt((weight * square).sum()))


def measure_inertia_error(chain: Chain, q: Array, nominal: Toolpath, frequency: float) -> float:
    """Measure how far the joints' own accelerations bend the arm along a path (n, nq) at the programmed feed: rms. [m]

    A mass on a spring of the natural frequency w [Hz] lags an acceleration x'' by x'' / w^2; joints are taken one by
    one, each with its lever, and accelerations as means over a period, which a smoothed motion has.
    """
    feed, rapid, period = nominal.feed[1:], nominal.rapid[1:], 1.0 / frequency
    times = np.where(rapid | (feed <= 0), 0.0, nominal.steps / np.maximum(feed, 1e-9))
    edges = np.diff(np.r_[0, (~rapid & (times > 0)).astype(int), 0])
    total = count = 0.0
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        time = np.r_[0.0, np.cumsum(times[first:last])]
        if time[-1] < 3 * period:
            continue
        step = max(period, float(time[-1]) / INSTANTS)
        when = np.arange(0.0, time[-1], step)
        run = interpolate(when, time, q[first : last + 1])
        push = np.diff(run, 2, axis=0) / step**2
        some = pick_even(np.arange(len(push)), LOOKED_AT)
        columns = joint_jacobian(chain, locate_frames(chain, run[1:-1][some]))[:, :3]
        square = np.einsum("nij,nj->n", columns**2, push[some] ** 2) / (2 * np.pi * frequency) ** 4
        total, count = total + float(square.mean()) * float(time[-1]), count + float(time[-1])
    return float(np.sqrt(total / max(count, 1e-12)))


#: Stroke between two reversals of a rail below which it does not move (assumed: racks and screws lose and repeat
#: hundredths to tenths of a millimetre); as many times what a folder says of its lost motion. [m]
LEAST_STROKE, TIMES_LOST = 1e-3, 3.0
#: The same of a turning joint that carries the part (assumed). [rad]
LEAST_TURN = float(np.radians(1.0))


#: Less lost motion is none (assumed). [rad or m]
LEAST_PLAY = 1e-6


def is_play(entry: Mapping[str, Any]) -> bool:
    """Tell whether an effect of a folder is lost motion that a command can lead."""
    return entry.get("effect") == "backlash" and width_of(entry) > LEAST_PLAY


def width_of(entry: Mapping[str, Any]) -> float:
    """Return the width of a backlash. [rad or m]"""
    values = entry.get("parameters", {})
    return float(values.get("width_rad", values.get("width_m", 0.0)))


def list_plays(robot: Robot) -> Array:
    """Return the width of the lost motion that a robot folder states of every joint. Shape (nq,). [rad or m]"""
    widths = np.zeros(robot.nq)
    for entry in filter(is_play, robot.effects):
        # names that the robot does not have are refused where the effects are built
        widths += width_of(entry) * (np.array(robot.joint_names) == entry["joint"])
    return widths


def least_strokes(robot: Robot) -> Array:
    """Return the least stroke of every joint that slides or carries the part, 0 for the others. (nq,). [m or rad]."""
    stroke = np.where(robot.prismatic, LEAST_STROKE, np.where(robot.carriers, LEAST_TURN, 0.0))
    return np.where(stroke > 0.0, np.maximum(stroke, TIMES_LOST * list_plays(robot)), 0.0)


def steady_slide(positions: Array, stroke: float) -> Array:
    """Take the small reversals out of the positions of a slide along a path. Shape (n,). [m]

    Between turning points that lie at least a stroke [m] apart the slide moves one way only; a slide whose whole motion
    is less stands still. No position moves by a stroke or more.
    """
    if not len(positions) or np.ptp(positions) < stroke:
        return np.full(len(positions), 0.5 * (positions.max() + positions.min()) if len(positions) else 0.0)
    turns = _turning_points(positions, stroke)
    steady = np.array(positions, float)
    for first, last in itertools.pairwise(turns):
        part = positions[first : last + 1]
        rising = part[-1] > part[0]
        run = np.maximum.accumulate(part) if rising else np.minimum.accumulate(part)
        steady[first : last + 1] = np.clip(run, min(part[0], part[-1]), max(part[0], part[-1]))
    steady[: turns[0]], steady[turns[-1] :] = steady[turns[0]], steady[turns[-1]]
    return steady


def _turning_points(positions: Array, stroke: float) -> list[int]:
    """List the rows of alternating extremes, each at least a stroke away from the one before."""
    low = high = 0
    rising: bool | None = None
    turns: list[int] = []
    for k, value in enumerate(positions.tolist()):
        if value > positions[high]:
            high = k
        if value < positions[low]:
            low = k
        if rising is not True and value - positions[low] >= stroke:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and positions[high] - value >= stroke:
            turns.append(high)
            rising, low = False, k
    turns.append(high if rising else low)
    return turns


def find_torn(q: Array, nominal: Toolpath, most_step: float) -> NDArray[np.bool_]:
    """Tell which waypoints of a cut a joint would have to jump to."""
    torn = np.zeros(len(q), bool)
    torn[1:] = np.abs(np.diff(q, axis=0)).max(axis=1) > most_step
    return torn & ~nominal.rapid
