"""Accuracy: what a pose is worth before and after, where it is worst, and what more poses would bring.

The pose accuracy of ISO 9283 is the distance between where a pose was commanded and the mean of where it was attained
[ISO9283]. Here a pose is a stay (rows of one stay averaged, poses met again count on their own), a path counts block by
block, and `after` is the delivered model's held-out prediction: poses that its parameters never saw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compplan.diagnosis.data.channels import block_index
from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, SEED
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_channels, posterior_mean
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.results.calibration import Correction, Pose, list_corrections, list_frames
from compplan.diagnosis.validation.held_out import free_of_frames
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.search.state import Fit


#: How many more poses the curve is asked for, and from how many on it is drawn (assumed: no further ahead than it has
#: seen).
MORE = 10


@dataclass(frozen=True)
class Accuracy:
    """Distances over a number of poses: mean, largest, mean plus three standard deviations, root mean square. [m]"""

    mean: float
    largest: float
    three_sigma: float
    rms: float
    poses: int

    def to_json(self) -> dict[str, float | int]:
        """Return the figures as diagnosis.json holds them."""
        names = {"mean": "mean", "max": "largest", "mean_and_3_sigma": "three_sigma", "rms": "rms"}
        figures = {f"{key}_mm": round(1e3 * getattr(self, name), 5) for key, name in names.items()}
        return {"poses": self.poses, **figures}


@dataclass(frozen=True)
class Learning:
    """Held-out error over the number of poses: e^2 = floor^2 + gain^2 / poses.

    Attributes:
        poses: Groups of poses that were fitted to, point by point.
        errors: Rms held-out distance of each. [m]
        floor: What no number of poses takes away. [m]
        gain: Error that one pose would leave beyond it. [m]
        now: Groups of poses of the campaign.
    """

    poses: tuple[float, ...]
    errors: tuple[float, ...]
    floor: float
    gain: float
    now: int

    def at(self, poses: float) -> float:
        """Return the error that the curve expects of a number of poses. [m]"""
        return float(np.sqrt(self.floor**2 + self.gain**2 / poses))

    def to_json(self) -> dict[str, Any]:
        """Return the curve as diagnosis.json holds it."""
        return {
            "poses": [round(p, 1) for p in self.poses],
            "held_out_rms_mm": [round(1e3 * e, 5) for e in self.errors],
            "poses_now": self.now,
            "expected_now_mm": round(1e3 * self.at(self.now), 5),
            f"expected_with_{MORE}_more_mm": round(1e3 * self.at(self.now + MORE), 5),
            "expected_with_endless_poses_mm": round(1e3 * self.floor, 5),
        }


@dataclass(frozen=True, eq=False)
class WorstPose:
    """A pose that the delivered model predicts badly: first row, joints [deg or mm], distance held out [m]."""

    row: int
    joints: Array
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Return the pose as diagnosis.json holds it."""
        joints = [round(float(v), 4) for v in self.joints]
        return {"row": self.row, "joints_deg_or_mm": joints, "held_out_mm": round(1e3 * self.distance, 5)}


def measure_accuracy(diagnosis: Diagnosis) -> dict[str, Accuracy]:
    """Measure the pose accuracy before, and held out after."""
    before, after, _ = _stays(diagnosis)
    return {"before": _summarise(before), "after": _summarise(after)}


def list_worst(diagnosis: Diagnosis) -> tuple[WorstPose, ...]:
    """List the poses that the delivered model predicts worst, held out."""
    _, after, first = _stays(diagnosis)
    order = np.argsort(-after, kind="stable")[:FEW_ROWS]
    unit = np.where(diagnosis.robot.prismatic, 1e3, 180.0 / np.pi)
    q = diagnosis.fit.problem.campaign.q
    return tuple(WorstPose(int(first[k]), q[first[k]] * unit, float(after[k])) for k in order)


def _stays(diagnosis: Diagnosis) -> tuple[Array, Array, NDArray[np.int_]]:
    """Average stays: distances before and after, first row of each. Shape (stays,). [m]"""
    campaign, held = diagnosis.fit.problem.campaign, diagnosis.deliveries[0].held
    good = campaign.usable.copy()
    good[diagnosis.outliers] = False
    keep = good[held.rows]
    rows = held.rows[keep]
    _, first, stay = np.unique(block_index(campaign)[rows], return_index=True, return_inverse=True)
    count = np.bincount(stay)
    sides = []
    for residual in (diagnosis.residual_before[rows], held.residual[keep]):
        mean = np.column_stack([np.bincount(stay, residual[:, k]) for k in range(3)]) / count[:, None]
        sides.append(np.linalg.norm(mean, axis=1))
    return sides[0], sides[1], rows[first]


def _summarise(distance: Array) -> Accuracy:
    mean = float(distance.mean())
    spread = float(distance.std(ddof=1)) if len(distance) > 1 else 0.0
    rms = float(np.sqrt(np.mean(distance**2)))
    return Accuracy(mean, float(distance.max()), mean + 3.0 * spread, rms, len(distance))


