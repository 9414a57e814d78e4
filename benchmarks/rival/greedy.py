"""Greedy forward selection by BIC over the whole vocabulary, outliers set aside, frames registered where asked."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.rival.chain import Array, Chain
from benchmarks.rival.log import Log
from benchmarks.rival.scene import ForwardModel, Motion, Spec, stage
from benchmarks.rival.signatures import Columns, rotation_gap
from benchmarks.rival.vocabulary import WAVES, list_specs

#: At most so many effects that may be named, and that may predict; share of rows set aside, and times the robust scale
#: from which a row is an outlier.
MOST, WIDE, ASIDE, FAR = 8, 20, 0.03, 6.0
#: Samples of a path count as one pose in so many.
PATH_SHARE = 10
#: Two explanations whose fits differ by less than so many standard deviations over the campaign are the same.
ALIKE = 3.0


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of a campaign."""

    turn: Array = field(default_factory=lambda: np.eye(3))  #: Base axes in the measurement frame. Shape (3, 3).
    shift: Array = field(default_factory=lambda: np.zeros(3))  #: Base origin in the measurement frame. [m]
    points: dict[str, Array] = field(default_factory=dict)  #: Offset of each target in the axes of the tip. [m]
    tool: Array = field(default_factory=lambda: np.eye(3))  #: Turn of the measured body against the axes of the tip.

    def of_targets(self, log: Log) -> Array:
        """Return the offset of each row's target. Shape (n, 3)."""
        return np.array([self.points.get(str(t), np.zeros(3)) for t in log.target])


def fit_frames(log: Log, tip: Array, attitude: Array, register: tuple[str, ...]) -> Frames:
    """Fit base and tool to a campaign, everything else fixed; far rows are set aside."""
    if not register:
        return Frames()
    labels, good = list(dict.fromkeys(map(str, log.target))), log.known.copy()
    turn, shift = np.eye(3), np.zeros(3)
    points = {label: np.zeros(3) for label in labels}
    for step in range(30):
        target = tip + np.einsum("nij,nj->ni", attitude, np.array([points[str(t)] for t in log.target]))
        if "base" in register:
            turn, shift = kabsch(target[good], log.position[good])
        seen = (log.position - shift) @ turn
        for label in labels if "tool" in register else []:
            rows = good & (log.target == label)
            points[label] = _offset_step(seen, target, tip, attitude, rows, points[label], "base" in register)
        if step % 10 == 9:
            miss = np.linalg.norm(seen - target, axis=1)
            good = log.known & (miss < FAR * max(1.4826 * float(np.nanmedian(miss[good])), 1e-9))
    tool = np.eye(3)
    if "tool" in register and log.attitude is not None:
        rows = good & np.isfinite(log.attitude).all(axis=(1, 2))
        tool = Rotation.from_matrix(attitude[rows].transpose(0, 2, 1) @ turn.T @ log.attitude[rows]).mean().as_matrix()
    return Frames(turn, shift, points, tool)


def _offset_step(
    seen: Array, target: Array, tip: Array, attitude: Array, rows: np.ndarray, point: Array, base: bool
) -> Array:
    """One Gauss-Newton step of a target's offset, the frame's six motions eliminated beside it."""
    blocks = [attitude[rows]]
    if base:
        arm = target[rows]
        blocks += [np.tile(np.eye(3), (len(arm), 1, 1)), np.stack([np.cross(e, arm) for e in np.eye(3)], axis=2)]
    a = np.concatenate(blocks, axis=2).reshape(-1, sum(b.shape[2] for b in blocks))
    return np.asarray(point + np.linalg.lstsq(a, (seen - target)[rows].ravel(), rcond=None)[0][:3])


def kabsch(model: Array, measured: Array) -> tuple[Array, Array]:
    """Return rotation and shift that carry the model's points onto the measured ones [Kabsch1976]."""
    a, b = model.mean(axis=0), measured.mean(axis=0)
    u, _, v = np.linalg.svd((model - a).T @ (measured - b))
    flip = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(v.T @ u.T)))])
    turn = v.T @ flip @ u.T
    return turn, b - turn @ a


