"""95 % band of the true tip, and its contributions.

To first order the error of the tip is e = J p + u + r + f with independent normal terms: parameters p of covariance S,
unexplained error u, repeatability r, force f. Its covariance is

    V = k^2 (J S J^T + V_u) + s_r^2 1 + V_f + V_m + V_p,   k: calibration factor from poses left out of the fit,

V_u = s_u^2/3 1 if the part frame is absolute (`Slopes.smooth_columns`), V_m due to the motion of the arm, about its
mean, V_p due to the placement of the part (`compplan.uncertainty.motion`). The radius of the band is the 0.95 quantile
of |e|, that of a quadratic form (`compplan.measurement.distance`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from compplan.effects.forward_model import ForwardModel
from compplan.measurement.distance import LEVEL, band_radius
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.toolpath.toolpath import interpolate
from compplan.uncertainty.assumed import list_assumed, robot_uncertainty
from compplan.uncertainty.ladder import (
    FORCE_DIRECTION,
    FORCE_LEVEL,
    POINTS,
    POSES,
    PROBE,
    PULL,
    TRACKER_SIGMA,
    MeasurementStep,
    condition,
    observe_poses,
    pick_places,
    pose_variance,
    predict_bands,
)
from compplan.uncertainty.motion import Motion, spread_draws
from compplan.uncertainty.posture_errors import vary_response
from compplan.uncertainty.sensitivities import (
    ROWS,
    ForceSpread,
    measure_force_slopes,
    measure_slopes,
    pick_rows,
    solve_rows,
    tie_force,
)
from compplan.uncertainty.touch_off import TouchedPart, subtract_touch

#: Contributions to the band, in the order of the report.
PARTS = ("model", "unexplained", "repeatability", "force", "motion", "placement")
#: Readable names of groups of effects; other effects keep their name.
CAUSES = {
    "stiffness of the robot": (
        "joint_stiffness", "link_compliance", "link_elasticity", "base_compliance", "stiffness_nonlinearity"
    ),
    "geometry of the robot": ("joint_offset", "link_geometry", "joint_coupling"),
    "gears of the robot": ("backlash", "transmission_error"),
    "tool frame": ("tool_frame", "payload"),
}  # fmt: skip
#: Readable names of the other contributions.
OTHER_CAUSES = {
    "unexplained": "what no parameter of the robot explains", "repeatability": "repeatability",
    "force": "process force", "motion": "inertia and vibration", "placement": "place of the part",
}  # fmt: skip
#: Source and largest part of the band on a path of which parts were measured.
LEARNED, UNDETERMINED = "learned from measured parts of this path", "what the measured parts do not determine"
#: Number of rows added at the greatest errors due to motion.
MOVED = 60
#: Least eigenvalue, relative to the greatest, of the components of smooth errors.
LEAST_VALUE = 1e-8
#: Number of sampled paths for the band of the complete path, and their seed; for a forecast, at so many places.
PATHS, SEED = 2000, 20260601
FEWER, PLACES = 500, 100


@dataclass(frozen=True, eq=False)
class Slopes:
    """A linearised path; k rows, p parameters."""

    rows: NDArray[np.int_]  #: Rows of the path. Shape (k,).
    tip: Array  #: Loaded tip. Shape (k, 3). [m]
    model: Array  #: Derivative of the tip with respect to every parameter. Shape (k, 3, p).
    shared: Array  #: Motion by one deviation of force (4 columns) and placement (6 or none). Shape (k, 3, .). [m]
    local: Array  #: Motion by one deviation of the local force. Shape (k, 3, 1). [m]
    #: Errors of the tip due to motion, by sample; empty if not included. Shape (d, k, 3). [m]
    moved: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))
    #: Correlated and independent part of the force (`tie_force`); None: all is independent.
    tie: tuple[Array, Array] | None = None
    #: The part as located by touch-off, or None if its frame is absolute.
    touched: TouchedPart | None = None
    #: Motion of the tip by each z of the robot beyond that by parameters and force, or None. Shape (k, 3, r). [m]
    beyond: Array | None = None

    def smooth_columns(self, known: Uncertainty) -> Array:
        """Return the tip motion by one deviation of each component of the unexplained error. (k, 3, c). [m]

        Its axes are independent Gaussian fields of covariance s_u^2/3 exp(-d^2 / 2 scale^2); a touched part follows.
        """
        k = len(self.rows)
        place = self.tip if self.touched is None else np.vstack([self.tip, self.touched.shown])
        value, vector = np.linalg.eigh(np.exp(-0.5 * (cdist(place, place) / known.scale) ** 2))
        kept = value > LEAST_VALUE * value.max(initial=0.0)
        root = known.smooth * vector[:, kept] * np.sqrt(value[kept])
        columns = np.einsum("kr,ij->kirj", root, np.eye(3)).reshape(len(place), 3, -1)
        if self.touched is None:
            return columns
        return np.asarray(columns[:k] - self.touched.follow(columns[k:], self.tip))

    def columns(self, known: Uncertainty) -> tuple[Array, Array]:
        """Return the tip motion by one deviation of robot and independent terms. Shapes (k, 3, r), (k, 3, .). [m]

        The first includes `beyond` and the force correlated with the robot, the second independent force and placement.
        """
        robot = self.model @ known.spread + (0.0 if self.beyond is None else self.beyond)
        if self.tie is None:
            return robot, self.shared
        tied, apart = self.tie
        force = self.shared[:, :, :4]
        return robot + force @ tied, np.concatenate([force @ apart, self.shared[:, :, 4:]], axis=2)


@dataclass(frozen=True, eq=False)
class ErrorBand:
    """95 % band of the true tip about the planned one; n rows of a path."""

    radius: Array  #: Radius that contains the true tip with 95 %, including the planned deviation. Shape (n,). [m]
    parts: Mapping[str, Array]  #: Radius due to each contribution alone. Shape (n,) each. [m]
    covariance: Array  #: Covariance of the tip, interpolated between the linearised rows. Shape (n, 3, 3). [m^2]
    cut: NDArray[np.bool_]  #: Rows to which the band applies. Shape (n,).
    between: float  #: Greatest distance between rows beyond that at the rows. [m]
    whole: float  #: Distance within which the complete path lies with 95 %. [m]
    #: Parameters and their share of the variance, mean over the path, largest first.
    leading: tuple[tuple[str, float], ...]
    known: Uncertainty  #: Parameter uncertainty of the robot.
    force: ForceSpread  #: Uncertainty of the force.
    assumed: tuple[str, ...]  #: Assumptions, one sentence each.
    #: `greatest` and `whole` of the uncorrected program; None if not computed. [m]
    before: tuple[float, float] | None = None
    ladder: tuple[MeasurementStep, ...] = ()  #: Predicted `whole` after further measurements, cheapest first.
    #: Cheapest measurements after which the band keeps the tolerance; empty: none needed or none sufficient.
    cheapest: tuple[str, ...] = ()
    #: Band at its widest row due to each cause alone, by readable name. [m]
    causes: Mapping[str, float] = field(default_factory=dict)
    motion: Motion | None = None  #: Dynamic error due to the motion of the arm, None if not included.

    @property
    def greatest(self) -> float:
        """Return the greatest radius over the cut, also between its rows. [m]."""
        return float(self.radius[self.cut].max(initial=0.0)) + self.between

    @property
    def along(self) -> Array:
        """Return the simultaneous band of the complete path, wider than that of each point alone. Shape (n,). [m]."""
        alone = float(self.radius[self.cut].max(initial=0.0))
        widened = (self.whole - self.between) / alone if alone > 0.0 else 1.0
        return self.radius * widened + self.between

    @property
    def widest(self) -> int:
        """Return the row of the cut with the widest band."""
        rows = np.flatnonzero(self.cut)
        return int(rows[self.radius[rows].argmax()])

    def describe(self) -> dict[str, Any]:
        """Describe the band for plan.json."""
        widest, known, before = self.widest, self.known, self.before
        return {
            "error_band_mm": {
                "p95_max": self.greatest * 1e3,
                "p95_rms": float(np.sqrt(np.mean(self.radius[self.cut] ** 2))) * 1e3,
                "whole_path_p95": self.whole * 1e3,
                "widest_waypoint": widest,
                "at_widest": {name: float(values[widest]) * 1e3 for name, values in self.parts.items()},
            },
            **({} if before is None else {
                "error_band_before_mm": {"p95_max": before[0] * 1e3, "whole_path_p95": before[1] * 1e3}}),
            "ladder": [
                {"step": rung.step, "p95_max": rung.band * 1e3, "alone_p95_max": rung.alone * 1e3, "keeps": rung.keeps,
                 "minutes": rung.minutes, "instrument": rung.instrument, "cheapest": rung.step in self.cheapest}
                for rung in self.ladder
            ],
            "error_band_from": {
                "grade": known.grade,
                "source": known.source,
                "force": self.force.source,
                "calibration_factor": known.calibration,
                "calibration_groups": known.groups,
                "leading": [{"unknown": name, "share_of_variance": share} for name, share in self.leading],
                "assumed": list(self.assumed),
            },
        }  # fmt: skip


def linearise_path(
    scene: ForwardModel, known: Uncertainty, force: ForceSpread, cut: NDArray[np.bool_], *,
    motion: Motion | None = None, part: Array | None = None, touched: TouchedPart | None = None, most: int = ROWS,
) -> Slopes:  # fmt: skip
    """Linearise a path of n rows by parameters, force and placement of the part at selected rows of the cut.

    Args:
        scene: Forward model at all rows.
        known: Parameter uncertainty of the robot.
        force: Uncertainty of the force.
        cut: Rows that matter. Shape (n,).
        motion: Dynamic error due to the motion of the arm, or None.
        part: Motion of the part by one standard deviation of its placement, or None. Shape (n, 3, 6). [m]
        touched: The part as located by touch-off, or None if its frame is absolute.
        most: Greatest number of rows, in addition to those with the greatest dynamic errors.
    """
    rows = pick_rows(cut, most)
    if motion is not None:
        rows = np.union1d(rows, motion.worst_rows(cut, MOVED))
    rest = solve_rows(scene, rows)
    shared, local = measure_force_slopes(scene, rows, force, rest)
    if part is not None:
        shared = np.concatenate([shared, part[rows]], axis=2)
    moved = np.zeros((0, len(rows), 3)) if motion is None else motion.error[:, rows]
    tie = tie_force(known, force) if len(force.robot) else None
    model = subtract_touch(measure_slopes(scene, known.unknowns, rows, rest), rest.position, touched, known.unknowns)
    return Slopes(rows, rest.position, model, shared, local, moved, tie, touched)


def split_covariance(slopes: Slopes, known: Uncertainty) -> dict[str, Array]:
    """Return the covariance of the tip due to each contribution. Shape (k, 3, 3) each. [m^2]."""
    eye = np.broadcast_to(np.eye(3), (len(slopes.rows), 3, 3))
    (moved, shared), smooth = slopes.columns(known), slopes.smooth_columns(known)
    force = np.concatenate([shared[:, :, :4], slopes.local], axis=2)
    part = shared[:, :, 4:]
    return {
        "model": moved @ np.swapaxes(moved, 1, 2),
        "unexplained": smooth @ np.swapaxes(smooth, 1, 2),
        "repeatability": eye * (known.repeatability or 0.0) ** 2,
        "force": force @ np.swapaxes(force, 1, 2),
        "motion": spread_draws(slopes.moved) if len(slopes.moved) else 0.0 * eye,
        "placement": part @ np.swapaxes(part, 1, 2),
    }


def estimate_band(
    robot: Robot, scene: ForwardModel, cut: NDArray[np.bool_], force: ForceSpread, *,
    left: Array | None = None, between: float = 0.0, motion: Motion | None = None, part: Array | None = None,
    touched: TouchedPart | None = None, touchable: TouchedPart | None = None,
    uncorrected: Array | None = None, written: Array | None = None, tolerance: float = 0.0,
) -> ErrorBand:  # fmt: skip
    """Estimate the 95 % band of the true tip about the planned one along a path of n rows.

    Args:
        robot: The robot.
        scene: Forward model at all rows, with the effects of the robot folder.
        cut: Rows that matter. Shape (n,).
        force: Uncertainty of the force.
        left: Deviation of the plan itself at every row. Shape (n,). [m]
        between: Greatest distance between rows beyond that at the rows. [m]
        motion: Dynamic error due to the motion of the arm, or None.
        part: Motion of the part by one standard deviation of its placement, or None. Shape (n, 3, 6). [m]
        touched: The part as located by touch-off, or None if its frame is absolute.
        touchable: The part as touch-off would locate it, if its frame is absolute.
        uncorrected: Deviation of the uncorrected program. Shape (n, 3). [m]
        written: Part of `left` due to the written program, corrected or not: fit and corners. Shape (n,). [m]
        tolerance: Greatest permitted deviation. [m]

    Raises:
        InputError: If the folder's uncertainty.toml names an effect, joint or parameter that the robot does not have.
    """
    known = robot_uncertainty(robot)
    slopes = linearise_path(scene, known, force, cut, motion=motion, part=part, touched=touched)
    parts, n = split_covariance(slopes, known), len(cut)
    spread = {name: interpolate(np.arange(n), slopes.rows, value) for name, value in parts.items()}
    mean = None if motion is None else motion.mean
    if motion is not None:  # computed at every row: no interpolation
        spread["motion"] = motion.covariance
    total = np.asarray(sum(spread.values()))
    left = np.zeros(n) if left is None else left
    radius = band_radius(total, mean=mean)
    drawn = draw_paths(slopes, known)
    along = float(radius[cut].max(initial=0.0)) * widen_to_path(drawn)
    whole = along + float(left[cut].max(initial=0.0)) + between
    before = None
    if uncorrected is not None:
        off = uncorrected if mean is None else uncorrected + mean
        written = np.zeros(n) if written is None else written
        widest = float((band_radius(total, mean=off) + written)[cut].max(initial=0.0))
        farther = find_farthest(drawn + uncorrected[slopes.rows][:, :, None]) - find_farthest(drawn)
        everywhere = along + farther + float(written[cut].max(initial=0.0))
        before = (widest + between, max(widest, everywhere) + between)
    alone = {name: band_radius(value, mean=mean if name == "motion" else None) for name, value in spread.items()}
    ladder, cheapest = _climb(scene, slopes, known, force, parts, left, whole, between, touchable, tolerance)
    return ErrorBand(
        radius=radius + left,
        parts=alone,
        covariance=total,
        cut=cut,
        between=between,
        whole=whole,
        leading=lead_unknowns(slopes, known, parts),
        known=known,
        force=force,
        before=before,
        ladder=ladder,
        cheapest=cheapest,
        assumed=(*list_assumed(robot), *([f"force: {force.source}"] if "assumed" in force.source else []),
                 *([f"inertia and vibration: {motion.source}"] if motion is not None else [])),
        causes=name_causes(slopes, known, radius, alone),
        motion=motion,
    )  # fmt: skip


def _climb(
    scene: ForwardModel, slopes: Slopes, known: Uncertainty, force: ForceSpread, parts: Mapping[str, Array],
    left: Array, whole: float, between: float, touchable: TouchedPart | None, tolerance: float,
) -> tuple[tuple[MeasurementStep, ...], tuple[str, ...]]:  # fmt: skip
    """Predict the band of the complete cut after further measurements; empty for a path without rows."""
    if not len(slopes.rows):
        return (), ()
    k, touched = len(slopes.rows), slopes
    varied = vary_response(scene, slopes.rows, known)
    if touchable is not None:
        model = subtract_touch(slopes.model, slopes.tip, touchable, known.unknowns)
        shared = np.concatenate([slopes.shared[:, :, :4], touchable.spread_part(slopes.tip)], axis=2)
        touched = replace(slopes, model=model, shared=shared, touched=touchable)
    points, variance = pick_places(k, POINTS), pose_variance(known, TRACKER_SIGMA)
    seen = observe_poses(scene.robot, known, slopes.model @ known.spread, scene.campaign.q, slopes.tip[:, 2].min(),
                         POSES, PULL, variance)  # fmt: skip
    near, along = left[slopes.rows], np.gradient(slopes.tip, axis=0)[points] if k > 1 else np.zeros((1, 3))
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]  # points are not measured along the path
    repeats = np.broadcast_to((known.repeatability or 0.0) * np.eye(3), (k, 3, 3))
    mean = slopes.moved.mean(axis=0) if len(slopes.moved) else np.zeros((k, 3))
    random, places = np.random.default_rng(SEED), pick_places(k, PLACES)
    normal, apart = (random.standard_normal((size * len(places), FEWER)) for size in (3, 1))
    moved = np.zeros((1, 3, 1))
    if len(slopes.moved):
        moved = np.moveaxis(slopes.moved[random.integers(len(slopes.moved), size=FEWER)][:, places], 0, 2)

    at_stated, at_touched = ((at.columns(known), at.smooth_columns(known)) for at in (slopes, touched))

    @cache
    def greatest(steps: frozenset[str]) -> float:
        """Return the band of the complete path after measurements, apart from a constant factor."""
        (robot, shared), smooth = at_touched if "touch_off" in steps else at_stated
        pushed, placed = shared[:, :, :4].copy(), shared[:, :, 4:]
        scatter = pushed[:, :, :1] * force.scatter / max(force.level, 1e-12)
        pushed[:, :, 0] *= force.common / max(force.level, 1e-12)
        # frame, force and run of a measured part are independent of those of the next
        own = np.concatenate([placed, scatter, repeats], axis=2)
        of_part = np.concatenate([robot, smooth, pushed, own], axis=2)
        columns = np.concatenate([robot, smooth, pushed, 0.0 * own], axis=2)
        rows, sigmas = [np.zeros((0, columns.shape[2]))], [1.0]
        if "force_log" in steps:
            first = robot.shape[2] + smooth.shape[2]
            turn = FORCE_DIRECTION / max(force.direction, 1e-12)
            rows += [np.eye(columns.shape[2])[[first + axis]] for axis in range(4)]
            sigmas += [FORCE_LEVEL / max(force.common, 1e-12), turn, turn, turn]
        if "poses" in steps:
            rows.append(np.pad(seen, ((0, 0), (0, columns.shape[2] - seen.shape[1]))))
            sigmas.append(float(np.sqrt(variance)))
        if "first_part" in steps:
            rows.append((across @ of_part[points]).reshape(-1, columns.shape[2]))
            sigmas.append(PROBE)
        local = slopes.local
        if {"force_log", "first_part"} & set(steps):
            local = local * min(1.0, FORCE_LEVEL / max(force.path, 1e-12))
        after = [condition(columns, rows, sigmas), scatter, placed, repeats]
        if "poses" in steps and "first_part" not in steps:  # the arm found answers the force by J (C + dC) J^T
            log = FORCE_LEVEL if "force_log" in steps else np.inf
            after.append(varied * np.hypot(force.scatter, min(force.common, log)))
        shaken = np.concatenate(after, axis=2)
        covariance = shaken @ np.swapaxes(shaken, 1, 2) + local @ np.swapaxes(local, 1, 2) + parts["motion"]
        drawn = draw_columns(shaken[places], normal) + local[places] * apart[:, None] + moved
        return float((band_radius(covariance, mean=mean) + near).max()) * widen_to_path(drawn)

    widened = (whole - between) / max(greatest(frozenset()), 1e-12)
    steps = ["poses", "first_part"] + (["touch_off"] if touchable is not None else [])
    steps += ["force_log"] if slopes.shared[:, :, :4].any() else []
    return predict_bands(whole, lambda chosen: widened * greatest(frozenset(chosen)) + between, steps, tolerance)


def widen_to_path(drawn: Array) -> float:
    """Return the ratio of the 95 % distance of the complete path to that of its widest point, at least 1.

    Both quantiles are estimated from the same samples. drawn: sampled errors of the tip, shape (k, 3, count). [m]
    """
    point = float(np.quantile(np.linalg.norm(drawn, axis=1), LEVEL, axis=1).max(initial=0.0))
    return find_farthest(drawn) / point if point > 0.0 else 1.0


def find_farthest(drawn: Array) -> float:
    """Return the 95 % quantile of the greatest distance of sampled paths. drawn: shape (k, 3, count). [m]"""
    return float(np.quantile(np.linalg.norm(drawn, axis=1).max(axis=0, initial=0.0), LEVEL))


def draw_paths(slopes: Slopes, known: Uncertainty, count: int = PATHS) -> Array:
    """Draw errors of the tip along the path, to first order. Shape (k, 3, count). [m]

    Parameters, force and repeatability are constant along a run; the unexplained error is spatially smooth.
    """
    random = np.random.default_rng(SEED)
    k = len(slopes.rows)
    moved = draw_columns(np.concatenate(slopes.columns(known), axis=2), random.standard_normal((3 * k, count)))
    moved += (known.repeatability or 0.0) * random.standard_normal((1, 3, count))
    moved += slopes.local * random.standard_normal((k, 1, count))
    if len(slopes.moved):
        moved += np.moveaxis(slopes.moved[random.integers(len(slopes.moved), size=count)], 0, 2)
    moved += draw_columns(slopes.smooth_columns(known), random.standard_normal((3 * k, count)))
    return np.asarray(moved)


def draw_columns(columns: Array, normal: Array) -> Array:
    """Draw normal errors of the tip of covariance C = S S^T. Shape (k, 3, count). [m]

    A sample C^(1/2) z = S (S^T S)^(-1/2) S^T z depends on C alone, not on the signs of the decomposition S.
    columns: S, motion of the tip by one standard deviation of each cause, (k, 3, c) [m]; normal: z, (3 k, count).
    """
    root = columns.reshape(-1, columns.shape[2])
    value, vector = np.linalg.eigh(root.T @ root)
    kept = value > LEAST_VALUE * value.max(initial=0.0)
    value, vector = value[kept], vector[:, kept]
    drawn = vector.T @ (root.T @ normal)
    return np.asarray((root @ (vector @ (drawn / np.sqrt(value)[:, None]))).reshape(len(columns), 3, -1))


def name_causes(slopes: Slopes, known: Uncertainty, radius: Array, alone: Mapping[str, Array]) -> dict[str, float]:
    """Return the band at its widest linearised row due to each cause alone, with parameters grouped by kind. [m]

    radius: band, (n,) [m]; alone: that of each contribution, (n,) each. [m]
    """
    if not len(slopes.rows):
        return {}
    row = int(radius[slopes.rows].argmax())
    found = {words: float(alone[name][slopes.rows[row]]) for name, words in OTHER_CAUSES.items()}
    words = {effect: name for name, effects in CAUSES.items() for effect in effects}
    kind = np.array([words.get(u.effect, u.effect.replace("_", " ")) for u in known.unknowns for _ in u.keys], object)
    for name in dict.fromkeys(kind):
        moved = slopes.model[row][:, kind == name] @ known.spread[kind == name]
        found[name] = float(band_radius((moved @ moved.T)[None])[0])
    return found


def lead_unknowns(
    slopes: Slopes, known: Uncertainty, parts: Mapping[str, Array], most: int = 8
) -> tuple[tuple[str, float], ...]:
    """Rank parameters by the reduction of the mean variance along the path if each were known exactly."""
    total = float(np.mean([np.trace(part, axis1=1, axis2=2) for part in parts.values()]) * len(parts))
    # exact knowledge of parameter j reduces the covariance S by S e_j e_j^T S / S_jj
    along = slopes.model @ known.covariance
    gain = (along**2).sum(axis=(0, 1)) / np.maximum(np.diag(known.covariance), 1e-300) / len(slopes.model)
    order, names = np.argsort(-gain)[:most], known.names
    return tuple((names[k], float(gain[k] / max(total, 1e-300))) for k in order if gain[k] > 1e-3 * total)