def draw_learning(diagnosis: Diagnosis) -> Learning | None:
    """Fit the delivered model to drawn parts of the poses, and predict the others to first order.

    Names, noise and the sizes of small errors are those of the whole campaign. None where there are too few poses, or
    where nothing is delivered.
    """
    delivery = diagnosis.deliveries[0]
    campaign = diagnosis.fit.problem.campaign
    _, pose = np.unique(campaign.pose, return_inverse=True)
    label = np.where(campaign.on_path, pose.max(initial=0) + 1 + block_index(campaign), pose.reshape(-1))
    if delivery.fitted is None:
        return None
    # rows that are no part of the fit (not measured, outliers, an approach that nobody knows) tell nothing here
    usable, group = np.zeros(len(label), bool), np.full(len(label), -1)
    usable[delivery.fitted.search.equations.source[0].rows] = True
    group[usable] = np.unique(label[usable], return_inverse=True)[1].reshape(-1)
    groups = int(group.max(initial=-1)) + 1
    if groups < MORE:
        return None
    rng = np.random.default_rng(SEED)
    parts = min(groups, ENOUGH_ROWS)
    part = np.where(usable, (rng.permutation(groups) % parts)[group], -1)
    products = [_multiply_part(delivery.fitted, part == k) for k in range(parts)]
    frames, freed = _frames(delivery.fitted), free_of_frames(delivery.fitted, groups)
    poses, errors = [], []
    # from half of the parts to all but one, and from every part on
    for count in range(parts // 2, parts):
        squares = []
        for start in range(parts):
            given = (start + np.arange(count)) % parts
            squares.append(_predict_rest(delivery.fitted, frames, [products[k] for k in given], ~np.isin(part, given)))
        poses.append(count / parts * groups)
        errors.append(freed * float(np.sqrt(np.mean(squares))))
    design = np.column_stack([np.ones(len(poses)), 1.0 / np.array(poses)])
    weight = 1.0 / np.array(errors) ** 2
    floor2, gain2 = nnls(design * weight[:, None], np.array(errors) ** 2 * weight)[0]
    return Learning(tuple(poses), tuple(errors), float(np.sqrt(floor2)), float(np.sqrt(gain2)), groups)


def _multiply_part(fitted: Fit, rows: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the whitened products of the active columns over some rows: gram, and with the observations."""
    posterior = fitted.model.posterior
    channels = select_rows(fitted.search.equations, rows, posterior.columns)
    gram, against, _, _ = combine_channels(channels, posterior.hyper)
    return gram, against


def _frames(fitted: Fit) -> Array:
    """Return what frames that every campaign brings can follow, whitened, orthonormal. Shape (3 r, k)."""
    equations = fitted.search.equations
    columns = equations.designs[0][..., equations.columns_named(REGISTRATION)]
    return np.asarray(np.linalg.qr(columns.reshape(equations.observed[0].size, columns.shape[-1]))[0])


def _predict_rest(fitted: Fit, frames: Array, given: Sequence[tuple[Array, Array]], rest: NDArray[np.bool_]) -> float:
    """Return the mean square distance that a model fitted to some products leaves of other rows. [m^2]"""
    equations, posterior = fitted.search.equations, fitted.model.posterior
    prior = fitted.search.prior_of(fitted.model.claims).variance(posterior.hyper.log_tau)[posterior.columns]
    gram, against = (sum((p[k] for p in given), np.zeros_like(given[0][k])) for k in range(2))
    mean = posterior_mean(gram, against, prior)
    source = equations.source[0]
    seen = rest[source.rows]
    left = equations.observed[0] - equations.designs[0][..., posterior.columns] @ mean
    left = left - (frames @ (frames.T @ left.ravel())).reshape(left.shape)
    return float(np.mean(np.sum((left[seen] * source.sigma[seen]) ** 2, axis=1)))


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a diagnosis is worth to a calibration engineer.

    Attributes:
        corrections: Zeros, lengths, tool and base to enter, with intervals.
        frames: Tool and registered frames as controllers take them.
        accuracy: Pose accuracy "before" and, held out, "after".
        learning: Held-out error over the number of poses, or None.
        worst: Poses that are predicted worst.
    """

    corrections: tuple[Correction, ...]
    frames: tuple[Pose, ...]
    accuracy: dict[str, Accuracy]
    learning: Learning | None
    worst: tuple[WorstPose, ...]

    def to_json(self) -> dict[str, Any]:
        """Return what diagnosis.json holds under `for_controllers` and `accuracy`."""
        return {
            "for_controllers": {
                "corrections": [correction.to_json() for correction in self.corrections],
                "frames": [frame.to_json() for frame in self.frames],
            },
            "accuracy": {
                **{name: accuracy.to_json() for name, accuracy in self.accuracy.items()},
                "learning": None if self.learning is None else self.learning.to_json(),
                "worst_poses": [pose.to_json() for pose in self.worst],
            },
        }


def assess_diagnosis(diagnosis: Diagnosis) -> Assessment:
    """Assess the delivered robot of a diagnosis."""
    return Assessment(
        list_corrections(diagnosis), list_frames(diagnosis), measure_accuracy(diagnosis), draw_learning(diagnosis),
        list_worst(diagnosis),
    )  # fmt: skip
