"""Whether the cut of a path is stable, waypoint by waypoint: modes of the arm as it stands, engagement of the cutter.

Modes follow from springs and masses with the drives at rest; those of tool and holder are as measured, those of a beam
on the arm, or left out. The arm's damping is not known of any robot here: assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.job.force_prediction import ForcePrediction
from compplan.job.job import Job
from compplan.plan.chatter import MODES
from compplan.plan.frequency_response import fit_responses
from compplan.plan.plan import build_task, prepare_job
from compplan.plan.stable_cut import CutProposal, propose_cut
from compplan.plan.tool_modes import ToolModes, model_beam, read_tool_modes
from compplan.process.cutting import CuttingForce
from compplan.process.force_models.end_mill import EndMillProcess
from compplan.process.stability import (
    CutDynamics,
    Modes,
    Spread,
    count_turns,
    find_coupling_limit,
    find_gains,
    find_limit,
    find_multiplier,
    find_odds,
)
from compplan.robot import Array
from compplan.simulation.vibration import Dynamics, build_dynamics, find_modes
from compplan.toolpath.contact import path_axes, tool_axes
from compplan.toolpath.toolpath import Toolpath, interpolate

#: Postures along the cut whose modes are worked out.
POSTURES = 12
#: Cuts that are told apart at most; waypoints take the verdict of the nearest.
CUTS = 120
#: Spindle speeds and depths of the map, as shares of the job's, and those that are semi-discretised.
SPEEDS, DEPTHS = np.linspace(0.25, 1.75, 61), np.geomspace(0.01, 20.0, 100)
FEW_SPEEDS, FEW_DEPTHS = np.linspace(0.25, 1.75, 13), np.geomspace(0.01, 20.0, 16)


@dataclass(frozen=True)
class StabilityMap:
    """Limits of depth over the spindle speed, at the waypoint that comes nearest to chatter.

    Attributes:
        waypoint: The waypoint.
        depth: Its axial depth. [m]
        speed: Spindle speeds. Shape (a,). [1/s]
        zero_order: Least unstable depth, inf for none. Shape (a,). [m]
        few_speed: Spindle speeds of the next. Shape (b,). [1/s]
        semi_discretised: The same by semi-discretisation. Shape (b,). [m]
        mode_coupling: Depth from which on modes couple without any delay, inf for none. [m]

    """

    waypoint: int
    depth: float
    speed: Array
    zero_order: Array
    few_speed: Array
    semi_discretised: Array
    mode_coupling: float


@dataclass(frozen=True)
class Stability:
    """Verdicts along a path; n waypoints.

    Attributes:
        multiplier: Growth of a vibration in a tooth period, 0 in the air. Shape (n,).
        odds: Probability of chatter, from the spread of masses, damping and coefficients; 0 in the air. Shape (n,).
        zero_order: Whether the zero-order solution calls the cut unstable. Shape (n,).
        frequencies: Natural frequencies at some postures, lowest first. Shape (p, m). [Hz]
        band: Lowest and highest frequency of the modes that were looked at, the tool's included. [Hz]
        damping: Share of critical damping of the arm's modes, assumed.
        masses: Where the robot has its masses from.
        map: Limits at the waypoint nearest to chatter.
        proposal: Speed and depth that are less likely to chatter, or more that is as safe.
        note: What a user has to know.

    """

    multiplier: Array
    odds: Array
    zero_order: NDArray[np.bool_]
    frequencies: Array
    band: tuple[float, float]
    damping: float
    masses: str
    map: StabilityMap | None
    proposal: CutProposal
    note: str

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """Waypoints whose cut chatters, by semi-discretisation. Shape (n,)."""
        return np.asarray(self.multiplier > 1.0)


def judge_stability(found: ForcePrediction) -> tuple[Stability | None, str]:
    """Judge the cut of a job; None and a sentence where that cannot be done, or nothing is milled.

    Args:
        found: Engagement and force along its path.

    """
    job, cutting = found.job, found.law.cutting
    if not isinstance(job.process, EndMillProcess) or cutting is None or not job.stability.judge:
        return None, ""
    try:
        q, dynamics, masses = _find_postures(job, found.nominal)
    except InputError as error:
        return None, f"Stability was not looked at: {error.message}."
    if not dynamics.known and job.stability.arm_modes:
        return None, "Stability was not looked at: the robot folder knows no masses or no springs."
    return _judge(found, cutting, q, dynamics, masses), ""


def _find_postures(job: Job, nominal: Toolpath) -> tuple[Array, Dynamics, str]:
    """Return joint positions at the waypoints of the path, and the robot with its masses."""
    robot, _, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    q = interpolate(nominal.arc_length, task.nominal.arc_length, task.q_start)
    return q, build_dynamics(robot), str(robot.sources.get("masses", "the folder does not say"))


def _judge(found: ForcePrediction, cutting: CuttingForce, q: Array, dynamics: Dynamics, masses: str) -> Stability:
    job, nominal = found.job, found.nominal
    n, table = len(nominal), job.stability
    tool, told = _read_carried(job, cutting)
    carried = tool_axes(nominal, found.law.tool_x)
    spread = Spread(table.frequency_spread, table.damping_spread, cutting.process.uncertainty)
    rows = np.flatnonzero(cutting.engagement.touches & ~nominal.rapid)
    spindle = cutting.process.spindle()
    posture = rows[np.unique(np.linspace(0, len(rows) - 1, min(POSTURES, len(rows))).astype(int))]
    modes = _find_arm(job, dynamics, q[posture])
    near = np.abs(rows[:, None] - posture[None, :]).argmin(axis=1)
    gains = find_gains(cutting.engagement, cutting.process.resistance, spindle.feed_per_tooth(nominal.feed))
    mean, axes = spindle.teeth * gains.mean(axis=1), path_axes(nominal)
    like = _group(mean[rows], near)
    multiplier, odds, zero = np.zeros(n), np.zeros(n), np.zeros(n, bool)

    def stage(row: int) -> CutDynamics:
        whole = modes[int(near[np.searchsorted(rows, row)])]
        whole = whole if tool is None else tool.at(float(nominal.arc_length[row])).join(whole, carried[row])
        return CutDynamics(gains[row], spindle.teeth, 1.0 / (spindle.speed * spindle.teeth), whole.turn(axes[row]))

    cuts = []
    for group in range(like.max() + 1):
        mine = rows[like == group]
        cut = stage(int(mine[len(mine) // 2]))
        multiplier[mine], zero[mine] = find_multiplier(cut), count_turns(cut, np.ones(1))[0] > 0
        odds[mine] = find_odds(cut, spread)
        cuts.append((float(multiplier[mine[0]]), cut))
    worst = int(multiplier.argmax())
    drawn = _draw_map(stage(worst), worst, float(cutting.engagement.axial[worst]), spindle.speed)
    proposal = propose_cut([cut for _, cut in sorted(cuts, key=lambda pair: -pair[0])], spread, spindle.speed,
                           drawn.depth, drawn.speed, drawn.zero_order)  # fmt: skip
    every = np.concatenate([cut.modes.omega for _, cut in cuts]) / (2 * np.pi)
    band, rings = (float(every.min()), float(every.max())), np.array([each.omega / (2 * np.pi) for each in modes])
    damped = f"the arm is damped by {100 * table.damping:.3g} % (assumed, stability.damping)"
    note = _tell(multiplier[rows], odds[rows], band, f"masses: {masses}; {damped}" if table.arm_modes else told)
    passing = spindle.speed * spindle.teeth
    note += (f" {told}" if told and table.arm_modes else "") + _tell_band(band, tool, passing) + proposal.sentence
    return Stability(multiplier, odds, zero, rings, band, table.damping, masses, drawn, proposal, note)


def _find_arm(job: Job, dynamics: Dynamics, q: Array) -> list[Modes]:
    """Return the modes of the arm at some postures, none where measured ones stand for it."""
    if not job.stability.arm_modes:
        return [Modes(np.zeros(0), np.zeros((3, 0)), np.zeros(0)) for _ in q]
    return [Modes(own.omega, own.tip, job.stability.damping) for own in find_modes(dynamics, q, MODES)]


def _read_carried(job: Job, cutting: CuttingForce) -> tuple[ToolModes | None, str]:
    """Return the modes of what the arm carries, None where it counts as rigid, and what a user has to know of them."""
    table, folder = job.stability, job.file.parent
    if table.modes is not None:
        return read_tool_modes(folder / table.modes), f"Measured modes of the tool: {table.modes}."
    if table.frf:
        return fit_responses({axis: folder / name for axis, name in table.frf.items()})
    if job.tool_beam is None:
        return None, ""
    cutter = cutting.bench.cutter
    own = model_beam(job.tool_beam.build(2.0 * cutter.radius, cutter.flute))
    return own, (f"Tool and holder are a beam on the arm (clamp and spindle rigid, assumed), damped by "
                 f"{100 * job.tool_beam.damping:.3g} % (assumed, tool_beam.damping), from "
                 f"{own.omega.min() / (2 * np.pi):.4g} Hz.")  # fmt: skip


def _group(mean: Array, near: NDArray[np.int_]) -> NDArray[np.int_]:
    """Number cuts that are alike: the same posture, mean gain alike; the coarser the more there are. Shape (r,)."""
    size = max(float(np.abs(mean).max()), 1e-300)
    for share in (0.01, 0.03, 0.1, 0.3, 1.0):
        keys = np.column_stack([near, np.round(mean.reshape(len(mean), -1) / (share * size))])
        like = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        if like.max() < CUTS:
            break
    return np.asarray(like)


def _draw_map(cut: CutDynamics, waypoint: int, depth: float, speed: float) -> StabilityMap:
    zero = np.array([find_limit(cut.scaled(speed=share), DEPTHS) for share in SPEEDS])
    semi = np.full(len(FEW_SPEEDS), np.inf)
    for k, share in enumerate(FEW_SPEEDS):
        before = 0.0
        for i, each in enumerate(FEW_DEPTHS):
            grown = find_multiplier(cut.scaled(each, share))
            if grown > 1.0:
                part = 1.0 if i == 0 else (1.0 - before) / (grown - before)
                semi[k] = each**part * FEW_DEPTHS[max(i - 1, 0)] ** (1.0 - part)
                break
            before = grown
    limit = find_coupling_limit(cut)
    return StabilityMap(waypoint, depth, speed * SPEEDS, depth * zero, speed * FEW_SPEEDS, depth * semi, depth * limit)


def _tell(multiplier: Array, odds: Array, band: tuple[float, float], known: str) -> str:
    count = int((multiplier > 1.0).sum())
    seen = f"of modes from {band[0]:.3g} to {band[1]:.3g} Hz"
    verdict = (f"chatters at {count} of {len(multiplier)} waypoints in contact, by the answer {seen}" if count else
               f"shows no chatter {seen} at any of {len(multiplier)} waypoints in contact")  # fmt: skip
    return (f"The cut {verdict} ({known.rstrip('.')}). Probability of chatter, from the "
            f"spread of masses, damping and coefficients (assumed): up to {100 * odds.max():.0f} %.")  # fmt: skip


def _tell_band(band: tuple[float, float], tool: ToolModes | None, passing: float) -> str:
    """Say what was not looked at."""
    if tool is not None:
        return ""
    more = f", while teeth pass at {passing:.3g} Hz" if passing > band[1] else ""
    return (f" Tool, holder and spindle count as rigid: nothing was looked at above {band[1]:.3g} Hz{more}; "
            "[tool_beam] or stability.modes say how they ring.")  # fmt: skip


def mark_spans(unstable: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last waypoint of each unstable stretch."""
    edges = np.diff(np.r_[0, unstable.astype(int), 0])
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return list(zip(first.tolist(), last.tolist(), strict=True))
