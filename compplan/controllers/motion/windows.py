"""Windows: sections of programs with their log rows, simulated with a motion model and compared with it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path as File
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.motion.align import find_nearest, measure_way, place_rows
from compplan.controllers.motion.geometry import STEP, Nodes, Path, build_path, follow_path, locate_nodes
from compplan.controllers.motion.instructions import read_instructions
from compplan.controllers.motion.log import Log, read_log
from compplan.controllers.motion.run import follow_command, lag_command, schedule_path
from compplan.controllers.writers.motion_table import ServoMotion
from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import Arm
from compplan.toolpath.toolpath import interpolate

#: Greatest number of placed rows of a log, of rows in a window, and of windows of all logs.
MOST_PLACED, MOST_ROWS, MOST_WINDOWS = 100_000, 500, 8
#: Approximate number of points of a program path on which a log is placed; windows use the usual point spacing.
MOST_POINTS = 100_000
#: Duration of a window, and of the execution before and after its rows, so that it runs as in the full program. [s]
WINDOW, LEAD = 5.0, 0.5
#: Median distance of rows from the program above which a log belongs to another program. [m]
OTHER_PROGRAM = 0.05
#: Path points to either side in the search for the nearest point of a row.
BESIDE = 25
#: Tip speed below which the robot rests. [m/s]
RESTING = 5e-4


@dataclass(frozen=True)
class Window:
    """A section of a program with rows of the log."""

    log: int  #: Index of its log.
    nodes: Nodes  #: Moves, from some before the rows to some after.
    s: Array  #: Length of every row along the programmed path of the section. Shape (n,). [m]
    q: Array  #: Joints of the rows. Shape (n, nq). [rad or m]
    rate: Array  #: Joint rates of the rows. Shape (n, nq). [rad/s or m/s]
    tip: Array  #: Nominal tips of the rows. Shape (n, 3). [m]
    torn_shift: Array  #: Tip displacement due to torn readings. Shape (n, 3). [m]
    point: Array  #: Nearest points of the programmed path. Shape (n, 3). [m]
    leverage: Array  #: Root-mean-square tip displacement per joint motion. Shape (nq,). [m/rad]
    programmed: Path  #: The path without blends.
    #: Executed paths by blend share, as far as computed, and the length of every row along each. [m]
    laid: dict[float, tuple[Path, Array]] = field(default_factory=dict)
    #: Latest command (`command`), position of the rows in it (`at`), and model parameters of both (`key`).
    latest: dict[str, Any] = field(default_factory=dict)

    @property
    def departure(self) -> Array:
        """Distance of every row across the programmed path. Shape (n,). [m]"""
        return np.asarray(np.linalg.norm(self.tip + self.torn_shift - self.point, axis=1))

    def lay_path(self, arm: Arm, blend_share: float) -> tuple[Path, Array]:
        """Return the executed path at a blend share, and the length along it of the point nearest to every row. [m]"""
        key = round(blend_share, 4)
        if key not in self.laid:
            path, sharp = build_path(self.nodes, arm, key), self.programmed
            guess = np.searchsorted(path.s, self.s * path.s[-1] / sharp.s[-1]).clip(0, len(path.s) - 1)
            _, share = find_nearest(path.position, guess, interpolate(self.s, sharp.s, sharp.position), BESIDE)
            self.laid[key] = path, np.interp(share, np.arange(len(path.s)), path.s)
        return self.laid[key]


@dataclass(frozen=True)
class PlacedLog:
    """A log placed on its program."""

    log: Log  #: The log.
    nodes: Nodes  #: Ends of the program's moves.
    rows: NDArray[np.int_]  #: Placed rows of the log. Shape (n,).
    s: Array  #: Their lengths along the programmed path. Shape (n,). [m]
    point: Array  #: Their nearest points of the programmed path. Shape (n, 3). [m]
    programmed: Path  #: The programmed path.


def load_trace(file: File, program: File, robot: Robot, arm: Arm) -> PlacedLog:
    """Read a log and its program, and find the position of every row on the program.

    Raises:
        InputError: If one of the files is not valid, or the log is of another program.
    """
    log, instructions = read_log(file, robot), read_instructions(program, robot)
    nodes = locate_nodes(instructions, arm, log.q[0])
    programmed = build_path(nodes, arm, 0.0, max(STEP, float(nodes.length.sum()) / MOST_POINTS))
    rows = np.arange(0, len(log), max(1, -(-len(log) // MOST_PLACED)))
    tip = locate_frames(arm.chain, log.q[rows]).tcp_position
    s, point = place_rows(programmed, tip, measure_way(log.time[rows], tip))
    usual = float(np.median(np.linalg.norm(tip - point, axis=1)))
    if usual > OTHER_PROGRAM:
        message = f"its rows are {1e3 * usual:.0f} mm off the path of {program} (median); is it the log of this program"
        raise InputError(f"{message}, and are the units in its column names right?", file=file)
    return PlacedLog(log, nodes, rows, s, point, programmed)


def cut_windows(traces: list[PlacedLog], arm: Arm) -> list[Window]:
    """Cut the logs into windows of some seconds; of too many choose evenly, the same number from each log."""
    windows: list[Window] = []
    for number, trace in enumerate(traces):
        spans = _divide_rows(trace)
        most = max(2, MOST_WINDOWS // len(traces))
        chosen = np.unique(np.linspace(0, len(spans) - 1, min(most, len(spans))).round().astype(int))
        windows += [window for k in chosen if (window := _cut_window(trace, number, spans[k], arm)) is not None]
    if not windows:
        raise InputError("no row moves along the program, expected the log of a program that runs",
                         file=traces[0].log.file)  # fmt: skip
    return windows


def _divide_rows(trace: PlacedLog) -> list[tuple[int, int]]:
    """Divide the rows by time; return the first row and the one after the last of each span."""
    time = trace.log.time[trace.rows]
    count = max(1, round((time[-1] - time[0]) / WINDOW))
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1))
    edges[-1] = len(time)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b - a > 5]


def _cut_window(trace: PlacedLog, number: int, span: tuple[int, int], arm: Arm) -> Window | None:
    log, ends, feed = trace.log, trace.programmed.ends, trace.nodes.instructions.feed
    part = slice(*span)
    s, rows = trace.s[part], trace.rows[part]
    speed = np.linalg.norm(_tip_rate(arm, log.q[rows], log.rate[rows]), axis=1)
    moves = (speed > RESTING) & (s > ends[0]) & (s < ends[-1])
    if moves.sum() < 10:
        return None
    lead = LEAD * float(feed.max())
    time = trace.log.time[rows]
    moves &= np.abs(s - np.median(s[moves])) < 2.0 * lead + float(feed.max() * (time[-1] - time[0]))  # reachable only
    first = max(0, int(np.searchsorted(ends, s[moves].min() - lead, "right")) - 1)
    last = min(len(ends) - 1, int(np.searchsorted(ends, s[moves].max() + lead)))
    keep = np.flatnonzero(moves)
    keep = keep[:: max(1, -(-len(keep) // MOST_ROWS))]
    chosen = rows[keep]
    q, raw = log.q[chosen], log.raw[chosen]
    tip = locate_frames(arm.chain, q).tcp_position
    torn_shift = locate_frames(arm.chain, raw).tcp_position - tip
    levers = np.stack([_tip_rate(arm, q, np.tile(row, (len(q), 1))) for row in np.eye(q.shape[1])])
    leverage = np.sqrt((levers**2).sum(axis=2).mean(axis=1)) + 0.02
    nodes = _slice_nodes(trace.nodes, first, last + 1)
    return Window(number, nodes, s[keep] - ends[first], q, log.rate[chosen], tip, torn_shift,
                  trace.point[part][keep], leverage, build_path(nodes, arm, 0.0))  # fmt: skip


def _tip_rate(arm: Arm, q: Array, rate: Array) -> Array:
    """Return velocities of the tip. Shape (n, 3). [m/s]"""
    step = 1e-5
    ahead, back = (locate_frames(arm.chain, q + sign * step * rate).tcp_position for sign in (1.0, -1.0))
    return np.asarray((ahead - back) / (2 * step))


def _slice_nodes(nodes: Nodes, first: int, end: int) -> Nodes:
    """Return some of the moves; the first one is the start of the section."""
    part, moves = slice(first, end), nodes.instructions
    cut = replace(moves, **{key: values[part] for key, values in vars(moves).items() if key != "file"})
    length = nodes.length[part].copy()
    length[0] = 0.0
    return Nodes(cut, nodes.q[part], nodes.position[part], nodes.rotation[part], length)


#: Cycle at which windows are simulated, and the rest after them. [s]
CYCLE, REST = 0.004, 0.2
#: Time to either side in the search for the nearest point of a run. [s]
NEAR = 0.04


@dataclass(frozen=True)
class WindowRun:
    """A window as executed by a motion model."""

    command: Array  #: Commanded joints. Shape (k, nq). [rad or m]
    q: Array  #: Joints reached by the drives. Shape (k, nq). [rad or m]
    at: Array  #: Position of every row of the window, in rows of the run. Shape (n,).

    @cached_property
    def here(self) -> tuple[Array, Array]:
        """Joints at each row of the window, and their change per row of the run. Shape (n, nq) twice."""
        return read_run(self.q, self.at)


def run_window(window: Window, motion: ServoMotion, arm: Arm) -> WindowRun:
    """Execute a window and find its rows in the run: first by path length, then as nearest points in joint space."""
    key = motion.blend_share, motion.acceleration, motion.smoothing
    if window.latest.get("key") != key:
        path, lengths = window.lay_path(arm, motion.blend_share)
        scheduled = schedule_path(path, replace(motion, cycle=CYCLE))
        s = np.r_[scheduled, np.full(round(REST / CYCLE), scheduled[-1])]
        at = np.interp(lengths, s + 1e-9 * np.arange(len(s)), np.arange(len(s)))
        command = follow_path(path, s)
        window.latest.update(key=key, command=command, at=at)
    command, at = window.latest["command"], window.latest["at"]
    q = follow_command(command, replace(motion, cycle=CYCLE))
    return WindowRun(command, q, _match_rows(window, q, at + float(motion.lag.mean()) / CYCLE))


def _match_rows(window: Window, q: Array, at: Array) -> Array:
    """Move the rows along a run to the nearest joints, weighted by their leverage on the tip."""
    for _ in range(4):
        here, slope = read_run(q, at)
        slope = slope * window.leverage
        gap = (window.q - here) * window.leverage
        size = (slope**2).sum(axis=1)
        step = (gap * slope).sum(axis=1) / np.maximum(size, 1e-16)
        at = np.clip(at + np.where(size > 1e-12, np.clip(step, -15.0, 15.0), 0.0), 0.0, len(q) - 1.0)
    return at


def read_run(q: Array, at: Array) -> tuple[Array, Array]:
    """Return joints and their change per row at positions of a run. Shape (n,) -> (n, nq) twice."""
    i = np.clip(at.astype(int), 1, len(q) - 3)
    u = (at - i)[:, None]
    before, here, after, last = q[i - 1], q[i], q[i + 1], q[i + 2]
    c1, c2 = 0.5 * (after - before), before - 2.5 * here + 2 * after - 0.5 * last
    c3 = 0.5 * (last - before) + 1.5 * (here - after)
    return here + u * (c1 + u * (c2 + u * c3)), c1 + u * (2 * c2 + 3 * u * c3)


def find_residual(window: Window, run: WindowRun) -> Array:
    """Return the distances of rows across a run, in joints weighted by their leverage. Shape (n, nq). [m]"""
    here, slope = run.here
    gap, slope = (window.q - here) * window.leverage, slope * window.leverage
    size = np.maximum((slope**2).sum(axis=1), 1e-16)
    return np.asarray(gap - ((gap * slope).sum(axis=1) / size)[:, None] * slope)


def locate_beside(window: Window, run: WindowRun, q: Array, arm: Arm) -> Array:
    """Return the point of a run's tip path that is nearest to every row. Shape (n, 3). [m]"""
    tip = locate_frames(arm.chain, q).tcp_position
    index = np.round(run.at).astype(int)
    return find_nearest(tip, index, window.tip + window.torn_shift, round(NEAR / CYCLE))[0]