class Problem:
    """The weighted least squares of one campaign around one posing of the robot."""

    def __init__(self, scene: ForwardModel, register: tuple[str, ...]) -> None:
        self.scene, self.register, log = scene, register, scene.log
        self.columns = Columns(scene)
        self.frames = fit_frames(log, scene.posed.tip, scene.posed.attitude, register)
        target = scene.posed.tip + np.einsum("nij,nj->ni", scene.posed.attitude, self.frames.of_targets(log))
        gaps = [(log.position - self.frames.shift) @ self.frames.turn - target]
        if log.attitude is not None:
            gaps.append(rotation_gap(self.frames.turn.T @ log.attitude, scene.posed.attitude @ self.frames.tool))
        if log.encoder is not None:
            bent = np.zeros_like(log.encoder)
            for joint in range(len(scene.chain.joints)):
                bent[:, joint] = sum((c * t[:, 0] for c, _, t in self.columns.own(joint)), np.zeros(len(bent)))
            gaps += list((log.encoder - bent).T[:, :, None])
        self.gaps = gaps
        self.rows = [log.known & np.isfinite(g).all(axis=1) for g in gaps]
        self.kept = log.known.copy()
        still = ~log.moving
        self.poses = len(set(log.stay[still & log.known])) + np.count_nonzero(log.moving) / PATH_SHARE
        self.sigma = [max(float(np.sqrt(np.mean(g[r] ** 2))), 1e-9) for g, r in zip(gaps, self.rows, strict=True)]
        self.noise = [max(1e-9, 0.2 * _repeat_scatter(g, log.stay)) for g in gaps]
        nuisance = [Spec("base_frame")] * ("base" in register) + [Spec("tool_frame")] * ("tool" in register)
        self.always = nuisance
        self.cache: dict[Spec, Motion] = {}

    def motion(self, spec: Spec) -> Motion:
        """Return the columns of an effect, kept for the next time."""
        if spec not in self.cache:
            self.cache[spec] = self.columns.of(spec)
        return self.cache[spec]

    def channels(self, motion: Motion) -> list[Array]:
        """Split columns as the gaps are split."""
        out = [motion.position]
        if self.scene.log.attitude is not None:
            out.append(motion.rotation)
        if self.scene.log.encoder is not None:
            out += [motion.encoder[:, j : j + 1] for j in range(motion.encoder.shape[1])]
        return out

    def masks(self) -> list[np.ndarray]:
        """Rows of each channel that are used."""
        return [rows & self.kept for rows in self.rows]

    def stack(self, parts: Iterable[Array]) -> Array:
        """Weigh and stack channels into one vector or matrix."""
        out = [
            p[m].reshape(int(m.sum()) * p.shape[1], *p.shape[2:]) / s
            for p, m, s in zip(parts, self.masks(), self.sigma, strict=True)
        ]
        return np.concatenate(out)

    def matrix(self, specs: Iterable[Spec]) -> Array:
        """Stack the columns of several effects."""
        blocks = [self.stack(self.channels(self.motion(s))) for s in specs]
        return np.hstack(blocks) if blocks else np.zeros((len(self.stack(self.gaps)), 0))

    def score(self, residual: Array) -> float:
        """Return n log(rss) summed over the channels, poses counted instead of rows."""
        total, at = 0.0, 0
        for gap, mask, sigma, noise in zip(self.gaps, self.masks(), self.sigma, self.noise, strict=True):
            size = int(mask.sum()) * gap.shape[1]
            part = residual[at : at + size]
            at += size
            if size:
                mean = float(part @ part) / size + (noise / sigma) ** 2
                total += self.poses * gap.shape[1] * np.log(mean)
        return total

    def price(self, spec: Spec, width: int, choices: int) -> float:
        """Return what an effect must gain: BIC's parameters, and the places and shapes that were tried."""
        return width * np.log(3.0 * self.poses) + 2.0 * np.log(choices * spec.tried)

    def fit(self, specs: list[Spec]) -> tuple[Array, list[Array]]:
        """Return the parameters of always-present frames and effects, and the gaps that they leave."""
        every = [*self.always, *specs]
        a = self.matrix(every)
        scale = np.linalg.norm(a, axis=0) + 1e-30
        value = np.linalg.lstsq(a / scale, self.stack(self.gaps), rcond=1e-9)[0] / scale
        left = [g.copy() for g in self.gaps]
        at = 0
        for spec in every:
            parts = self.channels(self.motion(spec))
            width = parts[0].shape[2]
            for k, part in enumerate(parts):
                left[k] -= part @ value[at : at + width]
            at += width
        return value, left

    def settle(self, specs: list[Spec]) -> None:
        """Set far rows aside and weigh each channel by what is left in it."""
        for _ in range(3):
            _, left = self.fit(specs)
            miss = np.linalg.norm(left[0], axis=1)
            known = self.scene.log.known
            limit = max(FAR * float(np.nanmedian(miss[known])), float(np.quantile(miss[known], 1.0 - ASIDE)))
            self.kept = known & (miss <= limit)
            for k, (part, mask) in enumerate(zip(left, self.masks(), strict=True)):
                self.sigma[k] = max(float(np.sqrt(np.mean(part[mask] ** 2))), self.noise[k]) if mask.any() else 1.0


