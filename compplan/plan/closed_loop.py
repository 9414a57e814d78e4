"""The virtual cell in time: a strategy at 100 Hz on a robot with lag and delay, noisy sensors, and a yielding process.

`compplan.study` asks for many cells and takes loops as linear filters; here one cell runs step by step, with what
is not linear: limiter and anti-windup of the correction, quantised encoders, and a process whose force depends on where
the tool stands, so that a corrected tool meets a higher force, as in forming [Johra2022].

In the loop the tip answers to commands and loads to first order around the expected command; where the tool stood is
then computed exactly for the recorded commands and wrenches. Effects of a robot folder shift tip and readings by what
their forward models say along the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compplan.effects import Effect, apply_effects, attain_scene, command_campaign, stage_scene
from compplan.errors import InputError
from compplan.plan.correction_loop import Loop
from compplan.plan.strategies.answer import Answer
from compplan.plan.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.elastic import loaded_compliance, solve_equilibrium
from compplan.statics.encoders import actuator_selection
from compplan.statics.sensitivity import attain_pose


@dataclass(frozen=True)
class TimeCell:
    """A cell; defaults are a cell without any fault.

    Attributes:
        robot: The robot that stands in it, with its tool; its compliances may differ from the model's.
        effects: What else is wrong with it.
        motor_noise: Noise of the motor-side encoders, one standard deviation. [rad]
        link_noise: Noise of the link-side encoders. [rad]
        motor_step: Step of the motor-side encoders, 0 for none. [rad]
        link_step: Step of the link-side encoders. [rad]
        force_noise: Noise of the force sensor. Shape (6,). [N, N m]
        force_bias: Its bias. Shape (6,). [N, N m]
        force_gain: Its relative error of gain.
        process_stiffness: How the force falls as the tool leaves the path: dF = -K (attained - nominal), base axes.
            Shape (3, 3). [N/m]
        axis_lag: Lag of the axes behind the programmed path. [s]
        most_correction: Limit of the online correction at the tip. [m]
        seed: Seed of the noise.

    """

    robot: Robot
    effects: tuple[Effect, ...] = ()
    motor_noise: float = 0.0
    link_noise: float = 0.0
    motor_step: float = 0.0
    link_step: float = 0.0
    force_noise: Array = field(default_factory=lambda: np.zeros(6))
    force_bias: Array = field(default_factory=lambda: np.zeros(6))
    force_gain: float = 0.0
    process_stiffness: Array = field(default_factory=lambda: np.zeros((3, 3)))
    axis_lag: float = 0.0
    most_correction: float = 0.010
    seed: int = 0


@dataclass(frozen=True)
class TimeRun:
    """What happened; k periods.

    Attributes:
        time: Shape (k,). [s]
        nominal: Wanted tip. Shape (k, 3). [m]
        attained: Where the loaded tool stood. Shape (k, 3). [m]
        wrench: Wrench that acted on the tool. Shape (k, 6). [N, N m]
        correction: Joint correction in effect. Shape (k, nq). [rad or m]
        limited: Periods in which the limiter held the correction. Shape (k,).

    """

    time: Array
    nominal: Array
    attained: Array
    wrench: Array
    correction: Array
    limited: Array

    @property
    def distance(self) -> Array:
        """Distance of the tip from the path. Shape (k,). [m]"""
        return np.asarray(np.linalg.norm(self.attained - self.nominal, axis=1))


@dataclass(frozen=True)
class _Track:
    """Everything that is known along the path before the run, at the periods of the loop."""

    q: Array
    q_rest: Array
    wrench: Array
    nominal: Array
    expected: Array
    gain: Array
    tip: Array
    joint_answer: Array
    wrench_answer: Array
    reading: Array
    reading_answer: Array
    shift: Array
    reading_shift: Array


def run_in_time(
    task: PlanTask, answer: Answer, cell: TimeCell, *, loop: Loop | None = None, seconds: float | None = None
) -> TimeRun:
    """Run a strategy in a cell in time.

    Args:
        task: The task; its wrench acts where the tool stands on the path.
        answer: The strategy.
        cell: The cell.
        loop: Correction loop in place of the strategy's own, such as one that is unstable.
        seconds: How long to run; the whole path if left out.

    Raises:
        InputError: If the strategy learns from part to part: that is no matter of time.

    """
    if answer.sensor == "tracker":
        raise InputError(f"strategy {answer.name!r} learns from part to part, it has no loop in time")
    loop = loop or answer.loop
    period = 0.01 if loop is None else loop.period
    chain = _controlled_chain(build_chain(cell.robot), answer)
    times = np.concatenate([[0.0], np.cumsum(task.step_time)])
    count = int(min(times[-1], np.inf if seconds is None else seconds) / period) + 1
    time = np.asarray(np.arange(count) * period, float)
    track = _lay_track(task, answer, cell, chain, np.interp(time, times, np.arange(len(times))))
    law = _Law(loop, task.robot.nq)
    rng = np.random.default_rng(cell.seed)
    wrench, correction = np.empty((count, 6)), np.empty((count, task.robot.nq))
    limited = np.zeros(count, bool)
    tip, acting = track.tip[0], track.wrench[0]
    lagging = _lag(track.q_rest, cell.axis_lag, period)
    base = lagging - track.q_rest
    for k in range(count):
        reading = _read(answer, cell, track, k, acting, rng)
        wanted = track.q[k] - track.q_rest[k] + track.gain[k] @ (reading - track.expected[k])
        correction[k], limited[k] = law.step(wanted, track.joint_answer[k], cell.most_correction)
        moved = track.q_rest[k] + correction[k] + base[k] - track.q[k]
        tip = track.tip[k] + track.joint_answer[k] @ moved + track.shift[k]
        acting = track.wrench[k].copy()
        if cell.process_stiffness.any():
            yielding = np.eye(3) + track.wrench_answer[k][:, :3] @ cell.process_stiffness
            away = np.linalg.solve(yielding, tip - track.nominal[k])
            acting[:3] -= cell.process_stiffness @ away
        wrench[k] = acting
    noise = _held_noise(answer, cell, rng, count, task.robot.nq)
    loaded = solve_equilibrium(chain, lagging + correction + noise, wrench, tolerance=1e-10)
    return TimeRun(time, track.nominal, loaded.position + track.shift, wrench, correction, limited)


class _Law:
    """A PI or PID law with limiter, conditional integration, delay and lag; without a loop what is wanted is sent."""

    def __init__(self, loop: Loop | None, nq: int) -> None:
        self.loop = loop
        self.total, self.last = np.zeros(nq), np.zeros(nq)
        self.sent, self.attained = np.zeros(nq), np.zeros(nq)
        if loop is not None:
            top, bottom = loop.robot
            self.weights, self.decay = top, -bottom[1] if len(bottom) > 1 else 0.0
            self.line = np.zeros((len(top), nq))

    def step(self, wanted: Array, answer: Array, most: float) -> tuple[Array, bool]:
        """Take the correction one period on; return what is in effect and whether the limiter holds it."""
        loop = self.loop
        if loop is None:
            return _limit(wanted, answer, most)
        # what the law sent one period ago reaches the robot now
        self.line = np.vstack([self.sent, self.line[:-1]])
        self.attained = self.decay * self.attained + self.weights @ self.line
        error = wanted - (self.sent if loop.error == "sent" else self.attained)
        total = self.total + error * loop.period / loop.integral
        slope = loop.derivative / loop.period * (error - self.last)
        self.sent, limited = _limit(loop.gain * (error + total + slope), answer, most)
        if not limited:
            self.total = total
        self.last = error
        return self.attained.copy(), limited


def _limit(correction: Array, answer: Array, most: float) -> tuple[Array, bool]:
    """Shorten a correction that moves the tip further than allowed."""
    size = float(np.linalg.norm(answer @ correction))
    return (correction * (most / size), True) if size > most else (correction, False)


def _read(
    answer: Answer, cell: TimeCell, track: _Track, k: int, wrench: Array, rng: np.random.Generator
) -> Array:
    """Read the strategy's sensor as it stands after the last period."""
    if answer.sensor == "force":
        noise = rng.standard_normal(6) * cell.force_noise
        return np.asarray((1.0 + cell.force_gain) * wrench + cell.force_bias + noise)
    if answer.sensor == "encoders":
        true = track.reading[k] + track.reading_answer[k] @ (wrench - track.wrench[k]) + track.reading_shift[k]
        link = track.q[k] + true + cell.link_noise * rng.standard_normal(len(true))
        motor = track.q[k] + cell.motor_noise * rng.standard_normal(len(true))
        difference = _quantise(link, cell.link_step) - _quantise(motor, cell.motor_step)
        return np.where(track.reading_answer[k].any(axis=1), difference, 0.0)
    return np.zeros(track.expected.shape[1])


