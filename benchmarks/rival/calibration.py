"""A plain calibration: offsets and link geometry of all joints, base and tool, and a compliance a joint.

The unknowns are those of any calibration of a serial arm; dependent ones are kept apart by a weak pull to the nominal
robot (SPREAD) instead of being removed. Joints of a rigid model bend under the weight of the links, those of an elastic
one change their compliance. It names nothing: it is a measure of what a plain fit can predict.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rival.chain import Array, Chain, read_chain
from benchmarks.rival.greedy import Problem, fit_frames
from benchmarks.rival.log import Log, read_log
from benchmarks.rival.scene import Spec, stage
from benchmarks.rival.signatures import Columns
from benchmarks.rival.vocabulary import AXES

#: Standard deviation of lengths and angles about the nominal robot (assumed), and of frames. [m or rad]
SPREAD, FRAMES = 2e-3, 1.0
#: The same of what columns say of compliances: 1e-6 rad/(N m), and shares of the modelled one (assumed).
PULLS = {"base_frame": FRAMES, "tool_frame": FRAMES, "gravity_sag": 200.0, "joint_stiffness": 1.0}
ROUNDS, FOLDS = 5, 5


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated robot."""

    table: dict[str, Any]  #: gap as in diagnosis.json, and a verdict without names.
    chain: Chain  #: The nominal robot.
    specs: list[Spec]  #: What was fitted.
    value: Array  #: The parameters. [m or rad]
    register: tuple[str, ...]  #: Frames that were unknown.

    def predict(self, log: Log, nominal: bool = False) -> Array:
        """Predict the target of every row of a later campaign, frames registered anew. Shape (n, 3). [m]"""
        scene = stage(self.chain, log, log.q, sagging=False, later=True)
        tip, attitude = scene.posed.tip, scene.posed.attitude
        if not nominal:
            skip = tuple(f"{name}_frame" for name in self.register)
            columns = Columns(scene)
            used = _each(columns, self.specs, lambda effect: float(effect not in skip))
            tip = tip + _stack(columns, self.specs) @ (self.value * used)
        frames = fit_frames(log, tip, attitude, self.register)
        target = tip + np.einsum("nij,nj->ni", attitude, frames.of_targets(log))
        return np.asarray(target @ frames.turn.T + frames.shift)


def _stack(columns: Columns, specs: list[Spec]) -> Array:
    return np.concatenate([_position(columns, s) for s in specs], axis=2)


def _position(columns: Columns, spec: Spec) -> Array:
    position = columns.of(spec).position
    return position[:, :, :3] if spec.effect == "tool_frame" else position


def _each(columns: Columns, specs: list[Spec], number: Callable[[str], float]) -> Array:
    """Return a number of its effect for every column."""
    return np.concatenate([np.full(_position(columns, s).shape[2], number(s.effect)) for s in specs])


def calibrate(robot: Path, measurements: Path, register: Sequence[str] = ()) -> Calibrated:
    """Calibrate a robot's geometry and compliances on a campaign; far rows lose weight (Huber, 3 robust deviations)."""
    chain = read_chain(robot)
    log = read_log(measurements, chain)
    problem = Problem(stage(chain, log, log.q, sagging=False), tuple(register))
    moving = [s.name for s in chain.segments if s.kind != "fixed"]
    specs = [Spec("base_frame"), Spec("tool_frame"), *(Spec("joint_offset", name) for name in chain.joints)]
    specs += [Spec("link_geometry", name, axis) for name in moving for axis in AXES]
    elastic = [g.name for g in chain.segments if any(spring.own for spring in g.springs)]
    specs += [Spec("joint_stiffness", name) for name in elastic if name in chain.joints]
    if not any(g.springs for g in chain.segments):
        specs.append(Spec("gravity_sag"))
    a, gap = _stack(problem.columns, specs), problem.gaps[0]
    pull = _each(problem.columns, specs, lambda effect: PULLS.get(effect, SPREAD))
    rows = np.flatnonzero(log.known)
    value = _solve(a[rows], gap[rows], pull)
    held, fold = gap.copy(), log.stay % FOLDS
    for k in range(FOLDS):
        use = rows[fold[rows] != k]
        held[fold == k] -= a[fold == k] @ _solve(a[use], gap[use], pull)
    after, before = gap - a @ value, gap
    kept = rows[_weights(after[rows]) > 0.5]
    figures = {
        "before_rms_mm": _rms(before[kept]),
        "after_rms_mm": _rms(after[kept]),
        "held_out_before_rms_mm": _rms(before[kept]),
        "held_out_after_rms_mm": _rms(held[kept]),
    }
    table = {"verdict": {"status": "calibrated", "effects": []}, "gap": figures, "candidates": []}
    return Calibrated(table, chain, specs, value, tuple(register))


def _rms(gap: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))


def _weights(left: Array) -> Array:
    miss = np.linalg.norm(left, axis=1)
    far = 3.0 * max(float(np.median(miss)), 1e-9) / 1.54
    return np.asarray(np.minimum(1.0, far / np.maximum(miss, 1e-12)))


def _solve(a: Array, gap: Array, pull: Array) -> Array:
    """Solve the ridged least squares; the noise that weighs the pull is what is left."""
    weights, noise, value = np.ones(len(a)), 1e-3, np.zeros(a.shape[2])
    for _ in range(ROUNDS):
        root = np.sqrt(weights)[:, None]
        m = np.vstack([(a * root[:, :, None]).reshape(-1, a.shape[2]) / noise, np.diag(1.0 / pull)])
        y = np.concatenate([(gap * root).ravel() / noise, np.zeros(a.shape[2])])
        value = np.linalg.lstsq(m, y, rcond=None)[0]
        left = gap - a @ value
        weights = _weights(left)
        noise = max(float(np.median(np.linalg.norm(left, axis=1))) / 1.54, 1e-6)
    return np.asarray(value)