def _repeat_scatter(gap: Array, stay: np.ndarray) -> float:
    """Return the scatter of one coordinate over rows of the same pose and load, 0 where there are none."""
    total, count = 0.0, 0
    order = np.argsort(stay, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(stay[order])) + 1):
        part = gap[rows][np.isfinite(gap[rows]).all(axis=1)]
        if len(part) > 1:
            total += float(np.sum((part - np.median(part, axis=0)) ** 2))
            count += (len(part) - 1) * part.shape[1]
    return float(np.sqrt(total / count)) if count else 0.0


def orthonormal(a: Array) -> Array:
    """Return an orthonormal basis of the columns, dependent ones left out."""
    if not a.shape[1]:
        return a
    u, s, _ = np.linalg.svd(a / (np.linalg.norm(a, axis=0) + 1e-30), full_matrices=False)
    return np.asarray(u[:, s > 1e-7 * max(float(s[0]), 1e-30)])


@dataclass(frozen=True, eq=False)
class Trial:
    """One effect added to a model: what it gains after its price, and what it explains."""

    spec: Spec
    gain: float
    fit: Array


def try_all(problem: Problem, beside: list[Spec], specs: list[Spec], choices: int) -> list[Trial]:
    """Add each effect to a model, best first."""
    basis = orthonormal(problem.matrix([*problem.always, *beside]))
    y = problem.stack(problem.gaps)
    y = y - basis @ (basis.T @ y)
    before, trials = problem.score(y), []
    for spec in specs:
        raw = problem.stack(problem.channels(problem.motion(spec)))
        a = raw - basis @ (basis.T @ raw)
        keep = np.linalg.norm(a, axis=0) > 1e-4 * np.linalg.norm(raw, axis=0) + 1e-12
        if not keep.any():
            continue
        q = orthonormal(a[:, keep])
        fit = q @ (q.T @ y)
        gain = before - problem.score(y - fit) - problem.price(spec, q.shape[1], choices)
        trials.append(Trial(spec, float(gain), fit))
    return sorted(trials, key=lambda t: -t.gain)