def _quantise(values: Array, step: float) -> Array:
    return values if step <= 0.0 else np.round(values / step) * step


def _held_noise(answer: Answer, cell: TimeCell, rng: np.random.Generator, count: int, nq: int) -> Array:
    """Draw what the noise of the encoders that hold the axes makes of the joints. Shape (count, nq). [rad]"""
    gain = answer.spring_gain
    motor = cell.motor_noise * rng.standard_normal((count, nq)) + cell.motor_step * (rng.random((count, nq)) - 0.5)
    link = cell.link_noise * rng.standard_normal((count, nq)) + cell.link_step * (rng.random((count, nq)) - 0.5)
    return np.asarray(-gain * motor - (1.0 - gain) * link)


def _controlled_chain(chain: Chain, answer: Answer) -> Chain:
    """Scale the gears' compliances by what the feedback leaves of them."""
    between = np.abs(actuator_selection(chain))
    scale = np.where(between.any(axis=0), answer.spring_gain @ between, 1.0)
    return replace(chain, compliance=chain.compliance * scale)


def _lag(q: Array, lag: float, period: float) -> Array:
    """Let the axes follow with a lag of the first order."""
    from scipy.signal import lfilter

    if lag <= 0.0:
        return q
    decay = float(np.exp(-period / lag))
    return q[0] + np.asarray(lfilter([1.0 - decay], [1.0, -decay], q - q[0], axis=0))