def measure_left(window: Window, motion: ServoMotion, arm: Arm) -> Array:
    """Return the distance of every row, torn or not, across the executed path of a model. Shape (n,). [m]"""
    run = run_window(window, motion, arm)
    return np.asarray(np.linalg.norm(window.tip + window.torn_shift - locate_beside(window, run, run.q, arm), axis=1))


def divide_gap(window: Window, motion: ServoMotion, arm: Arm) -> dict[str, Array]:
    """Divide the distance of rows across the programmed path among its causes.

    Each cause is the step from one executed path to the next at its nearest points: blends, then lag, then lost motion.
    The share of torn readings is the tip displacement of their correction.

    Returns:
        Vectors by cause, and `gap` for their total. Shape (n, 3) each. [m]
    """
    run = run_window(window, motion, arm)
    lagged = lag_command(run.command, motion.lag, motion.acceleration_lag, CYCLE)
    shift = float(motion.lag.mean()) / CYCLE
    early = replace(run, at=np.maximum(run.at - shift, 0.0))
    untorn = replace(window, torn_shift=np.zeros_like(window.torn_shift))
    blended = locate_beside(untorn, early, run.command, arm)
    lagging, reached = locate_beside(untorn, run, lagged, arm), locate_beside(untorn, run, run.q, arm)
    return {
        "gap": window.tip + window.torn_shift - window.point,
        "lag": lagging - blended,
        "blend": blended - window.point,
        "jitter": window.torn_shift,
        "lost_motion": reached - lagging,
    }