def scan_waves(problem: Problem, beside: list[Spec]) -> list[Spec]:
    """Find the best wave of each joint on what a model leaves: a coarse scan, then a fine one about its best."""
    _, left = problem.fit(beside)
    rows = np.flatnonzero(problem.kept)[:: max(1, int(problem.kept.sum()) // 400)]
    y, found = left[0][rows].ravel(), []
    for j, name in enumerate(problem.scene.chain.joints):
        lever, angle = problem.columns.reading[j][rows, :3], problem.scene.q[rows, j]
        rounds: list[Callable[[float], Array]] = [lambda _: WAVES, lambda best: best + np.linspace(-0.25, 0.25, 21)]
        best = 0.0
        for waves in rounds:
            tried = waves(best)
            best = float(tried[np.argmax([_wave_share(lever, w * angle, y) for w in tried])])
        found.append(Spec("transmission_error", name, shape=(round(best, 4),), tried=len(WAVES)))
    return found


def _wave_share(lever: Array, phase: Array, y: Array) -> float:
    a = np.stack([lever * np.sin(phase)[:, None], lever * np.cos(phase)[:, None]], axis=2).reshape(-1, 2)
    gram = a.T @ a + 1e-12 * np.eye(2)
    b = a.T @ y
    return float(b @ np.linalg.solve(gram, b))


@dataclass(frozen=True, eq=False)
class Selection:
    """What the greedy search chose."""

    problem: Problem  #: The least squares.
    chosen: list[Spec]  #: Effects, largest first gain first.
    specs: list[Spec]  #: Everything that was tried.
    coupling: Spec | None  #: Convention that was corrected before, or None.


def select(chain: Chain, log: Log, register: tuple[str, ...], most: int = MOST) -> Selection:
    """Choose effects one by one while BIC falls; drop those that later ones make idle."""
    q, coupling = correct_readings(chain, log, register)
    problem = Problem(stage(chain, log, q, sagging=False), register)
    specs = list(list_specs(problem.scene, register))
    chosen: list[Spec] = []
    for _ in range(2 * most):
        problem.settle(chosen)
        offered = [s for s in specs if s.place not in {c.place for c in chosen}] + scan_waves(problem, chosen)
        trials = try_all(problem, chosen, offered, len(specs))
        if not trials or trials[0].gain <= 0.0 or len(chosen) >= most:
            break
        chosen = prune(problem, [*chosen, trials[0].spec], len(specs))
        if any(c.effect == "gravity_sag" for c in chosen) and not problem.scene.gravity.any():
            problem = Problem(stage(chain, log, q, sagging=True), register)
            specs = list(list_specs(problem.scene, register))
    problem.settle(chosen)
    return Selection(problem, chosen, specs, coupling)


def prune(problem: Problem, chosen: list[Spec], choices: int) -> list[Spec]:
    """Drop effects that no longer pay, worst first."""
    while len(chosen) > 1:
        worth = [worth_of(problem, [c for c in chosen if c is not s], s, choices) for s in chosen[:-1]]
        if min(worth) > 0.0:
            return chosen
        chosen = [c for k, c in enumerate(chosen) if k != int(np.argmin(worth))]
    return chosen


def worth_of(problem: Problem, beside: list[Spec], spec: Spec, choices: int) -> float:
    """Return what an effect gains beside others; sag that is in the posing already is not asked again."""
    if spec.effect == "gravity_sag" and problem.scene.gravity.any() and not problem.scene.chain.has_gravity:
        return float("inf")
    gains = try_all(problem, beside, [spec], choices)
    return gains[0].gain if gains else -1.0


def correct_readings(chain: Chain, log: Log, register: tuple[str, ...]) -> tuple[Array, Spec | None]:
    """Look for a reversed, shifted or coupled reading where the gap is of centimetres; return what the links read."""
    loose = replace(log, wrench=np.zeros_like(log.wrench))

    def gap(q: Array) -> float:
        posed = stage(chain, loose, q, sagging=False).posed
        frames = fit_frames(log, posed.tip, posed.attitude, register)
        target = posed.tip + np.einsum("nij,nj->ni", posed.attitude, frames.of_targets(log))
        miss = np.linalg.norm((log.position - frames.shift) @ frames.turn - target, axis=1)
        return float(np.nanmedian(miss))

    start = gap(log.q)
    if start < 0.02:
        return log.q, None
    best: tuple[float, Array, Spec | None] = (start, log.q, None)
    for joint, name in enumerate(chain.joints):
        tries = [("reversed", -2.0 * log.q[:, joint], 0.0), ("zero", np.zeros(len(log.q)), 0.0)]
        tries += [(o, s * log.q[:, k], s) for k, o in enumerate(chain.joints) if k != joint for s in (1.0, -1.0)]
        for word, change, factor in tries:
            for zero in (0.0,) if factor else np.linspace(-np.pi, np.pi, 8, endpoint=False):
                q = log.q.copy()
                q[:, joint] += change + zero
                value = gap(q)
                if value < best[0]:
                    best = (value, q, Spec("joint_coupling", name, shape=(word, factor or zero)))
    if best[2] is None or best[0] > 0.2 * start:
        return log.q, None
    return best[1], best[2]