def _lay_track(task: PlanTask, answer: Answer, cell: TimeCell, chain: Chain, at: Array) -> _Track:
    """Work out at every waypoint, then interpolate to the periods of the loop."""
    n, nq = answer.q.shape
    attained = attain_pose(chain, answer.q, task.wrench)
    compliance = loaded_compliance(chain, answer.q, task.wrench)
    sensed = 1 if answer.expected is None else answer.expected.shape[1]
    true = build_chain(cell.robot)
    loaded = solve_equilibrium(true, answer.q, task.wrench)
    selection = actuator_selection(true)
    gear = np.abs(selection) @ np.diag(true.compliance)
    from compplan.statics.chain import jacobian

    columns = jacobian(true, loaded.frames)[:, :, true.spring_elements]
    shift, reading_shift = _shift_by_effects(cell, answer.q, task)
    known = {
        "q": answer.q,
        "q_rest": answer.q if answer.q_rest is None else answer.q_rest,
        "wrench": task.wrench,
        "nominal": task.position,
        "expected": np.zeros((n, sensed)) if answer.expected is None else answer.expected,
        "gain": np.zeros((n, nq, sensed)) if answer.gain is None else answer.gain,
        "tip": attained.position,
        "joint_answer": attained.jacobian[:, :3],
        "wrench_answer": compliance[:, :3],
        "reading": gear * (loaded.torque @ selection.T),
        "reading_answer": gear[:, None] * np.einsum("js,nks->njk", selection, columns),
        "shift": shift,
        "reading_shift": reading_shift,
    }
    before = np.minimum(at.astype(int), n - 2)
    share = at - before

    def follow(values: Array) -> Array:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[before] * (1.0 - weight) + values[before + 1] * weight)

    return _Track(**{name: follow(np.asarray(values, float)) for name, values in known.items()})


def _shift_by_effects(cell: TimeCell, q: Array, task: PlanTask) -> tuple[Array, Array]:
    """Return what the effects make of the tip (n, 3) [m] and of link-side less motor-side readings (n, nq) [rad]."""
    if not cell.effects:
        return np.zeros((len(q), 3)), np.zeros_like(q)

    def attain(effects: Sequence[Effect]) -> tuple[Array, Array]:
        time = np.r_[0.0, np.cumsum(task.step_time)]
        scene = stage_scene(cell.robot, command_campaign(q, task.wrench, time=time), later=True)
        attained = attain_scene(apply_effects(scene, effects))
        return attained.position, attained.link - attained.motor

    changed, plain = attain(cell.effects), attain(())
    return changed[0] - plain[0], changed[1] - plain[1]
